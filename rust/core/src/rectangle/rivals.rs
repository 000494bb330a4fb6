//! The outlines that a face may have: the network's and those with other lines of the picture for some of its sides, each with its
//! probability. Which it is may be told by the frame, or only together with the other frame of the box.

use super::line_evidence::{Evidence, Line};
use crate::calibration::Calibration;
use crate::face::extent::FaceStripes;
use crate::face::map_outline::MapOutline;
use crate::image::Frame;
use crate::network::Asked;
use crate::sides::ViewAxes;
use crate::view::SideOdds;

/// One of the outlines.
#[derive(Clone, Debug)]
pub(crate) struct Rival {
    pub outline: MapOutline,
    /// That all four sides are right.
    pub probability: f64,
}

/// Lines nearer than this are the same side, px: what lies between is decided where the edge is measured.
const SAME_PX: f64 = 10.0;
/// That the likeliest line of a side is right, as a logistic function: a constant, and the weights of the logarithms of the odds that
/// two judges give it who do not know each other, all evidence but the network of sides and that network, and of a pixel's size on the
/// face, mm. Each is too sure of itself where it errs, and lines so many px apart are farther apart on a far face; fitted to 2,168 sides
/// of rendered boxes of the learning and the choosing seeds (`training/weights.py`).
const SURE: [f64; 4] = [-0.17, 0.53, 0.80, -0.97];
/// ... but no more than this where the two favour different lines of a side: of 41 such sides 10 are wrong, however sure either is.
const DISAGREE: f64 = 0.76;
/// Lines that are no farther from one pull at it where it is measured, px and mm; this share of their scatter is in
/// its sigma. Chosen on 278 boxes of the learning and choosing seeds: the mean (error/sigma)^2 of right sides up to 400 mm is 0.5 to 0.6
/// with 0.6, and 0.6 to 0.9 with this.
const BESIDE_PX: f64 = 15.0;
const BESIDE_MM: f64 = 8.0;
const SPREAD: f64 = 0.35;
/// Odds of both count up to these: of sides that the first calls surer than that, one in some hundred is wrong all the same.
const MOST_ODDS: [f64; 2] = [150.0, 1e4];
/// Outlines that are kept, and the least probability of one.
const MOST: usize = 10;
const LEAST: f64 = 0.01;

/// One line of a side with all that belong to it.
#[derive(Clone, Copy, Debug)]
struct Choice {
    offset_mm: f64,
    probability: f64,
    /// As [`MapOutline::spread_mm`].
    spread_mm: f64,
}

/// The outlines, likeliest first. `wide` are the stripes followed as far as they go. `None` if the raster does not see the stripes.
pub(crate) fn rivals(
    frame: &Frame,
    calibration: &Calibration,
    wide: &FaceStripes,
    outline: &MapOutline,
    asked: &Asked<'_>,
    seen: Option<&(ViewAxes, SideOdds)>,
) -> Option<Vec<Rival>> {
    let raster = outline.raster.on(&wide.fit.plane);
    let evidence = Evidence { frame, calibration, raster: &raster, outline, asked, wide, seen };
    let mut sides = Vec::with_capacity(4);
    for side in 0..4 {
        let lines = evidence.lines(side, &outline.offsets_mm)?;
        sides.push(choices(lines, outline.offsets_mm[side], outline.mm_per_px));
    }
    let mut combined = vec![(1.0, [0.0; 4], [0.0; 4])];
    for (side, choices) in sides.iter().enumerate() {
        let mut next = Vec::with_capacity(combined.len() * choices.len());
        for (probability, offsets_mm, spread_mm) in &combined {
            for choice in choices {
                let (mut offsets_mm, mut spread_mm): ([f64; 4], [f64; 4]) = (*offsets_mm, *spread_mm);
                (offsets_mm[side], spread_mm[side]) = (choice.offset_mm, choice.spread_mm);
                next.push((probability * choice.probability, offsets_mm, spread_mm));
            }
        }
        next.retain(|(probability, ..)| *probability >= LEAST);
        combined = next;
    }
    combined.sort_by(|a, b| b.0.total_cmp(&a.0));
    combined.truncate(MOST);
    let rival = |(probability, offsets_mm, spread_mm)| Rival {
        outline: MapOutline { offsets_mm, spread_mm, ..outline.clone() },
        probability,
    };
    Some(combined.into_iter().map(rival).collect())
}

/// Lines that are the same side taken together, likeliest first; the outline's own place stands for those near it.
fn choices(mut lines: Vec<Line>, own_mm: f64, mm_per_px: f64) -> Vec<Choice> {
    let (same_mm, beside_mm) = (SAME_PX * mm_per_px, (BESIDE_PX * mm_per_px).min(BESIDE_MM));
    let weight = softmax(&lines, Line::log_weight);
    let told = softmax(&lines, |line| line.told);
    lines.sort_by(|a, b| b.log_weight().total_cmp(&a.log_weight()));
    let both = lines.first().and_then(|best| {
        let near = |line: &&Line| (line.offset_mm - best.offset_mm).abs() <= same_mm;
        let favourite = lines.iter().max_by(|a, b| a.told.total_cmp(&b.told))?;
        let sum = lines.iter().filter(near).map(told).sum();
        Some(([sum, best.seen?], near(&favourite)))
    });
    let all = lines.clone();
    let mut found = Vec::new();
    while let Some(best) = lines.first().copied() {
        let near = |l: &Line| (l.offset_mm - best.offset_mm).abs() <= same_mm;
        let sum: f64 = lines.iter().filter(|l| near(l)).map(&weight).sum();
        lines.retain(|l| !near(l));
        let own = (best.offset_mm - own_mm).abs() <= same_mm;
        let spread_mm = SPREAD * scatter_mm(&all, &best, beside_mm, &weight);
        found.push(Choice {
            offset_mm: if own { own_mm } else { best.offset_mm },
            probability: sum,
            spread_mm,
        });
    }
    if let (Some((judges, agree)), Some(best)) = (both, found.first().map(|c| c.probability)) {
        let sure = surely(judges, mm_per_px).min(if agree { 1.0 } else { DISAGREE });
        let others = if best < 1.0 { ((1.0 - sure) / (1.0 - best)).min(1.0) } else { 1.0 };
        found.iter_mut().skip(1).for_each(|choice| choice.probability *= others);
        found[0].probability = sure;
    }
    found.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    found
}

/// Weighted scatter of the lines beside one about their mean, 1 sigma, mm: the two roundings of an edge, a seam's two flanks, a line of
/// print just inside. Which of them is the edge is not surely known, and where the edge is measured they pull at it.
fn scatter_mm(lines: &[Line], at: &Line, beside_mm: f64, weight: impl Fn(&Line) -> f64) -> f64 {
    let beside = || lines.iter().filter(|l| (l.offset_mm - at.offset_mm).abs() <= beside_mm);
    let total: f64 = beside().map(&weight).sum();
    let mean: f64 = beside().map(|l| weight(l) * l.offset_mm).sum::<f64>() / total;
    (beside().map(|l| weight(l) * (l.offset_mm - mean).powi(2)).sum::<f64>() / total).sqrt()
}

/// The share of each line's weight.
fn softmax<F: Fn(&Line) -> f64>(lines: &[Line], log_weight: F) -> impl Fn(&Line) -> f64 + use<F> {
    let most = lines.iter().map(&log_weight).fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = lines.iter().map(|l| (log_weight(l) - most).exp()).sum();
    move |line| (log_weight(line) - most).exp() / total
}

/// See [`SURE`]; what the two judges say.
fn surely([told, seen]: [f64; 2], mm_per_px: f64) -> f64 {
    let odds = |p: f64, most: f64| (p.max(0.0) / (1.0 - p).max(0.0)).clamp(1.0 / most, most).ln();
    let [constant, by_told, by_seen, by_size] = SURE;
    let judged = by_told * odds(told, MOST_ODDS[0]) + by_seen * odds(seen, MOST_ODDS[1]);
    let logit = constant + judged + by_size * mm_per_px.ln();
    1.0 / (1.0 + (-logit).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_the_network_of_sides_does_not_see_is_less_sure_and_the_others_are_not_surer_for_it() {
        let line = |offset_mm, told, seen| Line { offset_mm, told, seen: Some(seen) };
        let of = |seen| choices(vec![line(10.0, 8.0, seen), line(50.0, 4.0, 0.01)], 10.0, 0.2);
        let (both, one) = (of(0.97), of(0.03));
        assert!(both[0].probability > 0.95 && one[0].probability < 0.9, "{both:?} {one:?}");
        for found in [both, one] {
            assert!(found.iter().map(|c| c.probability).sum::<f64>() <= 1.0 + 1e-9, "{found:?}");
        }
    }

    #[test]
    fn two_judges_who_favour_different_lines_are_not_sure() {
        let line = |offset_mm, told, seen| Line { offset_mm, told, seen: Some(seen) };
        let found = choices(vec![line(10.0, 5.0, 0.97), line(50.0, 5.5, 0.01)], 10.0, 0.2);
        assert_eq!((found[0].offset_mm, found[0].probability), (10.0, DISAGREE), "{found:?}");
    }

    #[test]
    fn lines_beside_each_other_are_one_choice() {
        let line = |offset_mm, weight: f64| Line { offset_mm, told: weight.ln(), seen: None };
        let lines = vec![line(10.0, 3.0), line(11.0, 3.0), line(50.0, 4.0)];
        let found = choices(lines, 10.8, 0.2);
        assert_eq!(found.len(), 2);
        assert_eq!(found[0].offset_mm, 10.8, "the outline's own place");
        assert!((found[0].spread_mm - SPREAD * 0.5).abs() < 1e-9 && found[1].spread_mm == 0.0, "{found:?}");
        assert!((found[0].probability - 0.6).abs() < 1e-9, "{}", found[0].probability);
        assert!((found[1].probability - 0.4).abs() < 1e-9 && found[1].offset_mm == 50.0);
    }
}
