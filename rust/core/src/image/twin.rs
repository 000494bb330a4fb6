//! The same view with the lasers off, laid over the lit picture: what is left of that is the lasers' light, whatever is printed on the face.
//!
//! The two are a frame's time apart, in which the hand moves (3 to 19 px at a face's corners). A plane moves by a homography: it is found by
//! Gauss-Newton on green and blue, which see least of the lasers, from coarse to fine (Lucas and Kanade 1981; Baker and Matthews, IJCV 56,
//! 2004), with a gain and a level for light that changes. The picture's middle counts most, since the face is there. What lies in front
//! or behind moves otherwise and is doubled in the difference.

use super::Frame;
use super::small::Downscaler;
use crate::error::{Error, ErrorKind};
use crate::statistics::{median, robust_sigma};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// Grey level of no light in the difference: noise and doubled edges keep their sign, a stripe on dark board is 215 high.
pub(super) const NO_LIGHT: u8 = 40;
/// Unknowns of the registration: movement, gain and level.
const UNKNOWNS: usize = 10;

/// Settings of the registration and of the difference. Where no reason stands, there is no record of how a value was chosen.
#[derive(Clone, Copy, Debug)]
struct TwinSettings {
    /// Red from this grey level on is at its limit: green tells there how much light there is ... More leaves out red that a JPEG made darker, less
    /// asks green where red still tells.
    at_limit: u8,
    /// ... of which it sees at most one part in so many of what red does. More makes stripes on white board stronger, and print too.
    green_share: i16,
    /// Pixels of the frame in one of the finest picture that is registered, along each axis; two coarser ones have 2 and 4 times as many. More
    /// is quicker and less exact.
    finest: usize,
    /// Steps in each picture, the coarsest first. More takes longer, fewer may end beside the best place.
    steps: [usize; 3],
    /// One column and row of so many is taken for a step, the coarsest picture first: 40,000 pixels of the finest.
    /// More is quicker and less exact.
    every: [usize; 3],
    /// Standard deviation of the window around the picture's middle, in halves of its width. More lets the background take part, which moves
    /// otherwise; less has little texture.
    window: f64,
    /// What has less weight in the window is left out: beyond two of its standard deviations. More is quicker and shows less texture.
    least_weight: f64,
    /// A residual of so many of its scatters counts half: edges of what moves otherwise, stripes that green sees. More lets these pull.
    half_weight: f64,
    /// Least scatter of a residual, share of full scale: a grey level. More lets what moves otherwise pull in pictures without noise.
    least_scatter: f64,
    /// How far each unknown may be from standing still, 1 sigma, with lengths in halves of the picture's width: about twice what the hand does in
    /// a fifteenth of a second (1.8 mrad, 1 mm) 0.4 m from a face. Holds what a plain face does not tell; more lets that wander.
    prior: [f64; UNKNOWNS],
    /// Edge of the blocks in which the shift that is left is measured, px of the finest picture. More averages over what moves otherwise, less
    /// leaves few blocks with texture enough.
    block: usize,
    /// A block whose own shift is better known than this, px of the finest picture, has texture enough. More counts blocks whose shift is noise.
    known_px: f64,
    /// Fewer blocks than so many tell nothing. More leaves plain pictures without this check.
    fewest_blocks: usize,
    /// Most that the middle one of the blocks may be shifted, px of the frame: half a narrow stripe's width (8 px). A print's edge that is
    /// doubled by less is narrower than a stripe, and of its own colour on both sides. More lets doubled print be taken for stripes.
    most_shift_px: f64,
    /// Most of the picture's variance that may be left: the same view leaves up to 0.02 (84 rendered ones), the other face of b02 0.2 or 0.6.
    /// More takes another view for the same.
    most_left: f64,
}

impl TwinSettings {
    const DEFAULT: Self = Self {
        at_limit: 250,
        green_share: 2,
        finest: 4,
        steps: [8, 5, 4],
        every: [1, 1, 2],
        window: 0.35,
        least_weight: 0.13,
        half_weight: 2.0,
        least_scatter: 1.0 / 255.0,
        prior: [0.003, 0.003, 0.012, 0.003, 0.003, 0.012, 0.0015, 0.0015, 0.1, 0.05],
        block: 24,
        known_px: 0.1,
        fewest_blocks: 4,
        most_shift_px: 4.0,
        most_left: 0.1,
    };
}

impl Default for TwinSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// How the unlit picture lies on the lit one.
#[derive(Clone, Debug)]
struct Registration {
    /// As [`TwinSettings::prior`]: x' = (x + p0 x + p1 y + p2) / (1 + p6 x + p7 y), y' = (y + p3 x + p4 y + p5) / the same; gain less 1; level, share of
    /// full scale.
    p: SVector<f64, UNKNOWNS>,
    /// Shift that is left in the middle one of the blocks with texture, px of the frame; `None` if too few have any.
    left_px: Option<f64>,
    /// Share of the variance that is left, beyond noise.
    variance_left: f64,
}

impl Frame {
    /// Adds `off`, the same view with the lasers off, taken just before or after this one: stripes are then looked for in the
    /// difference, in which there is no print. Gives the shift that is left between the two after the head's movement is taken out, px;
    /// `None` where nothing in the picture's middle would show one.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidFrame`] if `off` is this picture itself, has another size, shows another view, or cannot be laid over this one to
    /// within 4 px. The frame is then as it was.
    pub fn add_ambient(&mut self, off: &Self) -> Result<Option<f64>, Error> {
        let invalid = |text: String| Error::new(ErrorKind::InvalidFrame, text);
        if (self.width_px, self.height_px) != (off.width_px, off.height_px) {
            return Err(invalid(format!(
                "the picture with the lasers off is {} x {} px, the lit one {} x {} px",
                off.width_px, off.height_px, self.width_px, self.height_px
            )));
        }
        // Noise makes any two exposures differ.
        if self.rgb == off.rgb {
            return Err(invalid("the picture with the lasers off is the lit one itself".into()));
        }
        let settings = TwinSettings::default();
        let found = register(self, off, &settings);
        if found.variance_left > settings.most_left {
            let percent = 100.0 * found.variance_left;
            return Err(invalid(format!(
                "the picture with the lasers off shows another view: {percent:.0} % of the lit one is not in it, {:.0} % are allowed",
                100.0 * settings.most_left
            )));
        }
        if let Some(left) = found.left_px.filter(|left| *left > settings.most_shift_px) {
            return Err(invalid(format!(
                "the picture with the lasers off is still {left:.1} px beside the lit one after the head's movement is taken out, {} px are allowed",
                settings.most_shift_px
            )));
        }
        self.laser_light = Some(difference(self, off, &found, &settings));
        Ok(found.left_px)
    }

    /// Pixels in which stripes are looked for: the lasers' light alone if the frame has its twin, else the frame's own.
    pub(crate) fn stripe_rgb(&self) -> &[u8] {
        self.laser_light.as_deref().unwrap_or(&self.rgb)
    }

    /// Whether the frame has its twin.
    pub(crate) const fn has_ambient(&self) -> bool {
        self.laser_light.is_some()
    }

    /// Red of a pixel without the lasers' light, grey levels, if the frame has its twin. `at`: the index of the pixel's first byte.
    pub(crate) fn ambient_red(&self, at: usize) -> Option<u8> {
        let light = i16::from(*self.laser_light.as_ref()?.get(at)?) - i16::from(NO_LIGHT);
        Some((i16::from(self.rgb[at]) - light).clamp(0, 255) as u8)
    }
}

/// Green and blue of a picture, 0 to 1.
struct Grey {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Grey {
    fn of(frame: &Frame, px: usize) -> Self {
        let (width, height) = ((frame.width_px / px).max(1), (frame.height_px / px).max(1));
        let mut rgb = vec![0.0; 3 * width * height];
        Downscaler::new([width, height]).run(frame, &mut rgb);
        let (green, blue) = rgb[width * height..].split_at(width * height);
        Self { width, height, values: green.iter().zip(blue).map(|(g, b)| 0.5 * (g + b)).collect() }
    }

    /// The mean of each two by two.
    fn halved(&self) -> Self {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let at =
            |x: usize, y: usize| self.values[y.min(self.height - 1) * self.width + x.min(self.width - 1)];
        let mean = |x: usize, y: usize| 0.25 * (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1));
        let values = (0..width * height).map(|i| mean(2 * (i % width), 2 * (i / width))).collect();
        Self { width, height, values }
    }

    /// Half of its width, px: the unit of lengths.
    fn half(&self) -> f64 {
        0.5 * self.width as f64
    }

    /// From a pixel to halves of the width around the middle.
    fn unit(&self, x: usize, y: usize) -> Vector2<f64> {
        Vector2::new(x as f64 + 0.5 - self.half(), y as f64 + 0.5 - 0.5 * self.height as f64) / self.half()
    }

    /// The value at a place and how it changes along both axes, per pixel; bilinear. `None` outside.
    fn at(&self, unit: Vector2<f64>) -> Option<(f64, Vector2<f64>)> {
        let (x, y) =
            ((unit.x + 1.0) * self.half() - 0.5, unit.y * self.half() + 0.5 * self.height as f64 - 0.5);
        if !(x >= 0.0 && y >= 0.0 && x < self.width as f64 - 1.0 && y < self.height as f64 - 1.0) {
            return None;
        }
        let (left, upper) = (x as usize, y as usize);
        let (fx, fy) = (x - left as f64, y - upper as f64);
        let value = |x: usize, y: usize| f64::from(self.values[y * self.width + x]);
        let (a, b) = (value(left, upper), value(left + 1, upper));
        let (c, d) = (value(left, upper + 1), value(left + 1, upper + 1));
        let (above, below) = (a + (b - a) * fx, c + (d - c) * fx);
        let slope = Vector2::new((b - a) * (1.0 - fy) + (d - c) * fy, below - above);
        Some((above + (below - above) * fy, slope))
    }
}

/// Where a place of the lit picture is in the unlit one.
fn moved(p: &SVector<f64, UNKNOWNS>, at: Vector2<f64>) -> Vector2<f64> {
    let to = Vector2::new(at.x + p[0] * at.x + p[1] * at.y + p[2], at.y + p[3] * at.x + p[4] * at.y + p[5]);
    to / (1.0 + p[6] * at.x + p[7] * at.y)
}

/// How the unlit value at a place changes with all ten numbers, from how it changes along both axes.
fn row_of(p: &SVector<f64, UNKNOWNS>, sample: &Sample, lit: &Grey) -> SVector<f64, UNKNOWNS> {
    let at = lit.unit(sample.column(), sample.row());
    let to = moved(p, at);
    let w = (1.0 + p[8]) * lit.half() / (1.0 + p[6] * at.x + p[7] * at.y);
    let slope = sample.slope * w;
    let outwards = -slope.dot(&to);
    [
        slope.x * at.x,
        slope.x * at.y,
        slope.x,
        slope.y * at.x,
        slope.y * at.y,
        slope.y,
        outwards * at.x,
        outwards * at.y,
        sample.unlit,
        1.0,
    ]
    .into()
}

/// A pixel that both pictures show.
struct Sample {
    /// Lit less unlit, share of full scale.
    residual: f64,
    /// Of the window.
    weight: f64,
    /// How the unlit value changes, per pixel.
    slope: Vector2<f64>,
    /// What it is without gain and level.
    unlit: f64,
    pixel: [u16; 2],
}

impl Sample {
    fn column(&self) -> usize {
        usize::from(self.pixel[0])
    }

    fn row(&self) -> usize {
        usize::from(self.pixel[1])
    }
}

/// Pixels of two pictures, laid over each other: one of so many along both axes.
fn samples(
    lit: &Grey,
    off: &Grey,
    p: &SVector<f64, UNKNOWNS>,
    every: usize,
    settings: &TwinSettings,
) -> Vec<Sample> {
    let of = |pixel: [usize; 2]| {
        let at = lit.unit(pixel[0], pixel[1]);
        let weight = (-0.5 * at.norm_squared() / (settings.window * settings.window)).exp();
        let (unlit, slope) = (weight > settings.least_weight).then(|| off.at(moved(p, at)))??;
        let value = f64::from(lit.values[pixel[1] * lit.width + pixel[0]]);
        let residual = value - (1.0 + p[8]) * unlit - p[9];
        // In 16 bits, since there are up to 300,000 of them: a picture has at most 16,384 rows and columns.
        Some(Sample { residual, weight, slope, unlit, pixel: pixel.map(|at| at as u16) })
    };
    let rows = (0..lit.height).step_by(every);
    rows.flat_map(|y| (0..lit.width).step_by(every).filter_map(move |x| of([x, y]))).collect()
}

/// Robust scatter of the residuals.
fn scatter(samples: &[Sample], least: f64) -> f64 {
    robust_sigma(samples.iter().map(|s| s.residual)).map_or(least, |sigma| sigma.max(least))
}

fn register(lit: &Frame, off: &Frame, settings: &TwinSettings) -> Registration {
    let finest = [lit, off].map(|frame| Grey::of(frame, settings.finest));
    let middle = finest.each_ref().map(Grey::halved);
    let coarsest = middle.each_ref().map(Grey::halved);
    let mut p = SVector::<f64, UNKNOWNS>::zeros();
    for ([lit, off], (steps, every)) in
        [&coarsest, &middle, &finest].into_iter().zip(settings.steps.into_iter().zip(settings.every))
    {
        for _ in 0..steps {
            let samples = samples(lit, off, &p, every, settings);
            let scatter = scatter(&samples, settings.least_scatter);
            let mut normal = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
            let mut right = SVector::<f64, UNKNOWNS>::zeros();
            for s in &samples {
                let weight = s.weight
                    / (1.0 + (s.residual / (settings.half_weight * scatter)).powi(2))
                    / scatter.powi(2);
                let row = row_of(&p, s, lit);
                normal.ger(weight, &row, &row, 1.0);
                right.axpy(weight * s.residual, &row, 1.0);
            }
            for (i, sigma) in settings.prior.into_iter().enumerate() {
                normal[(i, i)] += sigma.powi(-2);
                right[i] -= p[i] * sigma.powi(-2);
            }
            let Some(step) = normal.cholesky().map(|c| c.solve(&right)) else { break };
            p += step;
        }
    }
    let [lit, off] = &finest;
    let samples = samples(lit, off, &p, 1, settings);
    let left_px = shift_left(lit, &samples, settings);
    Registration { p, left_px, variance_left: variance_left(lit, &samples, settings.least_scatter) }
}

/// The shift that is left in the middle one of the blocks that have texture in both directions, px of the frame.
fn shift_left(lit: &Grey, samples: &[Sample], settings: &TwinSettings) -> Option<f64> {
    let block = settings.block;
    let scatter = scatter(samples, settings.least_scatter);
    let columns = lit.width.div_ceil(block);
    let mut blocks = vec![(Matrix2::zeros(), Vector2::zeros()); columns * lit.height.div_ceil(block)];
    for s in samples.iter().filter(|s| s.weight > 0.3) {
        let (normal, right) = &mut blocks[s.row() / block * columns + s.column() / block];
        // What the lasers add, or what moves otherwise, is no shift.
        let weight = 1.0 / (1.0 + (s.residual / (settings.half_weight * scatter)).powi(2));
        *normal += weight * s.slope * s.slope.transpose();
        *right += weight * s.residual * s.slope;
    }
    let shift = |(normal, right): &(Matrix2<f64>, Vector2<f64>)| {
        let least = normal.symmetric_eigenvalues().min();
        let known = least > 0.0 && scatter / least.sqrt() < settings.known_px;
        known.then(|| normal.try_inverse().map(|inverse| (inverse * right).norm()))?
    };
    let shifts: Vec<f64> = blocks.iter().filter_map(shift).collect();
    if shifts.len() < settings.fewest_blocks {
        return None;
    }
    Some(median(shifts)? * settings.finest as f64)
}

/// Share of the lit picture's variance that the unlit one does not have, beyond what noise explains. The middle nine tenths of the residuals count:
/// stripes are no other view.
fn variance_left(lit: &Grey, samples: &[Sample], least_scatter: f64) -> f64 {
    let mut left: Vec<(f64, f64)> = samples.iter().map(|s| (s.residual.powi(2), s.weight)).collect();
    left.sort_by(|a, b| a.0.total_cmp(&b.0));
    left.truncate(left.len() * 9 / 10);
    let mean = |values: &[(f64, f64)]| {
        let total: f64 = values.iter().map(|(_, weight)| weight).sum();
        values.iter().map(|(value, weight)| value * weight).sum::<f64>() / total.max(f64::MIN_POSITIVE)
    };
    let values: Vec<(f64, f64)> =
        samples.iter().map(|s| (f64::from(lit.values[s.row() * lit.width + s.column()]), s.weight)).collect();
    let level = mean(&values);
    let all =
        mean(&values.iter().map(|(value, weight)| ((value - level).powi(2), *weight)).collect::<Vec<_>>());
    if samples.is_empty() { 1.0 } else { mean(&left) / (all + (2.0 * least_scatter).powi(2)) }
}

/// What the lasers add, over [`NO_LIGHT`]; where the unlit picture does not reach, nothing.
fn difference(lit: &Frame, off: &Frame, found: &Registration, settings: &TwinSettings) -> Vec<u8> {
    /// Pixels of a row between which the movement is a straight line: to a thousandth of a pixel.
    const STRAIGHT: usize = 16;
    /// Parts of a pixel; sums of four bytes by two such weights fit 32 bits.
    const PARTS: f64 = 256.0;
    let (width, height) = (lit.width_px, lit.height_px);
    let middle = Vector2::new(0.5 * width as f64, 0.5 * height as f64);
    let to_off = |x: usize, y: usize| {
        let at = (Vector2::new(x as f64 + 0.5, y as f64 + 0.5) - middle) / middle.x;
        (moved(&found.p, at) * middle.x + middle - Vector2::new(0.5, 0.5)) * PARTS
    };
    // Gain and level of each byte of the unlit picture, less the level of no light.
    let unlit: [i16; 256] = std::array::from_fn(|byte| {
        let value = (1.0 + found.p[8]) * byte as f64 + 255.0 * found.p[9];
        value.round().clamp(0.0, 255.0) as i16 - i16::from(NO_LIGHT)
    });
    let most = [width - 1, height - 1].map(|n| n as i32 * PARTS as i32 - 1);
    let mut light = vec![NO_LIGHT; lit.rgb.len()];
    let rows = light.chunks_exact_mut(3 * width).zip(lit.rgb.chunks_exact(3 * width));
    for (y, (row, own)) in rows.enumerate() {
        let pieces = row.chunks_mut(3 * STRAIGHT).zip(own.chunks(3 * STRAIGHT));
        for (piece, (pixels, own)) in pieces.enumerate() {
            let (from, to) = (to_off(piece * STRAIGHT, y), to_off((piece + 1) * STRAIGHT, y));
            let step = (to - from) / STRAIGHT as f64;
            for (k, (out, own)) in pixels.chunks_exact_mut(3).zip(own.chunks_exact(3)).enumerate() {
                let at = from + step * k as f64;
                let (u, v) = (at.x.round() as i32, at.y.round() as i32);
                if u < 0 || v < 0 || u > most[0] || v > most[1] {
                    continue;
                }
                let first = 3 * ((v as usize >> 8) * width + (u as usize >> 8));
                let above = off.rgb.get(first..).and_then(<[u8]>::first_chunk::<6>);
                let below = off.rgb.get(first + 3 * width..).and_then(<[u8]>::first_chunk::<6>);
                let (Some(above), Some(below)) = (above, below) else { continue };
                let (fu, fv) = (u as u32 & 255, v as u32 & 255);
                let [wa, wb] = [256 - fu, fu].map(|w| w.wrapping_mul(256 - fv));
                let [wc, wd] = [256 - fu, fu].map(|w| w.wrapping_mul(fv));
                let mut added = [0i16; 3];
                for (c, added) in added.iter_mut().enumerate() {
                    let product = |weight: u32, byte: u8| weight.wrapping_mul(u32::from(byte));
                    let sum = product(wa, above[c])
                        .wrapping_add(product(wb, above[c + 3]))
                        .wrapping_add(product(wc, below[c]))
                        .wrapping_add(product(wd, below[c + 3]));
                    *added = i16::from(own[c])
                        .wrapping_sub(unlit[(sum.wrapping_add(1 << 15) >> 16) as usize & 255]);
                }
                if own[0] >= settings.at_limit {
                    let level = i16::from(NO_LIGHT);
                    added[0] = added[0].max(
                        settings.green_share.wrapping_mul(added[1].wrapping_sub(level)).wrapping_add(level),
                    );
                }
                for (out, added) in out.iter_mut().zip(added) {
                    *out = added.clamp(0, 255) as u8;
                }
            }
        }
    }
    light
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [640, 480];

    /// A picture of a pattern moved by some numbers of a [`Registration`], with a stripe of `light` along the diagonal.
    fn picture(p: &SVector<f64, UNKNOWNS>, pattern: u32, light: f64) -> Frame {
        let [width, height] = SIZE.map(|n| n as f64);
        let half = 0.5 * width;
        let mut rgb = Vec::new();
        // As sums of waves of 15 to 120 px the pattern is known everywhere.
        let waves: Vec<[f64; 4]> = (0..24)
            .map(|k| {
                let angle = f64::from(k * 37 + pattern * 11);
                let length = 15.0 + f64::from((k * 61 + pattern * 29) % 105);
                [angle.cos() / length, angle.sin() / length, angle * 1.7, 4.0]
            })
            .collect();
        for y in 0..SIZE[1] {
            for x in 0..SIZE[0] {
                let unit = Vector2::new(x as f64 + 0.5 - half, y as f64 + 0.5 - 0.5 * height) / half;
                // Where the unlit picture has what the lit one has at `unit`: the inverse, to first order of a small movement.
                let from = unit - (moved(p, unit) - unit);
                let from = unit - (moved(p, from) - from);
                let at = from * half;
                let paint: f64 = waves
                    .iter()
                    .map(|[a, b, phase, size]| {
                        size * (std::f64::consts::TAU * (a * at.x + b * at.y) + phase).sin()
                    })
                    .sum();
                let board = 120.0 * (1.0 + p[8]) + paint + 255.0 * p[9];
                let across = (at.x - at.y) / 2f64.sqrt();
                let stripe = light * (-0.5 * (across / 4.0).powi(2)).exp();
                for share in [1.0, 0.15, 0.1] {
                    rgb.push((board + share * stripe).round().clamp(0.0, 255.0) as u8);
                }
            }
        }
        Frame::from_rgb(SIZE[0], SIZE[1], rgb).expect("the size fits")
    }

    fn still() -> SVector<f64, UNKNOWNS> {
        SVector::zeros()
    }

    fn hand() -> SVector<f64, UNKNOWNS> {
        [0.002, -0.003, 0.015, 0.003, -0.001, -0.011, 0.001, -0.0015, 0.0, 0.0].into()
    }

    #[test]
    fn a_movement_of_the_hand_is_found_and_only_the_stripe_is_left() {
        let (lit, off) = (picture(&still(), 1, 60.0), picture(&hand(), 1, 0.0));
        let found = register(&lit, &off, &TwinSettings::DEFAULT);
        for corner in [[-0.4, -0.3], [0.4, -0.3], [0.4, 0.3], [-0.4, 0.3], [0.0, 0.0]] {
            let at = Vector2::from(corner);
            let [due, seen] = [&hand(), &found.p].map(|p| moved(p, at) * 320.0);
            let (step, off_px) = ((due - at * 320.0).norm(), (due - seen).norm());
            assert!(step > 2.0 && off_px < 0.25, "{off_px} px of {step} px at {corner:?}");
        }
        let mut whole = lit.clone();
        let left = whole.add_ambient(&off).expect("the same view").expect("texture");
        assert!(left < 0.3, "{left} px");
        let level = |x: usize, y: usize| i32::from(whole.stripe_rgb()[3 * (y * SIZE[0] + x)]);
        for k in 0..100 {
            let (x, y) = (220 + 2 * k, 140 + 2 * k);
            assert!((level(x, y) - 100).abs() < 8, "the stripe at {x} {y}: {}", level(x, y));
            let beside = level(x + 40, y);
            assert!((beside - i32::from(NO_LIGHT)).abs() < 8, "beside it at {} {y}: {beside}", x + 40);
            let at = 3 * (y * SIZE[0] + x);
            let (ambient, due) =
                (whole.ambient_red(at).expect("a twin"), picture(&still(), 1, 0.0).rgb()[at]);
            assert!(ambient.abs_diff(due) < 8, "{ambient} for {due} at {x} {y}");
        }
        assert!(!lit.has_ambient() && lit.stripe_rgb() == lit.rgb() && lit.ambient_red(0).is_none());
    }

    #[test]
    fn light_that_changes_is_no_movement() {
        let mut changed = hand();
        (changed[8], changed[9]) = (0.06, 0.02);
        let (lit, off) = (picture(&still(), 2, 60.0), picture(&changed, 2, 0.0));
        let found = register(&lit, &off, &TwinSettings::DEFAULT);
        let (due, seen) = (moved(&changed, Vector2::zeros()), moved(&found.p, Vector2::zeros()));
        assert!((due - seen).norm() * 320.0 < 0.3, "{due} {seen}");
    }

    #[test]
    fn another_view_or_size_is_refused_and_the_frame_stays_as_it_was() {
        let lit = picture(&still(), 1, 60.0);
        let small = Frame::from_rgb(320, 480, vec![90; 320 * 480 * 3]).expect("the size fits");
        let others = [
            (picture(&still(), 5, 0.0), "another view"),
            (small, "320 x 480 px"),
            (lit.clone(), "lit one itself"),
        ];
        for (off, why) in others {
            let mut frame = lit.clone();
            let e = frame.add_ambient(&off).expect_err("does not fit");
            assert!(e.kind() == ErrorKind::InvalidFrame && e.to_string().contains(why), "{e}");
            assert_eq!(frame, lit);
        }
    }

    #[test]
    fn a_plain_view_stays_where_it_is_and_says_that_nothing_shows_a_shift() {
        let plain = |light: u8| Frame::from_rgb(64, 48, vec![light; 64 * 48 * 3]).expect("the size fits");
        let mut lit = plain(120);
        assert_eq!(lit.add_ambient(&plain(118)).expect("the same view"), None);
        for (width, height) in [(1, 1), (3, 2), (9, 40)] {
            let frame =
                || Frame::from_rgb(width, height, vec![7; width * height * 3]).expect("the size fits");
            // So small a picture shows nothing; it must do no harm.
            drop(frame().add_ambient(&frame()));
        }
    }

    #[test]
    fn where_red_is_at_its_limit_green_tells_the_light() {
        let paint = |lit: bool| {
            let pixels = (0..64 * 48).flat_map(|i| {
                let stripe = lit && i % 64 == 32;
                [255, if stripe { 235 } else { 215 }, if stripe { 215 } else { 205 }]
            });
            Frame::from_rgb(64, 48, pixels.collect()).expect("the size fits")
        };
        let mut frame = paint(true);
        frame.add_ambient(&paint(false)).expect("the same view");
        let pixel = &frame.stripe_rgb()[3 * (20 * 64 + 32)..][..3];
        assert!(2 * i32::from(pixel[0]) - i32::from(pixel[1]) - i32::from(pixel[2]) > 15, "{pixel:?}");
    }
}
