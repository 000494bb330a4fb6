package dev.boxline.sample

import android.content.res.Resources
import dev.boxline.BoxSize
import dev.boxline.Connection
import dev.boxline.DeviceCause
import dev.boxline.FaceView
import dev.boxline.Length
import dev.boxline.MeasureResult
import dev.boxline.Reason
import dev.boxline.ScannerState
import java.text.NumberFormat

/** The library's states and results in the user's language. */
internal class Words(private val resources: Resources) {
    private val locale = resources.configuration.locales[0]

    fun of(state: ScannerState): String {
        val view = state.view
        return when (val connection = state.connection) {
            Connection.None -> resources.getString(R.string.plug_in)
            is Connection.Ready -> resources.getString(R.string.ready, connection.serial)
            is Connection.Unavailable -> of(connection.cause, connection.message)
            is Connection.Live -> when {
                view is FaceView.Measurable && state.captured == 1 && view.steady -> resources.getString(R.string.second_face, 1)
                view is FaceView.Measurable -> resources.getString(R.string.hold_still)
                view is FaceView.Unmeasurable -> of(view.reason)
                else -> resources.getString(R.string.aim)
            }
        }
    }

    fun of(result: MeasureResult): String = when (result) {
        is MeasureResult.Measured -> of(result.size)
        is MeasureResult.Ambiguous -> resources.getString(R.string.choose)
        is MeasureResult.Rejected -> resources.getString(R.string.refused) + "\n" + of(result.reason)
        is MeasureResult.DeviceUnavailable -> of(result.cause, result.message)
    }

    fun of(size: BoxSize): String = resources.getString(
        R.string.size,
        number(size.length.value.value, 1), number(size.width.value.value, 1), number(size.height.value.value, 1),
        sigma(size.length), sigma(size.width), sigma(size.height), number(size.volume.value.value, 4),
    )

    fun short(size: BoxSize): String =
        listOf(size.length, size.width, size.height).joinToString(" × ") { number(it.value.value, 0) } + " mm"

    fun of(cause: DeviceCause, message: String): String = when (cause) {
        DeviceCause.LOST -> resources.getString(R.string.lost)
        DeviceCause.PERMISSION -> resources.getString(R.string.allow_usb)
        DeviceCause.NOT_A_HEAD -> resources.getString(R.string.not_a_head)
        else -> resources.getString(R.string.device_failed, message)
    }

    private fun of(reason: Reason): String = resources.getStringArray(R.array.reasons)[reason.kind.ordinal]

    private fun sigma(length: Length) = number(length.sigma.value, 2)

    private fun number(value: Double, digits: Int): String = NumberFormat.getNumberInstance(locale).run {
        minimumFractionDigits = digits
        maximumFractionDigits = digits
        isGroupingUsed = false
        format(value)
    }
}
