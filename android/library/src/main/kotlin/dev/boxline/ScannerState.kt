package dev.boxline

/** What a [BoxMeter] is doing, for a screen. */
public data class ScannerState(
    /** The head. */
    public val connection: Connection,
    /** The face in view at this moment; null while nothing is looked at. */
    public val view: FaceView?,
    /** How many faces are captured: 0 to 3. */
    public val captured: Int,
)

/** The head, as a [BoxMeter] has it. */
public sealed interface Connection {
    /** This meter has no head; it measures pictures that it is given. */
    public data object None : Connection

    /** The head is open, its lasers are off. */
    public data class Ready(public val serial: String) : Connection

    /** Lasers and stream are on, or being switched on. */
    public data class Live(public val serial: String) : Connection

    /** The head is gone or failed. Close this meter and open a new one when the head is back. */
    public data class Unavailable(public val deviceCause: DeviceCause, public val message: String) : Connection

    /** This meter is closed; its state does not change any more. */
    public data object Closed : Connection
}
