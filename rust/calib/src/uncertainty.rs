//! What a calibration's covariance means for a box: standard deviation of a side.

use boxline::calibration::{CalibrationCovariance, CalibrationStep, PARAMETERS, moved};
use boxline::camera::CameraModel;
use boxline::frames::{Cam, Plane, Ray};
use boxline::units::Px;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Variance that a calibration's covariance gives any quantity computed with it: `J C J^T`, J by central differences of
/// a tenth of a sigma in every parameter. `None` if the quantity cannot be computed beside the calibration.
pub fn variance_of(
    camera: &CameraModel,
    lasers: &[Plane<Cam>; 4],
    covariance: &CalibrationCovariance,
    mut quantity: impl FnMut(&CameraModel, &[Plane<Cam>; 4]) -> Option<f64>,
) -> Option<f64> {
    let mut gradient = CalibrationStep::zeros();
    for i in 0..PARAMETERS {
        let size = 0.1 * covariance[(i, i)].max(0.0).sqrt();
        if size == 0.0 {
            continue;
        }
        let mut step = CalibrationStep::zeros();
        step[i] = size;
        let (camera_up, lasers_up) = moved(camera, lasers, &step);
        let (camera_down, lasers_down) = moved(camera, lasers, &-step);
        gradient[i] =
            (quantity(&camera_up, &lasers_up)? - quantity(&camera_down, &lasers_down)?) / (2.0 * size);
    }
    Some((gradient.transpose() * covariance * gradient)[0].max(0.0))
}

/// The distance from which a face with this longer side fills the frame (PHYSICS.md, "What can be measured"): length +
/// width = 1.1 z with a width of 0.6 lengths, 350 to 2500 mm.
#[must_use]
pub fn usual_distance_mm(length_mm: f64) -> f64 {
    (1.6 * length_mm / 1.1).clamp(350.0, 2500.0)
}

/// Places on each stripe and on each side that stand for a measurement.
const SAMPLES: usize = 12;

/// Pixels that stand for a measurement of the longer side of a face seen straight on, the head rolled by 45 degrees, length : width =
/// 1 : 0.6.
#[derive(Clone, Debug)]
pub struct SideSeen {
    /// Stripes on the face by laser, 0 to 3.
    stripes: Vec<(usize, Px)>,
    /// The two sides whose distance is the length.
    sides: [Vec<Px>; 2],
}

impl SideSeen {
    /// From a distance, by a camera as a function from rays to pixels. `None` if something is not in view of it.
    #[must_use]
    pub fn new(
        px: impl Fn(&Ray<Cam>) -> Option<Px>,
        lasers: &[Plane<Cam>; 4],
        length_mm: f64,
        distance_mm: f64,
    ) -> Option<Self> {
        let half = Vector2::new(0.5 * length_mm, 0.3 * length_mm);
        let (s, c) = std::f64::consts::FRAC_PI_4.sin_cos();
        let on_face = |a: f64, b: f64| Vector3::new(c * a - s * b, s * a + c * b, distance_mm);
        let px = |p: Vector3<f64>| px(&Ray::new(p.x / p.z, p.y / p.z));
        let mut stripes: Vec<(usize, Px)> = Vec::new();
        for (laser, plane) in lasers.iter().enumerate() {
            let p = plane.per_mm;
            for i in 0..SAMPLES {
                let along = (i as f64 + 0.5) / SAMPLES as f64 * 2.0 - 1.0;
                // A line of the face that the stripe crosses: across for those that run along, and the other way round.
                for (a, b) in [(Some(along * half.x), None), (None, Some(along * half.y))] {
                    let (start, direction) = match (a, b) {
                        (Some(a), _) => (on_face(a, 0.0), on_face(0.0, 1.0) - on_face(0.0, 0.0)),
                        (_, b) => (on_face(0.0, b.unwrap_or(0.0)), on_face(1.0, 0.0) - on_face(0.0, 0.0)),
                    };
                    let slope = p.dot(&direction);
                    let at = (1.0 - p.dot(&start)) / slope;
                    let limit = if a.is_some() { half.y } else { half.x };
                    // The steep way across is the well defined one.
                    if at.abs() < limit && slope.abs() > 0.7 * p.xy().norm() {
                        stripes.push((laser, px(start + direction * at)?));
                    }
                }
            }
        }
        let side = |a: f64| -> Option<Vec<Px>> {
            (0..SAMPLES)
                .map(|i| px(on_face(a, ((i as f64 + 0.5) / SAMPLES as f64 * 2.0 - 1.0) * half.y)))
                .collect()
        };
        Some(Self { stripes, sides: [side(-half.x)?, side(half.x)?] })
    }

    /// The length that a calibration makes of these pixels, mm.
    #[must_use]
    pub fn length_mm(&self, camera: &CameraModel, lasers: &[Plane<Cam>; 4]) -> Option<f64> {
        let plane = plane_from_stripes(camera, lasers, &self.stripes)?;
        let point = |px: &Px| {
            let ray = camera.ray_from_px(*px).xy1;
            ray / plane.dot(&ray)
        };
        // Distance between the sides as an observer takes it: mean of the distances of opposite points.
        let [low, high] = &self.sides;
        let sum: f64 = low.iter().zip(high).map(|(l, h)| (point(l) - point(h)).norm()).sum();
        Some(sum / SAMPLES as f64)
    }
}

/// Standard deviation, mm, that the calibration alone gives the side of a [`SideSeen`]: its pixels stay where they are; plane and sides
/// are computed with the moved calibration.
#[must_use]
pub fn side_sigma_mm(
    camera: &CameraModel,
    lasers: &[Plane<Cam>; 4],
    covariance: &CalibrationCovariance,
    length_mm: f64,
    distance_mm: f64,
) -> Option<f64> {
    let seen = SideSeen::new(|ray| camera.px_from_ray(ray), lasers, length_mm, distance_mm)?;
    let variance = variance_of(camera, lasers, covariance, |camera, lasers| seen.length_mm(camera, lasers))?;
    Some(variance.sqrt())
}

/// `(q - p_k) . x = 0` by least squares.
fn plane_from_stripes(
    camera: &CameraModel,
    lasers: &[Plane<Cam>; 4],
    stripes: &[(usize, Px)],
) -> Option<Vector3<f64>> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (laser, px) in stripes {
        let x = camera.ray_from_px(*px).xy1;
        normal += x * x.transpose();
        right += x * lasers[*laser].per_mm.dot(&x);
    }
    Some(normal.cholesky()?.solve(&right))
}
