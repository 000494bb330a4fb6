//! Where the four stripes leave the face at its sides: eight places (the paper's D1 to D8) that owe nothing to edges in the picture.
//! Behind the sharp edge the light falls on another surface and therefore elsewhere in the picture, so along the line that the
//! face's plane predicts a stripe ends in a step. Two such steps a side tell an edge from print beside it, and near the head they
//! place it better than shading does.

use crate::calibration::Calibration;
use crate::edges::laser_response;
use crate::face::extent::crossing_on_px;
use crate::face::outline::{SIDES, outward_sign};
use crate::face::raster::PlaneRaster;
use crate::image::Frame;
use crate::scene::lit;
use crate::units::{LaserId, Px};

/// Where the stripes of a side end, outwards from the line; that is where the line of sight touches the box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StripeEnds {
    pub outwards_mm: f64,
    pub sigma_mm: f64,
    /// Both stripes show it, at the same place.
    pub agree: bool,
    pub mm_per_px: f64,
}

/// The stripe is looked at from so far inside the side's line to so far beyond it, px along it.
const LINE: usize = 60;
const BEYOND_PX: i32 = 40;
/// A stripe that runs on so far beyond the line must do so straight: within so many px of where it was inside.
const RUNS_ON_PX: f64 = 4.0;
const BENT_PX: f64 = 0.7;
/// Fewest samples on either side of the step.
const LEAST_INSIDE: usize = 20;
const LEAST_BEYOND: usize = 6;
/// Half width of a stripe's bright middle and where its surroundings begin, in half widths of its foot; bounds in px.
const MIDDLE: (f64, f64, f64) = (0.3, 1.0, 3.0);
const BESIDE: (f64, f64, f64) = (0.9, 4.0, 12.0);
/// Surroundings are as wide as where the stripes' light is looked at, px.
const BESIDE_PX: usize = lit::BESIDE_PX as usize;
/// A step counts that is this many times the scatter of single samples and leaves less than this share of the light: of ends of
/// rendered stripes 7 in 10 do, and where two of a side do and agree, 1 in 50 of these pairs is more than 6 px off.
const LEAST_STEP: f64 = 2.0;
const MOST_LEFT: f64 = 0.35;
/// Smallest scatter of a sample that is believed, grey levels.
const LEAST_NOISE: f64 = 0.5;
/// Blur carries a step so far beyond the end, px, and it scatters by so much: a single one, the mean of two that agree (rendered
/// stripes).
const BLUR_PX: f64 = 0.6;
const SIGMA_OF_ONE_PX: f64 = 2.0;
const SIGMA_OF_TWO_PX: f64 = 1.2;
/// How far two ends of a side that agree may differ, px.
const AGREE_PX: f64 = 5.0;

/// What the two stripes across a side's line tell; `None` if neither ends there clearly.
pub(crate) fn find(
    frame: &Frame,
    calibration: &Calibration,
    raster: &PlaneRaster,
    offset_mm: f64,
    side: usize,
    half_width_px: f64,
) -> Option<StripeEnds> {
    let ends: Vec<(f64, f64)> = SIDES[side]
        .0
        .stripes()
        .into_iter()
        .filter_map(|id| {
            end_px(&ScanDirection::new(frame, calibration, raster, offset_mm, side, id, half_width_px)?)
        })
        .collect();
    let mm_per_px = ends.iter().map(|e| e.1).sum::<f64>() / ends.len() as f64;
    let (px, sigma_px, agree) = match ends[..] {
        [(px, _)] => (px, SIGMA_OF_ONE_PX, false),
        [(p, _), (q, _)] if (p - q).abs() < AGREE_PX => (0.5 * (p + q), SIGMA_OF_TWO_PX, true),
        _ => return None,
    };
    Some(StripeEnds {
        outwards_mm: (px - BLUR_PX) * mm_per_px,
        sigma_mm: sigma_px * mm_per_px,
        agree,
        mm_per_px,
    })
}

/// The end of one stripe, px outwards from the line along the stripe, and mm across the side for each of these px.
fn end_px(scan: &ScanDirection) -> Option<(f64, f64)> {
    let light: Vec<f64> = scan.rows.iter().map(|row| scan.height(row)).collect();
    let (at, inside, beyond, noise) = step(&light)?;
    if inside - beyond <= LEAST_STEP * noise.max(LEAST_NOISE) || beyond >= MOST_LEFT * inside {
        return None;
    }
    let end_px = at - LINE as f64;
    if end_px > RUNS_ON_PX {
        // On the face's own plane it goes straight on; on the floor or a neighbouring face it bends away.
        let end = at as usize;
        let from = LINE + (end - LINE) / 3;
        if (scan.place(&scan.rows[from..end]) - scan.place(&scan.rows[..LINE])).abs() > BENT_PX {
            return None;
        }
    }
    Some((end_px, scan.mm_per_px))
}

/// Laser response along the line that a stripe would take on the face's plane, from inside a side to beyond it.
struct ScanDirection {
    /// Across the line, one row for each px along it; the side is at [`LINE`].
    rows: Vec<Vec<f64>>,
    /// Half widths of the bright middle and of all that is the stripe's, px.
    middle: usize,
    beside: usize,
    /// Across the side, for each px along the stripe.
    mm_per_px: f64,
}

impl ScanDirection {
    fn new(
        frame: &Frame,
        calibration: &Calibration,
        raster: &PlaneRaster,
        offset_mm: f64,
        side: usize,
        id: LaserId,
        half_width_px: f64,
    ) -> Option<Self> {
        let ((across, _), sign) = (SIDES[side], outward_sign(side));
        let at =
            |beyond_mm: f64| crossing_on_px(calibration, raster, across, offset_mm + sign * beyond_mm, id);
        let mm_per_px = at(-0.5)?.distance_px(at(0.5)?).recip();
        let bound = |(share, low, high): (f64, f64, f64)| (share * half_width_px).clamp(low, high);
        let (middle, beside) = (bound(MIDDLE).round() as usize, bound(BESIDE).ceil() as usize);
        let reach = (beside + BESIDE_PX) as i32;
        // Between the rows.
        let places: Vec<Px> = (-(LINE as i32)..=BEYOND_PX + 1)
            .map(|px| at((f64::from(px) - 0.5) * mm_per_px))
            .collect::<Option<_>>()?;
        let row = |between: &[Px]| {
            let (p, q) = (between.first()?, between.last()?);
            let length = p.distance_px(*q).max(1e-9);
            let (du, dv) = ((p.v - q.v) / length, (q.u - p.u) / length);
            let (u, v) = (0.5 * (p.u + q.u), 0.5 * (p.v + q.v));
            let laser_response =
                |k: i32| laser_response(frame, u + du * f64::from(k), v + dv * f64::from(k)).map(f64::from);
            (-reach..=reach).map(laser_response).collect::<Option<Vec<f64>>>()
        };
        let rows = places.windows(2).map(row).collect::<Option<_>>()?;
        Some(Self { rows, middle, beside, mm_per_px })
    }

    /// The darker side of a row: a label or another stripe lies on one only.
    fn ground(row: &[f64]) -> f64 {
        mean(&row[..BESIDE_PX]).min(mean(&row[row.len() - BESIDE_PX..]))
    }

    /// Light of the bright middle over its surroundings.
    fn height(&self, row: &[f64]) -> f64 {
        let centre = row.len() / 2;
        mean(&row[centre - self.middle..=centre + self.middle]) - Self::ground(row)
    }

    /// Where in the rows the stripe lies on the mean, px across.
    fn place(&self, rows: &[Vec<f64>]) -> f64 {
        let centre = self.beside + BESIDE_PX;
        let weights = (centre - self.beside..=centre + self.beside).map(|k| {
            let light = rows.iter().map(|row| row[k] - Self::ground(row)).sum::<f64>();
            (k as f64 - centre as f64, light.max(0.0))
        });
        let (sum, moment) = weights.fold((0.0, 0.0), |(s, m), (k, w)| (s + w, m + w * k));
        moment / sum.max(1e-9)
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The best step in a row of samples: its place (between samples), the levels on both sides, the scatter about them.
fn step(light: &[f64]) -> Option<(f64, f64, f64, f64)> {
    let total: f64 = light.iter().sum();
    let squares: f64 = light.iter().map(|l| l * l).sum();
    let mut sum: f64 = light.iter().take(LEAST_INSIDE).sum();
    let mut best: Option<(f64, f64, f64, f64)> = None;
    for i in LEAST_INSIDE..light.len().saturating_sub(LEAST_BEYOND) {
        let (n, m) = (i as f64, (light.len() - i) as f64);
        let rest = squares - sum * sum / n - (total - sum).powi(2) / m;
        if best.is_none_or(|(least, ..)| rest < least) {
            best = Some((rest, i as f64 - 0.5, sum / n, (total - sum) / m));
        }
        sum += light[i];
    }
    let (rest, at, inside, beyond) = best?;
    Some((at, inside, beyond, (rest / light.len() as f64).max(0.0).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_found_between_its_samples() {
        let light: Vec<f64> = (0..60).map(|i| if i < 42 { 10.0 } else { 1.0 } + f64::from(i % 2)).collect();
        let (at, inside, beyond, noise) = step(&light).expect("long enough");
        assert!(
            (at - 41.5).abs() < 1e-9 && (inside - 10.5).abs() < 0.1 && (beyond - 1.5).abs() < 0.1,
            "{at}"
        );
        assert!((noise - 0.5).abs() < 0.05, "{noise}");
        assert!(step(&[1.0; 20]).is_none());
    }
}
