//! A face fitted to its 16 numbers ([`FaceState`], as a rectangle), and what they then say of the lasers.

use super::FaceLines;
use crate::camera::CameraModel;
use crate::face::model::{FaceState, OFFSETS, Observation, Row, SHAPE, Source, Unknowns, solve};
use crate::frames::{Cam, Plane};
use nalgebra::{SMatrix, SVector};

/// Unknowns of a face: those of a rectangle.
const OWN: usize = SHAPE;
/// Numbers that check a face.
pub const REDUNDANT: usize = 8;

type Own = SVector<f64, OWN>;
/// Information on a face's unknowns.
pub type OwnMatrix = SMatrix<f64, OWN, OWN>;
/// Unknowns of the laser planes, `p . X = 1`, laser 1 first, 1/mm.
pub type Planes = SVector<f64, 12>;
/// Information on the laser planes, in the order of [`Planes`].
pub type PlanesMatrix = SMatrix<f64, 12, 12>;
type Mixed = SMatrix<f64, OWN, 12>;

/// Newton steps; the problem is nearly linear, 3 or 4 are used.
const ITERATIONS: usize = 12;
const HALVINGS: i32 = 10;

/// A face fitted to its lines, with what that tells about the lasers.
#[derive(Clone, Debug)]
pub struct FittedFace {
    /// The face.
    pub state: FaceState,
    /// Squared residuals of its lines and known sides in units of their variances; [`REDUNDANT`] degrees of freedom and one for each known side.
    pub chi_square: f64,
    /// Information on the face's own unknowns.
    own: OwnMatrix,
    mixed: Mixed,
    planes: PlanesMatrix,
    planes_gradient: Planes,
    own_gradient: Own,
}

/// Derivative of the length (0, across a) or width (1) by the unknowns.
pub fn length_by_own(state: &FaceState, which: usize) -> SVector<f64, OWN> {
    let (low, high) = (2 * which, 2 * which + 1);
    let sign = if state.offsets_mm[high] > state.offsets_mm[low] { 1.0 } else { -1.0 };
    let mut by = Own::zeros();
    (by[OFFSETS + low], by[OFFSETS + high]) = (-sign, sign);
    by
}

impl FittedFace {
    /// Fits the face. `None` if the lines do not fix it. A known length or width in mm with its sigma is one more row.
    pub fn new(
        camera: &CameraModel,
        lasers: &[Plane<Cam>; 4],
        lines: &FaceLines,
        known: &[KnownSide],
        start: &FaceState,
    ) -> Option<Self> {
        let seen = lines.seen(camera);
        let mut fitted = Self::at(lasers, &seen, known, start)?;
        for _ in 0..ITERATIONS {
            let step = solve(&fitted.own, &fitted.own_gradient)?;
            let change = Unknowns::from_fn(|i, _| if i < OWN { step[i] } else { 0.0 });
            // Lines that contradict each other bend the way to the minimum: a step that leads up is halved.
            let next = (0..HALVINGS)
                .filter_map(|n| {
                    Self::at(lasers, &seen, known, &fitted.state.plus(&(change * 0.5f64.powi(n))))
                })
                .find(|next| next.chi_square <= fitted.chi_square);
            let expected = step.dot(&fitted.own_gradient);
            let Some(next) = next else { break };
            fitted = next;
            if expected < 1e-12 {
                break;
            }
        }
        fitted.chi_square.is_finite().then_some(fitted)
    }

    fn at(
        lasers: &[Plane<Cam>; 4],
        seen: &[Observation],
        known: &[KnownSide],
        state: &FaceState,
    ) -> Option<Self> {
        let mut sums = Self {
            state: *state,
            chi_square: 0.0,
            own: OwnMatrix::zeros(),
            mixed: Mixed::zeros(),
            planes: PlanesMatrix::zeros(),
            planes_gradient: Planes::zeros(),
            own_gradient: Own::zeros(),
        };
        let lines = state.lines(lasers);
        for seen in seen {
            sums.add_row(&lines.row(seen)?);
        }
        for side in known {
            let off_mm = state.lengths_mm()[side.which] - side.raw_mm;
            sums.add(off_mm, &length_by_own(state, side.which), side.sigma_mm.powi(-2));
        }
        Some(sums)
    }

    fn add(&mut self, off: f64, by_face: &Own, weight: f64) {
        self.chi_square += weight * off * off;
        self.own.ger(weight, by_face, by_face, 1.0);
        self.own_gradient -= by_face * (weight * off);
    }

    fn add_row(&mut self, row: &Row) {
        let by_face = row.derivative_px.fixed_rows::<OWN>(0).into_owned();
        self.add(row.px, &by_face, row.weight);
        if let Source::Stripe(k) = row.source {
            let by_plane = row.by_laser_px;
            let mut block = self.planes.fixed_view_mut::<3, 3>(3 * k, 3 * k);
            block += by_plane * by_plane.transpose() * row.weight;
            let mut mixed = self.mixed.fixed_columns_mut::<3>(3 * k);
            mixed += by_face * by_plane.transpose() * row.weight;
            let mut gradient = self.planes_gradient.fixed_rows_mut::<3>(3 * k);
            gradient -= by_plane * (row.weight * row.px);
        }
    }

    /// Information on the laser planes with the face's own unknowns eliminated, and the step's right side (minus half the
    /// gradient of chi^2).
    pub fn on_planes(&self) -> Option<(PlanesMatrix, Planes)> {
        let solved = solve(&self.own, &self.mixed)?;
        let gradient = self.planes_gradient - solved.transpose() * self.own_gradient;
        Some((self.planes - self.mixed.transpose() * solved, gradient))
    }

    /// Derivative of the face's unknowns by the laser planes, pixels staying where they are.
    pub fn own_by_planes(&self) -> Option<Mixed> {
        solve(&self.own, &self.mixed).map(|m| -m)
    }

    /// Covariance of the face's unknowns from its lines alone.
    pub fn own_covariance(&self) -> Option<OwnMatrix> {
        solve(&self.own, &OwnMatrix::identity())
    }
}

/// A side whose length is known.
#[derive(Clone, Copy, Debug)]
pub struct KnownSide {
    /// 0: the length, 1: the width.
    pub which: usize,
    /// What the lines, which lie inside the sharp edges, should then give, mm.
    pub raw_mm: f64,
    /// Its standard deviation, mm.
    pub sigma_mm: f64,
}

#[cfg(test)]
mod tests {
    use super::super::simulation::{head, some_face};
    use super::*;
    use crate::noise::Noise;

    #[test]
    fn a_face_is_found_again_from_its_lines() {
        let calibration = head();
        let mut noise = Noise::new(6);
        for _ in 0..50 {
            let (state, lines) = some_face(&calibration, &mut noise, 0.0);
            let start = state.plus(&Unknowns::from_column_slice(&[
                2e-3, -3e-3, 1e-6, 5e-3, 2.0, -2.0, 3.0, 1.0, 0.0, 0.0, 0.0,
            ]));
            let fitted = FittedFace::new(calibration.camera(), calibration.lasers(), &lines, &[], &start)
                .expect("16 numbers fix 8");
            for (found, true_mm) in fitted.state.lengths_mm().iter().zip(state.lengths_mm()) {
                assert!((found - true_mm).abs() < 1e-5, "{found} {true_mm}");
            }
            assert!(fitted.chi_square < 1e-9);
        }
    }

    /// 8 of the 16 numbers are spent on the face: chi^2 has 8 degrees of freedom.
    #[test]
    fn noise_gives_the_chi_square_of_eight_and_sides_within_their_sigma() {
        let calibration = head();
        let mut noise = Noise::new(7);
        let (mut sum, mut squares) = (0.0, 0.0);
        const FACES: usize = 400;
        for _ in 0..FACES {
            let (state, lines) = some_face(&calibration, &mut noise, 1.0);
            let fitted = FittedFace::new(calibration.camera(), calibration.lasers(), &lines, &[], &state)
                .expect("16 numbers fix 8");
            sum += fitted.chi_square;
            let by = length_by_own(&fitted.state, 0);
            let variance = (by.transpose() * fitted.own_covariance().expect("regular") * by)[0];
            squares += (fitted.state.lengths_mm()[0] - state.lengths_mm()[0]).powi(2) / variance;
        }
        // Mean 8 +- 4 / sqrt(400) = 0.2, four of them; variance ratio 1 +- sqrt(2 / 400) = 0.07, four of them.
        let mean = sum / FACES as f64;
        assert!((mean - REDUNDANT as f64).abs() < 0.8, "mean chi^2 {mean}");
        let ratio = squares / FACES as f64;
        assert!((0.72..1.28).contains(&ratio), "variance over predicted {ratio}");
    }
}
