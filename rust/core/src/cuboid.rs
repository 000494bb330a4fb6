//! From two faces to a box: which side they share (paper eqs. 10-11), three sides, volume, and the A x A x B case.
//!
//! Each face was fitted by itself. Both together are the least-squares fit of three sides to four lengths with their full
//! covariance, in which the side that both show is one unknown. That is the joint fit of both frames: nothing else links
//! them but the shared side and the causes that both faces have in common ([`crate::measurement::SideUncertainty`]).

use crate::measurement::{BoxMeasurement, FaceMeasurement, Outcome};
use crate::reject::Reject;
use crate::units::{Estimate, Volume};
use crate::warning::{Warning, WarningKind};
use nalgebra::{Matrix3, Matrix4, Matrix4x3, Vector3, Vector4};

/// Sides that differ by no more than this many standard deviations may be the same edge of the box.
const SAME_SIGMAS: f64 = 4.0;
/// ... and never less than this: two faces of a real box need not agree better (bulges, flaps), mm.
const SAME_MM: f64 = 2.0;
/// ... nor than this share of the side.
const SAME_SHARE: f64 = 0.004;
/// Chi-square of the difference that one sound box in a thousand exceeds.
const LIMIT: f64 = 10.83;

/// A way to put the two faces together.
#[derive(Clone, Copy, Debug)]
struct Fit {
    /// The side that both show as the first and the second face have it, then the other side of each.
    lengths: [Estimate; 4],
    /// Their covariance, mm^2.
    covariance_mm2: Matrix4<f64>,
}

impl Fit {
    /// `shared` says which side of each face is the shared one: 0 the length, 1 the width.
    fn new(first: &FaceMeasurement, second: &FaceMeasurement, shared: [usize; 2]) -> Self {
        let sides = [[first.length, first.width], [second.length, second.width]];
        let parts = [(0, shared[0]), (1, shared[1]), (0, 1 - shared[0]), (1, 1 - shared[1])];
        let faces = [first, second];
        let covariance_mm2 = Matrix4::from_fn(|row, column| {
            let ((f, i), (g, j)) = (parts[row], parts[column]);
            let (u, v) = (&faces[f].uncertainty, &faces[g].uncertainty);
            let own = if f == g { u.own_mm2[(i, j)] } else { 0.0 };
            own + u.shared_mm.row(i).dot(&v.shared_mm.row(j))
        });
        let lengths = parts.map(|(f, i)| sides[f][i]);
        // A face that came without its causes has sigmas at least.
        let least = Vector4::from(lengths.map(|l| l.sigma_mm.max(1e-6).powi(2)));
        let known = covariance_mm2.cholesky().is_some();
        Self { lengths, covariance_mm2: if known { covariance_mm2 } else { Matrix4::from_diagonal(&least) } }
    }

    fn difference_mm(&self) -> f64 {
        self.lengths[0].value_mm - self.lengths[1].value_mm
    }

    fn difference_sigma_mm(&self) -> f64 {
        let c = &self.covariance_mm2;
        (c[(0, 0)] + c[(1, 1)] - 2.0 * c[(0, 1)]).max(1e-12).sqrt()
    }

    fn limit_mm(&self) -> f64 {
        (SAME_SIGMAS * self.difference_sigma_mm()).max(SAME_MM).max(SAME_SHARE * self.lengths[0].value_mm)
    }

    fn excess(&self) -> f64 {
        self.difference_mm().abs() / self.limit_mm()
    }

    fn warning(&self) -> Option<Warning> {
        let (found, sigma) = (self.difference_mm(), self.difference_sigma_mm());
        let chi_square = (found / sigma).powi(2);
        let warning =
            Warning { kind: WarningKind::SidesDiffer, laser: None, found, sigma, chi_square, limit: LIMIT };
        (chi_square > LIMIT).then_some(warning)
    }

    fn measurement(&self) -> BoxMeasurement {
        let lengths = Vector4::from(self.lengths.map(|l| l.value_mm));
        let (sides, covariance) = self.adjusted(&lengths).unwrap_or_else(|| {
            let c = &self.covariance_mm2;
            let mean = 0.5 * (lengths[0] + lengths[1]);
            let variances = Vector3::new(c[(0, 0)].max(c[(1, 1)]), c[(2, 2)], c[(3, 3)]);
            (Vector3::new(mean, lengths[2], lengths[3]), Matrix3::from_diagonal(&variances))
        });
        let estimate = |i: usize| Estimate::new(sides[i], covariance[(i, i)].max(0.0).sqrt());
        let mut sorted = [estimate(0), estimate(1), estimate(2)];
        sorted.sort_by(|a, b| b.value_mm.total_cmp(&a.value_mm));
        let [length, width, height] = sorted;
        let value_mm3 = sides.product();
        let relative = sides.map(|s| 1.0 / s);
        let sigma = (relative.transpose() * covariance * relative)[0].max(0.0).sqrt();
        let volume = Volume { value_m3: value_mm3 * 1e-9, sigma_m3: value_mm3 * 1e-9 * sigma };
        BoxMeasurement { length, width, height, volume }
    }

    /// Three sides from four lengths by least squares, with their covariance.
    fn adjusted(&self, lengths: &Vector4<f64>) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        #[rustfmt::skip]
        let side_of = Matrix4x3::new(
            1.0, 0.0, 0.0,
            1.0, 0.0, 0.0,
            0.0, 1.0, 0.0,
            0.0, 0.0, 1.0,
        );
        let weight = self.covariance_mm2.cholesky()?.inverse();
        let covariance = (side_of.transpose() * weight * side_of).cholesky()?.inverse();
        let sides = covariance * side_of.transpose() * weight * lengths;
        sides.iter().all(|s| s.is_finite() && *s > 0.0).then_some((sides, covariance))
    }
}

/// Puts two faces together, with what was noticed. `choose` settles an A x A x B box: 0 or 1.
pub(crate) fn assemble(
    first: &FaceMeasurement,
    second: &FaceMeasurement,
    choose: Option<usize>,
) -> (Outcome, Vec<Warning>) {
    let mut fits = [[0, 0], [0, 1], [1, 0], [1, 1]].map(|shared| Fit::new(first, second, shared));
    fits.sort_by(|a, b| a.excess().total_cmp(&b.excess()));
    let mut possible: Vec<Fit> = Vec::with_capacity(2);
    for fit in fits.iter().filter(|f| f.excess() <= 1.0) {
        // Two ways that give the same box (a cube's) are one.
        if possible.iter().all(|p| !same_box(&p.measurement(), &fit.measurement())) {
            possible.push(*fit);
        }
    }
    let measured = |fit: &Fit| (Outcome::Measured(fit.measurement()), Vec::from_iter(fit.warning()));
    match possible.as_slice() {
        [] => {
            let best = &fits[0];
            let [first, second, ..] = best.lengths;
            (
                Outcome::Rejected(Reject::SidesDisagree { first, second, limit_mm: best.limit_mm() }),
                Vec::new(),
            )
        }
        [only] => measured(only),
        [one, two, ..] => match choose {
            Some(0) => measured(one),
            Some(1) => measured(two),
            _ => (Outcome::Ambiguous([one.measurement(), two.measurement()]), Vec::from_iter(one.warning())),
        },
    }
}

/// Whether two outcomes are the same box within their uncertainties.
pub(crate) fn same_outcome(a: &Outcome, b: &Outcome) -> bool {
    match (a, b) {
        (Outcome::Measured(a), Outcome::Measured(b)) => same_box(a, b),
        (Outcome::Ambiguous([a, b]), Outcome::Ambiguous([c, d])) => same_box(a, c) && same_box(b, d),
        _ => false,
    }
}

fn same_box(a: &BoxMeasurement, b: &BoxMeasurement) -> bool {
    let near = |x: Estimate, y: Estimate| {
        (x.value_mm - y.value_mm).abs()
            <= SAME_MM.max(SAME_SIGMAS * x.sigma_mm.hypot(y.sigma_mm)).max(SAME_SHARE * x.value_mm)
    };
    near(a.length, b.length) && near(a.width, b.width) && near(a.height, b.height)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::SideUncertainty;
    use nalgebra::Matrix2;

    fn face(length: f64, width: f64) -> FaceMeasurement {
        let uncertainty = SideUncertainty { own_mm2: Matrix2::identity() * 0.16, ..Default::default() };
        FaceMeasurement { uncertainty, ..FaceMeasurement::made_up(length, width) }
    }

    fn assembled(first: &FaceMeasurement, second: &FaceMeasurement, choose: Option<usize>) -> Outcome {
        assemble(first, second, choose).0
    }

    #[test]
    fn the_shared_side_is_averaged_and_the_others_kept() {
        let Outcome::Measured(b) = assembled(&face(550.0, 300.4), &face(550.6, 350.0), None) else {
            panic!()
        };
        assert!((b.length.value_mm - 550.3).abs() < 1e-9);
        assert_eq!((b.width.value_mm, b.height.value_mm), (350.0, 300.4));
        assert!((b.volume.value_m3 - 0.5503 * 0.35 * 0.3004).abs() < 1e-9);
    }

    #[test]
    fn two_equal_faces_are_ambiguous_until_chosen() {
        let (a, b) = (face(500.0, 300.0), face(500.3, 300.2));
        let Outcome::Ambiguous(c) = assembled(&a, &b, None) else { panic!() };
        assert!((c[0].width.value_mm - c[1].width.value_mm).abs() > 100.0);
        for (i, candidate) in c.iter().enumerate() {
            assert_eq!(assembled(&a, &b, Some(i)), Outcome::Measured(*candidate));
        }
    }

    #[test]
    fn a_cube_is_not_ambiguous() {
        assert!(matches!(assembled(&face(300.2, 300.0), &face(300.1, 299.9), None), Outcome::Measured(_)));
    }

    #[test]
    fn faces_of_two_boxes_are_refused_with_the_numbers() {
        let Outcome::Rejected(Reject::SidesDisagree { first, second, limit_mm }) =
            assembled(&face(500.0, 300.0), &face(420.0, 250.0), None)
        else {
            panic!()
        };
        assert!((first.value_mm - second.value_mm).abs() > limit_mm);
    }

    #[test]
    fn what_both_faces_share_does_not_average_out() {
        let shared = SideUncertainty { own_mm2: Matrix2::identity() * 0.04, ..SideUncertainty::default() };
        // One cause that scales everything by a thousandth.
        let scaled = |length: f64, width: f64| {
            let mut uncertainty = shared;
            uncertainty.shared_mm[(0, 0)] = length * 1e-3;
            uncertainty.shared_mm[(1, 0)] = width * 1e-3;
            FaceMeasurement { uncertainty, ..face(length, width) }
        };
        let Outcome::Measured(b) = assembled(&scaled(550.0, 300.0), &scaled(550.2, 350.0), None) else {
            panic!()
        };
        assert!((b.length.sigma_mm - (0.02f64 + 0.55 * 0.55).sqrt()).abs() < 1e-3, "{:?}", b.length);
        // Three sides of a common scale: three thousandths of the volume, not the square root of three.
        let relative = b.volume.sigma_m3 / b.volume.value_m3;
        assert!((3.0e-3..3.3e-3).contains(&relative), "{relative}");
    }

    #[test]
    fn a_shared_side_that_differs_beyond_its_sigmas_is_told() {
        let (outcome, warnings) = assemble(&face(500.0, 300.0), &face(501.9, 350.0), None);
        assert!(matches!(outcome, Outcome::Measured(_)));
        let [warning] = warnings[..] else { panic!("{warnings:?}") };
        assert_eq!(warning.kind, WarningKind::SidesDiffer);
        assert!((warning.found + 1.9).abs() < 1e-9 && (warning.sigma - 0.566).abs() < 0.01);
        assert!(assemble(&face(500.0, 300.0), &face(501.0, 350.0), None).1.is_empty());
    }
}
