//! One error for the crate: a kind for programs, a text for people.

/// What went wrong, for programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ErrorKind {
    /// Descriptors that contradict themselves or end early.
    Descriptor,
    /// The device is well-formed but not a head that this crate can drive.
    Unsupported,
    /// The device answered with something that the protocol forbids.
    Protocol,
    /// The device refused a request.
    Refused,
    /// The cable is out, or the device went away.
    DeviceLost,
    /// Another program holds the device.
    DeviceBusy,
    /// The system does not let this program open the device.
    PermissionDenied,
    /// No such device.
    NotFound,
    /// No answer within the time allowed.
    Timeout,
    /// The bus has no room for the stream.
    Bandwidth,
    /// The calibration store holds nothing, or nothing whole.
    Store,
    /// A value outside what the head accepts, refused before it was sent.
    InvalidArgument,
    /// The system's USB layer failed.
    Io,
}

/// A failure, with what was found and what is needed.
#[derive(Clone, Debug)]
pub struct Error {
    kind: ErrorKind,
    text: String,
}

impl Error {
    /// Lower case, no full stop.
    pub fn new(kind: ErrorKind, text: impl Into<String>) -> Self {
        Self { kind, text: text.into() }
    }

    /// What went wrong, for programs.
    pub fn kind(&self) -> ErrorKind {
        self.kind
    }

    /// Says where it happened: `context: text`.
    #[must_use]
    pub fn in_context(self, context: impl std::fmt::Display) -> Self {
        Self { kind: self.kind, text: format!("{context}: {}", self.text) }
    }
}

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.text)
    }
}

impl std::error::Error for Error {}
