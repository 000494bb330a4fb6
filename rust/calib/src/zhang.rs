//! A start for the adjustment: camera without distortion from the homographies of several views, poses from the camera.
//! Zhang, "A flexible new technique for camera calibration", PAMI 22 (2000), section 3.1.

use super::board::OnBoard;
use boxline::camera::CameraModel;
use boxline::eigen::symmetric_eigen;
use boxline::frames::{Cam, Pose};
use boxline::units::Px;
use nalgebra::{DMatrix, Matrix3, SVector, Vector2, Vector3};

/// The homography that takes (x, y, 1) on the board, mm, to pixels. Hartley's normalisation keeps the equations even.
pub(super) fn homography(pairs: &[(Vector2<f64>, Px)]) -> Option<Matrix3<f64>> {
    if pairs.len() < 4 {
        return None;
    }
    let px = |p: &Px| Vector2::new(p.u, p.v);
    let (from, to) = (normaliser(pairs.iter().map(|p| p.0)), normaliser(pairs.iter().map(|p| px(&p.1))));
    let mut rows = DMatrix::zeros(2 * pairs.len(), 9);
    for (i, (board, image)) in pairs.iter().enumerate() {
        let b = from * board.push(1.0);
        let p = to * px(image).push(1.0);
        for k in 0..3 {
            rows[(2 * i, k)] = b[k];
            rows[(2 * i, 6 + k)] = -p.x * b[k];
            rows[(2 * i + 1, 3 + k)] = b[k];
            rows[(2 * i + 1, 6 + k)] = -p.y * b[k];
        }
    }
    let h = smallest_eigenvector(&(rows.transpose() * rows))?;
    let h = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]);
    let h = to.try_inverse()? * h * from;
    h.iter().all(|x| x.is_finite()).then_some(h)
}

fn normaliser(points: impl Iterator<Item = Vector2<f64>> + Clone) -> Matrix3<f64> {
    let n = points.clone().count().max(1) as f64;
    let middle = points.clone().sum::<Vector2<f64>>() / n;
    let spread = (points.map(|p| (p - middle).norm_squared()).sum::<f64>() / (2.0 * n)).sqrt().max(1e-9);
    Matrix3::new(1.0 / spread, 0.0, -middle.x / spread, 0.0, 1.0 / spread, -middle.y / spread, 0.0, 0.0, 1.0)
}

fn smallest_eigenvector(m: &DMatrix<f64>) -> Option<Vec<f64>> {
    let eigen = symmetric_eigen(m);
    let smallest = eigen.values.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1))?.0;
    Some(eigen.vectors.column(smallest).iter().copied().collect())
}

/// The camera from at least three homographies, without distortion. If Zhang's closed form gives an impossible camera, as
/// it does when views are few or nearly parallel, the principal point is put into the middle and the pixels are taken as
/// square, which leaves one unknown.
pub(super) fn camera(
    homographies: &[Matrix3<f64>],
    width_px: usize,
    height_px: usize,
) -> Option<CameraModel> {
    let (w, h) = (width_px as f64, height_px as f64);
    let possible = |c: &CameraModel| {
        let side = w.max(h);
        (0.2 * side..5.0 * side).contains(&c.fx)
            && (0.8..1.25).contains(&(c.fy / c.fx))
            && (0.2 * w..0.8 * w).contains(&c.cx)
            && (0.2 * h..0.8 * h).contains(&c.cy)
    };
    closed_form(homographies, w, h).filter(possible).or_else(|| one_focal_length(homographies, w, h))
}

/// Pixels in units of the image's half width about its middle: keeps the equations even.
fn centred(h: &Matrix3<f64>, width: f64, height: f64) -> Matrix3<f64> {
    let s = 2.0 / width.max(height);
    Matrix3::new(s, 0.0, -0.5 * s * (width - 1.0), 0.0, s, -0.5 * s * (height - 1.0), 0.0, 0.0, 1.0) * h
}

fn closed_form(homographies: &[Matrix3<f64>], width: f64, height: f64) -> Option<CameraModel> {
    let mut rows = DMatrix::zeros(2 * homographies.len() + 1, 6);
    let product = |h: &Matrix3<f64>, i: usize, j: usize| {
        let (a, b) = (h.column(i), h.column(j));
        SVector::<f64, 6>::from([
            a[0] * b[0],
            a[0] * b[1] + a[1] * b[0],
            a[1] * b[1],
            a[2] * b[0] + a[0] * b[2],
            a[2] * b[1] + a[1] * b[2],
            a[2] * b[2],
        ])
    };
    for (i, h) in homographies.iter().enumerate() {
        let h = centred(h, width, height);
        let h = h / h.column(0).norm();
        rows.row_mut(2 * i).copy_from(&product(&h, 0, 1).transpose());
        rows.row_mut(2 * i + 1).copy_from(&(product(&h, 0, 0) - product(&h, 1, 1)).transpose());
    }
    rows[(2 * homographies.len(), 1)] = 10.0; // no skew
    let b = smallest_eigenvector(&(rows.transpose() * rows))?;
    let [b11, b12, b22, b13, b23, b33] = b[..] else { return None };
    let determinant = b11 * b22 - b12 * b12;
    let v0 = (b12 * b13 - b11 * b23) / determinant;
    let scale = b33 - (b13 * b13 + v0 * (b12 * b13 - b11 * b23)) / b11;
    let (fx, fy) = ((scale / b11).sqrt(), (scale * b11 / determinant).sqrt());
    let u0 = -b13 * fx * fx / scale;
    let half = 0.5 * width.max(height);
    let camera = CameraModel {
        fx: fx * half,
        fy: fy * half,
        skew: 0.0,
        cx: u0 * half + 0.5 * (width - 1.0),
        cy: v0 * half + 0.5 * (height - 1.0),
        k1: 0.0,
        k2: 0.0,
        ..CameraModel::PINHOLE
    };
    [camera.fx, camera.fy, camera.cx, camera.cy].iter().all(|x| x.is_finite()).then_some(camera)
}

fn one_focal_length(homographies: &[Matrix3<f64>], width: f64, height: f64) -> Option<CameraModel> {
    let (mut top, mut bottom) = (0.0, 0.0);
    for h in homographies {
        let h = centred(h, width, height);
        let (a, b) = (h.column(0) / h.column(0).norm(), h.column(1) / h.column(0).norm());
        // a w b = 0 and a w a = b w b with w = diag(1 / f^2, 1 / f^2, 1).
        for (flat, deep) in [
            (a[0] * b[0] + a[1] * b[1], a[2] * b[2]),
            (a[0] * a[0] + a[1] * a[1] - b[0] * b[0] - b[1] * b[1], a[2] * a[2] - b[2] * b[2]),
        ] {
            top -= flat * deep;
            bottom += flat * flat;
        }
    }
    let half = 0.5 * width.max(height);
    let inverse_square = top / bottom;
    // Without any tilt nothing is known: a common lens then.
    let f = if inverse_square > 0.04 && inverse_square < 25.0 {
        half / inverse_square.sqrt()
    } else {
        2.0 * half
    };
    f.is_finite().then_some(CameraModel {
        fx: f,
        fy: f,
        skew: 0.0,
        cx: 0.5 * (width - 1.0),
        cy: 0.5 * (height - 1.0),
        k1: 0.0,
        k2: 0.0,
        ..CameraModel::PINHOLE
    })
}

/// The board's pose from where its circles are seen.
pub(super) fn pose(camera: &CameraModel, pairs: &[(Vector2<f64>, Px)]) -> Option<Pose<Cam, OnBoard>> {
    let ideal: Vec<(Vector2<f64>, Px)> = pairs
        .iter()
        .map(|(board, px)| {
            let ray = camera.ray_from_px(*px).xy1;
            (*board, Px::new(ray.x, ray.y))
        })
        .collect();
    let h = homography(&ideal)?;
    let scale = 2.0 / (h.column(0).norm() + h.column(1).norm());
    let sign = if h[(2, 2)] < 0.0 { -1.0 } else { 1.0 };
    let h = h * (scale * sign);
    let (a, b): (Vector3<f64>, Vector3<f64>) = (h.column(0).into(), h.column(1).into());
    let raw = Matrix3::from_columns(&[a, b, a.cross(&b)]);
    let svd = raw.svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    (rotation.determinant() > 0.0).then(|| Pose::new(rotation, h.column(2).into()))
}
