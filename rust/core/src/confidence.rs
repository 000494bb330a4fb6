//! The probability that a result is right, that is, every side within [`RIGHT_MM`] of the truth: that its lines are the right ones, and
//! that they were located well enough.

use crate::units::Estimate;

/// A side that is farther off is wrong, mm.
pub const RIGHT_MM: f64 = 5.0;

/// Probability that sides along the right lines are right. Errors have heavier tails than their sigmas say, since edges wave and
/// sigmas are themselves estimates: those of Student's distribution with 4 degrees of freedom.
pub(crate) fn located<'a>(sides: impl IntoIterator<Item = &'a Estimate>) -> f64 {
    sides.into_iter().map(|side| within(RIGHT_MM / side.sigma_mm.max(1e-9))).product()
}

/// Probability of lying within so many sigmas; Student's distribution with 4 degrees of freedom in closed form.
fn within(sigmas: f64) -> f64 {
    let s = sigmas * sigmas / (4.0 + sigmas * sigmas);
    s.sqrt() * (1.5 - 0.5 * s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_those_of_the_tables() {
        // Two-sided quantiles of Student's distribution with 4 degrees of freedom.
        for (sigmas, share) in [(0.741, 0.5), (2.132, 0.9), (2.776, 0.95), (4.604, 0.99), (8.610, 0.999)] {
            assert!((within(sigmas) - share).abs() < 2e-4, "{sigmas}: {}", within(sigmas));
        }
        let sides = [Estimate::new(300.0, 0.4), Estimate::new(200.0, 5.0)];
        assert!((located(&sides) - within(12.5) * within(1.0)).abs() < 1e-12);
        assert!(located(&sides[..1]) > 0.999 && located(&sides) < 0.64);
    }
}
