//! One frame: from the picture to the faces that it may show, each measured.

use super::progress::Progress;
use super::tracer::Tracer;
use crate::calibration::Calibration;
use crate::confidence;
use crate::edges::{EdgeDetector, subpixel::GradientDetector};
use crate::error::{Error, ErrorKind};
use crate::face::end_outline::{cut_by_border, end_outline, ends_seen, limits};
use crate::face::extent::{FaceStripes, InnerSegments, StripeContrast, follow_stripes, inner_segments};
use crate::face::map_outline::{MapOutline, map_outline, mask_at_border};
use crate::face::outline::InitialRectangle;
use crate::feasibility::{self, Hint};
use crate::frames::{Cam, Plane};
use crate::hypotheses::{FaceHypotheses, FaceHypothesis, MeasuredOutline, weighed};
use crate::image::Frame;
use crate::image::bands::band_maps;
use crate::image::laser_response::{Diagonal, RidgeMap, faint_ridge_map, half_laser_response};
use crate::measurement::{EdgeMethod, FaceMeasurement, FaceOutcome, Method, Settings, StageTimes};
use crate::network::{Channel, EdgeMap, EdgeMapNetwork, FaceMaps, Network, NetworkOutput};
use crate::paper::hough::HoughDetector;
use crate::paper::key_points;
use crate::paper::outline::hough_outline;
use crate::rectangle;
use crate::rectangle::SidesOf;
use crate::rectangle::outlines::{OutlineHypothesis, Pair, outlines};
use crate::rectangle::snap::snap_to_image;
use crate::reject::Reject;
use crate::report::FaceReport;
use crate::scene::cut::{self, CutSides};
use crate::scene::hidden::HiddenSides;
use crate::scene::lit::LitLines;
use crate::sides::ViewAxes;
use crate::stripe::grid_search::{self, Evidence, GridHypothesis, GridSearchSettings};
use crate::units::{Estimate, LaserId};
use crate::view::SideOdds;
use std::sync::atomic::Ordering;

/// When stripes and maps show a face on a plane. Where a field gives no reason for its value, none is on record.
#[derive(Clone, Copy, Debug)]
struct FaceSettings {
    /// Planes that are tried, strongest first. More takes longer where there is no face.
    planes: usize,
    /// Share of each stripe between its ends that must be seen on the face's plane: more than half of it may be print. More refuses faces with
    /// much print.
    least_seen: f64,
    /// ... one of the four may show this share on a face with known sides: by chance a line without a stripe shows 0.1. More refuses faces with
    /// dark print along one stripe.
    least_seen_of_one: f64,
    /// ... and share of its inner segment, which a line of big red letters can cover for the most part. More refuses faces with such letters.
    least_inner_seen: f64,
    /// Largest robust scatter of the stripe centres, in units of their own sigmas. More takes what is no plane for a face.
    most_scale: f64,
    /// Overlap of the outline with the network's mask (intersection over union) below which the maps show no face here; right outlines of rendered
    /// boxes have 0.7 and more. More refuses faces of which the mask is ragged.
    least_overlap: f32,
}

impl FaceSettings {
    const DEFAULT: Self = Self {
        planes: 4,
        least_seen: 0.4,
        least_seen_of_one: 0.2,
        least_inner_seen: 0.15,
        most_scale: 3.5,
        least_overlap: 0.5,
    };
}

impl Default for FaceSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What a frame shows.
pub(super) struct FrameResult {
    pub hypotheses: Result<FaceHypotheses, Reject>,
    /// For a view that cannot be measured: how to move.
    pub hint: Option<Hint>,
    pub times: StageTimes,
}

impl FrameResult {
    /// By itself.
    pub fn outcome(&self) -> FaceOutcome {
        match self.hypotheses.as_ref().map_err(Clone::clone).and_then(FaceHypotheses::face) {
            Ok(face) => FaceOutcome::Measured(Box::new(face.clone())),
            Err(reject) => FaceOutcome::Rejected(reject),
        }
    }
}

/// Measures one face.
///
/// # Errors
/// [`ErrorKind::CalibrationMismatch`] if the frame's size is not the calibration's; [`ErrorKind::Cancelled`].
pub fn measure_face(
    frame: &Frame,
    calibration: &Calibration,
    settings: &Settings,
) -> Result<FaceReport, Error> {
    let result = see_face(frame, calibration, settings)?;
    Ok(FaceReport { outcome: result.outcome(), hint: result.hint, times: result.times })
}

/// Looks at one frame.
pub(super) fn see_face(
    frame: &Frame,
    calibration: &Calibration,
    settings: &Settings,
) -> Result<FrameResult, Error> {
    check_size(frame, calibration)?;
    check_cancelled(settings)?;
    let mut progress = Progress::new();
    let network = chosen_network(settings).map(|network| NetworkOutput::new(network, frame)).transpose()?;
    let edge_map = paper_network(settings).map(|network| network.edge_map(frame)).transpose()?;
    progress.lap("network");
    check_cancelled(settings)?;
    let task = Task { frame, calibration, settings, network: network.as_ref(), edge_map: edge_map.as_ref() };
    if let Some(network) = &network {
        task.tracer().network(&network.maps);
    }
    let seen = face_stages(&task, &mut progress);
    check_cancelled(settings)?; // what was cut short is no result
    network.map_or(Ok(()), NetworkOutput::finish)?;
    let seen = seen.map(|mut seen| {
        for hypothesis in &mut seen.faces {
            if let Ok(face) = &hypothesis.face
                && let Some(reject) = feasibility::too_far(calibration, face.corners)
            {
                hypothesis.face = Err(reject);
            }
        }
        seen
    });
    let hint = match seen.as_ref().map_err(Clone::clone).and_then(FaceHypotheses::face) {
        Ok(_) => None,
        Err(reject) => Hint::new(calibration, progress.pose.as_ref(), &reject),
    };
    Ok(FrameResult { hypotheses: seen, hint, times: progress.times })
}

/// Refuses a frame that is not of the calibration's size.
pub(super) fn check_size(frame: &Frame, calibration: &Calibration) -> Result<(), Error> {
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
    Ok(())
}

fn is_cancelled(settings: &Settings) -> bool {
    settings.cancelled.is_some_and(|cancelled| cancelled.load(Ordering::Relaxed))
}

fn check_cancelled(settings: &Settings) -> Result<(), Error> {
    if is_cancelled(settings) { Err(Error::new(ErrorKind::Cancelled, "cancelled")) } else { Ok(()) }
}

/// The network, if this way of finding edges asks one.
fn chosen_network<'a>(settings: &Settings<'a>) -> Option<&'a dyn Network> {
    settings.network.filter(|_| settings.edges != EdgeMethod::Gradient && paper_network(settings).is_none())
}

/// The paper's network, if this way of finding edges asks it.
pub(super) fn paper_network<'a>(settings: &Settings<'a>) -> Option<&'a dyn EdgeMapNetwork> {
    settings.edge_map.filter(|_| settings.edges == EdgeMethod::Hough)
}

/// What every stage gets.
#[derive(Clone, Copy)]
struct Task<'a> {
    frame: &'a Frame,
    calibration: &'a Calibration,
    settings: &'a Settings<'a>,
    network: Option<&'a NetworkOutput<'a>>,
    /// The paper's map.
    edge_map: Option<&'a EdgeMap>,
}

impl Task<'_> {
    fn tracer(&self) -> Tracer<'_> {
        Tracer { trace: self.settings.trace, frame: self.frame, calibration: self.calibration }
    }
}

fn face_stages(task: &Task, progress: &mut Progress) -> Result<FaceHypotheses, Reject> {
    let Task { frame, calibration, network, .. } = *task;
    let maps = network.map(|network| &network.maps);
    let grid = GridSearchSettings::default();
    let most = FaceSettings::DEFAULT.planes;
    let diagonals = grid_search::diagonals(calibration);
    let ridges = band_maps(frame, diagonals);
    progress.lap("ridge");
    let planes =
        grid_search::find_planes(calibration, &evidence(&ridges, maps, &grid), &grid, grid.clear, most);
    progress.lap("grid");
    task.tracer().planes(&ridges, &planes);
    let refusal = match measure_on_planes(task, &planes, StripeContrast::Clear, progress) {
        Ok(seen) => return Ok(seen),
        // Whether a stripe is dark or misses the face is told by the other three.
        Err(Some(reject)) if !matches!(reject, Reject::NoBox { .. } | Reject::StripeNotFound { .. }) => {
            return Err(reject);
        }
        Err(refusal) => refusal,
    };
    let seen = progress.pose.take();
    let (width, height, laser_response) = half_laser_response(frame);
    let faint = diagonals.map(|d: Diagonal| faint_ridge_map(width, height, &laser_response, d));
    let evidence = evidence(&faint, maps, &grid);
    let planes = grid_search::find_planes(calibration, &evidence, &grid, grid.faint, most);
    let planes: Vec<GridHypothesis> =
        planes.iter().map(|plane| grid_search::climb(calibration, &evidence, &grid, plane)).collect();
    progress.lap("faint");
    task.tracer().planes(&faint, &planes);
    measure_on_planes(task, &planes, StripeContrast::Faint, progress).map_err(|faint| {
        progress.pose = progress.pose.take().or(seen);
        let missing = grid_search::three_stripes(calibration, &ridges[0], &ridges[1], &grid);
        progress.lap("grid");
        let missing = missing.map(|laser| Reject::StripeMissing { laser, stripes_on_face: 3 });
        missing.or(faint).or(refusal).unwrap_or_else(|| no_box(0.0))
    })
}

/// What speaks for each laser's stripe.
fn evidence<'a>(
    ridges: &'a [RidgeMap; 2],
    maps: Option<&FaceMaps>,
    grid: &GridSearchSettings,
) -> [Evidence<'a>; 4] {
    LaserId::ALL.map(|id| {
        let ridge = &ridges[id.index() / 2];
        maps.map_or_else(|| Evidence::ridge(ridge), |maps| Evidence::with_network(ridge, maps, id, grid))
    })
}

/// The face on the first of the planes, strongest first, on which one can be measured, also if it is unsure: going on until a plane gives a sure
/// face would end at a wrong plane. If none can be measured: the reason why the strongest cannot, if there is a plane.
fn measure_on_planes(
    task: &Task,
    planes: &[GridHypothesis],
    contrast: StripeContrast,
    progress: &mut Progress,
) -> Result<FaceHypotheses, Option<Reject>> {
    let mut refusal: Option<(f32, Reject)> = None;
    let mut pose = None;
    for hypothesis in planes.iter().take_while(|_| !is_cancelled(task.settings)) {
        progress.pose = None;
        match measure_on_plane(task, hypothesis, contrast, progress) {
            Ok(seen) => return Ok(seen),
            Err(reject) => {
                if refusal.as_ref().is_none_or(|(total, _)| hypothesis.total() > *total) {
                    refusal = Some((hypothesis.total(), reject));
                    pose = progress.pose;
                }
            }
        }
    }
    progress.pose = pose;
    Err(refusal.map(|(_, reject)| reject))
}

fn measure_on_plane(
    task: &Task,
    hypothesis: &GridHypothesis,
    contrast: StripeContrast,
    progress: &mut Progress,
) -> Result<FaceHypotheses, Reject> {
    let Task { frame, calibration, .. } = *task;
    let inner = inner_segments(frame, calibration, &hypothesis.plane, contrast);
    progress.lap("stripes");
    let inner = inner.ok_or_else(|| no_box(0.0))?;
    let wide = follow_stripes(frame, calibration, &inner, None);
    progress.lap("stripes");
    if let Some(stripes) = &wide {
        task.tracer().stripes(stripes);
    }
    match task.edge_map {
        Some(map) => measure_in_edge_map(task, &inner, &wide.ok_or_else(|| no_box(0.0))?, map, progress),
        None => measure_outlines(task, &inner, wide.as_ref(), progress),
    }
}

/// Measures the face whose sides the paper's map shows.
fn measure_in_edge_map(
    task: &Task,
    inner: &InnerSegments,
    wide: &FaceStripes,
    map: &EdgeMap,
    progress: &mut Progress,
) -> Result<FaceHypotheses, Reject> {
    let Task { frame, calibration, .. } = *task;
    let initial = hough_outline(frame, calibration, &wide.fit.plane, map);
    progress.lap("outline");
    let mut initial = initial.map_err(|open| cut_by_border(frame, wide).unwrap_or(open))?;
    progress.see(&initial.raster, &initial.offsets_mm);
    let limits = limits(calibration, &initial.raster, &initial.offsets_mm, initial.mm_per_px);
    let face = follow_stripes(frame, calibration, inner, limits.as_ref());
    progress.lap("stripes");
    let face = face.ok_or_else(|| no_box(0.0))?;
    check_stripes(&face, limits.is_some())?;
    initial.raster = initial.raster.on(&face.fit.plane);
    initial.at_ends = ends_seen(calibration, &face, &initial.raster).unwrap_or(initial.at_ends);
    let face = measure_initial(task, &face, &initial, progress)?;
    Ok(FaceHypotheses { faces: vec![FaceHypothesis::only(face)], unsure: None, overlap: 0.0 })
}

/// Measures the face along the outlines that it may have.
fn measure_outlines(
    task: &Task,
    inner: &InnerSegments,
    wide: Option<&FaceStripes>,
    progress: &mut Progress,
) -> Result<FaceHypotheses, Reject> {
    let Task { frame, calibration, network, .. } = *task;
    let (outline, overlap) = first_outline(task, inner, wide, progress)?;
    let wide = wide.ok_or_else(|| no_box(0.0))?;
    let seen = network.and_then(|network| seen_in_plane(calibration, wide, &outline, network));
    progress.lap("sides");
    let lit = LitLines::of(frame, calibration, wide);
    let outlines = outlines(frame, calibration, wide, &outline, network, seen.as_ref(), &lit)
        .ok_or_else(|| no_box(0.0))?;
    progress.lap("outline");
    task.tracer().outlines(&outlines);
    let best = outlines.first().ok_or(Reject::RectangleOpen { sides_found: 0 })?;
    progress.see(&best.outline.raster, &best.outline.offsets_mm);
    let (mut free, mut cut) = (1.0, None);
    if let Some(((_, odds), network)) = seen.as_ref().zip(network) {
        let hidden = HiddenSides::of(frame, calibration, wide, &best.outline, odds);
        progress.lap("outline");
        if let Some(reject) = hidden.refusal(calibration, &best.outline) {
            return Err(reject);
        }
        free = hidden.chance_that_free();
        let (outline, maps) = (&best.outline, &network.maps);
        cut = Some(CutSides::of(&cut::CutClues { calibration, wide, outline, odds, maps, lit: &lit }));
    }
    let whole = cut.as_ref().map_or([1.0; 2], CutSides::chance_that_whole);
    let pair = |pair: Pair, whole: f64| Pair { probability: free * whole * pair.probability, ..pair };
    let measured = outlines.iter().map(|OutlineHypothesis { outline, probability, pairs }| MeasuredOutline {
        probability: free * whole[0] * whole[1] * probability,
        pairs: [0, 1].map(|axis| pair(pairs[axis], whole[axis])),
        sides_mm: [1, 3].map(|high| outline.offsets_mm[high] - outline.offsets_mm[high - 1]),
        face: measure_outline(task, inner, outline, progress).map(|face| {
            let light = lit.of_sides(calibration, outline, &face);
            Box::new(FaceMeasurement { light: Some(light), ..face })
        }),
    });
    let faces = weighed(measured.collect(), |face| located([&face.length, &face.width], task.settings));
    // A plane on which no outline can be measured is none.
    if faces.iter().all(|a| a.face.is_err())
        && let Some(FaceHypothesis { face: Err(reject), .. }) = faces.first()
    {
        return Err(reject.clone());
    }
    let likeliest = faces.first().and_then(|a| a.face.as_ref().ok()?.confidence).unwrap_or(0.0);
    let unsure = (likeliest < task.settings.least_confidence).then(|| {
        let cut = cut.as_ref().and_then(CutSides::refusal);
        cut.unwrap_or_else(|| unclear(task, likeliest, overlap))
    });
    Ok(FaceHypotheses { faces, unsure, overlap })
}

/// The first outline, to some px: in the network's maps, or where the stripes end; and its overlap with the network's mask.
fn first_outline(
    task: &Task,
    inner: &InnerSegments,
    wide: Option<&FaceStripes>,
    progress: &mut Progress,
) -> Result<(InitialRectangle, f64), Reject> {
    let Task { frame, calibration, network, .. } = *task;
    let Some(NetworkOutput { maps, .. }) = network else {
        let wide = wide.ok_or_else(|| no_box(0.0))?;
        check_stripes(wide, false)?;
        let outline = end_outline(frame, calibration, wide);
        progress.lap("outline");
        return Ok((outline?, 0.0));
    };
    let outline = map_outline(calibration, &inner.plane, maps);
    progress.lap("outline");
    let overlap = outline.as_ref().map_or(0.0, |outline| outline.overlap);
    match outline.filter(|_| overlap >= FaceSettings::DEFAULT.least_overlap) {
        Some(MapOutline { initial, overlap }) => Ok((initial, f64::from(overlap))),
        // Why: a face that leaves the image has no outline.
        None => Err(wide
            .and_then(|face| cut_by_border(frame, face))
            .unwrap_or_else(|| unclear(task, 0.0, f64::from(overlap)))),
    }
}

/// What the network of sides says of the face, seen in the plane of its stripes.
fn seen_in_plane(
    calibration: &Calibration,
    wide: &FaceStripes,
    outline: &InitialRectangle,
    network: &NetworkOutput<'_>,
) -> Option<(ViewAxes, SideOdds)> {
    let axes = ViewAxes::of(calibration, outline.raster.on(&wide.fit.plane))?;
    let odds = network.sides(&axes.view(&network.small(), calibration))?;
    Some((axes, odds))
}

/// Measures the face along one outline.
fn measure_outline(
    task: &Task,
    inner: &InnerSegments,
    outline: &InitialRectangle,
    progress: &mut Progress,
) -> Result<FaceMeasurement, Reject> {
    let Task { frame, calibration, .. } = *task;
    let limits = limits(calibration, &outline.raster, &outline.offsets_mm, outline.mm_per_px);
    let face = follow_stripes(frame, calibration, inner, limits.as_ref());
    progress.lap("stripes");
    let face = face.ok_or_else(|| no_box(0.0))?;
    check_stripes(&face, limits.is_some())?;
    let initial = snap_to_image(frame, calibration, &face, outline);
    progress.lap("sides");
    let initial = initial?;
    // All stripes go on in the plane beyond all sides: a tile of a floor, a panel of a wall, a field of print.
    if !initial.at_ends.contains(&true) {
        return Err(Reject::RectangleOpen { sides_found: 0 });
    }
    measure_initial(task, &face, &initial, progress)
}

/// Measures the face that is where one was a moment ago: near a plane, and beside an outline on the plane that its stripes then have.
/// Asks no network.
pub(super) fn measure_beside(
    frame: &Frame,
    calibration: &Calibration,
    settings: &Settings,
    plane: &Plane<Cam>,
    outline: impl FnOnce(&Plane<Cam>) -> Option<InitialRectangle>,
) -> Option<FaceMeasurement> {
    let settings = &Settings { edges: EdgeMethod::Gradient, trace: None, ..*settings };
    let task = Task { frame, calibration, settings, network: None, edge_map: None };
    let inner = inner_segments(frame, calibration, plane, StripeContrast::Clear)?;
    measure_outline(&task, &inner, &outline(&inner.plane)?, &mut Progress::new()).ok()
}

/// Finds the edges beside an initial rectangle and fits it.
fn measure_initial(
    task: &Task,
    face: &FaceStripes,
    initial: &InitialRectangle,
    progress: &mut Progress,
) -> Result<FaceMeasurement, Reject> {
    let Task { frame, calibration, settings, network, edge_map, .. } = *task;
    let hough = HoughDetector {
        map: edge_map
            .map(EdgeMap::view)
            .or_else(|| network.map(|network| network.maps.view(Channel::FaceEdge))),
        stripes_on: edge_map.map(|_| &face.fit.plane),
    };
    let detector: &dyn EdgeDetector = match settings.edges {
        EdgeMethod::Net | EdgeMethod::Gradient => &GradientDetector::DEFAULT,
        EdgeMethod::Hough => &hough,
    };
    let keep_out = rectangle::keep_out(calibration, face, initial);
    let edges = detector.edge_points(frame, calibration, initial, &keep_out);
    progress.lap("edges");
    let by_key_points: SidesOf<'_> = &|fit| key_points::measure(calibration, face, fit, &edges);
    let by_key_points = (settings.method == Method::Keypoints).then_some(by_key_points);
    let result = rectangle::measure(frame, calibration, face, initial, &edges, settings, by_key_points);
    progress.lap("fit");
    result
}

/// The refusal of a face whose outline is not clear.
fn unclear(task: &Task, probability: f64, overlap: f64) -> Reject {
    match task.network.and_then(|network| mask_at_border(&network.maps)) {
        Some((sides_cut, at)) => Reject::FaceCutByBorder { sides_cut, at },
        None => unsure(probability, task.settings, overlap),
    }
}

/// The refusal of a result that is not likely enough to be right.
pub(super) fn unsure(probability: f64, settings: &Settings, overlap: f64) -> Reject {
    Reject::OutlineUnsure {
        support: probability,
        needed_support: settings.least_confidence,
        overlap,
        needed_overlap: f64::from(FaceSettings::DEFAULT.least_overlap),
    }
}

/// Probability that sides along the right lines are right. The paper's key points have wide sigmas and are shown as the paper has them.
pub(super) fn located<'a>(sides: impl IntoIterator<Item = &'a Estimate>, settings: &Settings) -> f64 {
    let weighs_sigma = settings.method == Method::Fit && settings.edges != EdgeMethod::Hough;
    if weighs_sigma { confidence::located(sides) } else { 1.0 }
}

/// Every stripe must be seen on the plane, and the centres must scatter as they should.
///
/// Where the sides are known already, all of the stripe counts, not only what lies between its ends.
fn check_stripes(face: &FaceStripes, sides_known: bool) -> Result<(), Reject> {
    let FaceSettings { least_seen, least_seen_of_one, least_inner_seen, most_scale, .. } =
        FaceSettings::DEFAULT;
    let seen = face.stripes.each_ref().map(|s| {
        let seen = if sides_known { s.whole_share } else { s.seen_share };
        seen.min(s.inner_share / least_inner_seen * least_seen)
    });
    let least = seen.iter().copied().fold(f64::INFINITY, f64::min);
    let planar = face.fit.scale <= most_scale;
    let mut unseen = LaserId::ALL.into_iter().filter(|id| seen[id.index()] < least_seen);
    match (unseen.next(), unseen.next()) {
        (None, _) if planar => Ok(()),
        // Dark print hides most of one stripe; the other three hold the plane.
        (Some(laser), None) if planar && sides_known && seen[laser.index()] >= least_seen_of_one => Ok(()),
        (Some(laser), None) if planar => {
            Err(Reject::StripeNotFound { laser, seen_share: seen[laser.index()], needed_share: least_seen })
        }
        _ => Err(no_box(least)),
    }
}

fn no_box(best_share: f64) -> Reject {
    Reject::NoBox { best_share, needed_share: FaceSettings::DEFAULT.least_seen }
}
