//! The probability that a result is right, that is, every side within [`RIGHT_MM`] of the truth: that its lines are the right ones, and
//! that they were located well enough.

use crate::units::Estimate;

/// A side that is farther off is wrong, mm.
pub const RIGHT_MM: f64 = 5.0;

/// Errors of sides along the right lines over their sigmas: Student's distribution with 6 degrees of freedom of this width (maximum
/// likelihood, 672 sides of boxes of the learning and choosing seeds measured without any limit: 2.4 of them are stated to be off by more
/// than 5 mm, 2 are). Edges wave and sigmas are themselves estimates, hence the tails; lines beside an edge make most sigmas too large,
/// hence the width.
const WIDTH: f64 = 0.65;

/// Probability that sides along the right lines are right.
pub(crate) fn located<'a>(sides: impl IntoIterator<Item = &'a Estimate>) -> f64 {
    sides.into_iter().map(|side| within(RIGHT_MM / (WIDTH * side.sigma_mm).max(1e-9))).product()
}

/// Probability of lying within so many widths; Student's distribution with 6 degrees of freedom in closed form (Abramowitz and Stegun,
/// 26.7.4).
fn within(widths: f64) -> f64 {
    let cosine2 = 6.0 / (6.0 + widths * widths);
    let sum = 1.0 + cosine2 * (1.0 / 2.0 + cosine2 * 3.0 / 8.0);
    (1.0 - cosine2).sqrt() * sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_those_of_the_tables() {
        // Two-sided quantiles of Student's distribution with 6 degrees of freedom.
        for (widths, share) in [(0.718, 0.5), (1.943, 0.9), (2.447, 0.95), (3.707, 0.99), (5.959, 0.999)] {
            assert!((within(widths) - share).abs() < 5e-4, "{widths}: {}", within(widths));
        }
        let sides = [Estimate::new(300.0, 0.5), Estimate::new(200.0, 5.0)];
        assert!((located(&sides) - within(15.384615384615385) * within(1.5384615384615385)).abs() < 1e-12);
        assert!(
            located(&sides[..1]) > 0.999 && (0.82..0.83).contains(&located(&sides)),
            "{}",
            located(&sides)
        );
    }
}
