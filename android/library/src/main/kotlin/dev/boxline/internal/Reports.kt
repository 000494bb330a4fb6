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

// Results from messages of proto/boxline.proto.

/** A `BoxReport`. */
internal fun measureResult(bytes: ByteArray): MeasureResult {
    val report = Wire.read(bytes)
    val record = Record(bytes)
    val faces = report.messages(Field.BoxReport.FACES)
    val warnings = faces.flatMapIndexed { i, face -> warnings(face.messages(Field.Face.WARNINGS), i) } +
        warnings(report.messages(Field.BoxReport.WARNINGS), null)
    val confidence = report.doubleOrNull(Field.BoxReport.CONFIDENCE)
    return when (report.number(Field.BoxReport.OUTCOME)) {
        Field.Outcome.OUTCOME_MEASURED -> {
            val enclosing = size(report.part(Field.BoxReport.ENCLOSING))
            MeasureResult.Measured(size(report.part(Field.BoxReport.SIDES)), enclosing, confidence, warnings, record)
        }
        Field.Outcome.OUTCOME_AMBIGUOUS -> {
            val (first, second) = report.messages(Field.BoxReport.CANDIDATES)
            MeasureResult.Ambiguous(size(first), size(second), confidence, warnings, record)
        }
        else -> {
            // With fewer than two good faces the report's own reason is that of the first face that is refused.
            val good = faces.count { it.number(Field.Face.OUTCOME) == Field.Outcome.OUTCOME_MEASURED }
            val refused = faces.indexOfFirst { it.number(Field.Face.OUTCOME) == Field.Outcome.OUTCOME_REJECTED }.takeIf { good < 2 && it >= 0 }
            MeasureResult.Rejected(
                reason = reason(report.part(Field.BoxReport.REJECT), refused?.let { faces[it].message(Field.Face.HINT) }),
                face = refused,
                likeliest = report.messages(Field.BoxReport.LIKELIEST).map {
                    Candidate(size(it.part(Field.Candidate.SIDES)), it.double(Field.Candidate.CONFIDENCE))
                },
                thirdFaceHelps = report.number(Field.BoxReport.THIRD_FACE_HELPS) != 0L,
                record = record,
            )
        }
    }
}

/** A `LiveView` with the number of its frame. */
internal fun liveView(bytes: ByteArray): Pair<FaceView, Long> {
    val live = Wire.read(bytes)
    val face = live.part(Field.LiveView.FACE)
    val frame = live.number(Field.LiveView.FRAME)
    if (face.number(Field.Face.OUTCOME) != Field.Outcome.OUTCOME_MEASURED) {
        return FaceView.Unmeasurable(reason(face.part(Field.Face.REJECT), face.message(Field.Face.HINT))) to frame
    }
    val view = FaceView.Measurable(
        length = length(face.part(Field.Face.LENGTH)),
        width = length(face.part(Field.Face.WIDTH)),
        corners = face.messages(Field.Face.CORNERS).map { point(it.part(Field.Corner.PX)) },
        stripes = face.messages(Field.Face.KEY_POINTS).map {
            point(it.part(Field.KeyPoints.FIRST)) to point(it.part(Field.KeyPoints.SECOND))
        },
        steady = live.number(Field.LiveView.STEADY) != 0L,
        confidence = face.doubleOrNull(Field.Face.CONFIDENCE),
        warnings = warnings(face.messages(Field.Face.WARNINGS), 0),
    )
    return view to frame
}

private fun Wire.part(field: Int): Wire = requireNotNull(message(field)) { "field $field is missing" }

private fun size(sides: Wire) = BoxSize(
    length = length(sides.part(Field.Sides.LENGTH)),
    width = length(sides.part(Field.Sides.WIDTH)),
    height = length(sides.part(Field.Sides.HEIGHT)),
    volume = sides.part(Field.Sides.VOLUME).let { volume ->
        Volume(
            CubicMetres(volume.double(Field.Volume.VALUE_M3)),
            CubicMetres(volume.double(Field.Volume.SIGMA_M3)),
            CubicMetres(volume.double(Field.Volume.LOW_95_M3)),
            CubicMetres(volume.double(Field.Volume.HIGH_95_M3)),
        )
    },
)

private fun length(message: Wire) = Length(
    Millimetres(message.double(Field.Length.VALUE_MM)),
    Millimetres(message.double(Field.Length.SIGMA_MM)),
    Millimetres(message.double(Field.Length.LOW_95_MM)),
    Millimetres(message.double(Field.Length.HIGH_95_MM)),
)

private fun point(message: Wire) = SensorPoint(message.double(Field.Px.U), message.double(Field.Px.V))

private fun numbers(numbers: List<Wire>) =
    numbers.associate { it.text(Field.Number.NAME) to it.double(Field.Number.VALUE) }

private fun reason(reject: Wire, hint: Wire?) = Reason(
    name = reject.text(Field.Reject.REASON),
    numbers = numbers(reject.messages(Field.Reject.NUMBERS)),
    text = reject.text(Field.Reject.TEXT),
    moves = hint?.messages(Field.Hint.MOVES).orEmpty().mapNotNull(::move),
    movesText = hint?.text(Field.Hint.TEXT).orEmpty(),
)

/** Null for a move that came with a newer native library. */
private fun move(message: Wire): Move? {
    val numbers = numbers(message.messages(Field.Move.NUMBERS))
    val angle = { name: String -> Radians(numbers[name] ?: 0.0) }
    val by = numbers["by_mm"]?.let(::Millimetres)
    return when (message.text(Field.Move.KIND)) {
        "closer" -> Move.Closer(by)
        "farther" -> Move.Farther(by)
        "roll" -> Move.Roll(angle("clockwise_rad"))
        "aim" -> Move.Aim(angle("right_rad"), angle("down_rad"))
        "look_straighter" -> Move.LookStraighter(angle("by_rad"))
        else -> null
    }
}

private fun warnings(warnings: List<Wire>, face: Int?) = warnings.map {
    val numbers = numbers(it.messages(Field.Warning.NUMBERS))
    Warning(name = it.text(Field.Warning.KIND), face = face, numbers = numbers, text = it.text(Field.Warning.TEXT))
}
