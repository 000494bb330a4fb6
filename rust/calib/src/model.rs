//! What is observed against what the unknowns predict, in px, with analytic derivatives.

use super::board::OnBoard;
use super::rim::board_matrix;
use boxline::calibration::{CAMERA, FIRST_PLANE, PARAMETERS, moved as moved_by};
use boxline::camera::CameraModel;
use boxline::frames::{Cam, Plane, Pose, Ray};
use boxline::units::Px;
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};

/// Unknowns that all frames share: those of a calibration ([`boxline::calibration::PARAMETERS`]), then the skew.
pub(super) const SHARED: usize = PARAMETERS + 1;
/// The skew.
pub(super) const SKEW: usize = PARAMETERS;
/// The camera's, in the order of [`ray_by_camera`].
const BY_CAMERA: [usize; 10] = {
    let mut all = [SKEW; 10];
    let mut i = 0;
    while i < CAMERA.len() {
        all[i] = CAMERA[i];
        i += 1;
    }
    all
};
/// Unknowns of a pose: rotation vector about the camera's axes (rad), translation (mm).
pub(super) const POSE: usize = 6;

/// Camera and planes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Shared {
    pub camera: CameraModel,
    pub planes: [Vector3<f64>; 4],
}

impl Shared {
    pub fn plus(&self, step: &SVector<f64, SHARED>) -> Self {
        let lasers = self.planes.map(Plane::new);
        let (mut camera, lasers) = moved_by(&self.camera, &lasers, &step.fixed_rows::<PARAMETERS>(0).into());
        camera.skew += step[SKEW];
        Self { camera, planes: lasers.map(|plane| plane.per_mm) }
    }

    /// Difference of the parameters, in the order of the covariance.
    pub fn minus(&self, other: &Self) -> SVector<f64, PARAMETERS> {
        let parameters = |s: &Self| {
            let c = &s.camera;
            let planes = s.planes.iter().flat_map(|p| [p.x, p.y, p.z]);
            let more = [c.p1, c.p2, c.k3];
            let all = [c.fx, c.fy, c.cx, c.cy, c.k1, c.k2].into_iter().chain(planes).chain(more);
            SVector::<f64, PARAMETERS>::from_iterator(all)
        };
        parameters(self) - parameters(other)
    }
}

/// A pose moved by a small rotation (after its own) and translation.
pub(super) fn moved(pose: &Pose<Cam, OnBoard>, step: &SVector<f64, POSE>) -> Pose<Cam, OnBoard> {
    let turn = nalgebra::Rotation3::new(Vector3::new(step[0], step[1], step[2]));
    Pose::new(turn.matrix() * pose.rotation, pose.translation_mm + step.fixed_rows::<3>(3))
}

/// One residual in px and its derivatives.
pub(super) struct Row {
    pub px: f64,
    pub by_shared: SVector<f64, SHARED>,
    pub by_pose: SVector<f64, POSE>,
}

/// The board's plane `q . X = 1`, 1/mm.
pub(super) fn board_plane(pose: &Pose<Cam, OnBoard>) -> Vector3<f64> {
    let normal: Vector3<f64> = pose.rotation.column(2).into();
    normal / normal.dot(&pose.translation_mm)
}

/// d(ideal ray of a fixed pixel) / d(fx, fy, cx, cy, k1, k2, p1, p2, k3, skew).
pub(super) fn ray_by_camera(camera: &CameraModel, px: Px) -> SMatrix<f64, 2, { BY_CAMERA.len() }> {
    let d = camera.distorted_from_px(px);
    let by_distorted = camera.ideal_by_distorted(d);
    let r2 = d.norm_squared();
    let (fx, fy, s) = (camera.fx, camera.fy, camera.skew);
    let mut out = SMatrix::<f64, 2, { BY_CAMERA.len() }>::zeros();
    let columns = [
        Vector2::new(-d.x / fx, 0.0),
        Vector2::new(s * d.y / (fx * fy), -d.y / fy),
        Vector2::new(-1.0 / fx, 0.0),
        Vector2::new(s / (fx * fy), -1.0 / fy),
    ];
    for (k, column) in columns.into_iter().enumerate() {
        out.set_column(k, &(by_distorted * column));
    }
    out.set_column(4, &(d * r2));
    out.set_column(5, &(d * (r2 * r2)));
    out.set_column(6, &Vector2::new(2.0 * d.x * d.y, r2 + 2.0 * d.y * d.y));
    out.set_column(7, &Vector2::new(r2 + 2.0 * d.x * d.x, 2.0 * d.x * d.y));
    out.set_column(8, &(d * (r2 * r2 * r2)));
    out.set_column(9, &(by_distorted * Vector2::new(-d.y / fx, 0.0)));
    out
}

/// A place on the board in the camera's frame, mm.
pub(super) fn point_on_board(pose: &Pose<Cam, OnBoard>, board_mm: Vector2<f64>) -> Vector3<f64> {
    pose.rotation.column(0) * board_mm.x + pose.rotation.column(1) * board_mm.y + pose.translation_mm
}

/// The pixel of a point and its derivatives by the point (px / mm) and by the point's ray. `None` behind the camera.
pub(super) fn px_by_point(
    camera: &CameraModel,
    point: &Vector3<f64>,
) -> Option<(Px, SMatrix<f64, 2, 3>, Matrix2<f64>)> {
    if point.z < 1.0 {
        return None;
    }
    let ray = Ray::new(point.x / point.z, point.y / point.z);
    let (px, px_by_ray) = camera.px_from_ray_with_jacobian(&ray)?;
    let ray_by_point = SMatrix::<f64, 2, 3>::new(1.0, 0.0, -ray.xy1.x, 0.0, 1.0, -ray.xy1.y) / point.z;
    Some((px, px_by_ray * ray_by_point, px_by_ray))
}

/// The two residuals (observed - projected; u, v) of a circle's centre. `None` behind the camera.
pub(super) fn centre_rows(
    shared: &Shared,
    pose: &Pose<Cam, OnBoard>,
    board_mm: Vector2<f64>,
    at: Px,
) -> Option<[Row; 2]> {
    let camera = &shared.camera;
    let point = point_on_board(pose, board_mm);
    let turned = point - pose.translation_mm;
    let (px, px_by_point, px_by_ray) = px_by_point(camera, &point)?;
    let by_turn = px_by_point * -turned.cross_matrix();
    // A pixel that keeps its ray: d(px) = -d(px)/d(ray) d(ray)/d(camera).
    let by_camera = px_by_ray * -ray_by_camera(camera, px);
    let row = |axis: usize, residual: f64| {
        let mut by_shared = SVector::zeros();
        for (k, unknown) in BY_CAMERA.into_iter().enumerate() {
            by_shared[unknown] = -by_camera[(axis, k)];
        }
        let mut by_pose = SVector::zeros();
        for k in 0..3 {
            by_pose[k] = -by_turn[(axis, k)];
            by_pose[3 + k] = -px_by_point[(axis, k)];
        }
        Row { px: residual, by_shared, by_pose }
    };
    Some([row(0, at.u - px.u), row(1, at.v - px.v)])
}

/// The residual of a stripe's centre: its distance from where the laser's plane meets the board, px across the stripe.
/// The factor from (q - p) . x to px is taken as constant.
pub(super) fn stripe_row(shared: &Shared, pose: &Pose<Cam, OnBoard>, laser: usize, at: Px) -> Option<Row> {
    let camera = &shared.camera;
    let (ray, jacobian) = camera.ray_from_px_with_jacobian(at);
    let normal: Vector3<f64> = pose.rotation.column(2).into();
    let distance = normal.dot(&pose.translation_mm);
    let q = normal / distance;
    let line = q - shared.planes[laser];
    let gradient = (jacobian.transpose() * line.xy()).norm();
    if gradient < 1e-12 || !gradient.is_finite() {
        return None;
    }
    let per = 1.0 / gradient;
    let by_line = ray.xy1 * per;
    let mut by_shared = SVector::<f64, SHARED>::zeros();
    let by_camera = ray_by_camera(camera, at).transpose() * line.xy() * per;
    for (k, unknown) in BY_CAMERA.into_iter().enumerate() {
        by_shared[unknown] = by_camera[k];
    }
    by_shared.fixed_rows_mut::<3>(FIRST_PLANE + 3 * laser).copy_from(&-by_line);
    // q = n / (n . t): dq = dn / d - q (dn . t + n . dt) / d, dn = turn x n.
    let normal_by_turn = -normal.cross_matrix();
    let q_by_turn = (normal_by_turn - q * (pose.translation_mm.transpose() * normal_by_turn)) / distance;
    let q_by_shift = -q * normal.transpose() / distance;
    let mut by_pose = SVector::<f64, POSE>::zeros();
    by_pose.fixed_rows_mut::<3>(0).copy_from(&(q_by_turn.transpose() * by_line));
    by_pose.fixed_rows_mut::<3>(3).copy_from(&(q_by_shift.transpose() * by_line));
    Some(Row { px: line.dot(&ray.xy1) * per, by_shared, by_pose })
}

/// Mean px per mm at a place on the board.
pub(super) fn px_per_mm(camera: &CameraModel, pose: &Pose<Cam, OnBoard>, at_mm: Vector2<f64>) -> f64 {
    let p: Vector3<f64> = board_matrix(pose) * at_mm.push(1.0);
    let m: Matrix3<f64> = board_matrix(pose);
    let by_board = Matrix2::new(
        m[(0, 0)] - m[(2, 0)] * p.x / p.z,
        m[(0, 1)] - m[(2, 1)] * p.x / p.z,
        m[(1, 0)] - m[(2, 0)] * p.y / p.z,
        m[(1, 1)] - m[(2, 1)] * p.y / p.z,
    ) / p.z;
    (by_board.determinant().abs() * camera.fx * camera.fy).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    fn shared() -> Shared {
        Shared {
            camera: CameraModel {
                fx: 2458.9,
                fy: 2453.8,
                skew: 0.7,
                cx: 1239.5,
                cy: 1032.6,
                k1: -0.034,
                k2: 0.32,
                p1: 0.006,
                p2: -0.004,
                k3: -0.05,
            },
            planes: [
                Vector3::new(0.0079, -0.0082, 0.0002),
                Vector3::new(0.0108, -0.0112, 0.0022),
                Vector3::new(0.0104, 0.0096, 0.0017),
                Vector3::new(0.0080, 0.0073, -0.0004),
            ],
        }
    }

    fn pose() -> Pose<Cam, OnBoard> {
        let turn = Rotation3::from_euler_angles(3.4, 0.3, 0.5);
        Pose::new(turn.into_inner(), Vector3::new(30.0, -50.0, 1200.0))
    }

    /// Every derivative against a central difference of the residual itself.
    fn check(rows: impl Fn(&Shared, &Pose<Cam, OnBoard>) -> Vec<Row>, slack: f64) {
        let (shared, pose) = (shared(), pose());
        let here = rows(&shared, &pose);
        let residual = |shared: &Shared, pose: &Pose<Cam, OnBoard>, i: usize| rows(shared, pose)[i].px;
        for (i, row) in here.iter().enumerate() {
            for k in 0..SHARED {
                let size = match k {
                    4 | 5 | 18 | 19 => 1e-4,
                    20 => 1e-2,
                    FIRST_PLANE..18 => 1e-8,
                    _ => 1e-2,
                };
                let mut step = SVector::zeros();
                step[k] = size;
                let numeric = (residual(&shared.plus(&step), &pose, i)
                    - residual(&shared.plus(&-step), &pose, i))
                    / (2.0 * size);
                let found = row.by_shared[k];
                assert!(
                    (found - numeric).abs() <= slack * (1e-6 + numeric.abs()),
                    "row {i} shared {k}: {found} {numeric}"
                );
            }
            for k in 0..POSE {
                let size = if k < 3 { 1e-6 } else { 1e-3 };
                let mut step = SVector::zeros();
                step[k] = size;
                let numeric = (residual(&shared, &moved(&pose, &step), i)
                    - residual(&shared, &moved(&pose, &-step), i))
                    / (2.0 * size);
                let found = row.by_pose[k];
                assert!(
                    (found - numeric).abs() <= slack * (1e-6 + numeric.abs()),
                    "row {i} pose {k}: {found} {numeric}"
                );
            }
        }
    }

    #[test]
    fn derivatives_of_centres_are_those_of_finite_differences() {
        for at in [Vector2::new(0.0, 0.0), Vector2::new(250.0, -150.0), Vector2::new(-350.0, 300.0)] {
            check(|s, p| centre_rows(s, p, at, Px::new(900.0, 800.0)).expect("in front").into(), 1e-4);
        }
    }

    #[test]
    fn derivatives_of_stripes_are_those_of_finite_differences() {
        // On the stripe itself, where the constant factor is exact.
        for laser in 0..4 {
            for start in [500.0, 1400.0] {
                let q = board_plane(&pose());
                let line = q - shared().planes[laser];
                let (mut u, v) = (1200.0, start);
                for _ in 0..20 {
                    let (ray, j) = shared().camera.ray_from_px_with_jacobian(Px::new(u, v));
                    u -= line.dot(&ray.xy1) / (j.transpose() * line.xy()).x;
                }
                check(|s, p| vec![stripe_row(s, p, laser, Px::new(u, v)).expect("a line")], 1e-3);
            }
        }
    }
}
