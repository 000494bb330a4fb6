package dev.boxline.internal

import kotlinx.coroutines.suspendCancellableCoroutine
import java.util.concurrent.Executors
import java.util.concurrent.RejectedExecutionException
import kotlin.coroutines.resumeWithException

/** A sign that ends native calls; closed by the call that it was made for. */
internal class StopSign : AutoCloseable {
    private var handle = Native.newStop()

    fun handle(): Long = synchronized(this) { handle }

    /** Does nothing once it is closed: then there is no call to end. */
    fun set(): Unit = synchronized(this) { if (handle != 0L) Native.setStop(handle) }

    override fun close(): Unit = synchronized(this) {
        if (handle != 0L) Native.closeStop(handle)
        handle = 0
    }
}

/** A thread for native calls that block; one call after the other. Cancelling a coroutine that waits ends its call. */
internal class CallThread(private val name: String) : AutoCloseable {
    private val thread = Executors.newSingleThreadExecutor { Thread(it, name).apply { isDaemon = true } }
    private val running = HashSet<StopSign>()

    suspend fun <T> call(body: (stop: Long) -> T): T = suspendCancellableCoroutine { continuation ->
        val stop = StopSign()
        synchronized(running) { running += stop }
        continuation.invokeOnCancellation { stop.set() }
        try {
            thread.execute {
                val result = runCatching { body(stop.handle()) }
                synchronized(running) { running -= stop }
                stop.close()
                result.fold(
                    { value -> continuation.resume(value) { _, unused, _ -> (unused as? AutoCloseable)?.close() } },
                    continuation::resumeWithException,
                )
            }
        } catch (closed: RejectedExecutionException) {
            synchronized(running) { running -= stop }
            stop.close()
            throw IllegalStateException("BoxMeter is closed", closed)
        }
    }

    /** Ends running calls and takes no new ones. [last] runs on the thread, after them. */
    fun close(last: () -> Unit) {
        synchronized(running) { running.forEach(StopSign::set) }
        try {
            thread.execute(last)
        } catch (_: RejectedExecutionException) {
            return // closed before
        }
        thread.shutdown()
    }

    override fun close(): Unit = close {}
}

/** A frame that was captured, kept by the native library until it is closed. */
internal class CapturedFrame(handle: Long) : AutoCloseable {
    val handle: Long = handle

    override fun close(): Unit = Native.closeFrame(handle)
}
