//! Which frame to take next: of a few dozen views, the one whose circles and stripes would sharpen a long side most.

use super::adjust::{CentreObservation, FrameObservations, StripeObservation};
use super::board::OnBoard;
use super::model::{POSE, SHARED, board_plane, centre_rows, stripe_row};
use super::solve::CalibrationSolution;
use super::uncertainty::{side_sigma_mm, usual_distance_mm};
use super::{adjust, rim};
use boxline::calibration::CalibrationCovariance;
use boxline::frames::{Cam, Point, Pose, Ray};
use boxline::statistics::median;
use boxline::units::Px;
use nalgebra::{Rotation3, SMatrix, SVector, Vector2, Vector3};

/// A view that would help.
#[derive(Clone, Copy, Debug)]
pub struct Advice {
    /// Distance of the board's middle, mm.
    pub distance_mm: f64,
    /// Tilt of the board, degrees.
    pub tilt_deg: f64,
    /// Which side of the picture is nearer: degrees in the image, 0 right, 90 bottom.
    pub towards_deg: f64,
    /// Standard deviation of an 1800 mm side now, mm.
    pub sigma_now_mm: f64,
    /// ... with this frame, mm.
    pub sigma_then_mm: f64,
}

const LENGTH_MM: f64 = 1800.0;
/// Stripe centres that stand for a stripe of a few hundred.
const STRIPE_SAMPLES: usize = 40;

/// The best of the views; `None` if none of them can be computed.
#[must_use]
pub fn next_frame(solution: &CalibrationSolution) -> Option<Advice> {
    let sigma = |covariance: &CalibrationCovariance| {
        side_sigma_mm(&solution.camera, &solution.lasers, covariance, LENGTH_MM, usual_distance_mm(LENGTH_MM))
    };
    let sigma_of = |information: &adjust::Information| {
        let (_, inverse) = adjust::solve_scaled(information, &SVector::zeros())?;
        sigma(&adjust::covariance(&inverse))
    };
    let sigma_now_mm = sigma_of(&solution.information)?;
    let mut best: Option<Advice> = None;
    for distance_mm in [600.0, 1000.0, 1500.0, 2000.0, 2500.0] {
        for tilt_deg in [0.0f64, 20.0, 40.0] {
            for towards_deg in [0.0f64, 90.0, 180.0, 270.0] {
                if tilt_deg == 0.0 && towards_deg > 0.0 {
                    continue;
                }
                let frame = imagined(solution, distance_mm, tilt_deg, towards_deg);
                let Some(information) = information_of(solution, &frame) else { continue };
                let Some(sigma_then_mm) = sigma_of(&(solution.information + information)) else { continue };
                if best.is_none_or(|b| sigma_then_mm < b.sigma_then_mm) {
                    best = Some(Advice { distance_mm, tilt_deg, towards_deg, sigma_now_mm, sigma_then_mm });
                }
            }
        }
    }
    best
}

fn imagined(
    solution: &CalibrationSolution,
    distance_mm: f64,
    tilt_deg: f64,
    towards_deg: f64,
) -> FrameObservations {
    let (s, c) = towards_deg.to_radians().sin_cos();
    let axis = nalgebra::Unit::new_normalize(Vector3::new(-s, c, 0.0));
    let face_us = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let rotation = Rotation3::from_axis_angle(&axis, tilt_deg.to_radians()) * face_us;
    let pose: Pose<Cam, OnBoard> = Pose::new(rotation.into_inner(), Vector3::new(0.0, 0.0, distance_mm));
    let [width, height] = solution.image_px;
    let inside =
        |px: &Px| px.u > 5.0 && px.v > 5.0 && px.u < width as f64 - 6.0 && px.v < height as f64 - 6.0;
    let project = |at: Vector2<f64>| {
        solution.camera.px_from_point(&pose.transform(&Point::new(at.x, at.y, 0.0))).filter(inside)
    };
    let mean = |values: &mut dyn Iterator<Item = f64>| median(values).unwrap_or(0.1);
    let centre_sigma = mean(&mut solution.next.iter().flat_map(|f| f.centres.iter().map(|c| c.sigma_px)));
    let stripe_sigma = mean(&mut solution.next.iter().flat_map(|f| f.stripes.iter().map(|s| s.sigma_px)));
    let mut frame = FrameObservations { pose, centres: Vec::new(), stripes: Vec::new() };
    let board = &solution.board;
    let cells = (0..board.columns).flat_map(|c| (0..board.rows).map(move |r| (c as i32, r as i32)));
    for (column, row) in cells {
        let board_mm = board.centre_mm(column, row);
        frame.centres.extend(project(board_mm).map(|at| CentreObservation {
            board_mm,
            at,
            sigma_px: centre_sigma,
        }));
    }
    // Stripes in the ideal image: (q - p) . x = 0, sampled along the image's rows.
    let q = board_plane(&pose);
    let reach = board.centre_mm(0, 0).abs();
    let to_board = rim::board_matrix(&pose).try_inverse();
    for (laser, plane) in solution.lasers.iter().enumerate() {
        let line = q - plane.per_mm;
        for i in 0..STRIPE_SAMPLES {
            let y = (i as f64 / STRIPE_SAMPLES as f64 - 0.5) * 0.8;
            let x = -(line.y * y + line.z) / line.x;
            let Some(on_board) = to_board.map(|m| m * Vector3::new(x, y, 1.0)) else { continue };
            if (on_board.x / on_board.z).abs() > reach.x || (on_board.y / on_board.z).abs() > reach.y {
                continue;
            }
            let at = solution.camera.px_from_ray(&Ray::new(x, y)).filter(inside);
            frame.stripes.extend(at.map(|at| StripeObservation { laser, at, sigma_px: stripe_sigma }));
        }
    }
    frame
}

/// What a frame would tell about the shared unknowns, its own pose eliminated.
fn information_of(solution: &CalibrationSolution, frame: &FrameObservations) -> Option<adjust::Information> {
    let mut shared = adjust::Information::zeros();
    let mut mixed = SMatrix::<f64, SHARED, POSE>::zeros();
    let mut own = SMatrix::<f64, POSE, POSE>::zeros();
    let mut add = |row: super::model::Row, sigma: f64, correlation: f64| {
        let w = 1.0 / (sigma * sigma * correlation);
        shared.ger(w, &row.by_shared, &row.by_shared, 1.0);
        mixed.ger(w, &row.by_shared, &row.by_pose, 1.0);
        own.ger(w, &row.by_pose, &row.by_pose, 1.0);
    };
    for c in &frame.centres {
        for row in centre_rows(&solution.shared, &frame.pose, c.board_mm, c.at)? {
            add(row, c.sigma_px * solution.scatter[0], solution.correlation[0]);
        }
    }
    for s in &frame.stripes {
        let row = stripe_row(&solution.shared, &frame.pose, s.laser, s.at)?;
        add(row, s.sigma_px * solution.scatter[1], solution.correlation[1]);
    }
    let product = mixed * own.cholesky()?.inverse();
    Some(shared - product * mixed.transpose())
}
