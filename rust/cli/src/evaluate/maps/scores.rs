//! Adds up the scores of maps over frames. Names and definitions are those of `rust/edgenet/training/metrics.py`.

use super::fits::{KeyPoints, key_points, line_error_px};
use super::lines::{Compared, LineCounts, LineScore, Map, threshold};
use boxline::LaserId;
use boxline::network::{Channel, FaceMaps};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Kinds of lines that are scored, beside the lasers by contrast. `single` is the paper's one edge map: the strongest of the four
/// lasers on the face and the face's edges.
const SINGLE: &str = "single";
const CHANNELS: [(&str, Channel); 7] = [
    ("L1", Channel::Laser(LaserId::ALL[0])),
    ("L2", Channel::Laser(LaserId::ALL[1])),
    ("L3", Channel::Laser(LaserId::ALL[2])),
    ("L4", Channel::Laser(LaserId::ALL[3])),
    ("spill", Channel::StrayLight),
    ("face_edge", Channel::FaceEdge),
    ("other_edge", Channel::OtherEdge),
];

/// Below 30 levels of red over its surroundings a laser is dim, from 100 on bright.
fn contrast_bin(contrast: f64) -> Option<&'static str> {
    match contrast {
        c if c <= 0.0 => None, // not on the face
        c if c < 30.0 => Some("dim"),
        c if c < 100.0 => Some("mid"),
        _ => Some("bright"),
    }
}

/// What a frame's maps should be.
pub struct Labels {
    pub maps: FaceMaps,
    /// Of each laser on the face, levels of 255; 0 if it is not there. `None` if nobody knows.
    pub contrast: Option<[f64; 4]>,
    pub measurable: bool,
    /// Recordings say nothing of spill and other boxes' edges.
    pub face_only: bool,
}

/// The thresholds of each kind of line, as indices; chosen on validation frames.
pub type Thresholds = BTreeMap<String, usize>;

/// All scores over the frames given to `add`.
#[derive(Default)]
pub struct Scores {
    frames: usize,
    lines: BTreeMap<String, LineCounts>,
    iou: Vec<f64>,
    mask_share_without_face: Vec<f64>,
    line_errors_px: BTreeMap<&'static str, Vec<f64>>,
    worst_of_four_px: Vec<f64>,
    worst_of_four_not_dim_px: Vec<f64>,
    key_points: KeyPoints,
}

impl Scores {
    /// Adds one frame; key points need the threshold of the single map.
    pub fn add(&mut self, predicted: &FaceMaps, labels: &Labels, thresholds: Option<&Thresholds>) {
        self.frames += 1;
        let truth = &labels.maps;
        let single = [largest(predicted, &face_channels()), largest(truth, &face_channels())];
        self.add_line(SINGLE, &Compared::new(&single[0], &single[1]));
        let lasers = LaserId::ALL.map(Channel::Laser);
        self.add_line("any_laser", &Compared::new(&largest(predicted, &lasers), &largest(truth, &lasers)));
        if !labels.face_only {
            let edges = [Channel::FaceEdge, Channel::OtherEdge];
            self.add_line("any_edge", &Compared::new(&largest(predicted, &edges), &largest(truth, &edges)));
        }
        for (name, channel) in CHANNELS {
            if labels.face_only && matches!(channel, Channel::StrayLight | Channel::OtherEdge) {
                continue;
            }
            let compared = Compared::new(&map(predicted, channel), &map(truth, channel));
            self.add_line(name, &compared);
            if let (Channel::Laser(id), Some(contrast)) = (channel, labels.contrast)
                && let Some(bin) = contrast_bin(contrast[id.index()])
            {
                self.add_line(&format!("laser_{bin}"), &compared);
            }
        }
        self.add_mask(predicted.channel(Channel::FaceMask), truth.channel(Channel::FaceMask));
        let true_lasers = lasers.map(|channel| map(truth, channel));
        self.add_fits(&lasers.map(|channel| map(predicted, channel)), &true_lasers, labels);
        if let Some(index) = thresholds.and_then(|t| t.get(SINGLE)) {
            let found = key_points(
                &single[0].thinned(),
                &true_lasers,
                &map(truth, Channel::FaceEdge),
                threshold(*index),
            );
            self.key_points.count += found.count;
            self.key_points.errors_px.extend(found.errors_px);
        }
    }

    fn add_line(&mut self, name: &str, compared: &Compared) {
        self.lines.entry(name.to_owned()).or_default().add(compared);
    }

    fn add_mask(&mut self, predicted: &[f32], truth: &[f32]) {
        let count = |yes: &dyn Fn(f32, f32) -> bool| {
            predicted.iter().zip(truth).filter(|(p, t)| yes(**p, **t)).count() as f64
        };
        let either = count(&|p, t| p >= 0.5 || t >= 0.5);
        if truth.iter().any(|t| *t >= 0.5) {
            self.iou.push(count(&|p, t| p >= 0.5 && t >= 0.5) / either);
        } else {
            self.mask_share_without_face.push(either / truth.len() as f64);
        }
    }

    fn add_fits(&mut self, predicted: &[Map; 4], truth: &[Map; 4], labels: &Labels) {
        let errors: Vec<Option<f64>> =
            predicted.iter().zip(truth).map(|(p, t)| line_error_px(p, t)).collect();
        for (i, error) in errors.iter().enumerate() {
            let Some(error) = *error else { continue };
            self.line_errors_px.entry("all").or_default().push(error);
            if let Some(bin) = labels.contrast.and_then(|c| contrast_bin(c[i])) {
                self.line_errors_px.entry(bin).or_default().push(error);
            }
        }
        let all: Option<Vec<f64>> = errors.into_iter().collect();
        if let Some(all) = all.filter(|_| labels.measurable) {
            let worst = all.into_iter().fold(0.0, f64::max);
            self.worst_of_four_px.push(worst);
            if labels.contrast.is_some_and(|c| c.iter().all(|c| *c >= 30.0)) {
                self.worst_of_four_not_dim_px.push(worst);
            }
        }
    }

    /// The threshold of each kind of line with the largest F.
    pub fn best_thresholds(&self) -> Thresholds {
        self.lines.iter().map(|(name, counts)| (name.clone(), counts.best_threshold())).collect()
    }

    /// Each kind of line at its threshold.
    pub fn line_scores(&self, thresholds: &Thresholds) -> Vec<(&str, LineScore)> {
        let at = |name: &String, counts: &LineCounts| {
            counts.score_at(thresholds.get(name).copied().unwrap_or_else(|| counts.best_threshold()))
        };
        self.lines.iter().map(|(name, counts)| (name.as_str(), at(name, counts))).collect()
    }

    /// Everything as one object; the same names as `score.py` prints.
    pub fn json(&self, thresholds: &Thresholds) -> Value {
        let lines = self.line_scores(thresholds);
        let per_line: serde_json::Map<String, Value> = lines
            .iter()
            .map(|(name, s)| {
                let at = (f64::from(threshold(s.threshold_index)) * 100.0).round() / 100.0;
                let score = json!({"f": rounded(s.f), "precision": rounded(s.precision), "recall": rounded(s.recall),
                    "threshold": at});
                ((*name).to_owned(), score)
            })
            .collect();
        let of_lasers = lines.iter().filter(|(name, _)| matches!(*name, "L1" | "L2" | "L3" | "L4"));
        let laser_f = of_lasers.map(|(_, s)| s.f).sum::<f64>() / 4.0;
        let line_px: serde_json::Map<String, Value> = self
            .line_errors_px
            .iter()
            .map(|(name, errors)| {
                let value = json!({"n": errors.len(), "median": quantile(errors, 0.5), "p90": quantile(errors, 0.9),
                    "below_2": below(errors, 2.0)});
                ((*name).to_owned(), value)
            })
            .collect();
        json!({
            "frames": self.frames, "lines": per_line, "laser_f": rounded(laser_f),
            "mask_iou_mean": mean(&self.iou), "mask_iou_median": quantile(&self.iou, 0.5),
            "mask_share_without_face": mean(&self.mask_share_without_face),
            "line_px": line_px,
            "four_lasers_below_2px": below(&self.worst_of_four_px, 2.0),
            "four_lasers_below_2px_not_dim": below(&self.worst_of_four_not_dim_px, 2.0),
            "key_points_px": self.key_points_json(),
        })
    }

    fn key_points_json(&self) -> Value {
        let KeyPoints { errors_px, count } = &self.key_points;
        let distances: Vec<f64> = errors_px.iter().map(|[x, y]| x.hypot(*y)).collect();
        let signed = |i: usize| mean(&errors_px.iter().map(|e| e[i]).collect::<Vec<_>>());
        json!({
            "n": count, "found": errors_px.len() as f64 / (*count).max(1) as f64,
            "signed": [signed(0), signed(1)], "unsigned": mean(&distances), "p90": quantile(&distances, 0.9),
        })
    }
}

fn face_channels() -> [Channel; 5] {
    let [a, b, c, d] = LaserId::ALL.map(Channel::Laser);
    [a, b, c, d, Channel::FaceEdge]
}

fn map(maps: &FaceMaps, channel: Channel) -> Map {
    largest(maps, &[channel])
}

fn largest(maps: &FaceMaps, channels: &[Channel]) -> Map {
    let [width, height] = maps.size();
    Map::largest(width, height, channels.iter().map(|channel| maps.channel(*channel)))
}

fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| rounded(values.iter().sum::<f64>() / values.len() as f64))
}

fn below(values: &[f64], limit: f64) -> Option<f64> {
    (!values.is_empty())
        .then(|| rounded(values.iter().filter(|v| **v < limit).count() as f64 / values.len() as f64))
}

/// The next higher of the values; no more than 999, which stands for a line that was not found.
fn quantile(values: &[f64], q: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let index = (q * sorted.len().saturating_sub(1) as f64).ceil() as usize;
    sorted.get(index).map(|v| rounded(v.min(999.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use boxline::network::CHANNELS as COUNT;

    fn maps(values: Vec<f32>) -> FaceMaps {
        FaceMaps::new(64, 48, [640, 480], values).expect("sizes fit")
    }

    fn crossing_lines() -> Vec<f32> {
        let mut values = vec![0.0; COUNT * 64 * 48];
        for x in 8..56 {
            for y in 0..48 {
                let distance = (y as f32 - 20.0 - 0.1 * x as f32) / 1.005;
                let value = (-0.5 * (distance / 0.8).powi(2)).exp();
                for channel in [0, 1, 2, 3, 5] {
                    values[(channel * 48 + y) * 64 + x] = value;
                }
                values[(7 * 48 + y) * 64 + x] = f32::from(u8::from(distance.abs() < 9.0));
            }
        }
        values
    }

    #[test]
    fn the_truth_itself_scores_one_and_nothing_scores_zero() {
        let labels = Labels {
            maps: maps(crossing_lines()),
            contrast: Some([10.0, 50.0, 200.0, 200.0]),
            measurable: true,
            face_only: false,
        };
        let score = |predicted: Vec<f32>| {
            let mut scores = Scores::default();
            scores.add(&maps(predicted), &labels, None);
            scores.json(&Thresholds::from([("L1".to_owned(), 8)]))
        };
        let perfect = score(crossing_lines());
        assert_eq!((&perfect["laser_f"], &perfect["mask_iou_mean"]), (&json!(1.0), &json!(1.0)));
        assert_eq!(perfect["four_lasers_below_2px"], json!(1.0));
        assert_eq!(perfect["lines"]["laser_dim"]["f"], json!(1.0));
        assert_eq!(perfect["line_px"]["bright"]["n"], json!(2));
        let nothing = score(vec![0.0; COUNT * 64 * 48]);
        assert_eq!((&nothing["laser_f"], &nothing["mask_iou_mean"]), (&json!(0.0), &json!(0.0)));
        assert_eq!(nothing["line_px"]["all"]["p90"], json!(999.0));
    }
}
