//! A share of so many tries with its interval.

use statrs::distribution::{Beta, ContinuousCDF};
use std::fmt;

/// `count` of `tries`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Share {
    pub count: usize,
    pub tries: usize,
}

impl Share {
    /// The Clopper-Pearson interval that holds the true share in at least 95 of 100 cases.
    pub fn interval_95(self) -> [f64; 2] {
        let (k, n) = (self.count as f64, self.tries as f64);
        let quantile = |a: f64, b: f64, p: f64| Beta::new(a, b).ok().map(|beta| beta.inverse_cdf(p));
        // A shape of 0 has no distribution: nothing was seen on that side.
        [quantile(k, n - k + 1.0, 0.025).unwrap_or(0.0), quantile(k + 1.0, n - k, 0.975).unwrap_or(1.0)]
    }
}

impl fmt::Display for Share {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [low, high] = self.interval_95().map(|x| 100.0 * x);
        write!(f, "{} of {} ({low:.1} to {high:.1} %)", self.count, self.tries)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of R's `binom.test`.
    #[test]
    fn intervals_as_published() {
        let near = |count, tries, expected: [f64; 2]| {
            let found = Share { count, tries }.interval_95();
            for (found, expected) in found.into_iter().zip(expected) {
                assert!((found - expected).abs() < 1e-6, "{count} of {tries}: {found}, {expected}");
            }
        };
        near(0, 10, [0.0, 0.308_497_1]);
        near(1, 10, [0.002_528_579, 0.445_016_117]);
        near(5, 10, [0.187_086_0, 0.812_914_0]);
        near(10, 10, [0.691_502_9, 1.0]);
        near(0, 0, [0.0, 1.0]);
    }
}
