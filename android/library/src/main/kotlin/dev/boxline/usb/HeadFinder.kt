package dev.boxline.usb

import android.Manifest
import android.annotation.SuppressLint
import android.app.PendingIntent
import android.content.BroadcastReceiver
import android.content.Context
import android.content.Intent
import android.content.IntentFilter
import android.content.pm.PackageManager
import android.hardware.usb.UsbConstants
import android.hardware.usb.UsbDevice
import android.hardware.usb.UsbManager
import android.os.Build
import dev.boxline.BoxMeter
import dev.boxline.DeviceCause
import dev.boxline.DeviceException
import dev.boxline.internal.openHeadUnlessCancelled
import kotlinx.coroutines.channels.awaitClose
import kotlinx.coroutines.flow.Flow
import kotlinx.coroutines.flow.callbackFlow
import kotlinx.coroutines.suspendCancellableCoroutine
import kotlin.coroutines.resume

/** A camera on the port that was plugged in or pulled out. Whether it is a head is known when it is opened. */
public sealed interface HeadEvent {
    /** It is there; it may need permission still. */
    public class Attached internal constructor(public val device: UsbDevice) : HeadEvent

    /** It is gone. An open [BoxMeter] has noticed by itself. */
    public class Detached internal constructor(public val device: UsbDevice) : HeadEvent
}

/** Finds heads on the phone's USB port, asks the user for them, opens them. May be used from any thread. */
public class HeadFinder(context: Context) {
    private val context = context.applicationContext
    private val usb = context.getSystemService(Context.USB_SERVICE) as UsbManager?

    /** Cameras on the port. Whether one is a head is known when it is opened. */
    public fun cameras(): List<UsbDevice> = usb?.deviceList?.values.orEmpty().filter(::isCamera)

    /**
     * Whether the app may use the camera. Ask for it *before* [open]: without it Android from version 9 on refuses a USB camera without asking
     * the user. Some phones with Android 10 refuse it even so; there is nothing to do then but to tell the user.
     */
    public fun hasCameraPermission(): Boolean =
        context.checkSelfPermission(Manifest.permission.CAMERA) == PackageManager.PERMISSION_GRANTED

    /** Cameras that come and go, from now on. */
    public fun events(): Flow<HeadEvent> = callbackFlow {
        val receiver = receiver { intent ->
            val device = device(intent)?.takeIf(::isCamera) ?: return@receiver
            val attached = intent.action == UsbManager.ACTION_USB_DEVICE_ATTACHED
            trySend(if (attached) HeadEvent.Attached(device) else HeadEvent.Detached(device))
        }
        // These come from the system alone.
        register(receiver, UsbManager.ACTION_USB_DEVICE_ATTACHED, UsbManager.ACTION_USB_DEVICE_DETACHED)
        awaitClose { context.unregisterReceiver(receiver) }
    }

    /**
     * Asks the user for a camera, opens it, and reads the head's calibration unless [calibrationJson] has it. Without a [device] each
     * camera is tried until one is a head; the user is asked for each. Suspends while the user decides. Cancelled, it leaves nothing open.
     *
     * @throws DeviceException if no head was opened, with [DeviceCause.LOST] if there is no camera, [DeviceCause.PERMISSION] if the user said
     *   no or the app lacks the camera permission, [DeviceCause.NOT_A_HEAD] if there are other cameras only
     * @throws dev.boxline.ScannerConfigException if the head has no calibration, or the network does not load
     */
    public suspend fun open(device: UsbDevice? = null, calibrationJson: ByteArray? = null): BoxMeter {
        val manager = usb ?: throw DeviceException(DeviceCause.LOST, "this phone has no USB host")
        val cameras = if (device == null) cameras() else listOf(device)
        if (cameras.isEmpty()) throw DeviceException(DeviceCause.LOST, "no USB camera is plugged in")
        if (!hasCameraPermission()) {
            throw DeviceException(DeviceCause.PERMISSION, "the app lacks the camera permission, which a USB camera needs too")
        }
        val failures = ArrayList<DeviceException>()
        for (camera in cameras) {
            try {
                return open(manager, camera, calibrationJson)
            } catch (e: DeviceException) {
                failures += e
            }
        }
        // Of a head and a webcam the head's failure is the one to tell.
        throw failures.find { it.deviceCause != DeviceCause.NOT_A_HEAD } ?: failures.first()
    }

    private suspend fun open(manager: UsbManager, camera: UsbDevice, calibrationJson: ByteArray?): BoxMeter {
        if (!manager.hasPermission(camera) && !ask(manager, camera)) {
            throw DeviceException(DeviceCause.PERMISSION, "the user did not allow the USB camera")
        }
        val connection = manager.openDevice(camera)
            ?: throw DeviceException(DeviceCause.BUSY, "the system does not open the USB camera")
        // The connection stays referenced, so open, until the native side has let go of the head.
        return openHeadUnlessCancelled(connection.fileDescriptor, calibrationJson, connection::close)
    }

    private suspend fun ask(manager: UsbManager, camera: UsbDevice): Boolean = suspendCancellableCoroutine { continuation ->
        lateinit var answer: BroadcastReceiver
        answer = receiver { intent ->
            context.unregisterReceiver(answer)
            // Some phones leave the extra out; the manager knows.
            val granted = intent.getBooleanExtra(UsbManager.EXTRA_PERMISSION_GRANTED, false) || manager.hasPermission(camera)
            if (continuation.isActive) continuation.resume(granted)
        }
        register(answer, PERMISSION)
        continuation.invokeOnCancellation { runCatching { context.unregisterReceiver(answer) } }
        // The system fills the device and the answer in, so it must be mutable; explicit, as Android 14 demands.
        val mutable = if (Build.VERSION.SDK_INT >= Build.VERSION_CODES.S) PendingIntent.FLAG_MUTABLE else 0
        val intent = Intent(PERMISSION).setPackage(context.packageName)
        manager.requestPermission(camera, PendingIntent.getBroadcast(context, 0, intent, mutable))
    }

    private fun receiver(body: (Intent) -> Unit) = object : BroadcastReceiver() {
        override fun onReceive(context: Context, intent: Intent) = body(intent)
    }

    @SuppressLint("UnspecifiedRegisterReceiverFlag") // the flag is there from Android 13 on, and given there
    private fun register(receiver: BroadcastReceiver, vararg actions: String) {
        val filter = IntentFilter().apply { actions.forEach(::addAction) }
        if (Build.VERSION.SDK_INT >= Build.VERSION_CODES.TIRAMISU) {
            context.registerReceiver(receiver, filter, Context.RECEIVER_NOT_EXPORTED)
        } else {
            context.registerReceiver(receiver, filter)
        }
    }

    @Suppress("DEPRECATION") // the typed getter came with Android 13
    private fun device(intent: Intent): UsbDevice? = intent.getParcelableExtra(UsbManager.EXTRA_DEVICE)

    private fun isCamera(device: UsbDevice): Boolean =
        (0 until device.interfaceCount).any { device.getInterface(it).interfaceClass == UsbConstants.USB_CLASS_VIDEO }

    private companion object {
        private const val PERMISSION = "dev.boxline.usb.PERMISSION"
    }
}
