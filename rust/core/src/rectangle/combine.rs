//! Which of the sides' candidates form the rectangle: every combination is judged by the image edges along all four sides.

use super::hypothesize::Which;
use crate::calibration::Calibration;
use crate::edges::side_scan::{ScanRange, SideScan};
use crate::face::outline::{RoughRectangle, SIDES, span_mm};
use crate::face::raster::{OnPlane, PlaneRaster};
use crate::image::Frame;
use crate::units::Px;
use std::collections::BTreeMap;

/// An edge seen on this share of a side at the stripes' ends is the face's; worth more than all supports together.
pub(super) const CLEAR_SUPPORT: f32 = 0.6;
const SETTLED_WORTH: f64 = 10.0;
/// Two candidates are one if they are closer than this, px.
pub(super) const APART_PX: f64 = 4.0;
/// Candidates kept per side.
pub(super) const KEEP: usize = 4;
/// Sides that end this near to each other are seen alike: of 16 segments less than half of one is another.
const SAME_END_PX: f64 = 12.0;
/// A side may be turned against the raster by this much from end to end, px.
pub(super) const DRIFT_PX: f64 = 8.0;

#[derive(Clone, Copy, Debug)]
pub(super) struct Side {
    /// Where it lies, mm.
    pub offset_mm: f64,
    /// Whether the stripes end there.
    pub at_end: bool,
    /// Share of the side on which the image must show an edge.
    pub needed: f32,
    /// Strength of the edge, less the farther it is from the stripes' ends.
    pub nearness: f32,
}

/// The best combination of sides by the image edges along their whole length, and the alternatives if they are wanted.
pub(super) fn choose(
    frame: &Frame,
    calibration: &Calibration,
    raster: &PlaneRaster,
    sides: &[Vec<Side>],
    mm_per_px: f64,
    known: Known,
) -> Vec<RoughRectangle> {
    let by_ends = known != Known::Outline;
    let (known_yet, least) = (BTreeMap::new(), [1.0; 4]);
    let mut judge = Judge { frame, calibration, raster, sides, mm_per_px, by_ends, known: known_yet, least };
    let mut combinations: Vec<[usize; 4]> = Vec::new();
    let counts = [0, 1, 2, 3].map(|s| sides[s].len().min(KEEP));
    for i in 0..counts[0] {
        for j in 0..counts[1] {
            for k in 0..counts[2] {
                combinations.extend((0..counts[3]).map(|l| [i, j, k, l]));
            }
        }
    }
    // The rectangle of the stripes' ends first; others only if the image contradicts it.
    combinations.sort_by_key(|c| c.iter().sum::<usize>());
    let mut best: Option<(f64, [usize; 4], RoughRectangle)> = None;
    for combination in combinations {
        let beaten = best.as_ref().map_or(f64::NEG_INFINITY, |(score, _, _)| *score);
        let Some(Verdict { score, clear, rough }) = judge.verdict(combination, beaten) else { continue };
        if score > beaten {
            let certain = combination == [0; 4] && rough.at_ends == [true; 4] && clear;
            best = Some((score, combination, rough));
            if certain {
                break;
            }
        }
    }
    let Some((_, chosen, rough)) = best else { return Vec::new() };
    let mut result = vec![rough];
    if known == Known::Ends(Which::WithAlternatives) {
        let mut others = Vec::new();
        for side in 0..4 {
            for (index, _) in sides[side].iter().enumerate().filter(|(_, s)| !s.at_end) {
                let mut combination = chosen;
                combination[side] = index;
                if combination != chosen {
                    others.extend(judge.verdict(combination, f64::NEG_INFINITY));
                }
            }
        }
        others.sort_by(|a, b| b.score.total_cmp(&a.score));
        result.extend(others.into_iter().map(|o| o.rough));
    }
    result
}

/// What is known of the sides before the image's edges are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Known {
    /// Where the stripes end.
    Ends(Which),
    /// The outline in a network's maps: how far a line lies from that counts.
    Outline,
}

/// What the image says of one combination of sides.
struct Verdict {
    score: f64,
    /// Every side is clearly seen.
    clear: bool,
    rough: RoughRectangle,
}

/// Judges combinations; what was looked at once is kept.
struct Judge<'a> {
    frame: &'a Frame,
    calibration: &'a Calibration,
    raster: &'a PlaneRaster,
    sides: &'a [Vec<Side>],
    mm_per_px: f64,
    by_ends: bool,
    known: BTreeMap<(usize, usize, usize, usize), f32>,
    /// The least support of each side so far.
    least: [f32; 4],
}

impl Judge<'_> {
    /// The first candidate of a side that ends others where this one does.
    fn alike(&self, side: usize, choice: usize) -> usize {
        let near = |s: &Side| {
            (s.offset_mm - self.sides[side][choice].offset_mm).abs() < SAME_END_PX * self.mm_per_px
        };
        self.sides[side][..choice].iter().position(near).unwrap_or(choice)
    }

    /// `None` if a corner is outside the image, a side is not seen, or the score cannot be more than `beaten`.
    fn verdict(&mut self, combination: [usize; 4], beaten: f64) -> Option<Verdict> {
        let (frame, calibration, raster, mm_per_px) =
            (self.frame, self.calibration, self.raster, self.mm_per_px);
        let right = frame.width_px() as f64 - 0.5;
        let bottom = frame.height_px() as f64 - 0.5;
        let inside = |p: Px| p.u > -0.5 && p.v > -0.5 && p.u < right && p.v < bottom;
        let chosen = [0, 1, 2, 3].map(|s| self.sides[s][combination[s]]);
        let offsets_mm = chosen.map(|s| s.offset_mm);
        let corners = [(0, 2), (1, 2), (1, 3), (0, 3)]
            .map(|(a, b)| raster.pixel(calibration, OnPlane::new(offsets_mm[a], offsets_mm[b])));
        if !corners.iter().all(|c| c.is_some_and(inside)) {
            return None;
        }
        let by_ends = self.by_ends;
        let score = |support: [f32; 4]| {
            if by_ends {
                // Where the stripes end and an edge is seen, that edge is the face's: other lines count only elsewhere.
                let seen = support.iter().zip(&chosen);
                let settled = seen.clone().filter(|(s, c)| c.at_end && **s >= CLEAR_SUPPORT).count();
                SETTLED_WORTH * settled as f64 + seen.map(|(s, c)| f64::from(s + c.nearness)).sum::<f64>()
            } else {
                chosen.iter().map(|c| f64::from(c.nearness.max(1e-6)).ln()).sum()
            }
        };
        // A side's support depends on its own place and on the two sides that end it.
        let ends = |side: usize| if side < 2 { [2, 3] } else { [0, 1] };
        let key = |side: usize| {
            let [first, last] = ends(side).map(|end| self.alike(end, combination[end]));
            (side, combination[side], first, last)
        };
        // Scanning is what takes time: sides that are known come first, then those that were seen least, and none when the best
        // cannot be beaten.
        let mut order = [0, 1, 2, 3];
        order.sort_by(|a, b| {
            let rank =
                |side: usize| if self.known.contains_key(&key(side)) { -1.0 } else { self.least[side] };
            rank(*a).total_cmp(&rank(*b))
        });
        let keys = [0, 1, 2, 3].map(key);
        let mut support = [1.0; 4];
        for side in order {
            if score(support) <= beaten {
                return None;
            }
            let (_, _, first, last) = keys[side];
            let mut spanned_mm = offsets_mm;
            for (end, choice) in ends(side).into_iter().zip([first, last]) {
                spanned_mm[end] = self.sides[end][choice].offset_mm;
            }
            let seen = *self
                .known
                .entry(keys[side])
                .or_insert_with(|| support_of(frame, calibration, raster, &spanned_mm, side, mm_per_px));
            self.least[side] = self.least[side].min(seen);
            support[side] = seen;
            if seen < chosen[side].needed {
                return None;
            }
        }
        Some(Verdict {
            score: score(support),
            clear: support.iter().all(|s| *s >= CLEAR_SUPPORT),
            rough: RoughRectangle {
                lines: Default::default(),
                raster: *raster,
                offsets_mm,
                at_ends: chosen.map(|s| s.at_end),
                mm_per_px,
            },
        })
    }
}

/// Share of a side on which an image edge is seen, 0 to 1.
fn support_of(
    frame: &Frame,
    calibration: &Calibration,
    raster: &PlaneRaster,
    offsets_mm: &[f64; 4],
    side: usize,
    mm_per_px: f64,
) -> f32 {
    let span = span_mm(offsets_mm, side);
    let margin = 0.03 * (span.1 - span.0);
    let window = 40.0 * mm_per_px;
    let scan = SideScan::new(
        frame,
        calibration,
        raster,
        &ScanRange {
            across: SIDES[side].0,
            from_mm: offsets_mm[side] - window,
            to_mm: offsets_mm[side] + window,
            span_mm: (span.0 + margin, span.1 - margin),
            step_mm: 0.8 * mm_per_px,
        },
    );
    scan.candidates(DRIFT_PX * mm_per_px, APART_PX * mm_per_px, 0.1, 8)
        .iter()
        .filter(|e| (e.offset_mm - offsets_mm[side]).abs() <= 8.0 * mm_per_px)
        .map(|e| e.strength)
        .fold(0.0, f32::max)
}
