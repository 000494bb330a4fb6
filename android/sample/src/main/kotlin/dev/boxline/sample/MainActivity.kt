package dev.boxline.sample

import android.Manifest
import android.app.Activity
import android.content.Intent
import android.content.pm.PackageManager
import android.os.Bundle
import android.view.SurfaceHolder
import android.view.SurfaceView
import android.view.View
import android.widget.Button
import android.widget.TextView
import dev.boxline.BoxMeter
import dev.boxline.Connection
import dev.boxline.DeviceException
import dev.boxline.FaceView
import dev.boxline.MeasureResult
import dev.boxline.NativeBugException
import dev.boxline.ScannerConfigException
import dev.boxline.ScannerState
import dev.boxline.intent.Dimensioning
import dev.boxline.usb.HeadEvent
import dev.boxline.usb.HeadFinder
import kotlinx.coroutines.CoroutineScope
import kotlinx.coroutines.Job
import kotlinx.coroutines.MainScope
import kotlinx.coroutines.cancel
import kotlinx.coroutines.flow.takeWhile
import kotlinx.coroutines.launch
import kotlinx.coroutines.sync.Mutex
import kotlinx.coroutines.sync.withLock

/** The one screen: shows what the library says. Also serves [Dimensioning.ACTION] for other apps. */
public class MainActivity : Activity() {
    private lateinit var finder: HeadFinder
    private lateinit var words: Words
    private var scope: CoroutineScope = MainScope()
    private var meter: BoxMeter? = null
    private var job: Job? = null
    private val oneAtATime = Mutex()
    private var shown: MeasureResult? = null

    override fun onCreate(savedInstanceState: Bundle?) {
        super.onCreate(savedInstanceState)
        setContentView(R.layout.main)
        finder = HeadFinder(this)
        words = Words(resources)
        view<Button>(R.id.again).setOnClickListener { measure() }
        view<Button>(R.id.share).setOnClickListener { share() }
        view<SurfaceView>(R.id.preview).holder.addCallback(object : SurfaceHolder.Callback {
            override fun surfaceCreated(holder: SurfaceHolder) = Unit

            override fun surfaceChanged(holder: SurfaceHolder, format: Int, width: Int, height: Int) {
                meter?.showPreview(holder.surface)
            }

            override fun surfaceDestroyed(holder: SurfaceHolder) {
                meter?.showPreview(null)
            }
        })
    }

    override fun onStart() {
        super.onStart()
        scope = MainScope()
        scope.launch { finder.events().collect { if (it is HeadEvent.Attached) start() } }
        start()
    }

    override fun onStop() {
        scope.cancel()
        meter?.close()
        meter = null
        super.onStop()
    }

    override fun onRequestPermissionsResult(code: Int, permissions: Array<String>, results: IntArray) {
        val granted = results.firstOrNull() == PackageManager.PERMISSION_GRANTED
        if (granted) start() else view<TextView>(R.id.status).setText(R.string.allow_camera)
    }

    private fun start() {
        if (!finder.hasCameraPermission()) {
            requestPermissions(arrayOf(Manifest.permission.CAMERA), 1)
            return
        }
        if (finder.cameras().isEmpty()) {
            view<TextView>(R.id.status).setText(R.string.plug_in)
            return
        }
        instead {
            meter?.close()
            meter = null
            val opened = finder.open()
            meter = opened
            opened.showPreview(view<SurfaceView>(R.id.preview).holder.surface)
            scope.launch { opened.state.takeWhile { it.connection != Connection.Closed }.collect(::show) }
            round(opened)
        }
    }

    private fun measure() {
        val connection = meter?.state?.value?.connection
        val meter = meter.takeIf { connection is Connection.Ready || connection is Connection.Live } ?: return start()
        instead { round(meter) }
    }

    private suspend fun round(meter: BoxMeter) {
        show(null)
        meter.dropCaptured()
        meter.startLive(autoCapture = true)
        var result = meter.measureLive()
        if (result is MeasureResult.Rejected && result.thirdFaceHelps) {
            view<TextView>(R.id.result).text = words.of(result)
            result = meter.measureLive()
        }
        meter.stopLive()
        show(result)
    }

    /** Opening and rounds, one at a time: the one before is cancelled, and has ended before the next begins. */
    private fun instead(body: suspend () -> Unit) {
        job?.cancel()
        job = scope.launch {
            oneAtATime.withLock {
                try {
                    body()
                } catch (e: DeviceException) {
                    view<TextView>(R.id.status).text = words.of(e.deviceCause, e.message.orEmpty())
                } catch (e: ScannerConfigException) {
                    view<TextView>(R.id.status).text = getString(R.string.config, e.message)
                } catch (e: NativeBugException) {
                    meter = null // it has closed itself
                    view<TextView>(R.id.status).text = getString(R.string.device_failed, e.message)
                }
            }
        }
    }

    internal fun show(state: ScannerState) {
        view<TextView>(R.id.status).text = words.of(state)
        view<OverlayView>(R.id.overlay).face = state.view as? FaceView.Measurable
    }

    /** Shows a result; null clears the last one. */
    internal fun show(result: MeasureResult?) {
        shown = result
        view<TextView>(R.id.result).text = result?.let(words::of)
        view<Button>(R.id.share).isEnabled = result.record() != null
        val ambiguous = result as? MeasureResult.Ambiguous
        view<View>(R.id.choice).visibility = if (ambiguous == null) View.GONE else View.VISIBLE
        if (ambiguous != null) {
            for ((id, size) in listOf(R.id.first to ambiguous.first, R.id.second to ambiguous.second)) {
                view<Button>(id).text = words.short(size)
                view<Button>(id).setOnClickListener {
                    view<TextView>(R.id.result).text = words.of(size, ambiguous.warnings)
                    view<View>(R.id.choice).visibility = View.GONE
                    answer { jpeg, now -> Dimensioning.result(intent, size, jpeg, now) }
                }
            }
        } else if (result != null) {
            answer { jpeg, now -> Dimensioning.result(intent, result, jpeg, now) }
        }
    }

    /** Ends with a result if another app asked for one. */
    private fun answer(extras: (jpeg: ByteArray?, timeMillis: Long) -> Intent) {
        if (intent.action != Dimensioning.ACTION) return
        setResult(RESULT_OK, extras(meter?.capturedJpeg(0), System.currentTimeMillis()))
        finish()
    }

    private fun share() {
        val record = shown.record() ?: return
        val send = Intent(Intent.ACTION_SEND).setType("application/json").putExtra(Intent.EXTRA_TEXT, record.toJson())
        startActivity(Intent.createChooser(send, getString(R.string.share)))
    }

    private fun MeasureResult?.record() = when (this) {
        is MeasureResult.Measured -> record
        is MeasureResult.Ambiguous -> record
        is MeasureResult.Rejected -> record
        is MeasureResult.DeviceUnavailable, null -> null
    }

    private fun <T : View> view(id: Int): T = findViewById(id)
}
