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
    /// Probability of an edge in the network's map, up to [`EvidenceWeights::most_map_edge`].
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
    /// In the order of [`EvidenceWeights::clues`].
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

impl Line {
    /// As [`Self::log_weight`], among lines that are too near each other to be different sides.
    pub fn log_weight_beside(&self, weights: &EvidenceWeights) -> f64 {
        let strength = self.strength.max(weights.least_strength_beside);
        self.log_weight(weights) + weights.strength_beside * strength.ln()
    }

    /// Logarithm of its weight among the lines of the side.
    pub fn log_weight(&self, weights: &EvidenceWeights) -> f64 {
        let log_odds = self.seen.map_or(self.log_odds, |seen| {
            weights.line_network * self.log_odds + weights.sides_network * (seen + weights.least_seen).ln()
        });
        log_odds + self.light
    }
}

/// What each kind of evidence counts, in nats a unit. Weights are fitted by maximum likelihood: each side's right line against its other lines. One
/// that is larger than fitted lets its kind of evidence decide against the others. Of limits that name no reason there is no record of how they
/// were chosen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EvidenceWeights {
    /// Of [`Clues`] beside networks, which the network of lines is told as well: 860 sides of 110 rendered boxes
    /// (`boxline render --held-out --seed 7000 --count 110`).
    clues: [f64; 11],
    /// Of [`Clues`] where there is no network (two of them are a network's): 2,728 sides of the learning seeds (`training/weights_alone.py`).
    clues_alone: [f64; 11],
    /// Of the network of lines, of the network of sides, and of the stripes' light and steps, together: rendered boxes of the learning seeds
    /// (`training/weights.py`).
    line_network: f64,
    sides_network: f64,
    /// Light goes on beyond the line on one stripe. On both it says nothing: the networks tell a flush neighbour from print.
    light_on_one: f64,
    /// Light is missing inside the line.
    light_missing: f64,
    /// The surface steps at the line ([`crate::scene::step`]).
    surface_steps: f64,
    /// Added to the probability of a place by the network of sides, so that it never rules one out. More: it rules out less.
    least_seen: f64,
    /// The network's probability of an edge counts up to this: it also draws lines of print, and surely. More: print counts more.
    most_map_edge: f32,
    /// The power to which an edge's strength speaks for the right line of several within 15 px, since a blurred or rounded edge has lines
    /// beside it that are no other edges: where 1,960 sides of the learning and choosing seeds were measured (log-likelihood a side 0.260
    /// without it, 0.301 with 3, 0.309 with 4). More: the strongest edge wins more often.
    strength_beside: f64,
    /// Least strength of which a power is taken. More: a line without an edge loses less to those beside it.
    least_strength_beside: f64,
}

impl EvidenceWeights {
    const DEFAULT: Self = Self {
        clues: [4.60, 1.30, -2.20, 1.48, -0.30, 1.24, 1.47, 1.12, -3.73, 2.25, 3.56],
        clues_alone: [5.06, 0.0, -0.83, 0.94, -0.30, 0.49, 0.64, -0.44, -2.56, 2.19, 0.0],
        line_network: 0.723,
        sides_network: 1.319,
        light_on_one: -0.043,
        light_missing: -0.312,
        surface_steps: 0.452,
        least_seen: 1e-3,
        most_map_edge: 0.4,
        strength_beside: 3.0,
        least_strength_beside: 1e-3,
    };
}

impl Default for EvidenceWeights {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Which lines of the picture are looked at, and how. Where no reason stands, there is no record of how a value was chosen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LineSettings {
    /// What all that is seen of them counts.
    pub weights: EvidenceWeights,
    /// Lines of a side that are found, and that are kept whatever the network of sides says. More: slower.
    found_lines: usize,
    kept_lines: usize,
    /// Least distance of two lines, px; edges are blurred over 2 to 3. More: the right line may be hidden by a stronger one beside it.
    lines_apart_px: f64,
    /// Least strength of a line: about the share of the side on which it is seen. More: weak edges are missed. Less: slower.
    least_strength: f32,
    /// Places to which the network of sides gives this probability are looked at as well, however weak their edge is, and if no edge of the
    /// picture is within `seen_apart_px` (some of its bins): what is no candidate cannot make another less sure. More: rivals are missed.
    likely_place: f64,
    seen_apart_px: f64,
    /// A line that is less likely than the best by this, nats, before its corners and the strip along it are looked at, is none: of 5,294
    /// sides of rendered faces, no right line was less likely by 5. More: slower.
    most_behind_best: f64,
    /// Guesses of all sides together, without a network; most stay from the second on. More: slower.
    most_guesses: usize,
    /// The adjacent sides' edges are looked at from so far to so far inside of a line and beyond it, px: from where its blur is over. A
    /// longer stretch sees weaker edges and more of what is not the side's.
    window_px: (f64, f64),
    /// A stripe's end is at a line if it is no farther, px: single ends scatter by 2 px. More: lines beside the right one have its end too.
    end_at_line_px: f64,
    /// Two ends that agree are elsewhere if they are farther, px. More: they speak against fewer wrong lines.
    end_elsewhere_px: f64,
    /// A traced end is at a line, and the outline's side is the line, within so many px: traces go by blocks of 8 rows. More: lines
    /// beside the right one pass for it.
    traced_at_line_px: f64,
    /// Evidence of a stripe is counted once in so many px. More: a stripe says less.
    place_px: f64,
    /// So many such places is the most that a point of a stripe stands for. More: few points with wide gaps decide.
    most_per_place: f64,
    /// The most that counts against a line beyond a stripe's likeliest end, nats: print hides a stripe for a while. More: dark print ends a
    /// face.
    most_lost: f64,
    /// A stripe goes on beyond a line if ending it there loses more than this, nats. More: less speaks against lines of print within the face.
    least_lost: f64,
}

impl LineSettings {
    pub const DEFAULT: Self = Self {
        weights: EvidenceWeights::DEFAULT,
        found_lines: 60,
        kept_lines: 14,
        lines_apart_px: 5.0,
        least_strength: 0.35,
        likely_place: 0.03,
        seen_apart_px: 20.0,
        most_behind_best: 6.0,
        most_guesses: 3,
        window_px: (8.0, 80.0),
        end_at_line_px: 5.0,
        end_elsewhere_px: 8.0,
        traced_at_line_px: 12.0,
        place_px: 8.0,
        most_per_place: 4.0,
        most_lost: 8.0,
        least_lost: 1.0,
    };
}

impl Default for LineSettings {
    fn default() -> Self {
        Self::DEFAULT
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
    pub settings: &'a LineSettings,
}

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
        for _ in 1..self.settings.most_guesses {
            let log_weight = |line: &Line| line.log_weight(&self.settings.weights);
            let likeliest = |lines: &Vec<Line>| {
                Some(lines.iter().max_by(|a, b| log_weight(a).total_cmp(&log_weight(b)))?.offset_mm)
            };
            let mut next_mm = offsets_mm;
            for (next_mm, lines) in next_mm.iter_mut().zip(&lines) {
                *next_mm = likeliest(lines)?;
            }
            let moved = |(a, b): (&f64, &f64)| {
                (a - b).abs() > self.settings.traced_at_line_px * self.outline.mm_per_px
            };
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
        let settings = self.settings;
        let (across, high) = SIDES[side];
        let px = self.outline.mm_per_px;
        let inner = innermost(self.calibration, self.wide, self.raster, SIDES[side], px)?;
        let span_mm = span_mm(offsets_mm, side);
        let outer = self.border_mm(side, span_mm, inner)?;
        let (from_mm, to_mm) = if high { (inner, outer) } else { (-outer, -inner) };
        let range = ScanRange { across, from_mm, to_mm, span_mm, step_mm: 0.8 * px };
        let scan = SideScan::new(self.frame, self.calibration, self.raster, &range);
        let mut found = scan.candidates(
            TURN_PX * px,
            settings.lines_apart_px * px,
            settings.least_strength,
            settings.found_lines,
        );
        if found.len() > settings.kept_lines {
            let weaker = found.split_off(settings.kept_lines);
            let likely = |e: &EdgeCandidate| {
                self.seen.is_some_and(|(axes, odds)| {
                    odds.at(side, axes.bin(side, e.offset_mm)) >= settings.likely_place
                })
            };
            found.extend(weaker.into_iter().filter(likely));
        }
        let own = offsets_mm[side];
        if found.iter().all(|e| (e.offset_mm - own).abs() > settings.lines_apart_px * px) {
            found.push(EdgeCandidate { offset_mm: own, strength: 0.0 });
        }
        if let Some((axes, odds)) = self.seen {
            for bin in odds.likely(side, settings.likely_place) {
                let offset_mm = axes.offset_mm(side, bin);
                let out_mm = outward_sign(side) * offset_mm;
                let apart = |e: &EdgeCandidate| (e.offset_mm - offset_mm).abs() > settings.seen_apart_px * px;
                if out_mm > inner && out_mm < outer && found.iter().all(apart) {
                    found.push(EdgeCandidate { offset_mm, strength: 0.0 });
                }
            }
        }
        let stripes = self.stripe_sums(side);
        let known: Vec<Clues> =
            found.iter().map(|e| self.without_corners(side, offsets_mm, &stripes, e)).collect();
        let weigh = &settings.weights;
        let clues_weights = if self.network.is_some() { &weigh.clues } else { &weigh.clues_alone };
        let best = known.iter().map(|clues| clues.log_odds(clues_weights)).fold(f64::NEG_INFINITY, f64::max);
        let likely = found
            .iter()
            .zip(&known)
            .filter(|(_, clues)| clues.log_odds(clues_weights) > best - settings.most_behind_best);
        let lines = likely.map(|(e, known)| {
            let (stop, seen) = self.corners(side, offsets_mm, e.offset_mm);
            let stripes_light = StripeLight {
                step: step::log_odds(self.calibration, self.wide, self.raster, side, e.offset_mm),
                ..self.lit.at(self.calibration, self.raster, side, e.offset_mm)
            };
            let clues = Clues { corners_stop: stop, corners_seen: seen, ..*known };
            let bin = self.seen.map(|(axes, _)| axes.bin(side, e.offset_mm));
            let mut log_odds = clues.log_odds(clues_weights);
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
            let light = weigh.light_on_one * (most - least)
                + weigh.light_missing * stripes_light.missing
                + weigh.surface_steps * stripes_light.step;
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
        let settings = self.settings;
        let (across, _) = SIDES[side];
        let (px, offset, out_mm) =
            (self.outline.mm_per_px, edge.offset_mm, outward_sign(side) * edge.offset_mm);
        let flag = |yes: bool| f64::from(u8::from(yes));
        let network = self.network.map_or(0.0, |network| {
            self.map_along(network, across, offset, span_mm(offsets_mm, side))
                .min(settings.weights.most_map_edge)
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
        let elsewhere = ends.is_some_and(|e| e.agree) && off_px > settings.end_elsewhere_px;
        let same_mm = settings.traced_at_line_px * px;
        let goes_on = |s: &StripeSum| s.end_mm - out_mm > same_mm && s.lost(out_mm) > settings.least_lost;
        let run_on = flag(stripes.iter().all(goes_on));
        let leave = stripes.iter().all(|s| (s.end_mm - out_mm).abs() < same_mm);
        let before =
            |s: &StripeSum| if s.end_mm < out_mm { s.lost(out_mm).min(settings.most_lost) } else { 0.0 };
        let ended_before = before(&stripes[0]).min(before(&stripes[1]));
        Clues {
            strength: f64::from(edge.strength),
            network: f64::from(network),
            ends_elsewhere: flag(elsewhere),
            end_here: flag(off_px <= settings.end_at_line_px),
            ended_before,
            leaves_plane: flag(leave),
            outline: flag((offset - self.outline.offsets_mm[side]).abs() <= settings.traced_at_line_px * px),
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
            let each = (spacing_px / self.settings.place_px).min(self.settings.most_per_place);
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
        let (nearest, farthest) = self.settings.window_px;
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
            inside += 0.5 * seen(-farthest, -nearest);
            beyond += 0.5 * seen(nearest, farthest);
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
