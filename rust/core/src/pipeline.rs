//! The one place that knows all stages and runs them in order.

use crate::box_depth;
use crate::calibration::Calibration;
use crate::cuboid;
use crate::edges::{EdgeDetector, hough::HoughDetector, subpixel::GradientDetector};
use crate::error::{Error, ErrorKind};
use crate::face::extent::{FaceStripes, Sight, follow_stripes, inner_segments};
use crate::face::map_outline::{LEAST_EDGE, MapOutline, map_outline, mask_at_border};
use crate::face::outline::RoughRectangle;
use crate::face::raster::PlaneRaster;
use crate::face_lines::view::FacePose;
use crate::feasibility::{self, Hint};
use crate::frames::{Cam, Plane};
use crate::image::Frame;
use crate::image::bands::band_maps;
use crate::image::redness::{Diagonal, RidgeMap, faint_ridge_map, half_redness};
use crate::measurement::{
    BoxReport, DepthSeen, EdgeMethod, FaceMeasurement, FaceOutcome, Outcome, Settings, StageTimes,
};
use crate::network::{FaceMaps, Network};
use crate::rectangle::hypothesize::{Which, cut_by_border, hypothesize, limits, snap_to_image};
use crate::rectangle::{self, Attempt, Measured};
use crate::reject::Reject;
use crate::stripe::grid_search::{self, Evidence, GridHypothesis};
use crate::units::LaserId;
use crate::warning::Warning;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// Planes that are tried, strongest first.
const PLANES: usize = 4;
/// Share of each stripe between its ends that must be seen on the face's plane: more than half of it may be print ...
const MIN_SEEN_SHARE: f64 = 0.4;
/// ... and share of its inner segment, which a line of big red letters can cover for the most part.
const MIN_INNER_SHARE: f64 = 0.15;
/// Robust scatter of the stripe centres in units of their own sigmas: more is no plane.
const MAX_SCALE: f64 = 3.5;

/// Adds the time since the last call to the list, and keeps the last rectangle that was seen: if the view is refused, it
/// says how to move.
struct Clock<'a> {
    since: Instant,
    times: &'a mut StageTimes,
    seen: Option<FacePose>,
}

impl<'a> Clock<'a> {
    fn new(times: &'a mut StageTimes) -> Self {
        Self { since: Instant::now(), times, seen: None }
    }

    fn see(&mut self, raster: &PlaneRaster, offsets_mm: &[f64; 4]) {
        let corners = rectangle::corner_points(offsets_mm).map(|corner| raster.cam_point(corner).mm);
        self.seen = FacePose::from_corners(corners).or(self.seen);
    }

    fn lap(&mut self, stage: &'static str) {
        let now = Instant::now();
        let nanos = u64::try_from((now - self.since).as_nanos()).unwrap_or(u64::MAX);
        self.since = now;
        add_time(self.times, stage, nanos);
    }
}

/// Adds to the time of a stage.
fn add_time(times: &mut StageTimes, stage: &'static str, nanos: u64) {
    match times.iter_mut().find(|(name, _)| *name == stage) {
        Some((_, sum)) => *sum += nanos,
        None => times.push((stage, nanos)),
    }
}

/// Measures one face. The nanoseconds of each stage are added to `times`.
///
/// # Errors
/// [`ErrorKind::CalibrationMismatch`] if the frame's size is not the calibration's; [`ErrorKind::Cancelled`].
pub fn measure_face(
    frame: &Frame,
    calibration: &Calibration,
    settings: &Settings,
    times: &mut StageTimes,
) -> Result<FaceOutcome, Error> {
    measure_face_with_hint(frame, calibration, settings, times).map(|(outcome, _)| outcome)
}

/// As [`measure_face`]; for a refused view with how to move, if moving helps.
///
/// # Errors
/// As [`measure_face`].
pub fn measure_face_with_hint(
    frame: &Frame,
    calibration: &Calibration,
    settings: &Settings,
    times: &mut StageTimes,
) -> Result<(FaceOutcome, Option<Hint>), Error> {
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
    check_wanted(settings)?;
    let mut clock = Clock::new(times);
    let maps = asked_network(settings).map(|network| network.maps(frame)).transpose()?;
    clock.lap("network");
    check_wanted(settings)?;
    let task = Task { frame, calibration, settings, maps: maps.as_ref(), which: Which::Best };
    let faces = face_stages(&task, &mut clock);
    check_wanted(settings)?; // what was cut short is no result
    let face =
        faces.and_then(|faces| faces.into_iter().next().ok_or(Reject::RectangleOpen { sides_found: 0 }));
    let face = face.and_then(|face| too_far(calibration, &face).map_or(Ok(face), Err));
    Ok(match face {
        Ok(face) => (FaceOutcome::Measured(Box::new(face)), None),
        Err(reject) => {
            let hint = Hint::new(calibration, clock.seen.as_ref(), &reject);
            (FaceOutcome::Rejected(reject), hint)
        }
    })
}

/// The refusal of a measured face that is too far away.
fn too_far(calibration: &Calibration, face: &FaceMeasurement) -> Option<Reject> {
    let pose = FacePose::from_corners(face.corners.map(|corner| corner.mm))?;
    feasibility::too_far(calibration, &pose)
}

fn unwanted(settings: &Settings) -> bool {
    settings.cancelled.is_some_and(|cancelled| cancelled.load(Ordering::Relaxed))
}

fn check_wanted(settings: &Settings) -> Result<(), Error> {
    if unwanted(settings) { Err(Error::new(ErrorKind::Cancelled, "cancelled")) } else { Ok(()) }
}

/// The network, if this way of finding edges asks one.
fn asked_network<'a>(settings: &Settings<'a>) -> Option<&'a dyn Network> {
    settings.network.filter(|_| settings.edges != EdgeMethod::Gradient)
}

/// What every stage gets.
#[derive(Clone, Copy)]
struct Task<'a> {
    frame: &'a Frame,
    calibration: &'a Calibration,
    settings: &'a Settings<'a>,
    maps: Option<&'a FaceMaps>,
    which: Which,
}

fn face_stages(task: &Task, clock: &mut Clock<'_>) -> Result<Vec<FaceMeasurement>, Reject> {
    let Task { frame, calibration, maps, .. } = *task;
    let diagonals = grid_search::diagonals(calibration);
    let ridges = band_maps(frame, diagonals);
    clock.lap("ridge");
    let planes =
        grid_search::find_planes(calibration, &evidence(&ridges, maps), grid_search::IN_RIDGES, PLANES);
    clock.lap("grid");
    let refusal = match measure_on_planes(task, &planes, Sight::Clear, clock) {
        Ok(faces) => return Ok(faces),
        // Whether a stripe is dark or misses the face is told by the other three.
        Err(Some(reject)) if !matches!(reject, Reject::NoBox { .. } | Reject::StripeNotFound { .. }) => {
            return Err(reject);
        }
        Err(refusal) => refusal,
    };
    let missing = grid_search::three_stripes(calibration, &ridges[0], &ridges[1]);
    clock.lap("grid");
    if let Some(laser) = missing {
        return Err(Reject::StripeMissing { laser, stripes_on_face: 3 });
    }
    let seen = clock.seen.take();
    let (width, height, redness) = half_redness(frame);
    let faint = diagonals.map(|d: Diagonal| faint_ridge_map(width, height, &redness, d));
    let evidence = evidence(&faint, maps);
    let planes = grid_search::find_planes(calibration, &evidence, grid_search::IN_FAINT_RIDGES, PLANES);
    let planes: Vec<GridHypothesis> =
        planes.iter().map(|plane| grid_search::climb(calibration, &evidence, plane)).collect();
    clock.lap("faint");
    measure_on_planes(task, &planes, Sight::Faint, clock).map_err(|faint| {
        clock.seen = clock.seen.take().or(seen);
        faint.or(refusal).unwrap_or_else(|| no_box(0.0))
    })
}

/// What speaks for each laser's stripe.
fn evidence<'a>(ridges: &'a [RidgeMap; 2], maps: Option<&FaceMaps>) -> [Evidence<'a>; 4] {
    LaserId::ALL.map(|id| {
        let ridge = &ridges[id.index() / 2];
        maps.map_or_else(|| Evidence::ridge(ridge), |maps| Evidence::with_network(ridge, maps, id))
    })
}

/// The first of the planes that can be measured; else why the strongest cannot, if there is one.
fn measure_on_planes(
    task: &Task,
    planes: &[GridHypothesis],
    sight: Sight,
    clock: &mut Clock<'_>,
) -> Result<Vec<FaceMeasurement>, Option<Reject>> {
    let mut refusal: Option<(f32, Reject)> = None;
    let mut seen = None;
    for hypothesis in planes.iter().take_while(|_| !unwanted(task.settings)) {
        clock.seen = None;
        match measure_on_plane(task, hypothesis, sight, clock) {
            Ok(faces) => return Ok(faces),
            Err(reject) => {
                if refusal.as_ref().is_none_or(|(total, _)| hypothesis.total() > *total) {
                    refusal = Some((hypothesis.total(), reject));
                    seen = clock.seen;
                }
            }
        }
    }
    clock.seen = seen;
    Err(refusal.map(|(_, reject)| reject))
}

fn measure_on_plane(
    task: &Task,
    hypothesis: &GridHypothesis,
    sight: Sight,
    clock: &mut Clock<'_>,
) -> Result<Vec<FaceMeasurement>, Reject> {
    let Task { frame, calibration, settings, maps, which } = *task;
    let inner = inner_segments(frame, calibration, &hypothesis.plane, sight);
    clock.lap("stripes");
    let inner = inner.ok_or_else(|| no_box(0.0))?;
    let outline = maps.map(|maps| seen_outline(calibration, &inner.plane, maps)).transpose();
    clock.lap("outline");
    let outline = outline.map_err(|unsure| {
        // Why: a face that leaves the image has no outline.
        let face = follow_stripes(frame, calibration, &inner, None);
        face.and_then(|face| cut_by_border(frame, &face)).unwrap_or(unsure)
    })?;
    if let Some(outline) = &outline {
        clock.see(&outline.raster, &outline.offsets_mm);
    }
    let limits = outline.as_ref().and_then(|o| limits(calibration, o));
    let face = follow_stripes(frame, calibration, &inner, limits.as_ref());
    clock.lap("stripes");
    let face = face.ok_or_else(|| no_box(0.0))?;
    check_stripes(&face, limits.is_some())?;
    let roughs = match outline.as_ref().zip(maps) {
        Some((outline, maps)) => {
            snap_to_image(frame, calibration, &face, outline, maps, MIN_MAP_SUPPORT).map(|rough| vec![rough])
        }
        None => hypothesize(frame, calibration, &face, which),
    };
    clock.lap("sides");
    let hough = HoughDetector { maps };
    let detector: &dyn EdgeDetector = match settings.edges {
        EdgeMethod::Net | EdgeMethod::Gradient => &GradientDetector,
        EdgeMethod::Hough => &hough,
    };
    let mut faces = Vec::new();
    let roughs = roughs?;
    if let Some(rough) = roughs.first() {
        clock.see(&rough.raster, &rough.offsets_mm);
    }
    for (index, rough) in roughs.iter().enumerate() {
        let mut measure = |rough: &RoughRectangle, attempt: Attempt| {
            let keep_out = rectangle::keep_out(calibration, &face, rough);
            let edges = detector.edge_points(frame, calibration, rough, &keep_out);
            clock.lap("edges");
            let result = rectangle::measure(frame, calibration, &face, rough, &edges, settings, attempt);
            clock.lap("fit");
            result
        };
        let result = match measure(rough, Attempt::First) {
            Ok(Measured::Misplaced(moved)) => {
                measure(&moved, Attempt::Last).or_else(|_| measure(rough, Attempt::Last))
            }
            result => result,
        };
        match result {
            Ok(Measured::Face(face)) => faces.push(*face),
            Ok(Measured::Misplaced(_)) => {} // of a first attempt only
            // An alternative that fails is none.
            Err(reject) if index == 0 => return Err(reject),
            Err(_) => {}
        }
    }
    Ok(faces)
}

/// Mean probability of an edge along each side that the network must see, and the overlap of the rectangle with its mask: 98
/// of 100 right outlines of rendered boxes have more. Two sets of `boxline render --held-out --count 60`, without and with print
/// along edges, gave 0.53 and 0.40, 0.89 and 0.85; the stricter ones hold.
///
/// A side with less is right if both stripes leave the plane there, which print cannot make them do; it must still be a line that
/// the network sees at all ([`LEAST_EDGE`]).
const MIN_MAP_SUPPORT: f32 = 0.53;
const MIN_MAP_OVERLAP: f32 = 0.89;

/// The face's outline in the maps, if it is clear enough.
fn seen_outline(
    calibration: &Calibration,
    plane: &Plane<Cam>,
    maps: &FaceMaps,
) -> Result<MapOutline, Reject> {
    let outline = map_outline(calibration, plane, maps);
    let (support, overlap) = outline.as_ref().map_or((0.0, 0.0), |outline| {
        (outline.support.iter().copied().fold(f32::INFINITY, f32::min), outline.overlap)
    });
    match outline {
        Some(outline) if support >= LEAST_EDGE && overlap >= MIN_MAP_OVERLAP => Ok(outline),
        _ => Err(match mask_at_border(maps) {
            Some((sides_cut, at)) => Reject::FaceCutByBorder { sides_cut, at },
            None => Reject::OutlineUnsure {
                support: f64::from(support),
                needed_support: f64::from(MIN_MAP_SUPPORT),
                overlap: f64::from(overlap),
                needed_overlap: f64::from(MIN_MAP_OVERLAP),
            },
        }),
    }
}

/// Every stripe must be seen on the plane, and the centres must scatter as they should.
///
/// Where the sides are known already, all of the stripe counts, not only what lies between its ends.
fn check_stripes(face: &FaceStripes, sides_known: bool) -> Result<(), Reject> {
    let seen = face.stripes.each_ref().map(|s| {
        let seen = if sides_known { s.whole_share } else { s.seen_share };
        seen.min(s.inner_share / MIN_INNER_SHARE * MIN_SEEN_SHARE)
    });
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
    measure_box_with_hints(first, second, calibration, settings, times).map(|(report, _)| report)
}

/// As [`measure_box`]; for each refused view with how to move, if moving helps.
///
/// # Errors
/// As [`measure_box`].
pub fn measure_box_with_hints(
    first: &Frame,
    second: &Frame,
    calibration: &Calibration,
    settings: &Settings,
    times: &mut StageTimes,
) -> Result<(BoxReport, [Option<Hint>; 2]), Error> {
    let face = |frame: &Frame, name: &str, times: &mut StageTimes| {
        measure_face_with_hint(frame, calibration, settings, times).map_err(|e| e.in_context(name))
    };
    let ((a, hint_a), (b, hint_b)) = match settings.workers.filter(|_| asked_network(settings).is_none()) {
        Some(workers) => {
            let (mut a, mut b, mut more) = (None, None, StageTimes::new());
            workers.both(&mut || a = Some(face(first, "first frame", times)), &mut || {
                b = Some(face(second, "second frame", &mut more));
            });
            more.into_iter().for_each(|(stage, nanos)| add_time(times, stage, nanos));
            let left_out = || Err(Error::new(ErrorKind::Cancelled, "the caller's workers left out a frame"));
            (a.unwrap_or_else(left_out)?, b.unwrap_or_else(left_out)?)
        }
        None => (face(first, "first frame", times)?, face(second, "second frame", times)?),
    };
    let hints = [hint_a, hint_b];
    let frames = [first, second];
    let (outcome, warnings, settled) = match (&a, &b) {
        (FaceOutcome::Measured(a), FaceOutcome::Measured(b)) => {
            assemble(frames, [a, b], calibration, settings)
        }
        (FaceOutcome::Rejected(r), _) | (_, FaceOutcome::Rejected(r)) => {
            (Outcome::Rejected(r.clone()), Vec::new(), None)
        }
    };
    if asked_network(settings).is_some()
        || !matches!(outcome, Outcome::Rejected(Reject::SidesDisagree { .. }))
    {
        return Ok((BoxReport { outcome, faces: [a, b], warnings, settled }, hints));
    }
    let agreed = with_alternatives(frames, calibration, settings, times);
    Ok((agreed.unwrap_or(BoxReport { outcome, faces: [a, b], warnings, settled }), hints))
}

/// Puts two faces together; where that leaves two boxes, the frames are asked how deep the box is behind the faces.
fn assemble(
    frames: [&Frame; 2],
    faces: [&FaceMeasurement; 2],
    calibration: &Calibration,
    settings: &Settings,
) -> (Outcome, Vec<Warning>, Option<DepthSeen>) {
    let [a, b] = faces;
    let (outcome, warnings) = cuboid::assemble(a, b, settings.choose);
    if let Outcome::Ambiguous(candidates) = &outcome
        && let Some((which, seen)) = box_depth::settle(calibration, frames, faces, candidates)
    {
        let (outcome, warnings) = cuboid::assemble(a, b, Some(which));
        return (outcome, warnings, Some(seen));
    }
    (outcome, warnings, None)
}

/// When the likeliest faces share no side, one of them may be two flush faces in one: the pair of alternatives that does
/// share a side, the likelier first. `None` if there is none, or if two pairs that agree give different boxes.
fn with_alternatives(
    frames: [&Frame; 2],
    calibration: &Calibration,
    settings: &Settings,
    times: &mut StageTimes,
) -> Option<BoxReport> {
    let mut clock = Clock::new(times);
    let [first, second] = frames.map(|frame| {
        let task = Task { frame, calibration, settings, maps: None, which: Which::WithAlternatives };
        face_stages(&task, &mut clock).ok()
    });
    let (first, second) = (first?, second?);
    let mut found: Option<BoxReport> = None;
    for (i, a) in first.iter().enumerate() {
        for (j, b) in second.iter().enumerate() {
            // One of the two is as likely as can be: two alternatives at once would agree too easily.
            if i > 0 && j > 0 {
                continue;
            }
            let (outcome, warnings, settled) = assemble(frames, [a, b], calibration, settings);
            if matches!(outcome, Outcome::Rejected(_)) {
                continue;
            }
            if found.as_ref().is_some_and(|f| !cuboid::same_outcome(&f.outcome, &outcome)) {
                return None;
            }
            let measured = |face: &FaceMeasurement| FaceOutcome::Measured(Box::new(face.clone()));
            found.get_or_insert(BoxReport { outcome, faces: [measured(a), measured(b)], warnings, settled });
        }
    }
    found
}
