package dev.boxline

import java.nio.ByteBuffer

/**
 * One face of a box: a JPEG of the head's camera, and of the same view with the lasers [off], taken right before or after it. Both buffers
 * are direct and are read from position to limit.
 */
public class Picture @JvmOverloads constructor(public val lit: ByteBuffer, public val off: ByteBuffer? = null)
