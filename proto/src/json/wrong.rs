//! What counts as a wrong result beside the truth: one definition for all that count wrong results.

use super::truth::TruthFace;
use boxline::confidence::RIGHT_MM;
use boxline::{BoxMeasurement, Estimate, FaceMeasurement, Px};

/// By less than the promise, but by more than this and this many of its own sigmas, it is wrong too: who reads it trusts the sigma.
const UNEXPECTED_MM: f64 = 3.0;
const UNEXPECTED_SIGMAS: f64 = 4.0;
/// Where the truth is clicked, good to some 10 px and without a scale, a corner that is farther off lies on another line.
const OTHER_LINE_PX: f64 = 25.0;

/// Whether a side is off by more than 5 mm, or by more than 3 mm and 4 of its own sigmas.
#[must_use]
pub fn is_wrong_side(found: Estimate, truth_mm: f64) -> bool {
    let error_mm = (found.value_mm - truth_mm).abs();
    // So that a number that is none is wrong.
    let right = error_mm <= RIGHT_MM && error_mm <= UNEXPECTED_MM.max(UNEXPECTED_SIGMAS * found.sigma_mm);
    !right
}

/// Whether a box has a wrong side.
#[must_use]
pub fn is_wrong_box(found: &BoxMeasurement, truth_mm: [f64; 3]) -> bool {
    let sides = [found.length, found.width, found.height];
    sides.into_iter().zip(truth_mm).any(|(side, truth_mm)| is_wrong_side(side, truth_mm))
}

/// The eight orders in which a face's four corners go round: from any of them, either way.
pub fn corner_orders() -> impl Iterator<Item = [usize; 4]> {
    (0..4).flat_map(|start| [1, 3].map(|step| [0, 1, 2, 3].map(|i| (start + step * i) % 4)))
}

impl TruthFace {
    /// Whether a measured face has a wrong side or, where the truth was clicked on a photograph, a corner on another line.
    #[must_use]
    pub fn is_wrong(&self, found: &FaceMeasurement) -> bool {
        if self.notes.click_px.is_some() {
            let distances = self.corner_distances_px(&found.corners_px);
            return distances.is_none_or(|d| !d.iter().all(|px| *px <= OTHER_LINE_PX));
        }
        let sides = [found.length, found.width].into_iter().zip(self.size_mm.unwrap_or([f64::NAN; 2]));
        sides.into_iter().any(|(side, truth_mm)| is_wrong_side(side, truth_mm))
    }

    /// How far four corners are from the true ones, px. They may start anywhere and go round either way: the best of the eight
    /// ways counts.
    #[must_use]
    pub fn corner_distances_px(&self, corners: &[Px; 4]) -> Option<[f64; 4]> {
        let truth = self.corners_px?;
        let all = corner_orders().map(|order| {
            [0, 1, 2, 3].map(|i| {
                let [u, v] = truth[order[i]];
                corners[i].distance_px(Px::new(u, v))
            })
        });
        let squares = |distances: &[f64; 4]| distances.iter().map(|d| d * d).sum::<f64>();
        all.min_by(|a, b| squares(a).total_cmp(&squares(b)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_wrong_beyond_the_promise_or_beyond_their_sigma() {
        let wrong =
            |error_mm: f64, sigma_mm: f64| is_wrong_side(Estimate::new(400.0 + error_mm, sigma_mm), 400.0);
        assert!(!wrong(2.9, 0.1) && !wrong(-3.1, 0.8) && !wrong(4.9, 1.3) && !wrong(5.0, 2.0));
        assert!(wrong(3.1, 0.7) && wrong(-4.9, 1.2) && wrong(5.1, 9.0) && wrong(-5.1, 9.0));
        assert!(wrong(f64::NAN, 1.0) && wrong(f64::INFINITY, 1.0));
    }

    #[test]
    fn corners_may_start_anywhere_and_go_either_way() {
        let truth = [[0.0, 0.0], [100.0, 0.0], [100.0, 60.0], [0.0, 60.0]];
        let face = TruthFace { corners_px: Some(truth), ..TruthFace::default() };
        let [a, b, c, d] = truth.map(|[u, v]| Px::new(u + 3.0, v + 4.0));
        for order in [[a, b, c, d], [b, c, d, a], [d, a, b, c], [d, c, b, a], [a, d, c, b]] {
            for distance in face.corner_distances_px(&order).unwrap() {
                assert!((distance - 5.0).abs() < 1e-9, "{distance}");
            }
        }
        assert_eq!(TruthFace::default().corner_distances_px(&[a, b, c, d]), None);
    }
}
