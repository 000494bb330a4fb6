//! Small pictures of frames: decoded at a fraction of their size, for a window on the screen.

use boxline::{Error, ErrorKind};
use jpeg_decoder::{Decoder, PixelFormat};

/// A picture for the screen: four bytes a pixel (red, green, blue, 255), rows top to bottom.
pub(crate) struct Picture {
    pub width_px: usize,
    pub height_px: usize,
    pub rgba: Vec<u8>,
}

/// The largest of 1/8, 1/4, 1/2 and 1/1 of a JPEG that fits a window; the smallest one if none does.
pub(crate) fn decode(jpeg: &[u8], window_px: [usize; 2]) -> Result<Picture, Error> {
    let broken = |e: &dyn std::fmt::Display| {
        Error::new(ErrorKind::InvalidFrame, format!("no preview of this frame: {e}"))
    };
    let mut decoder = Decoder::new(jpeg);
    decoder.read_info().map_err(|e| broken(&e))?;
    let info = decoder.info().ok_or_else(|| broken(&"it has no size"))?;
    let full = [info.width, info.height];
    let fits = |eighths: u16| {
        full.iter()
            .zip(window_px)
            .all(|(px, most)| usize::from(*px).div_ceil(8) * usize::from(eighths) <= most)
    };
    let eighths = [8, 4, 2].into_iter().find(|eighths| fits(*eighths)).unwrap_or(1);
    let asked = full.map(|px| (u32::from(px) * u32::from(eighths)).div_ceil(8).max(1));
    let asked = asked.map(|px| u16::try_from(px).unwrap_or(u16::MAX));
    let (width, height) = decoder.scale(asked[0], asked[1]).map_err(|e| broken(&e))?;
    let pixels = decoder.decode().map_err(|e| broken(&e))?;
    let (width_px, height_px) = (usize::from(width), usize::from(height));
    let format = decoder.info().map(|info| info.pixel_format);
    let rgba: Vec<u8> = match format {
        Some(PixelFormat::RGB24) => pixels.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 255]).collect(),
        Some(PixelFormat::L8) => pixels.iter().flat_map(|p| [*p, *p, *p, 255]).collect(),
        other => return Err(broken(&format!("its pixels are {other:?}"))),
    };
    if rgba.len() != width_px * height_px * 4 {
        return Err(broken(&format!("{} bytes for {width_px} x {height_px} px", rgba.len())));
    }
    Ok(Picture { width_px, height_px, rgba })
}

#[cfg(test)]
mod tests {
    use super::*;
    use boxline::Frame;

    fn recorded() -> Vec<u8> {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/b02/a.jpg");
        std::fs::read(path).expect("the recording is in the repository")
    }

    #[test]
    fn a_preview_is_the_frame_made_small() {
        let jpeg = recorded();
        let small = decode(&jpeg, [700, 700]).expect("decodes");
        assert_eq!((small.width_px, small.height_px), (648, 486));
        // Mean colour of both: the same scene.
        let full = Frame::from_jpeg(&jpeg).expect("decodes");
        let mean = |bytes: &[u8], step: usize, channel: usize| {
            let values = bytes.iter().skip(channel).step_by(step);
            let n = values.len() as f64;
            values.map(|v| f64::from(*v)).sum::<f64>() / n
        };
        for channel in 0..3 {
            let (a, b) = (mean(&small.rgba, 4, channel), mean(full.rgb(), 3, channel));
            assert!((a - b).abs() < 1.5, "channel {channel}: {a} and {b}");
        }
        assert!(small.rgba.iter().skip(3).step_by(4).all(|alpha| *alpha == 255));
    }

    #[test]
    fn the_window_chooses_the_fraction_and_torn_frames_are_errors() {
        let jpeg = recorded();
        let width = |window| decode(&jpeg, [window; 2]).expect("decodes").width_px;
        assert_eq!([width(1), width(330), width(1400), width(9999)], [324, 324, 1296, 2592]);
        for bytes in [&[][..], &jpeg[..200], b"not a picture"] {
            assert!(decode(bytes, [100, 100]).is_err_and(|e| e.kind() == ErrorKind::InvalidFrame));
        }
    }
}
