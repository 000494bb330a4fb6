//! Which rectangle on the plane is the face: its direction from the ends of the stripes, its four sides from the ends
//! where a stripe leaves the plane and from straight image edges where a flush neighbour carries the stripe on.

use super::combine::{APART_PX, CLEAR_SUPPORT, DRIFT_PX, KEEP, Known, Side, choose};
use super::corners_outside;
use crate::calibration::Calibration;
use crate::edges::side_scan::{EdgeCandidate, ScanRange, SideScan};
use crate::face::extent::{
    FaceStripes, Limits, StripeEnd, crossing_on_px, crossing_px, outermost_crossing_mm,
};
use crate::face::map_outline::MapOutline;
use crate::face::outline::{Across, RoughRectangle, SIDES, outward_sign, span_mm};
use crate::face::raster::{OnPlane, PlaneRaster};
use crate::image::Frame;
use crate::reject::Reject;
use crate::units::{LaserId, Px};

/// Two ends that belong to one side differ by no more than this, px, beyond the length of a profile block.
const END_TOLERANCE_PX: f64 = 12.0;
/// Scatter of a stripe's end about the edge, px, beyond the places that were not seen: the rounding takes 1 to 5 px.
const END_SIGMA_PX: f64 = 3.0;
/// Largest angle between a stripe and the box's edge: the head is rolled along the edges by eye, a tilted face shears.
const MAX_ANGLE_RAD: f64 = 0.55;
/// An image edge must be seen on this share of a side where the stripes end too ...
const SUPPORT_AT_ENDS: f32 = 0.35;
/// ... and on this share where only the image tells: print and tape seldom fill 16 segments.
const SUPPORT_ALONE: f32 = 0.75;
/// Candidates at the ends of the stripes that are kept per side.
const KEEP_AT_ENDS: usize = 3;
/// Further straight lines inside, kept as alternatives.
const KEEP_INSIDE: usize = 4;
/// Where the stripes' ends alone tell the sides, a side keeps this clear of the stripe that runs along it, px.
const STRIPE_CLEAR_PX: f64 = 6.0;

/// An end of a stripe on the raster.
#[derive(Clone, Copy)]
struct End {
    at: OnPlane,
    px: Px,
    runs_on: bool,
    uncertainty_px: f64,
}

impl End {
    fn leaves_image(&self, frame: &Frame) -> bool {
        leaves_image(self.px, self.runs_on, self.uncertainty_px, frame)
    }
}

/// Finds the rectangle, the likeliest first, or says why there is none.
pub(crate) fn hypothesize(
    frame: &Frame,
    calibration: &Calibration,
    face: &FaceStripes,
    which: Which,
) -> Result<Vec<RoughRectangle>, Reject> {
    let open = || Reject::RectangleOpen { sides_found: 0 };
    let [l1, _, l3, l4] = LaserId::ALL;
    let plane = &face.fit.plane;
    let at = crossing_px(calibration, plane, l1, l3).ok_or_else(open)?;
    let towards = crossing_px(calibration, plane, l1, l4).ok_or_else(open)?;
    let raster = PlaneRaster::new(calibration, plane, at, towards).ok_or_else(open)?;
    let mm_per_px = raster.mm_per_px(calibration, OnPlane::zeros()).ok_or_else(open)?;
    let ends = ends_by_side(calibration, face, &raster).ok_or_else(open)?;
    let angle = direction(&ends, mm_per_px).ok_or_else(|| cut_or_open(&ends, frame))?;
    let raster = raster.turned(angle);
    let ends = ends_by_side(calibration, face, &raster).ok_or_else(open)?;

    let mut sides = Vec::with_capacity(4);
    for (side, pair) in SIDES.iter().zip(&ends) {
        sides.push(
            side_candidates(frame, calibration, face, &raster, *side, pair, mm_per_px).ok_or_else(open)?,
        );
    }
    let found = sides.iter().filter(|s| !s.is_empty()).count();
    if found < 4 {
        let any_border =
            ends.iter().zip(&sides).any(|(e, s)| s.is_empty() && e.iter().any(|x| x.leaves_image(frame)));
        return Err(if any_border {
            cut_or_open(&ends, frame)
        } else {
            Reject::RectangleOpen { sides_found: found as u8 }
        });
    }
    let roughs = choose(frame, calibration, &raster, &sides, mm_per_px, Known::Ends(which));
    if roughs.is_empty() { Err(cut_or_open(&ends, frame)) } else { Ok(roughs) }
}

/// Which rectangles are wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Which {
    /// The likeliest alone.
    Best,
    /// Also those with one side at a straight line farther in: a flush neighbour of the same width makes one rectangle of
    /// two faces, and only the other frame can tell.
    WithAlternatives,
}

/// How far beside a side's line its edge may be found, 1 sigma and at most, px: the line is an edge of the picture itself, seen from end
/// to end; what is farther away is another line, with a probability of its own.
const LINE_SIGMA_PX: f64 = 4.0;
const LINE_REACH_PX: f64 = 10.0;
/// So far to both sides of it edges are compared with what else is there, px: a rounded edge of 4 mm seen from 0.35 m is 30 px wide, and
/// what fills the range that its noise is taken from is no edge.
const SCAN_PX: f64 = 64.0;

/// Finds the rectangle when its sides' lines are known: the image's edges beside each compete.
pub(crate) fn snap_to_image(
    frame: &Frame,
    calibration: &Calibration,
    face: &FaceStripes,
    outline: &MapOutline,
) -> Result<RoughRectangle, Reject> {
    let open = |found: usize| Reject::RectangleOpen { sides_found: found as u8 };
    let (raster, px) = (outline.raster.on(&face.fit.plane), outline.mm_per_px);
    let ends = ends_by_side(calibration, face, &raster).ok_or_else(|| open(0))?;
    let (reach, sigma) = (LINE_REACH_PX * px, LINE_SIGMA_PX * px);
    let mut sides = Vec::with_capacity(4);
    let mut flush = [false; 4];
    for (side, ((across, high), pair)) in SIDES.into_iter().zip(&ends).enumerate() {
        let offset = outline.offsets_mm[side];
        // A stripe that ends beside the side says where, if it was seen all the way.
        let mut ends_here = Vec::with_capacity(2);
        for end in pair.iter().filter(|e| !e.runs_on) {
            let spread = (END_SIGMA_PX + 0.36 * end.uncertainty_px) * px;
            let at = across.offset(end.at);
            if (at - offset).abs() < 3.0 * spread.hypot(sigma) {
                ends_here.push((at, spread));
            }
        }
        let inner = innermost(calibration, face, &raster, (across, high), px).ok_or_else(|| open(0))?;
        let sign = outward_sign(side);
        let outwards = pair.map(|e| sign * (across.offset(e.at) - offset));
        flush[side] =
            pair.iter().zip(outwards).all(|(e, o)| e.runs_on || o > RUNS_BEYOND * LIMIT_BEYOND_PX * px);
        let needed = if flush[side] { SUPPORT_FLUSH } else { LEAST_BESIDE_MAP };
        let scan = SideScan::new(
            frame,
            calibration,
            &raster,
            &ScanRange {
                across,
                from_mm: offset - SCAN_PX * px,
                to_mm: offset + SCAN_PX * px,
                span_mm: span_mm(&outline.offsets_mm, side),
                step_mm: 0.8 * px,
            },
        );
        // What is coplanar beyond the side, or hides the stripes before it, does so to both: they speak as one, the nearer. Two that
        // disagree say nothing.
        let agree = matches!(ends_here[..], [(a, _), (b, _)] if (a - b).abs() <= END_TOLERANCE_PX * px);
        let near = |e: &EdgeCandidate| {
            let by_ends = ends_here
                .iter()
                .filter(|_| agree)
                .map(|(at, spread)| agreement(e.offset_mm - at, *spread))
                .reduce(f64::max);
            e.strength * (agreement(e.offset_mm - offset, sigma) * by_ends.unwrap_or(1.0)) as f32
        };
        let mut edges: Vec<EdgeCandidate> = scan
            .candidates(DRIFT_PX * px, APART_PX * px, LEAST_BESIDE_MAP, 8)
            .into_iter()
            .filter(|e| (e.offset_mm - offset).abs() <= reach)
            .collect();
        // The stripe that runs along the side is none, unless nothing else is.
        if edges.iter().any(|e| sign * e.offset_mm > inner) {
            edges.retain(|e| sign * e.offset_mm > inner);
        }
        edges.sort_by(|x, y| near(y).total_cmp(&near(x)));
        edges.truncate(KEEP);
        sides.push(
            edges
                .iter()
                .map(|e| Side { offset_mm: e.offset_mm, at_end: true, needed, nearness: near(e) })
                .collect::<Vec<_>>(),
        );
    }
    let found = sides.iter().filter(|s| !s.is_empty()).count();
    if found < 4 {
        return Err(open(found));
    }
    let roughs = choose(frame, calibration, &raster, &sides, px, Known::Outline);
    let mut rough = roughs.into_iter().next().ok_or_else(|| {
        corners_outside(frame, calibration, &raster, &outline.offsets_mm).unwrap_or_else(|| open(found))
    })?;
    rough.at_ends = flush.map(|f| !f);
    rough.lines = outline.lines.clone();
    Ok(rough)
}

/// How well a place agrees with another, 1 at best: that of Cauchy's distribution, since both may be something else altogether.
fn agreement(distance: f64, sigma: f64) -> f64 {
    1.0 / (1.0 + (distance / (1.5 * sigma)).powi(2))
}

/// Where each stripe is to be followed when the maps have shown the face (its sides' offsets on a raster): a little beyond its two sides.
pub(crate) fn limits(
    calibration: &Calibration,
    raster: &PlaneRaster,
    offsets_mm: &[f64; 4],
    mm_per_px: f64,
) -> Option<Limits> {
    let beyond = LIMIT_BEYOND_PX * mm_per_px;
    let mut result = Vec::with_capacity(4);
    for id in LaserId::ALL {
        let mut pair = Vec::with_capacity(2);
        for (side, (across, high)) in SIDES.into_iter().enumerate() {
            if across.stripes().contains(&id) {
                let offset = offsets_mm[side] + if high { beyond } else { -beyond };
                pair.push(crossing_on_px(calibration, raster, across, offset, id)?);
            }
        }
        result.push(pair.try_into().ok()?);
    }
    result.try_into().ok()
}

/// How far beyond the sides in the maps the stripes are followed, px: enough to see whether they leave the plane there.
pub(crate) const LIMIT_BEYOND_PX: f64 = 40.0;
/// A stripe that goes on for this share of that did not leave the plane.
const RUNS_BEYOND: f64 = 0.7;
/// Share of a side on which the image must show an edge where the stripes run on beyond it: a flush neighbour's seam is seen
/// along the whole side.
const SUPPORT_FLUSH: f32 = 0.5;
/// ... and where they do not and the network has an edge.
const LEAST_BESIDE_MAP: f32 = 0.2;

/// Whether the stripes end at each side, and do not both run on onto a flush neighbour.
pub(crate) fn ends_seen(
    calibration: &Calibration,
    face: &FaceStripes,
    raster: &PlaneRaster,
) -> Option<[bool; 4]> {
    Some(ends_by_side(calibration, face, raster)?.map(|pair| !pair.iter().all(|end| end.runs_on)))
}

/// The two stripe ends of each side.
fn ends_by_side(
    calibration: &Calibration,
    face: &FaceStripes,
    raster: &PlaneRaster,
) -> Option<[[End; 2]; 4]> {
    let mut result = Vec::with_capacity(4);
    for (across, high) in SIDES {
        let mut pair = Vec::with_capacity(2);
        for id in across.stripes() {
            let mut ends = Vec::with_capacity(2);
            for end in &face.stripes[id.index()].ends {
                ends.push(End {
                    at: raster.on_plane(calibration, end.at)?,
                    px: end.at,
                    runs_on: end.runs_on,
                    uncertainty_px: end.uncertainty_px,
                });
            }
            ends.sort_by(|x, y| across.offset(x.at).total_cmp(&across.offset(y.at)));
            pair.push(ends[usize::from(high)]);
        }
        result.push([pair[0], pair[1]]);
    }
    result.try_into().ok()
}

/// How far the two ends of a side are from one offset, in units of what is allowed.
fn mismatch(across: Across, pair: &[End; 2], angle: f64, mm_per_px: f64) -> f64 {
    let (s, c) = angle.sin_cos();
    let offset = |e: &End| match across {
        Across::A => e.at.x * c + e.at.y * s,
        Across::B => e.at.y * c - e.at.x * s,
    };
    let tolerance = (END_TOLERANCE_PX + pair[0].uncertainty_px + pair[1].uncertainty_px) * mm_per_px;
    (offset(&pair[0]) - offset(&pair[1])).abs() / tolerance
}

/// The angle by which the raster must be turned so that most sides are parallel to an axis.
fn direction(ends: &[[End; 2]; 4], mm_per_px: f64) -> Option<f64> {
    let angle_of = |across: Across, pair: &[End; 2]| {
        let d = pair[1].at - pair[0].at;
        let (along, off) = (across.along(d), across.offset(d));
        let angle = match across {
            Across::A => -(off / along).atan(),
            Across::B => (off / along).atan(),
        };
        (angle.is_finite() && angle.abs() < MAX_ANGLE_RAD).then_some((angle, along * along))
    };
    let seen: Vec<_> = SIDES
        .iter()
        .zip(ends)
        .filter(|(_, pair)| pair.iter().all(|e| !e.runs_on))
        .filter_map(|((across, _), pair)| Some((*across, pair, angle_of(*across, pair)?)))
        .collect();
    let score = |angle: f64| -> f64 {
        seen.iter()
            .map(|(across, pair, _)| (1.0 - mismatch(*across, pair, angle, mm_per_px).powi(2)).max(0.0))
            .sum()
    };
    let (best, _, _) = seen
        .iter()
        .map(|(_, _, (angle, _))| (*angle, score(*angle), ()))
        .max_by(|x, y| x.1.total_cmp(&y.1))?;
    // The mean over the sides that agree, the longer lever counting more.
    let (mut sum, mut weights) = (0.0, 0.0);
    for (across, pair, (angle, weight)) in &seen {
        if mismatch(*across, pair, best, mm_per_px) < 1.0 {
            sum += angle * weight;
            weights += weight;
        }
    }
    (weights > 0.0).then_some(sum / weights)
}

/// How far out the stripe ends that runs along a side, mm from the raster's middle: the outermost crossing and half its width.
pub(super) fn innermost(
    calibration: &Calibration,
    face: &FaceStripes,
    raster: &PlaneRaster,
    side: (Across, bool),
    mm_per_px: f64,
) -> Option<f64> {
    let outermost_mm = outermost_crossing_mm(calibration, raster, side)?;
    Some(outermost_mm + face.half_width_px * mm_per_px)
}

/// Offsets at which a side may lie; the one at the stripes' ends first.
fn side_candidates(
    frame: &Frame,
    calibration: &Calibration,
    face: &FaceStripes,
    raster: &PlaneRaster,
    (across, high): (Across, bool),
    pair: &[End; 2],
    mm_per_px: f64,
) -> Option<Vec<Side>> {
    let sign = if high { 1.0 } else { -1.0 };
    let px = mm_per_px;
    let inner = innermost(calibration, face, raster, (across, high), px)? + STRIPE_CLEAR_PX * px;
    let offsets = pair.map(|e| sign * across.offset(e.at));
    // A faint stripe is lost before it ends.
    let unsure = pair[0].uncertainty_px.max(pair[1].uncertainty_px);
    let outer = offsets[0].max(offsets[1]) + (25.0 + unsure) * px;
    if outer <= inner {
        return Some(Vec::new());
    }
    let along = pair.map(|e| across.along(e.at));
    let span = (along[0].min(along[1]), along[0].max(along[1]));
    let (from, to) = if high { (inner, outer) } else { (-outer, -inner) };
    let step = 0.8 * px;
    let scan = SideScan::new(
        frame,
        calibration,
        raster,
        &ScanRange { across, from_mm: from, to_mm: to, span_mm: span, step_mm: step },
    );
    let edges = scan.candidates(DRIFT_PX * px, APART_PX * px, 0.3, 24);
    let tolerance = (END_TOLERANCE_PX + pair[0].uncertainty_px + pair[1].uncertainty_px) * px;
    let consistent = pair.iter().all(|e| !e.runs_on) && (offsets[0] - offsets[1]).abs() <= tolerance;
    let mut sides = Vec::new();
    if pair.iter().all(|e| !e.runs_on) && (offsets[0] - offsets[1]).abs() > END_TOLERANCE_PX * px {
        // The ends disagree. A stripe runs on beyond an edge by chance or on a flush neighbour more often than a straight line
        // crosses the whole face where a stripe is lost: the inner end is the face's if the image shows a clear edge there.
        let inner = if offsets[0] < offsets[1] { 0 } else { 1 };
        let (middle, reach) = (sign * offsets[inner], (END_TOLERANCE_PX + pair[inner].uncertainty_px) * px);
        let near = |e: &EdgeCandidate| e.strength / (1.0 + ((e.offset_mm - middle) / reach).powi(2) as f32);
        let beside =
            |e: &&EdgeCandidate| (e.offset_mm - middle).abs() <= reach && e.strength >= CLEAR_SUPPORT;
        if let Some(e) = edges.iter().filter(beside).max_by(|x, y| near(x).total_cmp(&near(y))) {
            let (offset_mm, nearness) = (e.offset_mm, near(e));
            sides.push(Side { offset_mm, at_end: true, needed: CLEAR_SUPPORT, nearness });
        }
    }
    if sides.is_empty() && consistent {
        let middle = 0.5 * sign * (offsets[0] + offsets[1]);
        // Near the ends the strongest edge, less the farther it is from them.
        let spread = (END_SIGMA_PX + 0.18 * (pair[0].uncertainty_px + pair[1].uncertainty_px)) * px;
        let near = |e: &EdgeCandidate| e.strength / (1.0 + ((e.offset_mm - middle) / spread).powi(2) as f32);
        let mut snapped: Vec<&EdgeCandidate> = edges
            .iter()
            .filter(|e| (e.offset_mm - middle).abs() <= tolerance && e.strength >= SUPPORT_AT_ENDS)
            .collect();
        snapped.sort_by(|x, y| near(y).total_cmp(&near(x)));
        snapped.truncate(KEEP_AT_ENDS);
        sides.extend(snapped.iter().map(|e| Side {
            offset_mm: e.offset_mm,
            at_end: true,
            needed: SUPPORT_AT_ENDS,
            nearness: near(e),
        }));
        if sides.is_empty() {
            sides.push(Side { offset_mm: middle, at_end: true, needed: SUPPORT_AT_ENDS, nearness: 0.0 });
        }
    }
    let at_ends = sides.clone();
    for e in edges.iter().filter(|e| e.strength >= SUPPORT_ALONE) {
        let apart = at_ends.iter().all(|s| (e.offset_mm - s.offset_mm).abs() > END_TOLERANCE_PX * px);
        if sides.len() < KEEP + KEEP_INSIDE && apart {
            sides.push(Side { offset_mm: e.offset_mm, at_end: false, needed: SUPPORT_ALONE, nearness: 0.0 });
        }
    }
    Some(sides)
}

/// The refusal if a stripe runs out of the image on the face.
pub(crate) fn cut_by_border(frame: &Frame, face: &FaceStripes) -> Option<Reject> {
    let leaving = |ends: &[StripeEnd; 2]| {
        ends.iter().copied().find(|e| leaves_image(e.at, e.runs_on, e.uncertainty_px, frame))
    };
    let found: Vec<StripeEnd> = face.stripes.iter().filter_map(|s| leaving(&s.ends)).collect();
    found.first().map(|end| Reject::FaceCutByBorder { sides_cut: found.len().min(4) as u8, at: end.at })
}

/// A stripe that comes so near to the border, px (5 % of the image), on a face without an edge there leaves the image with it:
/// "step back" is the right advice, though the laser's fan may end before.
const ROOM_PX: f64 = 100.0;

/// Whether a face without an edge where a stripe ends goes on to the image border.
fn leaves_image(at: Px, runs_on: bool, uncertainty_px: f64, frame: &Frame) -> bool {
    let (right, bottom) = (frame.width_px() as f64, frame.height_px() as f64);
    let room_px = at.u.min(at.v).min(right - at.u).min(bottom - at.v);
    runs_on || room_px < ROOM_PX + uncertainty_px
}

/// The refusal when sides are missing: cut by the border if a stripe runs out of the image, open otherwise.
fn cut_or_open(ends: &[[End; 2]; 4], frame: &Frame) -> Reject {
    let cut: Vec<&[End; 2]> = ends.iter().filter(|pair| pair.iter().any(|e| e.leaves_image(frame))).collect();
    match cut.first().and_then(|pair| pair.iter().find(|e| e.leaves_image(frame))) {
        Some(end) => Reject::FaceCutByBorder { sides_cut: cut.len() as u8, at: end.px },
        None => Reject::RectangleOpen { sides_found: (ends.len() - 1) as u8 },
    }
}
