//! What a call gives: the outcome with everything that led to it.

use crate::feasibility::Hint;
use crate::measurement::{BoxMeasurement, Candidate, DepthEstimate, FaceOutcome, Outcome, StageTimes};
use crate::reject::Reject;
use crate::units::{Estimate, Volume};
use crate::warning::Warning;

/// What became of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FaceReport {
    /// The result.
    pub outcome: FaceOutcome,
    /// For a view that was refused: how to move, if moving helps.
    pub hint: Option<Hint>,
    /// How long each stage took.
    pub times: StageTimes,
}

/// What became of two or three frames of a box.
#[derive(Clone, Debug, PartialEq)]
pub struct BoxReport {
    /// The result.
    pub outcome: Outcome,
    /// What each of the two or three frames gave, in their order.
    pub faces: Vec<FaceOutcome>,
    /// Checks between the faces that failed; those of a face stand with it.
    pub warnings: Vec<Warning>,
    /// What told an A x A x B box from A x B x B, if that was needed and seen.
    pub settled: Option<DepthEstimate>,
    /// Probability that every side of a measured or ambiguous box is within 5 mm ([`crate::confidence`]). `None` on the paper's map.
    pub confidence: Option<f64>,
    /// Of a refused box the two likeliest, fewer if the faces that the frames may show make fewer. None is likely enough to be a result.
    /// An A x A x B box that no stripe settles stands there as both that it may be, each with half of the probability.
    pub likeliest: Vec<Candidate>,
    /// For each frame whose view was refused: how to move, if moving helps.
    pub hints: Vec<Option<Hint>>,
    /// How long each stage took, all frames together; empty in a decoded message.
    pub times: StageTimes,
}

impl BoxReport {
    /// How to move for a frame, if moving helps.
    #[must_use]
    pub fn hint(&self, frame: usize) -> Option<&Hint> {
        self.hints.get(frame)?.as_ref()
    }

    /// Whether two frames leave open what one of a third face may settle: each of their sides is seen once more in it.
    #[must_use]
    pub fn third_face_helps(&self) -> bool {
        let doubtful =
            |reject: &Reject| matches!(reject, Reject::OutlineUnsure { .. } | Reject::FaceHidden { .. });
        let one_is_good = self.faces.iter().any(|face| match face {
            FaceOutcome::Measured(_) => true,
            FaceOutcome::Rejected(reject) => doubtful(reject),
        });
        let open = match &self.outcome {
            Outcome::Measured(_) => false,
            Outcome::Ambiguous(_) => true,
            Outcome::Rejected(reject) => {
                one_is_good && (doubtful(reject) || matches!(reject, Reject::SidesDisagree { .. }))
            }
        };
        open && self.faces.len() == 2
    }

    /// The smallest box of this direction that encloses a measured one, edges that bow and wave included: what a tunnel on a belt reads.
    /// Each side with the most that a face which shows it needs beyond its best rectangle.
    #[must_use]
    pub fn enclosing(&self) -> Option<BoxMeasurement> {
        let Outcome::Measured(sides) = &self.outcome else { return None };
        let sides = [sides.length, sides.width, sides.height];
        let faces = self.faces.iter().filter_map(FaceOutcome::measured);
        let (mut enclosing, mut most_mm) = (sides, [0.0; 3]);
        for (own, around) in
            faces.flat_map(|face| [(face.length, face.enclosing[0]), (face.width, face.enclosing[1])])
        {
            let off_mm = |i: &usize| (sides[*i].value_mm - own.value_mm).abs();
            let Some(i) = (0..3).min_by(|i, j| off_mm(i).total_cmp(&off_mm(j))) else { continue };
            let beyond_mm = around.value_mm - own.value_mm;
            if beyond_mm > most_mm[i] {
                most_mm[i] = beyond_mm;
                let beyond_mm2 = (around.sigma_mm.powi(2) - own.sigma_mm.powi(2)).max(0.0);
                let sigma_mm = (sides[i].sigma_mm.powi(2) + beyond_mm2).sqrt();
                enclosing[i] = Estimate::new(sides[i].value_mm + beyond_mm, sigma_mm);
            }
        }
        enclosing.sort_by(|a, b| b.value_mm.total_cmp(&a.value_mm));
        let [length, width, height] = enclosing;
        let value_m3 = enclosing.iter().map(|side| side.value_mm * 1e-3).product::<f64>();
        let relative2: f64 = enclosing.iter().map(|side| (side.sigma_mm / side.value_mm).powi(2)).sum();
        let volume = Volume { value_m3, sigma_m3: value_m3 * relative2.sqrt() };
        Some(BoxMeasurement { length, width, height, volume })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::FaceMeasurement;

    #[test]
    fn a_side_is_enclosed_as_far_as_the_face_that_bows_most() {
        let face = |length_mm: f64, width_mm: f64, beyond_mm: [f64; 2]| {
            let mut face = FaceMeasurement::made_up(length_mm, width_mm);
            for (enclosing, beyond_mm) in face.enclosing.iter_mut().zip(beyond_mm) {
                *enclosing = Estimate::new(enclosing.value_mm + beyond_mm, 0.5);
            }
            FaceOutcome::Measured(Box::new(face))
        };
        let estimate = |value_mm| Estimate::new(value_mm, 0.4);
        let volume = Volume { value_m3: 0.06, sigma_m3: 0.0001 };
        let sides = BoxMeasurement {
            length: estimate(500.0),
            width: estimate(400.0),
            height: estimate(300.0),
            volume,
        };
        let mut report = BoxReport {
            outcome: Outcome::Measured(sides),
            faces: vec![face(500.4, 300.2, [2.0, 0.0]), face(499.8, 399.9, [3.0, 1.0])],
            warnings: Vec::new(),
            settled: None,
            confidence: None,
            likeliest: Vec::new(),
            hints: Vec::new(),
            times: Vec::new(),
        };
        let around = report.enclosing().expect("it is measured");
        for (side, due) in
            [(around.length, (503.0, 0.5)), (around.width, (401.0, 0.5)), (around.height, (300.0, 0.4))]
        {
            assert!(
                (side.value_mm - due.0).abs() < 1e-9 && (side.sigma_mm - due.1).abs() < 1e-9,
                "{side:?} {due:?}"
            );
        }
        assert!((around.volume.value_m3 - 0.503 * 0.401 * 0.3).abs() < 1e-9);
        report.outcome = Outcome::Rejected(Reject::RectangleOpen { sides_found: 3 });
        assert_eq!(report.enclosing(), None);
    }
}
