package dev.boxline

import dev.boxline.internal.Native
import dev.boxline.internal.NativeTesting
import dev.boxline.testing.Recordings
import dev.boxline.testing.direct
import dev.boxline.testing.nothingIsLeftOpen
import kotlinx.coroutines.CancellationException
import kotlinx.coroutines.Dispatchers
import kotlinx.coroutines.async
import kotlinx.coroutines.awaitAll
import kotlinx.coroutines.cancelAndJoin
import kotlinx.coroutines.delay
import kotlinx.coroutines.launch
import kotlinx.coroutines.runBlocking
import kotlinx.coroutines.withTimeout
import org.junit.After
import org.junit.Assert.assertEquals
import org.junit.Assert.assertThrows
import org.junit.Assert.assertTrue
import org.junit.Test
import java.io.File
import java.nio.ByteBuffer

/** What a caller can do wrong: the typed result each, and a meter that goes on. */
class BadInputTest {
    private val a = Recordings.frame("b02", "a")
    private val b = Recordings.frame("b02", "b")

    @After fun nothingLeft() = nothingIsLeftOpen()

    private inline fun <reified T : Throwable> BoxMeter.fails(frameA: ByteBuffer, frameB: ByteBuffer): T =
        assertThrows(T::class.java) { runBlocking { measureBox(frameA, frameB) } }

    @Test
    fun `empty, cut, noise and heap buffers`(): Unit = BoxMeter.open(Recordings.calibration).use { meter ->
        val half = direct(ByteArray(a.remaining() / 2).also { a.duplicate().get(it) })
        for (broken in listOf(ByteBuffer.allocateDirect(0), half, direct("not a picture".toByteArray()))) {
            assertTrue(meter.fails<InvalidFrameException>(broken, b).message!!.startsWith("frameA: "))
            assertTrue(meter.fails<InvalidFrameException>(a, broken).message!!.startsWith("frameB: "))
        }
        assertTrue(meter.fails<IllegalArgumentException>(ByteBuffer.wrap(ByteArray(9)), b).message!!.contains("not a direct buffer"))
        val nothing: Any? = null
        @Suppress("UNCHECKED_CAST")
        val asJava = Native::class.java.methods.first { it.name == "measureBox" }
        val thrown = assertThrows(java.lang.reflect.InvocationTargetException::class.java) { asJava.invoke(null, 1L, nothing, nothing, nothing, nothing, nothing, nothing, 0L) }
        assertTrue("${thrown.cause}", thrown.cause is NullPointerException || thrown.cause is IllegalStateException)
        assertTrue(runBlocking { meter.measureBox(a, b) } is MeasureResult.Measured)
    }

    @Test
    fun `calibrations that are broken, of another size or of another head`() {
        val text = String(Recordings.calibration)
        for (broken in listOf("", text.take(text.length / 2), text.replace("\"fx\"", "\"gx\""))) {
            assertThrows(ScannerConfigException::class.java) { BoxMeter.open(broken.toByteArray()) }
        }
        BoxMeter.open(text.replace("2592", "1296").toByteArray()).use { meter ->
            assertTrue(meter.fails<ScannerConfigException>(a, b).message!!.contains("2592"))
        }
        val folder = File.createTempFile("boxline", "").apply { delete() }
        try {
            Recordings.folder("b02").copyRecursively(folder)
            File(folder, "calibration.json").writeText(text.replace("SIM-0001", "SIM-0002"))
            val recording = File(folder, "recording.json")
            recording.writeText(recording.readText().replace("../calibration_set/calibration.json", "calibration.json"))
            val e = assertThrows(ScannerConfigException::class.java) { BoxMeter.openRecording(folder) }
            assertTrue(e.message!!, e.message!!.contains("SIM-0002"))
            assertThrows(ScannerConfigException::class.java) { BoxMeter.openRecording(File(folder, "nowhere")) }
        } finally {
            folder.deleteRecursively()
        }
    }

    @Test
    fun `use after close, close twice, close during a call`(): Unit = runBlocking {
        val meter = BoxMeter.open(Recordings.calibration)
        val running = async(Dispatchers.Default) { runCatching { meter.measureBox(a, b) } }
        delay(30)
        meter.close()
        meter.close()
        val end = running.await()
        assertTrue("$end", end.isSuccess || end.exceptionOrNull() is IllegalStateException)
        val all = listOf<suspend () -> Any?>(
            { meter.measureBox(a, b) }, { meter.view(a) }, { meter.startLive() }, { meter.stopLive() }, { meter.captureFace() }, { meter.measure() },
            { meter.measureLive() }, { meter.dropCaptured() }, { meter.capturedJpeg(0) }, { meter.showPreview(null) },
        )
        for (use in all) {
            val e = runCatching { use() }.exceptionOrNull()
            assertTrue("$e", e is IllegalStateException)
            assertEquals("BoxMeter is closed", e?.message)
        }
        assertEquals(ScannerState(Connection.Closed, null, 0), meter.state.value)
    }

    @Test
    fun `calls from many threads wait for each other`(): Unit = runBlocking {
        BoxMeter.open(Recordings.calibration).use { meter ->
            val sizes = List(4) {
                async(Dispatchers.Default) { (meter.measureBox(a.duplicate(), b.duplicate()) as MeasureResult.Measured).size }
            }.awaitAll()
            assertEquals(1, sizes.toSet().size)
        }
    }

    @Test
    fun `a cancelled measurement ends soon and the meter goes on`(): Unit = runBlocking {
        BoxMeter.open(Recordings.calibration).use { meter ->
            repeat(3) { round ->
                var end: Throwable? = null
                val job = launch(Dispatchers.Default) {
                    try {
                        while (true) meter.measureBox(a, b)
                    } catch (e: CancellationException) {
                        end = e
                        throw e
                    }
                }
                delay(20L + 60 * round)
                withTimeout(5000) { job.cancelAndJoin() }
                assertTrue("$end", end is CancellationException)
            }
            assertTrue(meter.measureBox(a, b) is MeasureResult.Measured)
        }
        val futures = BoxMeterFutures(BoxMeter.open(Recordings.calibration))
        futures.use { assertTrue(it.measureBox(a, b).cancel(true)) }
    }

    @Test
    fun `a panic is an exception with its whole text, and native code lives on`() {
        for (text in listOf("frame 7 of 9: µ, 箱", "")) {
            val e = assertThrows(NativeBugException::class.java) { NativeTesting.panicWith(text) }
            assertEquals("panic in native code: " + text.ifEmpty { "a fixed text" }, e.message)
        }
        assertEquals(1, NativeTesting.echo(ByteArray(1)).size)
    }

    @Test
    fun `what hinders the start is told by each opener, and the next one works`() {
        var closed = 0
        val openers = listOf<() -> Any?>(
            { BoxMeter.open(Recordings.calibration) }, { BoxMeter.openRecording(Recordings.folder("b02")) }, { BoxMeter.openHead(0) { closed++ } },
            { BoxMeter.version() },
        )
        System.setProperty("boxline.threads", "65")
        try {
            for (open in openers) {
                val e = assertThrows(IllegalArgumentException::class.java) { open() }
                assertEquals("threads 65: 0 to 64 are allowed", e.message)
            }
        } finally {
            System.clearProperty("boxline.threads")
        }
        assertEquals(1, closed)
        BoxMeter.open(Recordings.calibration).close()
    }

    @Test
    fun `50 rounds of opening and closing leave nothing`() {
        repeat(50) { BoxMeter.open(Recordings.calibration).close() }
        nothingIsLeftOpen()
        val threads = Thread.getAllStackTraces().keys.count { it.name.startsWith("boxline") }
        assertTrue("$threads threads", threads < 10)
    }

    @Test
    fun `a meter without a head says so`(): Unit = runBlocking {
        BoxMeter.open(Recordings.calibration).use { meter ->
            assertEquals(Connection.None, meter.state.value.connection)
            assertThrows(IllegalStateException::class.java) { meter.startLive() }
            assertTrue(runCatching { meter.captureFace() }.exceptionOrNull() is IllegalStateException)
            assertTrue(runCatching { meter.measure() }.exceptionOrNull()!!.message!!.contains("two captured faces"))
            assertEquals("this BoxMeter has no head", runCatching { meter.measureLive() }.exceptionOrNull()?.message)
            meter.stopLive()
            assertEquals(false, meter.showPreview(object : android.view.Surface() {}))
            val view = assertThrows(IllegalArgumentException::class.java) { meter.showPreview("a view") }
            assertEquals("an android.view.Surface is needed, this is a java.lang.String", view.message)
        }
        for (fd in listOf(-1, 99_999)) {
            var closed = 0
            val e = runCatching { BoxMeter.openHead(fd) { closed++ } }.exceptionOrNull()
            assertTrue("$e", e is DeviceException || e is IllegalArgumentException)
            assertEquals(1, closed)
        }
    }
}
