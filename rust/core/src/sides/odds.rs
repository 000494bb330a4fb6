//! What the network of sides says of a face: for each of its four sides where it is, and whether something hides a piece of it.

use super::face_view::{BINS, ViewAxes};

/// Numbers of one side as the network gives them: logits of the places, of "not in view", and of "hidden".
const LOGITS: usize = BINS + 2;
/// Numbers that the network gives: sides one after the other.
pub const OUTPUTS: usize = 4 * LOGITS;
/// Two places of a side nearer than this are the same, bins: 1 to 2 % of the face. What lies closer is told apart in the frame itself.
const SAME_BINS: f64 = 2.0;

/// Probabilities of one side.
#[derive(Clone, Debug, PartialEq)]
struct Side {
    /// Of each place; with `gone` they add up to 1.
    places: Vec<f64>,
    hidden: f64,
}

/// Probabilities of all four sides, in the order of [`ViewAxes`].
#[derive(Clone, Debug, PartialEq)]
pub struct SideOdds {
    sides: Vec<Side>,
}

impl SideOdds {
    /// From what the network gives. `None` if that is not [`OUTPUTS`] finite numbers.
    #[must_use]
    pub fn from_logits(logits: &[f32]) -> Option<Self> {
        if logits.len() != OUTPUTS || logits.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let side = |told: &[f32]| {
            let (places, hidden) = (&told[..=BINS], f64::from(told[BINS + 1]));
            let most = places.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let mut places: Vec<f64> = places.iter().map(|v| f64::from(v - most).exp()).collect();
            let total: f64 = places.iter().sum();
            places.iter_mut().for_each(|p| *p /= total);
            places.truncate(BINS);
            Side { places, hidden: 1.0 / (1.0 + (-hidden).exp()) }
        };
        Some(Self { sides: logits.chunks_exact(LOGITS).map(side).collect() })
    }

    /// Probability that a side is at an offset, mm, to within [`SAME_BINS`].
    #[must_use]
    pub fn at(&self, axes: &ViewAxes, side: usize, offset_mm: f64) -> f64 {
        let middle = axes.bin(side, offset_mm);
        let share = |bin: usize| {
            // Of a bin that the window covers in part.
            let (from, to) = (bin as f64, bin as f64 + 1.0);
            (to.min(middle + SAME_BINS) - from.max(middle - SAME_BINS)).clamp(0.0, 1.0)
        };
        self.sides[side].places.iter().enumerate().map(|(bin, p)| p * share(bin)).sum()
    }

    /// The likeliest place of a side, mm.
    #[must_use]
    pub fn likeliest_mm(&self, axes: &ViewAxes, side: usize) -> f64 {
        let places = &self.sides[side].places;
        let best = (0..BINS).max_by(|i, j| places[*i].total_cmp(&places[*j])).unwrap_or(0);
        // The mean of what is around it: places between two bins are shared by both.
        let around = best.saturating_sub(1)..(best + 2).min(BINS);
        let sum: f64 = around.clone().map(|bin| places[bin]).sum();
        let mean =
            around.map(|bin| places[bin] * (bin as f64 + 0.5)).sum::<f64>() / sum.max(f64::MIN_POSITIVE);
        axes.offset_mm(side, mean)
    }

    /// Probability that something in front of the face hides a piece of a side, its corners or a stripe's end there.
    #[must_use]
    pub fn hidden(&self, side: usize) -> f64 {
        self.sides[side].hidden
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probabilities_add_up_and_broken_numbers_are_refused() {
        let mut logits = vec![0.0; OUTPUTS];
        logits[LOGITS + 40] = 12.0; // low side of the first axis' other end
        let odds = SideOdds::from_logits(&logits).expect("finite");
        for side in &odds.sides {
            assert!(side.places.iter().sum::<f64>() < 1.0 && (side.hidden - 0.5).abs() < 1e-9);
        }
        assert!(odds.sides[1].places[40] > 0.99);
        assert!(SideOdds::from_logits(&logits[1..]).is_none());
        logits[3] = f32::NAN;
        assert!(SideOdds::from_logits(&logits).is_none());
    }
}
