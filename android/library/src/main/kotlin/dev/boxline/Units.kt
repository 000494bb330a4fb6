package dev.boxline

/** A length in millimetres. */
@JvmInline
public value class Millimetres(public val value: Double) : Comparable<Millimetres> {
    override fun compareTo(other: Millimetres): Int = value.compareTo(other.value)

    override fun toString(): String = "$value mm"
}

/** A volume in cubic metres. */
@JvmInline
public value class CubicMetres(public val value: Double) : Comparable<CubicMetres> {
    override fun compareTo(other: CubicMetres): Int = value.compareTo(other.value)

    override fun toString(): String = "$value m³"
}

/** An angle in radians. */
@JvmInline
public value class Radians(public val value: Double) : Comparable<Radians> {
    /** For people. */
    public val degrees: Double get() = Math.toDegrees(value)

    override fun compareTo(other: Radians): Int = value.compareTo(other.value)

    override fun toString(): String = "$value rad"
}

/**
 * A measured length and its standard deviation: calibration and observation together. The interval from [low95] to [high95] contains
 * the truth in 95 of 100 measurements.
 */
public data class Length(
    @get:JvmName("getValue") public val value: Millimetres,
    @get:JvmName("getSigma") public val sigma: Millimetres,
    @get:JvmName("getLow95") public val low95: Millimetres,
    @get:JvmName("getHigh95") public val high95: Millimetres,
)

/** As [Length], a volume. */
public data class Volume(
    @get:JvmName("getValue") public val value: CubicMetres,
    @get:JvmName("getSigma") public val sigma: CubicMetres,
    @get:JvmName("getLow95") public val low95: CubicMetres,
    @get:JvmName("getHigh95") public val high95: CubicMetres,
)

/** A position on the camera's sensor, pixels; (0, 0) is the centre of the top-left one, [u] runs right, [v] down. */
public data class SensorPoint(public val u: Double, public val v: Double)

/** The sides of a box as if its edges were sharp; [length] >= [width] >= [height]. */
public data class BoxSize(
    public val length: Length,
    public val width: Length,
    public val height: Length,
    public val volume: Volume,
)
