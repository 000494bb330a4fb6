//! Where the red laser light is: laser response `R - (G + B) / 2`, and at half resolution a ridge response for each of the two
//! diagonal stripe directions, in units of the local noise.

use super::{Frame, LANES, word};
use crate::statistics::{MEDIAN_SIGMAS, robust_sigma_f32};
use crate::units::Px;

/// Direction of a stripe pair in the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Diagonal {
    /// u and v grow together.
    Down,
    /// v shrinks while u grows.
    Up,
}

/// Ridge strength at half resolution. Half-resolution pixel (i, j) covers full pixels 2i, 2i + 1 and 2j, 2j + 1.
pub struct RidgeMap {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    pub(super) layout: Layout,
    /// Ridge strength / local noise, clipped to +-[`Z_CLIP`], times [`Z_STEPS`].
    pub(super) z: Vec<i8>,
}

/// Where a pixel is found in a map: column `columns . (u, v) + first` and row `rows * v`, with u and v from the picture's corner; where
/// rows of the map lie aslant in the picture, each begins `lean` columns farther on than the last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Layout {
    pub columns: [f32; 2],
    pub first: f32,
    pub rows: f32,
    pub lean: i32,
    /// Samples along a line this far apart tell all that the map has.
    pub every_px: f32,
}

impl Layout {
    /// A map whose pixels are `1 / scale` px large.
    pub const fn even(scale: [f32; 2], every_px: f32) -> Self {
        Self { columns: [scale[0], 0.0], first: 0.0, rows: scale[1], lean: 0, every_px }
    }
}

/// Of a map with each half-resolution row, whose places share half of their pixels with their neighbours along a stripe.
const HALF: Layout = Layout::even([0.5; 2], 9.0);

/// Strengths beyond this many sigmas count no more: one bright spot must not stand for a stripe.
pub(crate) const Z_CLIP: f32 = 3.0;
/// Quantisation of the ridge map: 127 / 3 steps per sigma at most.
pub const Z_STEPS: f32 = 42.0;
/// Pixels (half resolution) added up along the diagonal: 5 keep a stripe together that strays 15 degrees from it.
pub(super) const ALONG: usize = 5;
/// Distance (half-resolution px, along a row) from the stripe to the background it is compared with. A stripe is about
/// 16 px wide at its foot (2 mrad fan at 2450 px focal length); along a row at 45 degrees that is 11 half px.
pub(super) const ACROSS: usize = 8;
/// Edge of the blocks in which the noise is estimated, half-resolution px.
pub(super) const BLOCK: usize = 32;

impl RidgeMap {
    /// Where its values belong.
    pub(crate) fn layout(&self) -> Layout {
        self.layout
    }

    /// All values in sigmas times [`Z_STEPS`], rows top to bottom.
    pub(crate) fn steps(&self) -> &[i8] {
        &self.z
    }

    /// Value in sigmas times [`Z_STEPS`]; 0 outside the map. `at` in full-resolution px.
    pub(crate) fn steps_at(&self, at: Px) -> i32 {
        let Layout { columns, first, rows, lean, .. } = self.layout;
        let [x, y] = [at.u, at.v].map(|x| x as f32 + 0.5);
        let row = (y * rows).floor();
        let column = (columns[0] * x + columns[1] * y + first).floor() + row * lean as f32;
        let inside = (0.0..self.width as f32).contains(&column) && (0.0..self.height as f32).contains(&row);
        if inside { i32::from(self.z[row as usize * self.width + column as usize]) } else { 0 }
    }

    /// The same. `u`, `v` in full-resolution px. For maps with each half-resolution row.
    #[inline]
    #[must_use]
    pub fn at_px(&self, u: f32, v: f32) -> i32 {
        let (i, j) = ((u * 0.5 + 0.25) as i32, (v * 0.5 + 0.25) as i32);
        if i < 0 || j < 0 || i >= self.width as i32 || j >= self.height as i32 {
            return 0;
        }
        i32::from(self.z[j as usize * self.width + i as usize])
    }
}

/// Sum of `2R - G - B` over 2 x 2 pixels (8 times the laser response), half resolution.
#[must_use]
pub fn half_laser_response(frame: &Frame) -> (usize, usize, Vec<i16>) {
    let (w, h) = (frame.width_px() / 2, frame.height_px() / 2);
    let stride = frame.width_px() * 3;
    let mut out = vec![0i16; w * h];
    for (j, row) in out.chunks_exact_mut(w).enumerate() {
        let top = &frame.stripe_rgb()[2 * j * stride..][..w * 6];
        let bottom = &frame.stripe_rgb()[(2 * j + 1) * stride..][..w * 6];
        // Pixels are taken by words of eight bytes, two pixels and two bytes more, each byte with 16 bits to itself.
        let words = top.windows(8).step_by(6).zip(bottom.windows(8).step_by(6));
        for (o, (t, b)) in row.iter_mut().zip(words) {
            let (t, b) = (word(t).unwrap_or(0), word(b).unwrap_or(0));
            let even = (t & LANES) + (b & LANES); // red, blue, the neighbour's green
            let odd = (t >> 8 & LANES) + (b >> 8 & LANES); // green, the neighbour's red and blue
            let lane = |word: u64, index: u32| (word >> (16 * index)) as u16 as i16;
            // All three lanes of both words at once: the product's third lane is their sum.
            let all = lane((even + odd).wrapping_mul(0x0001_0001_0001), 2);
            *o = 3 * (lane(even, 0) + lane(odd, 1)) - all;
        }
        // The last two pixels have no such word.
        if let (Some(o), Some(t), Some(b)) = (row.last_mut(), top.last_chunk::<6>(), bottom.last_chunk::<6>())
        {
            let sum = |of: [usize; 2]| of.map(|i| i16::from(t[i]) + i16::from(b[i])).iter().sum::<i16>();
            *o = 2 * sum([0, 3]) - sum([1, 2]) - sum([4, 5]);
        }
    }
    (w, h, out)
}

/// The ridge map for stripes near one diagonal, from the output of [`half_laser_response`].
#[must_use]
pub fn ridge_map(width: usize, height: usize, laser_response: &[i16], diagonal: Diagonal) -> RidgeMap {
    let mut z = vec![0i8; width * height];
    let mut ridge = vec![0i16; width * BLOCK];
    let mut slope = vec![0i16; width * BLOCK.div_ceil(2)];
    let mut sum = vec![0i16; width];
    let mut sample = Vec::with_capacity(BLOCK * BLOCK / 4);
    for block_top in (0..height).step_by(BLOCK) {
        let rows = BLOCK.min(height - block_top);
        ridge.fill(0);
        slope.fill(0);
        for r in 0..rows {
            if !sum_along(&mut sum, laser_response, width, block_top + r, diagonal)
                || width <= 2 * (ALONG / 2 + ACROSS)
            {
                continue;
            }
            let flat = (r % 2 == 0).then(|| &mut slope[r / 2 * width..][..width]);
            compare(&sum, &mut ridge[r * width..][..width], flat);
        }
        for block_left in (0..width).step_by(BLOCK) {
            let columns = BLOCK.min(width - block_left);
            sample.clear();
            for row in slope.chunks_exact(width.max(1)).take(rows.div_ceil(2)) {
                sample.extend(row[block_left..][..columns].iter().step_by(2));
            }
            let gain = Gain::new(&sample);
            for r in 0..rows {
                let from = &ridge[r * width + block_left..][..columns];
                gain.steps(from, &mut z[(block_top + r) * width + block_left..][..columns]);
            }
        }
    }
    RidgeMap { width, height, layout: HALF, z }
}

/// From the sums of a row: its ridge, and where it is wanted how much it changes. Differences of two sums are at most 20400: nothing
/// wraps here, and unchecked it becomes vector code.
pub(super) fn compare(sum: &[i16], ridge: &mut [i16], slope: Option<&mut [i16]>) {
    let n = sum.len() - 2 * ACROSS;
    let (left, here, right) = (&sum[..n], &sum[ACROSS..][..n], &sum[2 * ACROSS..][..n]);
    for (((o, l), h), r) in ridge[ACROSS..][..n].iter_mut().zip(left).zip(here).zip(right) {
        *o = h.wrapping_sub(*l).min(h.wrapping_sub(*r));
    }
    if let Some(slope) = slope {
        for ((f, h), r) in slope[ACROSS..][..n].iter_mut().zip(here).zip(right) {
            *f = h.wrapping_sub(*r).wrapping_abs();
        }
    }
}

/// From ridges to steps of the map.
pub(super) struct Gain {
    most: i16,
    gain: i16,
}

impl Gain {
    /// By a sample of how much the sums change.
    pub(super) fn new(slopes: &[i16]) -> Self {
        let floor = of_sums(RidgeSettings::DEFAULT.least_noise);
        let sigma = (f32::from(median(slopes)) / MEDIAN_SIGMAS as f32).max(floor);
        Self {
            most: (Z_CLIP * sigma).min(f32::from(i16::MAX)) as i16,
            gain: (GAIN_ONE as f32 * Z_STEPS / sigma).round() as i16,
        }
    }

    pub(super) fn steps(&self, ridge: &[i16], steps: &mut [i8]) {
        for (o, x) in steps.iter_mut().zip(ridge) {
            let steps = i32::from((*x).clamp(-self.most, self.most)).wrapping_mul(i32::from(self.gain));
            *o = (steps.wrapping_add(GAIN_ONE / 2) >> GAIN_ONE.ilog2()) as i8;
        }
    }
}

/// Unit of the gain from ridge to steps, a whole number: the largest gain, at the noise's floor, is 4.2 of it and fits 16 bits; at
/// a noise of 1000, more than print has, it is known to a third of a percent.
const GAIN_ONE: i32 = 4096;

/// Sums of [`ALONG`] pixels along the diagonal for each pixel of row `y`; false, and nothing done, where they do not fit.
fn sum_along(sum: &mut [i16], laser_response: &[i16], width: usize, y: usize, diagonal: Diagonal) -> bool {
    let margin = ALONG / 2;
    if y < margin || (y + margin + 1) * width > laser_response.len() || width < ALONG {
        return false;
    }
    let n = width - 2 * margin;
    let [a, b, c, d, e]: [&[i16]; ALONG] = std::array::from_fn(|t| {
        let shift = match diagonal {
            Diagonal::Down => t,
            Diagonal::Up => ALONG - 1 - t,
        };
        &laser_response[(y + t - margin) * width + shift..][..n]
    });
    let sum = &mut sum[margin..][..n];
    for i in 0..n {
        // 5 x 2040 fits.
        sum[i] = a[i].wrapping_add(b[i]).wrapping_add(c[i]).wrapping_add(d[i]).wrapping_add(e[i]);
    }
    true
}

/// The median of numbers that are not negative, found bit by bit: counting is vector code, sorting is not. 0 of none.
fn median(values: &[i16]) -> i16 {
    let below = |limit: i16| {
        let chunks = values.chunks(usize::from(u16::MAX)); // whose counts fit
        let count = |chunk: &[i16]| chunk.iter().fold(0u16, |n, x| n.wrapping_add(u16::from(*x < limit)));
        chunks.map(|chunk| usize::from(count(chunk))).sum::<usize>()
    };
    let middle = values.len() / 2;
    let bits = i16::BITS - values.iter().copied().max().unwrap_or(0).leading_zeros();
    (0..bits.min(15)).rev().map(|bit| 1i16 << bit).fold(0, |found, bit| {
        if !values.is_empty() && below(found + bit) <= middle { found + bit } else { found }
    })
}

/// Least noise of both maps, and what the faint one adds up and counts.
#[derive(Clone, Copy, Debug)]
struct RidgeSettings {
    /// Least noise that is believed, grey levels a pixel: JPEG's own step. More loses stripes on clean board.
    least_noise: f32,
    /// ... in the faint map, whose means leave less of JPEG's steps. More loses faint stripes.
    faint_least_noise: f32,
    /// Columns of the stripe's core that the faint map averages, half-resolution px: a stripe is 4 to 6 wide at half its height along a row at 45
    /// degrees. More mixes in what lies beside it, less shows more noise.
    core: usize,
    /// ... and of each side. More meets print, less shows more noise.
    side: usize,
    /// Least and most that a place counts for a stripe in the faint map, sigmas: noise alone has -0.4 and scatters by 0.8, a faint stripe has
    /// 0.5 to 2; print beside it has ten. A wider range lets print outvote stripes.
    faint_clip: (f32, f32),
}

impl RidgeSettings {
    const DEFAULT: Self =
        Self { least_noise: 0.5, faint_least_noise: 0.25, core: 3, side: 4, faint_clip: (-1.2, 1.8) };
}

impl Default for RidgeSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// A noise of so many grey levels a pixel in the unit of the sums of [`ALONG`] places, 8 for each.
fn of_sums(grey: f32) -> f32 {
    grey * 8.0 * ALONG as f32 / 2.0
}

/// As [`ridge_map`] with wider means, for stripes that no pixel shows: 1.7 times the signal to noise of the narrow one if
/// pixels are independent; thin print looks more like a stripe in it.
pub(crate) fn faint_ridge_map(
    width: usize,
    height: usize,
    laser_response: &[i16],
    diagonal: Diagonal,
) -> RidgeMap {
    let settings = RidgeSettings::DEFAULT;
    let (margin, reach) = (ALONG / 2, ACROSS + settings.side / 2);
    let mut ridge = vec![0f32; width * BLOCK];
    let mut slope = vec![0f32; width * BLOCK];
    let mut z = vec![0i8; width * height];
    let mut sum = vec![0i16; width];
    let mut running = vec![0i32; width + 1];
    let mut sample: Vec<f32> = Vec::with_capacity(BLOCK * BLOCK / 4);
    for block_top in (0..height).step_by(BLOCK) {
        let rows = BLOCK.min(height - block_top);
        ridge.fill(0.0);
        slope.fill(0.0);
        for r in 0..rows {
            if !sum_along(&mut sum, laser_response, width, block_top + r, diagonal)
                || width <= 2 * (margin + reach)
            {
                continue;
            }
            let mut total = 0i32;
            for (to, s) in running[1..].iter_mut().zip(&sum) {
                total = total.wrapping_add(i32::from(*s)); // 8192 of 10200 fit
                *to = total;
            }
            let n = width - 2 * (margin + reach);
            let first = margin + reach;
            // The mean of `count` sums around each place and `away` from it.
            let ends = |away: isize, count: usize| {
                let from = first.wrapping_add_signed(away) - count / 2;
                (&running[from..][..n], &running[from + count..][..n], 1.0 / count as f32)
            };
            let beside = |away: isize| ends(away, settings.side);
            let (core, left, right) =
                (ends(0, settings.core), beside(-(ACROSS as isize)), beside(ACROSS as isize));
            let mean = |(low, high, share): (&[i32], &[i32], f32), x: usize| {
                high[x].wrapping_sub(low[x]) as f32 * share
            };
            let out = &mut ridge[r * width + first..][..n];
            let flat = &mut slope[r * width + first..][..n];
            for x in 0..n {
                let (core, left, right) = (mean(core, x), mean(left, x), mean(right, x));
                out[x] = (core - left).min(core - right);
                flat[x] = (core - right).abs();
            }
        }
        for block_left in (0..width).step_by(BLOCK) {
            let columns = BLOCK.min(width - block_left);
            sample.clear();
            for row in slope.chunks_exact(width.max(1)).take(rows).step_by(2) {
                sample.extend(row[block_left..][..columns].iter().step_by(2));
            }
            let floor = of_sums(settings.faint_least_noise);
            let sigma = robust_sigma_f32(&mut sample).map_or(floor, |sigma| sigma.max(floor));
            let gain = Z_STEPS / sigma;
            for r in 0..rows {
                let from = &ridge[r * width + block_left..][..columns];
                let to = &mut z[(block_top + r) * width + block_left..][..columns];
                let (least, most) = settings.faint_clip;
                for (o, x) in to.iter_mut().zip(from) {
                    *o = (x * gain).clamp(least * Z_STEPS, most * Z_STEPS) as i32 as i8;
                }
            }
        }
    }
    RidgeMap { width, height, layout: HALF, z }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::Noise;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn half_laser_response_is_the_sum_of_four_pixels(width in 2..40usize, height in 2..6usize, seed: u64) {
            let mut random = fastrand::Rng::with_seed(seed);
            let rgb: Vec<u8> = (0..width * height * 3).map(|_| random.u8(..)).collect();
            let laser_response = |x: usize, y: usize| {
                let p = &rgb[(y * width + x) * 3..];
                2 * i16::from(p[0]) - i16::from(p[1]) - i16::from(p[2])
            };
            let frame = Frame::from_rgb(width, height, rgb.clone()).expect("the size fits");
            let (w, h, half) = half_laser_response(&frame);
            prop_assert_eq!((w, h), (width / 2, height / 2));
            for (i, found) in half.iter().enumerate() {
                let (x, y) = (2 * (i % w), 2 * (i / w));
                let want = laser_response(x, y) + laser_response(x + 1, y) + laser_response(x, y + 1) + laser_response(x + 1, y + 1);
                prop_assert_eq!(*found, want, "half pixel {} of {} x {}", i, w, h);
            }
        }

        #[test]
        fn the_median_is_the_middle_of_the_sorted(values in prop::collection::vec(0..=i16::MAX, 1..700)) {
            let mut sorted = values.clone();
            sorted.sort_unstable();
            prop_assert_eq!(median(&values), sorted[sorted.len() / 2]);
        }
    }

    /// A map of noise of `sigma` with a stripe `height` above it, 6 half px wide along a row, and its ridge map in sigmas.
    fn strengths(sigma: f32, height: f32, diagonal: Diagonal) -> (f32, f32) {
        let (width, rows) = (320, 256);
        let mut noise = Noise::new(1);
        let on = |x: usize, y: usize| match diagonal {
            Diagonal::Down => x.abs_diff(y + 30) <= 3,
            Diagonal::Up => (x + y).abs_diff(290) <= 3,
        };
        let mut laser_response = Vec::new();
        for y in 0..rows {
            laser_response.extend((0..width).map(|x| {
                (noise.normal() as f32 * sigma + if on(x, y) { height } else { 0.0 }).round() as i16
            }));
        }
        let map = ridge_map(width, rows, &laser_response, diagonal);
        let (mut lit, mut dark) = ([0.0; 2], [0.0; 2]);
        for y in 10..rows - 10 {
            for x in 20..width - 20 {
                let far = (0..40).all(|d| !on(x + 20 - d.min(x + 20), y));
                let sum = if on(x, y) {
                    &mut lit
                } else if far {
                    &mut dark
                } else {
                    continue;
                };
                sum[0] += f32::from(map.steps()[y * width + x]) / Z_STEPS;
                sum[1] += 1.0;
            }
        }
        (lit[0] / lit[1], dark[0] / dark[1])
    }

    #[test]
    fn noise_has_the_same_strength_whatever_its_size_and_a_stripe_stands_out() {
        for diagonal in [Diagonal::Down, Diagonal::Up] {
            for sigma in [20.0, 60.0, 200.0] {
                let (lit, dark) = strengths(sigma, 3.0 * sigma, diagonal);
                // The larger of two has 1 / sqrt(pi) of the noise of one, a difference sqrt(2) of it.
                assert!((dark + 0.4).abs() < 0.08, "{diagonal:?}, noise of {sigma}: {dark}");
                assert!(lit > 2.0, "{diagonal:?}, noise of {sigma}: a stripe has {lit}");
            }
        }
    }
}
