//! To and from OpenCV's camera model. Its polynomial goes from the ideal to the distorted coordinate, the opposite way to
//! ours, so coefficients cannot be exchanged: each side is fitted to the other over the whole sensor, and what is left is
//! told in px. OpenCV: `calib3d`, "Detailed Description" (radial k1, k2, k3, tangential p1, p2).

use boxline::camera::CameraModel;
use boxline::frames::Ray;
use boxline::units::Px;
use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

/// OpenCV's camera: matrix without skew, and five distortion coefficients.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OpenCvCamera {
    /// Focal length along the rows, px.
    pub fx: f64,
    /// Focal length along the columns, px.
    pub fy: f64,
    /// Principal point, column, px.
    pub cx: f64,
    /// Principal point, row, px.
    pub cy: f64,
    /// k1, k2, p1, p2, k3, as in `distCoeffs`.
    pub distortion: [f64; 5],
}

/// What a refit leaves over the sensor, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefitResidual {
    /// Root mean square of the distance.
    pub rms_px: f64,
    /// Largest distance.
    pub max_px: f64,
}

impl OpenCvCamera {
    /// The pixel of an ideal ray.
    #[must_use]
    pub fn px_from_ray(&self, x: f64, y: f64) -> Px {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
        let yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
        Px::new(self.fx * xd + self.cx, self.fy * yd + self.cy)
    }

    /// The ideal ray of a pixel by Newton's method from the axis outwards. `None` where the polynomial turns back before it gets there: what
    /// lies behind is another ray of the same pixel, which the lens does not have.
    fn ray_from_px(&self, px: Px) -> Option<Vector2<f64>> {
        let off = |ray: Vector2<f64>| {
            let at = self.px_from_ray(ray.x, ray.y);
            Vector2::new((at.u - px.u) / self.fx, (at.v - px.v) / self.fy)
        };
        let mut ray = Vector2::zeros();
        for _ in 0..INVERSE_STEPS {
            let left = off(ray);
            if left.norm() < 1e-12 {
                return Some(ray);
            }
            let step = self.distorted_by_ideal(ray).try_inverse()? * left;
            ray = halved(|share| {
                let next = ray - step * share;
                let nearer = off(next).norm() < left.norm();
                (nearer && self.distorted_by_ideal(next).determinant() > 0.0).then_some(next)
            })?;
        }
        None
    }

    /// Derivative of the distorted coordinate by the ideal one, both without unit.
    fn distorted_by_ideal(&self, ray: Vector2<f64>) -> Matrix2<f64> {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let (x, y, r2) = (ray.x, ray.y, ray.norm_squared());
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let outwards = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2));
        let beside = 2.0 * (p1 * x + p2 * y);
        Matrix2::identity() * radial
            + ray * ray.transpose() * outwards
            + Matrix2::new(2.0 * p1 * y + 6.0 * p2 * x, beside, beside, 6.0 * p1 * y + 2.0 * p2 * x)
    }
}

/// The first that will do of a whole step, half of it, a quarter and so on.
fn halved<T>(attempt: impl Fn(f64) -> Option<T>) -> Option<T> {
    (0..HALVINGS).find_map(|n| attempt(0.5f64.powi(n)))
}

const COLUMNS: usize = 37;
const ROWS: usize = 28;
const ITERATIONS: usize = 20;
/// Newton's steps from the axis to a pixel; 4 to 8 are used, a few more of strong lenses.
const INVERSE_STEPS: usize = 50;
/// A step that is no good at a millionth of its length is none.
const HALVINGS: i32 = 20;

fn sensor(width_px: u32, height_px: u32) -> impl Iterator<Item = Px> {
    let (w, h) = (f64::from(width_px) - 1.0, f64::from(height_px) - 1.0);
    let share = |i: usize, n: usize| i as f64 / (n - 1) as f64;
    (0..ROWS).flat_map(move |j| (0..COLUMNS).map(move |i| Px::new(w * share(i, COLUMNS), h * share(j, ROWS))))
}

/// OpenCV's camera that is nearest to ours over the sensor.
#[must_use]
pub fn to_opencv(
    camera: &CameraModel,
    width_px: u32,
    height_px: u32,
) -> Option<(OpenCvCamera, RefitResidual)> {
    let pairs: Vec<(Vector2<f64>, Px)> =
        sensor(width_px, height_px).map(|px| (camera.ray_from_px(px).xy1.xy(), px)).collect();
    let build = |p: &[f64]| OpenCvCamera {
        fx: p[0],
        fy: p[1],
        cx: p[2],
        cy: p[3],
        distortion: [p[4], p[5], p[6], p[7], p[8]],
    };
    let c = camera;
    let start = [c.fx, c.fy, c.cx, c.cy, -c.k1, -c.k2, -c.p1, -c.p2, -c.k3];
    let residuals = |p: &[f64]| {
        let camera = build(p);
        let off = |(ray, px): &(Vector2<f64>, Px)| {
            let found = camera.px_from_ray(ray.x, ray.y);
            [found.u - px.u, found.v - px.v]
        };
        Some(pairs.iter().flat_map(off).collect())
    };
    let (found, residual) = fit(&start, residuals)?;
    Some((build(&found), residual))
}

/// Our camera that is nearest to OpenCV's over the sensor.
#[must_use]
pub fn from_opencv(
    camera: &OpenCvCamera,
    width_px: u32,
    height_px: u32,
) -> Option<(CameraModel, RefitResidual)> {
    // Pixels where OpenCV's polynomial has no inverse are left out.
    let pairs: Vec<(Vector2<f64>, Px)> =
        sensor(width_px, height_px).filter_map(|px| Some((camera.ray_from_px(px)?, px))).collect();
    if pairs.len() < COLUMNS * ROWS / 2 {
        return None;
    }
    let build = |p: &[f64]| CameraModel {
        fx: p[0],
        fy: p[1],
        skew: 0.0,
        cx: p[2],
        cy: p[3],
        k1: p[4],
        k2: p[5],
        p1: p[6],
        p2: p[7],
        k3: p[8],
    };
    let [k1, k2, p1, p2, k3] = camera.distortion.map(|term| -term);
    let start = [camera.fx, camera.fy, camera.cx, camera.cy, k1, k2, p1, p2, k3];
    let residuals = |p: &[f64]| {
        let camera = build(p);
        let mut all = Vec::with_capacity(2 * pairs.len());
        for (ray, px) in &pairs {
            let found = camera.px_from_ray(&Ray::new(ray.x, ray.y))?;
            all.extend([found.u - px.u, found.v - px.v]);
        }
        Some(all)
    };
    // A strong start may have no inverse at the corners: then without distortion, from where each step stays among lenses that have one.
    let flat = [camera.fx, camera.fy, camera.cx, camera.cy, 0.0, 0.0, 0.0, 0.0, 0.0];
    let (found, residual) = fit(&start, residuals).or_else(|| fit(&flat, residuals))?;
    Some((build(&found), residual))
}

/// Gauss-Newton with differences: nine unknowns, smooth. A step is halved while it leaves lenses that have an inverse, or fits worse.
fn fit(start: &[f64], residuals: impl Fn(&[f64]) -> Option<Vec<f64>>) -> Option<(Vec<f64>, RefitResidual)> {
    let mut p = start.to_vec();
    for _ in 0..ITERATIONS {
        let here = DVector::from_vec(residuals(&p)?);
        let mut jacobian = DMatrix::zeros(here.len(), p.len());
        for k in 0..p.len() {
            let size = if k < 4 { 1e-3 } else { 1e-6 };
            let mut q = p.clone();
            q[k] += size;
            let there = DVector::from_vec(residuals(&q)?);
            jacobian.set_column(k, &((there - &here) / size));
        }
        let step = (jacobian.transpose() * &jacobian).cholesky()?.solve(&(jacobian.transpose() * &here));
        let shorter = |share: f64| {
            let moved: Vec<f64> = p.iter().zip(step.iter()).map(|(p, s)| p - share * s).collect();
            let left = DVector::from_vec(residuals(&moved)?);
            (left.norm_squared() <= here.norm_squared()).then_some(moved)
        };
        let Some(moved) = halved(shorter) else { break };
        p = moved;
        if step.amax() < 1e-9 {
            break;
        }
    }
    let left = residuals(&p)?;
    let distances: Vec<f64> = left.chunks_exact(2).map(|d| d[0].hypot(d[1])).collect();
    let rms_px = (distances.iter().map(|d| d * d).sum::<f64>() / distances.len() as f64).sqrt();
    let max_px = distances.iter().copied().fold(0.0, f64::max);
    max_px.is_finite().then_some((p, RefitResidual { rms_px, max_px }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_and_back_is_the_same_camera_to_what_the_refit_leaves() {
        let camera = *crate::paper_head::paper_head(1.0).camera();
        let (opencv, residual) = to_opencv(&camera, 2592, 1944).expect("a smooth lens");
        assert!(residual.max_px < 0.5, "{residual:?}");
        let (back, residual) = from_opencv(&opencv, 2592, 1944).expect("a smooth lens");
        assert!(residual.max_px < 0.5, "{residual:?}");
        for px in sensor(2592, 1944) {
            let ray = camera.ray_from_px(px);
            let other = back.px_from_ray(&ray).expect("on the sensor");
            assert!(other.distance_px(px) < 1.0, "{px:?} {other:?}");
        }
    }

    /// Terms of the square of decentring have no counterpart: 0.4 px at the corners here.
    #[test]
    fn a_decentred_lens_goes_there_and_back() {
        let opencv = OpenCvCamera {
            fx: 2458.4,
            fy: 2453.3,
            cx: 1239.5,
            cy: 1032.6,
            distortion: [0.03, -0.06, 0.0078, -0.003, 0.03],
        };
        let (ours, residual) = from_opencv(&opencv, 2592, 1944).expect("a smooth lens");
        assert!(residual.max_px < 0.6, "{residual:?}");
        assert!((ours.p1 + 0.0078).abs() < 2e-3 && (ours.p2 - 0.003).abs() < 1e-3, "{ours:?}");
        let (again, residual) = to_opencv(&ours, 2592, 1944).expect("a smooth lens");
        assert!(residual.max_px < 0.6, "{residual:?}");
        assert!((again.fx - opencv.fx).abs() < 1.0 && (again.cy - opencv.cy).abs() < 1.0, "{again:?}");
    }

    /// Strong lenses that never turn back: the distance from the middle grows with the angle all over the sensor.
    #[test]
    fn a_strong_lens_that_has_an_inverse_is_fitted() {
        for distortion in [
            [0.4, 0.2, 0.0, 0.0, 0.0],
            [0.6, 0.3, 0.0, 0.0, 0.0],
            [0.2, 0.5, 0.0, 0.0, 0.0],
            [0.5, 0.0, 0.0, 0.0, 0.0],
        ] {
            let opencv = OpenCvCamera { fx: 2458.4, fy: 2453.3, cx: 1239.5, cy: 1032.6, distortion };
            let (ours, residual) =
                from_opencv(&opencv, 2592, 1944).unwrap_or_else(|| panic!("{distortion:?}"));
            println!("{distortion:?}: {residual:?}");
            // Of the second 1.1 px are left in a corner: refitted, whatever a caller allows.
            assert!(residual.rms_px < 0.5 && residual.max_px < 2.0, "{distortion:?}: {residual:?}");
            for px in sensor(2592, 1944) {
                let ray = ours.ray_from_px(px).xy1;
                assert!(opencv.px_from_ray(ray.x, ray.y).distance_px(px) < 3.0, "{distortion:?}: {px:?}");
            }
        }
        // Turns back at 0.58 from the middle, inside the sensor.
        let folded = OpenCvCamera {
            fx: 1200.0,
            fy: 1200.0,
            cx: 1295.5,
            cy: 971.5,
            distortion: [-1.0, 0.0, 0.0, 0.0, 0.0],
        };
        assert_eq!(from_opencv(&folded, 2592, 1944), None);
    }

    #[test]
    fn without_distortion_nothing_is_left() {
        let camera = CameraModel {
            fx: 2000.0,
            fy: 2010.0,
            skew: 0.0,
            cx: 1300.0,
            cy: 900.0,
            k1: 0.0,
            k2: 0.0,
            ..CameraModel::PINHOLE
        };
        let (opencv, residual) = to_opencv(&camera, 2592, 1944).expect("a pinhole");
        assert!(residual.max_px < 1e-6 && opencv.distortion.iter().all(|k| k.abs() < 1e-9));
    }
}
