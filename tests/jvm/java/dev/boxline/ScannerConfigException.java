package dev.boxline;

/** The calibration is broken or belongs to another camera than the frames. */
public final class ScannerConfigException extends RuntimeException {
    private static final long serialVersionUID = 1;

    /** The native library makes these; the text names the field or the frame. */
    public ScannerConfigException(String message) {
        super(message);
    }
}
