//! Shares with their intervals, and how well stated probabilities hold.

use serde::Serialize;
use statrs::distribution::{Beta, ContinuousCDF};

/// So many of so many.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Share {
    pub count: usize,
    pub of: usize,
    /// The Clopper-Pearson interval of 95 %; 0 to 1 if there are none.
    pub interval: [f64; 2],
}

impl Share {
    pub fn new(count: usize, of: usize) -> Self {
        Self { count, of, interval: clopper_pearson(count, of) }
    }

    /// `None` of none.
    pub fn value(&self) -> Option<f64> {
        (self.of > 0).then(|| self.count as f64 / self.of as f64)
    }
}

/// The exact interval of a binomial share: with less than 2.5 % probability so many or more would be seen at its lower end, so many or
/// fewer at its upper end (Clopper and Pearson, Biometrika 26, 1934).
pub fn clopper_pearson(count: usize, of: usize) -> [f64; 2] {
    let quantile = |a: usize, b: usize, p: f64| {
        let beta = Beta::new(a as f64, b as f64).expect("both parameters are 1 or more");
        beta.inverse_cdf(p)
    };
    let (count, missed) = (count.min(of), of.saturating_sub(count));
    [
        if count == 0 { 0.0 } else { quantile(count, missed + 1, 0.025) },
        if missed == 0 { 1.0 } else { quantile(count + 1, missed, 0.975) },
    ]
}

/// A result with its stated probability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stated {
    pub probability: f64,
    pub right: bool,
}

/// Results with about the same stated probability.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bin {
    /// From (included) and to, the last one to 1.
    pub from: f64,
    pub to: f64,
    /// Mean of what was stated.
    pub stated: f64,
    /// What was observed.
    pub right: Share,
}

/// Bounds of the bins: narrow where most results are.
const BINS: [f64; 9] = [0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0];

/// The bins that hold something.
pub fn reliability(all: &[Stated]) -> Vec<Bin> {
    let bin = |bounds: &[f64]| {
        let (from, to) = (bounds[0], bounds[1]);
        let inside = |s: &&Stated| s.probability >= from && (s.probability < to || to == 1.0);
        let inside: Vec<&Stated> = all.iter().filter(inside).collect();
        let count = inside.len();
        (count > 0).then(|| Bin {
            from,
            to,
            stated: inside.iter().map(|s| s.probability).sum::<f64>() / count as f64,
            right: Share::new(inside.iter().filter(|s| s.right).count(), count),
        })
    };
    BINS.windows(2).filter_map(bin).collect()
}

/// Expected calibration error: how far stated and observed are apart, a mean over the bins by what they hold. `None` of none.
pub fn calibration_error(bins: &[Bin]) -> Option<f64> {
    let all: usize = bins.iter().map(|b| b.right.of).sum();
    let apart = |b: &Bin| (b.stated * b.right.of as f64 - b.right.count as f64).abs();
    (all > 0).then(|| bins.iter().map(apart).sum::<f64>() / all as f64)
}

/// What a limit on the stated probability leaves.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Limited {
    /// The lowest probability that counts.
    pub limit: f64,
    /// Results that have it.
    pub results: usize,
    pub wrong: usize,
}

/// Results and wrong ones as the limit falls from the highest probability to the lowest.
pub fn limits(all: &[Stated]) -> Vec<Limited> {
    let mut sorted = all.to_vec();
    sorted.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    let (mut found, mut results, mut wrong) = (Vec::new(), 0, 0);
    for same in sorted.chunk_by(|a, b| a.probability == b.probability) {
        results += same.len();
        wrong += same.iter().filter(|s| !s.right).count();
        found.push(Limited { limit: same[0].probability, results, wrong });
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Newcombe, Statistics in Medicine 17, 1998, Table I, method 5.
    #[test]
    fn intervals_as_published() {
        for (count, of, published) in [
            (81, 263, [0.2527, 0.3676]),
            (15, 148, [0.0578, 0.1617]),
            (0, 20, [0.0, 0.1684]),
            (1, 29, [0.0009, 0.1776]),
        ] {
            let found = clopper_pearson(count, of);
            for (found, published) in found.into_iter().zip(published) {
                assert!(
                    (found - published).abs() < 5.1e-5,
                    "{count} of {of}: {found}, {published} is published"
                );
            }
        }
    }

    #[test]
    fn intervals_at_the_ends() {
        assert_eq!(clopper_pearson(0, 0), [0.0, 1.0]);
        for of in [1, 10, 400, 100_000] {
            // (1 - p)^n = 0.025.
            let most = 1.0 - 0.025f64.powf(1.0 / of as f64);
            let ([low, high], [low_all, high_all]) = (clopper_pearson(0, of), clopper_pearson(of, of));
            assert!(low == 0.0 && (high - most).abs() < 1e-9, "{high}, {most} is right");
            assert!(high_all == 1.0 && (low_all - (1.0 - most)).abs() < 1e-9, "{low_all}");
        }
    }

    fn stated(all: &[(f64, bool)]) -> Vec<Stated> {
        all.iter().map(|&(probability, right)| Stated { probability, right }).collect()
    }

    #[test]
    fn stated_against_observed() {
        let all =
            stated(&[(0.75, true), (0.77, false), (0.99, true), (1.0, true), (0.98, true), (0.2, false)]);
        let bins = reliability(&all);
        let counts: Vec<_> = bins.iter().map(|b| (b.from, b.to, b.right.count, b.right.of)).collect();
        assert_eq!(counts, [(0.0, 0.3, 0, 1), (0.7, 0.8, 1, 2), (0.98, 1.0, 3, 3)]);
        assert!((bins[1].stated - 0.76).abs() < 1e-12);
        // 1/6 |0.2 - 0| + 2/6 |0.76 - 0.5| + 3/6 |0.99 - 1|
        let error = calibration_error(&bins).unwrap();
        assert!((error - (0.2 + 2.0 * 0.26 + 3.0 * 0.01) / 6.0).abs() < 1e-12, "{error}");
        assert_eq!(calibration_error(&[]), None);
    }

    #[test]
    fn fewer_are_wrong_with_a_higher_limit() {
        let all = stated(&[(0.9, true), (0.6, false), (0.95, true), (0.6, true), (0.99, false)]);
        let of = |limit, results, wrong| Limited { limit, results, wrong };
        assert_eq!(limits(&all), [of(0.99, 1, 1), of(0.95, 2, 1), of(0.9, 3, 1), of(0.6, 5, 2)]);
    }
}
