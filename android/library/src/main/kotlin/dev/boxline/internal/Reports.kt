package dev.boxline.internal

import dev.boxline.BoxSize
import dev.boxline.Candidate
import dev.boxline.CubicMetres
import dev.boxline.FaceView
import dev.boxline.Length
import dev.boxline.MeasureResult
import dev.boxline.Millimetres
import dev.boxline.Move
import dev.boxline.Radians
import dev.boxline.Reason
import dev.boxline.Record
import dev.boxline.SensorPoint
import dev.boxline.Volume
import dev.boxline.Warning

// Results from messages of proto/boxline.proto. The numbers of fields are those of that file.

private const val MEASURED = 1L
private const val AMBIGUOUS = 2L
private const val REJECTED = 3L

/** A `BoxReport`. */
internal fun measureResult(bytes: ByteArray): MeasureResult {
    val report = Wire.read(bytes)
    val record = Record(bytes)
    val faces = report.messages(5)
    val warnings = faces.flatMapIndexed { i, face -> warnings(face, 11, i) } + warnings(report, 6, null)
    return when (report.number(1)) {
        MEASURED -> {
            val enclosing = size(report.part(11))
            MeasureResult.Measured(size(report.part(2)), enclosing, report.doubleOrNull(8), warnings, record)
        }
        AMBIGUOUS -> {
            val (first, second) = report.messages(3)
            MeasureResult.Ambiguous(size(first), size(second), report.doubleOrNull(8), warnings, record)
        }
        else -> {
            // With fewer than two good faces the report's own reason is that of the first face that is refused.
            val good = faces.count { it.number(2) == MEASURED }
            val refused = faces.indexOfFirst { it.number(2) == REJECTED }.takeIf { good < 2 && it >= 0 }
            MeasureResult.Rejected(
                reason = reason(report.part(4), refused?.let { faces[it].message(13) }),
                face = refused,
                candidates = report.messages(9).map { Candidate(size(it.part(1)), it.double(2)) },
                thirdFaceHelps = report.number(10) != 0L,
                record = record,
            )
        }
    }
}

/** A `LiveView` with the number of its frame. */
internal fun liveView(bytes: ByteArray): Pair<FaceView, Long> {
    val live = Wire.read(bytes)
    val face = live.part(1)
    if (face.number(2) != MEASURED) return FaceView.Unmeasurable(reason(face.part(9), face.message(13))) to live.number(3)
    val view = FaceView.Measurable(
        length = length(face.part(3)),
        width = length(face.part(4)),
        corners = face.messages(5).map { point(it.part(1)) },
        stripes = face.messages(6).map { point(it.part(1)) to point(it.part(2)) },
        steady = live.number(2) != 0L,
        confidence = face.doubleOrNull(14),
        warnings = warnings(face, 11, 0),
    )
    return view to live.number(3)
}

private fun Wire.part(field: Int): Wire = requireNotNull(message(field)) { "field $field is missing" }

private fun size(sides: Wire) = BoxSize(
    length = length(sides.part(1)),
    width = length(sides.part(2)),
    height = length(sides.part(3)),
    volume = sides.part(4).let { volume ->
        Volume(CubicMetres(volume.double(1)), CubicMetres(volume.double(2)), CubicMetres(volume.double(3)), CubicMetres(volume.double(4)))
    },
)

private fun length(message: Wire) =
    Length(Millimetres(message.double(1)), Millimetres(message.double(2)), Millimetres(message.double(3)), Millimetres(message.double(4)))

private fun point(message: Wire) = SensorPoint(message.double(1), message.double(2))

private fun numbers(message: Wire) = message.messages(2).associate { it.text(1) to it.double(2) }

private fun reason(reject: Wire, hint: Wire?) = Reason(
    name = reject.text(1),
    numbers = numbers(reject),
    text = reject.text(3),
    moves = hint?.messages(1).orEmpty().mapNotNull(::move),
    movesText = hint?.text(2).orEmpty(),
)

/** Null for a move that came with a newer native library. */
private fun move(message: Wire): Move? {
    val numbers = numbers(message)
    val angle = { name: String -> Radians(numbers[name] ?: 0.0) }
    val by = numbers["by_mm"]?.let(::Millimetres)
    return when (message.text(1)) {
        "closer" -> Move.Closer(by)
        "farther" -> Move.Farther(by)
        "roll" -> Move.Roll(angle("clockwise_rad"))
        "aim" -> Move.Aim(angle("right_rad"), angle("down_rad"))
        "look_straighter" -> Move.LookStraighter(angle("by_rad"))
        else -> null
    }
}

private fun warnings(message: Wire, field: Int, face: Int?) =
    message.messages(field).map { Warning(name = it.text(1), face = face, numbers = numbers(it), text = it.text(3)) }
