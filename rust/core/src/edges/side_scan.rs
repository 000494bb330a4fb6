//! Evidence for a straight edge at each offset: the side is cut into segments, each gives a mean profile of its tone
//! across it, and an edge is where most segments show a step (or a thin dark line: the seam between flush boxes) at the
//! same place. Print, labels and tape seldom run the whole length of a side.

use super::line_tone::LineTones;
use super::noise_of;
use crate::calibration::Calibration;
use crate::face::outline::Across;
use crate::face::raster::PlaneRaster;
use crate::image::Frame;
use crate::units::Px;

/// A side may be turned against the raster by this much from end to end, px.
pub(crate) const TURN_PX: f64 = 8.0;
/// Segments of a side.
pub(crate) const SEGMENTS: usize = 16;
/// Samples added up in one segment at each offset.
const SAMPLES_A_SEGMENT: usize = 10;
/// Half the distance over which a step is measured, in scan steps (about px): the optics blur an edge over 2 to 3 px.
const STEP_REACH: usize = 2;
/// Exact projections every so many scan steps and at the segments' ends, straight lines between: distortion bends by less than
/// 0.05 px there.
const NODE_STEPS: usize = 32;

/// What counts as an edge in one segment, and where candidates lie. Where a field gives no reason for its value, none is on record.
#[derive(Clone, Copy, Debug)]
struct ScanSettings {
    /// Fewest steps of a segment that are seen: their noise is known from them. More leaves out lines near the picture's border.
    least_seen: usize,
    /// Least noise that is believed, grey levels: where the picture is flat. More loses faint edges.
    least_noise: f32,
    /// A step this many noise sigmas high counts fully; one segment must not outvote the others. More lets faint edges count less.
    full_sigmas: f32,
    /// A thin dark line counts so much more than a step as high. More takes print for seams.
    dark_line: f32,
    /// An edge between two steps counts so much at either. More widens edges.
    beside: f32,
    /// Most steps by which an edge drifts from end to end. More takes longer, and edges that are turned farther count.
    most_drift: f64,
}

impl ScanSettings {
    const DEFAULT: Self = Self {
        least_seen: 16,
        least_noise: 0.5,
        full_sigmas: 5.0,
        dark_line: 1.5,
        beside: 0.7,
        most_drift: 40.0,
    };
}

impl Default for ScanSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What is scanned.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScanRange {
    pub across: Across,
    /// First and last offset, mm.
    pub from_mm: f64,
    pub to_mm: f64,
    /// Where the side begins and ends along its direction, mm.
    pub span_mm: (f64, f64),
    /// Distance of two offsets, mm; about a pixel.
    pub step_mm: f64,
}

/// Edge evidence of all segments over the offsets.
pub(crate) struct SideScan {
    /// Offset of the first step, mm.
    pub start_mm: f64,
    /// Distance of two steps, mm; about a pixel.
    pub step_mm: f64,
    steps: usize,
    /// Strength 0 to 1 per segment and step.
    strength: Vec<f32>,
}

/// An edge candidate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgeCandidate {
    /// Offset at the middle of the side, mm.
    pub offset_mm: f64,
    /// Mean strength of the segments, 0 to 1.
    pub strength: f32,
}

/// Raises the evidence of one segment to what its mean profile shows, channel by channel.
fn add_evidence(channels: &[Vec<f32>; 2], out: &mut [f32]) {
    let settings = ScanSettings::DEFAULT;
    let n = out.len();
    if n < settings.least_seen + 4 * STEP_REACH {
        return;
    }
    let mut value = Vec::with_capacity(n);
    let mut sorted = Vec::with_capacity(n);
    for (channel, tone) in channels.iter().enumerate() {
        let (before, after) = (&tone[STEP_REACH..n - 3 * STEP_REACH], &tone[3 * STEP_REACH..n - STEP_REACH]);
        value.clear();
        value.extend(after.iter().zip(before).map(|(a, b)| (a - b).abs()));
        sorted.clear();
        sorted.extend(value.iter().filter(|s| s.is_finite()));
        if sorted.len() < settings.least_seen {
            continue;
        }
        let sigma = noise_of(&mut sorted, settings.least_noise);
        if channel == 0 {
            // A thin line must be dark: the gap between two boxes.
            let beside = tone.iter().zip(&tone[4 * STEP_REACH..]);
            for ((v, here), (left, right)) in value.iter_mut().zip(&tone[2 * STEP_REACH..]).zip(beside) {
                *v = v.max(-settings.dark_line * (here - 0.5 * (left + right)));
            }
        }
        for (o, v) in out[2 * STEP_REACH..].iter_mut().zip(&value) {
            let seen = ((v / sigma - 1.0) / (settings.full_sigmas - 1.0)).clamp(0.0, 1.0);
            *o = o.max(seen); // keeps what it has where nothing is seen (NaN)
        }
    }
}

impl SideScan {
    /// Gathers the evidence of all segments.
    pub fn new(frame: &Frame, calibration: &Calibration, raster: &PlaneRaster, range: &ScanRange) -> Self {
        let ScanRange { across, from_mm, to_mm, span_mm, step_mm } = *range;
        // Less a hair: ranges are often a whole number of steps, and the last digit must not add one.
        let steps = (((to_mm - from_mm) / step_mm - 1e-6).ceil().max(0.0) as usize + 1).min(6000);
        let mut strength = vec![0f32; SEGMENTS * steps];
        let mut tones = LineTones::new(steps);
        let mut channels = [const { Vec::new() }; 2];
        let length = span_mm.1 - span_mm.0;
        // Where the scan's nodes are in the image, at a position along the side.
        let nodes_at = |t: f64| -> Vec<Option<Px>> {
            let along = span_mm.0 + length * t;
            let nodes = (0..steps + NODE_STEPS).step_by(NODE_STEPS);
            nodes.map(|k| raster.pixel(calibration, across.at(from_mm + k as f64 * step_mm, along))).collect()
        };
        let mut begin = nodes_at(0.0);
        for (segment, out) in strength.chunks_exact_mut(steps).enumerate() {
            let end = nodes_at((segment + 1) as f64 / SEGMENTS as f64);
            tones.clear();
            for (n, (from, to)) in begin.windows(2).zip(end.windows(2)).enumerate() {
                let ([Some(b), Some(b_next)], [Some(e), Some(e_next)]) = (from, to) else { continue };
                let places = n * NODE_STEPS..((n + 1) * NODE_STEPS).min(steps);
                for sample in 0..SAMPLES_A_SEGMENT {
                    // Straight between the segment's ends: what perspective changes there lies along the side.
                    let t = (sample as f64 + 0.5) / SAMPLES_A_SEGMENT as f64;
                    let between = |p: &Px, q: &Px| [p.u + (q.u - p.u) * t, p.v + (q.v - p.v) * t];
                    let ([u, v], [next_u, next_v]) = (between(b, e), between(b_next, e_next));
                    let step_px = [(next_u - u) / NODE_STEPS as f64, (next_v - v) / NODE_STEPS as f64];
                    tones.add(frame, places.clone(), Px::new(u, v), step_px);
                }
            }
            begin = end;
            for (channel, values) in channels.iter_mut().enumerate() {
                values.clear();
                values.extend(tones.means(SAMPLES_A_SEGMENT as u32 / 2 + 1).map(|t| t[channel]));
            }
            add_evidence(&channels, out);
        }
        Self { start_mm: from_mm, step_mm, steps, strength }
    }

    /// Largest strength of a straight edge through each step at the middle of the side, over all drifts from end to end.
    fn best_strengths(&self, max_drift_steps: i64) -> Vec<f32> {
        let n = self.steps;
        // An edge between two steps counts at both.
        let mut wide = vec![0f32; SEGMENTS * n];
        for (wide, row) in wide.chunks_exact_mut(n).zip(self.strength.chunks_exact(n)) {
            for (w, near) in wide[1..].iter_mut().zip(row.windows(3)) {
                *w = near[1].max(ScanSettings::DEFAULT.beside * near[0].max(near[2]));
            }
        }
        let mut best = vec![0f32; n];
        let mut sum = vec![0f32; n];
        for drift in -max_drift_steps..=max_drift_steps {
            sum.fill(0.0);
            for (segment, wide) in wide.chunks_exact(n).enumerate() {
                let t = (segment as f64 + 0.5) / SEGMENTS as f64 - 0.5;
                let shift = (drift as f64 * t + 0.5).floor() as isize;
                // Whole rows at once: sum[k] += wide[k + shift].
                let (to, from) = if shift >= 0 { (0, shift as usize) } else { (shift.unsigned_abs(), 0) };
                for (s, w) in sum.iter_mut().skip(to).zip(wide.iter().skip(from)) {
                    *s += w;
                }
            }
            for (b, s) in best.iter_mut().zip(&sum) {
                *b = b.max(s / SEGMENTS as f32);
            }
        }
        best
    }

    /// The strongest edges, at least `apart_mm` from each other, strongest first.
    pub fn candidates(
        &self,
        max_drift_mm: f64,
        apart_mm: f64,
        least: f32,
        keep: usize,
    ) -> Vec<EdgeCandidate> {
        let most_drift = ScanSettings::DEFAULT.most_drift;
        let max_drift = (max_drift_mm / self.step_mm).round().clamp(0.0, most_drift) as i64;
        // Places are halves of a step and often just so far apart: the last digit must not decide.
        let apart_mm = apart_mm - 1e-6 * self.step_mm;
        let best = self.best_strengths(max_drift);
        let mut all = Vec::new();
        for (k, strength) in best.iter().copied().enumerate() {
            if strength >= least {
                // A step is seen over all its blur and a clear one is as strong everywhere there: it lies in the middle.
                let same = |n: &&f32| **n == strength;
                let (before, after) = (
                    best[..k].iter().rev().take_while(same).count(),
                    best[k + 1..].iter().take_while(same).count(),
                );
                let middle = k as f64 + 0.5 * (after as f64 - before as f64);
                all.push(EdgeCandidate { offset_mm: self.start_mm + middle * self.step_mm, strength });
            }
        }
        all.sort_by(|a, b| b.strength.total_cmp(&a.strength));
        let mut kept: Vec<EdgeCandidate> = Vec::new();
        for candidate in all {
            if kept.len() == keep {
                break;
            }
            if kept.iter().all(|k| (k.offset_mm - candidate.offset_mm).abs() >= apart_mm) {
                kept.push(candidate);
            }
        }
        kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edges::detector_tests::{picture, rectangle};
    use crate::face::outline::{SIDES, span_mm};
    use crate::frames::Plane;
    use crate::paper_head::paper_head;
    use nalgebra::Vector3;

    const DISTANCE_MM: f64 = 350.0;

    /// Strength of the edge at the middle of a face's picture whose rounding is so wide, px, scanned so far to both sides of it.
    fn strength(width_px: f64, reach_px: f64) -> f32 {
        let calibration = paper_head(1.0);
        let plane = Plane::new(Vector3::z() / DISTANCE_MM);
        let raster =
            PlaneRaster::along(&plane, Vector3::z() * DISTANCE_MM, &Vector3::x()).expect("a direction");
        let middle = raster.pixel(&calibration, Across::A.at(0.0, 0.0)).expect("in the picture");
        let mm_per_px = raster.mm_per_px(&calibration, Across::A.at(0.0, 0.0)).expect("in the picture");
        let [width, height] = [calibration.width_px() as usize, calibration.height_px() as usize];
        let mut rgb = Vec::with_capacity(3 * width * height);
        for n in 0..width * height {
            let off = ((n % width) as f64 - middle.u) / width_px;
            // A quarter of a cylinder, brightest where it faces the light, and some noise.
            let shade = 60.0 * (std::f64::consts::PI * off.clamp(-0.5, 0.5)).sin();
            let level = 130.0 + shade + (n * 7919 % 5) as f64;
            rgb.extend([level as u8; 3]);
        }
        let frame = Frame::from_rgb(width, height, rgb).expect("the sensor's size");
        let range = ScanRange {
            across: Across::A,
            from_mm: -reach_px * mm_per_px,
            to_mm: reach_px * mm_per_px,
            span_mm: (-40.0, 40.0),
            step_mm: 0.8 * mm_per_px,
        };
        let scan = SideScan::new(&frame, &calibration, &raster, &range);
        let found = scan.candidates(8.0 * mm_per_px, 4.0 * mm_per_px, 0.0, 8);
        found.iter().filter(|e| e.offset_mm.abs() < 10.0 * mm_per_px).map(|e| e.strength).fold(0.0, f32::max)
    }

    /// Noise is what most of the range shows: a rounded edge must not fill it.
    #[test]
    fn a_rounded_edge_seen_from_near_is_as_strong_as_a_sharp_one_if_enough_is_scanned() {
        assert!(strength(3.0, 16.0) > 0.9 && strength(3.0, 64.0) > 0.9, "a sharp edge");
        assert!(strength(30.0, 64.0) > 0.9, "{}", strength(30.0, 64.0));
        assert!(strength(30.0, 16.0) < 0.3, "{}: then a shorter range would do", strength(30.0, 16.0));
    }

    #[test]
    fn the_strongest_candidate_of_a_scan_is_the_edge_to_a_pixel() {
        let calibration = paper_head(0.25);
        let truth = rectangle(&calibration);
        let frame = picture(&calibration, &truth, 180, 90);
        let (offsets, px) = (truth.offsets_mm, truth.mm_per_px);
        for (side, (across, _)) in SIDES.into_iter().enumerate() {
            let range = ScanRange {
                across,
                from_mm: offsets[side] - 20.0 * px,
                to_mm: offsets[side] + 20.0 * px,
                span_mm: span_mm(&offsets, side),
                step_mm: 0.8 * px,
            };
            let scan = SideScan::new(&frame, &calibration, &truth.raster, &range);
            let found = scan.candidates(8.0 * px, 4.0 * px, 0.2, 8);
            let off_px = (found[0].offset_mm - offsets[side]) / px;
            assert!(
                found[0].strength > 0.9 && off_px.abs() < 1.0,
                "side {side}: {off_px} px, {:?}",
                found[0]
            );
        }
    }
}
