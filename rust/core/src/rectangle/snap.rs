//! From the lines of an outline to the picture's edges beside them: each side is the strongest edge nearby, less the farther it is from the line
//! and from where its stripes end.

use super::corners_outside;
use crate::calibration::Calibration;
use crate::edges::side_scan::{EdgeCandidate, ScanRange, SideScan, TURN_PX};
use crate::face::end_outline::{End, EndSettings, ends_by_side, innermost};
use crate::face::extent::FaceStripes;
use crate::face::outline::{InitialRectangle, SIDES, outward_sign, span_mm};
use crate::face::raster::PlaneRaster;
use crate::image::Frame;
use crate::reject::Reject;

/// Which of the picture's edges beside a line is the side.
#[derive(Clone, Copy, Debug)]
struct SnapSettings {
    /// Scatter of a stripe's end about the edge, px, beyond the places that were not seen: the rounding takes 1 to 5 px. More lets a strong line
    /// beside the end win.
    end_sigma_px: f64,
    /// ... and by how much it grows for each px that was not seen. More trusts ends of faint stripes less.
    end_sigma_per_unseen: f64,
    /// Two edges are one if they are closer than this, px. More loses the side beside a stronger line.
    edges_apart_px: f64,
    /// How far beside a side's line its edge may be found, 1 sigma and at most, px: the line is an edge of the picture itself, seen from end
    /// to end; what is farther away is another line, with a probability of its own. More takes that one for the side.
    line_sigma_px: f64,
    line_reach_px: f64,
    /// So far to both sides of it edges are compared with what else is there, px: a rounded edge of 4 mm seen from 0.35 m is 30 px wide, and
    /// what fills the range that its noise is taken from is no edge. More takes longer and compares with what is far away.
    scan_px: f64,
    /// Distance of samples across the side, px. More is quicker and less exact.
    step_px: f64,
    /// A stripe that goes on for this share of [`EndSettings::beyond_px`] did not leave the plane. More takes a flush neighbour's seam for an edge.
    runs_beyond: f64,
    /// Share of a side on which the image must show an edge where the stripes run on beyond it: a flush neighbour's seam is seen
    /// along the whole side. More refuses faint seams.
    support_flush: f32,
    /// ... and where they do not. More refuses faint edges.
    support: f32,
}

impl SnapSettings {
    const DEFAULT: Self = Self {
        end_sigma_px: 3.0,
        end_sigma_per_unseen: 0.36,
        edges_apart_px: 4.0,
        line_sigma_px: 4.0,
        line_reach_px: 10.0,
        scan_px: 64.0,
        step_px: 0.8,
        runs_beyond: 0.7,
        support_flush: 0.5,
        support: 0.2,
    };
}

impl Default for SnapSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// The rectangle whose sides are the image's edges beside these lines.
pub(crate) fn snap_to_image(
    frame: &Frame,
    calibration: &Calibration,
    face: &FaceStripes,
    outline: &InitialRectangle,
) -> Result<InitialRectangle, Reject> {
    let open = |sides_found: u8| Reject::RectangleOpen { sides_found };
    let raster = outline.raster.on(&face.fit.plane);
    let ends = ends_by_side(calibration, face, &raster).ok_or_else(|| open(0))?;
    let settings = &SnapSettings::DEFAULT;
    let snap = Snap { frame, calibration, face, outline, raster: &raster, settings };
    let (mut snapped, mut flush, mut found) = (outline.offsets_mm, [false; 4], 0u8);
    for (side, pair) in ends.iter().enumerate() {
        flush[side] = snap.runs_beyond(side, pair);
        let edges = snap.edges(side).ok_or_else(|| open(0))?;
        if let Some(nearest_mm) = snap.nearest_mm(side, pair, &edges, flush[side]) {
            snapped[side] = nearest_mm;
            found += 1;
        }
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
            mm_per_px: outline.mm_per_px,
        }),
    }
}

/// An outline over the picture's edges.
struct Snap<'a> {
    frame: &'a Frame,
    calibration: &'a Calibration,
    face: &'a FaceStripes,
    outline: &'a InitialRectangle,
    raster: &'a PlaneRaster,
    settings: &'a SnapSettings,
}

impl Snap<'_> {
    /// Both stripes go on beyond the side.
    fn runs_beyond(&self, side: usize, pair: &[End; 2]) -> bool {
        let ((across, _), offset) = (SIDES[side], self.outline.offsets_mm[side]);
        let far = self.settings.runs_beyond * EndSettings::DEFAULT.beyond_px * self.outline.mm_per_px;
        pair.iter().all(|e| e.runs_on || outward_sign(side) * (across.offset(e.at) - offset) > far)
    }

    /// The picture's edges beside the side's line; `None` if it is not known which lie inside the stripes' crossings.
    fn edges(&self, side: usize) -> Option<Vec<EdgeCandidate>> {
        let Self { frame, calibration, outline, raster, settings, .. } = *self;
        let ((across, _), offset, px) = (SIDES[side], outline.offsets_mm[side], outline.mm_per_px);
        let (sign, reach) = (outward_sign(side), settings.line_reach_px * px);
        let inner = innermost(calibration, self.face, raster, SIDES[side], px)?;
        let range = ScanRange {
            across,
            from_mm: offset - settings.scan_px * px,
            to_mm: offset + settings.scan_px * px,
            span_mm: span_mm(&outline.offsets_mm, side),
            step_mm: settings.step_px * px,
        };
        let mut edges: Vec<EdgeCandidate> = SideScan::new(frame, calibration, raster, &range)
            .candidates(TURN_PX * px, settings.edges_apart_px * px, settings.support, usize::MAX)
            .into_iter()
            .filter(|e| (e.offset_mm - offset).abs() <= reach)
            .collect();
        // The stripe that runs along the side is none, unless nothing else is.
        if edges.iter().any(|e| sign * e.offset_mm > inner) {
            edges.retain(|e| sign * e.offset_mm > inner);
        }
        Some(edges)
    }

    /// Where the edge lies that agrees best with the line and with the stripes' ends.
    fn nearest_mm(&self, side: usize, pair: &[End; 2], edges: &[EdgeCandidate], flush: bool) -> Option<f64> {
        let Self { outline, settings, .. } = *self;
        let ((across, _), offset, px) = (SIDES[side], outline.offsets_mm[side], outline.mm_per_px);
        let sigma = settings.line_sigma_px * px;
        // A stripe that ends beside the side says where, if it was seen all the way.
        let mut ends_here = Vec::with_capacity(2);
        for end in pair.iter().filter(|e| !e.runs_on) {
            let spread = (settings.end_sigma_px + settings.end_sigma_per_unseen * end.uncertainty_px) * px;
            let at = across.offset(end.at);
            if (at - offset).abs() < 3.0 * spread.hypot(sigma) {
                ends_here.push((at, spread));
            }
        }
        // What is coplanar beyond the side, or hides the stripes before it, does so to both: they speak as one, the nearer. Two that
        // disagree say nothing.
        let tolerance = EndSettings::DEFAULT.tolerance_px * px;
        let agree = matches!(ends_here[..], [(a, _), (b, _)] if (a - b).abs() <= tolerance);
        let near = |e: &EdgeCandidate| {
            let by_ends = ends_here
                .iter()
                .filter(|_| agree)
                .map(|(at, spread)| agreement(e.offset_mm - at, *spread))
                .reduce(f64::max);
            e.strength * (agreement(e.offset_mm - offset, sigma) * by_ends.unwrap_or(1.0)) as f32
        };
        let needed = if flush { settings.support_flush } else { settings.support };
        let clear = edges.iter().filter(|e| e.strength >= needed);
        clear.max_by(|x, y| near(x).total_cmp(&near(y))).map(|e| e.offset_mm)
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
