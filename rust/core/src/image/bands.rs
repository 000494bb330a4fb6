//! The ridge maps in which stripes are looked for first, in one pass over the picture: a row of the map for each ten of the picture.
//! A place is the sum over a strip along the diagonal, 2 x 10 px, as in [`super::redness::ridge_map`], but no pixel is in two of them.

use super::Frame;
use super::redness::{ACROSS, ALONG, BLOCK, Diagonal, Gain, Layout, RidgeMap, compare};

/// Rows of the map in a block in which the noise is estimated.
const BANDS: usize = BLOCK / ALONG;
/// Rows of the picture in a band.
const ROWS: usize = 2 * ALONG;

/// The maps of both directions.
pub(crate) fn band_maps(frame: &Frame, diagonals: [Diagonal; 2]) -> [RidgeMap; 2] {
    let (width, height) = (frame.width_px() / 2, frame.height_px() / ROWS);
    let mut maps = diagonals.map(|diagonal| RidgeMap {
        width,
        height,
        layout: layout(diagonal),
        z: vec![0i8; width * height],
    });
    if width <= 2 * (ALONG / 2 + ACROSS) {
        return maps;
    }
    let mut colours = vec![0u16; (width - ALONG + 1) * 6];
    let mut sum = vec![0i16; width];
    let mut ridges = [(); 2].map(|()| vec![0i16; width * BANDS]);
    let mut slopes = [(); 2].map(|()| vec![0i16; width * BANDS]);
    let mut sample = Vec::with_capacity(BLOCK * BANDS);
    for block_top in (0..height).step_by(BANDS) {
        let bands = BANDS.min(height - block_top);
        for band in 0..bands {
            let row = band * width..(band + 1) * width;
            for ((diagonal, ridge), slope) in diagonals.iter().zip(&mut ridges).zip(&mut slopes) {
                add_colours(&mut colours, frame, block_top + band, *diagonal);
                for (sum, c) in sum[ALONG / 2..].iter_mut().zip(colours.chunks_exact(6)) {
                    // Sums of ten bytes: nothing wraps.
                    let [a, b, c, d, e, f] = [c[0], c[1], c[2], c[3], c[4], c[5]];
                    let red = a.wrapping_add(d).wrapping_mul(2);
                    *sum = red.wrapping_sub(b).wrapping_sub(c).wrapping_sub(e).wrapping_sub(f) as i16;
                }
                compare(&sum, &mut ridge[row.clone()], Some(&mut slope[row.clone()]));
            }
        }
        for ((map, ridge), slope) in maps.iter_mut().zip(&ridges).zip(&slopes) {
            for left in (0..width).step_by(BLOCK) {
                let columns = left..(left + BLOCK).min(width);
                let rows = || (0..bands).map(|band| band * width);
                sample.clear();
                rows().for_each(|row| sample.extend(&slope[row..row + width][columns.clone()]));
                let gain = Gain::new(&sample);
                for row in rows() {
                    let to = &mut map.z[block_top * width + row..][..width];
                    gain.steps(&ridge[row..row + width][columns.clone()], &mut to[columns.clone()]);
                }
            }
        }
    }
    maps
}

/// Where the map of a direction has its places: those of a strip along the diagonal are one.
fn layout(diagonal: Diagonal) -> Layout {
    // A column is one of the band's middle row, half of ALONG below its top; a pixel is moved there along the diagonal.
    let slope = match diagonal {
        Diagonal::Down => 1.0,
        Diagonal::Up => -1.0,
    };
    Layout {
        columns: [0.5, -0.5 * slope],
        first: 0.5 * slope * ALONG as f32,
        rows: 1.0 / ROWS as f32,
        lean: slope as i32 * ALONG as i32,
        every_px: std::f32::consts::SQRT_2 * ROWS as f32,
    }
}

/// Adds up the colours of a band along the diagonal, six sums for each two pixels of a row.
fn add_colours(sums: &mut [u16], frame: &Frame, band: usize, diagonal: Diagonal) {
    let n = sums.len();
    let [a, b, c, d, e, f, g, h, i, j]: [&[u8]; ROWS] = std::array::from_fn(|row| {
        let shift = match diagonal {
            Diagonal::Down => row / 2,
            Diagonal::Up => ALONG - 1 - row / 2,
        };
        &frame.rgb()[(band * ROWS + row) * frame.width_px() * 3 + 6 * shift..][..n]
    });
    // Ten bytes fit; unchecked it becomes vector code.
    let add = |x: u8, y: u8| u16::from(x).wrapping_add(u16::from(y));
    for (k, sum) in sums.iter_mut().enumerate() {
        *sum = add(a[k], b[k])
            .wrapping_add(add(c[k], d[k]))
            .wrapping_add(add(e[k], f[k]))
            .wrapping_add(add(g[k], h[k]))
            .wrapping_add(add(i[k], j[k]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::redness::{Z_STEPS, half_redness, ridge_map};

    /// Noise of `sigma` with a red stripe along each diagonal, 12 px wide along a row.
    fn picture(sigma: f32, height: f32) -> Frame {
        let (width, rows) = (640, 500);
        let mut state = 1u32;
        let mut noise = || {
            (0..12).fold(-6.0, |sum, _| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                sum + (state >> 8) as f32 / (1u32 << 24) as f32
            })
        };
        let mut rgb = Vec::with_capacity(width * rows * 3);
        for y in 0..rows {
            for x in 0..width {
                let lit = x.abs_diff(y + 60) <= 6 || (x + y).abs_diff(580) <= 6;
                for colour in 0..3 {
                    let light = if lit && colour == 0 { height } else { 0.0 };
                    rgb.push((100.0 + sigma * noise() + light).round() as u8);
                }
            }
        }
        Frame::from_rgb(width, rows, rgb).expect("the size fits")
    }

    /// In the middle row of each band both maps have the same sums, each in units of its own noise.
    #[test]
    fn a_band_is_the_ridge_map_at_its_middle_row() {
        let frame = picture(6.0, 20.0);
        let (width, height, redness) = half_redness(&frame);
        let diagonals = [Diagonal::Down, Diagonal::Up];
        let bands = band_maps(&frame, diagonals);
        for (diagonal, bands) in diagonals.into_iter().zip(&bands) {
            let full = ridge_map(width, height, &redness, diagonal);
            let (mut off, mut strong) = (0.0, 0);
            for band in 0..bands.height {
                for x in 0..width {
                    let of_band = f32::from(bands.steps()[band * width + x]) / Z_STEPS;
                    let of_row = f32::from(full.steps()[(ALONG * band + ALONG / 2) * width + x]) / Z_STEPS;
                    off += (of_band - of_row).abs() / (width * bands.height) as f32;
                    strong += usize::from(of_band > 2.0 && of_row > 2.0);
                }
            }
            // Each has its own blocks for the noise.
            assert!(off < 0.2, "{diagonal:?}: {off} sigmas apart");
            assert!(strong > bands.height, "{diagonal:?}: the stripe has {strong} places");
        }
    }

    #[test]
    fn a_picture_too_small_for_it_has_empty_maps() {
        for (width, height) in [(1, 1), (20, 40), (41, 9), (60, 10)] {
            let frame = Frame::from_rgb(width, height, vec![90; width * height * 3]).expect("the size fits");
            for map in band_maps(&frame, [Diagonal::Down, Diagonal::Up]) {
                assert!(map.steps().iter().all(|z| *z == 0));
            }
        }
    }
}
