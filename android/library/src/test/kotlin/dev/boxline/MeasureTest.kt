package dev.boxline

import dev.boxline.testing.Recordings
import dev.boxline.testing.nothingIsLeftOpen
import kotlinx.coroutines.runBlocking
import org.junit.After
import org.junit.Assert.assertEquals
import org.junit.Assert.assertTrue
import org.junit.Test
import java.io.File

/** A recorded pair through the whole way; what it gives must be what the program `boxline` prints. */
class MeasureTest {
    @After fun nothingLeft() = nothingIsLeftOpen()

    @Test
    fun `a pair gives the numbers of the command line, digit by digit`(): Unit = runBlocking {
        BoxMeter.open(Recordings.calibration).use { meter ->
            val result = meter.measureBox(Recordings.frame("b02", "a"), Recordings.frame("b02", "b"))
            val size = (result as MeasureResult.Measured).size
            val json = result.record.toJson()
            println("ROW ${BoxMeter.version()} | ${size.length.value.value} | ${size.width.value.value} | ${size.height.value.value}")
            assertTrue(json, json.contains("${size.length.value.value}"))
            assertTrue(size.length.value >= size.width.value && size.width.value >= size.height.value)
            // The command line adds how to move, which a report does not carry.
            val printed = System.getProperty("boxline.json")?.let { File(it).readText().trim().replace(",\"hint\":null", "") }
            printed?.let { assertEquals(it, json) }
        }
    }

    @Test
    fun `a recording gives the same as its pictures`(): Unit = runBlocking {
        val byPictures = BoxMeter.open(Recordings.calibration).use { meter ->
            meter.measureBox(Recordings.frame("b02", "a"), Recordings.frame("b02", "b")) as MeasureResult.Measured
        }
        BoxMeter.openRecording(Recordings.folder("b02")).use { meter ->
            assertEquals(2, meter.state.value.captured)
            val measured = meter.measure() as MeasureResult.Measured
            assertEquals(byPictures.size, measured.size)
            assertEquals(Recordings.frame("b02", "a").remaining(), meter.capturedJpeg(0)?.size)
        }
    }

    @Test
    fun `two pictures of one face are refused with the reason`(): Unit = runBlocking {
        BoxMeter.open(Recordings.calibration).use { meter ->
            // The same lengths twice: never a wrong box, either two candidates or a refusal.
            val same = meter.measureBox(Recordings.frame("b02", "a"), Recordings.frame("b02", "a"))
            assertTrue("$same", same is MeasureResult.Ambiguous)
            val dark = meter.measureBox(Recordings.frame("b02", "a_off"), Recordings.frame("b02", "b"))
            val reason = (dark as MeasureResult.Rejected).reason
            assertEquals(Reason.Kind.NO_BOX, reason.kind)
            assertTrue(reason.numbers.keys.toString(), "best_share" in reason.numbers)
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
