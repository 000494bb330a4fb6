//! The one place that knows all stages and runs them in order.

use crate::calibration::Calibration;
use crate::cuboid;
use crate::edges::{EdgeDetector, hough::HoughDetector, subpixel::GradientDetector};
use crate::error::{Error, ErrorKind};
use crate::face::extent::{FaceStripes, follow_stripes};
use crate::image::Frame;
use crate::image::redness::{Diagonal, half_redness, ridge_map};
use crate::measurement::{
    BoxReport, EdgeMethod, FaceMeasurement, FaceOutcome, Outcome, Settings, StageTimes,
};
use crate::rectangle;
use crate::rectangle::hypothesize::{Which, hypothesize};
use crate::reject::Reject;
use crate::stripe::grid_search::{self, GridHypothesis};
use crate::units::LaserId;
use std::time::Instant;

/// Planes that are tried, strongest first.
const PLANES: usize = 4;
/// Share of each stripe between its ends that must be seen on the face's plane: more than half of it may be print ...
const MIN_SEEN_SHARE: f64 = 0.4;
/// ... and share of its inner segment, which a line of big red letters can cover for the most part.
const MIN_INNER_SHARE: f64 = 0.15;
/// Robust scatter of the stripe centres in units of their own sigmas: more is no plane.
const MAX_SCALE: f64 = 3.5;

/// Adds the time since the last call to the list.
struct Clock<'a> {
    since: Instant,
    times: &'a mut StageTimes,
}

impl Clock<'_> {
    fn lap(&mut self, stage: &'static str) {
        let now = Instant::now();
        let nanos = u64::try_from((now - self.since).as_nanos()).unwrap_or(u64::MAX);
        self.since = now;
        match self.times.iter_mut().find(|(name, _)| *name == stage) {
            Some((_, sum)) => *sum += nanos,
            None => self.times.push((stage, nanos)),
        }
    }
}

/// Measures one face. The nanoseconds of each stage are added to `times`.
///
/// # Errors
/// [`ErrorKind::CalibrationMismatch`] if the frame's size is not the calibration's.
pub fn measure_face(
    frame: &Frame,
    calibration: &Calibration,
    settings: &Settings,
    times: &mut StageTimes,
) -> Result<FaceOutcome, Error> {
    if frame.width_px() != calibration.width_px() as usize
        || frame.height_px() != calibration.height_px() as usize
    {
        return Err(Error::new(
            ErrorKind::CalibrationMismatch,
            format!(
                "the frame is {} x {} px, the calibration is for {} x {} px",
                frame.width_px(),
                frame.height_px(),
                calibration.width_px(),
                calibration.height_px()
            ),
        ));
    }
    let mut clock = Clock { since: Instant::now(), times };
    Ok(match face_stages(frame, calibration, settings, Which::Best, &mut clock) {
        Ok(faces) => faces
            .into_iter()
            .next()
            .map_or(FaceOutcome::Rejected(Reject::RectangleOpen { sides_found: 0 }), |face| {
                FaceOutcome::Measured(Box::new(face))
            }),
        Err(reject) => FaceOutcome::Rejected(reject),
    })
}

fn face_stages(
    frame: &Frame,
    calibration: &Calibration,
    settings: &Settings,
    which: Which,
    clock: &mut Clock<'_>,
) -> Result<Vec<FaceMeasurement>, Reject> {
    let (width, height, redness) = half_redness(frame);
    let diagonals = grid_search::diagonals(calibration);
    let maps = diagonals.map(|d: Diagonal| ridge_map(width, height, &redness, d));
    clock.lap("ridge");
    let planes = grid_search::find_planes(calibration, &maps[0], &maps[1], PLANES);
    clock.lap("grid");
    let mut refusal: Option<(f32, Reject)> = None;
    for hypothesis in &planes {
        let result = measure_on_plane(frame, calibration, settings, hypothesis, which, clock);
        match result {
            Ok(faces) => return Ok(faces),
            Err(reject) => {
                if refusal.as_ref().is_none_or(|(total, _)| hypothesis.total() > *total) {
                    refusal = Some((hypothesis.total(), reject));
                }
            }
        }
    }
    match refusal {
        // Whether a stripe is dark or misses the face is told by the other three.
        Some((_, reject)) if !matches!(reject, Reject::NoBox { .. } | Reject::StripeNotFound { .. }) => {
            Err(reject)
        }
        other => {
            let missing = grid_search::three_stripes(calibration, &maps[0], &maps[1]);
            clock.lap("grid");
            Err(match (missing, other) {
                (Some(laser), _) => Reject::StripeMissing { laser, stripes_on_face: 3 },
                (None, Some((_, reject))) => reject,
                (None, None) => no_box(0.0),
            })
        }
    }
}

fn measure_on_plane(
    frame: &Frame,
    calibration: &Calibration,
    settings: &Settings,
    hypothesis: &GridHypothesis,
    which: Which,
    clock: &mut Clock<'_>,
) -> Result<Vec<FaceMeasurement>, Reject> {
    let face = follow_stripes(frame, calibration, &hypothesis.plane);
    clock.lap("stripes");
    let face = face.ok_or_else(|| no_box(0.0))?;
    check_stripes(&face)?;
    let roughs = hypothesize(frame, calibration, &face, which);
    clock.lap("sides");
    let detector: &dyn EdgeDetector = match settings.edges {
        EdgeMethod::Gradient => &GradientDetector,
        EdgeMethod::Hough => &HoughDetector,
    };
    let mut faces = Vec::new();
    for (index, rough) in roughs?.iter().enumerate() {
        let keep_out = rectangle::keep_out(calibration, &face, rough);
        let edges = detector.edge_points(frame, calibration, rough, &keep_out);
        clock.lap("edges");
        let result = rectangle::measure(frame, calibration, &face, rough, &edges, settings.method);
        clock.lap("fit");
        match result {
            Ok(face) => faces.push(face),
            // An alternative that fails is none.
            Err(reject) if index == 0 => return Err(reject),
            Err(_) => {}
        }
    }
    Ok(faces)
}

/// Every stripe must be seen on the plane, and the centres must scatter as they should.
fn check_stripes(face: &FaceStripes) -> Result<(), Reject> {
    let seen =
        face.stripes.each_ref().map(|s| s.seen_share.min(s.inner_share / MIN_INNER_SHARE * MIN_SEEN_SHARE));
    let least = seen.iter().copied().fold(f64::INFINITY, f64::min);
    let planar = face.fit.scale <= MAX_SCALE;
    let mut unseen = LaserId::ALL.into_iter().filter(|id| seen[id.index()] < MIN_SEEN_SHARE);
    match (unseen.next(), unseen.next()) {
        (None, _) if planar => Ok(()),
        (Some(laser), None) if planar => Err(Reject::StripeNotFound {
            laser,
            seen_share: seen[laser.index()],
            needed_share: MIN_SEEN_SHARE,
        }),
        _ => Err(no_box(least)),
    }
}

fn no_box(best_share: f64) -> Reject {
    Reject::NoBox { best_share, needed_share: MIN_SEEN_SHARE }
}

/// Measures a box from two frames of adjacent faces.
///
/// # Errors
/// As [`measure_face`], for either frame.
pub fn measure_box(
    first: &Frame,
    second: &Frame,
    calibration: &Calibration,
    settings: &Settings,
    times: &mut StageTimes,
) -> Result<BoxReport, Error> {
    let a = measure_face(first, calibration, settings, times).map_err(|e| e.in_context("first frame"))?;
    let b = measure_face(second, calibration, settings, times).map_err(|e| e.in_context("second frame"))?;
    let outcome = match (&a, &b) {
        (FaceOutcome::Measured(a), FaceOutcome::Measured(b)) => cuboid::assemble(a, b, settings.choose),
        (FaceOutcome::Rejected(r), _) | (_, FaceOutcome::Rejected(r)) => Outcome::Rejected(r.clone()),
    };
    if !matches!(outcome, Outcome::Rejected(Reject::SidesDisagree { .. })) {
        return Ok(BoxReport { outcome, faces: [a, b] });
    }
    let agreed = with_alternatives([first, second], calibration, settings, times);
    Ok(agreed.unwrap_or(BoxReport { outcome, faces: [a, b] }))
}

/// When the likeliest faces share no side, one of them may be two flush faces in one: the pair of alternatives that does
/// share a side, the likelier first. `None` if there is none, or if two pairs that agree give different boxes.
fn with_alternatives(
    frames: [&Frame; 2],
    calibration: &Calibration,
    settings: &Settings,
    times: &mut StageTimes,
) -> Option<BoxReport> {
    let mut clock = Clock { since: Instant::now(), times };
    let [first, second] = frames
        .map(|frame| face_stages(frame, calibration, settings, Which::WithAlternatives, &mut clock).ok());
    let (first, second) = (first?, second?);
    let mut found: Option<BoxReport> = None;
    for (i, a) in first.iter().enumerate() {
        for (j, b) in second.iter().enumerate() {
            // One of the two is as likely as can be: two alternatives at once would agree too easily.
            if i > 0 && j > 0 {
                continue;
            }
            let outcome = cuboid::assemble(a, b, settings.choose);
            if matches!(outcome, Outcome::Rejected(_)) {
                continue;
            }
            if found.as_ref().is_some_and(|f| !cuboid::same_outcome(&f.outcome, &outcome)) {
                return None;
            }
            let measured = |face: &FaceMeasurement| FaceOutcome::Measured(Box::new(face.clone()));
            found.get_or_insert(BoxReport { outcome, faces: [measured(a), measured(b)] });
        }
    }
    found
}
