//! Eight unknowns of a face (its pose but for the place on the plane, and its four sides) against its 16 numbers. On the
//! plane q a side at the offset d along the axis e is where `e . X = d`, and X = x / (q . x): **(e - d q) . x = 0**, a line of
//! the ideal image as a stripe's (q - p_k) . x = 0 is. Derivatives are analytic; the factor to px is taken as constant.

use super::{FaceLines, Line};
use crate::camera::CameraModel;
use crate::frames::{Cam, Plane};
use crate::measurement::FaceMeasurement;
use crate::units::Px;
use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector3};

/// Unknowns of a face: turn about the camera's axes (3, rad), 1 / distance (1/mm), offsets of the sides (4, mm).
pub(crate) const OWN: usize = 8;
/// Numbers that check a face.
pub(crate) const REDUNDANT: usize = 8;

type Own = SVector<f64, OWN>;
/// Information on a face's unknowns.
pub(crate) type OwnMatrix = SMatrix<f64, OWN, OWN>;
/// Unknowns of the laser planes, `p . X = 1`, laser 1 first, 1/mm.
pub(crate) type Planes = SVector<f64, 12>;
pub(crate) type PlanesMatrix = SMatrix<f64, 12, 12>;
type Mixed = SMatrix<f64, OWN, 12>;

/// Newton steps; the problem is nearly linear, 3 or 4 are used.
const ITERATIONS: usize = 12;
const HALVINGS: i32 = 10;

/// Where a face is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FaceState {
    /// Columns: along the length, along the width, away from the camera.
    pub axes: Matrix3<f64>,
    /// 1 / distance of the plane from the camera.
    pub per_mm: f64,
    /// Offsets of the sides going round: 0 and 2 along the width's axis, 1 and 3 along the length's.
    pub offsets_mm: [f64; 4],
}

/// The axis across a side: 1 (width) for sides 0 and 2, 0 (length) for 1 and 3.
const ACROSS: [usize; 4] = [1, 0, 1, 0];

/// A face fitted to its lines, with what that tells about the lasers.
#[derive(Clone, Debug)]
pub(crate) struct FittedFace {
    pub state: FaceState,
    pub chi_square: f64,
    /// Information on the face's own unknowns.
    pub own: OwnMatrix,
    mixed: Mixed,
    planes: PlanesMatrix,
    planes_gradient: Planes,
    own_gradient: Own,
}

/// One residual: in px, its derivative by the face, and by the plane of a laser.
struct Row {
    px: f64,
    by_face: Own,
    by_plane: Option<(usize, Vector3<f64>)>,
}

impl FaceState {
    /// The state of a measured face, its corners as they are.
    pub fn from_measurement(face: &FaceMeasurement) -> Option<Self> {
        let (normal, distance_mm) = face.plane.normal_and_distance_mm();
        let [c0, c1, c2, c3] = face.corners.map(|c| c.mm);
        let along = c1 - c0;
        let length_axis = (along - normal * normal.dot(&along)).try_normalize(1e-9)?;
        let width_axis = normal.cross(&length_axis);
        let offset = |axis: Vector3<f64>, a: Vector3<f64>, b: Vector3<f64>| 0.5 * axis.dot(&(a + b));
        Some(Self {
            axes: Matrix3::from_columns(&[length_axis, width_axis, normal]),
            per_mm: 1.0 / distance_mm,
            offsets_mm: [
                offset(width_axis, c0, c1),
                offset(length_axis, c1, c2),
                offset(width_axis, c2, c3),
                offset(length_axis, c3, c0),
            ],
        })
    }

    /// The face's plane, 1/mm.
    pub fn plane(&self) -> Vector3<f64> {
        self.axes.column(2) * self.per_mm
    }

    /// Length and width, mm.
    pub fn sides_mm(&self) -> [f64; 2] {
        let [w0, l0, w1, l1] = self.offsets_mm;
        [(l1 - l0).abs(), (w1 - w0).abs()]
    }

    /// Derivative of length (0) or width (1) by the unknowns.
    pub fn side_by_own(&self, side: usize) -> SVector<f64, OWN> {
        let (low, high) = if side == 0 { (1, 3) } else { (0, 2) };
        let sign = if self.offsets_mm[high] > self.offsets_mm[low] { 1.0 } else { -1.0 };
        let mut by = Own::zeros();
        by[4 + high] = sign;
        by[4 + low] = -sign;
        by
    }

    fn plus(&self, step: &Own) -> Self {
        let turn = Rotation3::new(step.fixed_rows::<3>(0).into_owned());
        let mut next = *self;
        next.axes = turn.matrix() * self.axes;
        next.per_mm += step[3];
        for (offset, by) in next.offsets_mm.iter_mut().zip(step.iter().skip(4)) {
            *offset += by;
        }
        next
    }

    fn stripe_row(&self, camera: &CameraModel, lasers: &[Plane<Cam>; 4], k: usize, at: Px) -> Option<Row> {
        let q = self.plane();
        let (x, per_px) = scaled(camera, at, &(q - lasers[k].per_mm))?;
        let mut by_face = Own::zeros();
        by_face.fixed_rows_mut::<3>(0).copy_from(&(q.cross(&x) * per_px));
        by_face[3] = self.axes.column(2).dot(&x) * per_px;
        let px = (q - lasers[k].per_mm).dot(&x) * per_px;
        Some(Row { px, by_face, by_plane: Some((k, x * -per_px)) })
    }

    fn side_row(&self, camera: &CameraModel, side: usize, at: Px) -> Option<Row> {
        let offset_mm = self.offsets_mm[side];
        let line: Vector3<f64> = self.axes.column(ACROSS[side]) - self.plane() * offset_mm;
        let (x, per_px) = scaled(camera, at, &line)?;
        let mut by_face = Own::zeros();
        by_face.fixed_rows_mut::<3>(0).copy_from(&(line.cross(&x) * per_px));
        by_face[3] = -offset_mm * self.axes.column(2).dot(&x) * per_px;
        by_face[4 + side] = -self.plane().dot(&x) * per_px;
        Some(Row { px: line.dot(&x) * per_px, by_face, by_plane: None })
    }
}

/// The ray of a pixel, and the factor from `line . x` to px across the line.
fn scaled(camera: &CameraModel, at: Px, line: &Vector3<f64>) -> Option<(Vector3<f64>, f64)> {
    let (ray, jacobian) = camera.ray_from_px_with_jacobian(at);
    let gradient = (jacobian.transpose() * line.xy()).norm();
    (gradient > 1e-12 && gradient.is_finite()).then(|| (ray.xy1, 1.0 / gradient))
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
        let mut fitted = Self::at(camera, lasers, lines, known, start)?;
        for _ in 0..ITERATIONS {
            // The unknowns have sizes from 1e-3 to 1e3: scale before solving.
            let units = Own::from_fn(|i, _| 1.0 / fitted.own[(i, i)].max(1e-300).sqrt());
            let even = OwnMatrix::from_diagonal(&units) * fitted.own * OwnMatrix::from_diagonal(&units);
            let even_step = even.cholesky()?.solve(&fitted.own_gradient.component_mul(&units));
            let step = even_step.component_mul(&units);
            // Lines that contradict each other bend the way to the minimum: a step that leads up is halved.
            let next = (0..HALVINGS)
                .filter_map(|n| {
                    let state = fitted.state.plus(&(step * 0.5f64.powi(n)));
                    Self::at(camera, lasers, lines, known, &state)
                })
                .find(|next| next.chi_square <= fitted.chi_square);
            let Some(next) = next else { break };
            fitted = next;
            if even_step.amax() < 1e-6 {
                break;
            }
        }
        fitted.chi_square.is_finite().then_some(fitted)
    }

    fn at(
        camera: &CameraModel,
        lasers: &[Plane<Cam>; 4],
        lines: &FaceLines,
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
        let each = |line: &Line| line.map(|p| (p.at, p.sigma_px));
        for k in 0..4 {
            for (at, sigma_px) in each(&lines.stripes[k]) {
                sums.add(&state.stripe_row(camera, lasers, k, at)?, sigma_px);
            }
            for (at, sigma_px) in each(&lines.sides[k]) {
                sums.add(&state.side_row(camera, k, at)?, sigma_px);
            }
        }
        for side in known {
            let off_mm = state.sides_mm()[side.which] - side.raw_mm;
            sums.add(
                &Row { px: off_mm, by_face: state.side_by_own(side.which), by_plane: None },
                side.sigma_mm,
            );
        }
        Some(sums)
    }

    fn add(&mut self, row: &Row, sigma: f64) {
        let w = sigma.powi(-2);
        self.chi_square += w * row.px * row.px;
        self.own.ger(w, &row.by_face, &row.by_face, 1.0);
        self.own_gradient -= row.by_face * (w * row.px);
        if let Some((k, by_plane)) = &row.by_plane {
            let mut block = self.planes.fixed_view_mut::<3, 3>(3 * k, 3 * k);
            block += by_plane * by_plane.transpose() * w;
            let mut mixed = self.mixed.fixed_columns_mut::<3>(3 * k);
            mixed += row.by_face * by_plane.transpose() * w;
            let mut gradient = self.planes_gradient.fixed_rows_mut::<3>(3 * k);
            gradient -= by_plane * (w * row.px);
        }
    }

    /// Information on the laser planes with the face's own unknowns eliminated, and the step's right side (minus half the
    /// gradient of chi^2).
    pub fn on_planes(&self) -> Option<(PlanesMatrix, Planes)> {
        let solved = self.solve_own(&self.mixed)?;
        let gradient = self.planes_gradient - solved.transpose() * self.own_gradient;
        Some((self.planes - self.mixed.transpose() * solved, gradient))
    }

    /// Derivative of the face's unknowns by the laser planes, pixels staying where they are.
    pub fn own_by_planes(&self) -> Option<SMatrix<f64, OWN, 12>> {
        self.solve_own(&self.mixed).map(|m| -m)
    }

    /// Covariance of the face's unknowns from its lines alone.
    pub fn own_covariance(&self) -> Option<OwnMatrix> {
        self.solve_own(&OwnMatrix::identity())
    }

    fn solve_own<const N: usize>(&self, right: &SMatrix<f64, OWN, N>) -> Option<SMatrix<f64, OWN, N>> {
        let units = OwnMatrix::from_diagonal(&Own::from_fn(|i, _| 1.0 / self.own[(i, i)].max(1e-300).sqrt()));
        Some(units * (units * self.own * units).cholesky()?.solve(&(units * right)))
    }
}

/// A side whose length is known.
#[derive(Clone, Copy, Debug)]
pub(crate) struct KnownSide {
    /// 0: the length, 1: the width.
    pub which: usize,
    /// What the lines, which lie inside the sharp edges, should then give, mm.
    pub raw_mm: f64,
    pub sigma_mm: f64,
}

#[cfg(test)]
mod tests {
    use super::super::simulation::{head, some_face};
    use super::*;
    use crate::noise::Noise;

    #[test]
    fn derivatives_are_differences_of_the_residual() {
        let calibration = head();
        let mut noise = Noise::new(5);
        let (state, lines) = some_face(&calibration, &mut noise, 0.0);
        // Away from the truth, where residuals are not zero but small.
        let state = state.plus(&Own::from_column_slice(&[1e-4, -2e-4, 1e-4, 1e-8, 0.1, -0.1, 0.2, 0.1]));
        let camera = calibration.camera();
        let rows = |state: &FaceState, lasers: &[Plane<Cam>; 4]| -> Vec<Row> {
            (0..4)
                .flat_map(|k| {
                    let stripe = lines.stripes[k].map(|p| state.stripe_row(camera, lasers, k, p.at));
                    let side = lines.sides[k].map(|p| state.side_row(camera, k, p.at));
                    stripe.into_iter().chain(side).map(|row| row.expect("in view"))
                })
                .collect()
        };
        let lasers = calibration.lasers();
        let here = rows(&state, lasers);
        let close = |analytic: f64, numeric: f64| {
            assert!((analytic - numeric).abs() < 2e-3 * (1e-3 + numeric.abs()), "{analytic} {numeric}");
        };
        for i in 0..OWN {
            let size = [1e-6, 1e-6, 1e-6, 1e-10, 1e-4, 1e-4, 1e-4, 1e-4][i];
            let mut step = Own::zeros();
            step[i] = size;
            let (up, down) = (rows(&state.plus(&step), lasers), rows(&state.plus(&-step), lasers));
            for (n, row) in here.iter().enumerate() {
                close(row.by_face[i] * size * 1e3, (up[n].px - down[n].px) / 2.0 * 1e3);
            }
        }
        for k in 0..4 {
            for axis in 0..3 {
                let mut moved = *lasers;
                moved[k].per_mm[axis] += 1e-9;
                for (row, there) in here.iter().zip(rows(&state, &moved)) {
                    let by = row.by_plane.filter(|(laser, _)| *laser == k).map_or(0.0, |(_, by)| by[axis]);
                    close(by * 1e-9 * 1e3, (there.px - row.px) * 1e3);
                }
            }
        }
    }

    #[test]
    fn a_face_is_found_again_from_its_lines() {
        let calibration = head();
        let mut noise = Noise::new(6);
        for _ in 0..50 {
            let (state, lines) = some_face(&calibration, &mut noise, 0.0);
            let start = state.plus(&Own::from_column_slice(&[2e-3, -3e-3, 5e-3, 1e-6, 2.0, -2.0, 3.0, 1.0]));
            let fitted = FittedFace::new(calibration.camera(), calibration.lasers(), &lines, &[], &start)
                .expect("16 numbers fix 8");
            for (found, true_mm) in fitted.state.sides_mm().iter().zip(state.sides_mm()) {
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
            let by = fitted.state.side_by_own(0);
            let variance = (by.transpose() * fitted.own_covariance().expect("regular") * by)[0];
            squares += (fitted.state.sides_mm()[0] - state.sides_mm()[0]).powi(2) / variance;
        }
        // Mean 8 +- 4 / sqrt(400) = 0.2, four of them; variance ratio 1 +- sqrt(2 / 400) = 0.07, four of them.
        let mean = sum / FACES as f64;
        assert!((mean - REDUNDANT as f64).abs() < 0.8, "mean chi^2 {mean}");
        let ratio = squares / FACES as f64;
        assert!((0.72..1.28).contains(&ratio), "variance over predicted {ratio}");
    }
}
