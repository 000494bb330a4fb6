//! Where the stripes' ends put the face's rectangle: its direction from pairs of ends that lie on one side, each side where its stripes end. Rough:
//! a flush neighbour carries stripes on, print ends them early; what each side is, is judged afterwards (`rectangle/line_evidence`).

use super::extent::{FaceStripes, Limits, StripeEnd, crossing_on_px, crossing_px, outermost_crossing_mm};
use super::outline::{Across, InitialRectangle, MOST_TURN_RAD, SIDES, outward_sign};
use super::raster::{OnPlane, PlaneRaster};
use crate::calibration::Calibration;
use crate::image::Frame;
use crate::reject::Reject;
use crate::units::{LaserId, Px};

/// What the stripes' ends say of a side. Where a field gives no reason for its value, none is on record.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EndSettings {
    /// Two ends that belong to one side differ by no more than this, px, beyond the length of a profile block. More takes an end at print for one at
    /// the side.
    pub tolerance_px: f64,
    /// How far beyond the sides that are known the stripes are followed, px: enough to see whether they leave the plane there. More meets what lies
    /// beyond the face's neighbours.
    pub beyond_px: f64,
    /// A stripe that comes so near to the border, px (5 % of the image), on a face without an edge there leaves the image with it: "step back" is
    /// the right advice, though the laser's fan may end before. More gives it to faces that are open for another reason.
    border_px: f64,
}

impl EndSettings {
    pub const DEFAULT: Self = Self { tolerance_px: 12.0, beyond_px: 40.0, border_px: 100.0 };
}

impl Default for EndSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// An end of a stripe on the raster.
#[derive(Clone, Copy)]
pub(crate) struct End {
    pub at: OnPlane,
    pub px: Px,
    pub runs_on: bool,
    pub uncertainty_px: f64,
}

impl End {
    fn leaves_image(&self, frame: &Frame) -> bool {
        leaves_image(self.px, self.runs_on, self.uncertainty_px, frame)
    }
}

/// The rectangle through the stripes' ends, or why there is none.
///
/// A side on which both stripes end lies between the two ends, or at the nearer one if they differ: nothing but print ends a stripe before
/// the face does, and a neighbour carries one on more often. One that a stripe runs beyond lies at the other's end.
pub(crate) fn end_outline(
    frame: &Frame,
    calibration: &Calibration,
    face: &FaceStripes,
) -> Result<InitialRectangle, Reject> {
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
    let mut offsets_mm = [0.0; 4];
    for (side, pair) in ends.iter().enumerate() {
        let sign = outward_sign(side);
        let out = pair.map(|end| sign * SIDES[side].0.offset(end.at));
        let together = mismatch(SIDES[side].0, pair, 0.0, mm_per_px) <= 1.0;
        let out_mm = match pair.map(|end| end.runs_on) {
            [false, true] => out[0],
            [true, false] => out[1],
            [false, false] if together => 0.5 * (out[0] + out[1]),
            _ => out[0].min(out[1]),
        };
        let clear_mm = innermost(calibration, face, &raster, SIDES[side], mm_per_px).ok_or_else(open)?;
        if out_mm <= clear_mm {
            return Err(cut_or_open(&ends, frame));
        }
        offsets_mm[side] = sign * out_mm;
    }
    Ok(InitialRectangle::new(raster, offsets_mm, mm_per_px))
}

/// Where each stripe is to be followed when the face's sides are known (its sides' offsets on a raster): a little beyond its two sides.
pub(crate) fn limits(
    calibration: &Calibration,
    raster: &PlaneRaster,
    offsets_mm: &[f64; 4],
    mm_per_px: f64,
) -> Option<Limits> {
    let beyond = EndSettings::DEFAULT.beyond_px * mm_per_px;
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

/// Whether the stripes end at each side, and do not both run on onto a flush neighbour.
pub(crate) fn ends_seen(
    calibration: &Calibration,
    face: &FaceStripes,
    raster: &PlaneRaster,
) -> Option<[bool; 4]> {
    Some(ends_by_side(calibration, face, raster)?.map(|pair| !pair.iter().all(|end| end.runs_on)))
}

/// The two stripe ends of each side.
pub(crate) fn ends_by_side(
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
    let [first, second] = pair;
    let tolerance_px = EndSettings::DEFAULT.tolerance_px + first.uncertainty_px + second.uncertainty_px;
    (offset(first) - offset(second)).abs() / (tolerance_px * mm_per_px)
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
        (angle.is_finite() && angle.abs() < MOST_TURN_RAD).then_some((angle, along * along))
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
pub(crate) fn innermost(
    calibration: &Calibration,
    face: &FaceStripes,
    raster: &PlaneRaster,
    side: (Across, bool),
    mm_per_px: f64,
) -> Option<f64> {
    let outermost_mm = outermost_crossing_mm(calibration, raster, side)?;
    Some(outermost_mm + face.half_width_px * mm_per_px)
}

/// The refusal if a stripe runs out of the image on the face.
pub(crate) fn cut_by_border(frame: &Frame, face: &FaceStripes) -> Option<Reject> {
    let leaving = |ends: &[StripeEnd; 2]| {
        ends.iter().copied().find(|e| leaves_image(e.at, e.runs_on, e.uncertainty_px, frame))
    };
    let found: Vec<StripeEnd> = face.stripes.iter().filter_map(|s| leaving(&s.ends)).collect();
    found.first().map(|end| Reject::FaceCutByBorder { sides_cut: found.len().min(4) as u8, at: end.at })
}

/// Whether a face without an edge where a stripe ends goes on to the image border.
fn leaves_image(at: Px, runs_on: bool, uncertainty_px: f64, frame: &Frame) -> bool {
    let (right, bottom) = (frame.width_px() as f64, frame.height_px() as f64);
    let room_px = at.u.min(at.v).min(right - at.u).min(bottom - at.v);
    runs_on || room_px < EndSettings::DEFAULT.border_px + uncertainty_px
}

/// The refusal when sides are missing: cut by the border if a stripe runs out of the image, open otherwise.
fn cut_or_open(ends: &[[End; 2]; 4], frame: &Frame) -> Reject {
    let cut: Vec<&[End; 2]> = ends.iter().filter(|pair| pair.iter().any(|e| e.leaves_image(frame))).collect();
    match cut.first().and_then(|pair| pair.iter().find(|e| e.leaves_image(frame))) {
        Some(end) => Reject::FaceCutByBorder { sides_cut: cut.len() as u8, at: end.px },
        None => Reject::RectangleOpen { sides_found: (ends.len() - 1) as u8 },
    }
}
