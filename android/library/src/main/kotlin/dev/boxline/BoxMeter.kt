package dev.boxline

import dev.boxline.internal.CallThread
import dev.boxline.internal.CapturedFrame
import dev.boxline.internal.Native
import dev.boxline.internal.liveView
import dev.boxline.internal.measureResult
import kotlinx.coroutines.CancellationException
import kotlinx.coroutines.CoroutineName
import kotlinx.coroutines.CoroutineScope
import kotlinx.coroutines.Deferred
import kotlinx.coroutines.Dispatchers
import kotlinx.coroutines.Job
import kotlinx.coroutines.SupervisorJob
import kotlinx.coroutines.async
import kotlinx.coroutines.cancel
import kotlinx.coroutines.flow.MutableStateFlow
import kotlinx.coroutines.flow.StateFlow
import kotlinx.coroutines.flow.asStateFlow
import kotlinx.coroutines.flow.first
import kotlinx.coroutines.flow.update
import kotlinx.coroutines.launch
import java.io.File
import java.nio.ByteBuffer

/**
 * Measures boxes: from pictures, from a recording, or live with a head.
 *
 * All functions may be called from any thread, the main thread too: they do not block it, but for those that say so and the first that
 * opens a meter in a process, which loads the network. Native work runs on two threads of this object's own, one for measurements, one
 * for what the head sees; several calls at once wait for each other. Cancelling a coroutine ends its native work within some hundred
 * milliseconds. After [close] every function but [close] throws [IllegalStateException], and so do those that wait; the same after a
 * [NativeBugException], which closes the meter.
 *
 * Open one with [open], [openRecording] or, on Android, `BoxMeter.open(context)` of the package `dev.boxline.usb`.
 */
public class BoxMeter private constructor(
    private val calibration: Long,
    private val head: Long,
    serial: String?,
    frames: List<CapturedFrame>,
    private val onClosed: () -> Unit,
) : AutoCloseable {
    private val measuring = CallThread("boxline measure")
    private val looking = CallThread("boxline look")
    private val scope = CoroutineScope(SupervisorJob() + Dispatchers.Default + CoroutineName("boxline"))
    private val captured = ArrayDeque(frames)
    private val ready = if (serial == null) Connection.None else Connection.Ready(serial)
    private val serial = serial.orEmpty()
    private val mutableState = MutableStateFlow(ScannerState(ready, null, frames.size))
    private var live: Job? = null

    /** Lasers and stream of the live view are on, or why not. */
    @Volatile private var streaming: Deferred<Unit>? = null

    @Volatile private var closed = false

    /** What ended the live view, unless it was the head. */
    @Volatile private var failure: RuntimeException? = null

    /** Faces to capture before a measurement: three once two have left open what the box is. */
    @Volatile private var wanted = 2

    /**
     * Whether the calibration says how sure it is. If not, as in heads whose calibration was stored before heads kept that, every sigma lacks
     * the calibration's part; `boxline head calibration write` stores it.
     */
    public val calibrationHasCovariance: Boolean = Native.hasCovariance(calibration)

    /** What the meter is doing; always the newest value, from the thread that looks. */
    public val state: StateFlow<ScannerState> = mutableState.asStateFlow()

    /**
     * Measures a box from two pictures of adjacent faces. Each buffer is direct and holds one JPEG of the head's camera from position to
     * limit; both stay unchanged and must not be written to meanwhile.
     *
     * @throws InvalidFrameException if a buffer holds no whole JPEG
     * @throws ScannerConfigException if the pictures have another size than the calibration's
     */
    public suspend fun measureBox(frameA: ByteBuffer, frameB: ByteBuffer): MeasureResult =
        measureBox(listOf(Picture(frameA), Picture(frameB)))

    /**
     * The same from pictures of three adjacent faces, in which every side is seen twice: it measures boxes that two pictures leave open
     * ([MeasureResult.Rejected.thirdFaceHelps], [MeasureResult.Ambiguous]). A third picture that cannot be measured does no harm.
     */
    public suspend fun measureBox(frameA: ByteBuffer, frameB: ByteBuffer, frameC: ByteBuffer): MeasureResult =
        measureBox(listOf(Picture(frameA), Picture(frameB), Picture(frameC)))

    /**
     * The same from two or three pictures, each with the same view with the lasers off if there is one: more boxes are measured then, since
     * no print is taken for a stripe. One that does not fit its picture is left out. [captureFace] takes both by itself.
     */
    public suspend fun measureBox(pictures: List<Picture>): MeasureResult = result {
        require(pictures.size in 2..3) { "two or three pictures are needed, there are ${pictures.size}" }
        val (a, b) = pictures
        val c = pictures.getOrNull(2)
        val report = measuring.call { stop -> Native.measureBox(calibration, a.lit, b.lit, c?.lit, a.off, b.off, c?.off, stop) }
        measureResult(report)
    }

    /** Whether a face could be measured in this picture, and if not, why. Exceptions as [measureBox]. */
    public suspend fun view(frame: ByteBuffer): FaceView = guarded {
        liveView(measuring.call { stop -> Native.viewFrame(calibration, frame, stop) }).first
    }

    /**
     * Lights the lasers, starts the stream and keeps [state] up to date until [stopLive]. With [autoCapture] a face is captured by
     * itself as soon as it can be measured and the head is held still; the next one only after the head has moved.
     *
     * @throws IllegalStateException if this meter has no head
     */
    public fun startLive(autoCapture: Boolean = false) {
        synchronized(this) {
            checkOpen()
            check(head != 0L) { "this BoxMeter has no head" }
            live?.cancel()
            failure = null
            show { it.copy(connection = Connection.Live(serial)) }
            val started = scope.async { looking.call { Native.startStream(head) } }
            streaming = started
            live = scope.launch { look(started, autoCapture) }
        }
    }

    /** Lasers and stream off; captured faces stay. Does nothing if they are off. */
    public suspend fun stopLive(): Unit = guarded {
        val looked = synchronized(this) { live.also { live = null } }
        looked?.cancel()
        looked?.join()
        if (looked != null) dark()
    }

    /**
     * Captures the face in view and keeps it if it can be measured; of four captured faces the first is dropped. Needs [startLive].
     *
     * @throws InvalidFrameException if the frame was torn on its way: capture again
     * @throws ScannerConfigException if the calibration is of another head or picture size
     * @throws IllegalStateException if this meter has no head or is not live
     */
    public suspend fun captureFace(): FaceResult = try {
        guarded {
            val connection = state.value.connection
            if (connection is Connection.None || connection is Connection.Ready) throw notLive()
            streaming?.await()
            capture()
        }
    } catch (e: DeviceException) {
        unavailable(e)
        FaceResult.DeviceUnavailable(e.deviceCause, e.message.orEmpty())
    }

    /**
     * Measures the box from the two or three captured faces, or from those of the recording. They stay until [dropCaptured]: after
     * [MeasureResult.Rejected.thirdFaceHelps] or [MeasureResult.Ambiguous] capture a third face and measure again.
     *
     * @throws IllegalStateException if fewer than two faces are captured
     */
    public suspend fun measure(): MeasureResult = result {
        val faces = synchronized(captured) { captured.map(CapturedFrame::handle) }
        check(faces.size >= 2) { "two captured faces are needed, there are ${faces.size}" }
        measureResult(measuring.call { stop -> Native.measureFrames(calibration, faces.toLongArray(), stop) }).also {
            if (it is MeasureResult.Ambiguous || it is MeasureResult.Rejected && it.thirdFaceHelps) wanted = 3
        }
    }

    /**
     * Waits until [startLive] with `autoCapture` has captured two faces, then measures them. Called again after
     * [MeasureResult.Rejected.thirdFaceHelps] or [MeasureResult.Ambiguous] it waits for a third.
     *
     * @throws ScannerConfigException if the calibration is of another head or picture size
     * @throws NativeBugException if native code failed while this waited
     * @throws IllegalStateException if too few faces are captured and the meter is not live: [startLive] was not called, or [stopLive] or
     *   [close] was while this waited
     */
    public suspend fun measureLive(): MeasureResult {
        checkOpen()
        val end = state.first { it.captured >= wanted || it.connection !is Connection.Live }
        val connection = end.connection
        return when {
            end.captured >= wanted -> measure()
            connection is Connection.Unavailable -> MeasureResult.DeviceUnavailable(connection.deviceCause, connection.message)
            else -> throw notLive()
        }
    }

    /** Forgets captured faces, to start anew. */
    public fun dropCaptured() {
        checkOpen()
        val dropped = synchronized(captured) { captured.toList().also { captured.clear() } }
        dropped.forEach(CapturedFrame::close)
        wanted = 2
        show { it.copy(captured = 0) }
    }

    /** The JPEG of captured face 0, 1 or 2, as the head sent it; null if there is none. */
    public fun capturedJpeg(index: Int): ByteArray? {
        checkOpen()
        return synchronized(captured) { captured.getOrNull(index)?.let { Native.frameJpeg(it.handle) } }
    }

    /**
     * Draws what the head sees into an `android.view.Surface`, until null is given; false if that cannot be done. Native code draws: no
     * pixel passes through the virtual machine. Android only. Blocks while a frame is drawn.
     *
     * @throws IllegalArgumentException if it is something else, such as a `SurfaceView`, whose `holder.surface` is meant
     */
    public fun showPreview(surface: Any?): Boolean {
        checkOpen()
        // By name: this part of the library knows no Android. Native code takes what it is given for a surface.
        val classes = generateSequence<Class<*>>(surface?.javaClass) { it.superclass }
        require(surface == null || classes.any { it.name == "android.view.Surface" }) {
            "an android.view.Surface is needed, this is a ${surface?.javaClass?.name}"
        }
        return head != 0L && Native.showPreview(head, surface)
    }

    /**
     * Ends running calls, switches lasers and stream off, lets go of the head. Does not block: native clean-up, at most some seconds
     * with a silent head, goes on behind it. Closing twice does nothing.
     */
    override fun close() {
        synchronized(this) {
            if (closed) return
            closed = true
        }
        scope.cancel()
        measuring.close()
        looking.close {
            if (head != 0L) Native.closeHead(head)
            Native.closeCalibration(calibration)
            synchronized(captured) { captured.toList().also { captured.clear() } }.forEach(CapturedFrame::close)
            onClosed()
        }
        mutableState.value = ScannerState(Connection.Closed, null, 0)
    }

    /** A meter that nobody closed holds the head and native memory: closed here, late, and told in the log. */
    @Suppress("unused", "ProtectedInFinal")
    protected fun finalize() {
        if (!closed) {
            Native.log(2, "a BoxMeter was not closed")
            close()
        }
    }

    private suspend fun look(started: Deferred<Unit>, autoCapture: Boolean) {
        try {
            started.await()
            watch(autoCapture)
        } catch (e: CancellationException) {
            throw e
        } catch (e: DeviceException) {
            unavailable(e)
        } catch (e: NativeBugException) {
            failure = e
            close()
        } catch (e: RuntimeException) {
            if (closed) return
            failure = e
            try {
                dark()
            } catch (_: IllegalStateException) {
                return // closed meanwhile: lasers and stream are off
            }
        }
    }

    /** Follows what the head sees until something fails. */
    private suspend fun watch(autoCapture: Boolean) {
        var after = 0L
        var moved = true
        var whole = System.nanoTime()
        while (true) {
            try {
                val (view, frame) = liveView(looking.call { stop -> Native.liveView(head, calibration, after, stop) })
                after = frame
                whole = System.nanoTime()
                show { it.copy(view = view) }
                val steady = view is FaceView.Measurable && view.steady
                if (autoCapture && steady && moved && state.value.captured < wanted) {
                    moved = capture() !is FaceResult.Captured
                } else if (!steady) {
                    moved = true
                }
            } catch (e: InvalidFrameException) {
                // Torn on its way: the next one may be whole, this one is not looked at again.
                after++
                if (System.nanoTime() - whole > TORN_LIMIT_NANOS) throw DeviceException(DeviceCause.PROTOCOL, "no frame is whole: ${e.message}")
            }
        }
    }

    /** Lasers and stream off. */
    private suspend fun dark() {
        looking.call { Native.stopStream(head) }
        show { if (it.connection is Connection.Live) it.copy(connection = ready, view = null) else it }
    }

    private suspend fun capture(): FaceResult {
        val frame = looking.call { stop -> CapturedFrame(Native.captureFrame(head, stop)) }
        val view = try {
            liveView(measuring.call { stop -> Native.viewCaptured(calibration, frame.handle, stop) }).first
        } catch (e: Throwable) {
            frame.close()
            throw e
        }
        if (view is FaceView.Unmeasurable) frame.close()
        return when (view) {
            is FaceView.Unmeasurable -> FaceResult.Rejected(view.reason)
            is FaceView.Measurable -> FaceResult.Captured(view, keep(frame))
        }
    }

    private fun keep(frame: CapturedFrame): Int {
        val number = synchronized(captured) {
            if (closed) frame.close() else captured += frame
            if (captured.size > 3) captured.removeFirst().close()
            captured.size
        }
        show { it.copy(captured = number) }
        return number
    }

    private fun unavailable(e: DeviceException) {
        show { it.copy(connection = Connection.Unavailable(e.deviceCause, e.message.orEmpty()), view = null) }
    }

    /** A closed meter stays closed, whatever comes late. */
    private fun show(change: (ScannerState) -> ScannerState) {
        mutableState.update { if (it.connection == Connection.Closed) it else change(it) }
    }

    private fun checkOpen() {
        if (closed) throw closed(failure as? NativeBugException)
    }

    private fun closed(cause: Throwable?) = IllegalStateException("BoxMeter is closed", cause)

    /** Why a function that needs the live view cannot go on. */
    private fun notLive(): RuntimeException = failure ?: when {
        closed -> closed(null)
        head == 0L -> IllegalStateException("this BoxMeter has no head")
        else -> IllegalStateException("this BoxMeter is not live: startLive comes first")
    }

    private suspend fun result(body: suspend () -> MeasureResult): MeasureResult = try {
        guarded(body)
    } catch (e: DeviceException) {
        unavailable(e)
        MeasureResult.DeviceUnavailable(e.deviceCause, e.message.orEmpty())
    }

    private suspend fun <T> guarded(body: suspend () -> T): T {
        checkOpen()
        try {
            return body()
        } catch (e: NativeBugException) {
            close()
            throw e
        } catch (e: CancellationException) {
            // The native call was ended by close(), not by whoever waits for it.
            if (closed) throw closed(e)
            throw e
        }
    }

    public companion object {
        /** A head that gives no whole frame for so long is treated like one that gives none. */
        private const val TORN_LIMIT_NANOS = 3_000_000_000L

        /**
         * What this library is, for reports of bugs. Loads the network, as the first opener does.
         *
         * @throws ScannerConfigException if the network does not load
         */
        @JvmStatic
        public fun version(): String {
            Native.load()
            return Native.version()
        }

        /**
         * A meter for pictures, with the bytes of a `calibration.json`.
         *
         * @throws ScannerConfigException if it is broken, or the network does not load
         */
        @JvmStatic
        public fun open(calibrationJson: ByteArray): BoxMeter {
            Native.load()
            return BoxMeter(Native.openCalibration(calibrationJson), 0, null, emptyList()) {}
        }

        /**
         * A meter for the first two pictures of a recording's folder: [measure] measures them. Blocks while their files are read.
         *
         * @throws ScannerConfigException if the recording or its calibration is broken, or they are of two heads, or the network does not load
         */
        @JvmStatic
        public fun openRecording(folder: File): BoxMeter {
            Native.load()
            val (calibration, a, b) = Native.openRecording(folder.path)
            return BoxMeter(calibration, 0, null, listOf(CapturedFrame(a), CapturedFrame(b))) {}
        }

        /**
         * A meter with a head, from the file descriptor of an open USB device, such as `UsbDeviceConnection` has. The descriptor is
         * duplicated. [onClosed] runs after the head has been let go, on a thread of the meter: close the connection there. It also
         * runs if opening fails, whatever the failure. Blocks for up to some seconds while the head is asked for its calibration, unless
         * [calibrationJson] has it; one of another head is told by [measureLive] and [captureFace].
         *
         * @throws DeviceException if the head fails
         * @throws ScannerConfigException if the head has no calibration, or it is broken or of another head, or the network does not load
         */
        @JvmStatic
        @JvmOverloads
        public fun openHead(fileDescriptor: Int, calibrationJson: ByteArray? = null, onClosed: () -> Unit = {}): BoxMeter {
            var head = 0L
            var calibration = 0L
            try {
                Native.load()
                head = Native.openHead(fileDescriptor)
                calibration = calibrationJson?.let(Native::openCalibration) ?: Native.openHeadCalibration(head)
                return BoxMeter(calibration, head, Native.headSerial(head), emptyList(), onClosed)
            } catch (e: Throwable) {
                if (calibration != 0L) Native.closeCalibration(calibration)
                if (head != 0L) Native.closeHead(head)
                onClosed()
                throw e
            }
        }
    }
}
