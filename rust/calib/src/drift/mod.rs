//! Has a laser moved since the calibration? Every measured face of an ordinary box checks the four planes: 16 line coefficients
//! for 8 unknowns. A joint adjustment over many faces gives the change of the twelve plane parameters; each face has its own
//! plane and rectangle, eliminated face by face, as the calibration does with poses.
//!
//! What faces can tell (PHYSICS.md): the stripes of flat faces leave four parameters open, since `p -> a p + v` for all planes
//! at once moves every face and bends no stripe. Right angles close three of them (v), one stays: the global scale a. A known
//! length settles it. Which directions are observable is not assumed but read from the adjustment ([`directions`]).

pub mod directions;
mod significance;
#[cfg(test)]
mod tests;

pub use directions::{Direction, DirectionKind};
pub use significance::{ChangeTest, SIGNIFICANT};

use boxline::calibration::{CAMERA, Calibration, CalibrationCovariance};
use boxline::error::{Error, ErrorKind};
use boxline::face_geometry::fitted::{FittedFace, KnownSide, REDUNDANT};
use boxline::face_geometry::laser_motion::{
    MotionMatrix, Motions, all_planes_by_motion, blocks, motions_of, moved,
};
use boxline::face_geometry::{FaceLines, FaceState};
use boxline::frames::{Cam, Plane};
use boxline::measurement::FaceMeasurement;
use boxline::units::LaserId;
use nalgebra::{Matrix3, SMatrix};

/// A laser that turned by more than this fell off: rad, 1 sigma of what is thought possible before looking.
const PRIOR_TURN_RAD: f64 = 5e-3;
/// The emitter sits within 10 mm of where its module is held: a turn of 5 mrad shifts it by this, mm, 1 sigma.
const PRIOR_SHIFT_MM: f64 = 0.05;
/// The carrier grows with temperature: aluminium, 23e-6 / K, 30 K. Relative, 1 sigma, all lasers together.
const PRIOR_SCALE: f64 = 7e-4;
/// A face whose chi^2 (8 degrees of freedom) lies beyond the 99 % quantile is none that the model describes (bulges, flaps,
/// a wrong edge): it counts less, so that its pull does not grow with its error.
const FACE_CHI_SQUARE_99: f64 = 20.09;
/// Fewest faces: one gives 8 numbers for 12 unknowns.
const MIN_FACES: usize = 3;
const ITERATIONS: usize = 15;

/// One face that was measured with the calibration to be judged.
#[derive(Clone, Debug)]
pub struct ObservedFace {
    lines: FaceLines,
    start: FaceState,
    /// Length and width that the measurement tells, the sharp box's, and their sigma, mm.
    sharp_mm: [(f64, f64); 2],
    known: Vec<(usize, f64)>,
}

impl ObservedFace {
    /// The lines of a measured face. `None` if one of them has too few points.
    #[must_use]
    pub fn new(calibration: &Calibration, face: &FaceMeasurement) -> Option<Self> {
        let sharp_mm = [face.length, face.width].map(|e| (e.value_mm, e.sigma_mm));
        Some(Self {
            lines: FaceLines::from_measurement(calibration, face)?,
            start: FaceState::from_measurement(face)?,
            sharp_mm,
            known: Vec::new(),
        })
    }

    /// The same face with a length (`side` 0) or width (1) that is known from a ruler, mm.
    #[must_use]
    pub fn with_known(mut self, side: usize, known_mm: f64) -> Self {
        self.known.push((side.min(1), known_mm));
        self
    }

    /// Known sides as the lines should give them: lines run inside the sharp edges, by as much as the measurement said.
    fn known_sides(&self, nominal: &FittedFace) -> Vec<KnownSide> {
        self.known
            .iter()
            .map(|(which, known_mm)| {
                let (sharp_mm, sigma_mm) = self.sharp_mm[*which];
                let inside_mm = sharp_mm - nominal.state.lengths_mm()[*which];
                KnownSide { which: *which, raw_mm: known_mm - inside_mm, sigma_mm: sigma_mm.max(1e-3) }
            })
            .collect()
    }
}

/// Motion of one laser since the calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LaserMotion {
    /// Turn about its exit that moves the stripe across itself, rad.
    pub tilt_rad: f64,
    /// Turn that turns the stripe in the picture, rad.
    pub twist_rad: f64,
    /// Shift of the exit across the plane, away from the camera, mm.
    pub shift_mm: f64,
}

impl LaserMotion {
    fn from(motions: &Motions, laser: usize) -> Self {
        let at = 3 * laser;
        Self { tilt_rad: motions[at], twist_rad: motions[at + 1], shift_mm: motions[at + 2] }
    }
}

/// What many faces say about the lasers.
#[derive(Clone, Debug)]
pub struct Drift {
    /// The change of each laser since the calibration, and its sigma, laser 1 first. What faces do not tell comes from what is
    /// thought possible before looking.
    pub lasers: [(LaserMotion, LaserMotion); 4],
    /// The twelve directions, best known first.
    pub directions: Vec<Direction>,
    /// Whether the change is real.
    pub test: ChangeTest,
    /// Residuals over what was expected, squared: sigmas are larger by its root where it exceeds 1.
    pub variance_factor: f64,
    /// chi^2 of each face after the adjustment, 8 degrees of freedom, in the order given; `None` for one that could not be
    /// fitted.
    pub face_chi_squares: Vec<Option<f64>>,
    motions: Motions,
    covariance: MotionMatrix,
    by_motion: [Matrix3<f64>; 4],
}

/// The faces weighed at some motion of the lasers.
struct Sums {
    information: MotionMatrix,
    gradient: Motions,
    chi_square: f64,
    weight: f64,
    faces: Vec<Option<f64>>,
}

/// Estimates how the lasers have moved since `calibration`, with which the faces were measured.
///
/// The camera is taken as calibrated: what its covariance leaves (0.02 px) is below a line's own systematic part.
///
/// # Errors
/// [`ErrorKind::InvalidFrame`] if fewer than 3 faces can be fitted.
pub fn estimate_drift(calibration: &Calibration, faces: &[ObservedFace]) -> Result<Drift, Error> {
    let no = |text: &str| Error::new(ErrorKind::InvalidCalibration, text);
    let too_few = |found: usize| {
        Error::new(ErrorKind::InvalidFrame, format!("{found} measured faces, {MIN_FACES} are needed"))
    };
    if faces.len() < MIN_FACES {
        return Err(too_few(faces.len()));
    }
    let by_motion = all_planes_by_motion(calibration)
        .ok_or_else(|| no("a laser plane faces the camera: its motion is not defined"))?;
    let known: Vec<Vec<KnownSide>> = faces
        .iter()
        .map(|face| {
            let nominal =
                FittedFace::new(calibration.camera(), calibration.lasers(), &face.lines, &[], &face.start);
            nominal.map_or_else(Vec::new, |fitted| face.known_sides(&fitted))
        })
        .collect();
    let calibrated = calibrated_covariance(calibration, &by_motion)
        .ok_or_else(|| no("the laser planes cannot be expressed by motions of lasers"))?;
    let prior = calibrated
        + possible_covariance(calibration, &by_motion)
            .ok_or_else(|| no("the laser planes cannot be expressed by motions of lasers"))?;
    // Unknowns in units of what is possible: even, and free of units. motions = units y.
    let units = prior.cholesky().ok_or_else(|| no("covariance is not positive definite"))?.l();
    let mut states: Vec<FaceState> = faces.iter().map(|f| f.start).collect();
    let mut motions = Motions::zeros();
    let mut sums = weigh(calibration, faces, &known, &by_motion, &motions, &mut states, 1.0);
    for _ in 0..ITERATIONS {
        let fitted = sums.faces.iter().flatten().count();
        if fitted < MIN_FACES {
            return Err(too_few(fitted));
        }
        let factor = variance_factor(&sums);
        let information = units.transpose() * sums.information * units / factor;
        let gradient = units.transpose() * sums.gradient / factor - pulled(&units, &motions);
        let step = (information + MotionMatrix::identity())
            .cholesky()
            .ok_or_else(|| no("the faces give no finite information"))?
            .solve(&gradient);
        motions += units * step;
        sums = weigh(calibration, faces, &known, &by_motion, &motions, &mut states, factor);
        if step.amax() < 1e-6 {
            break;
        }
    }
    let factor = variance_factor(&sums);
    let information = units.transpose() * sums.information * units / factor;
    let posterior = (information + MotionMatrix::identity())
        .try_inverse()
        .ok_or_else(|| no("the faces give no finite information"))?;
    let covariance = units * posterior * units.transpose();
    let planes = moved(calibration.lasers(), &by_motion, &motions);
    let directions = directions::directions(&information, &units, &by_motion, &planes)
        .ok_or_else(|| no("the faces give no finite information"))?;
    let test = significance::test(&directions, &units, &motions, &calibrated);
    let sigmas = Motions::from_fn(|i, _| covariance[(i, i)].max(0.0).sqrt());
    Ok(Drift {
        lasers: std::array::from_fn(|k| (LaserMotion::from(&motions, k), LaserMotion::from(&sigmas, k))),
        directions,
        test,
        variance_factor: factor,
        face_chi_squares: sums.faces,
        motions,
        covariance,
        by_motion,
    })
}

impl Drift {
    /// The calibration with the lasers where the faces see them. It has a covariance only if `calibration` had one: the
    /// camera's is taken from there.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidCalibration`] if the moved planes are no head's.
    pub fn apply(&self, calibration: &Calibration) -> Result<Calibration, Error> {
        let planes = moved(calibration.lasers(), &self.by_motion, &self.motions);
        let size_px = [calibration.width_px(), calibration.height_px()];
        let planes = planes.map(|p| [p.per_mm.x, p.per_mm.y, p.per_mm.z, -1.0]);
        let updated = Calibration::new(calibration.serial(), size_px, *calibration.camera(), planes)?;
        let Some(old) = calibration.covariance() else { return Ok(updated) };
        let to_planes = blocks(&self.by_motion);
        let planes = to_planes * self.covariance * to_planes.transpose();
        let mut covariance = CalibrationCovariance::zeros();
        for (i, j) in CAMERA.into_iter().flat_map(|i| CAMERA.map(|j| (i, j))) {
            covariance[(i, j)] = old[(i, j)];
        }
        covariance.fixed_view_mut::<12, 12>(6, 6).copy_from(&((planes + planes.transpose()) * 0.5));
        updated.with_covariance(covariance)
    }
}

/// Refits every face to the moved lasers and adds up what they say.
fn weigh(
    calibration: &Calibration,
    faces: &[ObservedFace],
    known: &[Vec<KnownSide>],
    by_motion: &[Matrix3<f64>; 4],
    motions: &Motions,
    states: &mut [FaceState],
    factor: f64,
) -> Sums {
    let planes = moved(calibration.lasers(), by_motion, motions);
    let to_planes = blocks(by_motion);
    let mut sums = Sums {
        information: MotionMatrix::zeros(),
        gradient: Motions::zeros(),
        chi_square: 0.0,
        weight: 0.0,
        faces: Vec::with_capacity(faces.len()),
    };
    for ((face, known), state) in faces.iter().zip(known).zip(states) {
        let fitted = FittedFace::new(calibration.camera(), &planes, &face.lines, known, state);
        let on_planes = fitted.and_then(|fitted| Some((fitted.on_planes()?, fitted)));
        sums.faces.push(on_planes.as_ref().map(|(_, fitted)| fitted.chi_square));
        let Some(((information, gradient), fitted)) = on_planes else { continue };
        *state = fitted.state;
        let w = (FACE_CHI_SQUARE_99 * factor / fitted.chi_square.max(1e-12)).sqrt().min(1.0);
        sums.information += to_planes.transpose() * information * to_planes * w;
        sums.gradient += to_planes.transpose() * gradient * w;
        sums.chi_square += w * fitted.chi_square;
        sums.weight += w;
    }
    sums
}

/// chi^2 over its degrees of freedom, at least 1: residuals that are smaller than expected prove nothing.
fn variance_factor(sums: &Sums) -> f64 {
    let freedom = sums.weight * REDUNDANT as f64 - 12.0;
    if freedom >= REDUNDANT as f64 { (sums.chi_square / freedom).max(1.0) } else { 1.0 }
}

/// The prior's pull in units of itself: `units^-1 motions`.
fn pulled(units: &MotionMatrix, motions: &Motions) -> Motions {
    units.solve_lower_triangular(motions).unwrap_or_else(Motions::zeros)
}

/// The calibration's own covariance of the planes as motions; zero without one.
fn calibrated_covariance(calibration: &Calibration, by_motion: &[Matrix3<f64>; 4]) -> Option<MotionMatrix> {
    let Some(covariance) = calibration.covariance() else { return Some(MotionMatrix::zeros()) };
    let planes: SMatrix<f64, 12, 12> = covariance.fixed_view::<12, 12>(6, 6).into();
    let mut to_motions = MotionMatrix::zeros();
    for (k, b) in by_motion.iter().enumerate() {
        to_motions.fixed_view_mut::<3, 3>(3 * k, 3 * k).copy_from(&b.try_inverse()?);
    }
    Some(to_motions * planes * to_motions.transpose())
}

/// What is thought possible before looking.
fn possible_covariance(calibration: &Calibration, by_motion: &[Matrix3<f64>; 4]) -> Option<MotionMatrix> {
    let scale = scale_motion(calibration.lasers(), by_motion)? * PRIOR_SCALE;
    let mut possible = scale * scale.transpose();
    for laser in LaserId::ALL {
        let at = 3 * laser.index();
        possible[(at, at)] += PRIOR_TURN_RAD.powi(2);
        possible[(at + 1, at + 1)] += PRIOR_TURN_RAD.powi(2);
        possible[(at + 2, at + 2)] += PRIOR_SHIFT_MM.powi(2);
    }
    Some(possible)
}

/// The motions that scale everything the head sees by a factor of 1 + 1: `p -> p / (1 + s)`, ds = 1.
fn scale_motion(planes: &[Plane<Cam>; 4], by_motion: &[Matrix3<f64>; 4]) -> Option<Motions> {
    motions_of(by_motion, &planes.map(|p| -p.per_mm))
}
