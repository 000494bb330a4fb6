//! The paper's way (eqs. 5-11): the eight crossings D1-D8 of stripes and edges, each triangulated on its laser plane, four
//! edges through pairs of them, corners where edges meet, sides between corners.

use crate::calibration::Calibration;
use crate::edges::EdgePoint;
use crate::face::extent::FaceStripes;
use crate::face::outline::SIDES;
use crate::frames::{Cam, Point, Ray};
use crate::rectangle::KeyPointSides;
use crate::rectangle::refine::FittedRectangle;
use crate::statistics::robust_sigma;
use crate::units::{LaserId, Px};
use nalgebra::{Matrix3, Vector3};

/// Localisation of a key point (the paper reports 1.96 px for its network's key points; PHYSICS.md). More makes sigmas larger.
#[derive(Clone, Copy, Debug)]
struct KeyPointSettings {
    /// Along its stripe, that of a fitted edge, px.
    edge_sigma_px: f64,
    /// Across it, that of a fitted stripe at its end, px.
    stripe_sigma_px: f64,
}

impl KeyPointSettings {
    const DEFAULT: Self = Self { edge_sigma_px: 0.5, stripe_sigma_px: 0.15 };
}

impl Default for KeyPointSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// The sides from the eight key points alone.
pub(crate) fn measure(
    calibration: &Calibration,
    face: &FaceStripes,
    fit: &FittedRectangle,
    edges: &[Vec<EdgePoint>; 4],
) -> Option<KeyPointSides> {
    let ray = |px: Px| calibration.camera().ray_from_px(px).xy1;
    let of_stripe = |id| line_through(&face.centres(id).map(|o| ray(o.at)).collect::<Vec<_>>());
    let stripe_lines = LaserId::ALL.into_iter().map(of_stripe).collect::<Option<Vec<_>>>()?;
    let of_edge = |(points, used): (&Vec<EdgePoint>, &Vec<bool>)| {
        let used = points.iter().zip(used).filter(|(_, used)| **used);
        line_through(&used.map(|(p, _)| ray(p.at)).collect::<Vec<_>>())
    };
    let edge_lines = edges.iter().zip(&fit.edge_inliers).map(of_edge).collect::<Option<Vec<_>>>()?;
    // D_i: crossing in the ideal image, depth from its laser plane (eqs. 5-8).
    let key_point = |side: usize, id: LaserId, shift_px: (f64, f64)| -> Option<Vector3<f64>> {
        let x = stripe_lines[id.index()].cross(&edge_lines[side]);
        if x.z.abs() < 1e-12 {
            return None;
        }
        let px = calibration.camera().px_from_ray(&Ray::new(x.x / x.z, x.y / x.z))?;
        let ray = calibration.camera().ray_from_px(Px::new(px.u + shift_px.0, px.v + shift_px.1));
        calibration.laser(id).intersect(&ray).map(|p| p.mm)
    };
    let sides_of = |shift_px: &dyn Fn(usize, usize) -> (f64, f64)| -> Option<[f64; 2]> {
        let mut lines = Vec::with_capacity(4);
        for (side, (across, _)) in SIDES.iter().enumerate() {
            let [i, j] = across.stripes();
            let p = key_point(side, i, shift_px(side, 0))?;
            let q = key_point(side, j, shift_px(side, 1))?;
            lines.push((p, (q - p).try_normalize(1e-9)?));
        }
        let corner = |a: usize, b: usize| nearest_to_both(&lines[a], &lines[b]);
        let corners = [corner(0, 2)?, corner(1, 2)?, corner(1, 3)?, corner(0, 3)?];
        // Each side twice, from its two edges (eq. 9).
        let distance = |i: usize, j: usize| corners[i].distance_mm(&corners[j]);
        Some([0.5 * (distance(0, 1) + distance(3, 2)), 0.5 * (distance(1, 2) + distance(0, 3))])
    };
    let sides_mm = sides_of(&|_, _| (0.0, 0.0))?;
    // Every key point moved along its stripe (where the edge lies) and across it (where the stripe lies), one at a time.
    let d = fit.key_points_px(calibration)?;
    let KeyPointSettings { edge_sigma_px: edge, stripe_sigma_px: stripe } = KeyPointSettings::DEFAULT;
    let mut variances_mm2 = [0.0; 2];
    for side in 0..4 {
        for end in 0..2 {
            let [from, to] = d[SIDES[side].0.stripes()[end].index()];
            let length = from.distance_px(to).max(1.0);
            let (u, v) = ((to.u - from.u) / length, (to.v - from.v) / length);
            for step_px in [(u * edge, v * edge), (-v * stripe, u * stripe)] {
                let moved = sides_of(&|s, e| if (s, e) == (side, end) { step_px } else { (0.0, 0.0) })?;
                for (v, (m, s)) in variances_mm2.iter_mut().zip(moved.iter().zip(sides_mm)) {
                    *v += (m - s).powi(2);
                }
            }
        }
    }
    sides_mm.iter().all(|s| s.is_finite() && *s > 0.0).then_some(KeyPointSides { sides_mm, variances_mm2 })
}

/// The line through many rays of the ideal image, total least squares with one round of outlier removal.
fn line_through(rays: &[Vector3<f64>]) -> Option<Vector3<f64>> {
    let fit = |keep: &dyn Fn(&Vector3<f64>) -> bool| {
        let (mut n, mut mean) = (0.0, Vector3::zeros());
        for r in rays.iter().filter(|r| keep(r)) {
            mean += r;
            n += 1.0;
        }
        if n < 4.0 {
            return None;
        }
        mean /= n;
        let mut scatter = Matrix3::zeros();
        for r in rays.iter().filter(|r| keep(r)) {
            let d = r - mean;
            scatter += d * d.transpose();
        }
        let direction_angle = 0.5 * (2.0 * scatter[(0, 1)]).atan2(scatter[(0, 0)] - scatter[(1, 1)]);
        let (s, c) = direction_angle.sin_cos();
        Some(Vector3::new(-s, c, s * mean.x - c * mean.y))
    };
    let first = fit(&|_| true)?;
    let limit = 3.0 * robust_sigma(rays.iter().map(|r| first.dot(r)))?.max(1e-6);
    fit(&|r| first.dot(r).abs() <= limit)
}

/// The point nearest to two lines in space (they miss each other by noise).
fn nearest_to_both(
    (p, d): &(Vector3<f64>, Vector3<f64>),
    (q, e): &(Vector3<f64>, Vector3<f64>),
) -> Option<Point<Cam>> {
    let (b, w) = (d.dot(e), p - q);
    let denominator = 1.0 - b * b;
    if denominator < 1e-6 {
        return None;
    }
    let s = (b * e.dot(&w) - d.dot(&w)) / denominator;
    let t = (e.dot(&w) - b * d.dot(&w)) / denominator;
    Some(Point::from_vector(0.5 * (p + d * s + q + e * t)))
}
