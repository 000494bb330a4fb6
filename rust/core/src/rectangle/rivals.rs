//! The outlines that a face may have: the network's and those with other lines of the picture for some of its sides, each with its
//! probability. Which it is may be told by the frame, or only together with the other frame of the box.

use super::line_evidence::{Evidence, Line};
use crate::calibration::Calibration;
use crate::face::extent::FaceStripes;
use crate::face::map_outline::MapOutline;
use crate::image::Frame;
use crate::network::Asked;
use crate::sides::{SideOdds, ViewAxes};

/// One of the outlines.
#[derive(Clone, Debug)]
pub(crate) struct Rival {
    pub outline: MapOutline,
    /// That all four sides are right.
    pub probability: f64,
}

/// Lines nearer than this are the same side, px: what lies between is decided where the edge is measured.
const SAME_PX: f64 = 10.0;
/// Outlines that are kept, and the least probability of one.
const MOST: usize = 10;
const LEAST: f64 = 0.01;

/// One line of a side with all that belong to it.
#[derive(Clone, Copy)]
struct Choice {
    offset_mm: f64,
    probability: f64,
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
        sides.push(choices(lines, outline.offsets_mm[side], SAME_PX * outline.mm_per_px));
    }
    let mut combined = vec![(1.0, [0.0; 4])];
    for (side, choices) in sides.iter().enumerate() {
        let mut next = Vec::with_capacity(combined.len() * choices.len());
        for (probability, offsets_mm) in &combined {
            for choice in choices {
                let mut offsets_mm: [f64; 4] = *offsets_mm;
                offsets_mm[side] = choice.offset_mm;
                next.push((probability * choice.probability, offsets_mm));
            }
        }
        next.retain(|(probability, ..)| *probability >= LEAST);
        combined = next;
    }
    combined.sort_by(|a, b| b.0.total_cmp(&a.0));
    combined.truncate(MOST);
    let rival = |(probability, offsets_mm)| Rival {
        outline: MapOutline { offsets_mm, ..outline.clone() },
        probability,
    };
    Some(combined.into_iter().map(rival).collect())
}

/// Lines that are the same side taken together, likeliest first; the outline's own place stands for those near it.
fn choices(mut lines: Vec<Line>, own_mm: f64, same_mm: f64) -> Vec<Choice> {
    let most = lines.iter().map(|l| l.log_weight).fold(f64::NEG_INFINITY, f64::max);
    let weight = |l: &Line| (l.log_weight - most).exp();
    let total: f64 = lines.iter().map(weight).sum();
    lines.sort_by(|a, b| b.log_weight.total_cmp(&a.log_weight));
    let mut found = Vec::new();
    while let Some(best) = lines.first().copied() {
        let near = |l: &Line| (l.offset_mm - best.offset_mm).abs() <= same_mm;
        let sum: f64 = lines.iter().filter(|l| near(l)).map(weight).sum();
        lines.retain(|l| !near(l));
        let own = (best.offset_mm - own_mm).abs() <= same_mm;
        found.push(Choice { offset_mm: if own { own_mm } else { best.offset_mm }, probability: sum / total });
    }
    found.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_beside_each_other_are_one_choice() {
        let line = |offset_mm, weight: f64| Line { offset_mm, log_weight: weight.ln() };
        let lines = vec![line(10.0, 3.0), line(11.0, 3.0), line(50.0, 4.0)];
        let found = choices(lines, 10.8, 2.0);
        assert_eq!(found.len(), 2);
        assert_eq!(found[0].offset_mm, 10.8, "the outline's own place");
        assert!((found[0].probability - 0.6).abs() < 1e-9, "{}", found[0].probability);
        assert!((found[1].probability - 0.4).abs() < 1e-9 && found[1].offset_mm == 50.0);
    }
}
