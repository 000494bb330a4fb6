//! Lines beside a measured side that pull at it: the two roundings of an edge, a seam's two flanks, a line of print just inside. What they
//! may take it off by is in its sigma.

use super::refine::FittedRectangle;
use crate::confidence::RIGHT_MM;
use crate::face::outline::{InitialRectangle, SIDES, WeightedLine, outward_sign, span_mm};
use crate::warning::{Warning, WarningKind};

/// Lines that are no farther from a measured side pull at it, px and mm; it counts as right along any that is within [`RIGHT_MM`].
const NEARBY_PX: f64 = 15.0;
const NEARBY_MM: f64 = 8.0;
/// An edge of the picture has weaker ones beside it up to so far away, px: its blur, both ends of its rounding. They seldom are the side,
/// and their mean distance times this is in its sigma; a line farther away is another one, which may be the side as its share says. Of
/// 654 sides of the learning and choosing seeds all are within 4 sigmas for it, and 97.6 % in the interval of 95 %; the logarithm of the
/// likelihood is higher by 9 than with this share for all of them and none beyond 15 px.
const SAME_EDGE_PX: f64 = 7.0;
const SAME_EDGE_SHARE: f64 = 0.4;

/// Lines nearer than this are one, px ...
const SAME_LINE_PX: f64 = 4.0;
/// ... and one that has this share of the weight of all that are near speaks ten to one against the line that was measured.
const LEAST_OF_DOUBLE: f64 = 0.9;

/// The lines that pull at a measured side: the two roundings of an edge, a seam's two flanks, a line of print just inside.
pub(super) struct NearbyLines {
    /// How far the side may be off because one of them is it, 1 sigma, mm.
    pub sigma_mm: f64,
    /// The one that is likeliest to be it instead: how far outwards it lies, mm, and its share of the weight.
    other: Option<(f64, f64)>,
}

impl NearbyLines {
    pub fn of(fit: &FittedRectangle, initial: &InitialRectangle, side: usize) -> Self {
        let across = SIDES[side].0;
        let (from, to) = span_mm(&fit.offsets_mm, side);
        let middle = fit.raster.cam_point(across.at(fit.offsets_mm[side], 0.5 * (from + to)));
        let here_mm = across.offset(initial.raster.of_cam(&middle));
        Self::beside(here_mm, outward_sign(side), &initial.lines[side], initial.mm_per_px)
    }

    /// Of the lines of a side that was measured here.
    fn beside(here_mm: f64, outward_sign: f64, lines: &[WeightedLine], mm_per_px: f64) -> Self {
        let off_mm = |line: &WeightedLine| (line.offset_mm - here_mm).abs();
        let reach_mm = (NEARBY_PX * mm_per_px).clamp(RIGHT_MM, NEARBY_MM);
        let near: Vec<&WeightedLine> = lines.iter().filter(|line| off_mm(line) <= reach_mm).collect();
        let total: f64 = near.iter().map(|line| line.share).sum();
        if total <= 0.0 {
            let nearest = lines.iter().map(off_mm).min_by(f64::total_cmp);
            return Self { sigma_mm: SAME_EDGE_SHARE * nearest.unwrap_or(0.0), other: None };
        }
        let pull_mm = |line: &WeightedLine| {
            let same_edge = off_mm(line) <= SAME_EDGE_PX * mm_per_px;
            off_mm(line) * if same_edge { SAME_EDGE_SHARE } else { 1.0 }
        };
        let variance: f64 = near.iter().map(|line| line.share / total * pull_mm(line).powi(2)).sum();
        let other = near.iter().filter(|line| off_mm(line) > SAME_LINE_PX * mm_per_px);
        let other = other
            .max_by(|a, b| a.share.total_cmp(&b.share))
            .map(|line| (outward_sign * (line.offset_mm - here_mm), line.share / total));
        Self { sigma_mm: variance.sqrt(), other: other.filter(|(_, share)| *share >= LEAST_OF_DOUBLE) }
    }

    /// Of the side whose other line is the likeliest.
    pub fn warning(sides: &[Self; 4]) -> Option<Warning> {
        let doubled = sides.iter().filter_map(|nearby| Some((nearby.sigma_mm, nearby.other?)));
        let (sigma, (found, share)) = doubled.max_by(|(_, (_, a)), (_, (_, b))| a.total_cmp(b))?;
        let kind = WarningKind::EdgeDouble;
        Some(Warning { kind, laser: None, found, sigma, chi_square: share, limit: LEAST_OF_DOUBLE })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A face of which a pixel is 0.15 mm: a line 4.5 mm beside the measured one counts as right, so that sigma has to know of it, as it does
    /// not of one 8 mm away, which is another candidate.
    #[test]
    fn what_counts_as_right_is_in_sigma() {
        let of = |other_mm: f64| {
            let line = |offset_mm, share| WeightedLine { offset_mm, share };
            NearbyLines::beside(100.0, 1.0, &[line(100.0, 0.8), line(100.0 + other_mm, 0.2)], 0.15)
        };
        assert!(
            (of(4.5).sigma_mm - 4.5 * 0.2f64.sqrt()).abs() < 1e-9,
            "a line by itself: {}",
            of(4.5).sigma_mm
        );
        let blurred = of(0.9).sigma_mm;
        assert!((blurred - SAME_EDGE_SHARE * 0.9 * 0.2f64.sqrt()).abs() < 1e-9, "beside an edge: {blurred}");
        assert!(of(8.0).sigma_mm == 0.0);
    }
}
