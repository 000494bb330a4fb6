//! The outlines that a face may have: the first one and those with other lines of the picture for some of its sides, each with its
//! probability. Which it is may be told by the frame, or only together with the other frame of the box.

use super::line_evidence::{Evidence, Line, LineSettings};
use crate::calibration::Calibration;
use crate::confidence::RIGHT_MM;
use crate::face::extent::FaceStripes;
use crate::face::outline::{InitialRectangle, WeightedLine};
use crate::image::Frame;
use crate::network::NetworkOutput;
use crate::scene::lit::LitLines;
use crate::sides::ViewAxes;
use crate::view::SideOdds;

/// One of the outlines.
#[derive(Clone, Debug)]
pub(crate) struct OutlineHypothesis {
    pub outline: InitialRectangle,
    /// That all four sides are right.
    pub probability: f64,
    /// The lines of both pairs of opposite sides, in the order of the raster.
    pub pairs: [Pair; 2],
}

/// Two opposite sides of an outline: which of the lines that each may be (likeliest first), and that both are right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pair {
    pub lines: [usize; 2],
    pub probability: f64,
}

/// How lines become outlines, and how sure one is. Where no reason stands, there is no record of how a value was chosen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OutlineSettings {
    /// Which lines a side may be, and what speaks for each.
    pub lines: LineSettings,
    /// Lines nearer than this are the same side, px: what lies between is decided where the edge is measured. More: rivals beside the right
    /// line are not counted.
    same_side_px: f64,
    /// That the likeliest line of a side is right, as a logistic function: a constant, and the weights of the logarithms of the odds that
    /// two judges give it who do not know each other, all evidence but the network of sides and that network, of a pixel's size on the
    /// face, mm, of what the stripes' light says, and of the logarithm of what all of it together leaves for other lines. Each judge is too
    /// sure of itself where it errs, and lines so many px apart are farther apart on a far face; fitted to 6,408 sides of rendered boxes of
    /// the learning and the choosing seeds, right where the measured side is within 5 mm (`training/weights.py`). A weight
    /// that is larger than fitted makes sides too sure that its judge is sure of.
    sure: [f64; 6],
    /// A side on which all evidence but the network of sides favours another line is no surer than this: 16 of 16 that the network saw at
    /// 0.9 or more are right, of which no more than (16 + 1) / (16 + 2) is learned (Laplace's rule of succession).
    /// More: sides on which the judges differ are too sure.
    sure_against_others: f64,
    /// The same as `sure` without a network: one judge (`training/weights_alone.py`, the learning and the choosing seeds). Larger ones do the
    /// same.
    sure_alone: [f64; 6],
    /// What is left for other lines counts from this on: no model is surer. More: clear sides are less sure.
    least_left: f64,
    /// Odds of both judges count up to these: of sides that the first calls surer than that, one in some hundred is wrong all the same.
    /// More: a judge that errs is believed more.
    most_odds: [f64; 2],
    /// Outlines that are kept. More: slower.
    most_outlines: usize,
    /// Least probability of one. More: the right one may be lost before the other frame tells which it is. Less: slower.
    least_probability: f64,
}

impl OutlineSettings {
    pub const DEFAULT: Self = Self {
        lines: LineSettings::DEFAULT,
        same_side_px: 10.0,
        sure: [-0.54, 0.19, 0.73, -1.72, 0.63, -0.52],
        sure_against_others: 17.0 / 18.0,
        sure_alone: [0.33, 0.99, 0.0, -0.92, 0.57, 0.04],
        least_left: 1e-6,
        most_odds: [150.0, 1e4],
        most_outlines: 10,
        least_probability: 0.01,
    };
}

impl Default for OutlineSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Lines of a side that are the same.
#[derive(Clone, Copy, Debug)]
struct Choice {
    offset_mm: f64,
    probability: f64,
}

/// The outlines, likeliest first. `wide` are the stripes followed as far as they go. `None` if the raster does not see the stripes.
pub(crate) fn outlines(
    frame: &Frame,
    calibration: &Calibration,
    wide: &FaceStripes,
    outline: &InitialRectangle,
    network: Option<&NetworkOutput<'_>>,
    seen: Option<&(ViewAxes, SideOdds)>,
    lit: &LitLines,
) -> Option<Vec<OutlineHypothesis>> {
    let raster = outline.raster.on(&wide.fit.plane);
    let settings = &OutlineSettings::DEFAULT;
    let evidence = Evidence {
        frame,
        calibration,
        raster: &raster,
        outline,
        network,
        wide,
        seen,
        lit,
        settings: &settings.lines,
    };
    let lines =
        if network.is_some() { evidence.of_sides(&outline.offsets_mm)? } else { evidence.settled()? };
    let mut sides = Vec::with_capacity(4);
    let mut weighted: [Vec<WeightedLine>; 4] = Default::default();
    for (lines, weighted) in lines.into_iter().zip(&mut weighted) {
        let share = softmax(&lines, |line| line.log_weight_beside(&settings.lines.weights));
        *weighted =
            lines.iter().map(|line| WeightedLine { offset_mm: line.offset_mm, share: share(line) }).collect();
        sides.push(choices(lines, outline.mm_per_px, settings));
    }
    let mut combined = vec![(1.0, [0; 4])];
    for (side, choices) in sides.iter().enumerate() {
        let longer = |(probability, chosen): &(f64, [usize; 4])| {
            let (probability, chosen) = (*probability, *chosen);
            choices.iter().enumerate().map(move |(line, choice)| {
                let mut chosen = chosen;
                chosen[side] = line;
                (probability * choice.probability, chosen)
            })
        };
        combined = combined
            .iter()
            .flat_map(longer)
            .filter(|(probability, _)| *probability >= settings.least_probability)
            .collect();
    }
    combined.sort_by(|a, b| b.0.total_cmp(&a.0));
    combined.truncate(settings.most_outlines);
    let rival = |(probability, chosen): (f64, [usize; 4])| {
        let choice = |side: usize| sides[side][chosen[side]];
        let pair = |low: usize| Pair {
            lines: [chosen[low], chosen[low + 1]],
            probability: choice(low).probability * choice(low + 1).probability,
        };
        let offsets_mm = [0, 1, 2, 3].map(|side| choice(side).offset_mm);
        OutlineHypothesis {
            outline: InitialRectangle { offsets_mm, lines: weighted.clone(), ..outline.clone() },
            probability,
            pairs: [pair(0), pair(2)],
        }
    };
    Some(combined.into_iter().map(rival).collect())
}

/// Lines that are the same side taken together, likeliest first; the likeliest of those beside each other stands for them.
fn choices(mut lines: Vec<Line>, mm_per_px: f64, settings: &OutlineSettings) -> Vec<Choice> {
    let same_mm = settings.same_side_px * mm_per_px;
    let weights = &settings.lines.weights;
    let log_weight = |line: &Line| line.log_weight(weights);
    let weight = softmax(&lines, log_weight);
    let share = softmax(&lines, |line| line.log_odds);
    lines.sort_by(|a, b| log_weight(b).total_cmp(&log_weight(a)));
    let judges = lines.first().map(|best| {
        let near = |line: &&Line| (line.offset_mm - best.offset_mm).abs() <= same_mm;
        (lines.iter().filter(near).map(share).sum::<f64>(), best.seen)
    });
    let best_light = lines.first().map_or(0.0, |best| best.light);
    let mut found = Vec::new();
    while let Some(best) = lines.first().copied() {
        let near = |l: &Line| (l.offset_mm - best.offset_mm).abs() <= same_mm;
        let sum: f64 = lines.iter().filter(|l| near(l)).map(&weight).sum();
        let beside =
            |p: &&Line, q: &&Line| p.log_weight_beside(weights).total_cmp(&q.log_weight_beside(weights));
        let offset_mm = lines.iter().filter(|l| near(l)).max_by(beside).unwrap_or(&best).offset_mm;
        lines.retain(|l| !near(l));
        found.push(Choice { offset_mm, probability: sum });
    }
    if let (Some(judges), Some(best)) = (judges, found.first().copied()) {
        // What is near enough to be right with it is in its probability: only lines farther away share what is left.
        let right = |c: &Choice| (c.offset_mm - best.offset_mm).abs() <= RIGHT_MM;
        found.retain(|c| c.offset_mm == best.offset_mm || !right(c));
        let sure = settings.surely(judges, mm_per_px, best_light, 1.0 - best.probability);
        let others: f64 = found.iter().skip(1).map(|c| c.probability).sum();
        let share = if others > 0.0 { ((1.0 - sure) / others).min(1.0) } else { 1.0 };
        found.iter_mut().skip(1).for_each(|choice| choice.probability *= share);
        found[0].probability = sure;
    }
    found.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    found
}

/// The share of each line's weight.
fn softmax<F: Fn(&Line) -> f64>(lines: &[Line], log_weight: F) -> impl Fn(&Line) -> f64 + use<F> {
    let most = lines.iter().map(&log_weight).fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = lines.iter().map(|l| (log_weight(l) - most).exp()).sum();
    move |line| (log_weight(line) - most).exp() / total
}

impl OutlineSettings {
    /// That the likeliest line is right: what the two judges say, the light, and what is left for other lines.
    fn surely(&self, (share, seen): (f64, Option<f64>), mm_per_px: f64, light: f64, left: f64) -> f64 {
        let odds = |p: f64, most: f64| (p.max(0.0) / (1.0 - p).max(0.0)).clamp(1.0 / most, most).ln();
        let [constant, by_share, by_seen, by_size, by_light, by_left] =
            if seen.is_some() { self.sure } else { self.sure_alone };
        let [most_share, most_seen] = self.most_odds;
        let judged =
            by_share * odds(share, most_share) + seen.map_or(0.0, |seen| by_seen * odds(seen, most_seen));
        let of_rest = by_size * mm_per_px.ln() + by_light * light + by_left * left.max(self.least_left).ln();
        let logit = constant + judged + of_rest;
        let most = if seen.is_some() && share < 0.5 { self.sure_against_others } else { 1.0 };
        (1.0 / (1.0 + (-logit).exp())).min(most)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn choices(lines: Vec<Line>, mm_per_px: f64) -> Vec<Choice> {
        super::choices(lines, mm_per_px, &OutlineSettings::DEFAULT)
    }

    fn line(offset_mm: f64, log_odds: f64, seen: f64) -> Line {
        Line { offset_mm, log_odds, seen: Some(seen), strength: 0.5, ..Line::default() }
    }

    #[test]
    fn a_line_that_the_network_of_sides_does_not_see_is_less_sure_and_the_others_are_not_surer_for_it() {
        let of = |seen| choices(vec![line(10.0, 8.0, seen), line(50.0, 4.0, 0.01)], 0.7);
        let (both, one) = (of(0.97), of(0.03));
        assert!(both[0].probability > 0.95 && one[0].probability < 0.9, "{both:?} {one:?}");
        for found in [both, one] {
            assert!(found.iter().map(|c| c.probability).sum::<f64>() <= 1.0 + 1e-9, "{found:?}");
        }
    }

    #[test]
    fn light_that_speaks_against_the_likeliest_line_makes_it_less_sure_or_another_likelier() {
        let of = |light| choices(vec![Line { light, ..line(10.0, 6.0, 0.9) }, line(50.0, 4.0, 0.9)], 0.5);
        let (clear, doubtful, contradicted) = (of(0.0), of(-1.0), of(-4.0));
        assert!(clear[0].probability > doubtful[0].probability + 0.01, "{clear:?} {doubtful:?}");
        assert!(doubtful[0].offset_mm == 10.0 && contradicted[0].offset_mm == 50.0, "{contradicted:?}");
    }

    #[test]
    fn two_judges_who_favour_different_lines_are_not_sure() {
        let of = |told: [f64; 2]| choices(vec![line(10.0, told[0], 0.97), line(50.0, told[1], 0.01)], 0.7);
        let (differ, agree) = (of([5.0, 8.0]), of([8.0, 5.0]));
        assert!(differ[0].offset_mm == 10.0 && agree[0].offset_mm == 10.0, "{differ:?} {agree:?}");
        // Too unsure to be measured by default, and ten times as unsure as where both favour it.
        let doubt = |found: &[Choice]| 1.0 - found[0].probability;
        let least = crate::measurement::Settings::default().least_confidence;
        assert!(doubt(&differ) > (2.0 * (1.0 - least)).max(10.0 * doubt(&agree)), "{differ:?} {agree:?}");
    }

    #[test]
    fn lines_beside_each_other_are_one_choice() {
        let line = |offset_mm, weight: f64, strength| Line {
            offset_mm,
            log_odds: weight.ln(),
            strength,
            ..Line::default()
        };
        let lines = vec![line(10.0, 5.0, 0.5), line(11.0, 4.0, 0.9), line(50.0, 4.0, 0.5)];
        let [together, alone] = [lines.clone(), lines[..1].iter().chain(&lines[2..]).copied().collect()]
            .map(|lines| choices(lines, 0.2));
        assert_eq!(together.len(), 2);
        assert_eq!(together[0].offset_mm, 11.0, "the clearer edge");
        assert!(together[0].probability > alone[0].probability + 0.02, "{together:?} {alone:?}");
        let sum: f64 = together.iter().map(|choice| choice.probability).sum();
        assert!(together[1].offset_mm == 50.0 && (sum - 1.0).abs() < 1e-9, "{together:?}");
    }
}
