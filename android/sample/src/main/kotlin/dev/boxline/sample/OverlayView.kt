package dev.boxline.sample

import android.content.Context
import android.graphics.Canvas
import android.graphics.Color
import android.graphics.Paint
import android.util.AttributeSet
import android.view.View
import dev.boxline.FaceView
import dev.boxline.SensorPoint

/** Draws the stripes and edges of the face in view over the preview, which fills the same place. */
internal class OverlayView(context: Context, attributes: AttributeSet?) : View(context, attributes) {
    private val edge = Paint(Paint.ANTI_ALIAS_FLAG).apply { strokeWidth = 3 * resources.displayMetrics.density }
    private val stripe = Paint(Paint.ANTI_ALIAS_FLAG).apply {
        strokeWidth = 2 * resources.displayMetrics.density
        color = Color.RED
    }

    var face: FaceView.Measurable? = null
        set(value) {
            field = value
            invalidate()
        }

    override fun onDraw(canvas: Canvas) {
        val face = face ?: return
        val scaleX = width / SENSOR_WIDTH_PX
        val scaleY = height / SENSOR_HEIGHT_PX
        // (0, 0) is the centre of the first pixel, the view's corner is half a pixel before it.
        val line = { from: SensorPoint, to: SensorPoint, paint: Paint ->
            canvas.drawLine(
                (from.u.toFloat() + 0.5f) * scaleX, (from.v.toFloat() + 0.5f) * scaleY,
                (to.u.toFloat() + 0.5f) * scaleX, (to.v.toFloat() + 0.5f) * scaleY, paint,
            )
        }
        face.stripes.forEach { (from, to) -> line(from, to, stripe) }
        edge.color = if (face.steady) Color.GREEN else Color.YELLOW
        face.corners.indices.forEach { line(face.corners[it], face.corners[(it + 1) % face.corners.size], edge) }
    }

    private companion object {
        private const val SENSOR_WIDTH_PX = 2592f
        private const val SENSOR_HEIGHT_PX = 1944f
    }
}
