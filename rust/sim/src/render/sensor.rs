//! From linear light to the picture the head delivers: lens blur, motion, bloom, vignetting, Bayer mosaic, noise,
//! demosaicing, white balance, tone curve, sharpening. Small frames skip what averaging over 25 pixels removes.

use super::film::Film;
use crate::rng::Rng;
use crate::vec3::V3;
use std::sync::OnceLock;

/// One frame's optics and electronics.
#[derive(Clone, Copy, Debug)]
pub struct Sensor {
    /// Lens blur, standard deviation in sensor px.
    pub blur_px: f32,
    /// Path of the image during exposure, sensor px.
    pub motion_px: [f32; 2],
    /// Share of light lost in the image's corners.
    pub vignette: f32,
    /// Share of over-bright light that spreads widely.
    pub bloom: f32,
    /// Gains of R, G, B: what white balancing got wrong.
    pub balance: [f32; 3],
    /// Standard deviation of a sensor pixel at full scale (shot noise; falls with the root of the light).
    pub noise: f32,
    /// Noise in the dark.
    pub read: f32,
    /// Strength of the shoulder of the tone curve, 0 is plain sRGB.
    pub shoulder: f32,
    /// Strength of sharpening.
    pub sharpen: f32,
    /// Whether there is a colour mosaic.
    pub mosaic: bool,
}

/// How good the camera's pictures are, where an experiment sets it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Optics {
    /// Lens, hand and light as one finds them.
    #[default]
    AsFound,
    /// In focus, a still hand, plenty of light.
    Sharp,
    /// A little soft.
    Usual,
    /// Out of focus, moved during exposure, noisy.
    Blurred,
}

/// A wider blur takes several passes of the kernel, whose seven taps hold 2.5 standard deviations of this one, px.
const PASS_BLUR_PX: f32 = 1.2;

impl Sensor {
    /// The same sensor behind other optics.
    #[must_use]
    pub fn with_optics(self, optics: Optics) -> Self {
        let (blur_px, path_px, noise, bloom) = match optics {
            Optics::AsFound => return self,
            Optics::Sharp => (0.55, 0.1, 0.6, 0.0),
            Optics::Usual => (0.75, 0.3, 1.0, 0.015),
            Optics::Blurred => (2.0, 2.0, 1.6, 0.035),
        };
        let length = self.motion_px[0].hypot(self.motion_px[1]).max(1e-3);
        Self {
            blur_px,
            motion_px: self.motion_px.map(|p| p / length * path_px),
            noise: self.noise * noise,
            read: self.read * noise,
            bloom,
            ..self
        }
    }

    /// A perfect sensor: only the sRGB curve.
    #[must_use]
    pub const fn perfect() -> Self {
        Self {
            blur_px: 0.0,
            motion_px: [0.0, 0.0],
            vignette: 0.0,
            bloom: 0.0,
            balance: [1.0; 3],
            noise: 0.0,
            read: 0.0,
            shoulder: 0.0,
            sharpen: 0.0,
            mosaic: false,
        }
    }

    /// A sensor as one finds it, with the scene's noise.
    pub fn random(rng: &mut Rng, noise: f64) -> Self {
        let shake = if rng.chance(0.3) { rng.log_range(0.3, 2.5) } else { 0.1 };
        let turn = rng.range(0.0, std::f64::consts::TAU);
        Self {
            blur_px: rng.range_f32(0.55, 0.95),
            motion_px: [(shake * turn.cos()) as f32, (shake * turn.sin()) as f32],
            vignette: rng.range_f32(0.08, 0.35),
            bloom: rng.range_f32(0.0, 0.035),
            balance: [rng.range_f32(0.93, 1.07), 1.0, rng.range_f32(0.92, 1.08)],
            noise: noise as f32,
            read: noise as f32 * rng.range_f32(0.05, 0.15),
            shoulder: rng.range_f32(0.0, 0.5),
            sharpen: rng.range_f32(0.1, 0.55),
            mosaic: true,
        }
    }

    /// Develops a full frame; `scale` is sensor pixels per pixel of the film.
    #[must_use]
    pub fn develop(&self, film: &Film, scale: f32, rng: &mut Rng) -> Vec<u8> {
        if scale > 1.5 { self.develop_small(film, scale, rng) } else { self.develop_full(film, rng) }
    }

    /// Averaging has removed mosaic, sharpening and most of the noise; a blur of many pixels would remain.
    fn develop_small(&self, film: &Film, scale: f32, rng: &mut Rng) -> Vec<u8> {
        let curve = Curve::new(self.shoulder);
        let mut out = Vec::with_capacity(film.light.len() * 3);
        // Demosaiced neighbours share noise: the mean of n pixels is worse than n independent ones. Shot noise is even in
        // the root of the light, which is also what the curve's table wants.
        let noise = WHITE_GAIN.map(|g| 0.5 * self.noise * g.sqrt() * 1.6 / scale);
        let gauss = gaussians();
        for row in 0..film.height {
            let falls = Vignette::row(self.vignette, film.width, film.height, row);
            for (column, light) in film.light[row * film.width..][..film.width].iter().enumerate() {
                let fall = falls.at(column);
                let (bits, more) = (rng.bits(), rng.bits());
                let mut pixel = |x: f32, c: usize, deviate: u32| {
                    let root =
                        (x * fall * self.balance[c]).max(0.0).sqrt() + noise[c] * gauss[deviate as usize];
                    out.push(curve.byte_of_root(root));
                };
                pixel(light.x, 0, bits & 0xFFF);
                pixel(light.y, 1, bits >> 12 & 0xFFF);
                pixel(light.z, 2, more & 0xFFF);
            }
        }
        out
    }

    fn develop_full(&self, film: &Film, rng: &mut Rng) -> Vec<u8> {
        let (w, h) = (film.width, film.height);
        let mut planes: [Vec<f32>; 3] =
            [0, 1, 2].map(|c| film.light.iter().map(|l: &V3| l[c].min(40.0)).collect());
        if self.bloom > 0.0 {
            bloom(&mut planes[0], w, h, self.bloom);
        }
        for plane in &mut planes {
            if self.motion_px[0].hypot(self.motion_px[1]) > 0.25 {
                smear(plane, w, h, self.motion_px);
            }
            if self.blur_px > 0.0 {
                let passes = (self.blur_px / PASS_BLUR_PX).powi(2).ceil().max(1.0);
                (0..passes as usize).for_each(|_| soften(plane, w, h, self.blur_px / passes.sqrt()));
            }
        }
        for row in 0..h {
            let falls = Vignette::row(self.vignette, w, h, row);
            for (c, plane) in planes.iter_mut().enumerate() {
                for (column, x) in plane[row * w..][..w].iter_mut().enumerate() {
                    *x *= falls.at(column) * self.balance[c];
                }
            }
        }
        if self.mosaic {
            let raw = self.mosaic(&planes, w, h, rng);
            demosaic(&raw, &mut planes, w, h);
        }
        let curve = Curve::new(self.shoulder);
        let mut out = vec![0u8; w * h * 3];
        if self.sharpen <= 0.0 {
            for (i, px) in out.chunks_exact_mut(3).enumerate() {
                px.copy_from_slice(&[0, 1, 2].map(|c| curve.byte(planes[c][i])));
            }
            return out;
        }
        for plane in &mut planes {
            plane.iter_mut().for_each(|x| *x = curve.value(*x));
        }
        sharpen(&planes, w, h, self.sharpen, &mut out);
        out
    }

    /// One colour a pixel (RGGB), with shot and read noise, clipped at full scale.
    fn mosaic(&self, planes: &[Vec<f32>; 3], w: usize, h: usize, rng: &mut Rng) -> Vec<f32> {
        let gauss = gaussians();
        let noise = self.noise * self.noise;
        let read = self.read * self.read;
        let mut raw = vec![0.0; w * h];
        for row in 0..h {
            for column in 0..w {
                let c = (row & 1) + (column & 1);
                let at = row * w + column;
                let x = planes[c][at];
                let sigma = (noise * x * WHITE_GAIN[c] + read * WHITE_GAIN[c]).max(0.0).sqrt();
                let noisy = x + sigma * gauss[(rng.bits() >> 20) as usize];
                raw[at] = noisy.clamp(0.0, 1.15);
            }
        }
        raw
    }
}

/// Red and blue are amplified against green, and their noise with them.
const WHITE_GAIN: [f32; 3] = [1.8, 1.0, 1.6];

/// 4096 equally likely normal deviates.
pub(crate) fn gaussians() -> &'static [f32] {
    static TABLE: OnceLock<Vec<f32>> = OnceLock::new();
    TABLE.get_or_init(|| {
        let mut rng = Rng::new(23, 0x6A55);
        let mut table: Vec<f32> = (0..4096).map(|_| rng.normal() as f32).collect();
        let mean = table.iter().sum::<f32>() / 4096.0;
        let spread = (table.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / 4096.0).sqrt();
        table.iter_mut().for_each(|x| *x = (*x - mean) / spread);
        table
    })
}

/// Light falls off with the square of the distance from the middle.
struct Vignette {
    at_middle_column: f32,
    middle: f32,
    per_column: f32,
}

impl Vignette {
    fn row(strength: f32, w: usize, h: usize, row: usize) -> Self {
        let (cx, cy) = (0.5 * w as f32, 0.5 * h as f32);
        let per_column = strength / (cx * cx + cy * cy);
        let dy = row as f32 - cy;
        Self { at_middle_column: 1.0 - per_column * dy * dy, middle: cx, per_column }
    }

    #[inline]
    fn at(&self, column: usize) -> f32 {
        let dx = column as f32 - self.middle;
        self.at_middle_column - self.per_column * dx * dx
    }
}

/// sRGB with a shoulder, by table over the root of the light.
pub(crate) struct Curve {
    bytes: Vec<u8>,
    values: Vec<f32>,
}

impl Curve {
    pub(crate) fn new(shoulder: f32) -> Self {
        let values: Vec<f32> = (0..4096)
            .map(|i| {
                let x = (i as f32 / 4095.0).powi(2);
                let bent = x * (1.0 + shoulder) / (1.0 + shoulder * x);
                let y = if bent <= 0.003_130_8 { 12.92 * bent } else { 1.055 * bent.powf(1.0 / 2.4) - 0.055 };
                y * 255.0
            })
            .collect();
        Self { bytes: values.iter().map(|v| (v + 0.5) as u8).collect(), values }
    }

    #[inline]
    fn index(x: f32) -> usize {
        (x.clamp(0.0, 1.0).sqrt() * 4095.0 + 0.5) as usize
    }

    #[inline]
    fn byte_of_root(&self, root: f32) -> u8 {
        self.bytes[(root.clamp(0.0, 1.0) * 4095.0 + 0.5) as usize]
    }

    #[inline]
    pub(crate) fn byte(&self, x: f32) -> u8 {
        self.bytes[Self::index(x)]
    }

    #[inline]
    fn value(&self, x: f32) -> f32 {
        self.values[Self::index(x)]
    }
}

/// Gaussian blur by a kernel of seven taps along rows, then columns.
pub(crate) fn soften(plane: &mut [f32], w: usize, h: usize, sigma: f32) {
    let mut kernel = [0f32; 7];
    for (i, k) in kernel.iter_mut().enumerate() {
        *k = (-0.5 * ((i as f32 - 3.0) / sigma).powi(2)).exp();
    }
    let total: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= total);
    let mut line = vec![0.0; w + 6];
    for row in plane.chunks_exact_mut(w) {
        line[3..w + 3].copy_from_slice(row);
        for i in 0..3 {
            line[i] = row[0];
            line[w + 3 + i] = row[w - 1];
        }
        for (x, out) in row.iter_mut().enumerate() {
            *out = kernel.iter().zip(&line[x..x + 7]).map(|(k, v)| k * v).sum();
        }
    }
    let source = plane.to_vec();
    for y in 0..h {
        let out = &mut plane[y * w..(y + 1) * w];
        out.fill(0.0);
        for (i, k) in kernel.iter().enumerate() {
            let from = (y + i).saturating_sub(3).min(h - 1);
            for (o, v) in out.iter_mut().zip(&source[from * w..(from + 1) * w]) {
                *o += k * v;
            }
        }
    }
}

/// Averages five points of the path of the image during exposure.
fn smear(plane: &mut [f32], w: usize, h: usize, path: [f32; 2]) {
    let source = plane.to_vec();
    plane.fill(0.0);
    for step in -2i32..=2 {
        let (dx, dy) = (path[0] * 0.25 * step as f32, path[1] * 0.25 * step as f32);
        let (fx, fy) = (dx.floor(), dy.floor());
        let (tx, ty) = (dx - fx, dy - fy);
        let clamp = |v: isize, n: usize| v.clamp(0, n as isize - 1) as usize;
        for y in 0..h {
            let upper = clamp(y as isize + fy as isize, h) * w;
            let lower = clamp(y as isize + fy as isize + 1, h) * w;
            for x in 0..w {
                let left = clamp(x as isize + fx as isize, w);
                let right = clamp(x as isize + fx as isize + 1, w);
                let top = source[upper + left] * (1.0 - tx) + source[upper + right] * tx;
                let bottom = source[lower + left] * (1.0 - tx) + source[lower + right] * tx;
                plane[y * w + x] += 0.2 * (top * (1.0 - ty) + bottom * ty);
            }
        }
    }
}

/// Over-bright light spreads over tens of pixels: computed at an eighth of the size.
fn bloom(plane: &mut [f32], w: usize, h: usize, strength: f32) {
    let (sw, sh) = (w.div_ceil(8), h.div_ceil(8));
    let mut small = vec![0f32; sw * sh];
    for y in 0..h {
        for x in 0..w {
            small[y / 8 * sw + x / 8] += (plane[y * w + x] - 0.8).max(0.0) / 64.0;
        }
    }
    soften(&mut small, sw, sh, 1.6);
    for y in 0..h {
        let fy = ((y as f32 + 0.5) / 8.0 - 0.5).clamp(0.0, (sh - 1) as f32);
        let (y0, ty) = (fy as usize, fy.fract());
        let y1 = (y0 + 1).min(sh - 1);
        for x in 0..w {
            let fx = ((x as f32 + 0.5) / 8.0 - 0.5).clamp(0.0, (sw - 1) as f32);
            let (x0, tx) = (fx as usize, fx.fract());
            let x1 = (x0 + 1).min(sw - 1);
            let top = small[y0 * sw + x0] * (1.0 - tx) + small[y0 * sw + x1] * tx;
            let bottom = small[y1 * sw + x0] * (1.0 - tx) + small[y1 * sw + x1] * tx;
            plane[y * w + x] += strength * (top * (1.0 - ty) + bottom * ty);
        }
    }
}

/// Bilinear demosaicing of RGGB.
fn demosaic(raw: &[f32], planes: &mut [Vec<f32>; 3], w: usize, h: usize) {
    for y in 0..h {
        // Mirrored at the border, so that the colour of the neighbour is right there too.
        let up = if y == 0 { 1 } else { y - 1 } * w;
        let down = if y + 1 == h { h - 2 } else { y + 1 } * w;
        let here = y * w;
        for x in 0..w {
            let left = if x == 0 { 1 } else { x - 1 };
            let right = if x + 1 == w { w - 2 } else { x + 1 };
            let own = raw[here + x];
            let cross = || 0.25 * (raw[up + x] + raw[down + x] + raw[here + left] + raw[here + right]);
            let corners = || 0.25 * (raw[up + left] + raw[up + right] + raw[down + left] + raw[down + right]);
            let rows = || 0.5 * (raw[here + left] + raw[here + right]);
            let columns = || 0.5 * (raw[up + x] + raw[down + x]);
            let [r, g, b] = match (y & 1, x & 1) {
                (0, 0) => [own, cross(), corners()],
                (0, _) => [rows(), own, columns()],
                (_, 0) => [columns(), own, rows()],
                _ => [corners(), cross(), own],
            };
            planes[0][here + x] = r;
            planes[1][here + x] = g;
            planes[2][here + x] = b;
        }
    }
}

/// Adds the difference to the mean of the eight neighbours, limited as cameras do.
fn sharpen(planes: &[Vec<f32>; 3], w: usize, h: usize, strength: f32, out: &mut [u8]) {
    for (c, plane) in planes.iter().enumerate() {
        for y in 0..h {
            let rows = [y.saturating_sub(1), y, (y + 1).min(h - 1)].map(|r| &plane[r * w..(r + 1) * w]);
            for x in 0..w {
                let (l, r) = (x.saturating_sub(1), (x + 1).min(w - 1));
                let sum: f32 = rows.iter().map(|row| row[l] + row[x] + row[r]).sum();
                let own = rows[1][x];
                let detail = (own - sum / 9.0) * 1.8 * strength;
                out[(y * w + x) * 3 + c] = (own + detail.clamp(-40.0, 40.0) + 0.5).clamp(0.0, 255.0) as u8;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worse_optics_make_a_point_wider_and_flat_grey_noisier() {
        let (w, h) = (48, 48);
        let of = |optics: Optics| {
            let sensor = Sensor::random(&mut Rng::new(3, 0), 0.03).with_optics(optics);
            let light = vec![V3::default(); w * h];
            let (ids, depth, traces) = (Vec::new(), Vec::new(), Vec::new());
            let mut film = Film { width: w, height: h, light, ids, depth, traces };
            let spread = |film: &Film, sensor: &Sensor| sensor.develop(film, 1.0, &mut Rng::new(5, 0));
            film.light.fill(crate::vec3::v3(0.3, 0.3, 0.3));
            let grey = spread(&film, &sensor);
            let mean = grey.iter().map(|x| f64::from(*x)).sum::<f64>() / grey.len() as f64;
            let noise = grey.iter().map(|x| (f64::from(*x) - mean).powi(2)).sum::<f64>() / grey.len() as f64;
            film.light.fill(V3::default());
            film.light[24 * w + 24] = crate::vec3::v3(8.0, 8.0, 8.0);
            let silent = Sensor { noise: 0.0, read: 0.0, mosaic: false, ..sensor };
            let lit = spread(&film, &silent).chunks_exact(3).filter(|px| px[1] > 20).count();
            (noise, lit)
        };
        let [sharp, usual, blurred] = [Optics::Sharp, Optics::Usual, Optics::Blurred].map(of);
        assert!(sharp.0 < usual.0 && usual.0 < blurred.0, "{sharp:?}, {usual:?}, {blurred:?}");
        assert!(sharp.1 < usual.1 && 2 * usual.1 < blurred.1, "{sharp:?}, {usual:?}, {blurred:?}");
    }
}
