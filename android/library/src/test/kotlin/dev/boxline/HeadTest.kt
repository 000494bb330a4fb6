package dev.boxline

import android.view.Surface
import dev.boxline.internal.openHeadUnlessCancelled
import dev.boxline.testing.FakeHead
import dev.boxline.testing.Recordings
import dev.boxline.testing.eventually
import dev.boxline.testing.nothingIsLeftOpen
import kotlinx.coroutines.CoroutineScope
import kotlinx.coroutines.Deferred
import kotlinx.coroutines.Dispatchers
import kotlinx.coroutines.async
import kotlinx.coroutines.cancel
import kotlinx.coroutines.flow.first
import kotlinx.coroutines.launch
import kotlinx.coroutines.runBlocking
import kotlinx.coroutines.withTimeout
import org.junit.After
import org.junit.Assert.assertEquals
import org.junit.Assert.assertThrows
import org.junit.Assert.assertTrue
import org.junit.Assume.assumeTrue
import org.junit.Before
import org.junit.Test
import java.io.File
import java.util.concurrent.atomic.AtomicInteger

/** A head over the real libusb; only the kernel behind it is made of software. */
class HeadTest {
    private val closed = AtomicInteger()

    @Before
    fun plugged() {
        assumeTrue("SKIPPED HeadTest: this JVM has no fake head", FakeHead.isThere)
        FakeHead.show(0)
    }

    @After
    fun nothingLeft() {
        if (!FakeHead.isThere) return
        nothingIsLeftOpen()
        assertEquals("interfaces that are held", 0, FakeHead.claims())
        assertEquals("lasers that are lit", 0, FakeHead.lasers())
    }

    private fun open(how: Int = 0) = BoxMeter.openHead(FakeHead.plug(how)) { closed.incrementAndGet() }

    private fun <T> limited(body: suspend CoroutineScope.() -> T): T = runBlocking { withTimeout(60_000) { body() } }

    @Test
    fun `both faces are captured by hand and measured`(): Unit = limited {
        open().use { meter ->
            assertEquals(Connection.Ready("SIM-0001"), meter.state.value.connection)
            meter.startLive()
            meter.state.first { it.view is FaceView.Measurable }
            assertEquals(15, FakeHead.lasers())
            assertEquals(1, (meter.captureFace() as FaceResult.Captured).number)
            FakeHead.show(FakeHead.NOTHING)
            assertEquals(Reason.Kind.NO_BOX, ((captureDark(meter)) as FaceResult.Rejected).reason.kind)
            FakeHead.show(1)
            meter.state.first { it.view is FaceView.Measurable }
            assertEquals(2, (meter.captureFace() as FaceResult.Captured).number)
            val live = meter.measure() as MeasureResult.Measured
            val recorded = BoxMeter.openRecording(Recordings.folder("b02")).use { it.measure() as MeasureResult.Measured }
            assertEquals(recorded.size, live.size)
            meter.dropCaptured()
            assertEquals(0, meter.state.value.captured)
            meter.stopLive()
            assertEquals(0, FakeHead.lasers())
            assertEquals(Connection.Ready("SIM-0001"), meter.state.value.connection)
        }
        eventually("the connection is closed") { closed.get() == 1 }
    }

    @Test
    fun `what the head sees is drawn into a window, if there is one`(): Unit = limited {
        // Where the tests stand in for Android, the window is a file.
        val shown = System.getProperty("boxline.preview")?.let(::File)
        open().use { meter ->
            assertEquals(shown != null, meter.showPreview(object : Surface() {}))
            meter.startLive()
            meter.state.first { it.view is FaceView.Measurable }
            if (shown != null) {
                eventually("a preview is drawn") { shown.length() > 648 * 486 * 3 }
                val header = shown.inputStream().use { String(ByteArray(14).also(it::read), Charsets.US_ASCII) }
                assertEquals("P6 648 486 255", header)
            }
            assertEquals(false, meter.showPreview(null))
        }
    }

    /** The first frames after the change may still show the face. */
    private suspend fun captureDark(meter: BoxMeter): FaceResult {
        meter.state.first { it.view is FaceView.Unmeasurable }
        return meter.captureFace()
    }

    @Test
    fun `held still, faces are captured by themselves, the second after a move`(): Unit = limited {
        open().use { meter ->
            meter.startLive(autoCapture = true)
            meter.state.first { it.captured == 1 }
            // The same face is not taken twice.
            repeat(3) { meter.state.value.view.let { view -> meter.state.first { it.view !== view } } }
            assertEquals(1, meter.state.value.captured)
            FakeHead.show(1)
            assertTrue(meter.measureLive() is MeasureResult.Measured)
        }
    }

    @Test
    fun `a cable that comes out is a result, and a new head works`(): Unit = limited {
        open().use { meter ->
            meter.startLive()
            meter.state.first { it.view != null }
            val capture = async2 { meter.captureFace() }
            FakeHead.pull(2)
            val end = capture.await()
            assertTrue("$end", end is FaceResult.Captured || (end as FaceResult.DeviceUnavailable).deviceCause == DeviceCause.LOST)
            val state = meter.state.first { it.connection is Connection.Unavailable }.connection as Connection.Unavailable
            assertEquals(DeviceCause.LOST, state.deviceCause)
            assertEquals(DeviceCause.LOST, (meter.measureLive() as MeasureResult.DeviceUnavailable).deviceCause)
        }
        eventually("the connection is closed") { closed.get() == 1 }
        open().use { meter ->
            meter.startLive()
            meter.state.first { it.view is FaceView.Measurable }
        }
    }

    /** A measurement that waits for faces, of which there are none. */
    private suspend fun waiting(meter: BoxMeter): Deferred<Throwable?> {
        FakeHead.show(FakeHead.NOTHING)
        meter.startLive(autoCapture = true)
        val waiting = async2 { runCatching { meter.measureLive() }.exceptionOrNull() }
        meter.state.first { it.view is FaceView.Unmeasurable }
        assertTrue(waiting.isActive)
        return waiting
    }

    @Test
    fun `who waits for faces is told when none can come`(): Unit = limited {
        open().use { meter ->
            val before = runCatching { meter.measureLive() }.exceptionOrNull()
            assertEquals("this BoxMeter is not live: startLive comes first", before?.message)
            assertEquals(before?.message, runCatching { meter.captureFace() }.exceptionOrNull()?.message)
            val stopped = waiting(meter)
            meter.stopLive()
            assertEquals(before?.message, stopped.await()?.message)
            val closed = waiting(meter)
            meter.close()
            assertEquals("BoxMeter is closed", closed.await()?.message)
            assertEquals(ScannerState(Connection.Closed, null, 0), meter.state.value)
        }
    }

    @Test
    fun `a face may be captured at once after the live view was started`(): Unit = limited {
        open().use { meter ->
            repeat(3) {
                meter.startLive()
                assertTrue(meter.captureFace() is FaceResult.Captured)
                meter.stopLive()
            }
        }
    }

    @Test
    fun `a torn frame is passed over, a head that gives no other is told`(): Unit = limited {
        open().use { meter ->
            meter.startLive()
            meter.state.first { it.view is FaceView.Measurable }
            FakeHead.show(FakeHead.TORN)
            eventually("a torn frame comes") { runCatching { runBlocking { meter.captureFace() } }.exceptionOrNull() is InvalidFrameException }
            FakeHead.show(FakeHead.NOTHING)
            meter.state.first { it.view is FaceView.Unmeasurable }
            FakeHead.show(FakeHead.TORN)
            val end = meter.measureLive() as MeasureResult.DeviceUnavailable
            assertEquals(DeviceCause.PROTOCOL, end.deviceCause)
            assertTrue(end.message, end.message.startsWith("no frame is whole: "))
        }
    }

    @Test
    fun `a calibration of another picture size ends the live view, and measureLive says so`(): Unit = limited {
        val other = Recordings.calibration.decodeToString().replace("2592", "1296").encodeToByteArray()
        BoxMeter.openHead(FakeHead.plug(0), other).use { meter ->
            meter.startLive(autoCapture = true)
            repeat(2) {
                val e = runCatching { meter.measureLive() }.exceptionOrNull()
                assertTrue("$e", e is ScannerConfigException)
            }
            assertEquals(Connection.Ready("SIM-0001"), meter.state.value.connection)
            assertEquals(0, FakeHead.lasers())
        }
    }

    @Test
    fun `of two possible boxes a third face tells which it is`(): Unit = limited {
        open().use { meter ->
            meter.startLive()
            assertTrue(meter.captureFace() is FaceResult.Captured)
            meter.stopLive()
            FakeHead.show(2)
            meter.startLive()
            assertTrue(meter.captureFace() is FaceResult.Captured)
            assertTrue(meter.measureLive() is MeasureResult.Ambiguous)
            meter.stopLive()
            FakeHead.show(1)
            meter.startLive(autoCapture = true)
            assertTrue(meter.measureLive() is MeasureResult.Measured)
            assertEquals(3, meter.state.value.captured)
            BoxMeterFutures(meter).stopLive().get()
            assertEquals(0, FakeHead.lasers())
        }
    }

    @Test
    fun `who cancels opening leaves nothing open`(): Unit = limited {
        var meter: BoxMeter? = null
        launch {
            cancel()
            meter = openHeadUnlessCancelled(FakeHead.plug(0), null) { closed.incrementAndGet() }
        }.join()
        assertEquals(null, meter)
        eventually("the connection is closed") { closed.get() == 1 }
    }

    private fun <T> async2(body: suspend () -> T) = CoroutineScope(Dispatchers.Default).async { body() }

    @Test
    fun `a head without a calibration, or with another head's, is told when it is opened`() {
        assertThrows(ScannerConfigException::class.java) { open(FakeHead.EMPTY_STORE) }
        val e = assertThrows(ScannerConfigException::class.java) { open(FakeHead.OTHER_SERIAL) }
        assertTrue(e.message!!, e.message!!.contains("OTHER-0001"))
        assertEquals(2, closed.get())
        BoxMeter.openHead(FakeHead.plug(FakeHead.EMPTY_STORE), Recordings.calibration).use { meter ->
            limited {
                meter.startLive()
                meter.state.first { it.view != null }
            }
        }
    }

    @Test
    fun `50 rounds of opening, streaming and closing`() {
        val fd = FakeHead.plug(0)
        repeat(50) { round ->
            BoxMeter.openHead(fd) { closed.incrementAndGet() }.use { meter ->
                if (round % 5 == 0) {
                    limited {
                        meter.startLive()
                        meter.state.first { it.view != null }
                    }
                }
            }
            eventually("round $round is closed") { closed.get() == round + 1 }
        }
    }
}
