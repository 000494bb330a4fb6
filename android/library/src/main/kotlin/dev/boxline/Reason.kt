package dev.boxline

/** Why a view cannot be measured, and what to do about it. */
public class Reason internal constructor(
    /** The stable name, such as `face_cut_by_border`. */
    public val name: String,
    /** What was found and what was needed; names end in their unit. */
    public val numbers: Map<String, Double>,
    /** For people, English. */
    public val text: String,
    /** How to move the head, in this order, so that the face can be measured; empty if moving does not help. */
    public val moves: List<Move>,
    /** [moves] for people, English; empty if there are none. */
    public val movesText: String,
) {
    /** The reasons that this version knows; apps choose their own words by it. */
    public val kind: Kind = Kind.entries.find { it.name.lowercase(java.util.Locale.ROOT) == name } ?: Kind.OTHER

    override fun toString(): String = "$name: $text" + if (moves.isEmpty()) "" else "; $movesText"

    /** What the view or the box lacks. */
    public enum class Kind {
        /** No face of a box is in view, or no laser light. */
        NO_BOX,

        /** A stripe that should be on the face is dark. */
        STRIPE_NOT_FOUND,

        /** A stripe does not cross the face: aim at its middle, or go closer. */
        STRIPE_MISSING,

        /** Part of the face is outside the picture: step back. */
        FACE_CUT_BY_BORDER,

        /** The stripes lie on no common plane. */
        FACE_NOT_PLANAR,

        /** Not all four edges of the face were found. */
        RECTANGLE_OPEN,

        /** The outline of the face is not clear. */
        OUTLINE_UNSURE,

        /** Something in front of the face hides a piece of it. */
        FACE_HIDDEN,

        /** The face is farther away than it need be to be seen whole: go closer. */
        TOO_FAR,

        /** The face is not rectangular. */
        NOT_A_RECTANGLE,

        /** The two pictures do not show two adjacent faces of one box. */
        SIDES_DISAGREE,

        /** A reason that came with a newer native library. */
        OTHER,
    }
}

/** One move of the head. Right, down and clockwise are the user's, who looks along the camera. */
public sealed interface Move {
    /** Go towards the face; by null: until it can be measured. */
    public data class Closer(@get:JvmName("getBy") public val by: Millimetres?) : Move

    /** Go away from the face; by null: until it can be measured. */
    public data class Farther(@get:JvmName("getBy") public val by: Millimetres?) : Move

    /** Turn the head about its line of sight; negative anticlockwise. */
    public data class Roll(@get:JvmName("getClockwise") public val clockwise: Radians) : Move

    /** Turn the head to look elsewhere; negative left and up. */
    public data class Aim(
        @get:JvmName("getRight") public val right: Radians,
        @get:JvmName("getDown") public val down: Radians,
    ) : Move

    /** Step aside until the face is seen so much straighter. */
    public data class LookStraighter(@get:JvmName("getBy") public val by: Radians) : Move
}
