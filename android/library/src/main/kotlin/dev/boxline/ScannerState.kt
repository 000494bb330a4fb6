package dev.boxline

/** What a [BoxMeter] is doing, for a screen. */
public data class ScannerState(
    /** The head. */
    public val connection: Connection,
    /** The face in view at this moment; null while nothing is looked at. */
    public val view: FaceView?,
    /** How many faces are captured: 0, 1 or 2. */
    public val captured: Int,
)

/** The head, as a [BoxMeter] has it. */
public sealed interface Connection {
    /** This meter has no head; it measures pictures that it is given. */
    public data object None : Connection

    /** The head is open, its lasers are off. */
    public data class Ready(public val serial: String) : Connection

    /** Lasers and stream are on. */
    public data class Live(public val serial: String) : Connection

    /** The head is gone or failed; open a new [BoxMeter] when it is back. */
    public data class Unavailable(public val cause: DeviceCause, public val message: String) : Connection
}
