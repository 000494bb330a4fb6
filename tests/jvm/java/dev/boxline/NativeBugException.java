package dev.boxline;

/** The native library panicked: a bug in boxline, to be reported with its text. The process lives on. */
public final class NativeBugException extends RuntimeException {
    private static final long serialVersionUID = 1;

    /** The native library makes these; the text names the field or the frame. */
    public NativeBugException(String message) {
        super(message);
    }
}
