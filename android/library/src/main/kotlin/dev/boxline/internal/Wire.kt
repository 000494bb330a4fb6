package dev.boxline.internal

import java.nio.ByteBuffer
import java.nio.ByteOrder

/**
 * One protobuf message, read field by field (protobuf.dev, "Encoding"): numbers, doubles, bytes and messages, which is all that
 * proto/boxline.proto has. A protobuf library would be a second dependency, and larger than this product.
 */
internal class Wire private constructor(private val fields: Map<Int, List<Any>>) {
    /** The last value of a varint field; 0 if there is none. */
    fun number(field: Int): Long = fields[field]?.last() as Long? ?: 0

    /** The last value of a double field; 0 if there is none. */
    fun double(field: Int): Double = doubleOrNull(field) ?: 0.0

    fun doubleOrNull(field: Int): Double? = fields[field]?.last() as Double?

    fun text(field: Int): String = (fields[field]?.last() as ByteBuffer?)?.let { String(bytes(it), Charsets.UTF_8) } ?: ""

    fun message(field: Int): Wire? = fields[field]?.last()?.let { read(it as ByteBuffer) }

    fun messages(field: Int): List<Wire> = fields[field].orEmpty().map { read(it as ByteBuffer) }

    companion object {
        private const val VARINT = 0
        private const val EIGHT_BYTES = 1
        private const val BYTES = 2
        private const val FOUR_BYTES = 5

        fun read(message: ByteArray): Wire = read(ByteBuffer.wrap(message))

        private fun read(message: ByteBuffer): Wire {
            val fields = HashMap<Int, MutableList<Any>>()
            val rest = message.duplicate().order(ByteOrder.LITTLE_ENDIAN)
            while (rest.hasRemaining()) {
                val tag = varint(rest)
                val value: Any = when (val type = (tag and 7).toInt()) {
                    VARINT -> varint(rest)
                    EIGHT_BYTES -> rest.getDouble()
                    BYTES -> {
                        val length = varint(rest)
                        require(length in 0..rest.remaining()) { "$length bytes in a field, ${rest.remaining()} are left" }
                        val end = rest.position() + length.toInt()
                        val part = rest.duplicate()
                        part.limit(end)
                        rest.position(end)
                        part
                    }
                    FOUR_BYTES -> rest.getInt().toLong()
                    else -> throw IllegalArgumentException("wire type $type is not known")
                }
                fields.getOrPut((tag ushr 3).toInt()) { ArrayList() } += value
            }
            return Wire(fields)
        }

        private fun varint(from: ByteBuffer): Long {
            var value = 0L
            for (shift in 0 until 64 step 7) {
                val byte = from.get().toLong()
                value = value or ((byte and 0x7F) shl shift)
                if (byte >= 0) return value
            }
            throw IllegalArgumentException("a number of more than 64 bits")
        }

        private fun bytes(buffer: ByteBuffer): ByteArray = ByteArray(buffer.remaining()).also { buffer.duplicate().get(it) }
    }
}
