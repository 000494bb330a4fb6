//! The plane on which all stripe pixels lie: `(q - p_k) . x = 0` for a pixel with ray x on the stripe of laser k, linear
//! in the plane q (PHYSICS.md). Weighted so that residuals are pixels, re-weighted so that outliers do not count.

use crate::calibration::Calibration;
use crate::camera::CameraModel;
use crate::frames::{Cam, Plane, Ray};
use crate::statistics::{TUKEY, robust_sigma, tukey_weight};
use crate::units::{LaserId, Px};
use nalgebra::{Matrix2, Matrix3, Vector3};

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

/// How the plane is fitted. No record says how these values were chosen.
#[derive(Clone, Copy, Debug)]
struct PlaneFitSettings {
    /// Fewest centres. More refuses faces of which little is lit, fewer leave less to tell outliers by.
    least_centres: usize,
    /// Steps at most. More takes longer where weights do not settle.
    steps: usize,
    /// Least robust scatter that is believed, in sigmas of the centres. More lets outliers in.
    least_scale: f64,
    /// A change of the plane by this share ends the fit: far less than any number of a result. More ends it before it has settled.
    settled: f64,
}

impl PlaneFitSettings {
    const DEFAULT: Self = Self { least_centres: 12, steps: 12, least_scale: 0.3, settled: 1e-9 };
}

impl Default for PlaneFitSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What the camera tells of a pixel, whatever the plane: its ray and the ray's derivative by it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PxView {
    pub ray: Ray<Cam>,
    by_px: Matrix2<f64>,
}

impl PxView {
    pub fn new(camera: &CameraModel, at: Px) -> Self {
        let (ray, by_px) = camera.ray_from_px_with_jacobian(at);
        Self { ray, by_px }
    }

    /// The factor from `line . x` to px across the line.
    pub fn factor_px(&self, line: &Vector3<f64>) -> Option<f64> {
        let gradient = (self.by_px.transpose() * line.xy()).norm();
        (gradient > 1e-12 && gradient.is_finite()).then_some(1.0 / gradient)
    }
}

/// Distance of a stripe pixel from the line that a plane predicts, px, and the factor from `(q - p) . x` to px.
pub(crate) fn residual_px(
    calibration: &Calibration,
    plane: &Plane<Cam>,
    laser: LaserId,
    view: &PxView,
) -> Option<(f64, f64)> {
    let line = plane.per_mm - calibration.laser(laser).per_mm;
    view.factor_px(&line).map(|factor_px| (line.dot(&view.ray.xy1) * factor_px, factor_px))
}

/// Robust maximum-likelihood fit, starting from `start`. `None` if the observations do not fix a plane.
pub(crate) fn fit_plane(
    calibration: &Calibration,
    observations: &[StripeObservation],
    start: &Plane<Cam>,
) -> Option<PlaneFit> {
    let PlaneFitSettings { least_centres, steps, least_scale, settled } = PlaneFitSettings::DEFAULT;
    if observations.len() < least_centres {
        return None;
    }
    let mut plane = *start;
    let views: Vec<PxView> = observations.iter().map(|o| PxView::new(calibration.camera(), o.at)).collect();
    let mut residuals = vec![(0.0, 0.0); observations.len()];
    let mut scale = f64::INFINITY;
    for iteration in 0..steps {
        for ((r, o), view) in residuals.iter_mut().zip(observations).zip(&views) {
            *r = residual_px(calibration, &plane, o.laser, view)?;
        }
        let in_sigmas = residuals.iter().zip(observations).map(|(r, o)| r.0 / o.sigma_px);
        scale = robust_sigma(in_sigmas)?.max(least_scale);
        let mut normal = Matrix3::zeros();
        let mut right = Vector3::zeros();
        for (((px, per_px), o), view) in residuals.iter().zip(observations).zip(&views) {
            let x = &view.ray.xy1;
            let t = px / (o.sigma_px * scale);
            // The first step takes all points with bounded influence; the start may be some px off.
            let robust = if iteration == 0 { 1.0 / (1.0 + t.abs() / TUKEY) } else { tukey_weight(t) };
            let weight = robust * (per_px / o.sigma_px).powi(2);
            normal += x * x.transpose() * weight;
            right += x * (weight * calibration.laser(o.laser).per_mm.dot(x));
        }
        let next = normal.cholesky()?.solve(&right);
        let change = (next - plane.per_mm).norm() / next.norm();
        plane = Plane::new(next);
        if change < settled {
            break;
        }
    }
    let (mut sum, mut count) = (0.0, 0.0);
    for (o, view) in observations.iter().zip(&views) {
        let (r, _) = residual_px(calibration, &plane, o.laser, view)?;
        if r.abs() < TUKEY * scale * o.sigma_px {
            sum += r * r;
            count += 1.0;
        }
    }
    let rms_px = (sum / f64::max(count, 1.0)).sqrt();
    plane.per_mm.iter().all(|v| v.is_finite()).then_some(PlaneFit { plane, rms_px, scale })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::Ray;
    use crate::paper_head::paper_head;
    use proptest::prelude::*;

    /// Normal noise of sigma 1 from a seed (Box and Muller); a test must not depend on luck.
    struct Noise(u64);

    impl Noise {
        fn uniform(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((self.0 >> 11) as f64 + 0.5) / (1u64 << 53) as f64
        }

        fn normal(&mut self) -> f64 {
            (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
        }
    }

    /// Stripe centres on `plane`, every 8 px of 400 px to both sides of the image's middle, `sigma_px` across.
    fn stripes(
        calibration: &Calibration,
        plane: &Plane<Cam>,
        sigma_px: f64,
        noise: &mut Noise,
    ) -> Vec<StripeObservation> {
        let mut observations = Vec::new();
        for laser in LaserId::ALL {
            let line = plane.per_mm - calibration.laser(laser).per_mm;
            for step in -50..=50 {
                let x = f64::from(step) * 8.0 / 2450.0;
                let y = -(line.x * x + line.z) / line.y;
                let px = calibration.camera().px_from_ray(&Ray::new(x, y)).expect("near the axis");
                let (_, jacobian) = calibration.camera().ray_from_px_with_jacobian(px);
                let across = (jacobian.transpose() * line.xy()).normalize() * (sigma_px * noise.normal());
                let at = Px::new(px.u + across.x, px.v + across.y);
                observations.push(StripeObservation { laser, at, sigma_px: sigma_px.max(0.01) });
            }
        }
        observations
    }

    /// Planes that the head can see: 0.4 to 2.4 m away, tilted by up to 40 degrees.
    fn planes() -> impl Strategy<Value = Plane<Cam>> {
        (-0.6..0.6, -0.6..0.6, 400.0..2400.0)
            .prop_map(|(x, y, depth_mm)| Plane::new(Vector3::new(x, y, 1.0) / depth_mm))
    }

    /// Differences of the depth that two planes give to points across the face, mm, worst.
    fn depth_error_mm(plane: &Plane<Cam>, truth: &Plane<Cam>) -> f64 {
        let depth = |p: &Plane<Cam>, x: f64, y: f64| 1.0 / p.inverse_depth_per_mm(&Ray::new(x, y));
        [(0.0, 0.0), (0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.0, -0.1)]
            .map(|(x, y)| (depth(plane, x, y) - depth(truth, x, y)).abs())
            .into_iter()
            .fold(0.0, f64::max)
    }

    /// Standard deviation of the depth at a ray that `count` centres of `sigma_px` allow, mm, at most: 1 px moves the depth
    /// by z^2 / (f base), base = distance of the lasers from the camera (about 100 mm), and 4 stripes share the work.
    fn allowed_mm(depth_mm: f64, sigma_px: f64, count: usize) -> f64 {
        let per_px = depth_mm * depth_mm / (2450.0 * 90.0);
        1.5 * sigma_px * per_px * (40.0 / count as f64).sqrt()
    }

    proptest! {
        #[test]
        fn noiseless_stripes_give_their_plane(truth in planes(), tilt in -0.05..0.05f64) {
            let calibration = paper_head(1.0);
            let observations = stripes(&calibration, &truth, 0.0, &mut Noise(1));
            let start = Plane::new(truth.per_mm + Vector3::new(tilt, -tilt, 0.02) * truth.per_mm.z);
            let fit = fit_plane(&calibration, &observations, &start).expect("four stripes fix a plane");
            prop_assert!((fit.plane.per_mm - truth.per_mm).norm() < 1e-9 * truth.per_mm.norm());
            prop_assert!(fit.rms_px < 1e-6);
        }

        #[test]
        fn noisy_stripes_give_the_plane_as_well_as_their_noise_allows(
            truth in planes(), sigma_px in 0.05..1.0, seed in 1..1000u64
        ) {
            let calibration = paper_head(1.0);
            let observations = stripes(&calibration, &truth, sigma_px, &mut Noise(seed));
            let fit = fit_plane(&calibration, &observations, &truth).expect("four stripes fix a plane");
            let error = depth_error_mm(&fit.plane, &truth);
            let depth_mm = 1.0 / truth.per_mm.z * 1.15;
            let allowed = allowed_mm(depth_mm, sigma_px, observations.len());
            prop_assert!(error < allowed, "{error} mm, allowed {allowed}");
            prop_assert!((fit.rms_px / sigma_px - 1.0).abs() < 0.15, "rms {} for {sigma_px}", fit.rms_px);
            prop_assert!((fit.scale - 1.0).abs() < 0.25, "scale {}", fit.scale);
        }

        #[test]
        fn three_in_ten_wrong_centres_do_not_matter(truth in planes(), seed in 1..1000u64) {
            let calibration = paper_head(1.0);
            let mut noise = Noise(seed);
            let mut observations = stripes(&calibration, &truth, 0.3, &mut noise);
            for o in &mut observations {
                if noise.uniform() < 0.3 {
                    // Anywhere within 60 px: print, a neighbour, the floor.
                    o.at = Px::new(o.at.u + 120.0 * (noise.uniform() - 0.5), o.at.v + 120.0 * (noise.uniform() - 0.5));
                }
            }
            let fit = fit_plane(&calibration, &observations, &truth).expect("most of four stripes fix a plane");
            let error = depth_error_mm(&fit.plane, &truth);
            let depth_mm = 1.0 / truth.per_mm.z * 1.15;
            let allowed = 1.5 * allowed_mm(depth_mm, 0.3, observations.len());
            prop_assert!(error < allowed, "{error} mm, allowed {allowed}");
        }

        #[test]
        fn any_centres_give_a_finite_plane_or_none(
            places in prop::collection::vec((1..=4u8, -1e4..1e4, -1e4..1e4), 0..40)
        ) {
            let calibration = paper_head(1.0);
            let observations: Vec<StripeObservation> = places
                .into_iter()
                .map(|(n, u, v)| StripeObservation {
                    laser: LaserId::new(n).expect("1 to 4"),
                    at: Px::new(u, v),
                    sigma_px: 0.3,
                })
                .collect();
            if let Some(fit) = fit_plane(&calibration, &observations, &Plane::new(Vector3::z() * 1e-3)) {
                prop_assert!(fit.plane.per_mm.iter().all(|x| x.is_finite()));
                prop_assert!(fit.rms_px.is_finite() && fit.scale.is_finite());
            }
        }
    }

    #[test]
    fn centres_that_fix_no_plane_give_none() {
        let calibration = paper_head(1.0);
        let truth = Plane::new(Vector3::new(0.1, 0.2, 1.0) / 1000.0);
        let all = stripes(&calibration, &truth, 0.0, &mut Noise(1));
        let fit = |o: &[StripeObservation]| fit_plane(&calibration, o, &truth);
        assert!(fit(&[]).is_none());
        assert!(fit(&all[..11]).is_none(), "too few");
        assert!(fit(&vec![all[0]; 50]).is_none(), "one place");
        let two_places: Vec<StripeObservation> = (0..50).map(|i| all[(i % 2) * 300]).collect();
        assert!(fit(&two_places).is_none(), "two places");
        let nan = StripeObservation { at: Px::new(f64::NAN, 1.0), ..all[0] };
        assert!(fit(&vec![nan; 50]).is_none(), "not a number");
    }

    /// One straight stripe fixes a plane but for its turn about the stripe.
    #[test]
    fn one_stripe_gives_none_or_a_plane_through_it() {
        let calibration = paper_head(1.0);
        let truth = Plane::new(Vector3::new(0.1, 0.2, 1.0) / 1000.0);
        let all = stripes(&calibration, &truth, 0.0, &mut Noise(1));
        let one: Vec<StripeObservation> =
            all.iter().filter(|o| o.laser == LaserId::ALL[0]).copied().collect();
        if let Some(fit) = fit_plane(&calibration, &one, &truth) {
            assert!(fit.plane.per_mm.iter().all(|x| x.is_finite()));
            assert!(fit.rms_px < 1e-6);
        }
    }
}
