//! Storage and sampling of pixels; knows no geometry.

pub(crate) mod bands;
mod jpeg;
pub mod laser_response;
mod size;
pub mod small;
mod twin;

use crate::error::{Error, ErrorKind};
use size::check_size;

/// A decoded frame: 8-bit RGB, rows top to bottom, on the raw sensor raster.
#[derive(Clone, PartialEq, Eq)]
pub struct Frame {
    width_px: usize,
    height_px: usize,
    rgb: Vec<u8>,
    /// What the lasers add, three bytes a pixel: [`Frame::add_ambient`].
    laser_light: Option<Vec<u8>>,
}

impl std::fmt::Debug for Frame {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Frame({} x {} px)", self.width_px, self.height_px)
    }
}

/// Every other byte of a word: sums over pixels take several at once, each with 16 bits to itself.
pub(crate) const LANES: u64 = 0x00ff_00ff_00ff_00ff;

/// The first eight bytes.
#[inline]
pub(crate) fn word(bytes: &[u8]) -> Option<u64> {
    bytes.first_chunk().map(|bytes| u64::from_le_bytes(*bytes))
}

impl Frame {
    /// Decodes a JPEG as cameras send it: baseline or extended, one or three colours, one scan. Its Huffman tables may be missing
    /// (MJPEG: those of the standard are meant), its end marker too; what follows the end is not looked at.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidFrame`] if the bytes are empty, not such a JPEG, torn, or larger than 16384 px on a side or 2^25 px in
    /// all. A torn JPEG is one whose data does not give exactly the declared blocks, or gives what no picture can have.
    pub fn from_jpeg(bytes: &[u8]) -> Result<Self, Error> {
        let (width_px, height_px, rgb) = jpeg::decode(bytes)?;
        Self::from_rgb(width_px, height_px, rgb)
    }

    /// A frame from pixels, three bytes each.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidFrame`] if the number of bytes does not fit the size, or the size is larger than that of a JPEG may be.
    pub fn from_rgb(width_px: usize, height_px: usize, rgb: Vec<u8>) -> Result<Self, Error> {
        check_size(width_px, height_px)?;
        let needed = width_px * height_px * 3;
        if rgb.len() != needed {
            return Err(Error::new(
                ErrorKind::InvalidFrame,
                format!("{} bytes for {width_px} x {height_px} px, {needed} are needed", rgb.len()),
            ));
        }
        Ok(Self { width_px, height_px, rgb, laser_light: None })
    }

    /// Width in px.
    #[must_use]
    pub const fn width_px(&self) -> usize {
        self.width_px
    }

    /// Height in px.
    #[must_use]
    pub const fn height_px(&self) -> usize {
        self.height_px
    }

    /// All pixels, three bytes each, rows top to bottom.
    #[must_use]
    pub fn rgb(&self) -> &[u8] {
        &self.rgb
    }
}
