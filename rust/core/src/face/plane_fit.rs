//! The plane on which all stripe pixels lie: `(q - p_k) . x = 0` for a pixel with ray x on the stripe of laser k, linear
//! in the plane q (physics.md). Weighted so that residuals are pixels, re-weighted so that outliers do not count.

use crate::calibration::Calibration;
use crate::frames::{Cam, Plane};
use crate::units::{LaserId, Px};
use nalgebra::{Matrix3, Vector3};

/// One stripe centre with its laser and standard deviation across the stripe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StripeObservation {
    pub laser: LaserId,
    pub at: Px,
    pub sigma_px: f64,
}

/// A fitted plane.
#[derive(Clone, Debug)]
pub(crate) struct PlaneFit {
    pub plane: Plane<Cam>,
    /// Root mean square of the residuals of the inliers, px across the stripe.
    pub rms_px: f64,
    /// Robust scatter of all residuals, in sigmas.
    pub scale: f64,
}

/// Tukey's constant: 95 % efficiency for normal residuals.
const TUKEY: f64 = 4.685;
const ITERATIONS: usize = 12;

/// Distance of a stripe pixel from the line that a plane predicts, px, and the factor from `(q - p) . x` to px.
pub(crate) fn stripe_residual_px(
    calibration: &Calibration,
    plane: &Plane<Cam>,
    laser: LaserId,
    at: Px,
) -> Option<(f64, f64, Vector3<f64>)> {
    let (ray, jacobian) = calibration.camera().ray_from_px_with_jacobian(at);
    let line = plane.per_mm - calibration.laser(laser).per_mm;
    let gradient = (jacobian.transpose() * line.xy()).norm();
    (gradient > 1e-12).then(|| (line.dot(&ray.xy1) / gradient, 1.0 / gradient, ray.xy1))
}

/// Robust maximum-likelihood fit, starting from `start`. `None` if the observations do not fix a plane.
pub(crate) fn fit_plane(
    calibration: &Calibration,
    observations: &[StripeObservation],
    start: &Plane<Cam>,
) -> Option<PlaneFit> {
    if observations.len() < 12 {
        return None;
    }
    let mut plane = *start;
    let mut residuals = vec![(0.0, 0.0, Vector3::zeros()); observations.len()];
    let mut scale = f64::INFINITY;
    for iteration in 0..ITERATIONS {
        for (r, o) in residuals.iter_mut().zip(observations) {
            *r = stripe_residual_px(calibration, &plane, o.laser, o.at)?;
        }
        let mut sizes: Vec<f64> =
            residuals.iter().zip(observations).map(|(r, o)| (r.0 / o.sigma_px).abs()).collect();
        let middle = sizes.len() / 2;
        scale = (*sizes.select_nth_unstable_by(middle, f64::total_cmp).1 / 0.6745).max(0.3);
        let mut normal = Matrix3::zeros();
        let mut right = Vector3::zeros();
        for ((_, per_px, x), o) in residuals.iter().zip(observations) {
            let line_value = (plane.per_mm - calibration.laser(o.laser).per_mm).dot(x);
            let t = line_value * per_px / (o.sigma_px * scale * TUKEY);
            // The first step takes all points with bounded influence; the start may be some px off.
            let robust = if iteration == 0 { 1.0 / (1.0 + t.abs()) } else { (1.0 - t * t).max(0.0).powi(2) };
            let weight = robust * (per_px / o.sigma_px).powi(2);
            normal += x * x.transpose() * weight;
            right += x * (weight * calibration.laser(o.laser).per_mm.dot(x));
        }
        let next = normal.cholesky()?.solve(&right);
        let change = (next - plane.per_mm).norm() / next.norm();
        plane = Plane::new(next);
        if change < 1e-9 {
            break;
        }
    }
    let (mut sum, mut count) = (0.0, 0.0);
    for o in observations {
        let (r, _, _) = stripe_residual_px(calibration, &plane, o.laser, o.at)?;
        if r.abs() < TUKEY * scale * o.sigma_px {
            sum += r * r;
            count += 1.0;
        }
    }
    let rms_px = (sum / f64::max(count, 1.0)).sqrt();
    plane.per_mm.iter().all(|v| v.is_finite()).then_some(PlaneFit { plane, rms_px, scale })
}
