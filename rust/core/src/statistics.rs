//! Robust statistics, once for all stages: medians, the standard deviation that a median of residuals stands for, Tukey's weights.

/// Median of the absolute values of a normal distribution, in standard deviations.
pub(crate) const MEDIAN_SIGMAS: f64 = 0.6745;
/// Tukey's constant: residuals beyond so many sigmas do not count, which leaves 95 % of the efficiency for normal ones (Huber and Ronchetti,
/// Robust Statistics, 2nd ed., 4.8).
pub const TUKEY: f64 = 4.685;

/// The middle value, of an even number the upper one; `None` of none.
#[must_use]
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut all: Vec<f64> = values.into_iter().collect();
    let middle = all.len() / 2;
    (!all.is_empty()).then(|| *all.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Standard deviation of normal residuals about zero, from the median of their absolute values; `None` of none.
#[must_use]
pub fn robust_sigma(residuals: impl IntoIterator<Item = f64>) -> Option<f64> {
    median(residuals.into_iter().map(f64::abs)).map(|median| median / MEDIAN_SIGMAS)
}

/// As [`median`], in place.
pub(crate) fn median_f32(values: &mut [f32]) -> Option<f32> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// The value up to which half of the weight lies, of values and their weights; `None` without weight.
pub(crate) fn weighted_median_f32(values: &mut [(f32, f32)]) -> Option<f32> {
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|(_, weight)| weight).sum::<f32>();
    let mut sum = 0.0;
    let found = values.iter().find(|(_, weight)| {
        sum += weight;
        sum > half
    });
    found.map(|(value, _)| *value)
}

/// As [`robust_sigma`], in place; of absolute values.
pub(crate) fn robust_sigma_f32(absolute: &mut [f32]) -> Option<f32> {
    median_f32(absolute).map(|median| median / MEDIAN_SIGMAS as f32)
}

/// Tukey's weight of a residual of so many sigmas, 0 to 1.
#[must_use]
pub fn tukey_weight(sigmas: f64) -> f64 {
    (1.0 - (sigmas / TUKEY).powi(2)).max(0.0).powi(2)
}

/// Chi-square that one sound case in a thousand exceeds, with 1 to 4 degrees of freedom.
pub(crate) const fn chi_square_limit(degrees: usize) -> f64 {
    const AT_0_999: [f64; 4] = [10.83, 13.82, 16.27, 18.47];
    AT_0_999[degrees - 1]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::Noise;

    #[test]
    fn a_tenth_of_gross_errors_leaves_the_sigma_as_it_is() {
        let mut noise = Noise::new(1);
        let residuals: Vec<f64> =
            (0..2000).map(|i| if i % 10 == 0 { 100.0 } else { 2.0 * noise.normal() }).collect();
        let sigma = robust_sigma(residuals.iter().copied()).expect("there are some");
        assert!((2.0..2.5).contains(&sigma), "{sigma}");
        let mut absolute: Vec<f32> = residuals.iter().map(|r| r.abs() as f32).collect();
        let single = robust_sigma_f32(&mut absolute).expect("there are some");
        assert!((f64::from(single) - sigma).abs() < 1e-5, "{single} {sigma}");
        assert!(median([]).is_none() && median_f32(&mut []).is_none());
    }

    #[test]
    fn a_weighted_median_is_that_of_values_that_stand_as_often_as_they_weigh() {
        let mut values = [(5.0, 1.0), (1.0, 2.0), (9.0, 0.0), (3.0, 4.0)];
        assert_eq!(weighted_median_f32(&mut values), median_f32(&mut [1.0, 1.0, 3.0, 3.0, 3.0, 3.0, 5.0]));
        assert_eq!(weighted_median_f32(&mut [(9.0, 0.0), (2.0, 0.1)]), Some(2.0));
        assert!(weighted_median_f32(&mut []).is_none() && weighted_median_f32(&mut [(1.0, 0.0)]).is_none());
    }

    #[test]
    fn weights_fall_to_nothing_at_the_constant() {
        assert_eq!(tukey_weight(0.0), 1.0);
        assert!(tukey_weight(2.0) > tukey_weight(-3.0) && tukey_weight(TUKEY) == 0.0);
    }
}
