package dev.boxline.internal

/** Entry points that only a library built with the feature `testing` has. */
internal object NativeTesting {
    init {
        Native.hashCode() // loads the library
    }

    @JvmStatic external fun echo(bytes: ByteArray): ByteArray

    @JvmStatic external fun echoBuffer(buffer: java.nio.ByteBuffer): ByteArray

    @JvmStatic external fun panicWith(message: String?)

    @JvmStatic external fun failWith(kind: Int, text: String): Long

    /** Calibrations, stop signs, heads and frames that are open. */
    @JvmStatic external fun openHandles(): Int
}
