package dev.boxline

import dev.boxline.internal.Wire
import org.junit.Assert.assertEquals
import org.junit.Assert.assertThrows
import org.junit.Test
import java.util.Random

class WireTest {
    @Test
    fun `fields of every kind are read, unknown ones do not matter`() {
        // 1: 300, 2: "ab", 3: {1: 1.5}, 3: {1: -2.0}, 15: four bytes
        val bytes = byteArrayOf(0x08, 0xAC.toByte(), 2, 0x12, 2, 97, 98, 0x1A, 9, 9) + double(1.5) +
            byteArrayOf(0x1A, 9, 9) + double(-2.0) + byteArrayOf(0x7D, 1, 0, 0, 0)
        val wire = Wire.read(bytes)
        assertEquals(300L, wire.number(1))
        assertEquals("ab", wire.text(2))
        assertEquals(listOf(1.5, -2.0), wire.messages(3).map { it.double(1) })
        assertEquals(0L, wire.number(9))
    }

    @Test
    fun `broken bytes are exceptions, never a hang or a wild read`() {
        for (bytes in listOf(byteArrayOf(0x12, 5, 1), byteArrayOf(0x08), byteArrayOf(0x0B), ByteArray(11) { -1 })) {
            assertThrows(RuntimeException::class.java) { Wire.read(bytes) }
        }
        val random = Random(7)
        repeat(2000) { runCatching { Wire.read(ByteArray(40).also(random::nextBytes)) } }
    }

    private fun double(value: Double) =
        ByteArray(8) { (java.lang.Double.doubleToLongBits(value) ushr 8 * it).toByte() }
}
