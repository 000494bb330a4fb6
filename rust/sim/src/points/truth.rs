//! What is drawn: a head that is not quite what its calibration says, a box, and two views of adjacent faces.

use super::face::{Surface, see_face};
use super::rounding::Light;
use crate::error::Error;
use crate::head::Head;
use crate::pose::{FacePose, place_face, random_orientation};
use crate::rng::Rng;
use boxline::calibration::{CalibrationCovariance, CalibrationStep, moved};
use boxline::points::{PointWithSigma, SidePoints};
use boxline::{Calibration, LaserId};
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Unit, Vector3};

/// What the drawn boxes have in common.
#[derive(Clone, Copy, Debug)]
pub struct Conditions {
    /// Every laser has turned by a normal draw with this sigma since the calibration, rad.
    pub drift_rad: f64,
    /// One laser, drawn, has turned by this as well, rad.
    pub tilt_rad: f64,
    /// The middle of each face lies this much nearer than its edges, mm.
    pub bulge_mm: f64,
    /// Each face is skewed by this angle, rad.
    pub skew_rad: f64,
}

/// What one frame shows.
#[derive(Clone, Debug)]
pub struct PointFace {
    /// Points of the four stripes, along each.
    pub stripes: [Vec<PointWithSigma>; 4],
    /// The four sides: left, right, up, down.
    pub sides: [SidePoints; 4],
    /// How far inside the sharp edge each shows, mm.
    pub inside_mm: [f64; 4],
}

/// A box, seen twice.
#[derive(Clone, Debug)]
pub struct PointBox {
    /// The sharp box, longest side first, mm.
    pub size_mm: [f64; 3],
    /// Two frames.
    pub faces: [PointFace; 2],
    /// Which laser has the extra tilt.
    pub tilted: LaserId,
    /// Radius of its edges, mm.
    pub radius_mm: f64,
    /// How far inside the sharp edge each side shows, mm; two faces, four sides.
    pub inside_mm: [[f64; 4]; 2],
}

/// Sides of boxes, mm: every scale alike.
const SIDES_MM: (f64, f64) = (100.0, 1800.0);
/// Radius of cardboard edges, mm, every scale alike.
const RADIUS_MM: (f64, f64) = (0.5, 4.0);
/// Right, down and into the box of the two faces, in the axes of the box: both have its x to their right.
const FACES: [Matrix3<f64>; 2] = [
    Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
    Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0),
];
/// Farthest from looking straight at a face, degrees.
const MOST_DEG: f64 = 35.0;

impl PointBox {
    /// Draws a box before a head whose calibration is known with its covariance.
    ///
    /// # Errors
    /// If the calibration has no covariance or one that is none.
    pub fn random(rng: &mut Rng, known: &Calibration, conditions: &Conditions) -> Result<Self, Error> {
        loop {
            let (head, tilted) = true_head(rng, known, conditions)?;
            let size = [0; 3].map(|_| rng.log_range(SIDES_MM.0, SIDES_MM.1));
            let radius_mm = rng.log_range(RADIUS_MM.0, RADIUS_MM.1);
            // Two faces that share the first side.
            let poses = [[size[0], size[1]], [size[0], size[2]]].map(|face| stand(rng, &head, face));
            let [Some(a), Some(b)] = poses else { continue };
            let light = Light::draw(rng, FACES.map(|face| -face.column(2)));
            let [Some(a), Some(b)] = [(a, FACES[0]), (b, FACES[1])].map(|(pose, box_from_face)| {
                let surface = Surface {
                    box_from_face,
                    light: light.clone(),
                    radius_mm,
                    bulge_mm: conditions.bulge_mm,
                    skew_rad: conditions.skew_rad,
                };
                see_face(rng, &head, &pose, &surface)
            }) else {
                continue;
            };
            let mut size_mm = size;
            size_mm.sort_by(|x, y| y.total_cmp(x));
            let inside_mm = [a.inside_mm, b.inside_mm];
            return Ok(Self { size_mm, faces: [a, b], tilted, radius_mm, inside_mm });
        }
    }
}

/// A place from which the face can be measured, if a few tries find one.
fn stand(rng: &mut Rng, head: &Head, size_mm: [f64; 2]) -> Option<FacePose> {
    (0..4).find_map(|_| {
        let orientation = random_orientation(rng, true, MOST_DEG);
        place_face(rng, head, size_mm, orientation)
    })
}

/// The head as it is: off its calibration by a draw of the covariance, its lasers turned since.
fn true_head(rng: &mut Rng, known: &Calibration, conditions: &Conditions) -> Result<(Head, LaserId), Error> {
    let covariance = known
        .covariance()
        .ok_or_else(|| Error::new("calibration", "has no covariance; `boxline calibrate` writes one"))?;
    let off =
        draw(rng, covariance).ok_or_else(|| Error::new("calibration", "the covariance is not positive"))?;
    let (camera, lasers) = moved(known.camera(), known.lasers(), &off);
    let tilted = LaserId::ALL[rng.below(4)];
    let extra_rad = conditions.tilt_rad * rng.sign();
    let planes = LaserId::ALL.map(|id| {
        let extra_rad = if id == tilted { extra_rad } else { 0.0 };
        turned(lasers[id.index()].per_mm, conditions.drift_rad * rng.normal() + extra_rad)
    });
    Ok((Head::of(known.serial(), camera, planes)?, tilted))
}

/// A laser that turns in its mount: about its exit on the camera's x axis, so that its light moves out of its plane.
fn turned(plane: Vector3<f64>, angle_rad: f64) -> Vector3<f64> {
    let exit = Vector3::new(1.0 / plane.x, 0.0, 0.0);
    let normal = plane.normalize();
    let beam = (Vector3::z() - normal * normal.z).normalize();
    let hinge = Unit::new_normalize(normal.cross(&beam));
    let normal = Rotation3::from_axis_angle(&hinge, angle_rad) * normal;
    normal / normal.dot(&exit)
}

/// A normal draw with this covariance; what is known exactly stays.
fn draw(rng: &mut Rng, covariance: &CalibrationCovariance) -> Option<CalibrationStep> {
    let sigmas = covariance.diagonal().map(f64::sqrt);
    let moving: Vec<usize> = (0..sigmas.len()).filter(|i| sigmas[*i] > 0.0).collect();
    let n = moving.len();
    let even = DMatrix::from_fn(n, n, |i, j| {
        covariance[(moving[i], moving[j])] / (sigmas[moving[i]] * sigmas[moving[j]])
    });
    let lower = even.cholesky()?.l();
    let drawn = lower * DVector::from_fn(n, |_, _| rng.normal());
    let mut step = CalibrationStep::zeros();
    moving.iter().zip(&drawn).for_each(|(i, sigmas_off)| step[*i] = sigmas_off * sigmas[*i]);
    Some(step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turned_laser_keeps_its_exit_and_turns_by_the_angle() {
        let plane = Vector3::new(0.0079, -0.0082, 0.0002);
        let moved = turned(plane, 1e-3);
        assert!((1.0 / moved.x - 1.0 / plane.x).abs() < 1e-9);
        assert!((moved.angle(&plane) - 1e-3).abs() < 1e-9);
        // 1 mrad moves its light by 1 mm in 1 m.
        let far = Vector3::new(0.0, (1.0 - plane.z * 1000.0) / plane.y, 1000.0);
        let off_mm = (moved.dot(&far) - 1.0) / moved.norm();
        assert!((off_mm.abs() - 1.0).abs() < 0.02, "{off_mm}");
    }
}
