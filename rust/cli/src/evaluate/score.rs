//! What a result is worth beside the truth: errors of sides and pixels, and whether a refusal or a measurement was due.

use boxline::{
    BoxMeasurement, Candidate, Estimate, FaceMeasurement, FaceOutcome, Method, Outcome, Px, Warning,
};
use boxline_proto::json::TruthFace;

/// The paper's promise: no side is off by more. A measurement beyond it is wrong, not just inexact.
pub const PROMISE_MM: f64 = 5.0;
/// A side that is off by more than this and by more than so many of its sigmas is wrong too: who reads it trusts the sigma.
const UNEXPECTED_MM: f64 = 3.0;
const UNEXPECTED_SIGMAS: f64 = 4.0;

/// Whether a side is off by more than 5 mm, or by more than 3 mm and 4 of its sigmas.
pub fn is_wrong_side(found: Estimate, truth_mm: f64) -> bool {
    let error_mm = (found.value_mm - truth_mm).abs();
    // So that a number that is none is wrong.
    let right = error_mm <= PROMISE_MM && error_mm <= UNEXPECTED_MM.max(UNEXPECTED_SIGMAS * found.sigma_mm);
    !right
}

/// One recording, judged with one method.
pub struct RecordingScore {
    pub name: String,
    pub method: Method,
    /// The box, if the recording is of one.
    pub cuboid: Option<BoxScore>,
    pub faces: Vec<FaceScore>,
    /// Nanoseconds a stage over all frames of the recording, decoding first.
    pub stages: Vec<(String, u64)>,
}

/// A box beside the true one.
pub struct BoxScore {
    pub truth_mm: [f64; 3],
    pub outcome: Outcome,
    /// Both frames show sides of the same two lengths, so two candidates are the right answer.
    pub two_are_right: bool,
    /// Its stated probability, as in [`boxline::BoxReport`].
    pub confidence: Option<f64>,
    /// The likeliest box of a refused pair.
    pub likeliest: Option<Candidate>,
    /// Checks between the two faces that failed.
    pub warnings: Vec<Warning>,
}

/// A face beside the true one.
pub struct FaceScore {
    pub frame: String,
    pub truth_mm: Option<[f64; 2]>,
    /// The frame must be refused, for this reason if one is given.
    pub refusal_due: Option<Option<String>>,
    pub outcome: FaceOutcome,
    pub corners: Option<Distances>,
    pub key_points: Option<Distances>,
}

/// How far points are from where they belong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distances {
    pub rms_px: f64,
    pub worst_px: f64,
}

/// The judgement of a result.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// As it should be.
    Right,
    /// Refused as it should be, but for another reason.
    OtherReason,
    /// Two candidates although the frames tell the box.
    Undecided,
    /// A result where a refusal was due.
    MeasuredInsteadOfRefused,
    /// A refusal where a result was due.
    RefusedInsteadOfMeasured,
    /// A result with a wrong side ([`is_wrong_side`]), and the largest error.
    TooFarOff(f64),
}

impl Verdict {
    /// For tables and JSON.
    pub fn text(&self) -> String {
        match self {
            Self::Right => "right".into(),
            Self::OtherReason => "right, but for another reason".into(),
            Self::Undecided => "undecided".into(),
            Self::MeasuredInsteadOfRefused => "WRONG: measured, a refusal was due".into(),
            Self::RefusedInsteadOfMeasured => "WRONG: refused, a measurement was due".into(),
            Self::TooFarOff(error_mm) => format!("WRONG: off by {error_mm:.1} mm"),
        }
    }

    /// Is it one that must not happen?
    pub fn is_wrong(&self) -> bool {
        matches!(self, Self::MeasuredInsteadOfRefused | Self::RefusedInsteadOfMeasured | Self::TooFarOff(_))
    }
}

impl BoxScore {
    /// The measurement; of two candidates the one that is nearer to the truth.
    pub fn measurement(&self) -> Option<BoxMeasurement> {
        match &self.outcome {
            Outcome::Measured(m) => Some(*m),
            Outcome::Ambiguous(both) => both.iter().copied().min_by(|a, b| {
                worst(&errors_of(a, self.truth_mm)).total_cmp(&worst(&errors_of(b, self.truth_mm)))
            }),
            Outcome::Rejected(_) => None,
        }
    }

    /// Measured minus true, length, width, height, mm.
    pub fn errors_mm(&self) -> Option<[f64; 3]> {
        self.measurement().map(|m| errors_of(&m, self.truth_mm))
    }

    /// Why it was refused, if it was.
    pub fn reason(&self) -> Option<&'static str> {
        match &self.outcome {
            Outcome::Rejected(reject) => Some(reject.reason()),
            _ => None,
        }
    }

    pub fn verdict(&self) -> Verdict {
        match (&self.outcome, self.measurement()) {
            (Outcome::Rejected(_), _) => Verdict::RefusedInsteadOfMeasured,
            (_, Some(m)) if any_wrong(&sides_of(&m), &self.truth_mm) => {
                Verdict::TooFarOff(worst(&errors_of(&m, self.truth_mm)))
            }
            (Outcome::Ambiguous(_), _) if !self.two_are_right => Verdict::Undecided,
            _ => Verdict::Right,
        }
    }
}

impl FaceScore {
    /// Compares a face with the truth.
    pub fn new(truth: &TruthFace, must_refuse: bool, outcome: FaceOutcome) -> Self {
        let refused = must_refuse || truth.refuse.is_some() || truth.size_mm.is_none();
        let measured = match &outcome {
            FaceOutcome::Measured(face) => Some(face.as_ref()),
            FaceOutcome::Rejected(_) => None,
        };
        let corners = measured.zip(truth.corners_px).map(|(face, true_px)| corner_distances(face, true_px));
        let key_points = measured.and_then(|face| key_point_distances(face, truth));
        Self {
            frame: truth.frame.clone(),
            truth_mm: truth.size_mm,
            refusal_due: refused.then(|| truth.refuse.clone()),
            outcome,
            corners,
            key_points,
        }
    }

    /// The measured sides.
    pub fn sides(&self) -> Option<[Estimate; 2]> {
        match &self.outcome {
            FaceOutcome::Measured(m) => Some([m.length, m.width]),
            FaceOutcome::Rejected(_) => None,
        }
    }

    /// Measured minus true, length and width, mm.
    pub fn errors_mm(&self) -> Option<[f64; 2]> {
        let (sides, truth) = self.sides().zip(self.truth_mm)?;
        Some([sides[0].value_mm - truth[0], sides[1].value_mm - truth[1]])
    }

    /// Why it was refused, if it was.
    pub fn reason(&self) -> Option<&'static str> {
        match &self.outcome {
            FaceOutcome::Rejected(reject) => Some(reject.reason()),
            FaceOutcome::Measured(_) => None,
        }
    }

    pub fn verdict(&self) -> Verdict {
        match (&self.outcome, &self.refusal_due, self.sides().zip(self.truth_mm)) {
            (FaceOutcome::Rejected(reject), Some(Some(due)), _) if due != reject.reason() => {
                Verdict::OtherReason
            }
            (FaceOutcome::Rejected(_), None, _) => Verdict::RefusedInsteadOfMeasured,
            (FaceOutcome::Measured(_), Some(_), _) => Verdict::MeasuredInsteadOfRefused,
            (_, _, Some((sides, truth_mm))) if any_wrong(&sides, &truth_mm) => {
                Verdict::TooFarOff(self.errors_mm().map_or(f64::NAN, |errors| worst(&errors)))
            }
            _ => Verdict::Right,
        }
    }
}

impl RecordingScore {
    /// Everything in this recording that must not happen, with the reason of a refusal.
    pub fn wrong(&self) -> Vec<String> {
        let cuboid = self.cuboid.iter().map(|c| (self.name.clone(), c.verdict(), c.reason()));
        let faces =
            self.faces.iter().map(|f| (format!("{}/{}", self.name, f.frame), f.verdict(), f.reason()));
        cuboid
            .chain(faces)
            .filter(|(_, verdict, _)| verdict.is_wrong())
            .map(|(name, verdict, reason)| {
                let reason = reason.map_or(String::new(), |reason| format!(" ({reason})"));
                format!("{name}, {}: {}{reason}", method_name(self.method), verdict.text())
            })
            .collect()
    }
}

/// The name of a method as on the command line.
pub fn method_name(method: Method) -> &'static str {
    match method {
        Method::Fit => "fit",
        Method::Keypoints => "keypoints",
    }
}

/// Errors with their standard deviations, summed up.
#[derive(Default)]
pub struct Statistics {
    errors_mm: Vec<f64>,
    sigmas_mm: Vec<f64>,
}

impl Statistics {
    /// Adds one side.
    pub fn add(&mut self, error_mm: f64, sigma_mm: f64) {
        self.errors_mm.push(error_mm);
        self.sigmas_mm.push(sigma_mm);
    }

    pub fn count(&self) -> usize {
        self.errors_mm.len()
    }

    pub fn mean_mm(&self) -> f64 {
        mean(self.errors_mm.iter().copied())
    }

    pub fn mean_absolute_mm(&self) -> f64 {
        mean(self.errors_mm.iter().map(|e| e.abs()))
    }

    pub fn rms_mm(&self) -> f64 {
        mean(self.errors_mm.iter().map(|e| e * e)).sqrt()
    }

    pub fn worst_mm(&self) -> f64 {
        worst(&self.errors_mm)
    }

    pub fn within_promise(&self) -> usize {
        self.errors_mm.iter().filter(|e| e.abs() <= PROMISE_MM).count()
    }

    /// Mean of (error / sigma)^2: 1 if the standard deviations are honest, more if they are too small.
    pub fn mean_z2(&self) -> f64 {
        mean(self.errors_mm.iter().zip(&self.sigmas_mm).map(|(e, s)| (e / s).powi(2)))
    }

    /// Root of the same.
    pub fn error_in_sigmas(&self) -> f64 {
        self.mean_z2().sqrt()
    }

    /// Values whose interval of 95 % holds the truth.
    pub fn covered(&self) -> usize {
        let covers = |(error, sigma): (&f64, &f64)| {
            let [low, high] = Estimate::new(*error, *sigma).interval_95_mm();
            (low..=high).contains(&0.0)
        };
        self.errors_mm.iter().zip(&self.sigmas_mm).filter(|pair| covers(*pair)).count()
    }
}

/// Puts several sets of distances together (each of equally many points).
pub fn together(all: impl Iterator<Item = Distances> + Clone) -> Option<Distances> {
    all.clone().next()?;
    Some(Distances {
        rms_px: mean(all.clone().map(|d| d.rms_px * d.rms_px)).sqrt(),
        worst_px: all.map(|d| d.worst_px).fold(0.0, f64::max),
    })
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count
}

/// The largest absolute value; NaN if there is one, so that it cannot pass for a small error.
fn worst(errors: &[f64]) -> f64 {
    errors.iter().fold(0.0, |most, e| if e.is_nan() || most.is_nan() { f64::NAN } else { e.abs().max(most) })
}

fn any_wrong(sides: &[Estimate], truth_mm: &[f64]) -> bool {
    sides.iter().zip(truth_mm).any(|(side, truth_mm)| is_wrong_side(*side, *truth_mm))
}

/// Length, width, height.
pub fn sides_of(m: &BoxMeasurement) -> [Estimate; 3] {
    [m.length, m.width, m.height]
}

fn errors_of(m: &BoxMeasurement, truth_mm: [f64; 3]) -> [f64; 3] {
    [m.length.value_mm - truth_mm[0], m.width.value_mm - truth_mm[1], m.height.value_mm - truth_mm[2]]
}

fn distances(squared: &[f64]) -> Distances {
    Distances { rms_px: mean(squared.iter().copied()).sqrt(), worst_px: worst(squared).sqrt() }
}

fn squared(found: Px, [u, v]: [f64; 2]) -> f64 {
    found.distance_px(Px::new(u, v)).powi(2)
}

/// Corners may start anywhere and go round either way: the best of the eight ways counts.
fn corner_distances(face: &FaceMeasurement, truth: [[f64; 2]; 4]) -> Distances {
    let ways = (0..4).flat_map(|start| [1, 3].map(|step| (start, step)));
    let all = ways.map(|(start, step)| {
        distances(&[0, 1, 2, 3].map(|i| squared(face.corners_px[i], truth[(start + step * i) % 4])))
    });
    all.min_by(|a, b| a.rms_px.total_cmp(&b.rms_px))
        .unwrap_or(Distances { rms_px: f64::NAN, worst_px: f64::NAN })
}

/// The two key points of a stripe come in no promised order.
fn key_point_distances(face: &FaceMeasurement, truth: &TruthFace) -> Option<Distances> {
    let mut all = Vec::new();
    for (stripe, ends) in &truth.key_points_px {
        let found = face.key_points_px.get(usize::from(*stripe).checked_sub(1)?)?;
        let straight = [squared(found[0], ends[0]), squared(found[1], ends[1])];
        let swapped = [squared(found[0], ends[1]), squared(found[1], ends[0])];
        let better = if straight[0] + straight[1] <= swapped[0] + swapped[1] { straight } else { swapped };
        all.extend(better);
    }
    (!all.is_empty()).then(|| distances(&all))
}

#[cfg(test)]
mod tests {
    use super::*;
    use boxline::frames::{Plane, Point};
    use boxline::{Reject, Volume};
    use nalgebra::Vector3;

    const CORNERS: [[f64; 2]; 4] = [[0.0, 0.0], [100.0, 0.0], [100.0, 60.0], [0.0, 60.0]];

    fn px([u, v]: [f64; 2]) -> Px {
        Px::new(u, v)
    }

    fn face(corners: [[f64; 2]; 4], key_points: [[f64; 2]; 2]) -> FaceMeasurement {
        FaceMeasurement {
            length: Estimate::new(100.0, 0.5),
            width: Estimate::new(60.0, 0.5),
            plane: Plane::new(Vector3::new(0.0, 0.0, 0.001)),
            corners_px: corners.map(px),
            corners: corners.map(|[u, v]| Point::new(u, v, 1000.0)),
            key_points_px: [key_points.map(px); 4],
            rms_px: 0.2,
            stripe_points_px: Default::default(),
            edge_points_px: Default::default(),
            uncertainty: Default::default(),
            corner_angles: None,
            warnings: Vec::new(),
            surface: Vec::new(),
            confidence: None,
        }
    }

    fn truth(size_mm: [f64; 2], refuse: Option<&str>) -> TruthFace {
        TruthFace {
            frame: "a".into(),
            size_mm: Some(size_mm),
            corners_px: Some(CORNERS),
            key_points_px: [(2, [[10.0, 0.0], [10.0, 60.0]])].into(),
            refuse: refuse.map(Into::into),
            ..TruthFace::default()
        }
    }

    #[test]
    fn corners_may_start_anywhere_and_go_either_way() {
        let shift = |corners: [[f64; 2]; 4]| corners.map(|[u, v]| [u + 3.0, v + 4.0]);
        let [a, b, c, d] = shift(CORNERS);
        for order in [[a, b, c, d], [b, c, d, a], [d, a, b, c], [d, c, b, a], [a, d, c, b]] {
            let found = corner_distances(&face(order, [[0.0; 2]; 2]), CORNERS);
            assert!((found.rms_px - 5.0).abs() < 1e-9 && (found.worst_px - 5.0).abs() < 1e-9, "{found:?}");
        }
    }

    #[test]
    fn key_points_of_a_stripe_come_in_any_order() {
        for ends in [[[10.0, 0.0], [10.0, 62.0]], [[10.0, 62.0], [10.0, 0.0]]] {
            let found = key_point_distances(&face(CORNERS, ends), &truth([100.0, 60.0], None)).unwrap();
            assert!((found.worst_px - 2.0).abs() < 1e-9, "{found:?}");
        }
    }

    #[test]
    fn verdicts_on_faces() {
        let measured = || FaceOutcome::Measured(Box::new(face(CORNERS, [[0.0; 2]; 2])));
        let refused = || FaceOutcome::Rejected(Reject::RectangleOpen { sides_found: 3 });
        let verdict = |size, refuse, must_refuse, outcome| {
            FaceScore::new(&truth(size, refuse), must_refuse, outcome).verdict()
        };
        assert_eq!(verdict([101.0, 60.0], None, false, measured()), Verdict::Right);
        assert_eq!(verdict([100.0, 66.0], None, false, measured()), Verdict::TooFarOff(6.0));
        assert_eq!(verdict([97.5, 60.0], None, false, measured()), Verdict::Right);
        assert_eq!(
            verdict([96.0, 60.0], None, false, measured()),
            Verdict::TooFarOff(4.0),
            "8 sigmas of 0.5 mm"
        );
        assert_eq!(verdict([100.0, f64::NAN], None, false, measured()).text(), "WRONG: off by NaN mm");
        assert_eq!(verdict([100.0, 60.0], None, true, measured()), Verdict::MeasuredInsteadOfRefused);
        assert_eq!(verdict([100.0, 60.0], Some("no_box"), false, refused()), Verdict::OtherReason);
        assert_eq!(verdict([100.0, 60.0], Some("rectangle_open"), true, refused()), Verdict::Right);
        assert_eq!(verdict([100.0, 60.0], None, true, refused()), Verdict::Right);
        assert_eq!(verdict([100.0, 60.0], None, false, refused()), Verdict::RefusedInsteadOfMeasured);
    }

    #[test]
    fn sides_are_wrong_beyond_the_promise_or_beyond_their_sigma() {
        let wrong =
            |error_mm: f64, sigma_mm: f64| is_wrong_side(Estimate::new(400.0 + error_mm, sigma_mm), 400.0);
        assert!(!wrong(2.9, 0.1) && !wrong(-3.1, 0.8) && !wrong(4.9, 1.3) && !wrong(5.0, 2.0));
        assert!(wrong(3.1, 0.7) && wrong(-4.9, 1.2) && wrong(5.1, 9.0) && wrong(-5.1, 9.0));
        assert!(wrong(f64::NAN, 1.0) && wrong(f64::INFINITY, 1.0));
    }

    #[test]
    fn two_candidates_are_right_only_if_the_frames_cannot_tell() {
        let cuboid = |sides: [f64; 3]| {
            let [length, width, height] = sides.map(|side| Estimate::new(side, 0.1));
            BoxMeasurement { length, width, height, volume: Volume { value_m3: 0.1, sigma_m3: 0.01 } }
        };
        let both = [cuboid([500.0, 500.0, 300.0]), cuboid([500.0, 300.0, 300.0])];
        let score = |two_are_right| BoxScore {
            truth_mm: [500.5, 300.0, 300.0],
            outcome: Outcome::Ambiguous(both),
            two_are_right,
            confidence: None,
            likeliest: None,
            warnings: Vec::new(),
        };
        assert_eq!(score(true).errors_mm(), Some([-0.5, 0.0, 0.0]));
        assert_eq!(score(true).verdict(), Verdict::Right);
        assert_eq!(score(false).verdict(), Verdict::Undecided);
    }

    #[test]
    fn statistics_of_known_numbers() {
        let mut statistics = Statistics::default();
        for (error_mm, sigma_mm) in [(3.0, 1.0), (-6.0, 2.0)] {
            statistics.add(error_mm, sigma_mm);
        }
        assert_eq!((statistics.count(), statistics.within_promise()), (2, 1));
        assert_eq!((statistics.mean_mm(), statistics.mean_absolute_mm()), (-1.5, 4.5));
        assert_eq!((statistics.worst_mm(), statistics.error_in_sigmas()), (6.0, 3.0));
        assert!((statistics.rms_mm() - 22.5_f64.sqrt()).abs() < 1e-12);
        statistics.add(-1.9, 1.0);
        assert_eq!((statistics.covered(), statistics.count()), (1, 3));
        assert!((statistics.mean_z2() - (9.0 + 9.0 + 3.61) / 3.0).abs() < 1e-12);
    }
}
