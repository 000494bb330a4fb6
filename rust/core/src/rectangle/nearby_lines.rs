//! Lines beside a measured side that pull at it: the two roundings of an edge, a seam's two flanks, a line of print just inside. What they
//! may take it off by is in its sigma.

use super::refine::FittedRectangle;
use crate::confidence::RIGHT_MM;
use crate::face::outline::{InitialRectangle, SIDES, WeightedLine, outward_sign, span_mm};
use crate::warning::{Warning, WarningKind};

/// Which lines pull at a measured side, and by how much.
#[derive(Clone, Copy, Debug)]
struct NearbySettings {
    /// Lines no farther from a measured side than both of these pull at it, px and mm, and all within [`RIGHT_MM`], along any of which it
    /// counts as right. More takes another candidate for a line of this side and makes its sigma larger.
    reach_px: f64,
    reach_mm: f64,
    /// An edge of the picture has weaker ones beside it up to so far away, px: its blur, both ends of its rounding. More takes another line,
    /// which may be the side as its share says, for a part of this edge.
    same_edge_px: f64,
    /// They seldom are the side, and their mean distance times this is in its sigma. Of 654 sides of the learning and choosing seeds all are
    /// within 4 sigmas for it, and 97.6 % in the interval of 95 %; the logarithm of the likelihood is higher by 9 than with this share for all
    /// lines and none beyond 15 px. More makes intervals too wide.
    same_edge_share: f64,
    /// Lines nearer than this are one, px. More misses a second line close to the measured one.
    same_line_px: f64,
    /// A line that has this share of the weight of all that are near speaks ten to one against the line that was measured. More keeps silent
    /// on sides that lie on the wrong line.
    double_share: f64,
}

impl NearbySettings {
    const DEFAULT: Self = Self {
        reach_px: 15.0,
        reach_mm: 8.0,
        same_edge_px: 7.0,
        same_edge_share: 0.4,
        same_line_px: 4.0,
        double_share: 0.9,
    };
}

impl Default for NearbySettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

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
        let lines = &initial.lines[side];
        Self::beside(here_mm, outward_sign(side), lines, initial.mm_per_px, &NearbySettings::DEFAULT)
    }

    /// Of the lines of a side that was measured here.
    fn beside(
        here_mm: f64,
        outward_sign: f64,
        lines: &[WeightedLine],
        mm_per_px: f64,
        settings: &NearbySettings,
    ) -> Self {
        let off_mm = |line: &WeightedLine| (line.offset_mm - here_mm).abs();
        let reach_mm = (settings.reach_px * mm_per_px).clamp(RIGHT_MM, settings.reach_mm);
        let near: Vec<&WeightedLine> = lines.iter().filter(|line| off_mm(line) <= reach_mm).collect();
        let total: f64 = near.iter().map(|line| line.share).sum();
        if total <= 0.0 {
            let nearest = lines.iter().map(off_mm).min_by(f64::total_cmp);
            return Self { sigma_mm: settings.same_edge_share * nearest.unwrap_or(0.0), other: None };
        }
        let pull_mm = |line: &WeightedLine| {
            let same_edge = off_mm(line) <= settings.same_edge_px * mm_per_px;
            off_mm(line) * if same_edge { settings.same_edge_share } else { 1.0 }
        };
        let variance: f64 = near.iter().map(|line| line.share / total * pull_mm(line).powi(2)).sum();
        let other = near.iter().filter(|line| off_mm(line) > settings.same_line_px * mm_per_px);
        let other = other
            .max_by(|a, b| a.share.total_cmp(&b.share))
            .map(|line| (outward_sign * (line.offset_mm - here_mm), line.share / total));
        Self { sigma_mm: variance.sqrt(), other: other.filter(|(_, share)| *share >= settings.double_share) }
    }

    /// Of the side whose other line is the likeliest.
    pub fn warning(sides: &[Self; 4]) -> Option<Warning> {
        let doubled = sides.iter().filter_map(|nearby| Some((nearby.sigma_mm, nearby.other?)));
        let (sigma, (found, share)) = doubled.max_by(|(_, (_, a)), (_, (_, b))| a.total_cmp(b))?;
        let kind = WarningKind::EdgeDouble;
        Some(Warning {
            kind,
            laser: None,
            found,
            sigma,
            chi_square: share,
            limit: NearbySettings::DEFAULT.double_share,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A face of which a pixel is 0.15 mm: a line 4.5 mm beside the measured one counts as right, so that sigma has to know of it, as it does
    /// not of one 8 mm away, which is another candidate.
    #[test]
    fn what_counts_as_right_is_in_sigma() {
        let settings = NearbySettings::default();
        let of = |other_mm: f64| {
            let line = |offset_mm, share| WeightedLine { offset_mm, share };
            NearbyLines::beside(100.0, 1.0, &[line(100.0, 0.8), line(100.0 + other_mm, 0.2)], 0.15, &settings)
        };
        assert!(
            (of(4.5).sigma_mm - 4.5 * 0.2f64.sqrt()).abs() < 1e-9,
            "a line by itself: {}",
            of(4.5).sigma_mm
        );
        let blurred = of(0.9).sigma_mm;
        assert!(
            (blurred - settings.same_edge_share * 0.9 * 0.2f64.sqrt()).abs() < 1e-9,
            "beside an edge: {blurred}"
        );
        assert!(of(8.0).sigma_mm == 0.0);
    }
}
