//! Messages from core types.

use super::v1;
use crate::json::{Laser, RecordedFrame, Recording, Role, covariance_size};
use boxline::feasibility::Move;
use boxline::measurement::FaceMeasurement;
use boxline::{
    AngleEstimate, BoxMeasurement, BoxReport, Calibration, Error, Estimate, FaceOutcome, FollowedFace, Hint,
    LaserId, Outcome, Px, Reject, Straightness, SurfacePoint, Warning,
};

pub(super) fn report(report: &BoxReport, frame_ids: &[&str]) -> v1::BoxReport {
    let faces = report.faces.iter().zip(frame_ids).enumerate();
    let faces = faces.map(|(i, (outcome, id))| face(outcome, report.hint(i), id)).collect();
    let (outcome, measured, candidates, rejected) = match &report.outcome {
        Outcome::Measured(box_) => (v1::Outcome::Measured, Some(sides(box_)), Vec::new(), None),
        Outcome::Ambiguous(both) => (v1::Outcome::Ambiguous, None, both.iter().map(sides).collect(), None),
        Outcome::Rejected(why) => (v1::Outcome::Rejected, None, Vec::new(), Some(reject(why))),
    };
    let warnings = report.warnings.iter().map(warning).collect();
    let settled = report.settled.as_ref().map(|seen| v1::DepthSeen {
        depth: Some(length(seen.depth)),
        log_odds: seen.log_odds,
        stripes: u32::try_from(seen.stripes).unwrap_or(u32::MAX),
    });
    let likeliest = report.likeliest.iter().map(|likeliest| v1::Candidate {
        sides: Some(sides(&likeliest.sides)),
        confidence: likeliest.confidence,
    });
    v1::BoxReport {
        outcome: outcome.into(),
        sides: measured,
        candidates,
        reject: rejected,
        faces,
        warnings,
        settled,
        confidence: report.confidence,
        likeliest: likeliest.collect(),
        third_face_helps: report.third_face_helps(),
        enclosing: report.enclosing().as_ref().map(sides),
    }
}

pub(super) fn face(outcome: &FaceOutcome, hint: Option<&Hint>, frame_id: &str) -> v1::Face {
    let frame = frame_id.to_owned();
    let hint = hint.map(self::hint);
    match outcome {
        FaceOutcome::Measured(face) => v1::Face {
            frame,
            outcome: v1::Outcome::Measured.into(),
            length: Some(length(face.length)),
            width: Some(length(face.width)),
            corners: corners(face),
            key_points: face.key_points_px.iter().map(key_points).collect(),
            plane: Some(plane(face)),
            rms_px: face.rms_px,
            reject: None,
            corner_angles: face.corner_angles.iter().flatten().map(angle).collect(),
            warnings: face.warnings.iter().map(warning).collect(),
            surface: face.surface.iter().map(surface_point).collect(),
            hint,
            confidence: face.confidence,
            straightness: face.straightness.iter().map(straightness).collect(),
            side_light: face.light.iter().flatten().map(|light| light.name().to_owned()).collect(),
            enclosing_length: Some(length(face.enclosing[0])),
            enclosing_width: Some(length(face.enclosing[1])),
        },
        FaceOutcome::Rejected(why) => {
            let outcome = v1::Outcome::Rejected.into();
            v1::Face { frame, outcome, reject: Some(reject(why)), hint, ..v1::Face::default() }
        }
    }
}

/// A face that was not measured in this frame: places on the sensor, and what is known from before.
pub(super) fn followed_face(face: &FollowedFace) -> v1::Face {
    v1::Face {
        outcome: v1::Outcome::Measured.into(),
        length: Some(length(face.length)),
        width: Some(length(face.width)),
        corners: face.corners_px.map(|at| v1::Corner { px: Some(px(at)), ..v1::Corner::default() }).into(),
        key_points: face.key_points_px.iter().map(key_points).collect(),
        confidence: face.confidence,
        warnings: face.warnings.iter().map(warning).collect(),
        ..v1::Face::default()
    }
}

fn straightness(side: &Straightness) -> v1::Straightness {
    v1::Straightness {
        sagitta_mm: side.sagitta.value_mm,
        sagitta_sigma_mm: side.sagitta.sigma_mm,
        rms_mm: side.rms_mm,
    }
}

fn corners(face: &FaceMeasurement) -> Vec<v1::Corner> {
    let both = face.corners_px.iter().zip(&face.corners);
    both.map(|(on_sensor, p)| v1::Corner {
        px: Some(px(*on_sensor)),
        x_mm: p.mm.x,
        y_mm: p.mm.y,
        z_mm: p.mm.z,
    })
    .collect()
}

fn surface_point(point: &SurfacePoint) -> v1::SurfacePoint {
    let ([along_length_mm, along_width_mm], height) = (point.at_mm, point.height);
    let (height_mm, sigma_mm) = (height.value_mm, height.sigma_mm);
    v1::SurfacePoint { along_length_mm, along_width_mm, height_mm, sigma_mm }
}

fn key_points(&[first, second]: &[Px; 2]) -> v1::KeyPoints {
    v1::KeyPoints { first: Some(px(first)), second: Some(px(second)) }
}

fn plane(face: &FaceMeasurement) -> v1::Plane {
    let p = face.plane.per_mm;
    v1::Plane { x_per_mm: p.x, y_per_mm: p.y, z_per_mm: p.z }
}

fn px(px: Px) -> v1::Px {
    v1::Px { u: px.u, v: px.v }
}

fn sides(measured: &BoxMeasurement) -> v1::Sides {
    let [low_95_m3, high_95_m3] = measured.volume.interval_95_m3();
    let (value_m3, sigma_m3) = (measured.volume.value_m3, measured.volume.sigma_m3);
    let volume = v1::Volume { value_m3, sigma_m3, low_95_m3, high_95_m3 };
    v1::Sides {
        length: Some(length(measured.length)),
        width: Some(length(measured.width)),
        height: Some(length(measured.height)),
        volume: Some(volume),
    }
}

fn length(estimate: Estimate) -> v1::Length {
    let [low_95_mm, high_95_mm] = estimate.interval_95_mm();
    v1::Length { value_mm: estimate.value_mm, sigma_mm: estimate.sigma_mm, low_95_mm, high_95_mm }
}

fn angle(angle: &AngleEstimate) -> v1::Angle {
    v1::Angle { value_rad: angle.value_rad, sigma_rad: angle.sigma_rad }
}

fn numbers(named: Vec<(&'static str, f64)>) -> Vec<v1::Number> {
    named.into_iter().map(|(name, value)| v1::Number { name: name.to_owned(), value }).collect()
}

fn warning(warning: &Warning) -> v1::Warning {
    let kind = warning.kind.name().to_owned();
    v1::Warning { kind, numbers: numbers(warning.numbers()), text: warning.to_string() }
}

fn reject(reject: &Reject) -> v1::Reject {
    let reason = reject.reason().to_owned();
    v1::Reject { reason, numbers: numbers(reject.numbers()), text: reject.to_string() }
}

fn hint(hint: &Hint) -> v1::Hint {
    let entry = |one: &Move| v1::Move { kind: one.name().to_owned(), numbers: numbers(one.numbers()) };
    v1::Hint { moves: hint.moves.iter().map(entry).collect(), text: hint.to_string() }
}

pub(super) fn calibration(calibration: &Calibration) -> v1::Calibration {
    let c = calibration.camera();
    let laser_plane = |id: LaserId| {
        let p = calibration.laser(id).per_mm;
        v1::LaserPlane { a: p.x, b: p.y, c: p.z, d: -1.0 }
    };
    v1::Calibration {
        serial: calibration.serial().to_owned(),
        width_px: calibration.width_px(),
        height_px: calibration.height_px(),
        camera: Some(v1::Camera {
            fx: c.fx,
            fy: c.fy,
            skew: c.skew,
            cx: c.cx,
            cy: c.cy,
            k1: c.k1,
            k2: c.k2,
            p1: c.p1,
            p2: c.p2,
            k3: c.k3,
        }),
        laser_planes: LaserId::ALL.map(laser_plane).to_vec(),
        covariance: covariance(calibration),
    }
}

/// The lower triangle, as long as there is something in it.
fn covariance(calibration: &Calibration) -> Vec<f64> {
    let Some(all) = calibration.covariance() else { return Vec::new() };
    (0..covariance_size(all)).flat_map(|i| (0..=i).map(move |j| all[(i, j)])).collect()
}

pub(super) fn recording(recording: &Recording) -> Result<v1::Recording, Error> {
    let frame = |frame: &RecordedFrame| {
        Ok::<_, Error>(v1::RecordedFrame {
            id: frame.id.clone(),
            file: recording.relative(&frame.file, &format!("frame {:?}", frame.id))?,
            role: match frame.role {
                Role::Face => v1::Role::Face,
                Role::Board => v1::Role::Board,
            }
            .into(),
            laser: match frame.laser {
                Laser::On => v1::Laser::On,
                Laser::Off => v1::Laser::Off,
            }
            .into(),
        })
    };
    Ok(v1::Recording {
        serial: recording.serial.clone(),
        calibration: recording.relative(&recording.calibration_file, "calibration")?,
        frames: recording.frames.iter().map(frame).collect::<Result<_, _>>()?,
    })
}
