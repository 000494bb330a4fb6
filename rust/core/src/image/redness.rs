//! Where the red laser light is: redness `R - (G + B) / 2`, and at half resolution a ridge response for each of the two
//! diagonal stripe directions, in units of the local noise.

use super::Frame;

/// Direction of a stripe pair in the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Diagonal {
    /// u and v grow together.
    Down,
    /// v shrinks while u grows.
    Up,
}

/// Ridge strength at half resolution. Half-resolution pixel (i, j) covers full pixels 2i, 2i + 1 and 2j, 2j + 1.
pub(crate) struct RidgeMap {
    pub width: usize,
    pub height: usize,
    /// Ridge strength / local noise, clipped to +-[`Z_CLIP`], times [`Z_STEPS`].
    z: Vec<i8>,
}

/// Strengths beyond this many sigmas count no more: one bright spot must not stand for a stripe.
pub(crate) const Z_CLIP: f32 = 3.0;
/// Quantisation of the ridge map: 127 / 3 steps per sigma at most.
pub(crate) const Z_STEPS: f32 = 42.0;
/// Pixels (half resolution) added up along the diagonal: 5 keep a stripe together that strays 15 degrees from it.
const ALONG: usize = 5;
/// Distance (half-resolution px, along a row) from the stripe to the background it is compared with. A stripe is about
/// 16 px wide at its foot (2 mrad fan at 2450 px focal length); along a row at 45 degrees that is 11 half px.
const ACROSS: usize = 8;
/// Edge of the blocks in which the noise is estimated, half-resolution px.
const BLOCK: usize = 32;

impl RidgeMap {
    /// Value in sigmas times [`Z_STEPS`]; 0 outside the map. `u`, `v` in full-resolution px.
    #[inline]
    pub(crate) fn at_px(&self, u: f32, v: f32) -> i32 {
        let (i, j) = ((u * 0.5 + 0.25) as i32, (v * 0.5 + 0.25) as i32);
        if i < 0 || j < 0 || i >= self.width as i32 || j >= self.height as i32 {
            return 0;
        }
        i32::from(self.z[j as usize * self.width + i as usize])
    }
}

/// Sum of `2R - G - B` over 2 x 2 pixels (8 times the redness), half resolution.
pub(crate) fn half_redness(frame: &Frame) -> (usize, usize, Vec<i16>) {
    let (w, h) = (frame.width_px() / 2, frame.height_px() / 2);
    let stride = frame.width_px() * 3;
    let mut out = vec![0i16; w * h];
    for (j, row) in out.chunks_exact_mut(w).enumerate() {
        let top = &frame.rgb()[2 * j * stride..][..w * 6];
        let bottom = &frame.rgb()[(2 * j + 1) * stride..][..w * 6];
        for ((o, t), b) in row.iter_mut().zip(top.chunks_exact(6)).zip(bottom.chunks_exact(6)) {
            let red = i16::from(t[0]) + i16::from(t[3]) + i16::from(b[0]) + i16::from(b[3]);
            let rest = i16::from(t[1])
                + i16::from(t[2])
                + i16::from(t[4])
                + i16::from(t[5])
                + i16::from(b[1])
                + i16::from(b[2])
                + i16::from(b[4])
                + i16::from(b[5]);
            *o = 2 * red - rest;
        }
    }
    (w, h, out)
}

/// The ridge map for stripes near one diagonal, from the output of [`half_redness`].
pub(crate) fn ridge_map(width: usize, height: usize, redness: &[i16], diagonal: Diagonal) -> RidgeMap {
    let margin = ALONG / 2;
    let mut z = vec![0i8; width * height];
    let mut ridge = vec![0i16; width * BLOCK];
    let mut slope = vec![0i16; width * BLOCK];
    let mut sum = vec![0i16; width];
    let mut sample = Vec::with_capacity(BLOCK * BLOCK / 4);
    for block_top in (0..height).step_by(BLOCK) {
        let rows = BLOCK.min(height - block_top);
        ridge.fill(0);
        slope.fill(0);
        for r in 0..rows {
            let y = block_top + r;
            if y < margin || y + margin >= height || width <= 2 * (margin + ACROSS) {
                continue;
            }
            sum.fill(0);
            for t in 0..ALONG {
                let shift = match diagonal {
                    Diagonal::Down => t,
                    Diagonal::Up => ALONG - 1 - t,
                };
                let source = &redness[(y + t - margin) * width + shift..][..width - (ALONG - 1)];
                for (s, x) in sum[margin..].iter_mut().zip(source) {
                    *s += x; // 5 x 2040 fits in i16
                }
            }
            let out = &mut ridge[r * width..][..width];
            let flat = &mut slope[r * width..][..width];
            let n = width - 2 * ACROSS;
            for x in 0..n {
                let (left, here, right) = (sum[x], sum[x + ACROSS], sum[x + 2 * ACROSS]);
                out[x + ACROSS] = (here - left).min(here - right);
                flat[x + ACROSS] = here - right;
            }
        }
        for block_left in (0..width).step_by(BLOCK) {
            let columns = BLOCK.min(width - block_left);
            sample.clear();
            for r in (0..rows).step_by(2) {
                sample.extend(
                    slope[r * width + block_left..][..columns].iter().step_by(2).map(|x| x.unsigned_abs()),
                );
            }
            let middle = sample.len() / 2;
            let median = if sample.is_empty() { 0 } else { *sample.select_nth_unstable(middle).1 };
            // Median of |difference| is 0.6745 sigma; the floor is half a grey level per pixel (8 x 5 sums): JPEG's own step.
            let sigma = (f32::from(median) / 0.6745).max(0.5 * 8.0 * ALONG as f32 / 2.0);
            let gain = Z_STEPS / sigma;
            for r in 0..rows {
                let from = &ridge[r * width + block_left..][..columns];
                let to = &mut z[(block_top + r) * width + block_left..][..columns];
                for (o, x) in to.iter_mut().zip(from) {
                    *o = (f32::from(*x) * gain).clamp(-Z_CLIP * Z_STEPS, Z_CLIP * Z_STEPS) as i8;
                }
            }
        }
    }
    RidgeMap { width, height, z }
}

/// Columns of the stripe's core and of each side that the faint map averages, half-resolution px: a stripe is 4 to 6 wide at half
/// its height along a row at 45 degrees.
const CORE: usize = 3;
const SIDE: usize = 4;

/// Most that a place counts against and for a stripe in the faint map, sigmas: noise alone has -0.4 and scatters by 0.8, a faint
/// stripe has 0.5 to 2; print beside it has ten.
const FAINT_CLIP: (f32, f32) = (-1.2, 1.8);

/// As [`ridge_map`] with wider means, for stripes that no pixel shows: 1.7 times the signal to noise of the narrow one if
/// pixels are independent; thin print looks more like a stripe in it.
pub(crate) fn faint_ridge_map(width: usize, height: usize, redness: &[i16], diagonal: Diagonal) -> RidgeMap {
    let (margin, reach) = (ALONG / 2, ACROSS + SIDE / 2);
    let mut ridge = vec![0f32; width * height];
    let mut slope = vec![0f32; width * height];
    let mut sums = vec![0i32; width + 1];
    for y in margin..height.saturating_sub(margin) {
        if width <= 2 * (margin + reach) {
            break;
        }
        for x in 0..width {
            // Running sum of the diagonal's sums.
            let mut here = 0;
            if (margin..width - margin).contains(&x) {
                for t in 0..ALONG {
                    let shift = match diagonal {
                        Diagonal::Down => x + t - margin,
                        Diagonal::Up => x + margin - t,
                    };
                    here += i32::from(redness[(y + t - margin) * width + shift]);
                }
            }
            sums[x + 1] = sums[x] + here;
        }
        let mean = |from: usize, count: usize| (sums[from + count] - sums[from]) as f32 / count as f32;
        for x in margin + reach..width - margin - reach {
            let core = mean(x - CORE / 2, CORE);
            let [left, right] = [x - ACROSS, x + ACROSS].map(|middle| mean(middle - SIDE / 2, SIDE));
            ridge[y * width + x] = (core - left).min(core - right);
            slope[y * width + x] = (core - right).abs();
        }
    }
    let mut z = vec![0i8; width * height];
    let mut sample: Vec<f32> = Vec::with_capacity(BLOCK * BLOCK / 4);
    for top in (0..height).step_by(BLOCK) {
        for left in (0..width).step_by(BLOCK) {
            let (rows, columns) = (top..(top + BLOCK).min(height), left..(left + BLOCK).min(width));
            sample.clear();
            for y in rows.clone().step_by(2) {
                sample.extend(slope[y * width..][columns.clone()].iter().step_by(2));
            }
            let middle = sample.len() / 2;
            let median = *sample.select_nth_unstable_by(middle, f32::total_cmp).1;
            // As in the narrow map; the means leave less of JPEG's steps.
            let sigma = (median / 0.6745).max(0.25 * 8.0 * ALONG as f32 / 2.0);
            let gain = Z_STEPS / sigma;
            for y in rows {
                for x in columns.clone() {
                    let value = ridge[y * width + x] * gain;
                    z[y * width + x] = value.clamp(FAINT_CLIP.0 * Z_STEPS, FAINT_CLIP.1 * Z_STEPS) as i8;
                }
            }
        }
    }
    RidgeMap { width, height, z }
}
