package dev.boxline.internal

import java.nio.ByteBuffer

/**
 * The functions of `libboxline_jni`; `rust/jni/src/natives.rs` says what each does and throws. Any thread may call them. A handle
 * is a number, never 0; a `stop` is a handle of [newStop], or 0.
 */
internal object Native {
    init {
        // A test names the library by its path; on Android, and where the path is set, the system finds it.
        val path = System.getProperty("boxline.library")
        if (path == null) System.loadLibrary("boxline_jni") else System.load(path)
    }

    /**
     * Starts the log and loads the network, the first time. Every opener calls it: what fails here is an exception of its own, as it would
     * not be in a static initialiser.
     */
    fun load(): Unit = start(Integer.getInteger("boxline.log", 2), Integer.getInteger("boxline.threads", 0))

    @JvmStatic external fun start(logLevel: Int, threads: Int)

    @JvmStatic external fun version(): String

    @JvmStatic external fun log(level: Int, text: String)

    @JvmStatic external fun newStop(): Long

    @JvmStatic external fun setStop(stop: Long)

    @JvmStatic external fun closeStop(stop: Long)

    @JvmStatic external fun openCalibration(json: ByteArray): Long

    @JvmStatic external fun hasCovariance(calibration: Long): Boolean

    @JvmStatic external fun closeCalibration(handle: Long)

    /** Calibration, first and second frame. */
    @JvmStatic external fun openRecording(folder: String): LongArray

    /** From two frames, or three, each with or without the same view with the lasers off. */
    @JvmStatic external fun measureBox(
        calibration: Long,
        frameA: ByteBuffer,
        frameB: ByteBuffer,
        frameC: ByteBuffer?,
        offA: ByteBuffer?,
        offB: ByteBuffer?,
        offC: ByteBuffer?,
        stop: Long,
    ): ByteArray

    @JvmStatic external fun viewFrame(calibration: Long, frame: ByteBuffer, stop: Long): ByteArray

    @JvmStatic external fun reportJsonText(report: ByteArray): String

    @JvmStatic external fun openHead(fd: Int): Long

    @JvmStatic external fun closeHead(head: Long)

    @JvmStatic external fun headSerial(head: Long): String

    @JvmStatic external fun openHeadCalibration(head: Long): Long

    @JvmStatic external fun startStream(head: Long)

    @JvmStatic external fun stopStream(head: Long)

    @JvmStatic external fun liveView(head: Long, calibration: Long, after: Long, stop: Long): ByteArray

    @JvmStatic external fun captureFrame(head: Long, stop: Long): Long

    @JvmStatic external fun closeFrame(frame: Long)

    @JvmStatic external fun frameJpeg(frame: Long): ByteArray

    @JvmStatic external fun viewCaptured(calibration: Long, frame: Long, stop: Long): ByteArray

    @JvmStatic external fun measureFrames(calibration: Long, frames: LongArray, stop: Long): ByteArray

    @JvmStatic external fun showPreview(head: Long, surface: Any?): Boolean
}
