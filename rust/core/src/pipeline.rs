//! The one place that knows all stages and runs them in order.

use crate::alternatives::{Alternative, LIKELIEST, Seen, Together, Tried, likeliest_boxes, weighed};
use crate::box_depth;
use crate::calibration::Calibration;
use crate::confidence;
use crate::cuboid;
use crate::diagnostics::{Outlined, Told};
use crate::edges::{EdgeDetector, hough::HoughDetector, subpixel::GradientDetector};
use crate::error::{Error, ErrorKind};
use crate::face::extent::{FaceStripes, InnerSegments, Sight, follow_stripes, inner_segments};
use crate::face::map_outline::{MapOutline, map_outline, mask_at_border};
use crate::face::outline::{RoughRectangle, SIDES};
use crate::face::raster::PlaneRaster;
use crate::face_lines::view::FacePose;
use crate::feasibility::{self, Hint};
use crate::frames::{Cam, Plane, Point};
use crate::image::Frame;
use crate::image::bands::band_maps;
use crate::image::redness::{Diagonal, RidgeMap, faint_ridge_map, half_redness};
use crate::measurement::{
    BoxMeasurement, BoxReport, Candidate, DepthSeen, EdgeMethod, FaceMeasurement, FaceOutcome, Method,
    Outcome, Settings, SideLight, StageTimes,
};
use crate::network::{Asked, Channel, EdgeMap, EdgeMapNetwork, FaceMaps, Network};
use crate::rectangle::hough_outline::hough_outline;
use crate::rectangle::hypothesize::{Which, cut_by_border, ends_seen, hypothesize, limits, snap_to_image};
use crate::rectangle::rivals::{Pair, Rival, rivals};
use crate::rectangle::{self, Attempt, Measured};
use crate::reject::Reject;
use crate::scene::hidden::HiddenSides;
use crate::scene::lit::LitLines;
use crate::sides::ViewAxes;
use crate::stripe::grid_search::{self, Evidence, GridHypothesis};
use crate::units::{Estimate, LaserId};
use crate::view::SideOdds;
use crate::warning::Warning;
use std::ops::RangeInclusive;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// Planes that are tried, strongest first.
const PLANES: usize = 4;
/// Share of each stripe between its ends that must be seen on the face's plane: more than half of it may be print ...
const MIN_SEEN_SHARE: f64 = 0.4;
/// ... one of the four may show this share on a face with known sides: by chance a line without a stripe shows 0.1 ...
const MIN_SEEN_OF_ONE: f64 = 0.2;
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
    let (seen, hint) = see_face(frame, calibration, settings, times)?;
    Ok((outcome_of(&seen), hint))
}

fn outcome_of(seen: &Result<Seen, Reject>) -> FaceOutcome {
    match seen.as_ref().map_err(Clone::clone).and_then(Seen::face) {
        Ok(face) => FaceOutcome::Measured(Box::new(face.clone())),
        Err(reject) => FaceOutcome::Rejected(reject),
    }
}

fn see_face(
    frame: &Frame,
    calibration: &Calibration,
    settings: &Settings,
    times: &mut StageTimes,
) -> Result<(Result<Seen, Reject>, Option<Hint>), Error> {
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
    let asked = asked_network(settings).map(|network| Asked::new(network, frame)).transpose()?;
    let edge_map = paper_network(settings).map(|network| network.edge_map(frame)).transpose()?;
    clock.lap("network");
    check_wanted(settings)?;
    let task = Task {
        frame,
        calibration,
        settings,
        asked: asked.as_ref(),
        edge_map: edge_map.as_ref(),
        which: Which::Best,
    };
    asked.iter().for_each(|asked| task.told().network(&asked.maps));
    let seen = face_stages(&task, &mut clock);
    check_wanted(settings)?; // what was cut short is no result
    asked.map_or(Ok(()), Asked::finish)?;
    let seen = seen.map(|mut seen| {
        for alternative in &mut seen.alternatives {
            if let Ok(face) = &alternative.face
                && let Some(reject) = feasibility::too_far(calibration, face.corners)
            {
                alternative.face = Err(reject);
            }
        }
        seen
    });
    let hint = match seen.as_ref().map_err(Clone::clone).and_then(Seen::face) {
        Ok(_) => None,
        Err(reject) => Hint::new(calibration, clock.seen.as_ref(), &reject),
    };
    Ok((seen, hint))
}

fn unwanted(settings: &Settings) -> bool {
    settings.cancelled.is_some_and(|cancelled| cancelled.load(Ordering::Relaxed))
}

fn check_wanted(settings: &Settings) -> Result<(), Error> {
    if unwanted(settings) { Err(Error::new(ErrorKind::Cancelled, "cancelled")) } else { Ok(()) }
}

/// The network, if this way of finding edges asks one.
fn asked_network<'a>(settings: &Settings<'a>) -> Option<&'a dyn Network> {
    settings.network.filter(|_| settings.edges != EdgeMethod::Gradient && paper_network(settings).is_none())
}

/// The paper's network, if this way of finding edges asks it.
fn paper_network<'a>(settings: &Settings<'a>) -> Option<&'a dyn EdgeMapNetwork> {
    settings.edge_map.filter(|_| settings.edges == EdgeMethod::Hough)
}

/// Whether a network of either kind is asked.
fn asks_network(settings: &Settings) -> bool {
    asked_network(settings).is_some() || paper_network(settings).is_some()
}

/// What every stage gets.
#[derive(Clone, Copy)]
struct Task<'a> {
    frame: &'a Frame,
    calibration: &'a Calibration,
    settings: &'a Settings<'a>,
    asked: Option<&'a Asked<'a>>,
    /// The paper's map.
    edge_map: Option<&'a EdgeMap>,
    which: Which,
}

impl Task<'_> {
    fn told(&self) -> Told<'_> {
        Told { trace: self.settings.trace, frame: self.frame, calibration: self.calibration }
    }
}

fn face_stages(task: &Task, clock: &mut Clock<'_>) -> Result<Seen, Reject> {
    let Task { frame, calibration, asked, .. } = *task;
    let maps = asked.map(|asked| &asked.maps);
    let diagonals = grid_search::diagonals(calibration);
    let ridges = band_maps(frame, diagonals);
    clock.lap("ridge");
    let planes =
        grid_search::find_planes(calibration, &evidence(&ridges, maps), grid_search::IN_RIDGES, PLANES);
    clock.lap("grid");
    task.told().planes(&ridges, &planes);
    let refusal = match measure_on_planes(task, &planes, Sight::Clear, clock) {
        Ok(seen) => return Ok(seen),
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
    task.told().planes(&faint, &planes);
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

/// The strongest of the planes on which a face can be measured, however unsure it is: who tries until one is sure finds one that is wrong.
/// Else why the strongest cannot, if there is one.
fn measure_on_planes(
    task: &Task,
    planes: &[GridHypothesis],
    sight: Sight,
    clock: &mut Clock<'_>,
) -> Result<Seen, Option<Reject>> {
    let mut refusal: Option<(f32, Reject)> = None;
    let mut pose = None;
    for hypothesis in planes.iter().take_while(|_| !unwanted(task.settings)) {
        clock.seen = None;
        match measure_on_plane(task, hypothesis, sight, clock) {
            Ok(seen) => return Ok(seen),
            Err(reject) => {
                if refusal.as_ref().is_none_or(|(total, _)| hypothesis.total() > *total) {
                    refusal = Some((hypothesis.total(), reject));
                    pose = clock.seen;
                }
            }
        }
    }
    clock.seen = pose;
    Err(refusal.map(|(_, reject)| reject))
}

fn measure_on_plane(
    task: &Task,
    hypothesis: &GridHypothesis,
    sight: Sight,
    clock: &mut Clock<'_>,
) -> Result<Seen, Reject> {
    let Task { frame, calibration, asked, which, .. } = *task;
    let inner = inner_segments(frame, calibration, &hypothesis.plane, sight);
    clock.lap("stripes");
    let inner = inner.ok_or_else(|| no_box(0.0))?;
    let wide = follow_stripes(frame, calibration, &inner, None);
    clock.lap("stripes");
    wide.iter().for_each(|stripes| task.told().stripes(stripes));
    if let Some(asked) = asked {
        return measure_seen_outline(task, &inner, wide.as_ref(), asked, clock);
    }
    let face = wide.ok_or_else(|| no_box(0.0))?;
    if let Some(map) = task.edge_map {
        return measure_in_edge_map(task, &inner, &face, map, clock);
    }
    check_stripes(&face, false)?;
    let roughs = hypothesize(frame, calibration, &face, which);
    clock.lap("sides");
    let lit = LitLines::of(frame, calibration, &face);
    clock.lap("sides");
    let roughs = roughs?;
    task.told().outlines(roughs.iter().map(outlined));
    let mut alternatives = Vec::new();
    for (index, rough) in roughs.iter().enumerate() {
        if index == 0 {
            clock.see(&rough.raster, &rough.offsets_mm);
        }
        match measure_rough(task, &face, rough, clock) {
            Ok(mut measured) => {
                measured.light =
                    Some(light_at_sides(calibration, &rough.raster, &rough.offsets_mm, &lit, &measured));
                alternatives.push(Alternative::only(measured));
            }
            // An alternative that fails is none.
            Err(reject) if index == 0 => return Err(reject),
            Err(_) => {}
        }
    }
    Ok(Seen { alternatives, unsure: None, overlap: 0.0 })
}

fn outlined(rough: &RoughRectangle) -> Outlined<'_> {
    let RoughRectangle { raster, offsets_mm, lines, .. } = rough;
    Outlined { raster, offsets_mm, lines, probability: None }
}

/// Measures the face whose sides the paper's map shows.
fn measure_in_edge_map(
    task: &Task,
    inner: &InnerSegments,
    wide: &FaceStripes,
    map: &EdgeMap,
    clock: &mut Clock<'_>,
) -> Result<Seen, Reject> {
    let Task { frame, calibration, .. } = *task;
    let rough = hough_outline(frame, calibration, &wide.fit.plane, map);
    clock.lap("outline");
    let mut rough = rough.map_err(|open| cut_by_border(frame, wide).unwrap_or(open))?;
    task.told().outlines(std::iter::once(outlined(&rough)));
    clock.see(&rough.raster, &rough.offsets_mm);
    let limits = limits(calibration, &rough.raster, &rough.offsets_mm, rough.mm_per_px);
    let face = follow_stripes(frame, calibration, inner, limits.as_ref());
    clock.lap("stripes");
    let face = face.ok_or_else(|| no_box(0.0))?;
    check_stripes(&face, limits.is_some())?;
    rough.raster = rough.raster.on(&face.fit.plane);
    rough.at_ends = ends_seen(calibration, &face, &rough.raster).unwrap_or(rough.at_ends);
    let face = measure_rough(task, &face, &rough, clock)?;
    Ok(Seen { alternatives: vec![Alternative::only(face)], unsure: None, overlap: 0.0 })
}

/// Measures the face along the outlines that it may have.
fn measure_seen_outline(
    task: &Task,
    inner: &InnerSegments,
    wide: Option<&FaceStripes>,
    asked: &Asked<'_>,
    clock: &mut Clock<'_>,
) -> Result<Seen, Reject> {
    let Task { frame, calibration, .. } = *task;
    let maps = &asked.maps;
    let outline = seen_outline(calibration, &inner.plane, maps, task.settings);
    clock.lap("outline");
    // Why: a face that leaves the image has no outline.
    let outline =
        outline.map_err(|unsure| wide.and_then(|face| cut_by_border(frame, face)).unwrap_or(unsure))?;
    let wide = wide.ok_or_else(|| no_box(0.0))?;
    let seen = seen_in_plane(calibration, wide, &outline, asked);
    clock.lap("sides");
    let lit = LitLines::of(frame, calibration, wide);
    let rivals =
        rivals(frame, calibration, wide, &outline, asked, seen.as_ref(), &lit).ok_or_else(|| no_box(0.0))?;
    clock.lap("outline");
    task.told().outlines(rivals.iter().map(|Rival { outline, probability, .. }| {
        let MapOutline { raster, offsets_mm, lines, .. } = outline;
        Outlined { raster, offsets_mm, lines, probability: Some(*probability) }
    }));
    let best = rivals.first().ok_or(Reject::RectangleOpen { sides_found: 0 })?;
    clock.see(&best.outline.raster, &best.outline.offsets_mm);
    let mut free = 1.0;
    if let Some((_, odds)) = &seen {
        let hidden = HiddenSides::of(frame, calibration, wide, &best.outline, odds);
        clock.lap("outline");
        if let Some(reject) = hidden.refusal(calibration, &best.outline) {
            return Err(reject);
        }
        free = hidden.chance_that_free();
    }
    let measured = rivals.iter().map(|Rival { outline, probability, pairs }| Tried {
        probability: free * probability,
        pairs: pairs.map(|pair| Pair { probability: free * pair.probability, ..pair }),
        sides_mm: [1, 3].map(|high| outline.offsets_mm[high] - outline.offsets_mm[high - 1]),
        face: measure_outline(task, inner, outline, clock).map(|face| {
            let light = light_at_sides(calibration, &outline.raster, &outline.offsets_mm, &lit, &face);
            Box::new(FaceMeasurement { light: Some(light), ..face })
        }),
    });
    let alternatives =
        weighed(measured.collect(), |face| located([&face.length, &face.width], task.settings));
    // A plane on which no outline can be measured is none.
    if alternatives.iter().all(|a| a.face.is_err())
        && let Some(Alternative { face: Err(reject), .. }) = alternatives.first()
    {
        return Err(reject.clone());
    }
    let likeliest = alternatives.first().and_then(|a| a.face.as_ref().ok()?.confidence).unwrap_or(0.0);
    let overlap = f64::from(outline.overlap);
    let unsure = (likeliest < task.settings.least_confidence)
        .then(|| unclear(maps, likeliest, task.settings, overlap));
    Ok(Seen { alternatives, unsure, overlap })
}

/// What the stripes' light says of each side, going round as the corners do.
fn light_at_sides(
    calibration: &Calibration,
    raster: &PlaneRaster,
    offsets_mm: &[f64; 4],
    lit: &LitLines,
    face: &FaceMeasurement,
) -> [SideLight; 4] {
    [0, 1, 2, 3].map(|k| {
        let middle = Point::from_vector(0.5 * (face.corners[k].mm + face.corners[(k + 1) % 4].mm));
        let middle = raster.of_cam(&middle);
        let offset_mm = |side: usize| SIDES[side].0.offset(middle);
        // The one of the outline's sides on which it lies.
        let off = |side: &usize| (offset_mm(*side) - offsets_mm[*side]).abs();
        let side = (0..4).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0);
        lit.verdict(calibration, raster, side, offset_mm(side))
    })
}

/// What the network of sides says of the face, seen in the plane of its stripes.
fn seen_in_plane(
    calibration: &Calibration,
    wide: &FaceStripes,
    outline: &MapOutline,
    asked: &Asked<'_>,
) -> Option<(ViewAxes, SideOdds)> {
    let axes = ViewAxes::of(calibration, outline.raster.on(&wide.fit.plane))?;
    let odds = asked.sides(&axes.view(&asked.small(), calibration))?;
    Some((axes, odds))
}

/// Measures the face along one outline.
fn measure_outline(
    task: &Task,
    inner: &InnerSegments,
    outline: &MapOutline,
    clock: &mut Clock<'_>,
) -> Result<FaceMeasurement, Reject> {
    let Task { frame, calibration, .. } = *task;
    let limits = limits(calibration, &outline.raster, &outline.offsets_mm, outline.mm_per_px);
    let face = follow_stripes(frame, calibration, inner, limits.as_ref());
    clock.lap("stripes");
    let face = face.ok_or_else(|| no_box(0.0))?;
    check_stripes(&face, limits.is_some())?;
    let rough = snap_to_image(frame, calibration, &face, outline);
    clock.lap("sides");
    let rough = rough?;
    // All stripes go on in the plane beyond all sides: a tile of a floor, a panel of a wall, a field of print.
    if !rough.at_ends.contains(&true) {
        return Err(Reject::RectangleOpen { sides_found: 0 });
    }
    measure_rough(task, &face, &rough, clock)
}

/// Finds the edges beside a rough rectangle and fits it.
fn measure_rough(
    task: &Task,
    face: &FaceStripes,
    rough: &RoughRectangle,
    clock: &mut Clock<'_>,
) -> Result<FaceMeasurement, Reject> {
    let Task { frame, calibration, settings, asked, edge_map, .. } = *task;
    let hough = HoughDetector {
        map: edge_map.map(EdgeMap::view).or_else(|| asked.map(|asked| asked.maps.view(Channel::FaceEdge))),
        stripes_on: edge_map.map(|_| &face.fit.plane),
    };
    let detector: &dyn EdgeDetector = match settings.edges {
        EdgeMethod::Net | EdgeMethod::Gradient => &GradientDetector,
        EdgeMethod::Hough => &hough,
    };
    let mut measure = |rough: &RoughRectangle, attempt: Attempt| {
        let keep_out = rectangle::keep_out(calibration, face, rough);
        let edges = detector.edge_points(frame, calibration, rough, &keep_out);
        clock.lap("edges");
        let result = rectangle::measure(frame, calibration, face, rough, &edges, settings, attempt);
        clock.lap("fit");
        result
    };
    // A network's outline with other lines is another outline, with a probability of its own.
    let attempt = if asked.is_some() { Attempt::Last } else { Attempt::First };
    let result = match measure(rough, attempt) {
        Ok(Measured::Misplaced(moved)) => {
            measure(&moved, Attempt::Last).or_else(|_| measure(rough, Attempt::Last))
        }
        result => result,
    };
    match result? {
        Measured::Face(face) => Ok(*face),
        Measured::Misplaced(_) => Err(Reject::RectangleOpen { sides_found: 0 }), // of a first attempt only
    }
}

/// Overlap of the outline with the network's mask below which the maps show no face here; right outlines of rendered boxes have 0.7
/// and more.
const LEAST_OVERLAP: f32 = 0.5;

/// The face's outline in the maps, if they show a face.
fn seen_outline(
    calibration: &Calibration,
    plane: &Plane<Cam>,
    maps: &FaceMaps,
    settings: &Settings,
) -> Result<MapOutline, Reject> {
    let outline = map_outline(calibration, plane, maps);
    let overlap = outline.as_ref().map_or(0.0, |outline| outline.overlap);
    outline
        .filter(|_| overlap >= LEAST_OVERLAP)
        .ok_or_else(|| unclear(maps, 0.0, settings, f64::from(overlap)))
}

/// The refusal of a face whose outline is not clear.
fn unclear(maps: &FaceMaps, probability: f64, settings: &Settings, overlap: f64) -> Reject {
    match mask_at_border(maps) {
        Some((sides_cut, at)) => Reject::FaceCutByBorder { sides_cut, at },
        None => unsure(probability, settings, overlap),
    }
}

/// The refusal of a result that is not likely enough to be right.
fn unsure(probability: f64, settings: &Settings, overlap: f64) -> Reject {
    Reject::OutlineUnsure {
        support: probability,
        needed_support: settings.least_confidence,
        overlap,
        needed_overlap: f64::from(LEAST_OVERLAP),
    }
}

/// Probability that sides along the right lines are right. The paper's key points have wide sigmas and are shown as the paper has them.
fn located<'a>(sides: impl IntoIterator<Item = &'a Estimate>, settings: &Settings) -> f64 {
    let weighs_sigma = settings.method == Method::Fit && settings.edges == EdgeMethod::Net;
    if weighs_sigma { confidence::located(sides) } else { 1.0 }
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
        // Dark print hides most of one stripe; the other three hold the plane.
        (Some(laser), None) if planar && sides_known && seen[laser.index()] >= MIN_SEEN_OF_ONE => Ok(()),
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

/// Frames that make a box: two adjacent faces, or three.
const FRAMES: RangeInclusive<usize> = 2..=3;

/// Measures a box from frames of two or three adjacent faces. With three every side is seen twice: what one frame leaves open the others
/// tell, a wrong side shows, and an A x A x B box is never ambiguous. A third frame that cannot be measured does no harm.
///
/// # Errors
/// As [`measure_face`], for any of the frames; [`ErrorKind::InvalidFrame`] if there are not two or three.
pub fn measure_box(
    frames: &[&Frame],
    calibration: &Calibration,
    settings: &Settings,
    times: &mut StageTimes,
) -> Result<BoxReport, Error> {
    measure_box_with_hints(frames, calibration, settings, times).map(|(report, _)| report)
}

/// As [`measure_box`]; for each refused view with how to move, if moving helps.
///
/// # Errors
/// As [`measure_box`].
pub fn measure_box_with_hints(
    frames: &[&Frame],
    calibration: &Calibration,
    settings: &Settings,
    times: &mut StageTimes,
) -> Result<(BoxReport, Vec<Option<Hint>>), Error> {
    if !FRAMES.contains(&frames.len()) {
        let text = format!("{} frames, a box takes two or three", frames.len());
        return Err(Error::new(ErrorKind::InvalidFrame, text));
    }
    let (seen, hints): (Vec<_>, Vec<_>) =
        see_faces(frames, calibration, settings, times)?.into_iter().unzip();
    let boxes = asked_network(settings).map_or_else(Vec::new, |_| {
        let of_frames: Vec<Option<&Seen>> = seen.iter().map(|seen| seen.as_ref().ok()).collect();
        let agree = |faces: &[Option<&FaceMeasurement>]| {
            let assembled = assemble(frames, faces, calibration, settings);
            (!matches!(assembled.0, Outcome::Rejected(_))).then_some(assembled)
        };
        likeliest_boxes(&of_frames, agree, |(a, ..), (b, ..)| cuboid::same_outcome(a, b))
    });
    let confidence = |outcome: &Outcome, probability: f64| match outcome {
        Outcome::Measured(s) | Outcome::Ambiguous([s, _]) => {
            probability * located([&s.length, &s.width, &s.height], settings)
        }
        Outcome::Rejected(_) => 0.0, // nothing that agrees
    };
    let candidates = boxes.iter().flat_map(|together| {
        let confidence = confidence(&together.agreed.0, together.probability);
        let (all, share): (&[BoxMeasurement], f64) = match &together.agreed.0 {
            Outcome::Measured(sides) => (std::slice::from_ref(sides), 1.0),
            Outcome::Ambiguous(both) => (both, 0.5), // nothing tells which
            Outcome::Rejected(_) => (&[], 0.0),
        };
        all.iter().map(move |sides| Candidate { sides: *sides, confidence: share * confidence })
    });
    let mut likeliest: Vec<Candidate> = candidates.collect();
    likeliest.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
    likeliest.truncate(LIKELIEST);
    let mut doubt = None;
    if let Some(Together { faces, agreed: (outcome, warnings, settled), probability }) =
        boxes.into_iter().next()
    {
        let confidence = confidence(&outcome, probability);
        if confidence >= settings.least_confidence {
            let of_frame = |(face, seen): (&Option<&FaceMeasurement>, _)| match face {
                Some(face) => FaceOutcome::Measured(Box::new((*face).clone())),
                None => outcome_of(seen),
            };
            let faces: Vec<FaceOutcome> = faces.iter().zip(&seen).map(of_frame).collect();
            let unseen = |(face, hint): (&FaceOutcome, _)| {
                if matches!(face, FaceOutcome::Rejected(_)) { hint } else { None }
            };
            let hints = faces.iter().zip(hints).map(unseen).collect();
            likeliest.clear();
            let confidence = Some(confidence);
            let report = BoxReport { outcome, faces, warnings, settled, confidence, likeliest };
            return Ok((report, hints));
        }
        let overlaps = seen.iter().map(|seen| seen.as_ref().map_or(0.0, |seen| seen.overlap));
        doubt = Some(unsure(confidence, settings, overlaps.fold(1.0, f64::min)));
    }
    let faces: Vec<FaceOutcome> = seen.iter().map(outcome_of).collect();
    let measured: Vec<Option<&FaceMeasurement>> = faces
        .iter()
        .map(|face| match face {
            FaceOutcome::Measured(face) => Some(&**face),
            FaceOutcome::Rejected(_) => None,
        })
        .collect();
    let refused = faces.iter().find_map(|face| match face {
        FaceOutcome::Rejected(reject) => Some(reject.clone()),
        FaceOutcome::Measured(_) => None,
    });
    let (outcome, warnings, settled) = match (refused, doubt) {
        (Some(reject), _) if measured.iter().flatten().count() < *FRAMES.start() => {
            (Outcome::Rejected(reject), Vec::new(), None)
        }
        (_, Some(doubt)) => (Outcome::Rejected(doubt), Vec::new(), None),
        (_, None) => assemble(frames, &measured, calibration, settings),
    };
    let report = BoxReport { outcome, faces, warnings, settled, confidence: None, likeliest };
    if asks_network(settings) || !matches!(report.outcome, Outcome::Rejected(Reject::SidesDisagree { .. })) {
        return Ok((report, hints));
    }
    let report = match *frames {
        [first, second] => with_alternatives([first, second], calibration, settings, times).unwrap_or(report),
        _ => report,
    };
    Ok((report, hints))
}

/// What a frame shows; for a view that cannot be measured how to move.
type SeenWithHint = (Result<Seen, Reject>, Option<Hint>);

/// What each frame shows.
fn see_faces(
    frames: &[&Frame],
    calibration: &Calibration,
    settings: &Settings,
    times: &mut StageTimes,
) -> Result<Vec<SeenWithHint>, Error> {
    const NAMES: [&str; 3] = ["first frame", "second frame", "third frame"];
    let see = |i: usize, times: &mut StageTimes| {
        see_face(frames[i], calibration, settings, times).map_err(|e| e.in_context(NAMES[i]))
    };
    let Some(workers) = settings.workers else {
        return (0..frames.len()).map(|i| see(i, times)).collect();
    };
    let mut found: Vec<_> = frames.iter().map(|_| (None, StageTimes::new())).collect();
    let mut work = found.iter_mut().enumerate().map(|(i, (seen, times))| move || *seen = Some(see(i, times)));
    match (work.next(), work.next(), work.next()) {
        (Some(mut a), Some(mut b), Some(mut c)) => workers.both(&mut a, &mut || workers.both(&mut b, &mut c)),
        (Some(mut a), Some(mut b), None) => workers.both(&mut a, &mut b),
        (a, ..) => a.into_iter().for_each(|mut a| a()),
    }
    let taken = found.into_iter().map(|(seen, its_times)| {
        its_times.into_iter().for_each(|(stage, nanos)| add_time(times, stage, nanos));
        seen.ok_or_else(|| Error::new(ErrorKind::Cancelled, "the caller's workers left out a frame"))?
    });
    taken.collect()
}

/// Puts the faces together that are there, one a frame; where two leave two boxes, their frames are asked how deep the box is behind
/// the faces.
fn assemble(
    frames: &[&Frame],
    faces: &[Option<&FaceMeasurement>],
    calibration: &Calibration,
    settings: &Settings,
) -> (Outcome, Vec<Warning>, Option<DepthSeen>) {
    let known: Vec<(&Frame, &FaceMeasurement)> =
        frames.iter().zip(faces).filter_map(|(frame, face)| Some((*frame, (*face)?))).collect();
    let faces: Vec<&FaceMeasurement> = known.iter().map(|(_, face)| *face).collect();
    let (outcome, warnings) = cuboid::assemble(&faces, settings.choose);
    if let (Outcome::Ambiguous(candidates), [(p, a), (q, b)]) = (&outcome, &known[..])
        && let Some((which, seen)) = box_depth::settle(calibration, [*p, *q], [*a, *b], candidates)
    {
        let (outcome, warnings) = cuboid::assemble(&faces, Some(which));
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
        let which = Which::WithAlternatives;
        let task = Task { frame, calibration, settings, asked: None, edge_map: None, which };
        face_stages(&task, &mut clock).ok()
    });
    let (first, second) = (first?, second?);
    let [first, second] = [&first, &second].map(|seen| seen.measured().collect::<Vec<_>>());
    let mut found: Option<BoxReport> = None;
    for (i, a) in first.iter().copied().enumerate() {
        for (j, b) in second.iter().copied().enumerate() {
            // One of the two is as likely as can be: two alternatives at once would agree too easily.
            if i > 0 && j > 0 {
                continue;
            }
            let (outcome, warnings, settled) = assemble(&frames, &[Some(a), Some(b)], calibration, settings);
            if matches!(outcome, Outcome::Rejected(_)) {
                continue;
            }
            if found.as_ref().is_some_and(|f| !cuboid::same_outcome(&f.outcome, &outcome)) {
                return None;
            }
            let measured = |face: &FaceMeasurement| FaceOutcome::Measured(Box::new(face.clone()));
            found.get_or_insert(BoxReport {
                outcome,
                faces: vec![measured(a), measured(b)],
                warnings,
                settled,
                confidence: None,
                likeliest: Vec::new(),
            });
        }
    }
    found
}
