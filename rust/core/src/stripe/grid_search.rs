//! Finds the plane on which the four stripes form their 2 x 2 grid, without finding single stripes first.
//!
//! Stripes i (1, 2) and j (3, 4) cross inside every measurable face, because each joins two opposite edges of it. The
//! crossing (i, j) lies on the line where two laser planes meet, so its place in the image is linear in its inverse depth
//! `w`. The stripe between two crossings depends on just their two inverse depths: the mean ridge strengths `E_k(w, w')` of
//! four segments hold all evidence for a plane (three inverse depths, the fourth follows).
//! Adding up some 400 px on each of four segments finds stripes that no single pixel shows.

use super::curve::{Curve, fan_sums, steps_for};
use crate::calibration::Calibration;
use crate::camera::CameraModel;
use crate::frames::{Cam, Plane, Ray};
use crate::image::laser_response::{Diagonal, Layout, RidgeMap, Z_CLIP, Z_STEPS};
use crate::network::{Channel, FaceMaps};
use crate::units::{LaserId, Px};
use nalgebra::{Matrix3, Vector3};

/// A plane on which the stripe grid was found.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GridHypothesis {
    pub plane: Plane<Cam>,
    /// Mean ridge strength of the inner segment of each stripe, sigmas (clipped at 3).
    pub strength: [f32; 4],
}

impl GridHypothesis {
    /// Mean of the four.
    pub fn total(&self) -> f32 {
        self.strength.iter().sum::<f32>() / 4.0
    }
}

/// Settings of the search, of its last step and of the check for a missing stripe. Where no reason stands, there is no record of how a value was
/// chosen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GridSearchSettings {
    /// Nearest and farthest crossing that is searched, mm. The paper's range of sizes needs 350 to 2450 mm; beyond, the grid does not fit the
    /// face. A wider range takes longer and finds more of the background.
    pub range_mm: [f64; 2],
    /// How far a crossing moves in the image from one level of inverse depth to the next, px. A stripe is at least 6 px wide at half its
    /// height; larger steps miss narrow stripes, the time grows with the cube of smaller ones.
    pub step_px: f64,
    /// Largest ratio of the inverse depths of two neighbouring crossings. They are 0.17 z apart: at 60 degrees of tilt 1.35. A larger one takes
    /// longer and finds planes that are seen edge on.
    pub max_ratio: f64,
    /// Cosine of the largest tilt between the face's normal and the ray to its middle (65 degrees). A larger one refuses oblique faces, a
    /// smaller one finds planes that no face has.
    pub min_cos_tilt: f64,
    /// Distance of samples in a first look at each segment, px; straight, since distortion bends a segment by 3 px at most. Larger is quicker
    /// and drops faint stripes, since fewer samples scatter more.
    pub coarse_px: f32,
    /// What a segment needs in the ridge maps. Larger values lose faint stripes, smaller ones find planes in noise.
    pub clear: SegmentThresholds,
    /// ... and in the maps for faint stripes.
    pub faint: SegmentThresholds,
    /// Sigmas of ridge that one unit of the network's log-odds is worth ...
    pub sigmas_per_logit: f32,
    /// ... and the most units that count: two sigmas for or against, less than the three that a clear ridge has, so that neither overrules the
    /// other alone. Larger values trust the network more.
    pub most_logit: f32,
    /// Two planes are one if no crossing differs by more levels than this (6 levels are 24 px). More loses a second face beside the first, fewer
    /// fills the list with one plane.
    pub same_levels: usize,
    /// Steps in which a plane is moved to where its evidence is largest, px: from the search's own down to what a ridge map shows. Larger ones end
    /// beside the best place, more of them take longer.
    pub climb_px: [f64; 4],
    /// Distance of samples there, px. Larger is quicker and less exact.
    pub climb_sample_px: f32,
    /// For a missing stripe: the share of the segment beyond a crossing that must be lit where the next crossing is not on the face. A larger one
    /// asks for larger faces, a smaller one takes bright spots for stripes.
    pub partial_segment: f64,
    /// ... the strength of the full segment and of both partial ones that shows three stripes on one plane, sigmas (3 at most). A larger one says
    /// `no_box` where one stripe is missing, a smaller one blames a laser where there is no box.
    pub three_strength: f32,
    /// ... the mean of a first look below which a segment is not looked at again, sigmas; it scatters by 0.3. More is quicker and misses segments.
    pub three_coarse: f32,
    /// ... and how many of the strongest full segments are followed up. More takes longer.
    pub three_keep: usize,
}

/// What a segment must have, sigmas of its map. Larger values lose faint stripes, smaller ones find planes in noise.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SegmentThresholds {
    /// Mean in the first look; a weaker segment is not looked at again.
    coarse: f32,
    /// Mean; a weaker segment starts no plane.
    segment: f32,
    /// Mean of the four; a weaker plane is none.
    total: f32,
}

impl GridSearchSettings {
    pub const DEFAULT: Self = Self {
        range_mm: [200.0, 4000.0],
        step_px: 4.0,
        max_ratio: 1.5,
        min_cos_tilt: 0.42,
        coarse_px: 36.0,
        // Pure noise has a mean of -0.56 (a minimum of two); with 45 samples it scatters by 0.15, of which 0.05 is four above, in the first look
        // by 0.3. A stripe worth finding has 0.3 and more.
        clear: SegmentThresholds { coarse: -0.25, segment: 0.05, total: 0.0 },
        // The faint map's noise has a mean of -0.37 and the same scatter.
        faint: SegmentThresholds { coarse: -0.25, segment: -0.1, total: 0.15 },
        sigmas_per_logit: 0.5,
        most_logit: 4.0,
        same_levels: 6,
        climb_px: [4.0, 2.0, 1.0, 0.5],
        climb_sample_px: 3.0,
        partial_segment: 0.3,
        three_strength: 1.8,
        three_coarse: 0.9,
        three_keep: 40,
    };

    /// Inverse depths that are searched, 1/mm.
    fn inverse_depths(&self) -> (f64, f64) {
        (1.0 / self.range_mm[1], 1.0 / self.range_mm[0])
    }
}

impl Default for GridSearchSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// No segment that was sampled.
const NONE: f32 = -9.0;

/// What speaks for one laser's stripe at a pixel: the ridge of its pair and, if there is a network, what that says of this
/// very laser.
pub(crate) struct Evidence<'a> {
    ridge: &'a RidgeMap,
    network: Option<NetworkLayer>,
    /// The most that a sample can have, sigmas.
    most: f32,
}

/// A network's map in the steps of the ridge map.
struct NetworkLayer {
    width: usize,
    height: usize,
    layout: Layout,
    steps: Vec<i8>,
}

impl<'a> Evidence<'a> {
    /// The ridge alone.
    pub fn ridge(ridge: &'a RidgeMap) -> Self {
        Self { ridge, network: None, most: Z_CLIP }
    }

    /// The ridge and a network's map of `laser`.
    pub fn with_network(
        ridge: &'a RidgeMap,
        maps: &FaceMaps,
        laser: LaserId,
        settings: &GridSearchSettings,
    ) -> Self {
        let (most, worth) = (settings.most_logit, settings.sigmas_per_logit);
        let [width, height] = maps.size();
        let (zero, one) = (maps.raster_from_px(Px::new(0.0, 0.0)), maps.raster_from_px(Px::new(1.0, 1.0)));
        let steps = maps.channel(Channel::Laser(laser)).iter().map(|p| {
            let logit = (p.max(1e-6) / (1.0 - p).max(1e-6)).ln();
            (logit.clamp(-most, most) * worth * Z_STEPS) as i8
        });
        let scale = [0, 1].map(|i| (one[i] - zero[i]) as f32);
        let layout = Layout::even(scale, ridge.layout().every_px);
        let network = NetworkLayer { width, height, layout, steps: steps.collect() };
        Self { ridge, network: Some(network), most: Z_CLIP + most * worth }
    }

    /// Samples this far apart tell all.
    fn every_px(&self) -> f32 {
        self.ridge.layout().every_px
    }

    /// Sum along a curve, sigmas times [`Z_STEPS`].
    fn sum(&self, curve: &Curve) -> i32 {
        let map = self.ridge;
        let ridge = curve.sum(map.steps(), [map.width, map.height], &map.layout());
        ridge + self.network.as_ref().map_or(0, |l| curve.sum(&l.steps, [l.width, l.height], &l.layout))
    }
}

impl Evidence<'_> {
    /// Means along straight lines from one pixel to each of many, a sample every so many px of the longest, sigmas.
    fn means_of_fan(&self, from: [f32; 2], ends: &[[f32; 2]], every_px: f32) -> Vec<f32> {
        // The ends stand on a line: the farthest is its first or its last.
        let length = |end: &[f32; 2]| (end[0] - from[0]).hypot(end[1] - from[1]);
        let longest = ends.first().map_or(0.0, length).max(ends.last().map_or(0.0, length));
        let steps = steps_for(longest, every_px);
        let map = self.ridge;
        let mut sums = fan_sums(map.steps(), map.width, &map.layout(), from, ends, steps);
        if let Some(layer) = &self.network {
            let more = fan_sums(&layer.steps, layer.width, &layer.layout, from, ends, steps);
            sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        }
        sums.into_iter().map(|sum| sum as f32 / (steps + 1) as f32 / Z_STEPS).collect()
    }
}

/// The crossing of two stripes at each level of inverse depth.
struct Crossing {
    /// (x, y) = origin + w * slope in the ideal image.
    origin: [f64; 2],
    slope: [f64; 2],
    /// Sensor position per level, `None` outside the image.
    px: Vec<Option<[f32; 2]>>,
}

impl Crossing {
    fn ray(&self, w: f64) -> Vector3<f64> {
        Vector3::new(self.origin[0] + w * self.slope[0], self.origin[1] + w * self.slope[1], 1.0)
    }
}

/// Where planes `i` and `j` meet: `p_i . x = w` and `p_j . x = w`.
fn crossing_line(calibration: &Calibration, i: LaserId, j: LaserId) -> ([f64; 2], [f64; 2]) {
    let (p, q) = (calibration.laser(i).per_mm, calibration.laser(j).per_mm);
    let det = p.x * q.y - p.y * q.x; // never 0: Calibration::new checks that the pairs cross
    let solve = |a: f64, b: f64| [(a * q.y - b * p.y) / det, (p.x * b - q.x * a) / det];
    (solve(-p.z, -q.z), solve(1.0, 1.0))
}

/// The best planes, strongest first, at most `keep`, distinct in the image. One evidence a laser.
pub(crate) fn find_planes(
    calibration: &Calibration,
    evidence: &[Evidence; 4],
    settings: &GridSearchSettings,
    least: SegmentThresholds,
    keep: usize,
) -> Vec<GridHypothesis> {
    let [l1, l2, l3, l4] = LaserId::ALL;
    let camera = calibration.camera();
    let lines = [(l1, l3), (l1, l4), (l2, l3), (l2, l4)].map(|(i, j)| crossing_line(calibration, i, j));
    let fastest = lines.iter().map(|(_, s)| s[0].hypot(s[1])).fold(0.0, f64::max) * camera.fx.max(camera.fy);
    let step = settings.step_px / fastest;
    let (w_min, w_max) = settings.inverse_depths();
    let levels = (((w_max - w_min) / step) as usize).clamp(2, 2000) + 1;
    let w_of = |level: usize| w_min + level as f64 * step;
    let (right, bottom) = (f64::from(calibration.width_px()) - 0.5, f64::from(calibration.height_px()) - 0.5);
    let crossings = lines.map(|(origin, slope)| {
        let mut crossing = Crossing { origin, slope, px: Vec::new() };
        crossing.px = (0..levels)
            .map(|n| {
                let x = crossing.ray(w_of(n));
                camera
                    .px_from_ray(&Ray::new(x.x, x.y))
                    .filter(|p| p.u > -0.5 && p.u < right && p.v > -0.5 && p.v < bottom)
                    .map(|p| [p.u as f32, p.v as f32])
            })
            .collect();
        crossing
    });
    let [c13, c14, c23, c24] = &crossings;
    let scale = DepthSearch { camera, settings, w_min, step, levels, least };
    // Two laser pairs' segments from one crossing start a hypothesis; of the others just those that close one are looked at.
    let (mut e2, mut e4) =
        (Segments::new(&scale, c23, c24, &evidence[1]), Segments::new(&scale, c14, c24, &evidence[3]));
    let mut best = StrongestPlanes::new(keep, 4.0 * least.total, settings.same_levels);
    for n13 in 0..levels {
        let row1 = strong(&scale, c13, c14, &evidence[0], n13);
        if row1.is_empty() {
            continue;
        }
        let row3 = strong(&scale, c13, c23, &evidence[2], n13);
        let x13 = c13.ray(w_of(n13));
        for &(n14, s1) in &row1 {
            let x14 = c14.ray(w_of(n14));
            for &(n23, s3) in &row3 {
                let x23 = c23.ray(w_of(n23));
                if s1 + s3 + 2.0 * evidence[0].most <= best.floor() {
                    continue; // even two perfect segments would not be enough
                }
                let rows = Matrix3::from_rows(&[x13.transpose(), x14.transpose(), x23.transpose()]);
                let Some(inverse) = rows.try_inverse() else { continue };
                let q = inverse * Vector3::new(w_of(n13), w_of(n14), w_of(n23));
                let (p2, p4) = (calibration.laser(l2).per_mm, calibration.laser(l4).per_mm);
                let x = (q - p2).cross(&(q - p4));
                if x.z.abs() < 1e-15 {
                    continue;
                }
                let x24 = x / x.z;
                let level = (q.dot(&x24) - w_min) / step + 0.5;
                if !(level >= 0.0 && level < levels as f64) {
                    continue;
                }
                let n24 = level as usize;
                let middle = (x13 + x14 + x23 + x24) * 0.25;
                if q.dot(&middle) / (q.norm() * middle.norm()) < settings.min_cos_tilt {
                    continue;
                }
                let s2 = e2.at(n23, n24);
                if s2 <= least.segment || s1 + s2 + s3 + evidence[3].most <= best.floor() {
                    continue;
                }
                let s4 = e4.at(n14, n24);
                let sum = s1 + s2 + s3 + s4;
                if s4 <= least.segment || sum <= best.floor() {
                    continue;
                }
                best.offer(sum, [n13, n14, n23, n24], q, [s1, s2, s3, s4]);
            }
        }
    }
    best.into_hypotheses()
}

/// The levels of inverse depth that are searched, and what a segment must have.
struct DepthSearch<'a> {
    camera: &'a CameraModel,
    settings: &'a GridSearchSettings,
    w_min: f64,
    step: f64,
    levels: usize,
    least: SegmentThresholds,
}

impl DepthSearch<'_> {
    fn w_of(&self, level: usize) -> f64 {
        self.w_min + level as f64 * self.step
    }

    /// Levels of the next crossing: neither inverse depth is more than [`GridSearchSettings::max_ratio`] times the other.
    fn near(&self, level: usize) -> std::ops::RangeInclusive<usize> {
        let of = |w: f64| ((w - self.w_min) / self.step).clamp(0.0, (self.levels - 1) as f64);
        let (w, ratio) = (self.w_of(level), self.settings.max_ratio);
        of(w / ratio).ceil() as usize..=of(w * ratio) as usize
    }

    /// Mean of the map between two crossings at their levels; [`NONE`] outside of the image.
    fn mean(&self, map: &Evidence, from: (&Crossing, usize), to: (&Crossing, usize)) -> f32 {
        let middle = (from.0.ray(self.w_of(from.1)) + to.0.ray(self.w_of(to.1))) * 0.5;
        let middle = self.camera.px_from_ray(&Ray::new(middle.x, middle.y));
        match (from.0.px[from.1], middle, to.0.px[to.1]) {
            (Some(a), Some(c), Some(b)) => mean_along(map, a, [c.u as f32, c.v as f32], b, map.every_px()),
            _ => NONE,
        }
    }
}

/// The segments from one crossing to the next that are strong enough: level there and strength.
fn strong(
    scale: &DepthSearch,
    from: &Crossing,
    to: &Crossing,
    map: &Evidence,
    level: usize,
) -> Vec<(usize, f32)> {
    let Some(a) = from.px[level] else { return Vec::new() };
    let (ms, ends): (Vec<usize>, Vec<[f32; 2]>) =
        scale.near(level).filter_map(|m| Some((m, to.px[m]?))).unzip();
    let coarse = map.means_of_fan(a, &ends, scale.settings.coarse_px);
    ms.into_iter()
        .zip(coarse)
        .filter(|(_, coarse)| *coarse >= scale.least.coarse)
        .map(|(m, _)| (m, scale.mean(map, (from, level), (to, m))))
        .filter(|(_, mean)| *mean > scale.least.segment)
        .collect()
}

/// Segments from one crossing to the next that are looked at when they are asked for.
struct Segments<'a> {
    scale: &'a DepthSearch<'a>,
    from: &'a Crossing,
    to: &'a Crossing,
    map: &'a Evidence<'a>,
    /// Strength by both levels, 0 where nobody has asked.
    seen: Vec<f32>,
}

impl<'a> Segments<'a> {
    fn new(scale: &'a DepthSearch, from: &'a Crossing, to: &'a Crossing, map: &'a Evidence) -> Self {
        Self { scale, from, to, map, seen: vec![0.0; scale.levels * scale.levels] }
    }

    fn at(&mut self, from: usize, to: usize) -> f32 {
        let seen = &mut self.seen[from * self.scale.levels + to];
        if *seen == 0.0 {
            let near = self.scale.near(from).contains(&to);
            *seen = if near { self.scale.mean(self.map, (self.from, from), (self.to, to)) } else { NONE };
        }
        *seen
    }
}

/// Moves a plane to where its four segments have most evidence: the levels of the search are [`GridSearchSettings::step_px`] apart, and where the stripes
/// are too faint for single profiles nothing else tells better. Three crossings are moved in turn along their lines.
pub(crate) fn climb(
    calibration: &Calibration,
    evidence: &[Evidence; 4],
    settings: &GridSearchSettings,
    start: &GridHypothesis,
) -> GridHypothesis {
    let [l1, l2, l3, l4] = LaserId::ALL;
    let lines = [(l1, l3), (l1, l4), (l2, l3)].map(|(i, j)| crossing_line(calibration, i, j));
    let ray = |k: usize, w: f64| {
        let (origin, slope) = lines[k];
        Vector3::new(origin[0] + w * slope[0], origin[1] + w * slope[1], 1.0)
    };
    let plane_of = |w: &[f64; 3]| {
        let rows = [0, 1, 2].map(|k| ray(k, w[k]).transpose());
        Some(Matrix3::from_rows(&rows).try_inverse()? * Vector3::from(*w))
    };
    let px = |x: Vector3<f64>| {
        let at = calibration.camera().px_from_ray(&Ray::new(x.x / x.z, x.y / x.z))?;
        Some([at.u as f32, at.v as f32])
    };
    let strengths = |q: &Vector3<f64>| {
        let at = |i: LaserId, j: LaserId| {
            let x = (q - calibration.laser(i).per_mm).cross(&(q - calibration.laser(j).per_mm));
            (x.z.abs() > 1e-15).then(|| x / x.z)
        };
        let mut found = [0.0; 4];
        for (k, (id, [i, j])) in
            [(l1, [l3, l4]), (l2, [l3, l4]), (l3, [l1, l2]), (l4, [l1, l2])].into_iter().enumerate()
        {
            let (a, b) = (at(id, i)?, at(id, j)?);
            found[k] = mean_along(&evidence[k], px(a)?, px((a + b) * 0.5)?, px(b)?, settings.climb_sample_px);
        }
        Some(found)
    };
    // Where the first three crossings are now: w = q . x on each line, linear in w.
    let q = start.plane.per_mm;
    let mut w = [0, 1, 2].map(|k| {
        let (at_0, at_1) = (q.dot(&ray(k, 0.0)), q.dot(&ray(k, 1.0)));
        at_0 / (1.0 - (at_1 - at_0))
    });
    let sum = |s: &[f32; 4]| s.iter().sum::<f32>();
    let Some(mut best) = strengths(&q) else { return *start };
    let mut plane = q;
    for step_px in settings.climb_px {
        let mut moved = true;
        for _ in 0..4 {
            if !std::mem::take(&mut moved) {
                break;
            }
            for k in 0..3 {
                let per_px = 1.0 / (lines[k].1[0].hypot(lines[k].1[1]) * calibration.camera().fx);
                for sign in [1.0, -1.0] {
                    let mut next = w;
                    next[k] += sign * step_px * per_px;
                    let Some((q, found)) = plane_of(&next).and_then(|q| Some((q, strengths(&q)?))) else {
                        continue;
                    };
                    if sum(&found) > sum(&best) {
                        (w, plane, best, moved) = (next, q, found, true);
                    }
                }
            }
        }
    }
    GridHypothesis { plane: Plane::new(plane), strength: best }
}

/// Mean of the map along the parabola through three pixels, sigmas.
fn mean_along(map: &Evidence, a: [f32; 2], middle: [f32; 2], b: [f32; 2], every_px: f32) -> f32 {
    let curve = Curve::new(a, middle, b, every_px);
    map.sum(&curve) as f32 / (curve.steps + 1) as f32 / Z_STEPS
}

/// The strongest hypotheses so far; a new one replaces those that lie beside it.
struct StrongestPlanes {
    keep: usize,
    /// Least sum.
    least: f32,
    /// See [`GridSearchSettings::same_levels`].
    same_levels: usize,
    entries: Vec<(f32, [usize; 4], GridHypothesis)>,
}

impl StrongestPlanes {
    fn new(keep: usize, least: f32, same_levels: usize) -> Self {
        Self { keep, least, same_levels, entries: Vec::with_capacity(keep + 1) }
    }

    fn floor(&self) -> f32 {
        let full = self.entries.len() >= self.keep;
        self.entries.last().filter(|_| full).map_or(self.least, |e| e.0)
    }

    fn offer(&mut self, sum: f32, levels: [usize; 4], q: Vector3<f64>, strength: [f32; 4]) {
        let same_levels = self.same_levels;
        let near = |other: &[usize; 4]| levels.iter().zip(other).all(|(a, b)| a.abs_diff(*b) <= same_levels);
        if self.entries.iter().any(|(s, l, _)| *s >= sum && near(l)) {
            return;
        }
        self.entries.retain(|(_, l, _)| !near(l));
        let at = self.entries.partition_point(|(s, _, _)| *s >= sum);
        self.entries.insert(at, (sum, levels, GridHypothesis { plane: Plane::new(q), strength }));
        self.entries.truncate(self.keep);
    }

    fn into_hypotheses(self) -> Vec<GridHypothesis> {
        self.entries.into_iter().map(|(_, _, h)| h).collect()
    }
}

/// The diagonal along which each pair of stripes runs.
pub(crate) fn diagonals(calibration: &Calibration) -> [Diagonal; 2] {
    [LaserId::ALL[0], LaserId::ALL[2]].map(|id| {
        let p = calibration.laser(id).per_mm;
        // The stripe of a far face is p . x = 0: it runs along (-p.y, p.x).
        if -p.y * p.x > 0.0 { Diagonal::Down } else { Diagonal::Up }
    })
}

/// When no full grid was found: the laser whose stripe is missing, if the other three lie on one plane.
pub(crate) fn three_stripes(
    calibration: &Calibration,
    first_pair: &RidgeMap,
    second_pair: &RidgeMap,
    settings: &GridSearchSettings,
) -> Option<LaserId> {
    let (first_pair, second_pair) = (&Evidence::ridge(first_pair), &Evidence::ridge(second_pair));
    let camera = calibration.camera();
    let [l1, l2, l3, l4] = LaserId::ALL;
    let px = |x: Vector3<f64>| camera.px_from_ray(&Ray::new(x.x, x.y)).map(|p| [p.u as f32, p.v as f32]);
    let mut best: Option<(f32, LaserId)> = None;
    // (full stripe, its missing partner, the two stripes that cross it, maps of the full and of the crossing pair)
    for (full, missing, [i, j], along, crossing) in [
        (l1, l2, [l3, l4], first_pair, second_pair),
        (l2, l1, [l3, l4], first_pair, second_pair),
        (l3, l4, [l1, l2], second_pair, first_pair),
        (l4, l3, [l1, l2], second_pair, first_pair),
    ] {
        let lines = [crossing_line(calibration, full, i), crossing_line(calibration, full, j)];
        let speed = lines.iter().map(|(_, s)| s[0].hypot(s[1])).fold(0.0, f64::max) * camera.fx;
        let step = 2.0 * settings.step_px / speed;
        let (w_min, w_max) = settings.inverse_depths();
        let levels = (((w_max - w_min) / step) as usize).clamp(2, 1000) + 1;
        let at = |line: &([f64; 2], [f64; 2]), n: usize| {
            let w = w_min + n as f64 * step;
            (Vector3::new(line.0[0] + w * line.1[0], line.0[1] + w * line.1[1], 1.0), w)
        };
        let places = lines.map(|line| (0..levels).map(|n| px(at(&line, n).0)).collect::<Vec<_>>());
        let mut strong = Vec::new();
        for n in 0..levels {
            let Some(a) = places[0][n] else { continue };
            let (x, wx) = at(&lines[0], n);
            let near = (0..levels).filter(|m| {
                let wy = at(&lines[1], *m).1;
                wx.max(wy) <= settings.max_ratio * wx.min(wy)
            });
            let (ms, ends): (Vec<usize>, Vec<[f32; 2]>) =
                near.filter_map(|m| Some((m, places[1][m]?))).unzip();
            let coarse = along.means_of_fan(a, &ends, settings.coarse_px);
            for ((m, b), coarse) in ms.into_iter().zip(ends).zip(coarse) {
                let (y, wy) = at(&lines[1], m);
                if coarse < settings.three_coarse {
                    continue;
                }
                let Some(c) = px((x + y) * 0.5) else { continue };
                let strength = mean_along(along, a, c, b, along.every_px());
                if strength > settings.three_strength {
                    strong.push((strength, x, wx, y, wy));
                }
            }
        }
        strong.sort_by(|a, b| b.0.total_cmp(&a.0));
        strong.truncate(settings.three_keep);
        let (p_j, p_missing) = (calibration.laser(j).per_mm, calibration.laser(missing).per_mm);
        for (strength, x, wx, y, wy) in strong {
            // Planes through both crossings: one angle is free, set by the inverse depth of the missing crossing.
            for n in 0..levels {
                let (z, wz) = at(&crossing_line(calibration, missing, i), n);
                let rows = Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()]);
                let Some(inverse) = rows.try_inverse() else { continue };
                let q = inverse * Vector3::new(wx, wy, wz);
                let middle = (x + y) * 0.5;
                if q.dot(&middle) / (q.norm() * middle.norm()) < settings.min_cos_tilt {
                    continue;
                }
                let other = (q - p_missing).cross(&(q - p_j));
                if other.z.abs() < 1e-15 {
                    continue;
                }
                let other = other / other.z;
                let both_sides = |from: Vector3<f64>, to: Vector3<f64>| {
                    // The face may lie to either side of the stripe that is on it.
                    [1.0, -1.0]
                        .into_iter()
                        .filter_map(|sign| {
                            let end = from + (to - from) * (sign * settings.partial_segment);
                            Some(mean_along(
                                crossing,
                                px(from)?,
                                px((from + end) * 0.5)?,
                                px(end)?,
                                crossing.every_px(),
                            ))
                        })
                        .fold(NONE, f32::max)
                };
                let weakest = both_sides(x, z).min(both_sides(y, other)).min(strength);
                if weakest > settings.three_strength && best.is_none_or(|(b, _)| weakest > b) {
                    best = Some((weakest, missing));
                }
            }
        }
    }
    best.map(|(_, laser)| laser)
}
