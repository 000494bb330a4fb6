//! The edges of a face: where along a direction a straight edge lies ([`side_scan`]), and its course found by gradients
//! along the predicted normals ([`subpixel`]) or by the paper's edge map and Hough transform ([`map`], [`hough`]).

pub(crate) mod hough;
pub(crate) mod map;
pub(crate) mod side_scan;
pub(crate) mod subpixel;

use crate::calibration::Calibration;
use crate::face::outline::RoughRectangle;
use crate::image::Frame;
use crate::units::Px;

/// A point on a side of the face.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgePoint {
    pub at: Px,
    /// Standard deviation across the side, px.
    pub sigma_px: f64,
}

/// Finds the points of the four sides near a rough rectangle. `keep_out` are places with a radius (px) where laser light
/// disturbs.
pub(crate) trait EdgeDetector {
    /// Edge points per side, in the order of [`crate::face::outline::SIDES`].
    fn edge_points(
        &self,
        frame: &Frame,
        calibration: &Calibration,
        rough: &RoughRectangle,
        keep_out: &[(Px, f64)],
    ) -> [Vec<EdgePoint>; 4];
}

/// Brightness for edges, grey levels: green and blue, where the red laser hardly shows.
#[inline]
pub(crate) fn brightness(frame: &Frame, u: f64, v: f64) -> Option<f32> {
    let (w, h) = (frame.width_px(), frame.height_px());
    if !(u >= 0.0 && v >= 0.0) {
        return None;
    }
    let (x, y) = (u as usize, v as usize);
    if x + 1 >= w || y + 1 >= h {
        return None;
    }
    let (fu, fv) = ((u - x as f64) as f32, (v - y as f64) as f32);
    let rgb = frame.rgb();
    let at = |x: usize, y: usize| {
        let i = (y * w + x) * 3;
        0.5 * (f32::from(rgb[i + 1]) + f32::from(rgb[i + 2]))
    };
    let top = at(x, y) * (1.0 - fu) + at(x + 1, y) * fu;
    let bottom = at(x, y + 1) * (1.0 - fu) + at(x + 1, y + 1) * fu;
    Some(top * (1.0 - fv) + bottom * fv)
}

/// Brightness at half resolution, grey levels.
pub(crate) fn brightness_half(frame: &Frame) -> (usize, usize, Vec<f32>) {
    let (w, h) = (frame.width_px() / 2, frame.height_px() / 2);
    let stride = frame.width_px() * 3;
    let mut out = vec![0f32; w * h];
    for (j, row) in out.chunks_exact_mut(w.max(1)).enumerate() {
        let top = &frame.rgb()[2 * j * stride..][..w * 6];
        let bottom = &frame.rgb()[(2 * j + 1) * stride..][..w * 6];
        for ((o, t), b) in row.iter_mut().zip(top.chunks_exact(6)).zip(bottom.chunks_exact(6)) {
            let sum: u16 =
                [t[1], t[2], t[4], t[5], b[1], b[2], b[4], b[5]].iter().map(|x| u16::from(*x)).sum();
            *o = f32::from(sum) / 8.0;
        }
    }
    (w, h, out)
}
