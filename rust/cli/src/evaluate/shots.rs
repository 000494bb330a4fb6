//! Rendered shots: a frame as the head delivers it, and a series of values that repeated shots gave.

use boxline::{Estimate, Frame};
use boxline_sim::recording::{full_frame, jpeg};
use boxline_sim::world::{Scene, View};
use boxline_sim::{Head, Split, Stock};
use serde_json::{Value, json};
use std::path::Path;

/// A full frame through the camera's JPEG.
pub fn shot(head: &Head, scene: &Scene, view: &View, seed: u64, stock: &Stock) -> anyhow::Result<Frame> {
    Ok(Frame::from_jpeg(&jpeg(&full_frame(head, scene, view, true, seed, stock), seed)?)?)
}

/// Materials and photographs of a split.
pub fn stock(split: Split, photos: Option<&Path>) -> anyhow::Result<Stock> {
    Ok(match photos {
        Some(folder) => Stock::with_photos(split, folder)?,
        None => Stock::new(split),
    })
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

    /// Class A uncertainty of the mean (GUM 4.2, the paper's eq. 22), mm.
    pub fn class_a_mm(&self) -> Option<f64> {
        Some(self.scatter_mm()? / (self.values.len() as f64).sqrt())
    }

    /// Mean of the standard deviations that the measurements state, mm.
    pub fn stated_mm(&self) -> Option<f64> {
        self.mean_of(|e| e.sigma_mm)
    }

    pub fn json(&self) -> Value {
        json!({
            "true_mm": self.truth_mm, "measured": self.values.len(), "error_mm": self.error_mm(),
            "worst_mm": self.worst_mm(), "scatter_mm": self.scatter_mm(), "class_a_mm": self.class_a_mm(),
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
        assert!((series.class_a_mm().unwrap() - (8.0f64 / 3.0).sqrt() / 2.0).abs() < 1e-12);
        assert_eq!(series.stated_mm(), Some(0.5));
    }
}
