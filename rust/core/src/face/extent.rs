//! How far each stripe stays on the face's plane: its ends are the key points D1-D8, unless a neighbour is flush.

use super::outline::Across;
use super::plane_fit::{PlaneFit, StripeObservation, fit_plane};
use super::raster::PlaneRaster;
use crate::calibration::Calibration;
use crate::frames::{Cam, Plane, Ray};
use crate::image::Frame;
use crate::statistics::median;
use crate::stripe::centres::{
    CentreSettings, StripePoint, find_centres, find_centres_again, measure_half_width_px,
};
use crate::stripe::colour_projection::{ColourProjection, measure_projections};
use crate::stripe::stripe_line::{ScanDirection, StripeLine};
use crate::units::{LaserId, Px};

/// Where a stripe leaves the plane, at one of its ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StripeEnd {
    /// Predicted stripe pixel half way between the last place on the plane and the first one off it.
    pub at: Px,
    /// Half the uncertain stretch, px along the stripe.
    pub uncertainty_px: f64,
    /// The stripe runs on to the image border, or to where it was looked for: its end was not seen.
    pub runs_on: bool,
}

/// A stripe on the face's plane.
#[derive(Clone, Debug)]
pub(crate) struct FaceStripe {
    /// The lower and the upper end along the walk.
    pub ends: [StripeEnd; 2],
    /// All places along the whole line, on the plane or not.
    pub points: Vec<StripePoint>,
    /// How each of them speaks for being on the plane, -1 to 1.
    pub on_plane_score: Vec<f64>,
    /// Range of `points` that lies on the plane.
    pub on_plane: std::ops::Range<usize>,
    /// Share of the inner segment (between the crossings) that was seen on the plane, 0 to 1.
    pub inner_share: f64,
    /// Share of the places between the two ends that were seen on the plane, 0 to 1.
    pub seen_share: f64,
    /// Share of all places that were looked at and seen on the plane, 0 to 1.
    pub whole_share: f64,
}

/// The face's plane and the four stripes on it.
#[derive(Clone, Debug)]
pub(crate) struct FaceStripes {
    pub fit: PlaneFit,
    pub stripes: [FaceStripe; 4],
    /// Half the width of the stripes at their foot, px.
    pub half_width_px: f64,
    /// Peaks of each stripe that are higher are red print, grey levels in its projection.
    highest: [f64; 4],
}

impl FaceStripes {
    /// The centres of one stripe on the plane, without those that red print gave.
    pub fn centres(&self, id: LaserId) -> impl Iterator<Item = StripeObservation> + '_ {
        let stripe = &self.stripes[id.index()];
        centres(id, &stripe.points[stripe.on_plane.clone()], self.highest[id.index()])
    }
}

/// Settings of the way from a plane's hypothesis to the stripes on the face. Where no reason stands, there is no record of how a value was chosen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FollowSettings {
    /// For stripes that some rows show.
    clear: ContrastSettings,
    /// For stripes that only sums over whole segments show.
    faint: ContrastSettings,
    /// Fewest rows in one profile; 4 keep the ends sharp. More blurs them.
    fewest_rows: usize,
    /// Half width of a stripe at its foot before it is measured, px: between the narrowest and the widest. More takes in what lies beside narrow
    /// stripes, less cuts wide ones.
    first_half_width_px: f64,
    /// Peak over noise that one profile should reach: at 6 the centre scatters by about a pixel. More adds more rows, which blurs the ends.
    wanted_snr: f64,
    /// A peak this many sigmas from the prediction counts neither for nor against the plane; farther away it counts against. More takes what is
    /// beside the plane for the face, less loses bulged faces.
    on_plane_sigmas: f64,
    /// The prediction's uncertainty grows with the distance from what was fitted, so the first steps are short and lenient. More passes take longer.
    passes: [Pass; 4],
    /// A peak lower than this share of the stripe's usual height is another surface (the floor behind the box): black print reflects at least 4 %
    /// where cardboard reflects 30 %. More loses dark print, less follows the stripe onto the floor.
    least_share: f64,
    /// A peak higher than this many times the usual height is red print: a white label reflects 2 to 3 times what cardboard does. More takes red
    /// print for the stripe, less loses the stripe on labels.
    most_share: f64,
    /// Residuals of four true stripes scatter by 0.6 to 1.2 of their sigmas; above this one is looked for that does not fit ... More leaves in a
    /// stripe that followed print.
    suspicious_scale: f64,
    /// ... and is left out if the others then scatter by less than this share of it. More leaves out true ones.
    outlier_gain: f64,
    /// What a place without a peak counts against the stripe, a place with a peak on the plane counting 1: dark print and black tape swallow a
    /// stripe for a while; it must come back for as many places as half the gap. Nearer to 0 bridges longer gaps.
    absent: f64,
}

/// What differs with how well stripes are seen. Where no reason stands, there is no record of how a value was chosen.
#[derive(Clone, Copy, Debug)]
struct ContrastSettings {
    /// Rows per profile to begin with, and at most: 64 still follow a line that a tilted face bends. Of a faint inner segment, which has some 300
    /// rows, a plane needs a dozen centres. More shows fainter light and blurs the stripe's ends.
    rows: [usize; 2],
    /// Farthest peak from the prediction in each round, px. More bears a worse start and finds more wrong peaks.
    search_px: [f64; 3],
    /// Smallest peak over noise: what is not the stripe is left out by the plane's fit. More loses faint light, less finds more wrong peaks.
    least_snr: f64,
    /// Across how much of their half width profiles are averaged, which makes up for the rows. More shows fainter light and blurs clear stripes.
    smooth_share: f64,
}

/// One pass outwards along the stripes. Where no reason stands, there is no record of how a value was chosen.
#[derive(Clone, Copy, Debug)]
struct Pass {
    /// Farthest peak from the prediction, px. More finds more wrong peaks, less loses the stripe where the plane is known less well.
    search_px: f64,
    /// How far beyond the inner segment, in its lengths. More goes to where the plane is not known well enough yet.
    reach: f64,
    /// Uncertainty of the prediction, px; in the last passes texture and print, beyond noise and speckle. More takes what is
    /// beside the plane for the face.
    slack_px: f64,
}

impl Default for FollowSettings {
    fn default() -> Self {
        let pass = |search_px, reach, slack_px| Pass { search_px, reach, slack_px };
        let everywhere = f64::INFINITY;
        Self {
            clear: ContrastSettings {
                rows: [16, 64],
                search_px: [10.0, 6.0, 4.0],
                least_snr: 3.0,
                smooth_share: 0.0,
            },
            faint: ContrastSettings {
                rows: [64, 64],
                search_px: [6.0, 5.0, 4.0],
                least_snr: 2.0,
                smooth_share: 0.35,
            },
            fewest_rows: 4,
            first_half_width_px: 10.0,
            wanted_snr: 6.0,
            on_plane_sigmas: 2.5,
            passes: [
                pass(6.0, 0.5, 0.8),
                pass(5.0, 1.5, 0.5),
                pass(4.0, everywhere, 0.3),
                pass(4.0, everywhere, 0.2),
            ],
            least_share: 0.13,
            most_share: 3.5,
            suspicious_scale: 1.3,
            outlier_gain: 0.8,
            absent: -0.5,
        }
    }
}

impl FollowSettings {
    fn of(&self, contrast: StripeContrast) -> &ContrastSettings {
        match contrast {
            StripeContrast::Clear => &self.clear,
            StripeContrast::Faint => &self.faint,
        }
    }
}

/// The crossing of lasers `i` and `j` on a plane.
pub(crate) fn crossing_px(
    calibration: &Calibration,
    plane: &Plane<Cam>,
    i: LaserId,
    j: LaserId,
) -> Option<Px> {
    let x = (plane.per_mm - calibration.laser(i).per_mm).cross(&(plane.per_mm - calibration.laser(j).per_mm));
    if x.z.abs() < 1e-15 {
        return None;
    }
    let x = x / x.z;
    calibration.camera().px_from_ray(&Ray::new(x.x, x.y))
}

/// Where the stripe of `id` meets the line `offset` on a raster: the other coordinate, mm.
pub(crate) fn crossing_on(
    calibration: &Calibration,
    raster: &PlaneRaster,
    across: Across,
    offset: f64,
    id: LaserId,
) -> Option<f64> {
    let p = calibration.laser(id).per_mm;
    let start = raster.cam_point(across.at(offset, 0.0)).mm;
    let direction = raster.cam_point(across.at(offset, 1.0)).mm - start;
    let slope = p.dot(&direction);
    (slope.abs() > 1e-12).then(|| (1.0 - p.dot(&start)) / slope)
}

/// The pixel where the stripe of `id` meets the line `offset` on a raster.
pub(crate) fn crossing_on_px(
    calibration: &Calibration,
    raster: &PlaneRaster,
    across: Across,
    offset: f64,
    id: LaserId,
) -> Option<Px> {
    let along = crossing_on(calibration, raster, across, offset, id)?;
    raster.pixel(calibration, across.at(offset, along))
}

/// How far out the outermost crossing of the stripes that cross a side is, mm from the middle of a raster on their plane.
pub(crate) fn outermost_crossing_mm(
    calibration: &Calibration,
    raster: &PlaneRaster,
    (across, high): (Across, bool),
) -> Option<f64> {
    let sign = if high { 1.0 } else { -1.0 };
    let mut outermost_mm = f64::NEG_INFINITY;
    for id in across.stripes() {
        for other in crossing_lasers(id) {
            let at = raster.on_plane(calibration, crossing_px(calibration, &raster.plane, id, other)?)?;
            outermost_mm = outermost_mm.max(sign * across.offset(at));
        }
    }
    Some(outermost_mm)
}

/// The two lasers that cross a laser's stripe.
pub(crate) fn crossing_lasers(id: LaserId) -> [LaserId; 2] {
    let [l1, l2, l3, l4] = LaserId::ALL;
    if id.number() <= 2 { [l3, l4] } else { [l1, l2] }
}

/// How well the stripes are seen before they are followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StripeContrast {
    /// Some rows show them.
    Clear,
    /// They are known from sums over whole segments, to some px.
    Faint,
}

/// What the inner segments of the four stripes (between their crossings) tell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InnerSegments {
    pub plane: Plane<Cam>,
    half_width_px: f64,
    rows: [usize; 4],
    projections: [ColourProjection; 4],
    usual: [f64; 4],
    contrast: StripeContrast,
    settings: FollowSettings,
}

/// Refines the plane of a hypothesis on the inner segments alone: whatever lies around the face cannot mislead them.
/// `None` if the stripes do not hold it.
pub(crate) fn inner_segments(
    frame: &Frame,
    calibration: &Calibration,
    start: &Plane<Cam>,
    contrast: StripeContrast,
) -> Option<InnerSegments> {
    let settings = FollowSettings::default();
    let ContrastSettings { rows: [first_rows, most_rows], search_px, .. } = *settings.of(contrast);
    let mut inner = InnerSegments {
        plane: *start,
        half_width_px: settings.first_half_width_px,
        rows: [first_rows; 4],
        projections: [ColourProjection::LASER_RESPONSE; 4],
        usual: [0.0; 4],
        contrast,
        settings,
    };
    for (round, search_px) in search_px.into_iter().enumerate() {
        let mut pieces = Vec::with_capacity(4);
        for id in LaserId::ALL {
            pieces.push(inner_segment(calibration, &inner.plane, id)?);
        }
        // Anew when the plane is nearly right; in between they would hardly change.
        if round != 1 {
            inner.projections = measure_projections(frame, calibration, &pieces).try_into().ok()?;
            inner.half_width_px = measure_half_width_px(frame, calibration, &pieces, &inner.projections)
                .unwrap_or(inner.half_width_px);
        }
        let mut traces = Vec::with_capacity(4);
        for (id, (line, range, from)) in LaserId::ALL.into_iter().zip(pieces) {
            let tracing = inner.centre_settings(id, search_px);
            let points = find_centres(frame, calibration, &line, range, from, &tracing);
            inner.rows[id.index()] = rows_for(&points, tracing.rows, most_rows, &settings);
            traces.push(points);
        }
        inner.usual = usual_amplitudes(&traces)?;
        let mut observations = Vec::new();
        let highest = inner.highest();
        for (id, points) in LaserId::ALL.into_iter().zip(&traces) {
            observations.extend(centres(id, points, highest[id.index()]));
        }
        inner.plane = fit_without_outlier(calibration, &observations, &inner.plane, &settings)?;
    }
    Some(inner)
}

impl InnerSegments {
    /// Peaks that are higher are none of each stripe.
    fn highest(&self) -> [f64; 4] {
        self.usual.map(|usual| self.settings.most_share * usual)
    }

    fn centre_settings(&self, id: LaserId, search_px: f64) -> CentreSettings {
        let contrast = self.settings.of(self.contrast);
        CentreSettings {
            rows: self.rows[id.index()],
            search_px,
            min_signal_to_noise: contrast.least_snr,
            half_width_px: self.half_width_px,
            projection: self.projections[id.index()],
            smooth_px: contrast.smooth_share * self.half_width_px,
            ..CentreSettings::default()
        }
    }
}

/// Places on each stripe between which it is looked for; in the order of the lasers.
pub(crate) type Limits = [[Px; 2]; 4];

/// Follows the stripes outwards in steps: longer stripes fix the plane better, a better plane predicts farther. `None` if
/// the stripes do not hold the plane.
pub(crate) fn follow_stripes(
    frame: &Frame,
    calibration: &Calibration,
    inner: &InnerSegments,
    limits: Option<&Limits>,
) -> Option<FaceStripes> {
    let (mut before, mut plane) = (inner.plane, inner.plane);
    let mut result: Option<FaceStripes> = None;
    for pass in &inner.settings.passes {
        let mut observations = Vec::new();
        let mut stripes = Vec::with_capacity(4);
        // The plane hardly moves any more towards the end.
        let seen = result.take();
        for id in LaserId::ALL {
            let limits = limits.map(|l| l[id.index()]);
            let scan = |plane: &Plane<Cam>| StripeLine::new(calibration, id, plane).scan;
            let seen = seen.as_ref().filter(|_| scan(&plane) == scan(&before));
            let seen = seen.map(|seen| &seen.stripes[id.index()]);
            let stripe = follow(frame, calibration, &plane, id, inner, pass, limits, seen)?;
            observations.extend(centres(
                id,
                &stripe.points[stripe.on_plane.clone()],
                inner.highest()[id.index()],
            ));
            stripes.push(stripe);
        }
        let fit = fit_plane(calibration, &observations, &plane)?;
        (before, plane) = (plane, fit.plane);
        result = Some(FaceStripes {
            fit,
            stripes: stripes.try_into().ok()?,
            half_width_px: inner.half_width_px,
            highest: inner.highest(),
        });
    }
    result
}

/// Fits the plane; if leaving one stripe out makes the others agree much better, that one followed something else (the
/// straight lower edge of a line of print) and is left out: three stripes fix a plane.
fn fit_without_outlier(
    calibration: &Calibration,
    observations: &[StripeObservation],
    start: &Plane<Cam>,
    settings: &FollowSettings,
) -> Option<Plane<Cam>> {
    let all = fit_plane(calibration, observations, start)?;
    let mut best = (all.scale * settings.outlier_gain, all.plane);
    if all.scale > settings.suspicious_scale {
        for id in LaserId::ALL {
            let others: Vec<StripeObservation> =
                observations.iter().filter(|o| o.laser != id).copied().collect();
            if let Some(fit) = fit_plane(calibration, &others, start)
                && fit.scale < best.0
            {
                best = (fit.scale, fit.plane);
            }
        }
    }
    Some(best.1)
}

/// The median height of each stripe's peaks; of all peaks where a stripe has none. `None` if none has any.
fn usual_amplitudes(traces: &[Vec<StripePoint>]) -> Option<[f64; 4]> {
    let usual = |traces: &[Vec<StripePoint>]| {
        median(traces.iter().flatten().filter_map(|p| p.found).map(|f| f.amplitude))
    };
    let all = usual(traces)?;
    let mut each = [all; 4];
    for (own, trace) in each.iter_mut().zip(traces.chunks(1)) {
        *own = usual(trace).unwrap_or(all);
    }
    Some(each)
}

fn centres(
    laser: LaserId,
    points: &[StripePoint],
    highest: f64,
) -> impl Iterator<Item = StripeObservation> + '_ {
    points
        .iter()
        .filter_map(|p| p.found)
        .filter(move |f| f.amplitude < highest)
        .map(move |f| StripeObservation { laser, at: f.at, sigma_px: f.sigma_px })
}

/// The line of a laser on a plane, from the one crossing of its stripe to the other along its walk, and the first crossing.
pub(crate) fn inner_segment(
    calibration: &Calibration,
    plane: &Plane<Cam>,
    id: LaserId,
) -> Option<(StripeLine, std::ops::Range<f64>, Px)> {
    let line = StripeLine::new(calibration, id, plane);
    let [i, j] = crossing_lasers(id);
    let (a, b) = (crossing_px(calibration, plane, id, i)?, crossing_px(calibration, plane, id, j)?);
    let (first, last) = if line.scan.along(a) <= line.scan.along(b) { (a, b) } else { (b, a) };
    Some((line, line.scan.along(first)..line.scan.along(last), first))
}

/// Rows per profile so that the median place reaches the wanted signal to noise.
fn rows_for(points: &[StripePoint], rows: usize, most: usize, settings: &FollowSettings) -> usize {
    let snr = points.iter().map(|p| p.found.map_or(1.0, |f| f.amplitude / p.noise.max(1e-3)));
    let Some(usual) = median(snr) else { return rows };
    let needed = rows as f64 * (settings.wanted_snr / usual).powi(2);
    let mut power = settings.fewest_rows;
    while (power as f64) < needed && power < most {
        power *= 2;
    }
    power
}

#[allow(clippy::too_many_arguments)] // one call, all of it needed
fn follow(
    frame: &Frame,
    calibration: &Calibration,
    plane: &Plane<Cam>,
    id: LaserId,
    known: &InnerSegments,
    pass: &Pass,
    limits: Option<[Px; 2]>,
    seen: Option<&FaceStripe>,
) -> Option<FaceStripe> {
    let (settings, following) = (&known.centre_settings(id, pass.search_px), &known.settings);
    let usual = known.usual[id.index()];
    let (line, inner, first) = inner_segment(calibration, plane, id)?;
    let size = match line.scan {
        ScanDirection::Rows => frame.height_px(),
        ScanDirection::Columns => frame.width_px(),
    } as f64;
    let other = line.scan.across(first);
    let reach = pass.reach * (inner.end - inner.start);
    let mut range = (inner.start - reach).max(0.0)..(inner.end + reach).min(size);
    if let Some([p, q]) = limits.map(|l| l.map(|px| line.scan.along(px))) {
        range = range.start.max(p.min(q))..range.end.min(p.max(q));
    }
    // Every pass has the same places.
    let rows = settings.rows as f64;
    range.start = (range.start / rows).ceil() * rows;
    let start = line.px_at(calibration, range.start, other)?.0;
    let seen = seen.map_or(&[][..], |stripe| &stripe.points);
    let points = find_centres_again(frame, calibration, &line, range, start, settings, seen);
    if points.is_empty() {
        return None;
    }
    // The log-likelihood of "on the plane" against "anywhere", scaled to +-1.
    let score = |p: &StripePoint| match p.found {
        Some(f)
            if f.amplitude < following.least_share * usual || f.amplitude > following.most_share * usual =>
        {
            following.absent
        }
        Some(f) => (1.0
            - (f.residual_px / (following.on_plane_sigmas * f.sigma_px.hypot(pass.slack_px))).powi(2))
        .max(-1.0),
        None => following.absent,
    };
    let lo = points.partition_point(|p| p.along_px < inner.start);
    let hi = points.partition_point(|p| p.along_px <= inner.end);
    if hi <= lo {
        return None;
    }
    let seen = points[lo..hi].iter().filter(|p| score(p) > 0.0).count();
    let inner_share = seen as f64 / (hi - lo) as f64;
    // The most likely end is where the running sum outwards is largest.
    let reach = |places: &mut dyn Iterator<Item = usize>| {
        let (mut sum, mut best, mut best_count, mut count) = (0.0, 0.0, 0, 0);
        for i in places {
            sum += score(&points[i]);
            count += 1;
            if sum > best {
                best = sum;
                best_count = count;
            }
        }
        best_count
    };
    let end = hi + reach(&mut (hi..points.len()));
    let begin = lo - reach(&mut (0..lo).rev());
    let seen_all = points[begin..end].iter().filter(|p| score(p) > 0.0).count();
    let seen_share = seen_all as f64 / (end - begin).max(1) as f64;
    let whole_share = points.iter().filter(|p| score(p) > 0.0).count() as f64 / points.len() as f64;
    // Where a share p of the places is seen, the last one seen lies up to ln(0.05) / ln(1 - p) places before the end
    // (95 %).
    let unseen = (1.0 - seen_share).clamp(0.01, 0.9);
    let spacing = settings.rows as f64 * (1.0 + 0.05f64.ln() / unseen.ln());
    let place = |inside: usize, outside: Option<usize>| {
        let (at, runs_on) = match outside {
            Some(o) => {
                let middle = 0.5 * (points[inside].along_px + points[o].along_px);
                (middle, false)
            }
            None => (points[inside].along_px, true),
        };
        let guess = line.scan.across(points[inside].predicted);
        let px = line.px_at(calibration, at, guess).map_or(points[inside].predicted, |(px, _)| px);
        StripeEnd { at: px, uncertainty_px: spacing, runs_on }
    };
    let ends = [place(begin, begin.checked_sub(1)), place(end - 1, (end < points.len()).then_some(end))];
    let on_plane_score = points.iter().map(score).collect();
    Some(FaceStripe {
        ends,
        points,
        on_plane_score,
        on_plane: begin..end,
        inner_share,
        seen_share,
        whole_share,
    })
}
