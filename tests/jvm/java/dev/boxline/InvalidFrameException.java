package dev.boxline;

/** A frame is not a whole JPEG. */
public final class InvalidFrameException extends RuntimeException {
    private static final long serialVersionUID = 1;

    /** The native library makes these; the text names the field or the frame. */
    public InvalidFrameException(String message) {
        super(message);
    }
}
