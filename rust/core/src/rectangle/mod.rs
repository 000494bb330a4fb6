//! The rectangle of a face on its plane: which one ([`hypothesize`]), its joint fit ([`refine`]), the paper's eight key
//! points ([`key_points`]), the way from rounded to sharp edges ([`sharp_edge`]), and the result with its uncertainty (this
//! file).

pub(crate) mod hypothesize;
pub(crate) mod key_points;
pub(crate) mod refine;
pub(crate) mod sharp_edge;

use crate::calibration::Calibration;
use crate::edges::EdgePoint;
use crate::face::extent::{FaceStripes, crossing_px};
use crate::face::outline::{RoughRectangle, SIDES, span_mm};
use crate::face::plane_fit::StripeObservation;
use crate::face::raster::{OnPlane, PlaneRaster};
use crate::image::Frame;
use crate::measurement::{FaceMeasurement, Method};
use crate::reject::Reject;
use crate::units::{Estimate, LaserId, Px};
use nalgebra::SVector;
use refine::{Anchor, FittedRectangle, ITERATIONS, refine, start_from};

/// Pointing drift of a laser module between calibrations, rad, 1 sigma: half of the 0.1 mrad of physics.md, since the
/// four sit on one carrier and part of the drift is common.
const LASER_DRIFT_RAD: f64 = 0.05e-3;
/// Blur and demosaicing move edges of unequal brightness, px, 1 sigma.
const EDGE_SYSTEMATIC_PX: f64 = 0.2;
/// Fewest edge points on a side.
const MIN_EDGE_POINTS: usize = 8;
/// Residuals above these are not noise: stripes scatter by 0.2 to 0.5 px, edges by 0.3 to 1 px.
const MAX_STRIPE_RMS_PX: f64 = 1.5;
const MAX_EDGE_RMS_PX: f64 = 1.5;

/// Fits the rectangle of a face and judges it.
pub(crate) fn measure(
    frame: &Frame,
    calibration: &Calibration,
    face: &FaceStripes,
    rough: &RoughRectangle,
    edges: &[Vec<EdgePoint>; 4],
    method: Method,
) -> Result<FaceMeasurement, Reject> {
    let sides_found = edges.iter().filter(|e| e.len() >= MIN_EDGE_POINTS).count() as u8;
    let open = || Reject::RectangleOpen { sides_found };
    if sides_found < 4 {
        return Err(open());
    }
    if face.fit.rms_px > MAX_STRIPE_RMS_PX {
        return Err(Reject::FaceNotPlanar { rms_px: face.fit.rms_px, limit_px: MAX_STRIPE_RMS_PX });
    }
    let stripes = face_observations(calibration, face, rough);
    let [l1, _, l3, l4] = LaserId::ALL;
    let at = crossing_px(calibration, &face.fit.plane, l1, l3).ok_or_else(open)?;
    let towards = crossing_px(calibration, &face.fit.plane, l1, l4).ok_or_else(open)?;
    let anchor = Anchor { at, towards };
    let start = start_from(calibration, rough, anchor).ok_or_else(open)?;
    let mut fit = refine(calibration, &stripes, edges, anchor, &start, ITERATIONS).ok_or_else(open)?;
    let limit_px = edge_limit_px(edges);
    if fit.edge_rms_px > limit_px {
        return Err(Reject::NotARectangle { rms_px: fit.edge_rms_px, limit_px });
    }
    check_crossings(frame, calibration, &fit)?;

    let sides = |offsets: &[f64; 4]| [offsets[1] - offsets[0], offsets[3] - offsets[2]];
    let mut values = sides(&fit.offsets_mm);
    let corrections = sharp_edge::corrections(frame, calibration, face, &fit, &rough.at_ends);
    let sharpen = sharp_edge::lengths(&corrections);
    let surface =
        sharpen.map(|(_, variance)| variance + 2.0 * (EDGE_SYSTEMATIC_PX * rough.mm_per_px).powi(2));
    let mut variances = [0, 2].map(|low| {
        let mut pick = SVector::<f64, 8>::zeros();
        pick[4 + low] = -1.0;
        pick[5 + low] = 1.0;
        (pick.transpose() * fit.covariance * pick)[0] + surface[low / 2]
    });
    for id in LaserId::ALL {
        let turned = calibration.with_turned_laser(id, LASER_DRIFT_RAD);
        if let Some(moved) = refine(&turned, &stripes, edges, anchor, &fit.params, 2) {
            for ((v, m), f) in variances.iter_mut().zip(sides(&moved.offsets_mm)).zip(values) {
                *v += (m - f).powi(2);
            }
        }
    }
    if method == Method::Keypoints {
        // The paper measures what the image shows: what the rounding takes is part of its error.
        let points = key_points::measure(calibration, face, &fit, edges).ok_or_else(open)?;
        values = points.sides_mm;
        for ((v, s), (outwards_mm, _)) in variances.iter_mut().zip(surface).zip(sharpen) {
            *v = s + outwards_mm * outwards_mm;
        }
        variances = [0, 1].map(|i| variances[i] + points.variances_mm2[i]);
    } else {
        for (((offset, correction), (_, high)), i) in
            fit.offsets_mm.iter_mut().zip(&corrections).zip(SIDES).zip([0, 0, 1, 1])
        {
            *offset += if high { correction.outwards_mm } else { -correction.outwards_mm };
            values[i] += correction.outwards_mm;
        }
    }
    let key_points_px = key_points::on_sides(calibration, &fit).ok_or_else(open)?;
    assemble(calibration, &stripes, edges, &fit, values, variances, key_points_px).ok_or_else(open)
}

/// What edge residuals may be: more where the points come from a coarse map.
fn edge_limit_px(edges: &[Vec<EdgePoint>; 4]) -> f64 {
    let (sum, count) = edges.iter().flatten().fold((0.0, 0.0), |(s, n), e| (s + e.sigma_px, n + 1.0));
    MAX_EDGE_RMS_PX.max(3.0 * sum / f64::max(count, 1.0))
}

/// The stripe centres that lie within the rectangle.
fn face_observations(
    calibration: &Calibration,
    face: &FaceStripes,
    rough: &RoughRectangle,
) -> Vec<StripeObservation> {
    let margin = 2.0 * rough.mm_per_px;
    let [a0, a1, b0, b1] = rough.offsets_mm;
    let inside = |o: &StripeObservation| {
        rough
            .raster
            .on_plane(calibration, o.at)
            .is_some_and(|p| p.x > a0 + margin && p.x < a1 - margin && p.y > b0 + margin && p.y < b1 - margin)
    };
    LaserId::ALL.into_iter().flat_map(|id| face.centres(id)).filter(inside).collect()
}

/// Every stripe must cross its two sides between their corners, and every corner must be in the image.
fn check_crossings(frame: &Frame, calibration: &Calibration, fit: &FittedRectangle) -> Result<(), Reject> {
    if let Some(cut) = corners_outside(frame, calibration, &fit.raster, &fit.offsets_mm) {
        return Err(cut);
    }
    let mut missed = None;
    let mut on_face = 4;
    for id in LaserId::ALL {
        let crosses = [0, 1].into_iter().all(|end| {
            let side = if id.number() <= 2 { end } else { 2 + end };
            key_points::along_side_mm(calibration, fit, id, side).is_some_and(|along| {
                let (low, high) = span_mm(&fit.offsets_mm, side);
                along > low && along < high
            })
        });
        if !crosses {
            on_face -= 1;
            missed = missed.or(Some(id));
        }
    }
    match missed {
        Some(laser) => Err(Reject::StripeMissing { laser, stripes_on_face: on_face }),
        None => Ok(()),
    }
}

/// The refusal if a corner lies outside the image.
fn corners_outside(
    frame: &Frame,
    calibration: &Calibration,
    raster: &PlaneRaster,
    offsets_mm: &[f64; 4],
) -> Option<Reject> {
    let (right, bottom) = (frame.width_px() as f64 - 0.5, frame.height_px() as f64 - 0.5);
    let outside = |p: &Px| p.u < -0.5 || p.v < -0.5 || p.u > right || p.v > bottom;
    let corners = corner_points(offsets_mm)
        .map(|corner| raster.pixel(calibration, corner).unwrap_or(Px::new(-1.0, -1.0)));
    let first = corners.iter().find(|p| outside(p))?;
    let sides_cut = corners.iter().filter(|p| outside(p)).count() as u8;
    Some(Reject::FaceCutByBorder { sides_cut, at: *first })
}

/// Corners on the raster, going round from low a, low b along a.
pub(crate) fn corner_points([a0, a1, b0, b1]: &[f64; 4]) -> [OnPlane; 4] {
    [OnPlane::new(*a0, *b0), OnPlane::new(*a1, *b0), OnPlane::new(*a1, *b1), OnPlane::new(*a0, *b1)]
}

fn assemble(
    calibration: &Calibration,
    stripes: &[StripeObservation],
    edges: &[Vec<EdgePoint>; 4],
    fit: &FittedRectangle,
    values: [f64; 2],
    variances: [f64; 2],
    key_points_px: [[Px; 2]; 4],
) -> Option<FaceMeasurement> {
    let estimates = [0, 1].map(|i| Estimate::new(values[i], variances[i].max(0.0).sqrt()));
    let round = corner_points(&fit.offsets_mm);
    // Sides going round from corner 0: low b, high a, high b, low a.
    let mut corners = round;
    let mut sides = [2, 1, 3, 0];
    let (mut length, mut width) = (estimates[0], estimates[1]);
    if length.value_mm < width.value_mm {
        std::mem::swap(&mut length, &mut width);
        corners = [round[0], round[3], round[2], round[1]];
        sides = [0, 3, 1, 2];
    }
    let px = |c: OnPlane| fit.raster.pixel(calibration, c);
    let corners_px = [px(corners[0])?, px(corners[1])?, px(corners[2])?, px(corners[3])?];
    let used = |side: usize| -> Vec<Px> {
        edges[side]
            .iter()
            .zip(&fit.edge_inliers[side])
            .filter(|(_, used)| **used)
            .map(|(e, _)| e.at)
            .collect()
    };
    Some(FaceMeasurement {
        length,
        width,
        plane: fit.raster.plane,
        corners_px,
        corners: corners.map(|c| fit.raster.cam_point(c)),
        key_points_px,
        rms_px: fit.rms_px,
        stripe_points_px: LaserId::ALL
            .map(|id| stripes.iter().filter(|s| s.laser == id).map(|s| s.at).collect()),
        edge_points_px: sides.map(used),
    })
}

/// The places on the sides where the stripes cross, with the radius in which their light disturbs edges, px.
pub(crate) fn keep_out(
    calibration: &Calibration,
    face: &FaceStripes,
    rough: &RoughRectangle,
) -> Vec<(Px, f64)> {
    let radius = face.half_width_px + 5.0;
    let mut places = Vec::with_capacity(8);
    for (side, (across, _)) in SIDES.iter().enumerate() {
        for id in across.stripes() {
            if let Some(at) =
                key_points::crossing_on(calibration, &rough.raster, *across, rough.offsets_mm[side], id)
                    .and_then(|along| {
                        rough.raster.pixel(calibration, across.at(rough.offsets_mm[side], along))
                    })
            {
                places.push((at, radius));
            }
        }
    }
    places
}
