package dev.boxline

/** A check that failed although the view could be measured. The result stands: its standard deviations allow for what was seen. */
public class Warning internal constructor(
    /** The stable name, such as `face_not_flat`. */
    public val name: String,
    /** The picture whose face it is about, 0, 1 or 2; null if it is about several together. */
    public val face: Int?,
    /** What was found, its standard deviation, the check's statistic and limit; names end in their unit. */
    public val numbers: Map<String, Double>,
    /** For people, English. */
    public val text: String,
) {
    /** The checks that this version knows; apps choose their own words by it. */
    public val kind: Kind = Kind.entries.find { it.name.lowercase(java.util.Locale.ROOT) == name } ?: Kind.OTHER

    override fun toString(): String = "$name: $text"

    /** What does not fit a flat rectangle, a straight edge, the calibration, or the other pictures. */
    public enum class Kind {
        /** A laser stands otherwise than when the head was calibrated. */
        LASER_MOVED,

        /** The face bulges or is dented. */
        FACE_NOT_FLAT,

        /** The face is skewed. */
        NOT_RIGHT_ANGLED,

        /** Two opposite edges of the face differ in length. */
        OPPOSITE_EDGES,

        /** An edge of the face is a bow of more than 1 mm. */
        SIDE_BOWED,

        /** For another line beside an edge of the face more speaks than for the one that was measured: a seam, print, the other of two roundings. */
        EDGE_DOUBLE,

        /** A side that several pictures show differs more than it should. */
        SIDES_DIFFER,

        /** A check that came with a newer native library. */
        OTHER,
    }
}
