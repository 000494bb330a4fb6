//! The classical edge map: gradient magnitude at half resolution, thinned to ridges. The place of the paper's network map.

use super::brightness_half;
use crate::image::Frame;
use crate::units::Px;

/// A pixel of the thinned map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgePixel {
    /// Sub-pixel position, full-resolution px.
    pub at: Px,
    /// Direction of the gradient (the edge's normal), rad in (-pi, pi].
    pub normal_rad: f32,
}

/// Weakest gradient that counts, grey levels per half-resolution px: cardboard texture reaches about 1.
const MIN_GRADIENT: f32 = 1.2;

/// All ridge pixels of the gradient magnitude.
pub(crate) fn edge_pixels(frame: &Frame) -> Vec<EdgePixel> {
    let (w, h, grey) = brightness_half(frame);
    let mut magnitude = vec![0f32; w * h];
    let mut gradient = vec![(0f32, 0f32); w * h];
    for y in 1..h.saturating_sub(1) {
        for x in 1..w.saturating_sub(1) {
            let at = |dx: usize, dy: usize| grey[(y + dy - 1) * w + x + dx - 1];
            // Sobel, normalised to grey levels per pixel.
            let gx = (at(2, 0) + 2.0 * at(2, 1) + at(2, 2) - at(0, 0) - 2.0 * at(0, 1) - at(0, 2)) / 8.0;
            let gy = (at(0, 2) + 2.0 * at(1, 2) + at(2, 2) - at(0, 0) - 2.0 * at(1, 0) - at(2, 0)) / 8.0;
            gradient[y * w + x] = (gx, gy);
            magnitude[y * w + x] = gx.hypot(gy);
        }
    }
    let mut pixels = Vec::new();
    for y in 2..h.saturating_sub(2) {
        for x in 2..w.saturating_sub(2) {
            let i = y * w + x;
            let m = magnitude[i];
            if m < MIN_GRADIENT {
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
