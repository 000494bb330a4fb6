//! From the lines of an outline to the picture's edges beside them: each side is the strongest edge nearby, less the farther it is from the line
//! and from where its stripes end.

use super::corners_outside;
use crate::calibration::Calibration;
use crate::edges::side_scan::{EdgeCandidate, ScanRange, SideScan, TURN_PX};
use crate::face::end_outline::{END_TOLERANCE_PX, LIMIT_BEYOND_PX, ends_by_side, innermost};
use crate::face::extent::FaceStripes;
use crate::face::outline::{InitialRectangle, SIDES, outward_sign, span_mm};
use crate::image::Frame;
use crate::reject::Reject;

/// Scatter of a stripe's end about the edge, px, beyond the places that were not seen: the rounding takes 1 to 5 px.
const END_SIGMA_PX: f64 = 3.0;
/// Two edges are one if they are closer than this, px.
const EDGES_APART_PX: f64 = 4.0;
/// How far beside a side's line its edge may be found, 1 sigma and at most, px: the line is an edge of the picture itself, seen from end
/// to end; what is farther away is another line, with a probability of its own.
const LINE_SIGMA_PX: f64 = 4.0;
const LINE_REACH_PX: f64 = 10.0;
/// So far to both sides of it edges are compared with what else is there, px: a rounded edge of 4 mm seen from 0.35 m is 30 px wide, and
/// what fills the range that its noise is taken from is no edge.
const SCAN_PX: f64 = 64.0;
/// A stripe that goes on for this share of [`LIMIT_BEYOND_PX`] did not leave the plane.
const RUNS_BEYOND: f64 = 0.7;
/// Share of a side on which the image must show an edge where the stripes run on beyond it: a flush neighbour's seam is seen
/// along the whole side.
const SUPPORT_FLUSH: f32 = 0.5;
/// ... and where they do not.
const SUPPORT: f32 = 0.2;

/// The rectangle whose sides are the image's edges beside these lines.
pub(crate) fn snap_to_image(
    frame: &Frame,
    calibration: &Calibration,
    face: &FaceStripes,
    outline: &InitialRectangle,
) -> Result<InitialRectangle, Reject> {
    let open = |sides_found: u8| Reject::RectangleOpen { sides_found };
    let (raster, px) = (outline.raster.on(&face.fit.plane), outline.mm_per_px);
    let ends = ends_by_side(calibration, face, &raster).ok_or_else(|| open(0))?;
    let (reach, sigma) = (LINE_REACH_PX * px, LINE_SIGMA_PX * px);
    let (mut snapped, mut flush, mut found) = ([0.0; 4], [false; 4], 0u8);
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
        let needed = if flush[side] { SUPPORT_FLUSH } else { SUPPORT };
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
            .candidates(TURN_PX * px, EDGES_APART_PX * px, SUPPORT, usize::MAX)
            .into_iter()
            .filter(|e| (e.offset_mm - offset).abs() <= reach)
            .collect();
        // The stripe that runs along the side is none, unless nothing else is.
        if edges.iter().any(|e| sign * e.offset_mm > inner) {
            edges.retain(|e| sign * e.offset_mm > inner);
        }
        let clear = edges.iter().filter(|e| e.strength >= needed);
        let nearest = clear.max_by(|x, y| near(x).total_cmp(&near(y))).map(|e| e.offset_mm);
        found += u8::from(nearest.is_some());
        snapped[side] = nearest.unwrap_or(offset);
    }
    if found < 4 {
        return Err(open(found));
    }
    match corners_outside(frame, calibration, &raster, &snapped) {
        Some(cut) => Err(cut),
        None => Ok(InitialRectangle {
            raster,
            offsets_mm: snapped,
            at_ends: flush.map(|f| !f),
            lines: outline.lines.clone(),
            mm_per_px: px,
        }),
    }
}

/// How well a place agrees with another, 1 at best: that of Cauchy's distribution, since both may be something else altogether.
fn agreement(distance: f64, sigma: f64) -> f64 {
    1.0 / (1.0 + (distance / (1.5 * sigma)).powi(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::face::extent::{StripeContrast, follow_stripes, inner_segments};
    use crate::frames::Plane;
    use crate::scene::drawn::{DISTANCE_MM, Surface, drawn, face};
    use nalgebra::Vector3;

    /// Half the size of the face across both directions, mm; its edges are steps of paint from 1 to 0.7.
    const HALF_MM: [f64; 2] = [170.0, 200.0];

    #[test]
    fn print_beside_a_side_however_strong_does_not_hide_its_edge() {
        let (_, raster) = face();
        let behind = Some(Plane::new(Vector3::z() / (DISTANCE_MM + 200.0)));
        let px_mm =
            raster.mm_per_px(&face().0, crate::face::raster::OnPlane::zeros()).expect("in the picture");
        let frame = drawn(|at| {
            let inside_mm = [HALF_MM[0] - at.x.abs(), HALF_MM[1] - at.y.abs()];
            let on_face = inside_mm.iter().all(|mm| *mm > 0.0);
            // Ten lines, each a stronger edge than the side itself.
            let inside_px = inside_mm[0] / px_mm;
            let printed = at.x > 0.0 && (12.0..62.0).contains(&inside_px) && inside_px % 10.0 < 5.0;
            let paint = if printed {
                0.2
            } else if on_face {
                1.0
            } else {
                0.7
            };
            Surface { on: if on_face { Some(raster.plane) } else { behind }, paint }
        });
        let (calibration, _) = face();
        let inner =
            inner_segments(&frame, &calibration, &raster.plane, StripeContrast::Clear).expect("four stripes");
        let stripes = follow_stripes(&frame, &calibration, &inner, None).expect("a face");
        let offsets_mm = [-HALF_MM[0], HALF_MM[0] + 2.0 * px_mm, -HALF_MM[1], HALF_MM[1]];
        let outline = InitialRectangle::new(raster, offsets_mm, px_mm);
        let found = snap_to_image(&frame, &calibration, &stripes, &outline).expect("four edges");
        for (side, (offset_mm, true_mm)) in
            found.offsets_mm.iter().zip([-HALF_MM[0], HALF_MM[0], -HALF_MM[1], HALF_MM[1]]).enumerate()
        {
            assert!((offset_mm - true_mm).abs() < 2.0 * px_mm, "side {side}: {offset_mm} for {true_mm} mm");
        }
    }
}
