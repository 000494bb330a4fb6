package dev.boxline.internal;

import java.nio.ByteBuffer;

/** The functions of {@code libboxline_jni}; rust/jni/src/natives.rs says what they do and throw. Any thread may call them. */
public final class Native {
    private Native() {}

    /** Reads a calibration.json. The handle is never 0 and must be closed. */
    public static native long openCalibration(byte[] json);

    /** Whether the calibration says how sure it is. */
    public static native boolean hasCovariance(long calibration);

    /** Lets go of a calibration. Closing twice does nothing; calls that are running finish. */
    public static native void closeCalibration(long handle);

    /** A sign that ends calls which were given it. */
    public static native long newStop();

    /** Calls that were given it end, with a CancellationException. */
    public static native void setStop(long stop);

    public static native void closeStop(long stop);

    /**
     * Measures a box from two or three frames, each with or without (null) the same view with the lasers off. Each buffer is direct and
     * holds one JPEG from position to limit.
     *
     * @return the bytes of a boxline.v1.BoxReport
     */
    public static native byte[] measureBox(
            long handle,
            ByteBuffer frameA,
            ByteBuffer frameB,
            ByteBuffer frameC,
            ByteBuffer offA,
            ByteBuffer offB,
            ByteBuffer offC,
            long stop);
}
