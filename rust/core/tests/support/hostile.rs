//! What is done with a JPEG from outside, for the fuzz target (rust/core/fuzz) and for the run over its corpus in `cargo test`. Nothing
//! here may panic, and what is accepted must be what it claims to be.

use boxline::{ErrorKind, Frame};

/// A JPEG file.
pub fn jpeg(bytes: &[u8]) {
    match Frame::from_jpeg(bytes) {
        Ok(frame) => {
            assert!(frame.width_px() > 0 && frame.height_px() > 0);
            assert_eq!(frame.rgb().len(), frame.width_px() * frame.height_px() * 3);
        }
        Err(error) => {
            assert_eq!(error.kind(), ErrorKind::InvalidFrame);
            assert!(error.to_string().len() < 500, "{error}");
        }
    }
}
