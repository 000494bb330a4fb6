package dev.boxline

// The native library makes these by name; keep.pro keeps them and their constructors.

/** The calibration is broken or belongs to another head or picture size, or the network does not load. */
public class ScannerConfigException(message: String) : RuntimeException(message) {
    private companion object {
        private const val serialVersionUID: Long = 1
    }
}

/** A picture is not a whole JPEG. */
public class InvalidFrameException(message: String) : RuntimeException(message) {
    private companion object {
        private const val serialVersionUID: Long = 1
    }
}

/** The native library panicked: a bug in boxline, to be reported with this text. The [BoxMeter] is closed, the process lives. */
public class NativeBugException(message: String) : RuntimeException(message) {
    private companion object {
        private const val serialVersionUID: Long = 1
    }
}

/** The head failed while it was being opened. Later failures are results: [MeasureResult.DeviceUnavailable]. */
public class DeviceException(
    /** Why. */
    public val deviceCause: DeviceCause,
    message: String,
) : RuntimeException(message) {
    /** For the native library; an unknown name is a failure of the USB layer. */
    internal constructor(deviceCause: String, message: String) :
        this(DeviceCause.entries.find { it.name == deviceCause } ?: DeviceCause.USB, message)

    private companion object {
        private const val serialVersionUID: Long = 1
    }
}
