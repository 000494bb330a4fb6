//! Core types from messages. Nothing is taken on trust: a missing part, an unknown name or a number that is not finite is
//! an error that names the field.

use super::{DecodedReport, v1};
use crate::json::{Laser, RecordedFrame, Recording, Role, resolved_path};
use boxline::calibration::{CalibrationCovariance, PAPER_PARAMETERS, PARAMETERS};
use boxline::feasibility::Move;
use boxline::frames::{Plane, Point};
use boxline::measurement::FaceMeasurement;
use boxline::{
    AngleEstimate, BoxMeasurement, BoxReport, Calibration, CameraModel, Candidate, DepthEstimate, Error,
    ErrorKind, Estimate, FaceOutcome, Hint, LaserId, Outcome, Px, Reject, SideLight, Straightness,
    SurfacePoint, Volume, Warning, WarningKind,
};
use nalgebra::Vector3;
use std::path::Path;

fn invalid(text: impl Into<String>) -> Error {
    Error::new(ErrorKind::InvalidFile, text)
}

fn required<T>(part: Option<T>, name: &str) -> Result<T, Error> {
    part.ok_or_else(|| invalid(format!("{name}: missing")))
}

fn finite(value: f64, name: &str) -> Result<f64, Error> {
    if value.is_finite() {
        Ok(value)
    } else {
        Err(invalid(format!("{name}: found {value}, a finite number is needed")))
    }
}

fn exactly<T, const N: usize>(items: Vec<T>, name: &str) -> Result<[T; N], Error> {
    items
        .try_into()
        .map_err(|found: Vec<T>| invalid(format!("{name}: found {}, {N} are needed", found.len())))
}

fn known<E: TryFrom<i32>>(value: i32, name: &str) -> Result<E, Error> {
    E::try_from(value).ok().ok_or_else(|| invalid(format!("{name}: {value} is not known")))
}

pub(super) fn report(message: v1::BoxReport) -> Result<DecodedReport, Error> {
    let outcome = match known(message.outcome, "outcome")? {
        v1::Outcome::Measured => Outcome::Measured(sides(required(message.sides, "sides")?)?),
        v1::Outcome::Ambiguous => {
            let [first, second] = exactly(message.candidates, "candidates")?;
            Outcome::Ambiguous([sides(first)?, sides(second)?])
        }
        v1::Outcome::Rejected => Outcome::Rejected(reject(required(message.reject, "reject")?)?),
        v1::Outcome::Unspecified => return Err(invalid("outcome: missing")),
    };
    if !(2..=3).contains(&message.faces.len()) {
        return Err(invalid(format!("faces: found {}, 2 or 3 are needed", message.faces.len())));
    }
    let (mut faces, mut hints, mut frame_ids) = (Vec::new(), Vec::new(), Vec::new());
    for (i, message) in message.faces.into_iter().enumerate() {
        let (outcome, hint, id) = face(message).map_err(|e| e.in_context(format!("faces[{i}]")))?;
        faces.push(outcome);
        hints.push(hint);
        frame_ids.push(id);
    }
    let warnings = message.warnings.into_iter().map(warning).collect::<Result<_, _>>()?;
    let settled = message.settled.map(depth_seen).transpose()?;
    let confidence = message.confidence.map(|value| finite(value, "confidence")).transpose()?;
    let likeliest = message.likeliest.into_iter().map(candidate).collect::<Result<_, _>>()?;
    let times = Vec::new();
    let report = BoxReport { outcome, faces, warnings, settled, confidence, likeliest, hints, times };
    Ok(DecodedReport { report, frame_ids })
}

fn candidate(message: v1::Candidate) -> Result<Candidate, Error> {
    Ok(Candidate {
        sides: sides(required(message.sides, "likeliest.sides")?)?,
        confidence: finite(message.confidence, "likeliest.confidence")?,
    })
}

fn depth_seen(message: v1::DepthSeen) -> Result<DepthEstimate, Error> {
    Ok(DepthEstimate {
        depth: length(message.depth, "settled.depth")?,
        log_odds: finite(message.log_odds, "settled.log_odds")?,
        stripes: message.stripes as usize,
    })
}

/// Four sides, or none in a message of an older program.
fn straightness(messages: Vec<v1::Straightness>) -> Result<[Straightness; 4], Error> {
    if messages.is_empty() {
        return Ok(Default::default());
    }
    let mut sides = [Straightness::default(); 4];
    for (side, message) in sides.iter_mut().zip(exactly::<_, 4>(messages, "straightness")?) {
        let number = |value| finite(value, "straightness");
        let sagitta = Estimate::new(number(message.sagitta_mm)?, number(message.sagitta_sigma_mm)?);
        *side = Straightness { sagitta, rms_mm: number(message.rms_mm)? };
    }
    Ok(sides)
}

/// Four sides, or none in a message of an older program or on the paper's map.
fn side_light(names: Vec<String>) -> Result<Option<[SideLight; 4]>, Error> {
    if names.is_empty() {
        return Ok(None);
    }
    let mut sides = [SideLight::Dark; 4];
    for (side, name) in sides.iter_mut().zip(exactly::<_, 4>(names, "side_light")?) {
        let known = SideLight::ALL.into_iter().find(|light| light.name() == name);
        *side = known.ok_or_else(|| invalid(format!("side_light: found {name:?}")))?;
    }
    Ok(Some(sides))
}

fn surface_point(message: v1::SurfacePoint) -> Result<SurfacePoint, Error> {
    let number = |value| finite(value, "surface");
    let at_mm = [number(message.along_length_mm)?, number(message.along_width_mm)?];
    Ok(SurfacePoint { at_mm, height: Estimate::new(number(message.height_mm)?, number(message.sigma_mm)?) })
}

fn face(message: v1::Face) -> Result<(FaceOutcome, Option<Hint>, String), Error> {
    let hint = message.hint.map(hint).transpose()?;
    let outcome = match known(message.outcome, "outcome")? {
        v1::Outcome::Measured => {
            let corners: [v1::Corner; 4] = exactly(message.corners, "corners")?;
            let mut corners_px = [Px::new(0.0, 0.0); 4];
            let mut corners_in_cam = [Point::new(0.0, 0.0, 0.0); 4];
            for ((corner, on_sensor), in_cam) in
                corners.into_iter().zip(&mut corners_px).zip(&mut corners_in_cam)
            {
                let [x, y, z] = [corner.x_mm, corner.y_mm, corner.z_mm].map(|x| finite(x, "corners"));
                *on_sensor = px(corner.px, "corners")?;
                *in_cam = Point::new(x?, y?, z?);
            }
            let key_points: [v1::KeyPoints; 4] = exactly(message.key_points, "key_points")?;
            let mut key_points_px = [[Px::new(0.0, 0.0); 2]; 4];
            for (points, ends) in key_points.into_iter().zip(&mut key_points_px) {
                *ends = [px(points.first, "key_points")?, px(points.second, "key_points")?];
            }
            let plane = required(message.plane, "plane")?;
            let [x, y, z] = [plane.x_per_mm, plane.y_per_mm, plane.z_per_mm].map(|x| finite(x, "plane"));
            let sides = [length(message.length, "length")?, length(message.width, "width")?];
            let enclosing = |message: Option<v1::Length>, name: &str, side: Estimate| {
                message.map_or(Ok(side), |message| length(Some(message), name))
            };
            FaceOutcome::Measured(Box::new(FaceMeasurement {
                length: sides[0],
                width: sides[1],
                plane: Plane::new(Vector3::new(x?, y?, z?)),
                corners_px,
                corners: corners_in_cam,
                key_points_px,
                rms_px: finite(message.rms_px, "rms_px")?,
                stripe_points_px: Default::default(),
                edge_points_px: Default::default(),
                uncertainty: Default::default(),
                corner_angles: corner_angles(message.corner_angles)?,
                warnings: message.warnings.into_iter().map(warning).collect::<Result<_, _>>()?,
                surface: message.surface.into_iter().map(surface_point).collect::<Result<_, _>>()?,
                straightness: straightness(message.straightness)?,
                light: side_light(message.side_light)?,
                enclosing: [
                    enclosing(message.enclosing_length, "enclosing_length", sides[0])?,
                    enclosing(message.enclosing_width, "enclosing_width", sides[1])?,
                ],
                confidence: message.confidence.map(|value| finite(value, "confidence")).transpose()?,
            }))
        }
        v1::Outcome::Rejected => FaceOutcome::Rejected(reject(required(message.reject, "reject")?)?),
        v1::Outcome::Ambiguous => return Err(invalid("outcome: a single face is never ambiguous")),
        v1::Outcome::Unspecified => return Err(invalid("outcome: missing")),
    };
    Ok((outcome, hint, message.frame))
}

/// The inverse of `Move::name` and `Move::numbers`.
fn hint(message: v1::Hint) -> Result<Hint, Error> {
    let one = |message: v1::Move| {
        let find = |name: &str| message.numbers.iter().find(|n| n.name == name).map(|n| n.value);
        let number = |name: &str| finite(required(find(name), &format!("hint.{name}"))?, name);
        let by_mm = || find("by_mm").map(|value| finite(value, "hint.by_mm")).transpose();
        Ok(match message.kind.as_str() {
            "closer" => Move::Closer(by_mm()?),
            "farther" => Move::Farther(by_mm()?),
            "roll" => Move::RollClockwise(number("clockwise_rad")?),
            "aim" => Move::Aim { right_rad: number("right_rad")?, down_rad: number("down_rad")? },
            "look_straighter" => Move::LookStraighter(number("by_rad")?),
            other => return Err(invalid(format!("hint.move: {other:?} is not known"))),
        })
    };
    let moves = message.moves.into_iter().map(one).collect::<Result<Vec<_>, _>>()?;
    if moves.is_empty() { Err(invalid("hint.moves: at least one is needed")) } else { Ok(Hint { moves }) }
}

fn corner_angles(messages: Vec<v1::Angle>) -> Result<Option<[AngleEstimate; 4]>, Error> {
    if messages.is_empty() {
        return Ok(None);
    }
    let angles: [v1::Angle; 4] = exactly(messages, "corner_angles")?;
    let mut found = [AngleEstimate { value_rad: 0.0, sigma_rad: 0.0 }; 4];
    for (angle, message) in found.iter_mut().zip(angles) {
        angle.value_rad = finite(message.value_rad, "corner_angles")?;
        angle.sigma_rad = finite(message.sigma_rad, "corner_angles")?;
    }
    Ok(Some(found))
}

/// The inverse of `WarningKind::name` and `Warning::numbers`.
fn warning(message: v1::Warning) -> Result<Warning, Error> {
    let kind = WarningKind::ALL.into_iter().find(|kind| kind.name() == message.kind);
    let kind = kind.ok_or_else(|| invalid(format!("warning.kind: {:?} is not known", message.kind)))?;
    let find = |name: &str| message.numbers.iter().find(|n| n.name == name).map(|n| n.value);
    let number = |name: &str| finite(required(find(name), &format!("warning.{name}"))?, name);
    let laser = match find("laser") {
        None => None,
        Some(value) => {
            let laser = LaserId::ALL.into_iter().find(|l| f64::from(l.number()) == value);
            let wrong = || invalid(format!("warning.laser: found {value}, 1 to 4 is needed"));
            Some(laser.ok_or_else(wrong)?)
        }
    };
    let [found, sigma] = kind.number_names();
    Ok(Warning {
        kind,
        laser,
        found: number(found)?,
        sigma: number(sigma)?,
        chi_square: number("chi_square")?,
        limit: number("limit")?,
    })
}

fn px(message: Option<v1::Px>, name: &str) -> Result<Px, Error> {
    let px = required(message, name)?;
    Ok(Px::new(finite(px.u, name)?, finite(px.v, name)?))
}

fn sides(message: v1::Sides) -> Result<BoxMeasurement, Error> {
    let volume = required(message.volume, "volume")?;
    Ok(BoxMeasurement {
        length: length(message.length, "length")?,
        width: length(message.width, "width")?,
        height: length(message.height, "height")?,
        volume: Volume {
            value_m3: finite(volume.value_m3, "volume")?,
            sigma_m3: finite(volume.sigma_m3, "volume")?,
        },
    })
}

fn length(message: Option<v1::Length>, name: &str) -> Result<Estimate, Error> {
    let length = required(message, name)?;
    Ok(Estimate::new(finite(length.value_mm, name)?, finite(length.sigma_mm, name)?))
}

/// The inverse of `Reject::reason` and `Reject::numbers`.
fn reject(message: v1::Reject) -> Result<Reject, Error> {
    let optional = |name: &str| {
        let found = message.numbers.iter().find(|n| n.name == name);
        found.map(|n| finite(n.value, name)).transpose()
    };
    let number = |name: &str| required(optional(name)?, &format!("reject.{name}"));
    let small = |name: &str| {
        let value = number(name)?;
        let whole = (0..=u8::MAX).find(|n| f64::from(*n) == value);
        whole.ok_or_else(|| {
            invalid(format!("reject.{name}: found {value}, a whole number up to 255 is needed"))
        })
    };
    let laser = || {
        let id = small("laser")?;
        LaserId::new(id).ok_or_else(|| invalid(format!("reject.laser: found {id}, 1 to 4 is needed")))
    };
    let estimate = |value: &str, sigma: &str| Ok::<_, Error>(Estimate::new(number(value)?, number(sigma)?));
    Ok(match message.reason.as_str() {
        "no_box" => {
            Reject::NoBox { best_share: number("best_share")?, needed_share: number("needed_share")? }
        }
        "stripe_not_found" => Reject::StripeNotFound {
            laser: laser()?,
            seen_share: number("seen_share")?,
            needed_share: number("needed_share")?,
        },
        "stripe_missing" => {
            Reject::StripeMissing { laser: laser()?, stripes_on_face: small("stripes_on_face")? }
        }
        "face_cut_by_border" => Reject::FaceCutByBorder {
            sides_cut: small("sides_cut")?,
            at: Px::new(number("at_u_px")?, number("at_v_px")?),
        },
        "face_not_planar" => {
            Reject::FaceNotPlanar { rms_px: number("rms_px")?, limit_px: number("limit_px")? }
        }
        "rectangle_open" => Reject::RectangleOpen { sides_found: small("sides_found")? },
        "outline_unsure" => Reject::OutlineUnsure {
            support: number("support")?,
            needed_support: number("needed_support")?,
            overlap: number("overlap")?,
            needed_overlap: number("needed_overlap")?,
        },
        "face_hidden" => Reject::FaceHidden {
            sides_hidden: small("sides_hidden")?,
            at: Px::new(number("at_u_px")?, number("at_v_px")?),
            probability: number("probability")?,
            limit: number("limit")?,
            in_front_mm: optional("in_front_mm")?,
        },
        "too_far" => Reject::TooFar { distance_mm: number("distance_mm")?, limit_mm: number("limit_mm")? },
        "not_a_rectangle" => {
            Reject::NotARectangle { rms_px: number("rms_px")?, limit_px: number("limit_px")? }
        }
        "sides_disagree" => Reject::SidesDisagree {
            first: estimate("first_mm", "first_sigma_mm")?,
            second: estimate("second_mm", "second_sigma_mm")?,
            limit_mm: number("limit_mm")?,
        },
        other => return Err(invalid(format!("reject.reason: {other:?} is not known"))),
    })
}

pub(super) fn calibration(message: v1::Calibration) -> Result<Calibration, Error> {
    let invalid = |text: String| Error::new(ErrorKind::InvalidCalibration, text);
    let c = message.camera.ok_or_else(|| invalid("camera: missing".to_owned()))?;
    let v1::Camera { fx, fy, skew, cx, cy, k1, k2, p1, p2, k3 } = c;
    let camera = CameraModel { fx, fy, skew, cx, cy, k1, k2, p1, p2, k3 };
    let planes: Vec<_> = message.laser_planes.iter().map(|p| [p.a, p.b, p.c, p.d]).collect();
    let planes = <[[f64; 4]; 4]>::try_from(planes)
        .map_err(|found| invalid(format!("laser_planes: found {}, 4 are needed", found.len())))?;
    // `Calibration::new` and `with_covariance` check every number.
    let calibration =
        Calibration::new(message.serial, [message.width_px, message.height_px], camera, planes)?;
    if message.covariance.is_empty() {
        return Ok(calibration);
    }
    let size =
        [PAPER_PARAMETERS, PARAMETERS].into_iter().find(|n| n * (n + 1) / 2 == message.covariance.len());
    let size = size.ok_or_else(|| {
        invalid(format!("covariance: found {}, none, 171 or 231 are needed", message.covariance.len()))
    })?;
    let mut values = message.covariance.iter();
    let mut covariance = CalibrationCovariance::zeros();
    for i in 0..size {
        for j in 0..=i {
            let value = values.next().copied().unwrap_or_default(); // as many as there are
            (covariance[(i, j)], covariance[(j, i)]) = (value, value);
        }
    }
    calibration.with_covariance(covariance)
}

pub(super) fn recording(message: v1::Recording, folder: &Path) -> Result<Recording, Error> {
    let path = |text: &str, field: &str| {
        resolved_path(text, folder).map_err(|why| invalid(format!("{field}: {why}")))
    };
    let calibration_file = path(&message.calibration, "calibration")?;
    let mut frames: Vec<RecordedFrame> = Vec::new();
    for (i, frame) in message.frames.into_iter().enumerate() {
        if frame.id.is_empty() || frames.iter().any(|f| f.id == frame.id) {
            return Err(invalid(format!("frames[{i}].id: {:?} is not a name of its own", frame.id)));
        }
        frames.push(RecordedFrame {
            file: path(&frame.file, &format!("frames[{i}].file"))?,
            id: frame.id,
            role: match known(frame.role, &format!("frames[{i}].role"))? {
                v1::Role::Face => Role::Face,
                v1::Role::Board => Role::Board,
                v1::Role::Unspecified => return Err(invalid(format!("frames[{i}].role: missing"))),
            },
            laser: match known(frame.laser, &format!("frames[{i}].laser"))? {
                v1::Laser::On => Laser::On,
                v1::Laser::Off => Laser::Off,
                v1::Laser::Unspecified => return Err(invalid(format!("frames[{i}].laser: missing"))),
            },
        });
    }
    Ok(Recording { folder: folder.to_owned(), serial: message.serial, calibration_file, frames })
}
