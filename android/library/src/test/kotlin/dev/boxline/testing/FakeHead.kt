package dev.boxline.testing

/** A head made of software behind the real libusb (`rust/jni/examples/fake_head.rs`), if this JVM was started with it. */
internal object FakeHead {
    const val EMPTY_STORE: Int = 1
    const val OTHER_SERIAL: Int = 2
    const val NOTHING: Int = -1

    /** Frames of which half is missing. */
    const val TORN: Int = -2

    private val path: String? = System.getProperty("boxline.fakehead")

    val isThere: Boolean = path != null

    init {
        path?.let { System.load(it) }
    }

    /** Plugs a new head in and gives its descriptor; the one before is gone. */
    @JvmStatic external fun plug(how: Int): Int

    /** Which of the two lit pictures of the recording it sees from now on; 2 and 3 are the same in another exposure. */
    @JvmStatic external fun show(view: Int)

    /** The cable comes out after so many blocks of the stream. */
    @JvmStatic external fun pull(blocks: Int)

    @JvmStatic external fun lasers(): Int

    @JvmStatic external fun claims(): Int
}
