package dev.boxline.internal

import dev.boxline.BoxSize
import dev.boxline.CubicMetres
import dev.boxline.FaceView
import dev.boxline.Length
import dev.boxline.MeasureResult
import dev.boxline.Millimetres
import dev.boxline.Reason
import dev.boxline.Record
import dev.boxline.SensorPoint
import dev.boxline.Volume

// Results from messages of proto/boxline.proto. The numbers of fields are those of that file.

private const val MEASURED = 1L
private const val AMBIGUOUS = 2L

/** A `BoxReport`. */
internal fun measureResult(bytes: ByteArray): MeasureResult {
    val report = Wire.read(bytes)
    val record = Record(bytes)
    return when (report.number(1)) {
        MEASURED -> MeasureResult.Measured(size(report.part(2)), record)
        AMBIGUOUS -> {
            val (first, second) = report.messages(3)
            MeasureResult.Ambiguous(size(first), size(second), record)
        }
        else -> MeasureResult.Rejected(reason(report.part(4)), record)
    }
}

/** A `LiveView` with the number of its frame. */
internal fun liveView(bytes: ByteArray): Pair<FaceView, Long> {
    val live = Wire.read(bytes)
    val face = live.part(1)
    if (face.number(2) != MEASURED) return FaceView.Unmeasurable(reason(face.part(9))) to live.number(3)
    val view = FaceView.Measurable(
        length = length(face.part(3)),
        width = length(face.part(4)),
        corners = face.messages(5).map { point(it.part(1)) },
        stripes = face.messages(6).map { point(it.part(1)) to point(it.part(2)) },
        steady = live.number(2) != 0L,
    )
    return view to live.number(3)
}

private fun Wire.part(field: Int): Wire = requireNotNull(message(field)) { "field $field is missing" }

private fun size(sides: Wire) = BoxSize(
    length = length(sides.part(1)),
    width = length(sides.part(2)),
    height = length(sides.part(3)),
    volume = sides.part(4).let { Volume(CubicMetres(it.double(1)), CubicMetres(it.double(2))) },
)

private fun length(message: Wire) = Length(Millimetres(message.double(1)), Millimetres(message.double(2)))

private fun point(message: Wire) = SensorPoint(message.double(1), message.double(2))

private fun reason(reject: Wire) = Reason(
    name = reject.text(1),
    numbers = reject.messages(2).associate { it.text(1) to it.double(2) },
    text = reject.text(3),
)
