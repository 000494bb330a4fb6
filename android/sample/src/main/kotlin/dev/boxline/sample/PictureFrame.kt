package dev.boxline.sample

import android.content.Context
import android.util.AttributeSet
import android.widget.FrameLayout

/** As large as there is room for with the sides of the head's picture, 4 to 3. */
internal class PictureFrame(context: Context, attributes: AttributeSet?) : FrameLayout(context, attributes) {
    override fun onMeasure(widthMeasureSpec: Int, heightMeasureSpec: Int) {
        val width = MeasureSpec.getSize(widthMeasureSpec)
        val height = MeasureSpec.getSize(heightMeasureSpec)
        val fitting = minOf(width, height * 4 / 3)
        super.onMeasure(exactly(fitting), exactly(fitting * 3 / 4))
    }

    private fun exactly(px: Int) = MeasureSpec.makeMeasureSpec(px, MeasureSpec.EXACTLY)
}
