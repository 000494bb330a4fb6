package dev.boxline.usb

import android.content.Context
import android.hardware.usb.UsbDeviceConnection
import dev.boxline.BoxMeter
import dev.boxline.internal.openHeadUnlessCancelled

/** A meter with the head on the phone's port; asks the user for it. Exceptions as [HeadFinder.open]. */
public suspend fun BoxMeter.Companion.open(context: Context): BoxMeter = HeadFinder(context).open()

/**
 * A meter with a head that the app has opened itself. The connection is closed with the meter, also if this fails or is
 * cancelled.
 *
 * @throws dev.boxline.DeviceException if the head fails
 * @throws dev.boxline.ScannerConfigException if it has no calibration
 */
public suspend fun BoxMeter.Companion.open(connection: UsbDeviceConnection): BoxMeter =
    openHeadUnlessCancelled(connection.fileDescriptor, null, connection::close)
