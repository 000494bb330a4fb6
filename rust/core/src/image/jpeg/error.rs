//! The error of a JPEG that is not whole.

use crate::error::{Error, ErrorKind};

/// A broken frame: what is wrong.
pub(super) fn invalid(what: impl Into<String>) -> Error {
    Error::new(ErrorKind::InvalidFrame, what)
}
