//! The face's rectangle in a network's maps, on a plane that the stripes gave: direction and four sides to a pixel or so of
//! the maps. Flush neighbours, print and clutter are told apart here; the exact place of each side comes from the frame.

use super::extent::crossing_px;
use super::outline::{Across, InitialRectangle, MOST_TURN_RAD, SIDES, outward_sign, span_mm};
use super::raster::{OnPlane, PlaneRaster};
use crate::calibration::Calibration;
use crate::frames::{Cam, Plane};
use crate::network::{Channel, FaceMaps};
use crate::units::{LaserId, Px};

/// A rectangle seen in the maps.
#[derive(Clone, Debug)]
pub(crate) struct MapOutline {
    pub initial: InitialRectangle,
    /// Overlap of the rectangle with the mask of the face (intersection over union).
    pub overlap: f32,
}

/// Largest angle between a stripe and the box's edge, as for the stripes' ends, in whole degrees.
const MAX_ANGLE_DEG: i32 = MOST_TURN_RAD.to_degrees() as i32;

/// How lines are found in the maps and rectangles of them judged. Where a field gives no reason for its value, none is on record.
#[derive(Clone, Copy, Debug)]
struct MapOutlineSettings {
    /// Probability from which a pixel counts as edge. More loses faint sides, less takes in clutter.
    least_edge: f32,
    /// ... and as face. More shrinks the face, less takes flush neighbours in.
    least_mask: f32,
    /// Fewest pixels of each that show a face; of the face every fourth is taken. More loses small faces.
    least_pixels: usize,
    /// Size of a bin of a side's profile, pixels of the maps. More places lines less exactly.
    bin: f64,
    /// How much a bin's neighbours count in its sum: an edge between two bins counts in both. More joins lines that lie side by side.
    beside: f64,
    /// Peaks kept a side; more are print. The rectangles that are tried grow with its fourth power.
    peaks_a_side: usize,
    /// Distance of two peaks, pixels of the maps: a line is 1.9 px wide at half its height. More loses the side beside a stronger line.
    peaks_apart: f64,
    /// Samples along a side. More takes longer.
    samples: usize,
    /// How much the overlap with the mask counts: as much as the edges of all four sides. More follows the mask where the edges say otherwise.
    overlap_worth: f32,
    /// Edge pixels nearer than this to a side, in pixels of the maps, are its own; first to last step of the fit. More takes in lines beside it,
    /// a smaller last one leaves too few pixels.
    on_side: [f64; 5],
    /// A step of the fit that turns the rectangle by more, rad, has lost its sides. More follows it.
    most_turn_rad: f64,
    /// Pixels of the face along a border of the image that make a cut: a corner that just touches has fewer. More names fewer faces as cut.
    least_at_border: usize,
}

impl MapOutlineSettings {
    const DEFAULT: Self = Self {
        least_edge: 0.15,
        least_mask: 0.5,
        least_pixels: 48,
        bin: 0.5,
        beside: 0.7,
        peaks_a_side: 3,
        peaks_apart: 2.5,
        samples: 48,
        overlap_worth: 4.0,
        on_side: [4.0, 3.0, 2.5, 2.0, 1.5],
        most_turn_rad: 0.2,
        least_at_border: 4,
    };
}

impl Default for MapOutlineSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// A pixel of the maps on the plane.
pub(crate) struct WeightedPoint {
    pub at: OnPlane,
    pub weight: f64,
}

/// Finds the rectangle. `None` if the maps show no face on this plane.
pub(crate) fn map_outline(
    calibration: &Calibration,
    plane: &Plane<Cam>,
    maps: &FaceMaps,
) -> Option<MapOutline> {
    let [l1, l2, l3, l4] = LaserId::ALL;
    let at = crossing_px(calibration, plane, l1, l3)?;
    let base = PlaneRaster::new(calibration, plane, at, crossing_px(calibration, plane, l1, l4)?)?;
    let mm_per_px = base.mm_per_px(calibration, OnPlane::zeros())?;
    let unit = mm_per_px * maps.px_per_raster_px();
    let spots = |channel: Channel, least: f32, every: usize| {
        let [width, height] = maps.size();
        let map = maps.channel(channel);
        let mut found = Vec::new();
        for y in (0..height).step_by(every) {
            for x in (0..width).step_by(every) {
                let value = map[y * width + x];
                if value >= least
                    && let Some(at) = base.on_plane(calibration, maps.px_from_raster(x as f64, y as f64))
                {
                    found.push(WeightedPoint { at, weight: f64::from(value) });
                }
            }
        }
        found
    };
    let MapOutlineSettings { least_edge, least_mask, least_pixels, .. } = MapOutlineSettings::DEFAULT;
    let edges = spots(Channel::FaceEdge, least_edge, 1);
    let mask = spots(Channel::FaceMask, least_mask, 2);
    if edges.len() < least_pixels || mask.len() < least_pixels {
        return None;
    }
    let crossings: Vec<OnPlane> = [(l1, l3), (l1, l4), (l2, l3), (l2, l4)]
        .into_iter()
        .filter_map(|(i, j)| base.on_plane(calibration, crossing_px(calibration, plane, i, j)?))
        .collect();
    let (_, angle_deg) = (-MAX_ANGLE_DEG..=MAX_ANGLE_DEG)
        .map(|angle_deg| (sharpness(&edges, &crossings, angle_deg, unit), angle_deg))
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    let angle = f64::from(angle_deg).to_radians();
    let peaks = [0, 1, 2, 3].map(|side| peaks(&profile(&edges, &crossings, angle, side, unit)));
    let mut best: Option<(f32, RectangleCandidate)> = None;
    let mut pick = [0; 4];
    while pick[3] < peaks[3].len() {
        let chosen = [0, 1, 2, 3].map(|s| peaks[s].get(pick[s]).copied());
        if let [Some(a0), Some(a1), Some(b0), Some(b1)] = chosen {
            let candidate = RectangleCandidate { angle, offsets_mm: [a0, a1, b0, b1] };
            let score = candidate.score(calibration, &base, maps, &mask, unit);
            if best.as_ref().is_none_or(|(s, _)| score > *s) {
                best = Some((score, candidate));
            }
        }
        for (s, p) in pick.iter_mut().enumerate() {
            *p += 1;
            if *p < peaks[s].len() || s == 3 {
                break;
            }
            *p = 0;
        }
    }
    let (_, candidate) = best?;
    let candidate = candidate.fitted(&edges, unit);
    let initial = InitialRectangle::new(base.turned(candidate.angle), candidate.offsets_mm, mm_per_px);
    Some(MapOutline { initial, overlap: candidate.exact_overlap(calibration, &base, maps) })
}

/// How many borders of the image the face reaches in the maps, and where first. `None` if it keeps clear of all.
pub(crate) fn mask_at_border(maps: &FaceMaps) -> Option<(u8, Px)> {
    let MapOutlineSettings { least_mask, least_at_border, .. } = MapOutlineSettings::DEFAULT;
    let [width, height] = maps.size();
    let mask = maps.channel(Channel::FaceMask);
    let on = |(x, y): &(usize, usize)| mask[y * width + x] >= least_mask;
    let borders: [Vec<(usize, usize)>; 4] = [
        (0..width).map(|x| (x, 0)).filter(on).collect(),
        (0..height).map(|y| (width - 1, y)).filter(on).collect(),
        (0..width).map(|x| (x, height - 1)).filter(on).collect(),
        (0..height).map(|y| (0, y)).filter(on).collect(),
    ];
    let cut: Vec<_> = borders.iter().filter(|b| b.len() >= least_at_border).collect();
    let (x, y) = *cut.first()?.first()?;
    Some((cut.len() as u8, maps.px_from_raster(x as f64, y as f64)))
}

/// Coordinates on the raster turned by an angle.
pub(crate) fn turned(at: OnPlane, angle: f64) -> OnPlane {
    let (s, c) = angle.sin_cos();
    OnPlane::new(at.x * c + at.y * s, at.y * c - at.x * s)
}

/// Edge weight over the offset of one side, beyond the outermost crossing of stripes; the first number is the offset of
/// the first bin.
struct Profile {
    sign: f64,
    start_mm: f64,
    bin_mm: f64,
    sums: Vec<f64>,
}

fn profile(edges: &[WeightedPoint], crossings: &[OnPlane], angle: f64, side: usize, unit: f64) -> Profile {
    let ((across, _), sign) = (SIDES[side], outward_sign(side));
    let offset = |at: OnPlane| sign * across.offset(turned(at, angle));
    let start_mm = crossings.iter().map(|c| offset(*c)).fold(f64::NEG_INFINITY, f64::max);
    let MapOutlineSettings { bin, beside, .. } = MapOutlineSettings::DEFAULT;
    let bin_mm = bin * unit;
    let mut sums = vec![0.0; 1024];
    for spot in edges {
        let bin = (offset(spot.at) - start_mm) / bin_mm;
        if bin >= 0.0
            && let Some(sum) = sums.get_mut(bin as usize)
        {
            *sum += spot.weight;
        }
    }
    let smooth = |i: usize| {
        let at = |k: usize| sums.get(k).copied().unwrap_or(0.0);
        at(i) + beside * (at(i + 1) + if i > 0 { at(i - 1) } else { 0.0 })
    };
    let sums = (0..sums.len()).map(smooth).collect();
    Profile { sign, start_mm, bin_mm, sums }
}

/// How concentrated the edges are on four lines at an angle.
fn sharpness(edges: &[WeightedPoint], crossings: &[OnPlane], angle_deg: i32, unit: f64) -> f64 {
    let angle = f64::from(angle_deg).to_radians();
    (0..4)
        .map(|side| {
            profile(edges, crossings, angle, side, unit).sums.iter().fold(0.0, |a: f64, b| a.max(*b)).powi(2)
        })
        .sum()
}

/// Offsets of the strongest peaks, mm, strongest first.
fn peaks(profile: &Profile) -> Vec<f64> {
    let MapOutlineSettings { bin, peaks_a_side, peaks_apart, .. } = MapOutlineSettings::DEFAULT;
    let mut order: Vec<usize> = (0..profile.sums.len()).filter(|i| profile.sums[*i] > 0.0).collect();
    order.sort_by(|a, b| profile.sums[*b].total_cmp(&profile.sums[*a]));
    let mut kept: Vec<usize> = Vec::new();
    for i in order {
        if kept.len() == peaks_a_side {
            break;
        }
        if kept.iter().all(|k| k.abs_diff(i) as f64 * bin >= peaks_apart) {
            kept.push(i);
        }
    }
    kept.into_iter().map(|i| profile.sign * (profile.start_mm + (i as f64 + 0.5) * profile.bin_mm)).collect()
}

/// A rectangle: turned by an angle against the stripes, sides at offsets.
#[derive(Clone, Copy)]
pub(crate) struct RectangleCandidate {
    pub angle: f64,
    pub offsets_mm: [f64; 4],
}

impl RectangleCandidate {
    fn score(
        &self,
        calibration: &Calibration,
        base: &PlaneRaster,
        maps: &FaceMaps,
        mask: &[WeightedPoint],
        unit: f64,
    ) -> f32 {
        let sides: f32 = (0..4).map(|side| self.support(calibration, base, maps, side)).sum();
        sides + MapOutlineSettings::DEFAULT.overlap_worth * self.overlap(mask, unit)
    }

    /// Mean edge probability along a side.
    fn support(&self, calibration: &Calibration, base: &PlaneRaster, maps: &FaceMaps, side: usize) -> f32 {
        let samples = MapOutlineSettings::DEFAULT.samples;
        let raster = base.turned(self.angle);
        let (from, to) = span_mm(&self.offsets_mm, side);
        let value = |n: usize| {
            let along = from + (to - from) * (n as f64 + 0.5) / samples as f64;
            let px = raster.pixel(calibration, SIDES[side].0.at(self.offsets_mm[side], along));
            px.map_or(0.0, |px| maps.at(Channel::FaceEdge, px))
        };
        (0..samples).map(value).sum::<f32>() / samples as f32
    }

    /// About the intersection over union with the mask; `mask` holds one pixel in four.
    fn overlap(&self, mask: &[WeightedPoint], unit: f64) -> f32 {
        let [a0, a1, b0, b1] = self.offsets_mm;
        let inside = mask
            .iter()
            .filter(|spot| {
                let at = turned(spot.at, self.angle);
                at.x > a0 && at.x < a1 && at.y > b0 && at.y < b1
            })
            .count() as f64;
        // A tilted face has more pixels where it is near; the size of a pixel at the grid's middle stands for all.
        let area = (a1 - a0) * (b1 - b0) / (4.0 * unit * unit);
        (inside / (area.max(inside) + mask.len() as f64 - inside)) as f32
    }

    /// Intersection over union with the mask, counted on the maps.
    fn exact_overlap(&self, calibration: &Calibration, base: &PlaneRaster, maps: &FaceMaps) -> f32 {
        let [a0, a1, b0, b1] = self.offsets_mm;
        let [width, height] = maps.size();
        let map = maps.channel(Channel::FaceMask);
        let (mut both, mut either) = (0, 0);
        for y in (0..height).step_by(2) {
            for x in (0..width).step_by(2) {
                let face = map[y * width + x] >= MapOutlineSettings::DEFAULT.least_mask;
                let inside = base
                    .on_plane(calibration, maps.px_from_raster(x as f64, y as f64))
                    .map(|at| turned(at, self.angle))
                    .is_some_and(|at| at.x > a0 && at.x < a1 && at.y > b0 && at.y < b1);
                both += i32::from(face && inside);
                either += i32::from(face || inside);
            }
        }
        both as f32 / either.max(1) as f32
    }

    /// Least squares of angle and offsets to the edge pixels nearby; `unit` is a pixel of the maps, mm.
    pub fn fitted(mut self, edges: &[WeightedPoint], unit: f64) -> Self {
        let MapOutlineSettings { on_side, most_turn_rad, .. } = MapOutlineSettings::DEFAULT;
        for near in on_side {
            let mut normal = nalgebra::SMatrix::<f64, 5, 5>::zeros();
            let mut right = nalgebra::SVector::<f64, 5>::zeros();
            for spot in edges {
                let at = turned(spot.at, self.angle);
                for (side, (across, _)) in SIDES.iter().enumerate() {
                    let (from, to) = span_mm(&self.offsets_mm, side);
                    let (off, along) = (across.offset(at) - self.offsets_mm[side], across.along(at));
                    if off.abs() > near * unit || along < from || along > to {
                        continue;
                    }
                    // Turning by d moves a point's offset by +-its place along the side.
                    let lever = if *across == Across::A { along } else { -along };
                    let mut row = nalgebra::SVector::<f64, 5>::zeros();
                    row[0] = lever;
                    row[1 + side] = -1.0;
                    normal += row * row.transpose() * spot.weight;
                    right -= row * (off * spot.weight);
                }
            }
            let Some(step) = normal.cholesky().map(|c| c.solve(&right)) else { return self };
            if !step.iter().all(|s| s.is_finite()) || step[0].abs() > most_turn_rad {
                return self;
            }
            self.angle += step[0];
            for (offset, s) in self.offsets_mm.iter_mut().zip(step.iter().skip(1)) {
                *offset += s;
            }
        }
        self
    }
}
