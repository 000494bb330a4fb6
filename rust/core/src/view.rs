//! What the network of sides sees, a face in its own plane ([`FaceView`]), and what it says of it ([`SideOdds`]): for each of the four sides
//! where it is, and whether something hides a piece of it. Which places the bins are, [`crate::sides`] knows.

/// Cells from the outermost crossing to the border, for each of the four sides: the places where the side may be.
pub const BINS: usize = 112;
/// Cells between the crossings, along each axis.
pub const INNER: usize = 32;
/// Columns and rows.
pub const CELLS: usize = 2 * BINS + INNER;
/// Channels, rows and columns of a view: red, green, blue (0 to 1); where stripes 1 and 2 lie on the plane (1) and would lie on a
/// surface a little nearer (a half); the same of stripes 3 and 4. All 0 outside the picture.
pub const VIEW: [usize; 3] = [5, CELLS, CELLS];

/// A face in its own plane.
#[derive(Clone, Debug, PartialEq)]
pub struct FaceView {
    /// As [`VIEW`].
    pub values: Vec<f32>,
}

/// Numbers of one side as the network gives them: logits of the places, of "not in view", and of "hidden".
const LOGITS: usize = BINS + 2;
/// Numbers that the network gives: sides one after the other.
pub const OUTPUTS: usize = 4 * LOGITS;
/// Two places of a side nearer than this are the same, bins: 1 to 2 % of the face. What lies closer is told apart in the frame itself.
const SAME_BINS: f64 = 2.0;

/// Probabilities of one side.
#[derive(Clone, Debug, PartialEq)]
struct Side {
    /// Of each place; with that of "not in view" they add up to 1.
    places: Vec<f64>,
    hidden: f64,
}

/// Probabilities of all four sides: low and high along the rows, low and high along the columns.
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

    /// Probability that a side is at a place, a bin and its fraction, to within two bins.
    #[must_use]
    pub fn at(&self, side: usize, middle: f64) -> f64 {
        let share = |bin: usize| {
            // Of a bin that the window covers in part.
            let (from, to) = (bin as f64, bin as f64 + 1.0);
            (to.min(middle + SAME_BINS) - from.max(middle - SAME_BINS)).clamp(0.0, 1.0)
        };
        self.sides[side].places.iter().enumerate().map(|(bin, p)| p * share(bin)).sum()
    }

    /// The likeliest place of a side, a bin and its fraction.
    #[must_use]
    pub fn likeliest(&self, side: usize) -> f64 {
        let places = &self.sides[side].places;
        let best = (0..BINS).max_by(|i, j| places[*i].total_cmp(&places[*j])).unwrap_or(0);
        // The mean of what is around it: places between two bins are shared by both.
        let around = best.saturating_sub(1)..(best + 2).min(BINS);
        let sum: f64 = around.clone().map(|bin| places[bin]).sum();
        around.map(|bin| places[bin] * (bin as f64 + 0.5)).sum::<f64>() / sum.max(f64::MIN_POSITIVE)
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
