package dev.boxline.internal

import dev.boxline.BoxMeter
import kotlinx.coroutines.CancellationException
import kotlinx.coroutines.Dispatchers
import kotlinx.coroutines.NonCancellable
import kotlinx.coroutines.currentCoroutineContext
import kotlinx.coroutines.ensureActive
import kotlinx.coroutines.withContext

/**
 * [BoxMeter.openHead] on a thread that may block. It is not left half way: who is cancelled meanwhile has the head opened and closed
 * again, so [onClosed] runs whatever happens.
 */
internal suspend fun openHeadUnlessCancelled(fileDescriptor: Int, calibrationJson: ByteArray?, onClosed: () -> Unit): BoxMeter {
    // Two contexts: one that also changes the thread would drop the meter of a caller that was cancelled.
    val meter = withContext(NonCancellable) { withContext(Dispatchers.IO) { BoxMeter.openHead(fileDescriptor, calibrationJson, onClosed) } }
    try {
        currentCoroutineContext().ensureActive()
    } catch (e: CancellationException) {
        meter.close()
        throw e
    }
    return meter
}
