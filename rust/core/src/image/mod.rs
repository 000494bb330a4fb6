//! Storage and sampling of pixels; knows no geometry.

pub(crate) mod bands;
pub(crate) mod redness;
pub mod small;

use crate::error::{Error, ErrorKind};
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;

/// A decoded frame: 8-bit RGB, rows top to bottom, on the raw sensor raster.
#[derive(Clone, PartialEq, Eq)]
pub struct Frame {
    width_px: usize,
    height_px: usize,
    rgb: Vec<u8>,
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

/// Larger pictures are refused before memory is taken for them; the sensor has 2592 x 1944.
const MAX_SIDE_PX: usize = 16_384;

impl Frame {
    /// Decodes a JPEG.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidFrame`] if the bytes are empty, not a JPEG, torn, or larger than 16384 px on a side.
    pub fn from_jpeg(bytes: &[u8]) -> Result<Self, Error> {
        if bytes.is_empty() {
            return Err(Error::new(ErrorKind::InvalidFrame, "the frame is empty (0 bytes)"));
        }
        let options = DecoderOptions::default()
            .set_strict_mode(true)
            .set_max_width(MAX_SIDE_PX)
            .set_max_height(MAX_SIDE_PX)
            .jpeg_set_out_colorspace(ColorSpace::RGB);
        let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(bytes), options);
        let broken = |e: zune_jpeg::errors::DecodeErrors| {
            Error::new(
                ErrorKind::InvalidFrame,
                format!("the frame is not a whole JPEG ({} bytes): {e:?}", bytes.len()),
            )
        };
        decoder.decode_headers().map_err(broken)?;
        let (width_px, height_px) = decoder
            .dimensions()
            .ok_or_else(|| Error::new(ErrorKind::InvalidFrame, "the JPEG has no size"))?;
        let rgb = decoder.decode().map_err(broken)?;
        Self::from_rgb(width_px, height_px, rgb)
    }

    /// A frame from pixels, three bytes each.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidFrame`] if the number of bytes does not fit the size.
    pub fn from_rgb(width_px: usize, height_px: usize, rgb: Vec<u8>) -> Result<Self, Error> {
        if width_px == 0 || height_px == 0 || width_px > MAX_SIDE_PX || height_px > MAX_SIDE_PX {
            return Err(Error::new(
                ErrorKind::InvalidFrame,
                format!("the frame is {width_px} x {height_px} px, 1 to {MAX_SIDE_PX} px each are allowed"),
            ));
        }
        let needed = width_px * height_px * 3;
        if rgb.len() != needed {
            return Err(Error::new(
                ErrorKind::InvalidFrame,
                format!("{} bytes for {width_px} x {height_px} px, {needed} are needed", rgb.len()),
            ));
        }
        Ok(Self { width_px, height_px, rgb })
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
