package dev.boxline.internal

/** Numbers of proto/boxline.proto, a message an object, those that are read here. `proto/tests/kotlin.rs` compares them with the schema. */
internal object Field {
    object Outcome {
        const val OUTCOME_MEASURED = 1L
        const val OUTCOME_AMBIGUOUS = 2L
        const val OUTCOME_REJECTED = 3L
    }

    object BoxReport {
        const val OUTCOME = 1
        const val SIDES = 2
        const val CANDIDATES = 3
        const val REJECT = 4
        const val FACES = 5
        const val WARNINGS = 6
        const val CONFIDENCE = 8
        const val LIKELIEST = 9
        const val THIRD_FACE_HELPS = 10
        const val ENCLOSING = 11
    }

    object Candidate {
        const val SIDES = 1
        const val CONFIDENCE = 2
    }

    object Sides {
        const val LENGTH = 1
        const val WIDTH = 2
        const val HEIGHT = 3
        const val VOLUME = 4
    }

    object Length {
        const val VALUE_MM = 1
        const val SIGMA_MM = 2
        const val LOW_95_MM = 3
        const val HIGH_95_MM = 4
    }

    object Volume {
        const val VALUE_M3 = 1
        const val SIGMA_M3 = 2
        const val LOW_95_M3 = 3
        const val HIGH_95_M3 = 4
    }

    object Warning {
        const val KIND = 1
        const val NUMBERS = 2
        const val TEXT = 3
    }

    object Reject {
        const val REASON = 1
        const val NUMBERS = 2
        const val TEXT = 3
    }

    object Number {
        const val NAME = 1
        const val VALUE = 2
    }

    object Face {
        const val OUTCOME = 2
        const val LENGTH = 3
        const val WIDTH = 4
        const val CORNERS = 5
        const val KEY_POINTS = 6
        const val REJECT = 9
        const val WARNINGS = 11
        const val HINT = 13
        const val CONFIDENCE = 14
    }

    object Hint {
        const val MOVES = 1
        const val TEXT = 2
    }

    object Move {
        const val KIND = 1
        const val NUMBERS = 2
    }

    object Px {
        const val U = 1
        const val V = 2
    }

    object Corner {
        const val PX = 1
    }

    object KeyPoints {
        const val FIRST = 1
        const val SECOND = 2
    }

    object LiveView {
        const val FACE = 1
        const val STEADY = 2
        const val FRAME = 3
    }
}
