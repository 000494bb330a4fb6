//! How large a frame may be.

use crate::error::{Error, ErrorKind};

/// Longest side; the sensor has 2592 x 1944.
pub(super) const MAX_SIDE_PX: usize = 16_384;
/// Most pixels: 100 MB of RGB, six times what the sensor has.
const MAX_PX: usize = 1 << 25;

/// Refuses what is too large, before memory is taken for it.
pub(super) fn check_size(width_px: usize, height_px: usize) -> Result<(), Error> {
    let invalid = |what: String| Error::new(ErrorKind::InvalidFrame, what);
    if width_px == 0 || height_px == 0 || width_px > MAX_SIDE_PX || height_px > MAX_SIDE_PX {
        return Err(invalid(format!(
            "the frame is {width_px} x {height_px} px, 1 to {MAX_SIDE_PX} px each are allowed"
        )));
    }
    if width_px * height_px > MAX_PX {
        return Err(invalid(format!(
            "the frame is {width_px} x {height_px} px, {} in all, {MAX_PX} are allowed",
            width_px * height_px
        )));
    }
    Ok(())
}
