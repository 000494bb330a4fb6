//! The probability that a result is right, that is, every side within [`RIGHT_MM`] of the truth: that its lines are the right ones, and
//! that they were located well enough.

use crate::units::Estimate;

/// A side that is farther off is wrong, mm.
pub const RIGHT_MM: f64 = 5.0;

/// Probability that sides along the right lines are right. Errors have heavier tails than their sigmas say, since edges wave and
/// sigmas are themselves estimates: those of Student's distribution with 8 degrees of freedom.
pub(crate) fn located<'a>(sides: impl IntoIterator<Item = &'a Estimate>) -> f64 {
    sides.into_iter().map(|side| within(RIGHT_MM / side.sigma_mm.max(1e-9))).product()
}

/// Probability of lying within so many sigmas; Student's distribution with 8 degrees of freedom in closed form (Abramowitz and Stegun,
/// 26.7.4).
fn within(sigmas: f64) -> f64 {
    let cosine2 = 8.0 / (8.0 + sigmas * sigmas);
    let sum = 1.0 + cosine2 * (1.0 / 2.0 + cosine2 * (3.0 / 8.0 + cosine2 * 15.0 / 48.0));
    (1.0 - cosine2).sqrt() * sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_those_of_the_tables() {
        // Two-sided quantiles of Student's distribution with 8 degrees of freedom.
        for (sigmas, share) in [(0.706, 0.5), (1.860, 0.9), (2.306, 0.95), (3.355, 0.99), (5.041, 0.999)] {
            assert!((within(sigmas) - share).abs() < 5e-4, "{sigmas}: {}", within(sigmas));
        }
        let sides = [Estimate::new(300.0, 0.4), Estimate::new(200.0, 5.0)];
        assert!((located(&sides) - within(12.5) * within(1.0)).abs() < 1e-12);
        assert!(located(&sides[..1]) > 0.999 && located(&sides) < 0.66);
    }
}
