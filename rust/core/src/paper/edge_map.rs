//! Edge maps for the paper's chain, thinned to ridges: a network's map, or, without a network, the gradient of the tone at half
//! resolution in units of its noise.

use crate::edges::noise_of;
use crate::image::Frame;
use crate::network::MapView;
use crate::units::Px;

/// A pixel of the thinned map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgePixel {
    /// Sub-pixel position, full-resolution px.
    pub at: Px,
    /// Direction of the gradient (the edge's normal), rad in (-pi, pi].
    pub normal_rad: f32,
}

/// Which pixels are an edge's.
#[derive(Clone, Copy, Debug)]
pub(super) struct EdgeMapSettings {
    /// Weakest gradient that counts, in units of the median gradient's sigma: after smoothing, texture seldom exceeds it, and
    /// what does is not straight. More loses faint edges.
    least_sigmas: f32,
    /// Least noise, grey levels per half-resolution px: JPEG's own step. More loses faint edges of clean pictures.
    noise_floor: f32,
    /// Probability from which a pixel of a network's map counts: half of what a certain edge has. More loses edges that the network doubts.
    pub least_probability: f32,
}

impl EdgeMapSettings {
    pub const DEFAULT: Self = Self { least_sigmas: 2.0, noise_floor: 0.1, least_probability: 0.4 };
}

impl Default for EdgeMapSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// All ridge pixels of the gradient magnitude.
pub(crate) fn edge_pixels(frame: &Frame) -> Vec<EdgePixel> {
    let EdgeMapSettings { least_sigmas, noise_floor, .. } = EdgeMapSettings::DEFAULT;
    let (w, h, planes) = tone_half(frame);
    let mut magnitude = vec![0f32; w * h];
    let mut gradient = vec![(0f32, 0f32); w * h];
    for plane in planes {
        add_gradients(w, h, &smoothed(w, h, &plane), noise_floor, &mut gradient, &mut magnitude);
    }
    let mut pixels = Vec::new();
    for y in 2..h.saturating_sub(2) {
        for x in 2..w.saturating_sub(2) {
            let i = y * w + x;
            let m = magnitude[i];
            if m < least_sigmas {
                continue;
            }
            let (gx, gy) = gradient[i];
            // Neighbours along the gradient, to the nearest of eight directions.
            let (dx, dy) = ((gx / m).round() as isize, (gy / m).round() as isize);
            let step = dy * w as isize + dx;
            let before = magnitude[(i as isize - step) as usize];
            let after = magnitude[(i as isize + step) as usize];
            if m < before || m <= after {
                continue;
            }
            let shift = f64::from(0.5 * (before - after) / (before + after - 2.0 * m));
            let half = (x as f64 + shift * dx as f64, y as f64 + shift * dy as f64);
            pixels.push(EdgePixel {
                // Half-resolution pixel i covers full pixels 2i and 2i + 1.
                at: Px::new(2.0 * half.0 + 0.5, 2.0 * half.1 + 0.5),
                normal_rad: gy.atan2(gx),
            });
        }
    }
    pixels
}

/// All ridge pixels of a network's map.
pub(crate) fn edge_pixels_of_map(map: MapView<'_>) -> Vec<EdgePixel> {
    let least_probability = EdgeMapSettings::DEFAULT.least_probability;
    let [w, h] = map.size();
    let at = |x: usize, y: usize| map.values[y * w + x];
    let mut pixels = Vec::new();
    for y in 2..h.saturating_sub(2) {
        for x in 2..w.saturating_sub(2) {
            let m = at(x, y);
            if m < least_probability {
                continue;
            }
            // Across a ridge the second derivative is most negative: at a right angle to its largest value.
            let xx = at(x + 1, y) + at(x - 1, y) - 2.0 * m;
            let yy = at(x, y + 1) + at(x, y - 1) - 2.0 * m;
            let xy = 0.25 * (at(x + 1, y + 1) + at(x - 1, y - 1) - at(x + 1, y - 1) - at(x - 1, y + 1));
            let normal_rad = 0.5 * (2.0 * xy).atan2(xx - yy) + std::f32::consts::FRAC_PI_2;
            let (dx, dy) = (normal_rad.cos().round() as isize, normal_rad.sin().round() as isize);
            let neighbour =
                |sign: isize| at((x as isize + sign * dx) as usize, (y as isize + sign * dy) as usize);
            let (before, after) = (neighbour(-1), neighbour(1));
            if m < before || m <= after {
                continue;
            }
            let shift = f64::from(0.5 * (before - after) / (before + after - 2.0 * m));
            let place = (x as f64 + shift * dx as f64, y as f64 + shift * dy as f64);
            pixels.push(EdgePixel { at: map.px_from_raster(place.0, place.1), normal_rad });
        }
    }
    pixels
}

/// The tone at half resolution, one plane a channel.
fn tone_half(frame: &Frame) -> (usize, usize, [Vec<f32>; 2]) {
    let (w, h) = (frame.width_px() / 2, frame.height_px() / 2);
    let stride = frame.width_px() * 3;
    let mut planes = [vec![0f32; w * h], vec![0f32; w * h]];
    for j in 0..h {
        let top = &frame.rgb()[2 * j * stride..][..w * 6];
        let bottom = &frame.rgb()[(2 * j + 1) * stride..][..w * 6];
        for (i, (t, b)) in top.chunks_exact(6).zip(bottom.chunks_exact(6)).enumerate() {
            let sum = |c: usize| [t[c], t[c + 3], b[c], b[c + 3]].iter().map(|x| f32::from(*x)).sum::<f32>();
            let (red, green, blue) = (sum(0), sum(1), sum(2));
            planes[0][j * w + i] = (green + blue) / 8.0;
            planes[1][j * w + i] = (red - blue) / 8.0;
        }
    }
    (w, h, planes)
}

/// Binomial smoothing with 5 x 5 weights (sigma 1 px).
fn smoothed(w: usize, h: usize, plane: &[f32]) -> Vec<f32> {
    let blur = |v: &dyn Fn(isize) -> f32| (v(-2) + v(2) + 4.0 * (v(-1) + v(1)) + 6.0 * v(0)) / 16.0;
    let mut rows = vec![0f32; w * h];
    for y in 0..h {
        let row = &plane[y * w..][..w];
        for (x, out) in rows[y * w..][..w].iter_mut().enumerate() {
            *out = blur(&|d| row[(x as isize + d).clamp(0, w as isize - 1) as usize]);
        }
    }
    let mut result = vec![0f32; w * h];
    for y in 0..h {
        for x in 0..w {
            result[y * w + x] = blur(&|d| rows[(y as isize + d).clamp(0, h as isize - 1) as usize * w + x]);
        }
    }
    result
}

/// Keeps, at each pixel, the gradient that stands out most against its channel's noise.
fn add_gradients(
    w: usize,
    h: usize,
    plane: &[f32],
    noise_floor: f32,
    gradient: &mut [(f32, f32)],
    magnitude: &mut [f32],
) {
    // Central differences: the smoothing before is filter enough.
    let at = |x: usize, y: usize| {
        let i = y * w + x;
        (0.5 * (plane[i + 1] - plane[i - 1]), 0.5 * (plane[i + w] - plane[i - w]))
    };
    let inner = |n: usize| 1..n.saturating_sub(1);
    let mut sample: Vec<f32> = inner(h)
        .step_by(7)
        .flat_map(|y| inner(w).step_by(7).map(move |x| (x, y)))
        .map(|(x, y)| at(x, y).0.abs())
        .collect();
    let noise = noise_of(&mut sample, noise_floor);
    for y in inner(h) {
        for x in inner(w) {
            let (gx, gy) = at(x, y);
            let sigmas = gx.hypot(gy) / noise;
            if sigmas > magnitude[y * w + x] {
                magnitude[y * w + x] = sigmas;
                gradient[y * w + x] = (gx / noise, gy / noise);
            }
        }
    }
}
