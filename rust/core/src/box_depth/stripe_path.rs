//! One stripe on the face beside a measured one: where it must be seen, and how strongly it is.

use crate::calibration::Calibration;
use crate::frames::Point;
use crate::image::Frame;
use crate::measurement::FaceMeasurement;
use crate::statistics::{median, robust_sigma};
use crate::stripe::colour_projection::ColourProjection;
use crate::units::LaserId;
use nalgebra::{Matrix2, Vector2, Vector3};

/// The frame and how a stripe looks on it.
pub(super) struct FramedStripe<'a> {
    pub calibration: &'a Calibration,
    pub frame: &'a Frame,
    pub projection: ColourProjection,
    /// Half the stripe's width at its foot, px.
    pub foot_px: f64,
}

/// Where a stripe is looked for and how it is told from what lies beside it. Where a field gives no reason for its value, none is on record.
#[derive(Clone, Copy, Debug)]
struct PathSettings {
    /// Rows along the trail that are added to one place, px: the stripe's end is told to that. More shows fainter stripes and ends them less
    /// exactly.
    place_px: usize,
    /// Fewest places up to the nearer depth. More leaves out shallow boxes and oblique faces.
    least_places: usize,
    /// The neighbouring face is seen at this angle at least (cosine to its normal, 6 degrees of grazing). More leaves out oblique faces.
    least_cos: f64,
    /// How far the neighbouring face may lie from where it is expected at the edge, mm (rounding). More tries more lines: it takes longer, and a
    /// stripe must be clearer.
    off_mm: f64,
    /// ... and how much it may stand from a right angle, rad (three times half a degree). The same.
    off_rad: f64,
    /// Distance of two lines that are tried, in half widths of the stripe at its foot (about half a stripe), and how many there are to one side
    /// at most. A larger distance misses faint stripes between; more lines take longer.
    line_step: f64,
    most_lines: f64,
    /// A peak this far from the line is another surface's, px: more than noise (0.5 px) and a bulge of some mm move it. More takes floors and flush
    /// faces for the neighbouring one.
    near_px: f64,
    /// The line is drawn to peaks within so many half widths first, then within these, then within `near_px`; no peak is looked for nearer than the
    /// second. More lets print beside the stripe draw the line.
    peak_reach: f64,
    narrower_reach: f64,
    /// Strengths beyond this count no more, in sigmas. More lets single bright places stand for a stripe.
    most_sigmas: f64,
    /// Noise of the filter that is always there, grey levels: JPEG's steps. More loses faint stripes.
    least_noise: f64,
    /// The noise is that of so many places on either hand. More takes in what is brighter or darker farther along.
    noise_places: usize,
    /// In half widths of the stripe at its foot: half the core, and where what lies beside it begins and ends. A larger core and a wider background
    /// show fainter stripes and mix in print; a background that begins nearer has some of the stripe.
    filter: [f64; 3],
    /// Lines beside the trail, in half widths: from the first of these on, so far apart, as far as the third or so many px. Nearer ones see the
    /// stripe itself, farther ones leave the surface.
    beside_from: f64,
    beside_step: f64,
    beside_to: f64,
    beside_to_px: f64,
}

impl PathSettings {
    const DEFAULT: Self = Self {
        place_px: 4,
        least_places: 12,
        least_cos: 0.1,
        off_mm: 4.0,
        off_rad: 0.027,
        line_step: 0.4,
        most_lines: 12.0,
        near_px: 1.5,
        peak_reach: 0.7,
        narrower_reach: 0.5,
        most_sigmas: 6.0,
        least_noise: 0.5,
        noise_places: 4,
        filter: [0.5, 1.2, 2.2],
        beside_from: 2.5,
        beside_step: 0.75,
        beside_to: 6.0,
        beside_to_px: 24.0,
    };
}

impl Default for PathSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// A stripe's predicted way over a neighbouring face.
pub(super) struct StripePath {
    steps: Vec<Step>,
}

/// A place on the way.
#[derive(Clone, Copy, Debug)]
struct Step {
    depth_mm: f64,
    step_mm: f64,
    at: Vector2<f64>,
    /// Unit vectors in the image along the way and across it.
    along: Vector2<f64>,
    across: Vector2<f64>,
    /// How the stripe moves across when the surface moves outwards, px per mm.
    px_per_mm: f64,
    /// Sine of the angle to a stripe that goes on parallel to the measured face: a flush one at the edge, the floor beyond.
    sin_bend: f64,
}

/// One place with what was seen there.
#[derive(Clone, Copy, Debug)]
pub(super) struct PathSample {
    /// Behind the measured face, mm.
    pub depth_mm: f64,
    /// To the next place, mm.
    pub step_mm: f64,
    /// In sigmas of what lies beside it, clipped.
    pub strength: f64,
    /// The same in grey levels.
    pub light: f64,
}

/// The strongest line near the predicted one.
pub(super) struct BrightLine {
    pub places: Vec<PathSample>,
    /// Median strength up to the nearer depth.
    pub usual: f64,
    /// Of the sum up to there, in sigmas of such sums along lines beside it.
    pub significance: f64,
    /// Lines tried.
    pub tried: usize,
}

impl StripePath {
    /// The way of a laser's stripe beyond side `side` (corner `side` to the next one) of a face, up to `most_mm` behind it or to
    /// where it leaves the image. `None` if the stripe does not cross the side or the face beyond is not seen.
    pub fn new(
        paper: &FramedStripe,
        face: &FaceMeasurement,
        side: usize,
        id: LaserId,
        most_mm: f64,
    ) -> Option<Self> {
        let PathSettings { place_px, least_cos, .. } = PathSettings::DEFAULT;
        let corners = face.corners.map(|c| c.mm);
        let (from, to) = (corners[side], corners[(side + 1) % 4]);
        let centre = corners.iter().sum::<Vector3<f64>>() * 0.25;
        let middle = (from + to) * 0.5;
        let edge = to - from;
        let (inwards, _) = face.plane.normal_and_distance_mm();
        let out = edge.cross(&inwards).try_normalize(1e-9)?;
        let out = if out.dot(&(middle - centre)) > 0.0 { out } else { -out };
        if -middle.normalize().dot(&out) < least_cos {
            return None;
        }
        let laser = paper.calibration.laser(id).per_mm;
        let share = (1.0 - laser.dot(&from)) / laser.dot(&edge);
        if !(0.0..=1.0).contains(&share) {
            return None;
        }
        let start = from + edge * share;
        // In the laser's plane: over the neighbouring face, per mm of depth; over a surface parallel to the measured one, per mm
        // outwards.
        let down = laser.cross(&out);
        let down = down / Some(down.dot(&inwards)).filter(|d| d.abs() > 1e-6 * down.norm())?;
        let on = laser.cross(&inwards);
        let on = on / Some(on.dot(&out)).filter(|d| d.abs() > 1e-6 * on.norm())?;
        let per_mm = edge.dot(&down) / edge.norm_squared();
        let px = |x: Vector3<f64>| {
            let px = paper.calibration.camera().px_from_point(&Point::from_vector(x))?;
            Some(Vector2::new(px.u, px.v))
        };
        let reach = paper.reach_px() as f64 + place_px as f64;
        let (right, bottom) = (paper.frame.width_px() as f64 - 1.0, paper.frame.height_px() as f64 - 1.0);
        let inside =
            |p: Vector2<f64>| p.x > reach && p.y > reach && p.x < right - reach && p.y < bottom - reach;
        let mut steps = Vec::new();
        let mut depth_mm = 0.0;
        // The face beside ends where the edge ends.
        while depth_mm < most_mm && (0.0..=1.0).contains(&(share + per_mm * depth_mm)) {
            let x = start + down * depth_mm;
            let Some(at) = px(x).filter(|p| inside(*p)) else { break };
            let way = px(x + down)? - at;
            let beside = px(x + on)? - at;
            let Some(along) = way.try_normalize(1e-3) else { break };
            let across = Vector2::new(-along.y, along.x);
            let px_per_mm = beside.dot(&across);
            let step_mm = place_px as f64 / way.norm();
            let sin_bend = (px_per_mm / beside.norm().max(1e-9)).abs();
            steps.push(Step { depth_mm, step_mm, at, along, across, px_per_mm, sin_bend });
            depth_mm += step_mm;
        }
        (!steps.is_empty()).then_some(Self { steps })
    }

    /// How far a stripe that goes on parallel to the measured face from this depth on is still taken for one on this trail, mm.
    pub fn late_mm(&self, depth_mm: f64) -> f64 {
        let PathSettings { place_px, near_px, .. } = PathSettings::DEFAULT;
        let at = self.steps.partition_point(|s| s.depth_mm < depth_mm);
        let late_mm = |s: &Step| near_px / s.sin_bend.max(1e-9) / place_px as f64 * s.step_mm;
        self.steps.get(at).map_or(f64::INFINITY, late_mm)
    }

    /// The strongest of all lines on which the stripe may run, judged up to `near_mm`.
    pub fn brightest(&self, paper: &FramedStripe, near_mm: f64) -> Option<BrightLine> {
        let PathSettings { off_mm, off_rad, line_step, most_lines, near_px, .. } = PathSettings::DEFAULT;
        let PathSettings { least_places, most_sigmas, peak_reach, .. } = PathSettings::DEFAULT;
        let first = self.steps.partition_point(|s| s.depth_mm <= 0.0);
        let last = self.steps.partition_point(|s| s.depth_mm < near_mm);
        if last < first + least_places {
            return None;
        }
        let responses: Vec<Response> = self.steps.iter().map(|s| paper.response(s)).collect();
        let noise: Vec<(f64, f64)> = (0..responses.len()).map(|i| beside(&responses, i, paper)).collect();
        let strength = |i: usize, offset_px: f64| {
            let (mean, sigma) = noise[i];
            ((responses[i].at(offset_px) - mean) / sigma).clamp(-most_sigmas, most_sigmas)
        };
        let count = (last - first) as f64;
        let sum = |offset: &dyn Fn(&Step) -> f64| {
            (first..last).map(|i| strength(i, offset(&self.steps[i]))).sum::<f64>() / count.sqrt()
        };
        let of_line =
            |(off_mm, off_rad): (f64, f64)| move |s: &Step| (off_mm + off_rad * s.depth_mm) * s.px_per_mm;
        let gain = self.steps[first..last].iter().map(|s| s.px_per_mm.abs()).fold(0.0, f64::max);
        let lines =
            |most_px: f64| (most_px / (line_step * paper.foot_px)).ceil().clamp(1.0, most_lines) as i32;
        let (offs, turns) = (lines(off_mm * gain), lines(off_rad * near_mm * gain));
        let mut best: Option<(f64, (f64, f64))> = None;
        for i in -offs..=offs {
            for j in -turns..=turns {
                let line =
                    (off_mm * f64::from(i) / f64::from(offs), off_rad * f64::from(j) / f64::from(turns));
                let found = sum(&of_line(line));
                if best.is_none_or(|(most, _)| found > most) {
                    best = Some((found, line));
                }
            }
        }
        let (found, line) = best?;
        // The same sums along lines beside it.
        let scatter = robust_sigma(paper.beside_px().map(|offset| sum(&|_| offset)))?;
        let line = self.refined(line, &responses[..last], first, paper.foot_px)?;
        let offset = of_line(line);
        let place = |(i, s): (usize, &Step)| {
            let offset_px = offset(s);
            let light = responses[i].at(offset_px) - noise[i].0;
            let peak_px = responses[i].peak_px(offset_px, peak_reach * paper.foot_px);
            let on_line = peak_px.is_some_and(|p| (p - offset_px).abs() <= near_px);
            let strength = if on_line { strength(i, offset_px) } else { 0.0 };
            PathSample { depth_mm: s.depth_mm, step_mm: s.step_mm, strength, light }
        };
        let places: Vec<PathSample> = self.steps.iter().enumerate().map(place).collect();
        let usual = median(places[first..last].iter().map(|p| p.strength))?;
        let tried = ((2 * offs + 1) * (2 * turns + 1)) as usize;
        (usual > 0.0).then_some(BrightLine { places, usual, significance: found / scatter.max(1.0), tried })
    }
}

impl StripePath {
    /// The line through the peaks near a line, with what is known of neighbouring faces beforehand: (off, turn).
    fn refined(
        &self,
        (mut off_mm, mut off_rad): (f64, f64),
        responses: &[Response],
        first: usize,
        foot_px: f64,
    ) -> Option<(f64, f64)> {
        let settings = &PathSettings::DEFAULT;
        let (last_px, narrower_px) = (settings.near_px, settings.narrower_reach * foot_px);
        for near_px in [settings.peak_reach * foot_px, narrower_px, last_px, last_px] {
            let known = Vector2::new(settings.off_mm.powi(-2), settings.off_rad.powi(-2));
            let mut normal = Matrix2::from_diagonal(&known);
            let mut right = Vector2::zeros();
            for (s, response) in self.steps.iter().zip(responses).skip(first) {
                let row = Vector2::new(s.px_per_mm, s.px_per_mm * s.depth_mm);
                let here_px = row.dot(&Vector2::new(off_mm, off_rad));
                let peak_px = response.peak_px(here_px, near_px.max(narrower_px));
                if let Some(peak_px) = peak_px.filter(|p| (p - here_px).abs() <= near_px) {
                    // One px a place: neighbours share texture.
                    normal += row * row.transpose();
                    right += row * peak_px;
                }
            }
            let solved = normal.cholesky()?.solve(&right);
            (off_mm, off_rad) = (solved.x, solved.y);
        }
        Some((off_mm, off_rad))
    }
}

/// The filter's output across one place, one value a px.
struct Response {
    values: Vec<f64>,
    middle: f64,
}

impl Response {
    /// The nearest value.
    fn at(&self, offset_px: f64) -> f64 {
        let last = self.values.len() - 1;
        self.values[((offset_px + self.middle).round().max(0.0) as usize).min(last)]
    }
}

impl Response {
    /// Where it is largest within `reach_px` of an offset, by a parabola; `None` if it only grows towards one end.
    fn peak_px(&self, offset_px: f64, reach_px: f64) -> Option<f64> {
        let place = |offset: f64| {
            ((offset + self.middle).round().max(1.0) as usize).min(self.values.len().saturating_sub(2))
        };
        let (from, to) = (place(offset_px - reach_px), place(offset_px + reach_px));
        let top = (from..=to).max_by(|a, b| self.values[*a].total_cmp(&self.values[*b]))?;
        let [left, here, right] = [top - 1, top, top + 1].map(|k| self.values[k]);
        let bend = left - 2.0 * here + right;
        (left <= here && right <= here && bend < 0.0)
            .then(|| top as f64 - self.middle + 0.5 * (left - right) / bend)
    }
}

/// Mean and standard deviation of the filter beside the trail around place `i`, robust.
fn beside(responses: &[Response], i: usize, paper: &FramedStripe) -> (f64, f64) {
    let PathSettings { noise_places, least_noise, .. } = PathSettings::DEFAULT;
    let around = &responses[i.saturating_sub(noise_places)..(i + noise_places + 1).min(responses.len())];
    let values: Vec<f64> = around.iter().flat_map(|r| paper.beside_px().map(|o| r.at(o))).collect();
    let middle = median(values.iter().copied());
    let spread = middle.and_then(|middle| robust_sigma(values.iter().map(|value| value - middle)));
    middle.zip(spread).map_or((0.0, f64::INFINITY), |(middle, spread)| (middle, spread.max(least_noise)))
}

impl FramedStripe<'_> {
    /// Half widths in which the filter is built, px: the stripe's core, and where what lies beside it begins and ends.
    fn widths_px(&self) -> [usize; 3] {
        PathSettings::DEFAULT.filter.map(|share| (share * self.foot_px).round().max(1.0) as usize)
    }

    /// Farthest line beside the trail, px.
    fn most_px(&self) -> f64 {
        (PathSettings::DEFAULT.beside_to * self.foot_px).max(PathSettings::DEFAULT.beside_to_px)
    }

    /// Pixels across the trail that are looked at.
    fn reach_px(&self) -> usize {
        self.most_px().ceil() as usize + self.widths_px()[2] + 1
    }

    /// Lines beside the trail that the stripe does not touch, px.
    fn beside_px(&self) -> impl Iterator<Item = f64> + use<> {
        let PathSettings { beside_from, beside_step, .. } = PathSettings::DEFAULT;
        let (foot, most) = (self.foot_px, self.most_px());
        let line_px = move |k: i32| beside_from * foot + beside_step * foot * f64::from(k);
        let steps = (1..).map(line_px).take_while(move |o| *o <= most);
        steps.flat_map(|o| [o, -o])
    }

    /// The stripe's core less the brighter of both sides: a step of brightness is no stripe.
    fn response(&self, step: &Step) -> Response {
        let place_px = PathSettings::DEFAULT.place_px;
        let reach = self.reach_px();
        let mut sums = vec![0.0; 2 * reach + 2];
        let (width, height) = (self.frame.width_px(), self.frame.height_px());
        for k in 0..=2 * reach {
            let mut value = 0.0;
            for row in 0..place_px {
                let at = step.at + step.along * row as f64 + step.across * (k as f64 - reach as f64);
                let (u, v) = (at.x.round().max(0.0) as usize, at.y.round().max(0.0) as usize);
                let index = v.min(height - 1) * width + u.min(width - 1);
                value += f64::from(self.projection.at(self.frame.stripe_rgb(), index));
            }
            sums[k + 1] = sums[k] + value / place_px as f64;
        }
        let [core, near, far] = self.widths_px();
        let mean = |from: usize, to: usize| (sums[to] - sums[from]) / (to - from) as f64;
        let values = (far..=2 * reach - far)
            .map(|k| {
                let here = mean(k - core, k + core + 1);
                let left = mean(k - far, k - near);
                let right = mean(k + near + 1, k + far + 1);
                here - left.max(right)
            })
            .collect();
        Response { values, middle: (reach - far) as f64 }
    }
}
