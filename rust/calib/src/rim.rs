//! The rim of a circle: where it is in the image to a fraction of a pixel, and what that says about the circle's centre.
//!
//! The centre of an ellipse is not the image of the circle's centre (by about f (r / z)^2 sin t cos t, 0.3 to 0.5 px here).
//! So no centre is taken from the image: each rim point goes through the camera onto the board, where it must lie on the
//! circle, with whatever perspective and distortion. What it misses by, in px along the rim's normal n, is
//! `n . shift + offset`: the shift corrects the projected centre; the offset takes up what blur and the tone curve do to
//! the radius, which is the same all around. Repeated with the new camera and pose this converges at once.

use super::blobs::Blob;
use super::board::OnBoard;
use boxline::camera::CameraModel;
use boxline::eigen::symmetric_eigen;
use boxline::frames::{Cam, Pose, Ray};
use boxline::image::Frame;
use boxline::statistics::{TUKEY, median, robust_sigma, tukey_weight};
use boxline::units::Px;
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};

/// Rim points per px of circumference: neighbours closer than a pixel tell nothing new.
const POINTS_PER_PX: f64 = 0.6;
const POINTS: std::ops::Range<usize> = 20..96;
/// Profiles reach this far inside and outside, in mean radii, and at least this many px.
const REACH_RADII: f64 = 0.55;
const MIN_REACH_PX: f64 = 4.0;
/// Samples of a profile on either side of the rim.
const HALF_SAMPLES: usize = 10;
/// Dark to white, grey levels of green, below which there is no circle.
const MIN_CONTRAST: f64 = 20.0;
/// Laser response above that of the rest of the rim at which a place is lit by a laser, grey levels: JPEG leaves 2 to 3.
const LASER_LASER_RESPONSE: f64 = 7.0;
/// Share of the rim that must be left, free of laser light.
const MIN_SHARE: f64 = 0.5;
/// Scatter about the ellipse above which this is no circle, px and share of the radius.
const MAX_RMS_PX: f64 = 0.5;
const MAX_RMS_RADII: f64 = 0.03;
/// About one of so many neighbouring rim points is independent: interpolation and JPEG tie them together.
const CORRELATION: f64 = 2.0;

/// A rim as found.
pub(super) struct Rim {
    pub ellipse_centre: Px,
    pub points: Vec<Px>,
    pub rms_px: f64,
    /// From dark to white, 10 to 90 %, px.
    pub width_px: f64,
}

struct RimPoint {
    at: Vector2<f64>,
    width_px: f64,
    laser_response: f64,
}

/// Green and laser response between pixels; `None` outside.
fn sample(frame: &Frame, at: Vector2<f64>) -> Option<(f64, f64)> {
    let (x, y) = (at.x.floor(), at.y.floor());
    if x < 0.0 || y < 0.0 || x + 1.0 >= frame.width_px() as f64 || y + 1.0 >= frame.height_px() as f64 {
        return None;
    }
    let (fx, fy) = (at.x - x, at.y - y);
    let stride = 3 * frame.width_px();
    let first = y as usize * stride + x as usize * 3;
    let rgb = frame.rgb();
    let mut green = 0.0;
    let mut laser_response = 0.0;
    for (index, weight) in [
        (first, (1.0 - fx) * (1.0 - fy)),
        (first + 3, fx * (1.0 - fy)),
        (first + stride, (1.0 - fx) * fy),
        (first + stride + 3, fx * fy),
    ] {
        let [r, g, b] = [rgb[index], rgb[index + 1], rgb[index + 2]].map(f64::from);
        green += weight * g;
        laser_response += weight * (r - 0.5 * (g + b));
    }
    Some((green, laser_response))
}

/// Finds the rim of a blob. `None` if it is no ellipse, not wholly in the frame, or too much of it is lit by lasers.
pub(super) fn find_rim(frame: &Frame, blob: &Blob) -> Option<Rim> {
    // A = the map from the unit circle to the ellipse.
    let mut centre = blob.at;
    let mut shape = symmetric_root(&(blob.moments * 4.0))?;
    let mut points = Vec::new();
    let mut wanted = 0;
    for _ in 0..2 {
        let radius = shape.determinant().abs().sqrt();
        wanted =
            ((2.0 * std::f64::consts::PI * radius * POINTS_PER_PX) as usize).clamp(POINTS.start, POINTS.end);
        let reach = (REACH_RADII * radius).max(MIN_REACH_PX);
        let normal_map = shape.try_inverse()?.transpose();
        points.clear();
        for k in 0..wanted {
            let angle = 2.0 * std::f64::consts::PI * k as f64 / wanted as f64;
            let on_unit = Vector2::new(angle.cos(), angle.sin());
            let normal = (normal_map * on_unit).normalize();
            points.extend(rim_point(frame, centre + shape * on_unit, normal, reach));
        }
        let (c, s, _) = fit_ellipse(&points, centre, shape)?;
        (centre, shape) = (c, s);
    }
    let usual = median(points.iter().map(|p| p.laser_response))?;
    points.retain(|p| (p.laser_response - usual).abs() < LASER_LASER_RESPONSE);
    if (points.len() as f64) < MIN_SHARE * wanted as f64 {
        return None;
    }
    let (centre, shape, residuals) = fit_ellipse(&points, centre, shape)?;
    let scatter = robust_sigma(residuals.iter().copied())?;
    let radius = shape.determinant().abs().sqrt();
    if scatter > MAX_RMS_PX.max(MAX_RMS_RADII * radius) {
        return None;
    }
    let width_px = median(points.iter().map(|p| p.width_px))?;
    let limit = TUKEY * scatter.max(0.02);
    let kept: Vec<(Px, f64)> = points
        .iter()
        .zip(&residuals)
        .filter(|(_, r)| r.abs() < limit)
        .map(|(p, r)| (Px::new(p.at.x, p.at.y), *r))
        .collect();
    if (kept.len() as f64) < MIN_SHARE * wanted as f64 {
        return None;
    }
    let rms_px = (kept.iter().map(|(_, r)| r * r).sum::<f64>() / kept.len() as f64).sqrt();
    let points = kept.into_iter().map(|(p, _)| p).collect();
    Some(Rim { ellipse_centre: Px::new(centre.x, centre.y), points, rms_px, width_px })
}

/// Where brightness passes half way from the dark inside to the white outside, along the outward normal.
fn rim_point(frame: &Frame, at: Vector2<f64>, normal: Vector2<f64>, reach: f64) -> Option<RimPoint> {
    const N: usize = 2 * HALF_SAMPLES + 1;
    let step = reach / HALF_SAMPLES as f64;
    let place = |i: f64| at + normal * ((i - HALF_SAMPLES as f64) * step);
    let mut profile = [0.0; N];
    let mut laser_response = 0.0f64;
    for (i, p) in profile.iter_mut().enumerate() {
        let (green, red) = sample(frame, place(i as f64))?;
        *p = green;
        // The reddest place of the profile: a laser on the white side moves the half-way level too.
        laser_response = laser_response.max(red);
    }
    let plateau = |part: &[f64]| median(part.iter().copied());
    let (dark, white) = (plateau(&profile[..N / 4])?, plateau(&profile[N - N / 4..])?);
    let contrast = white - dark;
    if contrast < MIN_CONTRAST {
        return None;
    }
    let crossing = |share: f64| {
        let level = dark + share * contrast;
        let i = profile.windows(2).position(|w| w[0] <= level && w[1] > level)?;
        Some(i as f64 + (level - profile[i]) / (profile[i + 1] - profile[i]))
    };
    let middle = crossing(0.5)?;
    let width_px = (crossing(0.9)? - crossing(0.1)?).abs() * step;
    Some(RimPoint { at: place(middle), width_px, laser_response })
}

/// Least squares for an ellipse near a given one: centre, map from the unit circle, residuals along the normals in px.
fn fit_ellipse(
    points: &[RimPoint],
    mut centre: Vector2<f64>,
    mut shape: Matrix2<f64>,
) -> Option<(Vector2<f64>, Matrix2<f64>, Vec<f64>)> {
    if points.len() < 8 {
        return None;
    }
    let mut residuals = Vec::new();
    for _ in 0..4 {
        let inverse = shape.try_inverse()?;
        let rows: Vec<(SVector<f64, 5>, f64)> = points
            .iter()
            .map(|p| {
                let unit = inverse * (p.at - centre);
                let (x, y) = (unit.x / unit.norm(), unit.y / unit.norm());
                // Unknowns in the unit circle's plane: centre, radius, and the two ways to stretch it.
                (SVector::from([x, y, 1.0, x * x - y * y, 2.0 * x * y]), unit.norm() - 1.0)
            })
            .collect();
        let scale = robust_sigma(rows.iter().map(|(_, d)| *d))?.max(1e-6);
        let mut normal = SMatrix::<f64, 5, 5>::zeros();
        let mut right = SVector::<f64, 5>::zeros();
        for (row, d) in &rows {
            let weight = tukey_weight(d / scale);
            normal += row * row.transpose() * weight;
            right += row * (weight * d);
        }
        let x = normal.cholesky()?.solve(&right);
        let radius_px = shape.determinant().abs().sqrt();
        residuals = rows.iter().map(|(row, d)| (d - row.dot(&x)) * radius_px).collect();
        centre += shape * Vector2::new(x[0], x[1]);
        shape *= Matrix2::new(1.0 + x[2] + x[3], x[4], x[4], 1.0 + x[2] - x[3]);
        if x.amax() < 1e-6 {
            break;
        }
    }
    centre.iter().all(|c| c.is_finite()).then_some((centre, shape, residuals))
}

fn symmetric_root(m: &Matrix2<f64>) -> Option<Matrix2<f64>> {
    let eigen = symmetric_eigen(m);
    let roots = eigen.values.map(|e| e.max(0.0).sqrt());
    (roots.min() > 0.5).then(|| eigen.vectors * Matrix2::from_diagonal(&roots) * eigen.vectors.transpose())
}

/// What a rim says about its circle's centre.
#[derive(Clone, Copy, Debug)]
pub(super) struct CentreFromRim {
    /// Where the centre's image is.
    pub at: Px,
    /// Standard deviation of either coordinate, px.
    pub sigma_px: f64,
    /// How much larger the radius looks than it is, px.
    pub offset_px: f64,
}

/// The place on the board (z = 0), mm, that a pixel shows.
pub(super) fn on_board(camera: &CameraModel, pose: &Pose<Cam, OnBoard>, px: Px) -> Option<Vector2<f64>> {
    let ray = camera.ray_from_px(px).xy1;
    // ray * depth = R (x, y, 0) + t  =>  [r1 r2 t] (x, y, 1) ~ ray.
    let columns = board_matrix(pose);
    let p = columns.try_inverse()? * ray;
    (p.z.abs() > 1e-12).then(|| Vector2::new(p.x / p.z, p.y / p.z))
}

/// `[r1 r2 t]`: takes (x, y, 1) on the board to the camera.
pub(super) fn board_matrix(pose: &Pose<Cam, OnBoard>) -> Matrix3<f64> {
    Matrix3::from_columns(&[
        pose.rotation.column(0).into(),
        pose.rotation.column(1).into(),
        pose.translation_mm,
    ])
}

/// The centre of a circle of `radius_mm` at `centre_mm` on the board from its rim.
pub(super) fn centre_from_rim(
    camera: &CameraModel,
    pose: &Pose<Cam, OnBoard>,
    centre_mm: Vector2<f64>,
    radius_mm: f64,
    rim: &[Px],
) -> Option<CentreFromRim> {
    let to_board = board_matrix(pose).try_inverse()?;
    let mut rows: Vec<(Vector3<f64>, f64)> = Vec::with_capacity(rim.len());
    for px in rim {
        let (ray, jacobian) = camera.ray_from_px_with_jacobian(*px);
        let p = to_board * ray.xy1;
        let at = Vector2::new(p.x / p.z, p.y / p.z);
        let from_centre = at - centre_mm;
        let distance = from_centre.norm();
        let outwards = from_centre / distance;
        // d(at)/d(ray) from the quotient rule, then d(ray)/d(px).
        let by_ray = Matrix2::new(
            to_board[(0, 0)] - at.x * to_board[(2, 0)],
            to_board[(0, 1)] - at.x * to_board[(2, 1)],
            to_board[(1, 0)] - at.y * to_board[(2, 0)],
            to_board[(1, 1)] - at.y * to_board[(2, 1)],
        ) / p.z;
        let gradient = (by_ray * jacobian).transpose() * outwards;
        let mm_per_px = gradient.norm();
        let normal = gradient / mm_per_px;
        rows.push((Vector3::new(normal.x, normal.y, 1.0), (distance - radius_mm) / mm_per_px));
    }
    let mut x = Vector3::zeros();
    let mut covariance = Matrix3::identity();
    let mut scale = robust_sigma(rows.iter().map(|(_, d)| *d))?.max(0.03);
    for _ in 0..4 {
        let mut normal = Matrix3::zeros();
        let mut right = Vector3::zeros();
        for (row, d) in &rows {
            let weight = tukey_weight((d - row.dot(&x)) / scale);
            normal += row * row.transpose() * weight;
            right += row * (weight * d);
        }
        covariance = normal.try_inverse()?;
        x = covariance * right;
        scale = robust_sigma(rows.iter().map(|(row, d)| d - row.dot(&x)))?.max(0.015);
    }
    let centre = camera.px_from_ray(&{
        let p = board_matrix(pose) * Vector3::new(centre_mm.x, centre_mm.y, 1.0);
        Ray::new(p.x / p.z, p.y / p.z)
    })?;
    let sigma_px = scale * (CORRELATION * 0.5 * (covariance[(0, 0)] + covariance[(1, 1)])).sqrt();
    let at = Px::new(centre.u + x.x, centre.v + x.y);
    (at.u.is_finite() && at.v.is_finite() && sigma_px.is_finite()).then_some(CentreFromRim {
        at,
        sigma_px,
        offset_px: x.z,
    })
}
