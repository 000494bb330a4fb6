//! Evidence for a straight edge at each offset: the side is cut into segments, each gives a mean profile of its tone
//! across it, and an edge is where most segments show a step (or a thin dark line: the seam between flush boxes) at the
//! same place. Print, labels and tape seldom run the whole length of a side.

use super::{noise_of, tone};
use crate::calibration::Calibration;
use crate::face::outline::Across;
use crate::face::raster::PlaneRaster;
use crate::image::Frame;

/// Segments of a side.
pub(crate) const SEGMENTS: usize = 16;
/// Samples added up in one segment at each offset.
const SAMPLES: usize = 10;
/// Half the distance over which a step is measured, in scan steps (about px): the optics blur an edge over 2 to 3 px.
const REACH: usize = 2;
/// A step this many noise sigmas high counts fully; one segment must not outvote the others.
const FULL_SIGMAS: f32 = 5.0;
/// Exact projections every so many scan steps, straight lines between: distortion bends by less than 0.05 px there.
const NODE: usize = 32;

/// What is scanned.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScanRange {
    pub across: Across,
    /// First and last offset, mm.
    pub from_mm: f64,
    pub to_mm: f64,
    /// Where the side begins and ends along its direction, mm.
    pub span_mm: (f64, f64),
    /// Distance of two offsets, mm; about a pixel.
    pub step_mm: f64,
}

/// Edge evidence of all segments over the offsets.
pub(crate) struct SideScan {
    /// Offset of the first step, mm.
    pub start_mm: f64,
    /// Distance of two steps, mm; about a pixel.
    pub step_mm: f64,
    steps: usize,
    /// Strength 0 to 1 per segment and step.
    strength: Vec<f32>,
}

/// An edge candidate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgeCandidate {
    /// Offset at the middle of the side, mm.
    pub offset_mm: f64,
    /// Mean strength of the segments, 0 to 1.
    pub strength: f32,
}

impl SideScan {
    /// Gathers the evidence of all segments.
    pub fn new(frame: &Frame, calibration: &Calibration, raster: &PlaneRaster, range: &ScanRange) -> Self {
        let ScanRange { across, from_mm, to_mm, span_mm, step_mm } = *range;
        let steps = (((to_mm - from_mm) / step_mm).ceil().max(0.0) as usize + 1).min(6000);
        let mut strength = vec![0f32; SEGMENTS * steps];
        let mut sum = vec![[0f32; 2]; steps];
        let mut count = vec![0f32; steps];
        let mut sorted = Vec::with_capacity(steps);
        for segment in 0..SEGMENTS {
            sum.fill([0.0; 2]);
            count.fill(0.0);
            for sample in 0..SAMPLES {
                let t = (segment as f64 + (sample as f64 + 0.5) / SAMPLES as f64) / SEGMENTS as f64;
                let along = span_mm.0 + (span_mm.1 - span_mm.0) * t;
                let mut here = raster.pixel(calibration, across.at(from_mm, along));
                for node in (0..steps).step_by(NODE) {
                    let last = (node + NODE).min(steps);
                    let there =
                        raster.pixel(calibration, across.at(from_mm + (node + NODE) as f64 * step_mm, along));
                    if let (Some(p), Some(q)) = (here, there) {
                        let (du, dv) = ((q.u - p.u) / NODE as f64, (q.v - p.v) / NODE as f64);
                        for k in node..last {
                            let s = (k - node) as f64;
                            if let Some([y, c]) = tone(frame, p.u + du * s, p.v + dv * s) {
                                sum[k][0] += y;
                                sum[k][1] += c;
                                count[k] += 1.0;
                            }
                        }
                    }
                    here = there;
                }
            }
            for (s, c) in sum.iter_mut().zip(&count) {
                *s = if *c * 2.0 > SAMPLES as f32 { s.map(|x| x / c) } else { [f32::NAN; 2] };
            }
            let out = &mut strength[segment * steps..][..steps];
            for channel in 0..2 {
                let step = |k: usize| (sum[k + REACH][channel] - sum[k - REACH][channel]).abs();
                sorted.clear();
                sorted
                    .extend((2 * REACH..steps.saturating_sub(2 * REACH)).map(step).filter(|s| s.is_finite()));
                if sorted.len() < 16 {
                    continue;
                }
                let sigma = noise_of(&mut sorted, 0.5);
                for k in 2 * REACH..steps.saturating_sub(2 * REACH) {
                    let mut value = step(k);
                    if channel == 0 {
                        // A thin line must be dark: the gap between two boxes.
                        let line = sum[k][0] - 0.5 * (sum[k - 2 * REACH][0] + sum[k + 2 * REACH][0]);
                        value = value.max(-1.5 * line);
                    }
                    let seen = ((value / sigma - 1.0) / (FULL_SIGMAS - 1.0)).clamp(0.0, 1.0);
                    if seen.is_finite() {
                        out[k] = out[k].max(seen);
                    }
                }
            }
        }
        Self { start_mm: from_mm, step_mm, steps, strength }
    }

    /// Largest strength of a straight edge through each step at the middle of the side, over all drifts from end to end.
    fn best_strengths(&self, max_drift_steps: i64) -> Vec<f32> {
        let n = self.steps;
        // An edge between two steps counts at both.
        let mut wide = vec![0f32; SEGMENTS * n];
        for (wide, row) in wide.chunks_exact_mut(n).zip(self.strength.chunks_exact(n)) {
            for (w, near) in wide[1..].iter_mut().zip(row.windows(3)) {
                *w = near[1].max(0.7 * near[0].max(near[2]));
            }
        }
        let mut best = vec![0f32; n];
        let mut sum = vec![0f32; n];
        for drift in -max_drift_steps..=max_drift_steps {
            sum.fill(0.0);
            for (segment, wide) in wide.chunks_exact(n).enumerate() {
                let t = (segment as f64 + 0.5) / SEGMENTS as f64 - 0.5;
                let shift = (drift as f64 * t + 0.5).floor() as isize;
                // Whole rows at once: sum[k] += wide[k + shift].
                let (to, from) = if shift >= 0 { (0, shift as usize) } else { (shift.unsigned_abs(), 0) };
                for (s, w) in sum.iter_mut().skip(to).zip(wide.iter().skip(from)) {
                    *s += w;
                }
            }
            for (b, s) in best.iter_mut().zip(&sum) {
                *b = b.max(s / SEGMENTS as f32);
            }
        }
        best
    }

    /// The strongest edges, at least `apart_mm` from each other, strongest first.
    pub fn candidates(
        &self,
        max_drift_mm: f64,
        apart_mm: f64,
        least: f32,
        keep: usize,
    ) -> Vec<EdgeCandidate> {
        let max_drift = (max_drift_mm / self.step_mm).round().clamp(0.0, 40.0) as i64;
        let best = self.best_strengths(max_drift);
        let mut all = Vec::new();
        for (k, strength) in best.iter().copied().enumerate() {
            if strength >= least {
                // A step is seen over all its blur and a clear one is as strong everywhere there: it lies in the middle.
                let same = |n: &&f32| **n == strength;
                let (before, after) = (
                    best[..k].iter().rev().take_while(same).count(),
                    best[k + 1..].iter().take_while(same).count(),
                );
                let middle = k as f64 + 0.5 * (after as f64 - before as f64);
                all.push(EdgeCandidate { offset_mm: self.start_mm + middle * self.step_mm, strength });
            }
        }
        all.sort_by(|a, b| b.strength.total_cmp(&a.strength));
        let mut kept: Vec<EdgeCandidate> = Vec::new();
        for candidate in all {
            if kept.len() == keep {
                break;
            }
            if kept.iter().all(|k| (k.offset_mm - candidate.offset_mm).abs() >= apart_mm) {
                kept.push(candidate);
            }
        }
        kept
    }
}
