//! The calibration of one head: camera and four laser planes, checked once and immutable afterwards.

use crate::camera::CameraModel;
use crate::error::{Error, ErrorKind};
use crate::frames::{Cam, Plane};
use crate::units::LaserId;
use nalgebra::{SMatrix, SVector, Vector3};

/// Parameters of a calibration: fx, fy, cx, cy, k1, k2 (px, and 1 for the last two), the four planes `p . X = 1` (x, y, z each, laser
/// 1 first, 1/mm), p1, p2, k3.
pub const PARAMETERS: usize = 21;
/// Those of a lens as the paper has it: the first.
pub const PAPER_PARAMETERS: usize = 18;
/// First parameter of the planes.
pub const FIRST_PLANE: usize = 6;
/// The camera's parameters.
pub const CAMERA: [usize; 9] = [0, 1, 2, 3, 4, 5, 18, 19, 20];

/// The planes of one pair differ by more, as parts of 1 / distance.
const LEAST_DIFFERENCE: f64 = 0.01;

/// Rounding may leave an eigenvalue of the correlations so far below 0: as far as the matrix may be from symmetric.
const MOST_NEGATIVE: f64 = 1e-6;

/// Covariance of a calibration's parameters. A term of the lens without variance is known to be 0; one that is 0 and has a variance was not
/// needed by the frames, and may be something else.
pub type CalibrationCovariance = SMatrix<f64, PARAMETERS, PARAMETERS>;

/// Unknowns of a calibration in the order of its covariance.
pub type CalibrationStep = SVector<f64, PARAMETERS>;

/// A head's calibration. Built only by [`Calibration::new`], which checks every number.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    serial: String,
    width_px: u32,
    height_px: u32,
    camera: CameraModel,
    lasers: [Plane<Cam>; 4],
    covariance: Option<Box<CalibrationCovariance>>,
}

impl Calibration {
    /// Checks and keeps a calibration. `laser_planes` are (a, b, c, d) of `a x + b y + c z + d = 0` in `Cam`, mm.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidCalibration`], naming the number: not finite, a plane through the camera's centre, or a pair
    /// of planes that is no pair.
    pub fn new(
        serial: impl Into<String>,
        image_size_px: [u32; 2],
        camera: CameraModel,
        laser_planes: [[f64; 4]; 4],
    ) -> Result<Self, Error> {
        let invalid = |text: String| Error::new(ErrorKind::InvalidCalibration, text);
        let [width_px, height_px] = image_size_px;
        camera.check_on_sensor(image_size_px)?;
        let mut lasers = [Plane::new(Vector3::zeros()); 4];
        for ((plane, id), [a, b, c, d]) in lasers.iter_mut().zip(LaserId::ALL).zip(laser_planes) {
            if ![a, b, c, d].iter().all(|x| x.is_finite()) {
                return Err(invalid(format!("laser_planes: plane {id} has a number that is not finite")));
            }
            let normal = Vector3::new(a, b, c);
            let distance_mm = d.abs() / normal.norm();
            if !(distance_mm > 1.0 && distance_mm < 10_000.0) {
                return Err(invalid(format!(
                    "laser_planes: plane {id} is {distance_mm:.3} mm from the camera's centre, 1 to 10000 mm are allowed"
                )));
            }
            *plane = Plane::new(-normal / d);
        }
        let calibration =
            Self { serial: serial.into(), width_px, height_px, camera, lasers, covariance: None };
        for (first, second) in [(0, 1), (2, 3)] {
            let (n1, n2) = (calibration.lasers[first].per_mm, calibration.lasers[second].per_mm);
            let angle = n1.angle(&n2).min(n1.angle(&-n2));
            let cross = n1.angle(&calibration.lasers[(first + 2) % 4].per_mm);
            // A pair is nearly parallel, the two pairs cross: half way between is the most that either may stray.
            if angle > std::f64::consts::FRAC_PI_4 || (cross.sin()) < std::f64::consts::FRAC_1_SQRT_2 {
                return Err(invalid(format!(
                    "laser_planes: planes {} and {} are no pair of a 2 x 2 grid",
                    first + 1,
                    second + 1
                )));
            }
            // Those of heads differ by a quarter. Closer ones cannot be told apart in a picture.
            if (n1 - n2).norm() < LEAST_DIFFERENCE * n1.norm().max(n2.norm()) {
                return Err(invalid(format!(
                    "laser_planes: planes {} and {} are the same, they differ by less than {} %",
                    first + 1,
                    second + 1,
                    LEAST_DIFFERENCE * 100.0
                )));
            }
        }
        Ok(calibration)
    }

    /// The same calibration with what is known of its own uncertainty.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidCalibration`] unless all numbers are finite, the matrix is symmetric, no variance negative, nor that of any sum of parameters, and none so large
    /// that the parameter would not be known at all: such a matrix is in other units.
    pub fn with_covariance(mut self, covariance: CalibrationCovariance) -> Result<Self, Error> {
        let invalid = |text: String| Error::new(ErrorKind::InvalidCalibration, text);
        for i in 0..PARAMETERS {
            let variance = covariance[(i, i)];
            if !variance.is_finite() || variance < 0.0 {
                return Err(invalid(format!("covariance[{i}][{i}] is {variance}, a variance is needed")));
            }
            let (sigma, most) = (variance.sqrt(), self.most_sigma(i));
            if sigma > most {
                return Err(invalid(format!(
                    "covariance[{i}][{i}] is {variance:e}, a sigma of {sigma:.4}: at most {most:.4} is allowed"
                )));
            }
            for j in 0..i {
                let (a, b) = (covariance[(i, j)], covariance[(j, i)]);
                let most = (variance * covariance[(j, j)]).sqrt() * (1.0 + 1e-6);
                // Written by our own solver it is symmetric to the last digits that are kept.
                if !a.is_finite() || (a - b).abs() > 1e-6 * most || a.abs() > most {
                    return Err(invalid(format!(
                        "covariance[{i}][{j}] is {a} and [{j}][{i}] is {b}: both must be equal and at most {most:e}"
                    )));
                }
            }
        }
        let least = least_eigenvalue_of_correlation(&covariance);
        if least < -MOST_NEGATIVE {
            return Err(invalid(format!(
                "covariance: the correlations have an eigenvalue of {least:.2e}, none below 0 is possible"
            )));
        }
        self.covariance = Some(Box::new(covariance));
        Ok(self)
    }

    /// The largest sigma of a parameter that still says anything: a tenth of focal length, image or plane, and of a lens's term as
    /// much as moves the corner by its whole distance from the middle. Calibrations are a hundred times better.
    fn most_sigma(&self, parameter: usize) -> f64 {
        const TENTH: f64 = 0.1;
        let (width, height) = (f64::from(self.width_px), f64::from(self.height_px));
        let c = &self.camera;
        let corner = (0.5 * width / c.fx).hypot(0.5 * height / c.fy);
        match parameter {
            0 => TENTH * c.fx,
            1 => TENTH * c.fy,
            2 => TENTH * width,
            3 => TENTH * height,
            4 => corner.powi(-2),
            5 => corner.powi(-4),
            FIRST_PLANE..PAPER_PARAMETERS => TENTH * self.lasers[(parameter - FIRST_PLANE) / 3].per_mm.norm(),
            18 | 19 => 1.0 / corner,
            _ => corner.powi(-6),
        }
    }

    /// Covariance of the parameters, if the calibration came with one.
    #[must_use]
    pub fn covariance(&self) -> Option<&CalibrationCovariance> {
        self.covariance.as_deref()
    }

    /// The planes of all four lasers in `Cam`.
    #[must_use]
    pub const fn lasers(&self) -> &[Plane<Cam>; 4] {
        &self.lasers
    }

    /// Serial number of the head.
    #[must_use]
    pub fn serial(&self) -> &str {
        &self.serial
    }

    /// Image width in px.
    #[must_use]
    pub const fn width_px(&self) -> u32 {
        self.width_px
    }

    /// Image height in px.
    #[must_use]
    pub const fn height_px(&self) -> u32 {
        self.height_px
    }

    /// The camera.
    #[must_use]
    pub const fn camera(&self) -> &CameraModel {
        &self.camera
    }

    /// The same head with other parameters and without covariance; not checked: steps of a derivative are small.
    pub(crate) fn with_parameters(&self, camera: CameraModel, lasers: [Plane<Cam>; 4]) -> Self {
        Self { serial: String::new(), camera, lasers, covariance: None, ..*self }
    }

    /// The same head with one laser turned by `angle_rad` about its exit (where its plane meets the camera's x axis), the
    /// way a laser module drifts with temperature.
    pub(crate) fn with_turned_laser(&self, id: LaserId, angle_rad: f64) -> Self {
        let mut turned = self.clone();
        let p = self.laser(id).per_mm;
        let normal = p.normalize();
        let exit = laser_exit(self.laser(id));
        // The middle of the fan: forward, within the plane.
        let forward = (Vector3::z() - normal * normal.z).normalize();
        let moved = (normal + forward * angle_rad.tan()).normalize();
        turned.lasers[id.index()] = Plane::new(moved / moved.dot(&exit));
        turned
    }

    /// The plane of one laser in `Cam`.
    #[must_use]
    pub const fn laser(&self, id: LaserId) -> &Plane<Cam> {
        &self.lasers[id.index()]
    }
}

/// Where a laser's plane meets the camera's x axis, mm; the origin if the two are parallel.
pub(crate) fn laser_exit(plane: &Plane<Cam>) -> Vector3<f64> {
    let x = plane.per_mm.x;
    Vector3::new(if x.abs() > 1e-9 { 1.0 / x } else { 0.0 }, 0.0, 0.0)
}

/// The least eigenvalue of a covariance in units of its own sigmas: focal lengths and planes differ by 10^9 in theirs. What is known
/// exactly has a correlation with nothing.
fn least_eigenvalue_of_correlation(covariance: &CalibrationCovariance) -> f64 {
    let sigmas = covariance.diagonal().map(f64::sqrt);
    let correlation = CalibrationCovariance::from_fn(|i, j| match sigmas[i] * sigmas[j] {
        both if both > 0.0 => covariance[(i, j)] / both,
        _ => f64::from(u8::from(i == j)),
    });
    correlation.symmetric_eigenvalues().min()
}

/// A camera and planes moved by a step of the parameters.
#[must_use]
pub fn moved(
    camera: &CameraModel,
    lasers: &[Plane<Cam>; 4],
    step: &CalibrationStep,
) -> (CameraModel, [Plane<Cam>; 4]) {
    let camera = CameraModel {
        fx: camera.fx + step[0],
        fy: camera.fy + step[1],
        cx: camera.cx + step[2],
        cy: camera.cy + step[3],
        k1: camera.k1 + step[4],
        k2: camera.k2 + step[5],
        p1: camera.p1 + step[18],
        p2: camera.p2 + step[19],
        k3: camera.k3 + step[20],
        ..*camera
    };
    let mut moved = *lasers;
    for (k, plane) in moved.iter_mut().enumerate() {
        *plane = Plane::new(plane.per_mm + step.fixed_rows::<3>(FIRST_PLANE + 3 * k));
    }
    (camera, moved)
}
