//! Broken inputs. A bad view of a box is not an error: see [`crate::reject`].

use std::fmt;

/// What kind of input is broken; for programs. People read the `Display` text of [`Error`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The calibration has missing, non-finite or impossible numbers.
    InvalidCalibration,
    /// The frame does not belong to the calibration (for example another image size).
    CalibrationMismatch,
    /// The frame cannot be decoded.
    InvalidFrame,
    /// A file of another kind has the wrong format or version.
    InvalidFile,
    /// A network's file is broken, or its inputs and outputs are not those of an edge network.
    ModelFile,
    /// The library that runs networks cannot be loaded, or failed.
    NetworkRuntime,
    /// Reading or writing failed.
    Io,
    /// The caller asked to stop ([`crate::Settings::cancelled`]).
    Cancelled,
}

/// A broken input: what, and why.
#[derive(Debug)]
pub struct Error {
    kind: ErrorKind,
    context: String,
    source: Option<Box<dyn std::error::Error + Send + Sync>>,
}

impl Error {
    /// An error of a kind with a text for people: lower case, no full stop, the value found and what is allowed.
    pub fn new(kind: ErrorKind, context: impl Into<String>) -> Self {
        Self { kind, context: context.into(), source: None }
    }

    /// Adds the cause.
    #[must_use]
    pub fn with_source(mut self, source: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        self.source = Some(source.into());
        self
    }

    /// Puts the name of the thing (a file, a frame) in front of the text.
    #[must_use]
    pub fn in_context(mut self, what: impl fmt::Display) -> Self {
        self.context = format!("{what}: {}", self.context);
        self
    }

    /// The kind, for programs.
    #[must_use]
    pub const fn kind(&self) -> ErrorKind {
        self.kind
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.context)
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.source.as_deref().map(|s| s as _)
    }
}
