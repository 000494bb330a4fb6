//! From two faces to a box: which side they share (paper eqs. 10-11), three sides, volume, and the A x A x B case.

use crate::measurement::{BoxMeasurement, FaceMeasurement, Outcome};
use crate::reject::Reject;
use crate::units::{Estimate, Volume};

/// Sides that differ by no more than this many standard deviations may be the same edge of the box.
const SAME_SIGMAS: f64 = 4.0;
/// ... and never less than this: two faces of a real box need not agree better (bulges, flaps), mm.
const SAME_MM: f64 = 2.0;
/// ... nor than this share of the side.
const SAME_SHARE: f64 = 0.004;

/// A way to put the two faces together.
#[derive(Clone, Copy, Debug)]
struct Fit {
    /// The side that both show, first and second face.
    shared: [Estimate; 2],
    /// The other side of each.
    others: [Estimate; 2],
}

impl Fit {
    fn difference_mm(&self) -> f64 {
        (self.shared[0].value_mm - self.shared[1].value_mm).abs()
    }

    fn limit_mm(&self) -> f64 {
        let sigma = self.shared[0].sigma_mm.hypot(self.shared[1].sigma_mm);
        (SAME_SIGMAS * sigma).max(SAME_MM).max(SAME_SHARE * self.shared[0].value_mm)
    }

    fn measurement(&self) -> BoxMeasurement {
        let mut sides = [mean(self.shared), self.others[0], self.others[1]];
        sides.sort_by(|a, b| b.value_mm.total_cmp(&a.value_mm));
        let [length, width, height] = sides;
        BoxMeasurement { length, width, height, volume: volume(&sides) }
    }
}

/// Puts two faces together. `choose` settles an A x A x B box: 0 or 1.
pub(crate) fn assemble(first: &FaceMeasurement, second: &FaceMeasurement, choose: Option<usize>) -> Outcome {
    let (f, s) = ([first.length, first.width], [second.length, second.width]);
    let mut fits = Vec::with_capacity(4);
    for i in 0..2 {
        for j in 0..2 {
            fits.push(Fit { shared: [f[i], s[j]], others: [f[1 - i], s[1 - j]] });
        }
    }
    fits.sort_by(|a, b| (a.difference_mm() / a.limit_mm()).total_cmp(&(b.difference_mm() / b.limit_mm())));
    let mut possible: Vec<Fit> = Vec::with_capacity(2);
    for fit in fits.iter().filter(|f| f.difference_mm() <= f.limit_mm()) {
        // Two ways that give the same box (a cube's) are one.
        if possible.iter().all(|p| !same_box(&p.measurement(), &fit.measurement())) {
            possible.push(*fit);
        }
    }
    match possible.as_slice() {
        [] => {
            let best = &fits[0];
            Outcome::Rejected(Reject::SidesDisagree {
                first: best.shared[0],
                second: best.shared[1],
                limit_mm: best.limit_mm(),
            })
        }
        [only] => Outcome::Measured(only.measurement()),
        [one, two, ..] => match choose {
            Some(0) => Outcome::Measured(one.measurement()),
            Some(1) => Outcome::Measured(two.measurement()),
            _ => Outcome::Ambiguous([one.measurement(), two.measurement()]),
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

/// Weighted mean of two measurements of one side. The part that both share (rounding, drift) does not average out: the
/// standard deviation is that of the better one times 1/sqrt(2) at best.
fn mean([x, y]: [Estimate; 2]) -> Estimate {
    let (wx, wy) = (x.sigma_mm.max(1e-6).powi(-2), y.sigma_mm.max(1e-6).powi(-2));
    let value_mm = (x.value_mm * wx + y.value_mm * wy) / (wx + wy);
    Estimate::new(value_mm, (1.0 / (wx + wy)).sqrt())
}

fn volume(sides: &[Estimate; 3]) -> Volume {
    let value_mm3: f64 = sides.iter().map(|s| s.value_mm).product();
    let relative: f64 = sides.iter().map(|s| (s.sigma_mm / s.value_mm).powi(2)).sum::<f64>().sqrt();
    Volume { value_m3: value_mm3 * 1e-9, sigma_m3: value_mm3 * 1e-9 * relative }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::{Plane, Point};
    use crate::units::Px;

    fn face(length: f64, width: f64) -> FaceMeasurement {
        let origin = Px::new(0.0, 0.0);
        FaceMeasurement {
            length: Estimate::new(length, 0.4),
            width: Estimate::new(width, 0.4),
            plane: Plane::new(nalgebra::Vector3::z() * 1e-3),
            corners_px: [origin; 4],
            corners: [Point::new(0.0, 0.0, 1000.0); 4],
            key_points_px: [[origin; 2]; 4],
            rms_px: 0.2,
            stripe_points_px: Default::default(),
            edge_points_px: Default::default(),
        }
    }

    #[test]
    fn the_shared_side_is_averaged_and_the_others_kept() {
        let Outcome::Measured(b) = assemble(&face(550.0, 300.4), &face(550.6, 350.0), None) else { panic!() };
        assert!((b.length.value_mm - 550.3).abs() < 1e-9);
        assert_eq!((b.width.value_mm, b.height.value_mm), (350.0, 300.4));
        assert!((b.volume.value_m3 - 0.5503 * 0.35 * 0.3004).abs() < 1e-9);
    }

    #[test]
    fn two_equal_faces_are_ambiguous_until_chosen() {
        let (a, b) = (face(500.0, 300.0), face(500.3, 300.2));
        let Outcome::Ambiguous(c) = assemble(&a, &b, None) else { panic!() };
        assert!((c[0].width.value_mm - c[1].width.value_mm).abs() > 100.0);
        for (i, candidate) in c.iter().enumerate() {
            assert_eq!(assemble(&a, &b, Some(i)), Outcome::Measured(*candidate));
        }
    }

    #[test]
    fn a_cube_is_not_ambiguous() {
        assert!(matches!(assemble(&face(300.2, 300.0), &face(300.1, 299.9), None), Outcome::Measured(_)));
    }

    #[test]
    fn faces_of_two_boxes_are_refused_with_the_numbers() {
        let Outcome::Rejected(Reject::SidesDisagree { first, second, limit_mm }) =
            assemble(&face(500.0, 300.0), &face(420.0, 250.0), None)
        else {
            panic!()
        };
        assert!((first.value_mm - second.value_mm).abs() > limit_mm);
    }
}
