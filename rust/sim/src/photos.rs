//! Photographs from a folder as textures: prints on boxes, posters, floors. They are read at run time, never kept here.

use crate::error::Error;
use boxline::Frame;
use std::path::Path;
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;

/// The longest side kept, px: more is never seen in a frame.
const MOST_PX: usize = 1024;

/// A photograph: linear light in 8 bits of square root, rows top to bottom.
#[derive(Clone, Debug)]
pub struct Photo {
    /// The file's name.
    pub name: String,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// sRGB bytes.
    pub rgb: Vec<[u8; 3]>,
}

/// All photographs of a folder; may be empty.
#[derive(Clone, Debug, Default)]
pub struct Photos {
    /// In the order of their names.
    pub all: Vec<Photo>,
}

impl Photos {
    /// Reads the JPEGs of a folder (no deeper) whose names are wanted. Files that cannot be decoded are passed over: textures
    /// are no input.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn from_folder(folder: &Path, wanted: impl Fn(&str) -> bool) -> Result<Self, Error> {
        let entries = std::fs::read_dir(folder).map_err(|e| Error::file(folder, e))?;
        let mut paths: Vec<_> = entries.filter_map(|e| e.ok().map(|e| e.path())).collect();
        paths.sort();
        let is_jpeg = |p: &Path| {
            p.extension().is_some_and(|e| e.eq_ignore_ascii_case("jpg") || e.eq_ignore_ascii_case("jpeg"))
        };
        let mut all = Vec::new();
        for path in paths.iter().filter(|p| is_jpeg(p)) {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if !wanted(&name) {
                continue;
            }
            let bytes = std::fs::read(path).map_err(|e| Error::file(path, e))?;
            all.extend(decoded(&bytes).map(|frame| shrink(&frame, name)));
        }
        Ok(Self { all })
    }
}

/// A photograph may be of any kind, also progressive, which core refuses as no camera's frame.
fn decoded(jpeg: &[u8]) -> Option<Frame> {
    let options = DecoderOptions::default().jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(jpeg), options);
    let rgb = decoder.decode().ok()?;
    let (width, height) = decoder.dimensions()?;
    Frame::from_rgb(width, height, rgb).ok()
}

/// Averages over whole blocks until the longest side fits.
fn shrink(frame: &Frame, name: String) -> Photo {
    let step = frame.width_px().max(frame.height_px()).div_ceil(MOST_PX);
    let (width, height) = ((frame.width_px() / step).max(1), (frame.height_px() / step).max(1));
    let mut rgb = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let mut sum = [0usize; 3];
            let mut n = 0;
            for yy in y * step..((y + 1) * step).min(frame.height_px()) {
                for xx in x * step..((x + 1) * step).min(frame.width_px()) {
                    let at = (yy * frame.width_px() + xx) * 3;
                    for (s, v) in sum.iter_mut().zip(&frame.rgb()[at..at + 3]) {
                        *s += usize::from(*v);
                    }
                    n += 1;
                }
            }
            rgb.push(sum.map(|s| (s / n.max(1)) as u8));
        }
    }
    Photo { name, width, height, rgb }
}
