package dev.boxline.internal;

import java.nio.ByteBuffer;

/** Entry points that only a library built with the feature {@code testing} has. */
public final class NativeTesting {
    private NativeTesting() {}

    public static native byte[] echo(byte[] bytes);

    public static native byte[] echoBuffer(ByteBuffer buffer);

    /** Panics: with a formatted text; with a fixed one if it is empty; with no text at all if it is null. */
    public static native void panicWith(String message);

    /** Fails with an error kind, in the order of Rust's ErrorKind. */
    public static native long failWith(int kind, String text);

    public static native int openHandles();
}
