//! What a result is worth beside the truth: errors of sides and pixels, and whether a refusal or a measurement was due.

use boxline::confidence::RIGHT_MM;
use boxline::{
    BoxMeasurement, Candidate, Estimate, FaceMeasurement, FaceOutcome, Method, Outcome, Px, Warning,
};
use boxline_proto::json::{TruthFace, is_wrong_side};

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
    /// Where the truth was clicked on a photograph: does a corner lie on another line? Sides are not judged there.
    pub other_line: Option<bool>,
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
    /// A corner is so many px from where it was clicked.
    OtherLine(f64),
}

impl Verdict {
    /// For tables and JSON.
    pub fn text(&self) -> String {
        match self {
            Self::Right => "right".into(),
            Self::OtherReason => "right, but for another reason".into(),
            Self::Undecided => "undecided".into(),
            Self::MeasuredInsteadOfRefused => "WRONG: measured, a refusal was due".into(),
            Self::RefusedInsteadOfMeasured => "missed: refused, a measurement was due".into(),
            Self::TooFarOff(error_mm) => format!("WRONG: off by {error_mm:.1} mm"),
            Self::OtherLine(px) => format!("WRONG: a corner off by {px:.0} px"),
        }
    }

    /// Is it one that must not happen?
    pub fn is_wrong(&self) -> bool {
        matches!(self, Self::MeasuredInsteadOfRefused | Self::TooFarOff(_) | Self::OtherLine(_))
    }

    /// Is it a measurement that was due and is not there?
    pub const fn is_missed(&self) -> bool {
        matches!(self, Self::RefusedInsteadOfMeasured)
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
        let corners = measured
            .and_then(|face| truth.corner_distances_px(&face.corners_px))
            .map(|px| distances(&px.map(|d| d * d)));
        let key_points = measured.and_then(|face| key_point_distances(face, truth));
        Self {
            frame: truth.frame.clone(),
            truth_mm: truth.size_mm,
            other_line: truth.notes.click_px.and(measured).map(|face| truth.is_wrong(face)),
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

    /// Measured minus true, length and width, mm; `None` where the truth was clicked.
    pub fn errors_mm(&self) -> Option<[f64; 2]> {
        let (sides, truth) = self.sides().zip(self.truth_mm).filter(|_| self.other_line.is_none())?;
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
            (_, _, Some((sides, truth_mm))) if self.other_line.is_none() && any_wrong(&sides, &truth_mm) => {
                Verdict::TooFarOff(self.errors_mm().map_or(f64::NAN, |errors| worst(&errors)))
            }
            _ if self.other_line == Some(true) => {
                Verdict::OtherLine(self.corners.map_or(f64::NAN, |corners| corners.worst_px))
            }
            _ => Verdict::Right,
        }
    }
}

impl RecordingScore {
    /// Everything in this recording that must not happen, with the reason of a refusal.
    pub fn wrong(&self) -> Vec<String> {
        self.told(Verdict::is_wrong)
    }

    /// Every refusal in this recording where a measurement was due, with its reason.
    pub fn missed(&self) -> Vec<String> {
        self.told(Verdict::is_missed)
    }

    fn told(&self, which: impl Fn(&Verdict) -> bool) -> Vec<String> {
        let cuboid = self.cuboid.iter().map(|c| (self.name.clone(), c.verdict(), c.reason()));
        let faces =
            self.faces.iter().map(|f| (format!("{}/{}", self.name, f.frame), f.verdict(), f.reason()));
        cuboid
            .chain(faces)
            .filter(|(_, verdict, _)| which(verdict))
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
        self.errors_mm.iter().filter(|e| e.abs() <= RIGHT_MM).count()
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
            straightness: Default::default(),
            light: None,
            enclosing: [Estimate::default(); 2],
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

    /// On a photograph lines are judged, whatever the sides are: the truth has no scale.
    #[test]
    fn verdicts_on_clicked_faces() {
        let verdict = |shift_px: f64| {
            let corners = CORNERS.map(|[u, v]| [u + shift_px, v]);
            let mut clicked = truth([170.0, 90.0], None);
            clicked.notes.click_px = Some(4.0);
            let outcome = FaceOutcome::Measured(Box::new(face(corners, [[0.0; 2]; 2])));
            let score = FaceScore::new(&clicked, false, outcome);
            assert_eq!(score.errors_mm(), None);
            score.verdict()
        };
        assert_eq!(verdict(20.0), Verdict::Right);
        assert_eq!(verdict(30.0), Verdict::OtherLine(30.0));
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
