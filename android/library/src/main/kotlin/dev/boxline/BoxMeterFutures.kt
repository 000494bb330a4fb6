package dev.boxline

import kotlinx.coroutines.CoroutineScope
import kotlinx.coroutines.Dispatchers
import kotlinx.coroutines.SupervisorJob
import kotlinx.coroutines.cancel
import kotlinx.coroutines.future.future
import java.nio.ByteBuffer
import java.util.concurrent.CompletableFuture

/**
 * The functions of [BoxMeter] that wait, for callers without coroutines, Java among them. Cancelling a future ends its native work.
 * Futures complete on a thread of the library; closing this closes the meter.
 *
 * All else is called on the meter itself: `startLive`, `dropCaptured`, `capturedJpeg`, `showPreview`. There is no listener: the newest
 * state is `getState().getValue()`. There is no opener that asks the user for a head either: ask with Android's `UsbManager`, then
 * [BoxMeter.openHead] on a thread that may block.
 */
public class BoxMeterFutures(private val meter: BoxMeter) : AutoCloseable {
    private val scope = CoroutineScope(SupervisorJob() + Dispatchers.Default)

    /** As [BoxMeter.measureBox]. */
    public fun measureBox(frameA: ByteBuffer, frameB: ByteBuffer): CompletableFuture<MeasureResult> =
        scope.future { meter.measureBox(frameA, frameB) }

    /** As [BoxMeter.measureBox] with three pictures. */
    public fun measureBox(frameA: ByteBuffer, frameB: ByteBuffer, frameC: ByteBuffer): CompletableFuture<MeasureResult> =
        scope.future { meter.measureBox(frameA, frameB, frameC) }

    /** As [BoxMeter.measureBox] with the lasers off too. */
    public fun measureBox(pictures: List<Picture>): CompletableFuture<MeasureResult> = scope.future { meter.measureBox(pictures) }

    /** As [BoxMeter.view]. */
    public fun view(frame: ByteBuffer): CompletableFuture<FaceView> = scope.future { meter.view(frame) }

    /** As [BoxMeter.stopLive]. */
    public fun stopLive(): CompletableFuture<Void?> = scope.future {
        meter.stopLive()
        null
    }

    /** As [BoxMeter.captureFace]. */
    public fun captureFace(): CompletableFuture<FaceResult> = scope.future { meter.captureFace() }

    /** As [BoxMeter.measure]. */
    public fun measure(): CompletableFuture<MeasureResult> = scope.future { meter.measure() }

    /** As [BoxMeter.measureLive]. */
    public fun measureLive(): CompletableFuture<MeasureResult> = scope.future { meter.measureLive() }

    override fun close() {
        scope.cancel()
        meter.close()
    }
}
