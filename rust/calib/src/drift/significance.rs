//! Is the change real? Chi-square of what the faces say about the observable directions, against the calibration's own
//! covariance and theirs.

use super::Direction;
use boxline::face_geometry::laser_motion::{MotionMatrix, Motions};
use nalgebra::{DMatrix, DVector};

/// A change is called real if chance alone gives a larger one in less than one of a hundred cases.
pub const SIGNIFICANT: f64 = 0.01;

/// The test of "no laser has moved".
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChangeTest {
    /// Squared change in units of its covariance.
    pub chi_square: f64,
    /// Observable directions.
    pub degrees_of_freedom: usize,
    /// Probability of so large a value, or a larger one, if nothing moved.
    pub p_value: f64,
}

impl ChangeTest {
    /// Whether the change is significant ([`SIGNIFICANT`]).
    #[must_use]
    pub fn significant(&self) -> bool {
        self.p_value < SIGNIFICANT
    }
}

/// Tests the estimate `motions` (posterior; the prior's part is taken out again).
pub(super) fn test(
    directions: &[Direction],
    units: &MotionMatrix,
    motions: &Motions,
    calibrated: &MotionMatrix,
) -> ChangeTest {
    let nothing = ChangeTest { chi_square: 0.0, degrees_of_freedom: 0, p_value: 1.0 };
    let observable: Vec<&Direction> = directions.iter().filter(|d| d.observable()).collect();
    let n = observable.len();
    let (Some(inverse), true) = (units.try_inverse(), n > 0) else { return nothing };
    let estimate = inverse * motions;
    let own = inverse * calibrated * inverse.transpose();
    // At the posterior's maximum the faces alone would have gone farther: y (1 + 1 / eigenvalue).
    let change = DVector::from_fn(n, |i, _| {
        observable[i].vector.dot(&estimate) * (1.0 + 1.0 / observable[i].eigenvalue)
    });
    let covariance = DMatrix::from_fn(n, n, |i, j| {
        let own = (observable[i].vector.transpose() * own * observable[j].vector)[0];
        own + if i == j { 1.0 / observable[i].eigenvalue } else { 0.0 }
    });
    let Some(factor) = covariance.cholesky() else { return nothing };
    let chi_square = change.dot(&factor.solve(&change));
    ChangeTest { chi_square, degrees_of_freedom: n, p_value: chi_square_beyond(chi_square, n) }
}

/// Probability that chi^2 of `freedom` degrees exceeds `x`: Q(k/2, x/2), by the recurrence Q(a + 1, y) = Q(a, y) + y^a e^-y /
/// Gamma(a + 1) from Q(1, y) = e^-y or Q(1/2, y) = erfc(sqrt y) (Abramowitz and Stegun 6.5.21, 6.5.17).
pub(crate) fn chi_square_beyond(x: f64, freedom: usize) -> f64 {
    if freedom == 0 || x <= 0.0 || x.is_nan() {
        return 1.0;
    }
    let y = 0.5 * x;
    let (mut a, mut q) =
        if freedom.is_multiple_of(2) { (1.0, (-y).exp()) } else { (0.5, libm::erfc(y.sqrt())) };
    while a < 0.5 * freedom as f64 - 0.25 {
        q += (a * y.ln() - y - libm::lgamma(a + 1.0)).exp();
        a += 1.0;
    }
    q.clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Quantiles from the tables of any statistics book.
    #[test]
    fn tables_of_chi_square() {
        for (freedom, quantile, beyond) in [
            (1, 3.841, 0.05),
            (1, 6.635, 0.01),
            (2, 9.210, 0.01),
            (8, 20.090, 0.01),
            (11, 24.725, 0.01),
            (11, 5.578, 0.90),
            (12, 32.909, 0.001),
        ] {
            let found = chi_square_beyond(quantile, freedom);
            assert!((found / beyond - 1.0).abs() < 2e-3, "{freedom} {quantile}: {found}");
        }
        assert_eq!(chi_square_beyond(-1.0, 3), 1.0);
        assert_eq!(chi_square_beyond(f64::NAN, 3), 1.0);
        assert!(chi_square_beyond(1e6, 3) >= 0.0);
    }
}
