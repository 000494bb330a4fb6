package dev.boxline.testing

import dev.boxline.Picture
import dev.boxline.internal.NativeTesting
import java.io.File
import java.nio.ByteBuffer

/** The recordings in tests/data. */
internal object Recordings {
    private val data = File(System.getProperty("boxline.data", "../../tests/data"))

    val calibration: ByteArray = File(data, "calibration_set/calibration.json").readBytes()

    fun folder(name: String): File = File(data, name)

    fun frame(name: String, frame: String): ByteBuffer = direct(File(folder(name), "$frame.jpg").readBytes())

    /** Both faces of a box, each with the lasers off too. */
    fun pictures(name: String): List<Picture> = listOf("a", "b").map { Picture(frame(name, it), frame(name, "${it}_off")) }
}

internal fun direct(bytes: ByteArray): ByteBuffer =
    ByteBuffer.allocateDirect(bytes.size).apply {
        put(bytes)
        flip()
    }

/** Waits for what another thread does; native clean-up goes on behind `close`. */
internal fun eventually(what: String, condition: () -> Boolean) {
    val end = System.nanoTime() + 20_000_000_000
    while (!condition()) {
        if (System.nanoTime() > end) throw AssertionError("not within 20 s: $what")
        Thread.sleep(10)
    }
}

internal fun nothingIsLeftOpen(): Unit =
    eventually("all handles closed, ${NativeTesting.openHandles()} are open") { NativeTesting.openHandles() == 0 }
