//! A length measured again and again, and what became of all shots of one thing.

use super::plan::Experiment;
use boxline::Estimate;
use boxline::confidence::RIGHT_MM;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// What became of one shot in one way.
#[derive(Clone, Debug, PartialEq)]
pub enum ShotResult {
    /// Its sides, in the order of [`Experiment::sides_mm`].
    Measured { sides: Vec<Estimate>, warned: bool },
    /// Why not.
    Refused(String),
}

/// All shots of one thing in one way.
#[derive(Clone, Debug)]
pub struct Tally {
    pub shots: usize,
    /// In the order of [`Experiment::sides_mm`]; the same shots in each.
    pub sides: Vec<Series>,
    pub refused: BTreeMap<String, usize>,
    /// Shots with a side that is off by more than the paper's promise.
    pub wrong: usize,
    pub warned: usize,
}

impl Tally {
    /// Of all shots.
    pub fn new<'a>(what: &Experiment, shots: impl Iterator<Item = &'a ShotResult>) -> Self {
        let sides = what.sides_mm.iter().map(|truth_mm| Series::new(*truth_mm)).collect();
        let mut tally = Self { shots: 0, sides, refused: BTreeMap::new(), wrong: 0, warned: 0 };
        for shot in shots {
            tally.shots += 1;
            match shot {
                ShotResult::Refused(reason) => *tally.refused.entry(reason.clone()).or_default() += 1,
                ShotResult::Measured { sides, warned } => {
                    let far_off = |(side, truth): (&Estimate, &f64)| (side.value_mm - truth).abs() > RIGHT_MM;
                    tally.wrong += usize::from(sides.iter().zip(&what.sides_mm).any(far_off));
                    tally.warned += usize::from(*warned);
                    for (series, side) in tally.sides.iter_mut().zip(sides) {
                        series.values.push(*side);
                    }
                }
            }
        }
        tally
    }

    pub fn measured(&self) -> usize {
        self.sides.first().map_or(0, |side| side.values.len())
    }

    /// Errors of all sides, mm.
    pub fn errors_mm(&self) -> impl Iterator<Item = f64> + '_ {
        self.sides.iter().flat_map(|side| side.values.iter().map(|e| e.value_mm - side.truth_mm))
    }

    /// Error of the volume in percent, a box's shots as a series about 0.
    pub fn volume_percent(&self) -> Series {
        let mut volume = Series::new(0.0);
        for shot in 0..self.measured() {
            let ratio: f64 = self.sides.iter().map(|s| s.values[shot].value_mm / s.truth_mm).product();
            volume.values.push(Estimate::new(100.0 * (ratio - 1.0), 0.0));
        }
        volume
    }

    pub fn json(&self) -> Value {
        json!({
            "shots": self.shots, "measured": self.measured(), "wrong": self.wrong, "warned": self.warned,
            "refused": self.refused, "sides": self.sides.iter().map(Series::json).collect::<Vec<_>>(),
        })
    }
}

/// One length, measured again and again.
#[derive(Clone, Debug)]
pub struct Series {
    pub truth_mm: f64,
    pub values: Vec<Estimate>,
}

impl Series {
    pub fn new(truth_mm: f64) -> Self {
        Self { truth_mm, values: Vec::new() }
    }

    fn mean_of(&self, of: impl Fn(&Estimate) -> f64) -> Option<f64> {
        let n = self.values.len();
        (n > 0).then(|| self.values.iter().map(of).sum::<f64>() / n as f64)
    }

    /// Mean minus truth, mm.
    pub fn error_mm(&self) -> Option<f64> {
        self.mean_of(|e| e.value_mm - self.truth_mm)
    }

    /// Largest distance from the truth, mm.
    pub fn worst_mm(&self) -> Option<f64> {
        self.values.iter().map(|e| (e.value_mm - self.truth_mm).abs()).reduce(f64::max)
    }

    /// Standard deviation of one shot about the mean, mm; two shots at least.
    pub fn scatter_mm(&self) -> Option<f64> {
        let n = self.values.len();
        let mean = self.mean_of(|e| e.value_mm)?;
        let sum: f64 = self.values.iter().map(|e| (e.value_mm - mean).powi(2)).sum();
        (n > 1).then(|| (sum / (n - 1) as f64).sqrt())
    }

    /// Mean of the standard deviations that the measurements state, mm.
    pub fn stated_mm(&self) -> Option<f64> {
        self.mean_of(|e| e.sigma_mm)
    }

    pub fn json(&self) -> Value {
        json!({
            "true_mm": self.truth_mm, "measured": self.values.len(), "error_mm": self.error_mm(),
            "worst_mm": self.worst_mm(), "scatter_mm": self.scatter_mm(),
            "stated_sigma_mm": self.stated_mm(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_series_of_known_numbers() {
        let mut series = Series::new(100.0);
        assert_eq!((series.error_mm(), series.worst_mm(), series.scatter_mm()), (None, None, None));
        for value in [99.0, 101.0, 103.0, 101.0] {
            series.values.push(Estimate::new(value, 0.5));
        }
        assert_eq!((series.error_mm(), series.worst_mm()), (Some(1.0), Some(3.0)));
        assert!((series.scatter_mm().unwrap() - (8.0f64 / 3.0).sqrt()).abs() < 1e-12);
        assert_eq!(series.stated_mm(), Some(0.5));
    }

    #[test]
    fn shots_are_counted_by_what_became_of_them() {
        let what = Experiment {
            table: super::super::plan::Table::Boxes,
            name: "a box".into(),
            sides_mm: vec![200.0, 100.0, 50.0],
            distance_mm: [900.0; 2],
        };
        let measured = |length: f64, warned| ShotResult::Measured {
            sides: [length, 100.0, 50.0].map(|v| Estimate::new(v, 0.5)).to_vec(),
            warned,
        };
        let shots = [measured(201.0, true), ShotResult::Refused("no_box".into()), measured(205.1, false)];
        let tally = Tally::new(&what, shots.iter());
        assert_eq!((tally.shots, tally.measured(), tally.wrong, tally.warned), (3, 2, 1, 1));
        assert_eq!(tally.refused["no_box"], 1);
        assert_eq!(tally.sides[0].worst_mm().map(|w| (w * 10.0).round()), Some(51.0));
        assert_eq!(tally.errors_mm().count(), 6);
        let volume = tally.volume_percent();
        assert!((volume.values[0].value_mm - 0.5).abs() < 1e-9, "{volume:?}");
    }
}
