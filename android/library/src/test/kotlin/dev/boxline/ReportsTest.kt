package dev.boxline

import dev.boxline.internal.liveView
import dev.boxline.internal.measureResult
import org.junit.Assert.assertEquals
import org.junit.Assert.assertFalse
import org.junit.Assert.assertNull
import org.junit.Assert.assertTrue
import org.junit.Test
import java.nio.ByteBuffer
import java.nio.ByteOrder

/** Messages of proto/boxline.proto that recorded pictures do not give, written here by hand. */
class ReportsTest {
    private fun field(number: Int, bytes: ByteArray): ByteArray =
        byteArrayOf((number shl 3 or 2).toByte()) + varint(bytes.size) + bytes

    private fun field(number: Int, text: String) = field(number, text.toByteArray())

    private fun field(number: Int, value: Double): ByteArray =
        byteArrayOf((number shl 3 or 1).toByte()) + ByteBuffer.allocate(8).order(ByteOrder.LITTLE_ENDIAN).putDouble(value).array()

    private fun field(number: Int, value: Int): ByteArray = byteArrayOf((number shl 3).toByte()) + varint(value)

    private fun varint(value: Int): ByteArray =
        if (value < 0x80) byteArrayOf(value.toByte()) else byteArrayOf((value and 0x7F or 0x80).toByte()) + varint(value ushr 7)

    private fun number(name: String, value: Double) = field(2, field(1, name) + field(2, value))

    private fun estimate(value: Double) = (0..3).fold(ByteArray(0)) { all, i -> all + field(i + 1, value + i) }

    private val sides = field(1, estimate(500.0)) + field(2, estimate(400.0)) + field(3, estimate(300.0)) + field(4, estimate(0.06))

    private val enclosing = field(1, estimate(502.0)) + field(2, estimate(401.0)) + field(3, estimate(300.5)) + field(4, estimate(0.061))

    private fun warning(kind: String) = field(1, kind) + number("sagitta_mm", -2.5) + field(3, "odd")

    @Test
    fun `warnings of both faces and of the pair are told with their face`() {
        val good = field(2, 1)
        val report = field(1, 1) + field(2, sides) + field(11, enclosing) + field(5, good + field(11, warning("face_not_flat"))) +
            field(5, good + field(11, warning("laser_moved")) + field(11, warning("side_bowed"))) + field(8, 0.97) + field(6, warning("sides_differ")) + field(6, warning("of tomorrow"))
        val measured = measureResult(report) as MeasureResult.Measured
        val kinds = listOf(Warning.Kind.FACE_NOT_FLAT, Warning.Kind.LASER_MOVED, Warning.Kind.SIDE_BOWED, Warning.Kind.SIDES_DIFFER, Warning.Kind.OTHER)
        assertEquals(kinds, measured.warnings.map { it.kind })
        assertEquals(0.97, measured.confidence)
        assertEquals(listOf(502.0, 401.0, 300.5), measured.enclosing.run { listOf(length, width, height) }.map { it.value.value })
        assertEquals(listOf(0, 1, 1, null, null), measured.warnings.map { it.face })
        assertEquals(mapOf("sagitta_mm" to -2.5), measured.warnings[0].numbers)
        assertEquals(Length(Millimetres(500.0), Millimetres(501.0), Millimetres(502.0), Millimetres(503.0)), measured.size.length)
    }

    @Test
    fun `every move is known, one of tomorrow is left out`() {
        val moves = listOf(
            "closer" to ByteArray(0), "closer" to number("by_mm", 50.0), "farther" to number("by_mm", 70.0), "jump" to ByteArray(0),
            "roll" to number("clockwise_rad", -0.5), "aim" to number("right_rad", 0.1) + number("down_rad", 0.2),
            "look_straighter" to number("by_rad", 0.3),
        )
        val hint = moves.fold(ByteArray(0)) { all, (kind, numbers) -> all + field(1, field(1, kind) + numbers) } + field(2, "move so")
        val reject = field(1, "outline_unsure") + field(3, "unclear")
        val face = field(2, 3) + field(9, reject) + field(13, hint)
        val expected = listOf(
            Move.Closer(null), Move.Closer(Millimetres(50.0)), Move.Farther(Millimetres(70.0)), Move.Roll(Radians(-0.5)),
            Move.Aim(Radians(0.1), Radians(0.2)), Move.LookStraighter(Radians(0.3)),
        )
        val (view, frame) = liveView(field(1, face) + field(3, 7))
        assertEquals(expected, (view as FaceView.Unmeasurable).reason.moves)
        assertEquals("outline_unsure: unclear; move so", view.reason.toString())
        assertEquals(7L, frame)
        val result = measureResult(field(1, 3) + field(4, reject) + field(5, field(2, 1)) + field(5, face)) as MeasureResult.Rejected
        assertEquals(expected, result.reason.moves)
        assertEquals(1, result.face)
    }

    @Test
    fun `a refusal names the boxes that are likely, and that a third face helps`() {
        val candidate = field(1, sides) + field(2, 0.5)
        val faces = field(5, field(2, 1)) + field(5, field(2, 1))
        val reject = field(4, field(1, "outline_unsure"))
        val result = measureResult(field(1, 3) + reject + faces + field(9, candidate) + field(10, 1)) as MeasureResult.Rejected
        assertTrue(result.thirdFaceHelps)
        assertEquals(0.5, result.likeliest.single().confidence, 0.0)
        assertNull(result.face)
        // Of three pictures one is refused, and the others do not fit together: none is to blame.
        val three = measureResult(field(1, 3) + reject + faces + field(5, field(2, 3) + field(9, field(1, "no_box")))) as MeasureResult.Rejected
        assertNull(three.face)
        assertFalse(three.thirdFaceHelps)
    }

    @Test
    fun `a report without a probability has no confidence`() {
        val measured = measureResult(field(1, 1) + field(2, sides) + field(11, enclosing) + field(5, field(2, 1)) + field(5, field(2, 1))) as MeasureResult.Measured
        assertNull(measured.confidence)
    }

    @Test
    fun `two faces that do not fit together name no face and no move`() {
        val report = field(1, 3) + field(4, field(1, "sides_disagree")) + field(5, field(2, 1)) + field(5, field(2, 1))
        val result = measureResult(report) as MeasureResult.Rejected
        assertEquals(Reason.Kind.SIDES_DISAGREE, result.reason.kind)
        assertNull(result.face)
        assertTrue(result.reason.moves.isEmpty())
    }
}
