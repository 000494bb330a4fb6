package dev.boxline

/** What a measurement of a box ends with. */
public sealed interface MeasureResult {
    /** The box was measured. */
    public class Measured internal constructor(
        public val size: BoxSize,
        /** The smallest box that encloses it, edges that bow and wave included: what a carrier's tunnel reads. */
        public val enclosing: BoxSize,
        /** Probability that every side is within 5 mm, 0 to 1; null if the report has none, but this library's measurements have one. */
        public val confidence: Double?,
        /** What looked odd; empty as a rule. */
        public val warnings: List<Warning>,
        public val record: Record,
    ) : MeasureResult

    /**
     * All pictures show a face of A x B, so the box is A x A x B or A x B x B, and only a look at it or a picture of the third face can
     * tell: `measureBox` takes three. [first] is the more likely one.
     */
    public class Ambiguous internal constructor(
        public val first: BoxSize,
        public val second: BoxSize,
        /** That one of both is right; as [Measured.confidence]. */
        public val confidence: Double?,
        /** As [Measured.warnings]. */
        public val warnings: List<Warning>,
        public val record: Record,
    ) : MeasureResult

    /** A view cannot be measured; [reason] says why and what to do. */
    public class Rejected internal constructor(
        public val reason: Reason,
        /** The picture that is refused, 0, 1 or 2; null if two or more are good and they do not fit together surely enough. */
        public val face: Int?,
        /** The likeliest boxes, two at most, for a person who decides; none is likely enough to be a result. */
        public val likeliest: List<Candidate>,
        /** Two pictures leave open what one of a third face may settle: `measureBox` takes three. */
        public val thirdFaceHelps: Boolean,
        public val record: Record,
    ) : MeasureResult

    /** The head is gone or failed. Close this meter and open a new one when the head is back. */
    public class DeviceUnavailable internal constructor(
        public val deviceCause: DeviceCause,
        public val message: String,
    ) : MeasureResult
}

/** A box that may be the right one. */
public class Candidate internal constructor(
    public val size: BoxSize,
    /** Probability that it is, 0 to 1. */
    public val confidence: Double,
)

/** What the capture of one face ends with. */
public sealed interface FaceResult {
    /** The face was captured; [number] is how many are kept now, one to three. */
    public class Captured internal constructor(public val view: FaceView.Measurable, public val number: Int) : FaceResult

    /** This view cannot be measured and was not kept. */
    public class Rejected internal constructor(public val reason: Reason) : FaceResult

    /** As [MeasureResult.DeviceUnavailable]. */
    public class DeviceUnavailable internal constructor(
        public val deviceCause: DeviceCause,
        public val message: String,
    ) : FaceResult
}

/** One face of a box in one picture. */
public sealed interface FaceView {
    /** The face can be measured. Live it may be one that an earlier picture showed: [length] and [width] were measured there. */
    public class Measurable internal constructor(
        public val length: Length,
        public val width: Length,
        /** Four, going round the face. */
        public val corners: List<SensorPoint>,
        /** For each laser, where its stripe crosses two edges of the face. */
        public val stripes: List<Pair<SensorPoint, SensorPoint>>,
        /** The head is held still: a picture taken now is sharp. Always false for a single picture. */
        public val steady: Boolean,
        /** As [MeasureResult.Measured.confidence], of this face's sides. */
        public val confidence: Double?,
        /** As [MeasureResult.Measured.warnings]. */
        public val warnings: List<Warning>,
    ) : FaceView

    /** It cannot. */
    public class Unmeasurable internal constructor(public val reason: Reason) : FaceView
}

/** Why a head cannot be used. */
public enum class DeviceCause {
    /** The cable is out, or the head went away. */
    LOST,

    /** Another program holds it. */
    BUSY,

    /** The user has not allowed it: the camera, or this USB device. */
    PERMISSION,

    /** It does not answer in time. */
    SILENT,

    /** The bus has no room for its stream. */
    BANDWIDTH,

    /** A camera, but no head. */
    NOT_A_HEAD,

    /** It answered with something that the protocol forbids. */
    PROTOCOL,

    /** The system's USB layer failed. */
    USB,
}

/** A result as it can be kept or sent on. */
public class Record internal constructor(private val bytes: ByteArray) {
    /** The bytes of a `boxline.v1.BoxReport` (proto/boxline.proto). */
    public fun toProtobuf(): ByteArray = bytes.clone()

    /** The JSON that `boxline measure --json` prints for the same pictures. */
    public fun toJson(): String = dev.boxline.internal.Native.reportJsonText(bytes)
}
