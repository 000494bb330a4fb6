package dev.boxline;

import dev.boxline.internal.Native;
import dev.boxline.internal.NativeTesting;
import java.io.IOException;
import java.nio.ByteBuffer;
import java.nio.file.Files;
import java.nio.file.Path;
import java.util.ArrayList;
import java.util.Arrays;
import java.util.List;
import java.util.concurrent.Callable;
import java.util.concurrent.CountDownLatch;
import java.util.concurrent.ExecutorService;
import java.util.concurrent.Executors;
import java.util.concurrent.Future;

/**
 * Uses the native library as an app does, and as a broken app does. tests/jvm.rs runs it and compares what it prints and
 * writes: one line "ok name" a check, the measured bytes in a file. The first failure ends it with exit code 1.
 */
public final class BoundaryCheck {
    private static final int THREADS = 8;
    private static final int CALLS = 2;
    private static final int ROUNDS = 50;

    private final byte[] calibration;
    private final ByteBuffer frameA;
    private final ByteBuffer frameB;

    private BoundaryCheck(Path calibration, Path folder) throws IOException {
        this.calibration = Files.readAllBytes(calibration);
        this.frameA = direct(Files.readAllBytes(folder.resolve("a.jpg")));
        this.frameB = direct(Files.readAllBytes(folder.resolve("b.jpg")));
    }

    /** Arguments: the library, calibration.json, the folder with a.jpg and b.jpg, the file for the measured bytes. */
    public static void main(String[] args) throws Exception {
        System.load(Path.of(args[0]).toAbsolutePath().toString());
        BoundaryCheck check = new BoundaryCheck(Path.of(args[1]), Path.of(args[2]));
        byte[] measured = check.measure();
        Files.write(Path.of(args[3]), measured);
        System.out.println("ok measure");
        check.run("position_and_limit", () -> check.positionAndLimit(measured));
        check.run("echo", check::echo);
        check.run("panic", check::panic);
        check.run("errors", check::errors);
        check.run("broken_calibration", check::brokenCalibration);
        check.run("broken_frames", check::brokenFrames);
        check.run("wrong_arguments", check::wrongArguments);
        check.run("closed_handle", check::closedHandle);
        check.run("open_and_close_" + ROUNDS + "_times", check::openAndClose);
        check.run("stop", check::stop);
        check.run("threads", () -> check.threads(measured));
        check.run("close_during_calls", () -> check.closeDuringCalls(measured));
        check.run("nothing_left_open", () -> same(0, NativeTesting.openHandles()));
    }

    private interface Body {
        void run() throws Exception;
    }

    private void run(String name, Body body) throws Exception {
        body.run();
        System.out.println("ok " + name);
    }

    private byte[] measure() {
        long handle = Native.openCalibration(calibration);
        try {
            return Native.measureBox(handle, frameA, frameB, null, null, null, null, 0);
        } finally {
            Native.closeCalibration(handle);
        }
    }

    /** A frame in the middle of a larger buffer, as a camera's ring of buffers gives it. */
    private void positionAndLimit(byte[] measured) {
        ByteBuffer larger = ByteBuffer.allocateDirect(frameA.capacity() + 200);
        larger.position(100);
        larger.put(frameA.duplicate());
        larger.limit(larger.position());
        larger.position(100);
        long handle = Native.openCalibration(calibration);
        same(true, Arrays.equals(measured, Native.measureBox(handle, larger, frameB, null, null, null, null, 0)));
        Native.closeCalibration(handle);
        same(100, larger.position());
        same(100 + frameA.capacity(), larger.limit());
        same("[3, 4]", Arrays.toString(NativeTesting.echoBuffer(direct(new byte[] {1, 2, 3, 4, 5}).position(2).limit(4))));
        same("[3, 4]", Arrays.toString(NativeTesting.echoBuffer(direct(new byte[] {1, 2, 3, 4}).position(2).slice())));
        same("[7]", Arrays.toString(NativeTesting.echoBuffer(direct(new byte[] {7}).asReadOnlyBuffer())));
    }

    private void echo() {
        byte[] bytes = new byte[256];
        for (int i = 0; i < bytes.length; i++) {
            bytes[i] = (byte) i;
        }
        same(true, Arrays.equals(bytes, NativeTesting.echo(bytes)));
        same(0, NativeTesting.echo(new byte[0]).length);
    }

    private void panic() {
        String text = "frame 7 of 9: µ, 箱, \uD83D\uDCE6, nul \0 and \"" + "x".repeat(5000) + "\"";
        for (int i = 0; i < 20; i++) {
            fails(NativeBugException.class, "panic in native code: " + text, () -> NativeTesting.panicWith(text));
        }
        fails(NativeBugException.class, "panic in native code: a fixed text", () -> NativeTesting.panicWith(""));
        fails(NativeBugException.class, "panic in native code: no message", () -> NativeTesting.panicWith(null));
        same(1, NativeTesting.echo(new byte[1]).length);
    }

    private void errors() {
        List<Class<? extends RuntimeException>> byKind = List.of(
                ScannerConfigException.class,
                ScannerConfigException.class,
                InvalidFrameException.class,
                ScannerConfigException.class,
                ScannerConfigException.class,
                ScannerConfigException.class,
                ScannerConfigException.class,
                java.util.concurrent.CancellationException.class);
        for (int kind = 0; kind < byKind.size(); kind++) {
            int k = kind;
            String text = kind < 7 ? "camera.fx: 0 µm" : "cancelled";
            fails(byKind.get(kind), text, () -> NativeTesting.failWith(k, "camera.fx: 0 µm"));
        }
    }

    private void brokenCalibration() {
        String text = new String(calibration, java.nio.charset.StandardCharsets.UTF_8);
        String[][] table = {
            {"", "calibration: not JSON: "},
            {text.substring(0, text.length() / 2), "not JSON: EOF"},
            {text.replace("calibration/1", "calibration/9"), "calibration: format: found \"boxline-calibration/9\""},
            {text.replace("\"fx\"", "\"gx\""), "calibration: camera: missing field `fx`"},
            {text.replaceFirst("-1\\.0", "NaN"), "not JSON: "},
        };
        for (String[] row : table) {
            byte[] bytes = row[0].getBytes(java.nio.charset.StandardCharsets.UTF_8);
            failsWith(ScannerConfigException.class, row[1], () -> Native.openCalibration(bytes));
        }
        // Well-formed, but for another camera.
        long other = Native.openCalibration(text.replace("2592", "1296").getBytes(java.nio.charset.StandardCharsets.UTF_8));
        failsWith(ScannerConfigException.class, "2592", () -> Native.measureBox(other, frameA, frameB, null, null, null, null, 0));
        same(false, Native.hasCovariance(other));
        Native.closeCalibration(other);
    }

    private void brokenFrames() {
        long handle = Native.openCalibration(calibration);
        byte[] whole = bytes(frameA);
        ByteBuffer empty = ByteBuffer.allocateDirect(0);
        ByteBuffer cut = direct(Arrays.copyOf(whole, whole.length / 2));
        ByteBuffer noise = direct("not a picture".getBytes());
        for (ByteBuffer broken : List.of(empty, cut, noise, frameA.duplicate().position(frameA.limit()))) {
            failsWith(InvalidFrameException.class, "frameA: ", () -> Native.measureBox(handle, broken, frameB, null, null, null, null, 0));
            failsWith(InvalidFrameException.class, "frameA with the lasers off: ", () -> Native.measureBox(handle, frameA, frameB, null, broken, null, null, 0));
            failsWith(InvalidFrameException.class, "frameB: ", () -> Native.measureBox(handle, frameA, broken, null, null, null, null, 0));
        }
        Native.closeCalibration(handle);
    }

    private void wrongArguments() {
        long handle = Native.openCalibration(calibration);
        fails(NullPointerException.class, "json is null", () -> Native.openCalibration(null));
        fails(NullPointerException.class, "frameA is null", () -> Native.measureBox(handle, null, frameB, null, null, null, null, 0));
        fails(NullPointerException.class, "frameB is null", () -> Native.measureBox(handle, frameA, null, null, null, null, null, 0));
        ByteBuffer onHeap = ByteBuffer.wrap(bytes(frameA));
        Class<IllegalArgumentException> wrong = IllegalArgumentException.class;
        failsWith(wrong, "frameA is not a direct buffer", () -> Native.measureBox(handle, onHeap, frameB, null, null, null, null, 0));
        failsWith(wrong, "frameB is not a direct buffer", () -> Native.measureBox(handle, frameA, onHeap, null, null, null, null, 0));
        failsWith(wrong, "offB is not a direct buffer", () -> Native.measureBox(handle, frameA, frameB, null, null, onHeap, null, 0));
        failsWith(wrong, "frameC is not a direct buffer", () -> Native.measureBox(handle, frameA, frameB, onHeap, null, null, null, 0));
        Native.closeCalibration(handle);
    }

    private void closedHandle() {
        long handle = Native.openCalibration(calibration);
        Native.closeCalibration(handle);
        Native.closeCalibration(handle); // does nothing
        Class<IllegalStateException> state = IllegalStateException.class;
        fails(state, "handle " + handle + " is closed", () -> Native.measureBox(handle, frameA, frameB, null, null, null, null, 0));
        for (long never : new long[] {0, -1, handle + 1, Long.MAX_VALUE, Long.MIN_VALUE}) {
            String text = "handle " + never + " was never opened";
            fails(state, text, () -> Native.measureBox(never, frameA, frameB, null, null, null, null, 0));
            fails(state, text, () -> Native.closeCalibration(never));
        }
        long next = Native.openCalibration(calibration);
        fails(state, "handle " + handle + " is closed", () -> Native.measureBox(handle, frameA, frameB, null, null, null, null, 0));
        Native.closeCalibration(handle); // must not close the new one
        same(1, NativeTesting.openHandles());
        Native.closeCalibration(next);
    }

    private void openAndClose() {
        for (int round = 0; round < ROUNDS; round++) {
            List<Long> handles = new ArrayList<>();
            for (int i = 0; i < 3; i++) {
                handles.add(Native.openCalibration(calibration));
            }
            same(3, NativeTesting.openHandles());
            handles.forEach(Native::closeCalibration);
            same(0, NativeTesting.openHandles());
        }
    }

    /** A call that is stopped ends with the exception of coroutines, at once if the sign was set before. */
    private void stop() throws Exception {
        long handle = Native.openCalibration(calibration);
        long stop = Native.newStop();
        Thread later = new Thread(() -> {
            try {
                Thread.sleep(20);
            } catch (InterruptedException e) {
                throw new AssertionError(e);
            }
            Native.setStop(stop);
        });
        later.start();
        Class<java.util.concurrent.CancellationException> cancelled = java.util.concurrent.CancellationException.class;
        fails(cancelled, "cancelled", () -> Native.measureBox(handle, frameA, frameB, null, null, null, null, stop));
        later.join();
        fails(cancelled, "cancelled", () -> Native.measureBox(handle, frameA, frameB, null, null, null, null, stop));
        Native.closeStop(stop);
        fails(IllegalStateException.class, "handle " + stop + " is closed", () -> Native.measureBox(handle, frameA, frameB, null, null, null, null, stop));
        fails(IllegalStateException.class, "handle " + stop + " is closed", () -> Native.setStop(stop));
        Native.closeCalibration(handle);
    }

    private void threads(byte[] measured) throws Exception {
        long handle = Native.openCalibration(calibration);
        onThreads(() -> {
            for (int call = 0; call < CALLS; call++) {
                same(true, Arrays.equals(measured, Native.measureBox(handle, frameA.duplicate(), frameB.duplicate(), null, null, null, null, 0)));
            }
            return null;
        });
        Native.closeCalibration(handle);
    }

    /** A running call finishes with the right bytes, later ones see a closed handle; nothing in between. */
    private void closeDuringCalls(byte[] measured) throws Exception {
        long handle = Native.openCalibration(calibration);
        CountDownLatch oneHasFinished = new CountDownLatch(1); // then the other threads are in the middle of theirs
        Thread closer = new Thread(() -> {
            try {
                oneHasFinished.await();
            } catch (InterruptedException e) {
                throw new AssertionError(e);
            }
            Native.closeCalibration(handle);
        });
        closer.start();
        List<Integer> finished = onThreads(() -> {
            for (int calls = 0; ; calls++) {
                try {
                    same(true, Arrays.equals(measured, Native.measureBox(handle, frameA.duplicate(), frameB.duplicate(), null, null, null, null, 0)));
                    oneHasFinished.countDown();
                } catch (IllegalStateException e) {
                    same("handle " + handle + " is closed", e.getMessage());
                    return calls;
                }
            }
        });
        closer.join();
        same(true, finished.stream().mapToInt(calls -> calls).sum() > 1);
    }

    private static <T> List<T> onThreads(Callable<T> body) throws Exception {
        ExecutorService threads = Executors.newFixedThreadPool(THREADS);
        try {
            List<T> results = new ArrayList<>();
            for (Future<T> result : threads.invokeAll(java.util.Collections.nCopies(THREADS, body))) {
                results.add(result.get());
            }
            return results;
        } finally {
            threads.shutdownNow();
        }
    }

    private static ByteBuffer direct(byte[] bytes) {
        return ByteBuffer.allocateDirect(bytes.length).put(bytes).flip();
    }

    private static byte[] bytes(ByteBuffer buffer) {
        byte[] bytes = new byte[buffer.remaining()];
        buffer.duplicate().get(bytes);
        return bytes;
    }

    private static void same(Object expected, Object found) {
        if (!expected.equals(found)) {
            throw new AssertionError("expected " + expected + ", found " + found);
        }
    }

    private static void fails(Class<? extends RuntimeException> type, String text, Runnable body) {
        same(text, failure(type, body));
    }

    private static void failsWith(Class<? extends RuntimeException> type, String part, Runnable body) {
        String text = failure(type, body);
        if (!text.contains(part)) {
            throw new AssertionError("\"" + part + "\" is not in \"" + text + "\"");
        }
    }

    private static String failure(Class<? extends RuntimeException> type, Runnable body) {
        try {
            body.run();
        } catch (RuntimeException e) {
            if (e.getClass() != type) {
                throw new AssertionError("expected " + type, e);
            }
            return e.getMessage();
        }
        throw new AssertionError("expected " + type + ", nothing was thrown");
    }
}
