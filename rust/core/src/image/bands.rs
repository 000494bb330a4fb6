//! The ridge maps in which stripes are looked for first, in one pass over the picture: a row of the map for each ten of the picture.
//! A place is the sum over a strip along the diagonal, 2 x 10 px, as in [`super::laser_response::ridge_map`], but no pixel is in two of them.
//!
//! Red light cannot make red brighter than its limit: on an orange face in good light a stripe has less laser response than what lies beside it, and
//! green and blue, which see a little of the laser, carry it. There the ridge of green and blue counts if it is the stronger one.

use super::Frame;
use super::laser_response::{ACROSS, ALONG, BLOCK, Diagonal, Gain, Layout, RidgeMap, compare};

/// Rows of the map in a block in which the noise is estimated.
const BANDS: usize = BLOCK / ALONG;
/// Rows of the picture in a band.
const ROWS: usize = 2 * ALONG;

/// A place is at red's limit if its mean red is at least this, grey levels: noise and JPEG leave so much below 255.
const LIMIT: i16 = 245;
/// ... and its colour is not near white, 2 R - G - B in grey levels: light only print or a label has, which the laser does not make.
const COLOURED: i16 = 60;
/// Pixels of a place.
const PIXELS: i16 = 2 * ROWS as i16;

/// What is summed up at the places of one direction: rows of a block.
struct Block {
    ridge: Vec<i16>,
    slope: Vec<i16>,
}

impl Block {
    fn new(width: usize) -> Self {
        Self { ridge: vec![0; width * BANDS], slope: vec![0; width * BANDS] }
    }

    fn compare(&mut self, sum: &[i16], row: std::ops::Range<usize>) {
        compare(sum, &mut self.ridge[row.clone()], Some(&mut self.slope[row]));
    }

    /// The gain of some columns of these rows.
    fn gain(
        &self,
        rows: impl Iterator<Item = usize>,
        columns: &std::ops::Range<usize>,
        sample: &mut Vec<i16>,
    ) -> Gain {
        sample.clear();
        rows.for_each(|row| sample.extend(&self.slope[row..][columns.clone()]));
        Gain::new(sample)
    }
}

/// One direction.
struct Direction {
    laser_response: Block,
    /// Of green and blue.
    rest: Block,
    /// Places of a row where these count.
    at_limit: Vec<Vec<usize>>,
}

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
    let (mut sum, mut rest) = (vec![0i16; width], vec![0i16; width]);
    let mut steps = vec![0i8; width];
    let mut blocks = diagonals.map(|_| Direction {
        laser_response: Block::new(width),
        rest: Block::new(width),
        at_limit: vec![Vec::new(); BANDS],
    });
    let mut sample = Vec::with_capacity(BLOCK * BANDS);
    for block_top in (0..height).step_by(BANDS) {
        let bands = BANDS.min(height - block_top);
        for band in 0..bands {
            let row = band * width..(band + 1) * width;
            for (diagonal, block) in diagonals.iter().zip(&mut blocks) {
                add_colours(&mut colours, frame, block_top + band, *diagonal);
                let to = sum[ALONG / 2..].iter_mut().zip(&mut rest[ALONG / 2..]);
                for ((sum, rest), c) in to.zip(colours.chunks_exact(6)) {
                    // Sums of ten bytes: nothing wraps.
                    let [a, b, c, d, e, f] = [c[0], c[1], c[2], c[3], c[4], c[5]];
                    let red = a.wrapping_add(d).wrapping_mul(2);
                    let others = b.wrapping_add(c).wrapping_add(e).wrapping_add(f);
                    *sum = red.wrapping_sub(others) as i16;
                    *rest = others as i16;
                }
                block.laser_response.compare(&sum, row.clone());
                // 2 R is what both add up to.
                let limited = |(sum, rest): (&i16, &i16)| {
                    *sum >= COLOURED * PIXELS && sum.wrapping_add(*rest) >= 2 * LIMIT * PIXELS
                };
                let at_limit = &mut block.at_limit[band];
                at_limit.clear();
                at_limit.extend((0..width).filter(|x| limited((&sum[*x], &rest[*x]))));
                if !at_limit.is_empty() {
                    block.rest.compare(&rest, row.clone());
                }
            }
        }
        for (map, block) in maps.iter_mut().zip(&blocks) {
            for left in (0..width).step_by(BLOCK) {
                let columns = left..(left + BLOCK).min(width);
                let gain =
                    block.laser_response.gain((0..bands).map(|band| band * width), &columns, &mut sample);
                for band in 0..bands {
                    let to = &mut map.z[(block_top + band) * width..][..width];
                    gain.steps(
                        &block.laser_response.ridge[band * width..][columns.clone()],
                        &mut to[columns.clone()],
                    );
                }
                let in_block = |x: &usize| columns.contains(x);
                let limited = |band: &usize| block.at_limit[*band].iter().any(in_block);
                let limited: Vec<usize> = (0..bands).filter(limited).collect();
                if limited.is_empty() {
                    continue;
                }
                let gain = block.rest.gain(limited.iter().map(|band| band * width), &columns, &mut sample);
                for band in limited {
                    let to = &mut map.z[(block_top + band) * width..][..width];
                    gain.steps(
                        &block.rest.ridge[band * width..][columns.clone()],
                        &mut steps[columns.clone()],
                    );
                    for x in block.at_limit[band].iter().copied().filter(in_block) {
                        to[x] = to[x].max(steps[x]);
                    }
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
        &frame.stripe_rgb()[(band * ROWS + row) * frame.width_px() * 3 + 6 * shift..][..n]
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
    use crate::image::laser_response::{Z_STEPS, half_laser_response, ridge_map};
    use crate::noise::Noise;
    use crate::units::Px;

    /// Noise of `sigma` with a red stripe along each diagonal, 12 px wide along a row.
    fn picture(sigma: f32, height: f32) -> Frame {
        let (width, rows) = (640, 500);
        let mut noise = Noise::new(1);
        let mut rgb = Vec::with_capacity(width * rows * 3);
        for y in 0..rows {
            for x in 0..width {
                let lit = x.abs_diff(y + 60) <= 6 || (x + y).abs_diff(580) <= 6;
                for colour in 0..3 {
                    let light = if lit && colour == 0 { height } else { 0.0 };
                    rgb.push((100.0 + sigma * noise.normal() as f32 + light).round() as u8);
                }
            }
        }
        Frame::from_rgb(width, rows, rgb).expect("the size fits")
    }

    /// In the middle row of each band both maps have the same sums, each in units of its own noise.
    #[test]
    fn a_band_is_the_ridge_map_at_its_middle_row() {
        let frame = picture(6.0, 20.0);
        let (width, height, laser_response) = half_laser_response(&frame);
        let diagonals = [Diagonal::Down, Diagonal::Up];
        let bands = band_maps(&frame, diagonals);
        for (diagonal, bands) in diagonals.into_iter().zip(&bands) {
            let full = ridge_map(width, height, &laser_response, diagonal);
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

    /// A stripe on orange board in good light: red is at its limit, so that there is less laser response in the stripe than beside it.
    #[test]
    fn a_stripe_on_orange_is_a_ridge_and_a_white_line_on_brown_is_none() {
        let strength = |board: [u8; 3], line: [u8; 3]| {
            let (width, rows) = (640, 500);
            let mut rgb = Vec::with_capacity(width * rows * 3);
            for y in 0..rows {
                for x in 0..width {
                    rgb.extend(if x.abs_diff(y + 60) <= 6 { line } else { board });
                }
            }
            let frame = Frame::from_rgb(width, rows, rgb).expect("the size fits");
            let [map, _] = band_maps(&frame, [Diagonal::Down, Diagonal::Up]);
            let along = (150..350).step_by(10).map(f64::from);
            let along = along.map(|v| map.steps_at(Px::new(v + 60.0, v)) as f32 / Z_STEPS);
            along.sum::<f32>() / 20.0
        };
        let on_orange = strength([222, 115, 45], [255, 194, 119]);
        assert!(on_orange > 2.0, "{on_orange}");
        let white_on_brown = strength([190, 140, 95], [250, 250, 248]);
        assert!(white_on_brown < 0.0, "{white_on_brown}");
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
