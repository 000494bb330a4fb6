package dev.boxline

import dev.boxline.testing.Recordings
import dev.boxline.testing.nothingIsLeftOpen
import kotlinx.coroutines.runBlocking
import org.junit.After
import org.junit.Assert.assertEquals
import org.junit.Assert.assertFalse
import org.junit.Assert.assertThrows
import org.junit.Assert.assertTrue
import org.junit.Test
import java.io.File
import kotlin.math.abs

/** A recorded pair through the whole way; what it gives must be what the program `boxline` prints. */
class MeasureTest {
    @After fun nothingLeft() = nothingIsLeftOpen()

    @Test
    fun `a pair gives the numbers of the command line, digit by digit`(): Unit = runBlocking {
        BoxMeter.open(Recordings.calibration).use { meter ->
            val result = meter.measureBox(Recordings.pictures("b02"))
            val size = (result as MeasureResult.Measured).size
            val json = result.record.toJson()
            println("ROW ${BoxMeter.version()} | ${size.length.value.value} | ${size.width.value.value} | ${size.height.value.value}")
            assertTrue(json, json.contains("${size.length.value.value}"))
            assertTrue(size.length.value >= size.width.value && size.width.value >= size.height.value)
            for (side in listOf(size.length, size.width, size.height)) {
                assertEquals(side.value.value - 1.96 * side.sigma.value, side.low95.value, 1e-9)
                assertEquals(side.value.value + 1.96 * side.sigma.value, side.high95.value, 1e-9)
            }
            val printed = System.getProperty("boxline.json")?.let { File(it).readText().trim() }
            printed?.let { assertSameNumbers(it, json) }
        }
    }

    /** The same to the last digit, or, on another kind of processor, whose sine has another last digit, within `boxline.tolerance`. */
    private fun assertSameNumbers(expected: String, found: String) {
        val tolerance = System.getProperty("boxline.tolerance")?.toDouble() ?: return assertEquals(expected, found)
        assertEquals(expected.replace(number, "#"), found.replace(number, "#"))
        for ((a, b) in number.findAll(expected).zip(number.findAll(found))) {
            assertEquals(a.value.toDouble(), b.value.toDouble(), tolerance * maxOf(1.0, abs(a.value.toDouble())))
        }
    }

    private val number = Regex("-?\\d+\\.\\d+(e-?\\d+)?")

    @Test
    fun `a calibration tells whether it knows how sure it is`() {
        BoxMeter.open(Recordings.calibration).use { assertFalse(it.calibrationHasCovariance) }
        val row = { i: Int -> (0 until 18).joinToString(",", "[", "]") { if (it == i) "1e-9" else "0" } }
        val covariance = (0 until 18).joinToString(",", "[", "]", transform = row)
        val known = Recordings.calibration.decodeToString().trimEnd().removeSuffix("}") + ",\"covariance\":$covariance}"
        BoxMeter.open(known.encodeToByteArray()).use { assertTrue(it.calibrationHasCovariance) }
    }

    @Test
    fun `a recording gives the same as its pictures`(): Unit = runBlocking {
        val byPictures = BoxMeter.open(Recordings.calibration).use { meter ->
            meter.measureBox(Recordings.pictures("b02")) as MeasureResult.Measured
        }
        BoxMeter.openRecording(Recordings.folder("b02")).use { meter ->
            assertEquals(2, meter.state.value.captured)
            val measured = meter.measure() as MeasureResult.Measured
            assertEquals(byPictures.size, measured.size)
            assertEquals(Recordings.frame("b02", "a").remaining(), meter.capturedJpeg(0)?.size)
        }
    }

    @Test
    fun `a picture with the lasers off that shows another face is left out`(): Unit = runBlocking {
        BoxMeter.open(Recordings.calibration).use { meter ->
            val (a, b) = listOf("a", "b").map { Recordings.frame("b02", it) }
            val wrong = meter.measureBox(listOf(Picture(a, Recordings.frame("b02", "b_off")), Picture(b)))
            val without = meter.measureBox(a, b)
            assertEquals((without as MeasureResult.Measured).size, (wrong as MeasureResult.Measured).size)
        }
    }

    @Test
    fun `one picture twice and a face without lasers are refused with the reason`(): Unit = runBlocking {
        BoxMeter.open(Recordings.calibration).use { meter ->
            val twice = assertThrows(InvalidFrameException::class.java) {
                runBlocking { meter.measureBox(Recordings.frame("b02", "a"), Recordings.frame("b02", "a")) }
            }
            assertTrue(twice.message!!, twice.message!!.contains("is the same picture as the first frame"))
            val dark = meter.measureBox(Recordings.frame("b02", "a_off"), Recordings.frame("b02", "b"))
            val reason = (dark as MeasureResult.Rejected).reason
            assertEquals(Reason.Kind.NO_BOX, reason.kind)
            assertTrue(reason.numbers.keys.toString(), "best_share" in reason.numbers)
        }
    }

    @Test
    fun `a refusal says which picture and how to move`(): Unit = runBlocking {
        BoxMeter.open(Recordings.calibration).use { meter ->
            val good = Recordings.frame("b02", "b")
            val cut = meter.measureBox(good, Recordings.frame("refuse", "r2")) as MeasureResult.Rejected
            assertEquals(Reason.Kind.FACE_CUT_BY_BORDER to 1, cut.reason.kind to cut.face)
            assertTrue(cut.reason.toString(), cut.reason.moves.any { it is Move.Farther })
            assertTrue(cut.record.toJson(), cut.record.toJson().contains("\"hint\":{\"text\":\"${cut.reason.movesText}\""))
            val missed = meter.measureBox(Recordings.frame("refuse", "r1"), good) as MeasureResult.Rejected
            assertEquals(Reason.Kind.STRIPE_MISSING to 0, missed.reason.kind to missed.face)
            val view = meter.view(Recordings.frame("refuse", "r1")) as FaceView.Unmeasurable
            assertEquals(missed.reason.moves, view.reason.moves)
            assertTrue(view.reason.toString(), view.reason.moves.isNotEmpty() && view.reason.movesText.isNotEmpty())
            val nothing = meter.view(Recordings.frame("refuse", "r3")) as FaceView.Unmeasurable
            assertEquals(emptyList<Move>(), nothing.reason.moves)
        }
    }

    @Test
    fun `a view says whether the face is measurable`(): Unit = runBlocking {
        BoxMeter.open(Recordings.calibration).use { meter ->
            val view = meter.view(Recordings.frame("b02", "a")) as FaceView.Measurable
            assertEquals(listOf(4, 4), listOf(view.corners.size, view.stripes.size))
            assertTrue(view.corners.all { it.u in 0.0..2592.0 && it.v in 0.0..1944.0 })
            assertTrue(meter.view(Recordings.frame("b02", "a_off")) is FaceView.Unmeasurable)
        }
    }

    @Test
    fun `callers without coroutines get the same`() {
        BoxMeterFutures(BoxMeter.open(Recordings.calibration)).use { futures ->
            val result = futures.measureBox(Recordings.frame("b02", "a"), Recordings.frame("b02", "b")).get()
            assertTrue(result is MeasureResult.Measured)
        }
    }
}
