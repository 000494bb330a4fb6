//! A report with something in every field.
#![allow(dead_code)] // each test uses a part of it

use boxline::feasibility::{Hint, Move};
use boxline::frames::{Plane, Point};
use boxline::measurement::FaceMeasurement;
use boxline::{
    AngleEstimate, BoxMeasurement, BoxReport, Candidate, DepthEstimate, Estimate, FaceOutcome, LaserId,
    Outcome, Px, Reject, Straightness, SurfacePoint, Volume, Warning, WarningKind,
};

pub fn face() -> FaceMeasurement {
    FaceMeasurement {
        length: Estimate::new(550.5, 0.25),
        width: Estimate::new(300.0, 0.1),
        plane: Plane::new(nalgebra::Vector3::new(0.0, 0.0, 0.001)),
        corners_px: [Px::new(1.0, 2.0), Px::new(3.0, 4.5), Px::new(-5.0, 6.0), Px::new(7.0, 0.1)],
        corners: [1.0, 2.0, 3.0, 4.0].map(|x| Point::new(x, -x, 1000.0 + x)),
        key_points_px: [0.0, 1.0, 2.0, 3.0].map(|i| [Px::new(i, 10.0), Px::new(i, 20.0 / 3.0)]),
        rms_px: 0.4,
        stripe_points_px: Default::default(),
        edge_points_px: Default::default(),
        uncertainty: Default::default(),
        corner_angles: Some(
            [1.57, 1.58, 1.56, 1.572].map(|value_rad| AngleEstimate { value_rad, sigma_rad: 1e-3 }),
        ),
        warnings: WarningKind::ALL.map(warning).to_vec(),
        surface: vec![SurfacePoint { at_mm: [-20.0, 30.5], height: Estimate::new(1.25, 0.125) }],
        straightness: [0.5, -0.25, 0.0, 1.0]
            .map(|mm| Straightness { sagitta: Estimate::new(mm, 0.125), rms_mm: 0.75 }),
        light: Some(boxline::SideLight::ALL),
        enclosing: [Estimate::new(551.5, 0.5), Estimate::new(300.5, 0.25)],
        confidence: Some(0.9375),
    }
}

pub fn warning(kind: WarningKind) -> Warning {
    let laser = if kind == WarningKind::FaceNotFlat { LaserId::new(2) } else { None };
    Warning { kind, laser, found: -0.5, sigma: 0.125, chi_square: 16.0, limit: 10.83 }
}

pub fn sides(height_mm: f64) -> BoxMeasurement {
    BoxMeasurement {
        length: Estimate::new(550.5, 0.25),
        width: Estimate::new(350.5, 0.2),
        height: Estimate::new(height_mm, 0.1),
        volume: Volume { value_m3: 0.0579, sigma_m3: 0.0001 },
    }
}

pub fn report(outcome: Outcome) -> BoxReport {
    let rejected = FaceOutcome::Rejected(Reject::RectangleOpen { sides_found: 3 });
    let warnings = vec![warning(WarningKind::SidesDiffer)];
    let settled = Some(DepthEstimate { depth: Estimate::new(300.5, 2.0), log_odds: 14.5, stripes: 3 });
    let faces = vec![FaceOutcome::Measured(Box::new(face())), rejected];
    let (confidence, likeliest) = match outcome {
        Outcome::Rejected(_) => (None, vec![Candidate { sides: sides(310.0), confidence: 0.5 }]),
        _ => (Some(0.75), Vec::new()),
    };
    // For the rejected one of the two faces.
    let moves = vec![Move::RollClockwise(0.2), Move::Closer(Some(200.0))];
    let hints = vec![None, Some(Hint { moves })];
    BoxReport { outcome, faces, warnings, settled, confidence, likeliest, hints, times: Vec::new() }
}
