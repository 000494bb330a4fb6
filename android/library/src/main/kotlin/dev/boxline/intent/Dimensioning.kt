package dev.boxline.intent

import android.content.Intent
import android.graphics.Bitmap
import android.graphics.BitmapFactory
import dev.boxline.BoxSize
import dev.boxline.Length
import dev.boxline.MeasureResult
import java.io.ByteArrayOutputStream
import java.util.Locale

/**
 * Measuring by intent, for apps that do not link this library: start an activity for result with [ACTION]; its result has the extras
 * below. An activity that serves it ends with `setResult(RESULT_OK, Dimensioning.result(...))`.
 *
 * | Extra | Type | |
 * |---|---|---|
 * | [LENGTH], [WIDTH], [HEIGHT] | double | in [UNIT]; only if [STATUS] is `MEASURED`; length >= width >= height |
 * | `..._SIGMA` | double | standard deviation of each, in the same unit |
 * | [UNIT] | String | `MM`, `CM` or `INCH`: as the request asks, else `MM` |
 * | [TIMESTAMP] | String | UTC, ISO 8601 |
 * | [STATUS] | String | `MEASURED`, `AMBIGUOUS`, `REJECTED`, `DEVICE_UNAVAILABLE` |
 * | [MESSAGE] | String | why not, for people |
 * | [IMAGE] | byte[] | a small JPEG of the first face, if there is one |
 */
public object Dimensioning {
    public const val ACTION: String = "dev.boxline.action.MEASURE"
    public const val LENGTH: String = "LENGTH"
    public const val WIDTH: String = "WIDTH"
    public const val HEIGHT: String = "HEIGHT"
    public const val SIGMA_SUFFIX: String = "_SIGMA"
    public const val UNIT: String = "DIMENSIONING_UNIT"
    public const val TIMESTAMP: String = "TIMESTAMP"
    public const val STATUS: String = "STATUS"
    public const val MESSAGE: String = "MESSAGE"
    public const val IMAGE: String = "IMAGE"

    private val perMillimetre = mapOf("MM" to 1.0, "CM" to 0.1, "INCH" to 1 / 25.4)

    /**
     * Result extras for a [request]; [jpeg] is a picture as the head sent it, [timeMillis] when, milliseconds since 1970. Blocks while the
     * picture is made small.
     */
    public fun result(request: Intent?, result: MeasureResult, jpeg: ByteArray?, timeMillis: Long): Intent = when (result) {
        is MeasureResult.Measured -> result(request, result.size, jpeg, timeMillis)
        is MeasureResult.Ambiguous -> without(request, "AMBIGUOUS", "two boxes are possible", jpeg, timeMillis)
        is MeasureResult.Rejected -> without(request, "REJECTED", result.reason.text, jpeg, timeMillis)
        is MeasureResult.DeviceUnavailable -> without(request, "DEVICE_UNAVAILABLE", result.message, jpeg, timeMillis)
    }

    /** The same for the box that the user chose of two possible ones. */
    public fun result(request: Intent?, size: BoxSize, jpeg: ByteArray?, timeMillis: Long): Intent {
        val intent = common(request, jpeg, timeMillis).putExtra(STATUS, "MEASURED")
        put(intent, size, perMillimetre.getValue(unit(request)))
        return intent
    }

    private fun without(request: Intent?, status: String, message: String, jpeg: ByteArray?, timeMillis: Long): Intent =
        common(request, jpeg, timeMillis).putExtra(STATUS, status).putExtra(MESSAGE, message)

    private fun common(request: Intent?, jpeg: ByteArray?, timeMillis: Long): Intent {
        val intent = Intent().putExtra(UNIT, unit(request)).putExtra(TIMESTAMP, timestamp(timeMillis))
        jpeg?.let(::small)?.let { intent.putExtra(IMAGE, it) }
        return intent
    }

    private fun unit(request: Intent?): String =
        request?.getStringExtra(UNIT)?.uppercase(Locale.ROOT)?.takeIf(perMillimetre::containsKey) ?: "MM"

    private fun put(intent: Intent, size: BoxSize, scale: Double) {
        val put = { name: String, length: Length ->
            intent.putExtra(name, length.value.value * scale)
            intent.putExtra(name + SIGMA_SUFFIX, length.sigma.value * scale)
        }
        put(LENGTH, size.length)
        put(WIDTH, size.width)
        put(HEIGHT, size.height)
    }

    private fun timestamp(millis: Long): String {
        val format = java.text.SimpleDateFormat("yyyy-MM-dd'T'HH:mm:ss.SSS'Z'", Locale.ROOT)
        format.timeZone = java.util.TimeZone.getTimeZone("UTC")
        return format.format(java.util.Date(millis))
    }

    /** A quarter of the size: what passes between apps may have 1 MB at the most. */
    private fun small(jpeg: ByteArray): ByteArray? {
        val options = BitmapFactory.Options().apply { inSampleSize = 4 }
        val bitmap = BitmapFactory.decodeByteArray(jpeg, 0, jpeg.size, options) ?: return null
        return ByteArrayOutputStream().also { bitmap.compress(Bitmap.CompressFormat.JPEG, 80, it) }.toByteArray()
    }
}
