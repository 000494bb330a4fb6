//! The sub-pixel course of each side: gradient extremes along the normals of the predicted side (the default detector).

use super::{ColourTone, EdgeDetector, EdgePoint, Palette, noise_of, tones};
use crate::calibration::Calibration;
use crate::face::outline::{InitialRectangle, SIDES};
use crate::image::Frame;
use crate::units::Px;
use wide::f32x4;

/// Gradient search along the normals of the predicted sides, with its settings. Where no reason stands, there is no record of how a value was chosen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GradientDetector {
    /// Distance of neighbouring profiles along the side, px, and how many of them make one edge point. More average more noise away and round
    /// off what the side does between them; corners stay out.
    spacing_px: f64,
    group: usize,
    /// Over how many neighbouring groups a point's profile is averaged; the first number that shows the edge on this share of the side is
    /// taken. Faint edges need more, and their windows overlap. A larger share asks for more averaging, which rounds off what the side does.
    windows: [usize; 3],
    enough_share: f64,
    /// Share of the side at each corner that is left out, where the other side's blur and rounding disturb. More leaves fewer points on short
    /// sides.
    pub corner_share: f64,
    /// An edge point lies within this distance of the straight line that most points share, px. More lets other lines in, less loses bowed sides.
    near_line_px: f64,
    /// That line may differ from the prediction by so much at either end, px ...
    line_search_px: f64,
    /// ... and by so much in the middle: a line that lies farther off was weighed against this one before. Both are at most the profile's reach.
    line_search_middle_px: f64,
    /// What half a pixel of distance from the prediction costs, in shares of full support: 8 px cost 0.16. More takes a weak line near it for a
    /// strong one farther off.
    far_cost: f32,
    /// Smallest step of brightness of an edge point, grey levels, and in units of the profile's noise. More loses faint edges, less lets texture
    /// in.
    min_step: f32,
    min_step_sigmas: f32,
    /// How far a step's place in linear light may be from that in grey levels, px: the tone curve moves it by up to 1 px. More takes another
    /// step beside it.
    light_search_px: f64,
}

impl GradientDetector {
    pub const DEFAULT: Self = Self {
        spacing_px: 2.0,
        group: 4,
        windows: [1, 3, 9],
        enough_share: 0.33,
        corner_share: 0.025,
        near_line_px: 2.0,
        line_search_px: 8.0,
        line_search_middle_px: 4.0,
        far_cost: 0.01,
        min_step: 1.5,
        min_step_sigmas: 3.0,
        light_search_px: 1.5,
    };
}

impl Default for GradientDetector {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Reach of a profile to both sides of the prediction, px.
const REACH_PX: usize = 10;
/// Samples per px in a profile.
const PER_PX: usize = 2;
const N: usize = 2 * REACH_PX * PER_PX + 1;

/// One averaged profile across a side.
struct Profile {
    middle: Px,
    normal: (f64, f64),
    /// Position along the side, 0 to 1.
    along: f64,
    tone: [ColourTone; N],
    /// The same in linear light.
    light: [ColourTone; N],
}

impl Profile {
    fn channel(&self, channel: usize) -> [f32; N] {
        self.tone.map(|t| t[channel])
    }

    fn at(&self, index: f64) -> Px {
        let t = index / PER_PX as f64 - REACH_PX as f64;
        Px::new(self.middle.u + self.normal.0 * t, self.middle.v + self.normal.1 * t)
    }
}

impl EdgeDetector for GradientDetector {
    fn edge_points(
        &self,
        frame: &Frame,
        calibration: &Calibration,
        initial: &InitialRectangle,
        keep_out: &[(Px, f64)],
    ) -> [Vec<EdgePoint>; 4] {
        [0, 1, 2, 3].map(|side| {
            let mut best = Vec::new();
            let profiles = self.profiles(frame, calibration, initial, side, keep_out);
            for window in self.windows {
                let points = match window {
                    1 => self.points_on_line(&profiles, window),
                    _ => self.points_on_line(&averaged(&profiles, window), window),
                };
                if points.len() > best.len() {
                    best = points;
                }
                if best.len() as f64 >= self.enough_share * profiles.len() as f64 {
                    break;
                }
            }
            best
        })
    }
}

impl GradientDetector {
    fn profiles(
        &self,
        frame: &Frame,
        calibration: &Calibration,
        initial: &InitialRectangle,
        side: usize,
        keep_out: &[(Px, f64)],
    ) -> Vec<Profile> {
        let palette = Palette::get();
        let (across, _) = SIDES[side];
        let (from, to) = initial.span_mm(side);
        let offset = initial.offsets_mm[side];
        let margin = self.corner_share * (to - from);
        let pixel = |along: f64| initial.raster.pixel(calibration, across.at(offset, along));
        let (Some(first), Some(last)) = (pixel(from + margin), pixel(to - margin)) else { return Vec::new() };
        let groups = (first.distance_px(last) / (self.spacing_px * self.group as f64)).floor() as usize;
        let mut result = Vec::with_capacity(groups);
        for group in 0..groups {
            let mut sum = [f32x4::ZERO; N];
            let mut middle = Px::new(0.0, 0.0);
            let mut normal = (0.0, 0.0);
            let mut good = true;
            for k in 0..self.group {
                let t = (group as f64 + (k as f64 + 0.5) / self.group as f64) / groups as f64;
                let along = from + margin + (to - from - 2.0 * margin) * t;
                let step = 2.0 * initial.mm_per_px;
                let (Some(p), Some(q)) = (pixel(along), pixel(along + step)) else {
                    good = false;
                    break;
                };
                if keep_out.iter().any(|(c, r)| c.is_within(p, *r)) {
                    good = false;
                    break;
                }
                let length = p.distance_px(q).max(1e-9);
                let n = (-(q.v - p.v) / length, (q.u - p.u) / length);
                for (i, s) in sum.iter_mut().enumerate() {
                    let t = i as f64 / PER_PX as f64 - REACH_PX as f64;
                    let (u, v) = (p.u + n.0 * t, p.v + n.1 * t);
                    let Some(tones) = tones(frame, palette, u, v) else {
                        good = false;
                        break;
                    };
                    *s += tones * (1.0 / self.group as f32);
                }
                middle = Px::new(middle.u + p.u / self.group as f64, middle.v + p.v / self.group as f64);
                normal = n;
            }
            if good {
                let along = (group as f64 + 0.5) / groups as f64;
                let tones = sum.map(f32x4::to_array);
                let (tone, light) = (tones.map(|[b, h, ..]| [b, h]), tones.map(|[.., b, h]| [b, h]));
                result.push(Profile { middle, normal, along, tone, light });
            }
        }
        result
    }
}

/// Each profile averaged with its neighbours along the side; all follow the same predicted line.
fn averaged(profiles: &[Profile], window: usize) -> Vec<Profile> {
    let mean = |i: usize, of: fn(&Profile) -> &[ColourTone; N]| {
        let (lo, hi) = (i.saturating_sub(window / 2), (i + window / 2 + 1).min(profiles.len()));
        let mut tone = [[0f32; 2]; N];
        for p in &profiles[lo..hi] {
            for (sum, t) in tone.iter_mut().zip(of(p)) {
                sum[0] += t[0] / (hi - lo) as f32;
                sum[1] += t[1] / (hi - lo) as f32;
            }
        }
        tone
    };
    profiles
        .iter()
        .enumerate()
        .map(|(i, p)| Profile { tone: mean(i, |p| &p.tone), light: mean(i, |p| &p.light), ..*p })
        .collect()
}

/// Difference of neighbours one px to each side.
fn gradient(value: &[f32; N]) -> [f32; N] {
    let mut g = [0f32; N];
    for (out, pair) in g[PER_PX..].iter_mut().zip(value.windows(2 * PER_PX + 1)) {
        *out = pair[2 * PER_PX] - pair[0];
    }
    g
}

/// Fisher's direction for a step at `expected`: difference of the means 2 to 5 px to both sides over the squared noise,
/// scaled to unit length.
fn mixture(tone: &[ColourTone; N], expected: f64, noises: [f32; 2]) -> [f32; 2] {
    let middle = expected.round() as usize;
    let (near, far) = (2 * PER_PX, 5 * PER_PX);
    let weights = [0, 1].map(|c| {
        let mean = |range: std::ops::Range<usize>| {
            let n = range.len().max(1) as f32;
            range.map(|i| tone[i][c]).sum::<f32>() / n
        };
        let before = mean(middle.saturating_sub(far)..middle.saturating_sub(near));
        let after = mean((middle + near).min(N)..(middle + far).min(N));
        (after - before) / (noises[c] * noises[c])
    });
    let length = weights[0].hypot(weights[1]);
    if length > 0.0 { weights.map(|w| w / length) } else { [1.0, 0.0] }
}

/// What the edge is: a step of brightness, or the thin dark line between two flush boxes.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Step,
    DarkLine,
}

impl GradientDetector {
    fn points_on_line(&self, profiles: &[Profile], window: usize) -> Vec<EdgePoint> {
        if profiles.len() < 6 {
            return Vec::new();
        }
        let gradients = [0, 1].map(|c| profiles.iter().map(|p| gradient(&p.channel(c))).collect::<Vec<_>>());
        // Noise of a gradient sample: what changes from one profile to the next that shares no light with it. The edge
        // itself, however blurred, is in both.
        let noises = gradients.each_ref().map(|g| {
            let pairs = g.iter().zip(g.iter().skip(window));
            let mut all: Vec<f32> = pairs
                .flat_map(|(p, q)| {
                    (PER_PX..N - PER_PX).map(|i| (p[i] - q[i]).abs() * std::f32::consts::FRAC_1_SQRT_2)
                })
                .collect();
            noise_of(&mut all, 0.3)
        });
        let strengths: Vec<[f32; N]> = gradients[0]
            .iter()
            .zip(&gradients[1])
            .map(|(first, second)| {
                std::array::from_fn(|i| {
                    let sigmas = (first[i].abs() / noises[0]).max(second[i].abs() / noises[1]);
                    ((sigmas - 1.0) / 5.0).clamp(0.0, 1.0)
                })
            })
            .collect();
        // The straight line with the most support: offsets at both ends, half-pixel steps.
        let reach = (self.line_search_px * PER_PX as f64) as i32;
        let most = (2.0 * self.line_search_middle_px * PER_PX as f64) as i32;
        let centre = (REACH_PX * PER_PX) as i32;
        let mut best = (f32::NEG_INFINITY, 0, 0);
        for first in -reach..=reach {
            for last in (first - 10).max(-reach)..=(first + 10).min(reach) {
                if (first + last).abs() > most {
                    continue;
                }
                let mut sum = 0.0;
                // Half a sample is added, so that cutting off rounds; the reach is less than the centre.
                let (begin, turn) = (f64::from(centre + first) + 0.5, f64::from(last - first));
                for (strength, p) in strengths.iter().zip(profiles) {
                    sum += strength[(begin + turn * p.along) as u32 as usize];
                }
                // The nearer to the prediction the better.
                let score =
                    sum - self.far_cost * profiles.len() as f32 * (first.abs() + last.abs()) as f32 / 2.0;
                if score > best.0 {
                    best = (score, first, last);
                }
            }
        }
        let (_, first, last) = best;
        let line = |p: &Profile| f64::from(centre) + f64::from(first) + f64::from(last - first) * p.along;
        let (kind, shift) = edge_kind(profiles, &line);
        let mut points = Vec::with_capacity(profiles.len());
        let near = self.near_line_px * PER_PX as f64;
        let (min_step, correlation) = (self.min_step / (window as f32).sqrt(), (window as f64).sqrt());
        for p in profiles {
            let expected = line(p) + shift;
            // The mixture of both channels in which this edge stands out most against their noise.
            let mixture = match kind {
                Kind::Step => mixture(&p.tone, expected, noises),
                Kind::DarkLine => [1.0, 0.0],
            };
            let value = p.tone.map(|t| t[0] * mixture[0] + t[1] * mixture[1]);
            let g = gradient(&value);
            let noise = (noises[0] * mixture[0]).hypot(noises[1] * mixture[1]);
            let lo = ((expected - near).ceil().max(PER_PX as f64 + 1.0)) as usize;
            let hi = ((expected + near).floor() as usize).min(N - PER_PX - 2);
            if lo >= hi {
                continue;
            }
            let signal = |i: usize| match kind {
                Kind::Step => g[i].abs(),
                Kind::DarkLine => -value[i],
            };
            let Some(top) = (lo..=hi).max_by(|a, b| signal(*a).total_cmp(&signal(*b))) else { continue };
            let Some(mut index) = vertex(signal, top) else { continue };
            let height = match kind {
                Kind::Step => signal(top),
                Kind::DarkLine => {
                    0.5 * (value[top.saturating_sub(6)] + value[(top + 6).min(N - 1)]) - value[top]
                }
            };
            if height < min_step.max(self.min_step_sigmas * noise) {
                continue;
            }
            if kind == Kind::Step {
                let Some(found) = step_in_light(p, index, self.light_search_px) else { continue };
                index = found;
            }
            let sigma_px = 0.5 * f64::from(noise / height).max(0.2) * correlation;
            points.push(EdgePoint { at: p.at(index), sigma_px });
        }
        points
    }
}

/// Where the step near `index` lies in linear light.
fn step_in_light(p: &Profile, index: f64, search_px: f64) -> Option<f64> {
    let near = search_px * PER_PX as f64;
    let mixture = mixture(&p.light, index, [1.0; 2]);
    let g = gradient(&p.light.map(|t| t[0] * mixture[0] + t[1] * mixture[1])).map(f32::abs);
    let lo = (index - near).ceil().max(PER_PX as f64 + 1.0) as usize;
    let hi = ((index + near).floor() as usize).min(N - PER_PX - 2);
    let top = (lo..=hi).max_by(|a, b| g[*a].total_cmp(&g[*b]))?;
    vertex(|i| g[i], top)
}

/// Place of the parabola's top through the sample `top` and its neighbours, within one sample of it.
fn vertex(signal: impl Fn(usize) -> f32, top: usize) -> Option<f64> {
    let (l, c, r) = (signal(top - 1), signal(top), signal(top + 1));
    let curvature = l + r - 2.0 * c;
    (curvature < 0.0).then(|| top as f64 + f64::from(0.5 * (l - r) / curvature).clamp(-1.0, 1.0))
}

/// Whether the mean profile along the line shows a step or a dark line, and how far from the line that lies (samples).
fn edge_kind(profiles: &[Profile], line: &impl Fn(&Profile) -> f64) -> (Kind, f64) {
    const SPAN: i32 = 4 * PER_PX as i32;
    let mut mean = [0f32; 2 * SPAN as usize + 1];
    let mut count = 0.0;
    for p in profiles {
        let middle = line(p).round() as i32;
        if middle < SPAN || middle + SPAN >= N as i32 {
            continue;
        }
        for (k, m) in mean.iter_mut().enumerate() {
            *m += p.tone[(middle - SPAN) as usize + k][0];
        }
        count += 1.0;
    }
    if count < 1.0 {
        return (Kind::Step, 0.0);
    }
    mean.iter_mut().for_each(|m| *m /= count);
    let (left, right) = (mean[0].min(mean[1]), mean[mean.len() - 1].min(mean[mean.len() - 2]));
    let (lowest, value) = mean
        .iter()
        .enumerate()
        .skip(2)
        .take(mean.len() - 4)
        .fold((0, f32::INFINITY), |best, (i, m)| if *m < best.1 { (i, *m) } else { best });
    let depth = left.min(right) - value;
    let step = (mean[mean.len() - 1] - mean[0]).abs();
    if depth > 1.0 && depth > 0.7 * step {
        (Kind::DarkLine, lowest as f64 - f64::from(SPAN))
    } else {
        (Kind::Step, 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::GradientDetector;
    use crate::edges::detector_tests::{
        bears_frames_of_any_size, finds_known_sides, finds_nothing_in_the_dark, keeps_out_of_laser_light,
    };
    use proptest::prelude::*;

    const DETECTOR: GradientDetector = GradientDetector::DEFAULT;

    #[test]
    fn known_sides_are_found_to_a_fifth_of_a_pixel() {
        finds_known_sides(&DETECTOR);
    }

    #[test]
    fn no_point_lies_where_laser_light_disturbs() {
        keeps_out_of_laser_light(&DETECTOR);
    }

    #[test]
    fn a_black_frame_has_no_edges() {
        finds_nothing_in_the_dark(&DETECTOR);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn frames_of_any_size_do_no_harm(width in 1..90usize, height in 1..90usize, seed: u32) {
            bears_frames_of_any_size(&DETECTOR, width, height, seed);
        }
    }
}
