//! Whether a set of frames can fix a calibration at all: counts, tilt, distance, lasers, and what of a wrong board file
//! shows. A board file whose pitch and diameter are wrong by the same factor cannot be told from images: everything is
//! then measured too large or too small by that factor (`boxline verify` finds it).

use super::board::{Board, BoardView, OnBoard};
use super::model::px_per_mm;
use super::planes::StripesInSpace;
use super::reject::CalibrationReject;
use super::rim::centre_from_rim;
use boxline::camera::CameraModel;
use boxline::frames::{Cam, Pose};
use boxline::statistics::median;
use boxline::units::LaserId;

/// Two frames must be tilted at least so far: below, focal length and distance go together (the first is then known to
/// about 1 / tilt^2 of the circles' 0.05 px).
const MIN_TILT_DEG: f64 = 12.0;
const MIN_TILTED: usize = 2;
/// The farthest stripe point over the nearest: a plane through one line only turns about it.
const MIN_RANGE: f64 = 1.3;
/// Frames in which a laser must be seen.
pub(super) const MIN_LASER_FRAMES: usize = 5;
/// Diameter over pitch: blur and tone move a rim by up to 0.5 px, 2 % of a circle of 25 px radius.
const MAX_RATIO_ERROR: f64 = 0.05;

/// More circles than the board has, in either orientation?
pub(super) fn check_counts(views: &[&BoardView], board: &Board) -> Result<(), CalibrationReject> {
    let file = (board.columns, board.rows);
    let (long, short) = (file.0.max(file.1), file.0.min(file.1));
    // One frame may show something else that looks like a circle; two frames agree only on the board.
    let larger: Vec<(u32, u32)> = views
        .iter()
        .map(|view| view.span())
        .filter(|seen| seen.0.max(seen.1) > long || seen.0.min(seen.1) > short)
        .collect();
    match larger[..] {
        [first, _, ..] => Err(CalibrationReject::MoreCirclesThanBoard { seen: first, board: file }),
        _ => Ok(()),
    }
}

/// Angle between a board's normal and the camera's axis, degrees.
#[must_use]
pub fn tilt_deg(pose: &Pose<Cam, OnBoard>) -> f64 {
    pose.rotation[(2, 2)].abs().min(1.0).acos().to_degrees()
}

pub(super) fn check_tilt<'a>(
    poses: impl Iterator<Item = &'a Pose<Cam, OnBoard>>,
) -> Result<(), CalibrationReject> {
    let tilts: Vec<f64> = poses.map(tilt_deg).collect();
    if tilts.iter().filter(|t| **t >= MIN_TILT_DEG).count() >= MIN_TILTED {
        return Ok(());
    }
    let largest_deg = tilts.iter().copied().fold(0.0, f64::max);
    Err(CalibrationReject::NoTilt { largest_deg, needed_deg: MIN_TILT_DEG })
}

/// The circles' size against their distance, both as seen.
pub(super) fn check_ratio(
    views: &[&BoardView],
    board: &Board,
    camera: &CameraModel,
    poses: &[Pose<Cam, OnBoard>],
) -> Result<(), CalibrationReject> {
    let radius_mm = 0.5 * board.diameter_mm;
    let mut ratios = Vec::new();
    for (view, pose) in views.iter().zip(poses) {
        for circle in &view.circles {
            let centre_mm = board.centre_mm(circle.column, circle.row);
            if let Some(found) = centre_from_rim(camera, pose, centre_mm, radius_mm, &circle.rim) {
                let offset_mm = found.offset_px / px_per_mm(camera, pose, centre_mm);
                ratios.push(2.0 * (radius_mm + offset_mm) / board.pitch_mm);
            }
        }
    }
    let expected = board.diameter_mm / board.pitch_mm;
    match median(ratios) {
        Some(seen) if (seen / expected - 1.0).abs() > MAX_RATIO_ERROR => {
            Err(CalibrationReject::OtherRatio { seen, board: expected })
        }
        _ => Ok(()),
    }
}

/// In how many frames every laser is seen, and from where to where, mm.
pub(super) fn check_lasers(
    frames: &[StripesInSpace],
    lasers: &[Vec<Option<usize>>],
) -> Result<[(f64, f64); 4], CalibrationReject> {
    let mut ranges = [(f64::INFINITY, 0.0f64); 4];
    for id in LaserId::ALL {
        let mut seen = 0;
        for (frame, lasers) in frames.iter().zip(lasers) {
            for (points, _) in frame.points.iter().zip(lasers).filter(|(_, l)| **l == Some(id.index())) {
                seen += 1;
                let (near, far) = &mut ranges[id.index()];
                for p in points {
                    (*near, *far) = (near.min(p.z), far.max(p.z));
                }
            }
        }
        if seen < MIN_LASER_FRAMES {
            return Err(CalibrationReject::LaserSeenTooRarely {
                laser: id,
                frames: seen,
                needed: MIN_LASER_FRAMES,
            });
        }
    }
    Ok(ranges)
}

pub(super) fn check_distance(ranges: &[(f64, f64); 4]) -> Result<(), CalibrationReject> {
    match ranges.iter().find(|(near, far)| far / near < MIN_RANGE) {
        Some(range) => Err(CalibrationReject::OneDistance { range_mm: *range, needed_ratio: MIN_RANGE }),
        None => Ok(()),
    }
}
