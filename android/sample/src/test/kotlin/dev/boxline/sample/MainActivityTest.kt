package dev.boxline.sample

import android.Manifest
import android.content.Intent
import android.graphics.Bitmap
import android.graphics.BitmapFactory
import android.graphics.Canvas
import android.graphics.drawable.BitmapDrawable
import android.view.View
import android.widget.Button
import android.widget.TextView
import dev.boxline.BoxMeter
import dev.boxline.BoxSize
import dev.boxline.Connection
import dev.boxline.CubicMetres
import dev.boxline.DeviceCause
import dev.boxline.FaceView
import dev.boxline.Length
import dev.boxline.MeasureResult
import dev.boxline.Millimetres
import dev.boxline.Move
import dev.boxline.Radians
import dev.boxline.Reason
import dev.boxline.Record
import dev.boxline.ScannerState
import dev.boxline.SensorPoint
import dev.boxline.Volume
import dev.boxline.Warning
import dev.boxline.intent.Dimensioning
import kotlinx.coroutines.runBlocking
import org.junit.Assert.assertEquals
import org.junit.Assert.assertFalse
import org.junit.Assert.assertTrue
import org.junit.Assume.assumeTrue
import org.junit.Test
import org.junit.runner.RunWith
import org.robolectric.Robolectric
import org.robolectric.RobolectricTestRunner
import org.robolectric.RuntimeEnvironment
import org.robolectric.Shadows.shadowOf
import org.robolectric.annotation.Config
import org.robolectric.annotation.GraphicsMode
import java.io.File
import java.nio.ByteBuffer

/** The screen in its states, drawn by Android's own code; pictures go to the folder `boxline.screens`, to be looked at. */
@RunWith(RobolectricTestRunner::class)
@GraphicsMode(GraphicsMode.Mode.NATIVE)
@Config(sdk = [35], qualifiers = "w411dp-h731dp-mdpi")
class MainActivityTest {
    private fun length(mm: Double) = Length(Millimetres(mm), Millimetres(0.4), Millimetres(mm - 0.8), Millimetres(mm + 0.8))

    private fun size(a: Double, b: Double, c: Double): BoxSize {
        val m3 = a * b * c * 1e-9
        return BoxSize(length(a), length(b), length(c), Volume(CubicMetres(m3), CubicMetres(1e-4), CubicMetres(m3 - 2e-4), CubicMetres(m3 + 2e-4)))
    }

    private val record = Record(ByteArray(0))
    private val bulge = Warning("face_not_flat", 0, emptyMap(), "")
    private val measured = MeasureResult.Measured(size(550.41, 349.78, 300.09), size(551.0, 350.2, 300.4), 0.99, listOf(bulge, Warning("face_not_flat", 1, emptyMap(), "")), record)
    private val moves = listOf(Move.Farther(Millimetres(234.0)), Move.Aim(Radians(-0.1), Radians(0.001)))
    private val cut = Reason("face_cut_by_border", emptyMap(), "", moves, "")
    private val ambiguous = MeasureResult.Ambiguous(size(400.0, 400.0, 250.0), size(400.0, 250.0, 250.0), 0.99, emptyList(), record)
    private val square = listOf(500.0 to 400.0, 2100.0 to 500.0, 2000.0 to 1500.0, 450.0 to 1400.0).map { (u, v) -> SensorPoint(u, v) }
    private val face = FaceView.Measurable(length(400.0), length(300.0), square, listOf(square[0] to square[2], square[1] to square[3]), true, 0.99, emptyList())

    private fun screen(name: String, intent: Intent = Intent(), body: (MainActivity) -> Unit) {
        shadowOf(RuntimeEnvironment.getApplication()).grantPermissions(Manifest.permission.CAMERA)
        Robolectric.buildActivity(MainActivity::class.java, intent).setup().use { controller ->
            val activity = controller.get()
            body(activity)
            shadowOf(android.os.Looper.getMainLooper()).idle()
            val root = activity.window.decorView
            val bitmap = Bitmap.createBitmap(root.width, root.height, Bitmap.Config.ARGB_8888)
            root.draw(Canvas(bitmap))
            val folder = File(System.getProperty("boxline.screens", "build/screens")).apply { mkdirs() }
            File(folder, "$name.png").outputStream().use { bitmap.compress(Bitmap.CompressFormat.PNG, 100, it) }
        }
    }

    private fun MainActivity.text(id: Int) = findViewById<TextView>(id).text.toString()

    @Test
    fun `without a head it asks for one`() = screen("plug-in") {
        assertEquals("Plug the head in", it.text(R.id.status))
        assertFalse(it.findViewById<Button>(R.id.share).isEnabled)
    }

    /** The whole way: the native library of this machine finds the face in a recorded picture, which stands in for the preview. */
    @Test
    fun `a real face is drawn over its picture`() {
        assumeTrue(System.getProperty("boxline.library") != null)
        val data = File(System.getProperty("boxline.data", "../../tests/data"))
        val jpeg = File(data, "b02/a.jpg").readBytes()
        val buffer = ByteBuffer.allocateDirect(jpeg.size).apply { put(jpeg).flip() }
        val calibration = File(data, "calibration_set/calibration.json").readBytes()
        val view = BoxMeter.open(calibration).use { meter -> runBlocking { meter.view(buffer) } }
        screen("live") {
            val preview = it.findViewById<View>(R.id.preview)
            (preview.parent as View).background = BitmapDrawable(it.resources, BitmapFactory.decodeByteArray(jpeg, 0, jpeg.size))
            preview.visibility = View.GONE
            it.show(ScannerState(Connection.Live("SIM-0001"), view, 0))
            assertEquals("Good. Hold still", it.text(R.id.status))
        }
    }

    @Test
    fun `a face held still is drawn in green`() = screen("steady") {
        it.show(ScannerState(Connection.Live("SIM-0001"), face, 0))
        assertEquals("Good. Hold still", it.text(R.id.status))
    }

    @Test
    fun `a face that cannot be measured says how to move`() = screen("how-to-move") {
        it.show(ScannerState(Connection.Live("SIM-0001"), FaceView.Unmeasurable(cut), 0))
        // A move of less than a degree is none.
        assertEquals("Step back: part of the face is outside the picture\n→ Go 23 cm farther away\n→ Aim 6° to the left", it.text(R.id.status))
    }

    @Test
    @Config(qualifiers = "+de-rDE-night")
    fun `a result with its interval and warning, in German, in the dark`() = screen("measured-de-dark") {
        it.show(ScannerState(Connection.Ready("SIM-0001"), null, 2))
        it.show(measured)
        val text = it.text(R.id.result)
        assertTrue(text, text.startsWith("550,4 × 349,8 × 300,1 mm\n95 von 100 Mal innerhalb 549,6–551,2 · 349,0–350,6 · 299,3–300,9 mm"))
        assertTrue(text, text.endsWith("m³\n⚠ Eine Seite ist gewölbt oder eingedrückt"))
        assertTrue(it.findViewById<Button>(R.id.share).isEnabled)
    }

    @Test
    @Config(qualifiers = "+zh-rCN", fontScale = 1.6f)
    fun `a refusal says what to do, in Chinese, in large letters`() = screen("refused-zh-large") {
        it.show(MeasureResult.Rejected(cut, 1, emptyList(), false, record))
        assertTrue(it.text(R.id.result), it.text(R.id.result).startsWith("第 2 面无法测量\n请后退"))
        assertTrue(it.text(R.id.result), it.text(R.id.result).contains("请远离 23 厘米"))
    }

    @Test
    fun `a refusal that a third face may settle says so`() = screen("third-face") {
        it.show(MeasureResult.Rejected(Reason("outline_unsure", emptyMap(), "", emptyList(), ""), null, emptyList(), true, record))
        assertTrue(it.text(R.id.result), it.text(R.id.result).endsWith("\n→ Take a third face too"))
    }

    @Test
    fun `two boxes are offered, and the one that is touched is shown`() = screen("choice") {
        it.show(ambiguous)
        assertEquals(View.VISIBLE, it.findViewById<View>(R.id.choice).visibility)
        assertEquals("400 × 250 × 250 mm", it.text(R.id.second))
    }

    @Test
    fun `a head that is gone`() = screen("unplugged") {
        it.show(ScannerState(Connection.Unavailable(DeviceCause.LOST, ""), null, 0))
        assertEquals("The head is unplugged", it.text(R.id.status))
    }

    @Test
    fun `an app that asks by intent gets the sides in its unit`() {
        val request = Intent(Dimensioning.ACTION).putExtra(Dimensioning.UNIT, "cm")
        screen("intent", request) { activity ->
            activity.show(measured)
            assertTrue(activity.isFinishing)
            val result = shadowOf(activity).resultIntent
            assertEquals(55.041, result.getDoubleExtra(Dimensioning.LENGTH, 0.0), 1e-9)
            assertEquals(0.04, result.getDoubleExtra(Dimensioning.HEIGHT + Dimensioning.SIGMA_SUFFIX, 0.0), 1e-9)
            assertEquals("MEASURED CM", result.getStringExtra(Dimensioning.STATUS) + " " + result.getStringExtra(Dimensioning.UNIT))
            assertTrue(result.getStringExtra(Dimensioning.TIMESTAMP)!!.endsWith("Z"))
        }
    }

    @Test
    fun `an app that asks by intent waits until the user has chosen`() = screen("intent-choice", Intent(Dimensioning.ACTION)) { activity ->
        activity.show(ambiguous)
        assertFalse(activity.isFinishing)
        activity.findViewById<Button>(R.id.second).performClick()
        assertTrue(activity.isFinishing)
        val result = shadowOf(activity).resultIntent
        assertEquals("MEASURED MM", result.getStringExtra(Dimensioning.STATUS) + " " + result.getStringExtra(Dimensioning.UNIT))
        assertEquals(250.0, result.getDoubleExtra(Dimensioning.WIDTH, 0.0), 0.0)
    }
}
