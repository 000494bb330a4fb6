package dev.boxline.sample

import android.content.res.Resources
import dev.boxline.BoxSize
import dev.boxline.Connection
import dev.boxline.DeviceCause
import dev.boxline.FaceView
import dev.boxline.Length
import dev.boxline.MeasureResult
import dev.boxline.Move
import dev.boxline.Radians
import dev.boxline.Reason
import dev.boxline.ScannerState
import dev.boxline.Warning
import java.text.NumberFormat
import kotlin.math.abs
import kotlin.math.max

/** The library's states and results in the user's language. */
internal class Words(private val resources: Resources) {
    private val locale = resources.configuration.locales[0]

    fun of(state: ScannerState): String {
        val view = state.view
        return when (val connection = state.connection) {
            Connection.None, Connection.Closed -> resources.getString(R.string.plug_in)
            is Connection.Ready -> resources.getString(R.string.ready, connection.serial)
            is Connection.Unavailable -> of(connection.deviceCause, connection.message)
            is Connection.Live -> when {
                view is FaceView.Measurable && state.captured == 1 && view.steady -> resources.getString(R.string.second_face, 1)
                view is FaceView.Measurable -> resources.getString(R.string.hold_still)
                view is FaceView.Unmeasurable -> of(view.reason)
                else -> resources.getString(R.string.aim)
            }
        }
    }

    fun of(result: MeasureResult): String = when (result) {
        is MeasureResult.Measured -> of(result.size, result.warnings)
        is MeasureResult.Ambiguous -> resources.getString(R.string.choose)
        is MeasureResult.Rejected -> {
            val third = if (result.thirdFaceHelps) "\n→ " + resources.getString(R.string.third_face) else ""
            refused(result.face) + "\n" + of(result.reason) + third
        }
        is MeasureResult.DeviceUnavailable -> of(result.deviceCause, result.message)
    }

    /** Sides, the intervals that hold the truth in 95 of 100 measurements, volume, and what looked odd. */
    fun of(size: BoxSize, warnings: List<Warning>): String {
        val sides = resources.getString(
            R.string.size,
            number(size.length.value.value, 1), number(size.width.value.value, 1), number(size.height.value.value, 1),
            interval(size.length), interval(size.width), interval(size.height), number(size.volume.value.value, 4),
        )
        val words = resources.getStringArray(R.array.warnings)
        return sides + warnings.map { words[it.kind.ordinal] }.distinct().joinToString("") { "\n⚠ $it" }
    }

    fun short(size: BoxSize): String =
        listOf(size.length, size.width, size.height).joinToString(" × ") { number(it.value.value, 0) } + " mm"

    fun of(cause: DeviceCause, message: String): String = when (cause) {
        DeviceCause.LOST -> resources.getString(R.string.lost)
        DeviceCause.PERMISSION -> resources.getString(R.string.allow_usb)
        DeviceCause.NOT_A_HEAD -> resources.getString(R.string.not_a_head)
        else -> resources.getString(R.string.device_failed, message)
    }

    private fun refused(face: Int?) =
        if (face == null) resources.getString(R.string.refused) else resources.getString(R.string.refused_face, face + 1)

    private fun of(reason: Reason): String =
        resources.getStringArray(R.array.reasons)[reason.kind.ordinal] + reason.moves.flatMap(::of).joinToString("") { "\n→ $it" }

    private fun of(move: Move): List<String> = when (move) {
        is Move.Closer -> listOf(move.by?.let { resources.getString(R.string.closer_by, centimetres(it.value)) } ?: resources.getString(R.string.closer))
        is Move.Farther -> listOf(move.by?.let { resources.getString(R.string.farther_by, centimetres(it.value)) } ?: resources.getString(R.string.farther))
        is Move.Roll -> angle(move.clockwise, R.string.roll_clockwise, R.string.roll_anticlockwise)
        is Move.Aim -> angle(move.right, R.string.aim_right, R.string.aim_left) + angle(move.down, R.string.aim_down, R.string.aim_up)
        is Move.LookStraighter -> angle(move.by, R.string.straighter, R.string.straighter)
    }

    /** Nothing below one degree: nobody aims so well. */
    private fun angle(angle: Radians, positive: Int, negative: Int): List<String> {
        val degrees = number(abs(angle.degrees), 0)
        return if (degrees == number(0.0, 0)) emptyList() else listOf(resources.getString(if (angle.value > 0) positive else negative, degrees))
    }

    private fun centimetres(mm: Double) = number(max(mm / 10, 1.0), 0)

    private fun interval(length: Length) = number(length.low95.value, 1) + "–" + number(length.high95.value, 1)

    private fun number(value: Double, digits: Int): String = NumberFormat.getNumberInstance(locale).run {
        minimumFractionDigits = digits
        maximumFractionDigits = digits
        isGroupingUsed = false
        format(value)
    }
}
