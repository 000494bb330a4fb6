//! The edges of a face: where along a direction a straight edge lies ([`side_scan`]), and its course found by gradients
//! along the predicted normals ([`subpixel`]); the paper's way to find it is in [`crate::paper`].

#[cfg(test)]
pub(crate) mod detector_tests;
mod line_tone;
pub(crate) mod side_scan;
pub(crate) mod subpixel;

use crate::calibration::Calibration;
use crate::face::outline::InitialRectangle;
use crate::image::Frame;
use crate::statistics::robust_sigma_f32;
use crate::units::Px;
use std::ops::{Add, Mul};
use std::sync::LazyLock;
use wide::f32x4;

/// A point on a side of the face.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgePoint {
    pub at: Px,
    /// Standard deviation across the side, px.
    pub sigma_px: f64,
}

/// Finds the points of the four sides near a initial rectangle. `keep_out` are places with a radius (px) where laser light
/// disturbs.
pub(crate) trait EdgeDetector {
    /// Edge points per side, in the order of [`crate::face::outline::SIDES`].
    fn edge_points(
        &self,
        frame: &Frame,
        calibration: &Calibration,
        initial: &InitialRectangle,
        keep_out: &[(Px, f64)],
    ) -> [Vec<EdgePoint>; 4];
}

/// What edges are seen in: brightness without red, where the laser hardly shows, and the colour difference red - blue,
/// which tells cardboard from grey floor of the same brightness. Grey levels.
pub(crate) type ColourTone = [f32; 2];

/// The tone at a sub-pixel position.
#[cfg(test)]
pub(crate) fn tone(frame: &Frame, u: f64, v: f64) -> Option<ColourTone> {
    let [brightness, hue, ..] = tones(frame, Palette::get(), u, v)?.to_array();
    Some([brightness, hue])
}

/// Linear light of each grey level, full scale 255. A blurred step lies where light is half way between its sides; the tone curve
/// moves that towards the dark side, by up to a pixel.
pub(crate) fn linear_light() -> &'static [f32; 256] {
    static LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| {
        std::array::from_fn(|level| {
            let c = level as f32 / 255.0;
            255.0 * if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
        })
    });
    &LINEAR
}

/// Least scatter of light that is believed, share of full scale of [`linear_light`]: a step of a byte in the middle of its range.
pub(crate) const LEAST_SCATTER: f32 = 0.004;

/// What each level of red, green and blue adds to the tone and to the same in [`linear_light`].
pub(crate) struct Palette([[f32x4; 256]; 3]);

impl Palette {
    /// The only one.
    pub fn get() -> &'static Self {
        static PALETTE: LazyLock<Palette> = LazyLock::new(|| {
            // Brightness and hue of red, green and blue.
            Palette([[0.0, 0.5], [0.5, 0.0], [0.5, -0.5]].map(|[brightness, hue]| {
                std::array::from_fn(|level| {
                    let (grey, light) = (level as f32, linear_light()[level]);
                    f32x4::from([brightness * grey, hue * grey, brightness * light, hue * light])
                })
            }))
        });
        &PALETTE
    }
}

/// The tone at a sub-pixel position, and the same in [`linear_light`].
#[inline]
pub(crate) fn tones(frame: &Frame, palette: &Palette, u: f64, v: f64) -> Option<f32x4> {
    let [reds, greens, blues] = &palette.0;
    sampled(frame, u, v, |[red, green, blue]| {
        reds[usize::from(red)] + greens[usize::from(green)] + blues[usize::from(blue)]
    })
}

/// Brightness without red at a sub-pixel position, in [`linear_light`].
#[inline]
pub(crate) fn light(frame: &Frame, linear: &[f32; 256], u: f64, v: f64) -> Option<f32> {
    let of = |[_, green, blue]: [u8; 3]| 0.5 * (linear[usize::from(green)] + linear[usize::from(blue)]);
    sampled(frame, u, v, of)
}

/// `R - (G + B) / 2` at a sub-pixel position, grey levels: where laser light is.
#[inline]
pub(crate) fn laser_response(frame: &Frame, u: f64, v: f64) -> Option<f32> {
    let of = |[red, green, blue]: [u8; 3]| f32::from(red) - 0.5 * (f32::from(green) + f32::from(blue));
    sampled(frame, u, v, of)
}

/// What a pixel tells, at a sub-pixel position, bilinear.
#[inline]
fn sampled<T: Copy + Add<Output = T> + Mul<f32, Output = T>>(
    frame: &Frame,
    u: f64,
    v: f64,
    sample: impl Fn([u8; 3]) -> T,
) -> Option<T> {
    let (w, h) = (frame.width_px(), frame.height_px());
    if !(u >= 0.0 && v >= 0.0) {
        return None;
    }
    // Through 32 bits: one instruction, where a cast to usize takes several.
    let (x, y) = (u as u32, v as u32);
    let (fu, fv) = ((u - f64::from(x)) as f32, (v - f64::from(y)) as f32);
    let (x, y) = (x as usize, y as usize);
    if x + 1 >= w || y + 1 >= h {
        return None;
    }
    let rows = [y, y + 1].map(|row| frame.rgb().get((row * w + x) * 3..(row * w + x) * 3 + 6));
    let [Some(top), Some(bottom)] = rows else { return None };
    let sample = |p: &[u8], weight: f32| sample([p[0], p[1], p[2]]) * weight;
    let top = sample(&top[..3], (1.0 - fu) * (1.0 - fv)) + sample(&top[3..], fu * (1.0 - fv));
    Some(top + sample(&bottom[..3], (1.0 - fu) * fv) + sample(&bottom[3..], fu * fv))
}

/// Scale of zero-mean noise from the median of its absolute values; `floor` where the picture is flat.
pub(crate) fn noise_of(absolute: &mut [f32], floor: f32) -> f32 {
    robust_sigma_f32(absolute).map_or(floor, |sigma| sigma.max(floor))
}
