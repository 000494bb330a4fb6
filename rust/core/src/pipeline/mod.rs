//! The one place that knows all stages and runs them in order: each frame by itself (`face`), then the box that the frames show together.

mod face;
mod progress;
mod tracer;
mod track;

use crate::box_depth;
use crate::calibration::Calibration;
use crate::cuboid;
use crate::error::{Error, ErrorKind};
use crate::hypotheses::{BoxHypothesis, FaceHypotheses, LIKELIEST, likeliest_boxes};
use crate::image::Frame;
use crate::measurement::{
    BoxMeasurement, Candidate, DepthEstimate, FaceMeasurement, FaceOutcome, Outcome, Settings, StageTimes,
};
use crate::reject::Reject;
use crate::report::BoxReport;
use crate::warning::Warning;
pub use face::measure_face;
use face::{FrameResult, located, paper_network, see_face, unsure};
use progress::add_time;
use std::ops::RangeInclusive;
pub use track::{FollowedFace, LiveFace, Tracker};

/// Frames that make a box: two adjacent faces, or three.
const FRAMES: RangeInclusive<usize> = 2..=3;

const NAMES: [&str; 3] = ["first frame", "second frame", "third frame"];

/// Measures a box from frames of two or three adjacent faces. With three every side is seen twice: what one frame leaves open the others
/// tell, a wrong side shows, and an A x A x B box is never ambiguous. A third frame that cannot be measured does no harm.
///
/// # Errors
/// As [`measure_face`], for any of the frames; [`ErrorKind::InvalidFrame`] if there are not two or three, or one is given twice.
pub fn measure_box(
    frames: &[&Frame],
    calibration: &Calibration,
    settings: &Settings,
) -> Result<BoxReport, Error> {
    if !FRAMES.contains(&frames.len()) {
        let text = format!("{} frames, a box takes two or three", frames.len());
        return Err(Error::new(ErrorKind::InvalidFrame, text));
    }
    // Noise makes any two pictures differ; one picture twice would be a box of two equal faces.
    for (i, frame) in frames.iter().enumerate() {
        let same = |other: &&Frame| other.width_px() == frame.width_px() && other.rgb() == frame.rgb();
        if let Some(j) = frames[..i].iter().position(same) {
            let text =
                format!("{}: is the same picture as the {}, each is of another face", NAMES[i], NAMES[j]);
            return Err(Error::new(ErrorKind::InvalidFrame, text));
        }
    }
    let results = see_faces(frames, calibration, settings)?;
    let mut report = put_together(frames, &results, calibration, settings);
    for (face, result) in report.faces.iter().zip(results) {
        let refused = matches!(face, FaceOutcome::Rejected(_));
        report.hints.push(result.hint.filter(|_| refused));
        result.times.into_iter().for_each(|(stage, nanos)| add_time(&mut report.times, stage, nanos));
    }
    Ok(report)
}

/// Looks at each frame.
fn see_faces(
    frames: &[&Frame],
    calibration: &Calibration,
    settings: &Settings,
) -> Result<Vec<FrameResult>, Error> {
    let see = |i: usize| see_face(frames[i], calibration, settings).map_err(|e| e.in_context(NAMES[i]));
    let Some(workers) = settings.workers else {
        return (0..frames.len()).map(see).collect();
    };
    let mut found: Vec<_> = frames.iter().map(|_| None).collect();
    let mut work = found.iter_mut().enumerate().map(|(i, found)| move || *found = Some(see(i)));
    match (work.next(), work.next(), work.next()) {
        (Some(mut a), Some(mut b), Some(mut c)) => workers.both(&mut a, &mut || workers.both(&mut b, &mut c)),
        (Some(mut a), Some(mut b), None) => workers.both(&mut a, &mut b),
        (a, ..) => a.into_iter().for_each(|mut a| a()),
    }
    // What the caller's workers left out is done here.
    found.into_iter().enumerate().map(|(i, result)| result.unwrap_or_else(|| see(i))).collect()
}

/// The box that the frames show, or why there is none.
fn put_together(
    frames: &[&Frame],
    results: &[FrameResult],
    calibration: &Calibration,
    settings: &Settings,
) -> BoxReport {
    // On the paper's map nothing weighs one line against another.
    if paper_network(settings).is_some() {
        return of_measured_faces(frames, results, calibration, settings);
    }
    let of_frames: Vec<Option<&FaceHypotheses>> =
        results.iter().map(|result| result.hypotheses.as_ref().ok()).collect();
    let agree = |faces: &[Option<&FaceMeasurement>]| {
        let assembled = assemble(frames, faces, calibration, settings);
        (!matches!(assembled.outcome, Outcome::Rejected(_))).then_some(assembled)
    };
    let boxes = likeliest_boxes(&of_frames, agree, |a, b| cuboid::same_outcome(&a.outcome, &b.outcome));
    let likeliest = candidates(&boxes, settings);
    let Some(BoxHypothesis { faces, agreed, probability }) = boxes.into_iter().next() else {
        let report = of_measured_faces(frames, results, calibration, settings);
        let outcome = match report.outcome {
            Outcome::Rejected(reject) => reject,
            // Faces that agree, and so badly that they are no box of any weight.
            Outcome::Measured(_) | Outcome::Ambiguous(_) => unsure(0.0, settings, least_overlap(results)),
        };
        return BoxReport { outcome: Outcome::Rejected(outcome), ..report };
    };
    let confidence = stated(&agreed.outcome, probability, settings);
    if confidence >= settings.least_confidence {
        let of_frame = |(face, result): (&Option<&FaceMeasurement>, &FrameResult)| match face {
            Some(face) => FaceOutcome::Measured(Box::new((*face).clone())),
            None => result.outcome(),
        };
        let faces = faces.iter().zip(results).map(of_frame).collect();
        return BoxReport { confidence: Some(confidence), ..agreed.report(faces) };
    }
    let faces: Vec<FaceOutcome> = results.iter().map(FrameResult::outcome).collect();
    // What is not sure of one face alone may be surer, or less, of the box.
    let of_frame = too_few(&faces).filter(|reject| !matches!(reject, Reject::OutlineUnsure { .. }));
    let reject = of_frame.unwrap_or_else(|| unsure(confidence, settings, least_overlap(results)));
    BoxReport { likeliest, ..Assembled::rejected(reject).report(faces) }
}

/// The box of the faces that were measured, no probability stated.
fn of_measured_faces(
    frames: &[&Frame],
    results: &[FrameResult],
    calibration: &Calibration,
    settings: &Settings,
) -> BoxReport {
    let faces: Vec<FaceOutcome> = results.iter().map(FrameResult::outcome).collect();
    let measured: Vec<Option<&FaceMeasurement>> = faces.iter().map(FaceOutcome::measured).collect();
    let assembled = match too_few(&faces) {
        Some(reject) => Assembled::rejected(reject),
        None => assemble(frames, &measured, calibration, settings),
    };
    assembled.report(faces)
}

/// Why a frame was refused, if too few were measured.
fn too_few(faces: &[FaceOutcome]) -> Option<Reject> {
    let refused = faces.iter().find_map(|face| match face {
        FaceOutcome::Rejected(reject) => Some(reject.clone()),
        FaceOutcome::Measured(_) => None,
    });
    refused.filter(|_| faces.iter().filter_map(FaceOutcome::measured).count() < *FRAMES.start())
}

/// Overlap of outline and mask in the frame where it is least.
fn least_overlap(results: &[FrameResult]) -> f64 {
    let overlap = |result: &FrameResult| result.hypotheses.as_ref().map_or(0.0, |seen| seen.overlap);
    results.iter().map(overlap).fold(1.0, f64::min)
}

/// That a box is right: the right faces, located well enough.
fn stated(outcome: &Outcome, probability: f64, settings: &Settings) -> f64 {
    match outcome {
        Outcome::Measured(s) | Outcome::Ambiguous([s, _]) => {
            probability * located([&s.length, &s.width, &s.height], settings)
        }
        Outcome::Rejected(_) => 0.0, // nothing that agrees
    }
}

/// The likeliest boxes; one that is ambiguous is two, since nothing tells which.
fn candidates(boxes: &[BoxHypothesis<'_, Assembled>], settings: &Settings) -> Vec<Candidate> {
    let of_box = |hypothesis: &BoxHypothesis<'_, Assembled>| {
        let outcome = &hypothesis.agreed.outcome;
        let confidence = stated(outcome, hypothesis.probability, settings);
        let (all, share): (&[BoxMeasurement], f64) = match outcome {
            Outcome::Measured(sides) => (std::slice::from_ref(sides), 1.0),
            Outcome::Ambiguous(both) => (both, 0.5),
            Outcome::Rejected(_) => (&[], 0.0),
        };
        let candidate = |sides: &BoxMeasurement| Candidate { sides: *sides, confidence: share * confidence };
        all.iter().map(candidate).collect::<Vec<_>>()
    };
    let mut likeliest: Vec<Candidate> = boxes.iter().flat_map(of_box).collect();
    likeliest.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
    likeliest.truncate(LIKELIEST);
    likeliest
}

/// Faces put together.
struct Assembled {
    outcome: Outcome,
    warnings: Vec<Warning>,
    settled: Option<DepthEstimate>,
}

impl Assembled {
    fn rejected(reject: Reject) -> Self {
        Self { outcome: Outcome::Rejected(reject), warnings: Vec::new(), settled: None }
    }

    fn report(self, faces: Vec<FaceOutcome>) -> BoxReport {
        BoxReport {
            outcome: self.outcome,
            faces,
            warnings: self.warnings,
            settled: self.settled,
            confidence: None,
            likeliest: Vec::new(),
            hints: Vec::new(),
            times: StageTimes::new(),
        }
    }
}

/// Puts the faces together that are there, one a frame; where two leave two boxes, their frames are asked how deep the box is behind
/// the faces.
fn assemble(
    frames: &[&Frame],
    faces: &[Option<&FaceMeasurement>],
    calibration: &Calibration,
    settings: &Settings,
) -> Assembled {
    let known: Vec<(&Frame, &FaceMeasurement)> =
        frames.iter().zip(faces).filter_map(|(frame, face)| Some((*frame, (*face)?))).collect();
    let faces: Vec<&FaceMeasurement> = known.iter().map(|(_, face)| *face).collect();
    let (outcome, warnings) = cuboid::assemble(&faces, settings.choose);
    if let (Outcome::Ambiguous(candidates), [(p, a), (q, b)]) = (&outcome, &known[..])
        && let Some((which, seen)) = box_depth::settle(calibration, [*p, *q], [*a, *b], candidates)
    {
        let (outcome, warnings) = cuboid::assemble(&faces, Some(which));
        return Assembled { outcome, warnings, settled: Some(seen) };
    }
    Assembled { outcome, warnings, settled: None }
}
