//! How round the edges of a box are, and where its sharp edges lie, from shading. Across an edge the surface turns from the face to
//! the neighbouring one; light that changes with the turn draws that arc into the picture, 2 to 20 px wide. The brightness across
//! each side, averaged along it, is compared with quarter cylinders of all radii at all places; all edges of a box have one
//! radius, so sides that show it tell it for those that do not.

use super::refine::FittedRectangle;
use super::side_view::{Correction, Rule, SideView, middle, normal, outwards, touching_share};
use super::stripe_ends::StripeEnds;
use crate::calibration::Calibration;
use crate::edges::{light, linear_light};
use crate::face::outline::{SIDES, outward_sign, span_mm};
use crate::image::Frame;
use crate::units::Px;
use nalgebra::{SMatrix, SVector};
use std::f64::consts::{FRAC_PI_2, PI};
use std::ops::Range;

/// Brightness across a side in linear light, one sample a px outwards.
#[derive(Clone, Debug)]
pub(crate) struct EdgeProfile {
    /// The first sample lies so far inside the side's line.
    pub inside_px: usize,
    pub light: Vec<f64>,
    /// Standard deviation of each: what changes along the side.
    pub sigma: Vec<f64>,
}

/// Radii of cardboard's edges, mm (PHYSICS.md).
pub(crate) const CARDBOARD_MM: std::ops::RangeInclusive<f64> = 0.5..=4.0;
/// How many radii are tried, and places of the sharp edge for each; lamps that rise over the arc.
const RADII: usize = 8;
const PLACES: usize = 25;
const RISES: usize = 3;
/// Logarithm of the least likelihood: an exponential that is still a number.
const IMPOSSIBLE: f64 = -500.0;

/// What is known of a light before looking.
#[derive(Clone, Copy, Debug)]
struct Spread {
    /// Over the light on the face. A wrong one moves sharp edges.
    mean: f64,
    /// Its standard deviation. More explains any profile, also print.
    sigma: f64,
}

/// How profiles are taken, with which arcs they are compared, and how far a comparison is believed. Where no reason stands, there is no record of how
/// a value was chosen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RoundingSettings {
    /// Profiles go this far to where there is box, mm: the largest rounding, blurred, and some of a flat face; bounds in px. More meets print.
    box_mm: f64,
    box_px: [f64; 2],
    /// ... and this far beyond a silhouette, px. More meets what lies behind.
    behind_px: usize,
    /// Most positions along a side at which one is taken, 2 px apart on short sides. More takes longer.
    most_positions: usize,
    /// Blocks of a side whose spread is the noise. More share print and shadow with their neighbours, and the noise comes out too small.
    blocks: usize,
    /// Part of the side at each corner that is left out. More leaves less to average.
    corner_share: f64,
    /// Where it is brighter than this the sensor saturates, and nothing is told; full scale is that of [`linear_light`]. More takes its limit for
    /// an even light.
    saturated: f64,
    /// Smallest and largest radius that is tried, mm, every scale alike: six share cardboard's range, one lies beyond either end. A larger range
    /// is coarser.
    radii_mm: [f64; 2],
    /// How likely a radius just beyond cardboard's is, against one within. More lets print pass for an odd rounding.
    unusual: f64,
    /// Places of the sharp edge that are tried, in sigmas of what the radius alone tells. More is coarser and lets a profile draw
    /// the edge farther away.
    places_sigmas: f64,
    /// Blur of lens, motion and demosaicing that is tried, px, one standard deviation. Wider ones take longer and explain a wide arc as blur.
    blurs_px: [f64; 3],
    /// ... its median, px, and the scatter of its logarithm. A larger median takes rounded edges for blurred sharp ones, a larger scatter lets
    /// profiles tell less of the radius.
    blur_px: f64,
    blur_scatter: f64,
    /// Light on a surface turned by a quarter, and the part of the light that does not change with the turn, over the light on the face (or
    /// on the brighter one of two): what rooms and yards have (`rust/sim/src/points/rounding.rs`). Larger sigmas explain anything, also print.
    turned: Spread,
    even: Spread,
    /// The light on a neighbouring face that is in view: anything. A smaller sigma takes a bright or a black neighbour for print.
    in_view: Spread,
    /// Turns of the arc at which lamps rise, and their light. A larger sigma explains print by lamps.
    rises_rad: [f64; RISES],
    lamp: Spread,
    /// What the model leaves out of a profile (lamps that set within the arc, gloss, wear), as a share of the light. More weighs all samples
    /// alike, however noisy they are, and lets strange profiles in.
    model: f64,
    /// Chi-square per degree of freedom from which a profile is not that of a rounded edge: print, a shadow or a neighbour beside it. More lets
    /// such profiles in.
    strange: f64,
    /// What the model leaves out goes together over several px: so many samples tell as much as one. With this and `misleading` the mean of
    /// (error / sigma)^2 is 1.0 for 1034 sides of rendered faces and 0.82 for drawn ones. More makes sigmas larger.
    together: f64,
    /// ... and no profile is followed more closely than this share of its variance: a perfect picture is none. More believes clean ones less.
    least_share: f64,
    /// How likely something else than the arc made a profile that looks like one, against the likelihood of the best arc. More makes sigmas
    /// larger.
    misleading: f64,
    /// No side makes a radius less likely than this, of its best: one in thirty shows something else. More lets sides tell each other less.
    doubt: f64,
    /// How likely the end of a stripe is elsewhere by chance (dark print, a neighbour's surface), against its density where it should be. More
    /// lets ends say less.
    wrong_end: f64,
    /// What neither shading nor ends know of: crushed edges, tape, flaps that stand off, mm. With it the 95 % intervals of 95 % of 357 sides of
    /// rendered faces hold the truth. More makes intervals too wide.
    wear_mm: f64,
    /// Scatter of a side's line, px. More spreads the places that are tried and makes sigmas larger.
    line_px: f64,
    /// Samples of the drawn arc a px. More takes longer.
    per_px: usize,
}

impl RoundingSettings {
    pub const DEFAULT: Self = Self {
        box_mm: 5.0,
        box_px: [6.0, 30.0],
        behind_px: 5,
        most_positions: 400,
        blocks: 8,
        corner_share: 0.06,
        saturated: 0.9 * 255.0,
        radii_mm: [0.42, 4.76],
        unusual: 0.15,
        places_sigmas: 3.0,
        blurs_px: [0.8, 1.3, 2.1],
        blur_px: 1.1,
        blur_scatter: 0.5,
        turned: Spread { mean: 0.7, sigma: 0.5 },
        even: Spread { mean: 0.45, sigma: 0.35 },
        in_view: Spread { mean: 0.5, sigma: 10.0 },
        rises_rad: [0.125 * PI, 0.25 * PI, 0.375 * PI],
        lamp: Spread { mean: 0.0, sigma: 0.3 },
        model: 0.01,
        strange: 3.0,
        together: 5.0,
        least_share: 0.1,
        misleading: 0.005,
        doubt: 0.03,
        wrong_end: 0.02,
        wear_mm: 0.2,
        line_px: 0.3,
        per_px: 4,
    };

    /// Radius number `i`, mm.
    fn radius_mm(&self, i: usize) -> f64 {
        let [low, high] = self.radii_mm;
        low * (high / low).powf(i as f64 / (RADII - 1) as f64)
    }

    /// How likely a radius is before looking.
    fn prior(&self, i: usize) -> f64 {
        if CARDBOARD_MM.contains(&self.radius_mm(i)) { 1.0 } else { self.unusual }
    }

    /// Place number `j` in sigmas.
    fn place_sigmas(&self, j: usize) -> f64 {
        self.places_sigmas * (2.0 * j as f64 / (PLACES - 1) as f64 - 1.0)
    }

    /// What the radius alone tells of the sharp edge's place outwards from the line: mean and sigma, mm.
    fn expected_mm(&self, rule: &Rule, view: &SideView, radius_mm: f64) -> (f64, f64) {
        (rule.share * radius_mm, (rule.share_sigma * radius_mm).hypot(self.line_px * view.mm_per_px))
    }

    /// How far a profile goes inside and beyond the line, px.
    fn reach_px(&self, view: &SideView) -> (usize, usize) {
        let [least, most] = self.box_px;
        let of_box = (self.box_mm / view.mm_per_px + 3.0).clamp(least, most).round() as usize;
        (of_box, if view.tan > 0.0 { of_box } else { self.behind_px })
    }
}

impl Default for RoundingSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Logarithm of how well a radius (row) and a place (column) explain a side.
pub(crate) type Table = SMatrix<f64, RADII, PLACES>;

/// How a side of the fit is seen.
pub(crate) fn view(calibration: &Calibration, fit: &FittedRectangle, side: usize) -> Option<SideView> {
    let towards = -middle(fit, side).normalize();
    let facing = -towards.dot(&normal(fit));
    let (from, to) = span_mm(&fit.offsets_mm, side);
    let pixel = |beside_mm: f64| {
        let at = SIDES[side].0.at(fit.offsets_mm[side] + beside_mm, 0.5 * (from + to));
        fit.raster.pixel(calibration, at)
    };
    let px_per_mm = pixel(-0.5)?.distance_px(pixel(0.5)?);
    (px_per_mm > 1e-3 && facing > 1e-3)
        .then(|| SideView { tan: towards.dot(&outwards(fit, side)) / facing, mm_per_px: 1.0 / px_per_mm })
}

impl RoundingSettings {
    /// The brightness across a side, averaged along it; `keep_out` are places with laser light. `None` if too little of it is clear.
    pub fn profile(
        &self,
        frame: &Frame,
        calibration: &Calibration,
        fit: &FittedRectangle,
        side: usize,
        view: &SideView,
        keep_out: &[(Px, f64)],
    ) -> Option<EdgeProfile> {
        let (across, _) = SIDES[side];
        let (from, to) = span_mm(&fit.offsets_mm, side);
        let (inside_px, outside_px) = self.reach_px(view);
        let samples = inside_px + outside_px + 1;
        let beside = |px: f64| fit.offsets_mm[side] + px * view.mm_per_px * outward_sign(side);
        let pixel = |px: f64, along: f64| fit.raster.pixel(calibration, across.at(beside(px), along));
        let length_px = pixel(0.0, from)?.distance_px(pixel(0.0, to)?);
        let positions = ((length_px / 2.0) as usize).min(self.most_positions);
        let linear = linear_light();
        let mut row = vec![0.0; samples];
        let mut blocks = vec![(vec![0.0; samples], 0.0); self.blocks];
        for i in 0..positions {
            let t = (i as f64 + 0.5) / positions as f64;
            let along = from + (to - from) * (self.corner_share + (1.0 - 2.0 * self.corner_share) * t);
            let (Some(p), Some(q)) = (pixel(-(inside_px as f64), along), pixel(outside_px as f64, along))
            else {
                continue;
            };
            let reach = 0.5 * p.distance_px(q);
            let mid = Px::new(0.5 * (p.u + q.u), 0.5 * (p.v + q.v));
            if keep_out.iter().any(|(c, r)| c.is_within(mid, r + reach)) {
                continue;
            }
            let step = 1.0 / (samples - 1) as f64;
            let seen = row.iter_mut().enumerate().try_for_each(|(k, value)| {
                let w = k as f64 * step;
                *value = f64::from(light(frame, linear, p.u + (q.u - p.u) * w, p.v + (q.v - p.v) * w)?);
                Some(())
            });
            if seen.is_some() {
                let (sum, count) = &mut blocks[i * self.blocks / positions];
                sum.iter_mut().zip(&row).for_each(|(s, value)| *s += value);
                *count += 1.0;
            }
        }
        let used: Vec<Vec<f64>> = blocks
            .into_iter()
            .filter(|(_, count)| *count > 0.0)
            .map(|(sum, count)| sum.into_iter().map(|s| s / count).collect())
            .collect();
        if used.len() <= self.blocks / 2 {
            return None;
        }
        let profile = EdgeProfile::of_blocks(inside_px, &used);
        profile.light.iter().all(|l| *l < self.saturated).then_some(profile)
    }
}

impl EdgeProfile {
    fn of_blocks(inside_px: usize, blocks: &[Vec<f64>]) -> Self {
        let samples = blocks.first().map_or(0, Vec::len);
        let mut profile =
            Self { inside_px, light: Vec::with_capacity(samples), sigma: Vec::with_capacity(samples) };
        for k in 0..samples {
            let mut values: Vec<f64> = blocks.iter().map(|block| block[k]).collect();
            values.sort_by(f64::total_cmp);
            // The middle half: print and shadows that only part of the side has do not count.
            let quarter = values.len() / 4;
            let inner = &values[quarter..values.len() - quarter];
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64;
            profile.light.push(inner.iter().sum::<f64>() / inner.len() as f64);
            profile.sigma.push((variance / values.len() as f64).sqrt());
        }
        profile
    }
}

/// Unknowns of a profile that are linear: light on the face, on a surface turned by a quarter, even light, what is behind, and lamps
/// that rise over the arc where it has turned by each of [`RoundingSettings::rises_rad`] (one that sets is one that rises and a difference of the first
/// three).
const LIGHTS: usize = 4 + RISES;
/// What each of them gives to a sample; the last is for the sample itself. In 64 bits: what the best lights leave is a millionth of what
/// they explain.
type Lights = SVector<f64, { LIGHTS + 1 }>;

/// The arc of one radius under each of the lights; `per_px` samples a px from `first_px` on, 0 at the sharp edge. All outside of
/// `changing` is as what lies next to that.
struct Arc {
    first_px: f64,
    per_px: f64,
    lights: Vec<Lights>,
    changing: Range<usize>,
}

impl Arc {
    /// Sharp, with room for a blur.
    fn new(view: &SideView, radius_mm: f64, blur_px: f64, settings: &RoundingSettings) -> Self {
        let per_px = settings.per_px as f64;
        let (radius_px, t) = (radius_mm / view.mm_per_px, view.tan);
        let crease = t > 0.0;
        // A silhouette ends where the line of sight touches it.
        let end = if crease { FRAC_PI_2 } else { f64::atan2(1.0, -t) };
        let place = |turn: f64| radius_px * ((turn.sin() - 1.0) + (1.0 - turn.cos()) * t);
        let (first, last) = (place(0.0), place(end));
        let margin = 4.0 * blur_px + 1.0;
        let first_px = first - margin;
        let samples = ((last - first + 2.0 * margin) * per_px).ceil() as usize + 1;
        // place(turn) / radius = sin turn - t cos turn + t - 1 is a sine itself: its inverse needs no search.
        let (length, phase) = (1.0f64.hypot(t), t.atan());
        let turn_at = |px: f64| ((px / radius_px + 1.0 - t) / length).clamp(-1.0, 1.0).asin() + phase;
        let behind = Lights::from([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
        let lit = |turn: f64| {
            let (s, c) = turn.sin_cos();
            let rises = settings.rises_rad.map(|rise| (turn - rise).sin().max(0.0));
            let [a, b, d] = rises;
            Lights::from([c, s, 1.0 - c - s, 0.0, a, b, d, 0.0])
        };
        let px_of = |i: usize| first_px + i as f64 / per_px;
        let begin = (0..samples).find(|i| px_of(*i) > first).unwrap_or(samples);
        let past = (begin..samples).find(|i| px_of(*i) >= last).unwrap_or(samples);
        let beyond = if crease { lit(FRAC_PI_2) } else { behind };
        let mut lights = vec![lit(0.0); begin];
        lights.extend((begin..past).map(|i| lit(turn_at(px_of(i)).clamp(0.0, end))));
        lights.resize(samples, beyond);
        Self { first_px, per_px, lights, changing: begin..past }
    }

    /// After a Gaussian blur; what lies beyond the ends goes on as it is there.
    fn blurred(&self, blur_px: f64) -> Self {
        let sigma = blur_px * self.per_px;
        let reach = (3.0 * sigma).ceil() as usize;
        let bell = |k: usize| (-0.5 * ((k as f64 - reach as f64) / sigma).powi(2)).exp();
        let total: f64 = (0..=2 * reach).map(bell).sum();
        let kernel: Vec<f64> = (0..=2 * reach).map(|k| bell(k) / total).collect();
        // What the kernel has before each of its samples.
        let mut before = vec![0.0];
        for w in &kernel {
            before.push(before[before.len() - 1] + w);
        }
        let Range { start, end } = self.changing;
        let changing = start.saturating_sub(reach)..(end + reach).min(self.lights.len());
        let (first, last) = (self.lights[0], self.lights[self.lights.len() - 1]);
        let mut lights = self.lights.clone();
        for i in changing.clone() {
            // Sample m counts with kernel[m + reach - i]: the constant ends at once, what changes one by one.
            let part = |m: usize| (m + reach).saturating_sub(i).min(kernel.len());
            let (from, to) = (part(start), part(end));
            let between = kernel[from..to].iter().zip(&self.lights[i + from - reach..]);
            let sum = between.fold(Lights::zeros(), |sum, (w, light)| sum + *light * *w);
            lights[i] = first * before[from] + sum + last * (1.0 - before[to]);
        }
        Self { lights, changing, ..*self }
    }

    /// Outside of this it is as at its ends, px.
    fn changing_px(&self) -> (f64, f64) {
        let px = |i: usize| self.first_px + i as f64 / self.per_px;
        (px(self.changing.start) - 1.0, px(self.changing.end) + 1.0)
    }

    fn at(&self, px: f64) -> Lights {
        let last = self.lights.len() - 1;
        let place = ((px - self.first_px) * self.per_px).clamp(0.0, last as f64);
        let low = (place as u32 as usize).min(last - 1);
        let w = place - low as f64;
        self.lights[low] * (1.0 - w) + self.lights[low + 1] * w
    }
}

/// Normal equations for the lights, row by row; the right side is the last lane.
#[derive(Clone, Copy)]
struct Equations([Lights; LIGHTS]);

impl Equations {
    /// Adds samples under the same lights: their weights and weighted values.
    fn add(&mut self, lights: Lights, weight: f64, weighted: f64) {
        let mut row = lights * weight;
        row[LIGHTS] = weighted;
        for (sum, light) in self.0.iter_mut().zip(&lights) {
            *sum += row * *light;
        }
    }

    /// How much of the weighted squares the best lights explain, by Cholesky's way; `None` where they are not fixed.
    fn explained(&self) -> Option<f64> {
        let mut lower = self.0;
        let mut solved = lower.map(|row| row[LIGHTS]);
        let mut explained = 0.0;
        for a in 0..LIGHTS {
            for b in 0..=a {
                let before: f64 = lower[a].iter().zip(&lower[b]).take(b).map(|(x, y)| x * y).sum();
                let rest = lower[a][b] - before;
                if a == b && (rest <= 0.0 || rest.is_nan()) {
                    return None;
                }
                lower[a][b] = if a == b { rest.sqrt() } else { rest / lower[b][b] };
            }
            let before: f64 = lower[a].iter().zip(&solved).take(a).map(|(x, y)| x * y).sum();
            solved[a] = (solved[a] - before) / lower[a][a];
            explained += solved[a] * solved[a];
        }
        Some(explained)
    }
}

/// A profile's samples with their weights, ready to be compared with arcs.
struct Weighed<'a> {
    light: &'a [f64],
    weights: Vec<f64>,
    /// Weights and weighted values of all samples before each.
    sums: Vec<(f64, f64)>,
    /// What is known of the lights beforehand.
    beforehand: Equations,
    /// Weighted squares of all that is observed or known.
    total: f64,
}

impl<'a> Weighed<'a> {
    /// `known`: number, mean and sigma of each light of which something is known.
    fn new(light: &'a [f64], weights: Vec<f64>, known: &[(usize, Spread)]) -> Self {
        let mut beforehand = [[0.0; LIGHTS + 1]; LIGHTS];
        // A light that nothing shows is as good as none.
        (0..LIGHTS).for_each(|light| beforehand[light][light] = 1e-12);
        let mut sums = vec![(0.0, 0.0)];
        let mut total = 0.0;
        for (value, weight) in light.iter().zip(&weights) {
            let (w, v) = sums[sums.len() - 1];
            sums.push((w + weight, v + weight * value));
            total += weight * value * value;
        }
        for (light, Spread { mean, sigma }) in known {
            let weight = sigma.powi(-2);
            beforehand[*light][*light] += weight;
            beforehand[*light][LIGHTS] = weight * mean;
            total += weight * mean * mean;
        }
        Self { light, weights, sums, beforehand: Equations(beforehand.map(Lights::from)), total }
    }

    /// What an arc leaves of the weighted squares if its sharp edge is at this sample; `None` where its lights are not fixed.
    fn left(&self, arc: &Arc, edge: f64) -> Option<f64> {
        let (from_px, to_px) = arc.changing_px();
        let samples = self.light.len();
        let first = ((from_px + edge).max(0.0) as usize).min(samples);
        let last = ((to_px + edge).max(0.0) as usize).clamp(first, samples);
        let mut equations = self.beforehand;
        equations.add(arc.at(f64::NEG_INFINITY), self.sums[first].0, self.sums[first].1);
        let each = self.light.iter().zip(&self.weights).enumerate();
        for (k, (value, weight)) in each.take(last).skip(first) {
            equations.add(arc.at(k as f64 - edge), *weight, weight * value);
        }
        let (w, v) = self.sums[samples];
        equations.add(arc.at(f64::INFINITY), w - self.sums[last].0, v - self.sums[last].1);
        Some((self.total - equations.explained()?).max(0.0))
    }
}

impl RoundingSettings {
    /// How well each radius and place explain a profile; `None` if none does.
    pub fn explain(&self, profile: &EdgeProfile, rule: &Rule, view: &SideView) -> Option<Table> {
        let samples = profile.light.len();
        let few = samples < profile.inside_px + self.behind_px || samples <= LIGHTS + 3;
        if profile.sigma.len() != samples || few {
            return None;
        }
        let mean = profile.light.iter().sum::<f64>() / samples as f64;
        let face = profile.light.iter().take(4).sum::<f64>() / 4.0;
        if !(mean > 0.0 && face > 0.0) {
            return None;
        }
        let weights = profile.sigma.iter().map(|s| (s * s + (self.model * mean).powi(2)).recip()).collect();
        // A neighbouring face that is in view tells its light itself.
        let beyond = profile.light.iter().rev().take(4).sum::<f64>() / 4.0;
        let (usual, turned) =
            if view.tan > 0.0 { (face.max(beyond), self.in_view) } else { (face, self.turned) };
        let known = [(1, turned), (2, self.even), (4, self.lamp), (5, self.lamp), (6, self.lamp)]
            .map(|(i, light)| (i, Spread { mean: light.mean * usual, sigma: light.sigma * usual }));
        let weighed = Weighed::new(&profile.light, weights, &known);
        let mut chi2 = Table::repeat(f64::INFINITY);
        for (i, mut row) in chi2.row_iter_mut().enumerate() {
            let radius_mm = self.radius_mm(i);
            let (mean_mm, sigma_mm) = self.expected_mm(rule, view, radius_mm);
            for blur_px in self.blurs_px {
                let arc = Arc::new(view, radius_mm, blur_px, self).blurred(blur_px);
                let unusual = ((blur_px / self.blur_px).ln() / self.blur_scatter).powi(2);
                for (j, best) in row.iter_mut().enumerate() {
                    let out_mm = mean_mm + self.place_sigmas(j) * sigma_mm;
                    let edge = profile.inside_px as f64 + out_mm / view.mm_per_px;
                    if let Some(left) = weighed.left(&arc, edge) {
                        *best = best.min(left + unusual);
                    }
                }
            }
        }
        let freedom = samples as f64 - 6.0;
        // How far the samples are from the best arc tells their noise better than their spread along the side, which a lamp's falling
        // light alone makes: Student's t.
        let least = chi2.min().max(self.least_share * freedom);
        let likelihood = |c: f64| (c.max(least) / least).powf(-0.5 * freedom / self.together);
        (least < self.strange * freedom).then(|| chi2.map(|c| (likelihood(c) + self.misleading).ln()))
    }

    /// What the stripes' ends tell of the sharp edge, if they are right: none is certain.
    pub fn explain_ends(&self, ends: &StripeEnds, rule: &Rule, view: &SideView) -> Table {
        Table::from_fn(|i, j| {
            let radius_mm = self.radius_mm(i);
            let (mean_mm, sigma_mm) = self.expected_mm(rule, view, radius_mm);
            let end_mm = mean_mm + self.place_sigmas(j) * sigma_mm - touching_share(view) * radius_mm;
            let off = (end_mm - ends.outwards_mm) / ends.sigma_mm;
            ((-0.5 * off * off).exp() + self.wrong_end).ln()
        })
    }

    /// The corrections of four sides that share one radius; `None` in `tables` for a side that tells nothing.
    pub fn corrections(
        &self,
        rules: &[Rule; 4],
        views: &[SideView; 4],
        tables: &[Option<Table>; 4],
    ) -> [Correction; 4] {
        // With what the radius alone tells of the place.
        let places = SVector::<f64, PLACES>::from_fn(|j, _| -0.5 * self.place_sigmas(j).powi(2)).transpose();
        let tables = [0, 1, 2, 3].map(|side| {
            let mut table = tables[side].unwrap_or_else(Table::zeros);
            table.row_iter_mut().for_each(|mut row| row += places);
            table.map(|log| log.max(IMPOSSIBLE).exp())
        });
        // How likely each radius makes what a side shows; none is ruled out by one side.
        let by_side = tables.map(|table| {
            let likely = table.column_sum();
            likely.map(|l| l + self.doubt * likely.max())
        });
        let radii = SVector::<f64, RADII>::from_fn(|i, _| {
            self.prior(i) * by_side.iter().map(|l| l[i]).product::<f64>()
        });
        let radii = radii / radii.sum();
        [0, 1, 2, 3].map(|side| {
            let (mut mean, mut square, mut of_means) = (0.0, 0.0, 0.0);
            for i in 0..RADII {
                let (mean_mm, sigma_mm) = self.expected_mm(&rules[side], &views[side], self.radius_mm(i));
                let row = tables[side].row(i);
                let sum = row.sum();
                let moment = |power: i32| {
                    let at =
                        |(j, w): (usize, &f64)| w * (mean_mm + self.place_sigmas(j) * sigma_mm).powi(power);
                    row.iter().enumerate().map(at).sum::<f64>() / sum
                };
                let here = moment(1);
                mean += radii[i] * here;
                square += radii[i] * moment(2);
                of_means += radii[i] * here * here;
            }
            Correction {
                outwards_mm: mean,
                sigma_mm: (square - mean * mean).max(0.0).sqrt().hypot(self.wear_mm),
                by_radius_mm: (of_means - mean * mean).max(0.0).sqrt(),
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ROUNDING: RoundingSettings = RoundingSettings::DEFAULT;
    const MM_PER_PX: f64 = 0.25;

    /// The brightness across a quarter cylinder, drawn point by point: thousands of places on the arc fall into the samples' blur.
    /// The line lies `line_mm` inside the sharp edge.
    fn drawn(view: &SideView, radius_mm: f64, lamp_rad: f64, line_mm: f64) -> EdgeProfile {
        let light = |turn: f64| 0.3 + (turn - lamp_rad).cos().max(0.0);
        let mut places: Vec<(f64, f64)> = Vec::new();
        for i in 0..40_000 {
            let mm = -12.0 + i as f64 * 6e-4; // across, 0 at the sharp edge
            // The first surface that the line of sight through this place of the face's plane meets.
            let turn = (0..=900).map(|k| k as f64 / 900.0 * FRAC_PI_2).rev().find(|turn| {
                let place = radius_mm * (turn.sin() - 1.0 + (1.0 - turn.cos()) * view.tan);
                let facing = turn.cos() + view.tan * turn.sin() > 0.0;
                facing && place <= mm
            });
            let first = -radius_mm;
            let last = if view.tan > 0.0 { radius_mm * view.tan } else { -touching_share(view) * radius_mm };
            let value = if mm <= first {
                light(0.0)
            } else if mm < last {
                light(turn.unwrap_or(0.0))
            } else if view.tan > 0.0 {
                light(FRAC_PI_2)
            } else {
                0.15
            };
            places.push((mm, value));
        }
        let (inside_px, outside_px) = ROUNDING.reach_px(view);
        let light = (0..=inside_px + outside_px)
            .map(|k| {
                let mm = (k as f64 - inside_px as f64) * view.mm_per_px - line_mm;
                let weighted = places.iter().map(|(at, value)| {
                    let weight = (-0.5 * ((at - mm) / view.mm_per_px).powi(2)).exp();
                    (weight, weight * value)
                });
                let (weights, sum) = weighted.fold((0.0, 0.0), |(w, s), (a, b)| (w + a, s + b));
                100.0 * sum / weights
            })
            .collect::<Vec<f64>>();
        EdgeProfile { inside_px, sigma: vec![0.5; light.len()], light }
    }

    /// Not so where a lamp sets half way round a wide arc (lamp -0.6, tangent 0.3): what follows is as flat as the neighbouring face, and
    /// the sharp edge is found 1 mm inside, three sigmas.
    #[test]
    fn shading_tells_radius_and_sharp_edge() {
        for radius_mm in [0.7, 1.5, 3.5] {
            for (tan, lamp_rad) in [(-0.4, -0.5), (-0.2, 2.2), (0.3, 2.0), (0.3, 0.3)] {
                let view = SideView { tan, mm_per_px: MM_PER_PX };
                let rule = Rule::new(&view);
                let line_mm = rule.share * radius_mm;
                let table = ROUNDING.explain(&drawn(&view, radius_mm, lamp_rad, line_mm), &rule, &view);
                assert!(table.is_some(), "radius {radius_mm}, tan {tan}, lamp {lamp_rad}");
                let known = ROUNDING.corrections(&[rule; 4], &[view; 4], &[table; 4])[0];
                let unknown = ROUNDING.corrections(&[rule; 4], &[view; 4], &[None; 4])[0];
                let off = (known.outwards_mm - line_mm).abs();
                assert!(
                    off < 0.4 && off < 2.5 * known.sigma_mm,
                    "{radius_mm} {tan} {lamp_rad}: {known:?}, {line_mm} is true"
                );
                assert!(known.sigma_mm < 0.75 * unknown.sigma_mm, "{known:?} {unknown:?}");
            }
        }
    }

    #[test]
    fn without_shading_cardboard_tells() {
        let view = SideView { tan: 0.0, mm_per_px: 1.0 };
        let rule = Rule { share: 0.5, share_sigma: 0.3 };
        let found = ROUNDING.corrections(&[rule; 4], &[view; 4], &[None; 4])[0];
        // Radius 1.68 +- 0.98 mm: every scale from 0.5 to 4 alike; and a little beyond.
        assert!(
            (found.outwards_mm - 0.85).abs() < 0.1 && (found.by_radius_mm - 0.5).abs() < 0.15,
            "{found:?}"
        );
    }

    #[test]
    fn radii_that_a_perfect_picture_rules_out_leave_a_number() {
        let view = SideView { tan: 0.0, mm_per_px: 0.1 };
        let rule = Rule { share: 0.5, share_sigma: 0.3 };
        let table = Table::from_fn(|i, _| if i == 2 { 0.0 } else { -1e5 });
        let found = ROUNDING.corrections(&[rule; 4], &[view; 4], &[Some(table); 4])[0];
        assert!(
            (found.outwards_mm - 0.5 * ROUNDING.radius_mm(2)).abs() < 0.05 && found.sigma_mm.is_finite(),
            "{found:?}"
        );
    }

    #[test]
    fn print_beside_an_edge_is_no_rounding() {
        let view = SideView { tan: -0.3, mm_per_px: MM_PER_PX };
        let rule = Rule::new(&view);
        let mut profile = drawn(&view, 1.0, -0.5, 0.3);
        profile.light.iter_mut().skip(4).take(3).for_each(|l| *l *= 0.4);
        assert!(ROUNDING.explain(&profile, &rule, &view).is_none());
    }

    proptest! {
        #[test]
        fn no_profile_panics(light in prop::collection::vec(-1e3..1e3f64, 0..70), inside_px in 0usize..80, tan in -3.0..3.0f64,
            mm_per_px in 0.01..5.0f64) {
            let view = SideView { tan, mm_per_px };
            let rule = Rule::new(&view);
            let table = ROUNDING.explain(&EdgeProfile { inside_px, sigma: vec![1.0; light.len()], light }, &rule, &view);
            for c in ROUNDING.corrections(&[rule; 4], &[view; 4], &[table, None, table, None]) {
                prop_assert!(c.outwards_mm.is_finite() && c.sigma_mm.is_finite() && c.by_radius_mm <= c.sigma_mm);
            }
        }
    }
}
