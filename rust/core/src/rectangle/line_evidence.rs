//! What speaks for a straight line being a side of the face, as one number: the logarithm of its odds against the other lines of that
//! side. Neither the outline, nor the picture's edges, nor the stripes decide alone. Without a network it is the same with fewer terms.

use super::line_strip::{Place, strip};
use super::stripe_ends;
use crate::calibration::Calibration;
use crate::edges::side_scan::{EdgeCandidate, ScanRange, SideScan, TURN_PX};
use crate::face::end_outline::innermost;
use crate::face::extent::FaceStripes;
use crate::face::outline::{Across, InitialRectangle, SIDES, outward_sign, span_mm};
use crate::face::raster::PlaneRaster;
use crate::image::Frame;
use crate::network::{Channel, NetworkOutput, StripeLight};
use crate::scene::lit::LitLines;
use crate::scene::step;
use crate::sides::ViewAxes;
use crate::view::SideOdds;

/// A line that may be a side.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Line {
    pub offset_mm: f64,
    /// Logarithm of its weight among the lines of the side by all but the network of sides.
    pub log_odds: f64,
    /// Probability that the network of sides gives its place; `None` without one.
    pub seen: Option<f64>,
    /// What the stripes' light adds to both.
    pub light: f64,
    /// How strong an edge of the picture it is, 0 to 1.
    pub strength: f64,
    pub clues: Clues,
    pub stripes_light: StripeLight,
}

/// What is looked at for each line beside the networks of lines and of sides, and the stripes' light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Clues {
    /// Strength of the picture's edge, 0 to 1.
    strength: f64,
    /// Probability of an edge in the network's map, up to [`NETWORK_MOST`].
    network: f64,
    /// Both stripes end elsewhere (0 or 1); a stripe ends here.
    ends_elsewhere: f64,
    end_here: f64,
    /// What speaks for a stripe's light inside, where it ended before the line.
    ended_before: f64,
    /// Both stripes leave the plane here.
    leaves_plane: f64,
    /// It is the outline's side.
    outline: f64,
    /// Both stripes go on: a flush neighbour, whose seam is seen along the whole side, or print on the face.
    run_on: f64,
    run_on_unseen: f64,
    /// The adjacent sides' edges are seen up to it and not beyond; the network sees corners there.
    corners_stop: f64,
    corners_seen: f64,
}

impl Clues {
    /// In the order of [`CLUE_WEIGHTS`].
    pub fn values(&self) -> [f64; 11] {
        [
            self.strength,
            self.network,
            self.ends_elsewhere,
            self.end_here,
            self.ended_before,
            self.leaves_plane,
            self.outline,
            self.run_on,
            self.run_on_unseen,
            self.corners_stop,
            self.corners_seen,
        ]
    }

    fn log_odds(&self, weights: &[f64; 11]) -> f64 {
        self.values().iter().zip(weights).map(|(value, weight)| value * weight).sum()
    }
}

/// A blurred or rounded edge has lines beside it that are no other edges: what speaks for the right line of several within 15 px is the
/// edge's strength to this power as well. Fitted by maximum likelihood to where 1,960 sides of the learning and choosing seeds were measured
/// (log-likelihood a side 0.260 without it, 0.301 with 3, 0.309 with 4).
const STRENGTH_BESIDE: f64 = 3.0;
const LEAST_STRENGTH_BESIDE: f64 = 1e-3;

impl Line {
    /// As [`Self::log_weight`], among lines that are too near each other to be different sides.
    pub fn log_weight_beside(&self) -> f64 {
        self.log_weight() + STRENGTH_BESIDE * self.strength.max(LEAST_STRENGTH_BESIDE).ln()
    }

    /// Logarithm of its weight among the lines of the side.
    pub fn log_weight(&self) -> f64 {
        let log_odds = self.seen.map_or(self.log_odds, |seen| {
            LINE_NETWORK_WEIGHT * self.log_odds + SIDES_NETWORK_WEIGHT * (seen + LEAST_SEEN).ln()
        });
        log_odds + self.light
    }
}

/// All that can speak for a line.
pub(crate) struct Evidence<'a> {
    pub frame: &'a Frame,
    pub calibration: &'a Calibration,
    /// The outline's raster on the plane of the stripes.
    pub raster: &'a PlaneRaster,
    pub outline: &'a InitialRectangle,
    /// A network, if there is one.
    pub network: Option<&'a NetworkOutput<'a>>,
    /// Stripes, followed as far as they go.
    pub wide: &'a FaceStripes,
    /// What the network of sides says, if there is one.
    pub seen: Option<&'a (ViewAxes, SideOdds)>,
    pub lit: &'a LitLines,
}

/// Weights, fitted by maximum likelihood (each side's right line against its other lines) to the 860 sides of 110 rendered boxes
/// (`boxline render --held-out --seed 7000 --count 110`).
const CLUE_WEIGHTS: [f64; 11] = [4.60, 1.30, -2.20, 1.48, -0.30, 1.24, 1.47, 1.12, -3.73, 2.25, 3.56];
/// The same without any network, of 2,728 sides of the learning seeds (`training/weights_alone.py`); two clues are a network's.
const CLUE_WEIGHTS_ALONE: [f64; 11] = [5.06, 0.0, -0.83, 0.94, -0.30, 0.49, 0.64, -0.44, -2.56, 2.19, 0.0];

/// Weights of the networks of lines and of sides and of the stripes' light and steps, fitted together by maximum likelihood to the sides of rendered
/// boxes of the learning seeds (`training/weights.py`); that of the network of sides is of the probability of a place and a little, so
/// that it never rules one out. Light that goes on beyond a line on both stripes says nothing: the networks tell a flush neighbour from
/// print.
const LINE_NETWORK_WEIGHT: f64 = 0.723;
const SIDES_NETWORK_WEIGHT: f64 = 1.319;
const LEAST_SEEN: f64 = 1e-3;
const LIGHT_ON_ONE: f64 = -0.043;
const LIGHT_MISSING: f64 = -0.312;
const SURFACE_STEPS: f64 = 0.452;
/// Places that it gives this probability are looked at as well, however weak their edge is, and if no edge of the picture is within so
/// many px (some of its bins): what is no candidate cannot make another less sure.
const LIKELY_PLACE: f64 = 0.03;
const SEEN_APART_PX: f64 = 20.0;

/// The network's probability of an edge counts up to this: it also draws lines of print, and surely.
const NETWORK_MOST: f32 = 0.4;
/// A line that is less likely than the best by this before its corners and it are looked at is none: of 5,294 sides of rendered faces, no
/// right line was less likely by 5.
const MOST_BEHIND_BEST: f64 = 6.0;
/// Lines of a side that are found, that are kept whatever the network of sides says, their distance and the least share of the side on which they are seen.
const FOUND_LINES: usize = 60;
const KEPT_LINES: usize = 14;
const LINES_APART_PX: f64 = 5.0;
const LEAST_STRENGTH: f32 = 0.35;
/// Guesses of all sides together; most stay from the second on.
const MOST_GUESSES: usize = 3;
/// Stretches to both sides of a line that are looked at begin and end so far from it, px.
const WINDOW_PX: (f64, f64) = (8.0, 80.0);
/// A stripe's end and a line are at the same place or not, px: single ends scatter by 2 px, traced ones by a block of rows.
const END_AT_LINE_PX: f64 = 5.0;
const END_ELSEWHERE_PX: f64 = 8.0;
const TRACED_END_AT_LINE_PX: f64 = 12.0;
/// The outline's side is this line if it is no farther, px.
const OUTLINE_PX: f64 = 12.0;
/// Evidence of a stripe that one place of 8 px gives, and the most that counts: print hides it for a while.
const PLACE_PX: f64 = 8.0;
const MOST_PER_PLACE: f64 = 4.0;
const MOST_LOST: f64 = 8.0;
/// A stripe goes on if ending it here loses more than this.
const LEAST_LOST: f64 = 1.0;

/// A stripe outwards from the middle: places (mm) and the running sum of what speaks for its being on the plane.
struct StripeSum {
    sums: Vec<(f64, f64)>,
    /// Where the sum is largest: the likeliest end, mm, and the sum there.
    end_mm: f64,
    most: f64,
}

impl StripeSum {
    /// What is lost if it ends here.
    fn lost(&self, at_mm: f64) -> f64 {
        let here = self.sums.iter().take_while(|(at, _)| *at <= at_mm).last().map_or(0.0, |(_, sum)| *sum);
        self.most - here
    }
}

impl Evidence<'_> {
    /// Lines that may be each side, where all four are about here.
    pub fn of_sides(&self, offsets_mm: &[f64; 4]) -> Option<Vec<Vec<Line>>> {
        (0..4).map(|side| self.lines(side, offsets_mm)).collect()
    }

    /// The same where the outline is no more than a guess: how far a side goes changes what is seen of it, so the likeliest lines are the
    /// next guess, until they stay.
    pub fn settled(&self) -> Option<Vec<Vec<Line>>> {
        let mut offsets_mm = self.outline.offsets_mm;
        let mut lines = self.of_sides(&offsets_mm)?;
        for _ in 1..MOST_GUESSES {
            let likeliest = |lines: &Vec<Line>| {
                Some(lines.iter().max_by(|a, b| a.log_weight().total_cmp(&b.log_weight()))?.offset_mm)
            };
            let mut next_mm = offsets_mm;
            for (next_mm, lines) in next_mm.iter_mut().zip(&lines) {
                *next_mm = likeliest(lines)?;
            }
            let moved = |(a, b): (&f64, &f64)| (a - b).abs() > OUTLINE_PX * self.outline.mm_per_px;
            if !next_mm.iter().zip(&offsets_mm).any(moved) {
                break;
            }
            offsets_mm = next_mm;
            lines = self.of_sides(&offsets_mm)?;
        }
        Some(lines)
    }

    /// Lines that may be a side, in no order; `offsets_mm` are all four sides as they are known.
    pub fn lines(&self, side: usize, offsets_mm: &[f64; 4]) -> Option<Vec<Line>> {
        let (across, high) = SIDES[side];
        let px = self.outline.mm_per_px;
        let inner = innermost(self.calibration, self.wide, self.raster, SIDES[side], px)?;
        let span_mm = span_mm(offsets_mm, side);
        let outer = self.border_mm(side, span_mm, inner)?;
        let (from_mm, to_mm) = if high { (inner, outer) } else { (-outer, -inner) };
        let range = ScanRange { across, from_mm, to_mm, span_mm, step_mm: 0.8 * px };
        let scan = SideScan::new(self.frame, self.calibration, self.raster, &range);
        let mut found = scan.candidates(TURN_PX * px, LINES_APART_PX * px, LEAST_STRENGTH, FOUND_LINES);
        if found.len() > KEPT_LINES {
            let weaker = found.split_off(KEPT_LINES);
            let likely = |e: &EdgeCandidate| {
                self.seen
                    .is_some_and(|(axes, odds)| odds.at(side, axes.bin(side, e.offset_mm)) >= LIKELY_PLACE)
            };
            found.extend(weaker.into_iter().filter(likely));
        }
        let own = offsets_mm[side];
        if found.iter().all(|e| (e.offset_mm - own).abs() > LINES_APART_PX * px) {
            found.push(EdgeCandidate { offset_mm: own, strength: 0.0 });
        }
        if let Some((axes, odds)) = self.seen {
            for bin in odds.likely(side, LIKELY_PLACE) {
                let offset_mm = axes.offset_mm(side, bin);
                let out_mm = outward_sign(side) * offset_mm;
                let apart = |e: &EdgeCandidate| (e.offset_mm - offset_mm).abs() > SEEN_APART_PX * px;
                if out_mm > inner && out_mm < outer && found.iter().all(apart) {
                    found.push(EdgeCandidate { offset_mm, strength: 0.0 });
                }
            }
        }
        let stripes = self.stripe_sums(side);
        let known: Vec<Clues> =
            found.iter().map(|e| self.without_corners(side, offsets_mm, &stripes, e)).collect();
        let weights = if self.network.is_some() { &CLUE_WEIGHTS } else { &CLUE_WEIGHTS_ALONE };
        let best = known.iter().map(|clues| clues.log_odds(weights)).fold(f64::NEG_INFINITY, f64::max);
        let likely =
            found.iter().zip(&known).filter(|(_, clues)| clues.log_odds(weights) > best - MOST_BEHIND_BEST);
        let lines = likely.map(|(e, known)| {
            let (stop, seen) = self.corners(side, offsets_mm, e.offset_mm);
            let stripes_light = StripeLight {
                step: step::log_odds(self.calibration, self.wide, self.raster, side, e.offset_mm),
                ..self.lit.at(self.calibration, self.raster, side, e.offset_mm)
            };
            let clues = Clues { corners_stop: stop, corners_seen: seen, ..*known };
            let bin = self.seen.map(|(axes, _)| axes.bin(side, e.offset_mm));
            let mut log_odds = clues.log_odds(weights);
            if let Some(network) = self.network {
                let place = Place {
                    side,
                    light: stripes_light,
                    offset_mm: e.offset_mm,
                    span_mm,
                    mm_per_px: px,
                    away_px: outward_sign(side) * (e.offset_mm - own) / px,
                    strength: e.strength,
                    log_odds: log_odds as f32,
                    bin,
                };
                log_odds = network.line_log_odds(&strip(
                    self.frame,
                    self.calibration,
                    self.raster,
                    &network.maps,
                    &place,
                )?);
            }
            let seen = self.seen.zip(bin).map(|((_, odds), bin)| odds.at(side, bin));
            let [least, most] = stripes_light.beyond;
            let light = LIGHT_ON_ONE * (most - least)
                + LIGHT_MISSING * stripes_light.missing
                + SURFACE_STEPS * stripes_light.step;
            Some(Line {
                offset_mm: e.offset_mm,
                log_odds,
                seen,
                light,
                strength: f64::from(e.strength),
                clues,
                stripes_light,
            })
        });
        lines.collect()
    }

    /// How far out the middle of a side stays in the image, mm.
    fn border_mm(&self, side: usize, span: (f64, f64), inner: f64) -> Option<f64> {
        const STEP_PX: f64 = 10.0;
        const MOST_STEPS: u32 = 400;
        let (right, bottom) = (self.frame.width_px() as f64, self.frame.height_px() as f64);
        let middle = 0.5 * (span.0 + span.1);
        let mut outer = inner;
        for n in 1..MOST_STEPS {
            let at = inner + f64::from(n) * STEP_PX * self.outline.mm_per_px;
            let p = self.raster.pixel(self.calibration, SIDES[side].0.at(outward_sign(side) * at, middle))?;
            if !(p.u > 0.0 && p.v > 0.0 && p.u < right && p.v < bottom) {
                break;
            }
            outer = at;
        }
        Some(outer)
    }

    /// All but what the corners and a look at the line say.
    fn without_corners(
        &self,
        side: usize,
        offsets_mm: &[f64; 4],
        stripes: &[StripeSum; 2],
        edge: &EdgeCandidate,
    ) -> Clues {
        let (across, _) = SIDES[side];
        let (px, offset, out_mm) =
            (self.outline.mm_per_px, edge.offset_mm, outward_sign(side) * edge.offset_mm);
        let flag = |log_odds: bool| f64::from(u8::from(log_odds));
        let network = self.network.map_or(0.0, |network| {
            self.map_along(network, across, offset, span_mm(offsets_mm, side)).min(NETWORK_MOST)
        });
        let ends = stripe_ends::find(
            self.frame,
            self.calibration,
            self.raster,
            offset,
            side,
            self.wide.half_width_px,
        );
        let off_px = ends.map_or(f64::INFINITY, |e| (e.outwards_mm / e.mm_per_px).abs());
        let elsewhere = ends.is_some_and(|e| e.agree) && off_px > END_ELSEWHERE_PX;
        let same_mm = TRACED_END_AT_LINE_PX * px;
        let goes_on = |s: &StripeSum| s.end_mm - out_mm > same_mm && s.lost(out_mm) > LEAST_LOST;
        let run_on = flag(stripes.iter().all(goes_on));
        let leave = stripes.iter().all(|s| (s.end_mm - out_mm).abs() < same_mm);
        let before = |s: &StripeSum| if s.end_mm < out_mm { s.lost(out_mm).min(MOST_LOST) } else { 0.0 };
        let ended_before = before(&stripes[0]).min(before(&stripes[1]));
        Clues {
            strength: f64::from(edge.strength),
            network: f64::from(network),
            ends_elsewhere: flag(elsewhere),
            end_here: flag(off_px <= END_AT_LINE_PX),
            ended_before,
            leaves_plane: flag(leave),
            outline: flag((offset - self.outline.offsets_mm[side]).abs() <= OUTLINE_PX * px),
            run_on,
            run_on_unseen: run_on * (1.0 - f64::from(edge.strength)),
            ..Clues::default()
        }
    }

    /// Mean probability of the face's edge in the maps along a line, the best within a pixel of the map.
    fn map_along(&self, network: &NetworkOutput, across: Across, offset: f64, span: (f64, f64)) -> f32 {
        const SAMPLES: u32 = 48;
        let unit = network.maps.px_per_raster_px() * self.outline.mm_per_px;
        let mean = |offset: f64| {
            let value = |n: u32| {
                let along = span.0 + (span.1 - span.0) * (f64::from(n) + 0.5) / f64::from(SAMPLES);
                let px = self.raster.pixel(self.calibration, across.at(offset, along));
                px.map_or(0.0, |px| network.maps.at(Channel::FaceEdge, px))
            };
            (0..SAMPLES).map(value).sum::<f32>() / SAMPLES as f32
        };
        [-1.0, 0.0, 1.0].map(|k| mean(offset + k * unit)).into_iter().fold(0.0, f32::max)
    }

    /// Both stripes of a side.
    fn stripe_sums(&self, side: usize) -> [StripeSum; 2] {
        let (across, _) = SIDES[side];
        across.stripes().map(|id| {
            let stripe = &self.wide.stripes[id.index()];
            let mut places: Vec<(f64, f64)> = stripe
                .points
                .iter()
                .zip(&stripe.on_plane_score)
                .filter_map(|(point, score)| {
                    let at = self.raster.on_plane(self.calibration, point.predicted)?;
                    Some((outward_sign(side) * across.offset(at), *score))
                })
                .filter(|(at, _)| *at >= 0.0)
                .collect();
            places.sort_by(|x, y| x.0.total_cmp(&y.0));
            let length_mm = places.last().map_or(0.0, |l| l.0) - places.first().map_or(0.0, |f| f.0);
            let spacing_px =
                length_mm / self.outline.mm_per_px / places.len().saturating_sub(1).max(1) as f64;
            let each = (spacing_px / PLACE_PX).min(MOST_PER_PLACE);
            let mut result = StripeSum { sums: Vec::with_capacity(places.len()), end_mm: 0.0, most: 0.0 };
            let mut sum = 0.0;
            for (at, score) in places {
                sum += score * each;
                result.sums.push((at, sum));
                if sum > result.most {
                    (result.most, result.end_mm) = (sum, at);
                }
            }
            result
        })
    }

    /// Whether the edges of the two adjacent sides are seen up to a line and not beyond, and the network's probability of a corner
    /// where they meet it; means of both, 0 to 1.
    fn corners(&self, side: usize, offsets_mm: &[f64; 4], offset: f64) -> (f64, f64) {
        let px = self.outline.mm_per_px;
        let (mut inside, mut beyond, mut corner) = (0.0, 0.0, 0.0);
        for other in if side < 2 { [2, 3] } else { [0, 1] } {
            let (across, place) = (SIDES[other].0, offsets_mm[other]);
            let seen = |from_px: f64, to_px: f64| {
                let (p, q) =
                    (offset + outward_sign(side) * from_px * px, offset + outward_sign(side) * to_px * px);
                let range = ScanRange {
                    across,
                    from_mm: place - 14.0 * px,
                    to_mm: place + 14.0 * px,
                    span_mm: (p.min(q), p.max(q)),
                    step_mm: 0.8 * px,
                };
                let scan = SideScan::new(self.frame, self.calibration, self.raster, &range);
                let found = scan.candidates(2.0 * px, 3.0 * px, 0.1, 8);
                let near = found.iter().filter(|e| (e.offset_mm - place).abs() < 6.0 * px);
                near.map(|e| f64::from(e.strength)).fold(0.0, f64::max)
            };
            inside += 0.5 * seen(-WINDOW_PX.1, -WINDOW_PX.0);
            beyond += 0.5 * seen(WINDOW_PX.0, WINDOW_PX.1);
            let Some(maps) = self.network.map(|network| &network.maps) else { continue };
            let unit = maps.px_per_raster_px() * px;
            let mut best = 0f32;
            for (i, j) in (-1..=1).flat_map(|i| (-1..=1).map(move |j| (i, j))) {
                let at = SIDES[side].0.at(offset + f64::from(i) * unit, place + f64::from(j) * unit);
                if let Some(px) = self.raster.pixel(self.calibration, at) {
                    best = best.max(maps.at(Channel::Corner, px));
                }
            }
            corner += 0.5 * f64::from(best);
        }
        (inside * (1.0 - beyond), corner)
    }
}
