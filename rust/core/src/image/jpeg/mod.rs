//! JPEG to pixels. A frame that is not whole is refused before zune-jpeg sees it (`decisions/0002-jpeg-decoder.md`).

mod bits;
mod block;
mod error;
mod header;
mod huffman;
mod scan;
mod seam;

use super::size::MAX_SIDE_PX;
use crate::error::Error;
use error::invalid;
use std::borrow::Cow;
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;

/// Width, height and RGB of a whole JPEG.
pub(super) fn decode(bytes: &[u8]) -> Result<(usize, usize, Vec<u8>), Error> {
    if bytes.is_empty() {
        return Err(invalid("the frame is empty (0 bytes)"));
    }
    let jpeg = whole(bytes)?;
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(MAX_SIDE_PX)
        .set_max_height(MAX_SIDE_PX)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(&jpeg[..]), options);
    let rgb = decoder.decode().map_err(|e| {
        invalid(format!("the frame is not a JPEG that can be decoded ({} bytes): {e:?}", bytes.len()))
    })?;
    let (width, height) = decoder.dimensions().ok_or_else(|| invalid("the JPEG has no size"))?;
    Ok((width, height, rgb))
}

/// The frame as the standard has it: with tables, with an end marker, with nothing behind it. Refuses what is torn.
fn whole(bytes: &[u8]) -> Result<Cow<'_, [u8]>, Error> {
    let header = header::read(bytes)?;
    let end = scan::read(bytes, &header)?;
    if header.tables.is_none() && end.marked {
        return Ok(Cow::Borrowed(&bytes[..end.data + 2]));
    }
    let (before, scan) = bytes[..end.data].split_at(header.scan_header_at);
    let tables = header.tables.as_deref().unwrap_or_default();
    Ok(Cow::Owned([before, tables, scan, &[0xff, 0xd9]].concat()))
}
