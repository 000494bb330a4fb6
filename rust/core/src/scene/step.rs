//! Whether the surface steps at a line. A box that stands flush with its neighbour is so to a millimetre or two, and no print moves a stripe:
//! where light goes on in the face's plane beyond a line, a step of the stripes there tells the seam between two boxes from print on one.

use crate::calibration::Calibration;
use crate::face::extent::{FaceStripes, crossing_on_px};
use crate::face::outline::{SIDES, outward_sign};
use crate::face::raster::PlaneRaster;
use crate::statistics::{robust_sigma, tukey_weight};
use crate::stripe::stripe_line::StripeLine;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Centres so far from the line count, px along the stripe: from where blur is over; and so many on either hand are needed.
const NEAREST_PX: f64 = 6.0;
const FARTHEST_PX: f64 = 100.0;
const LEAST_CENTRES: usize = 4;
/// Least scatter of centres that is believed, px.
const LEAST_SCATTER_PX: f64 = 0.03;
const ROUNDS: usize = 5;
/// Board waves, so that a step where there is none is larger than centres scatter: so many times, and by so much, px (5,750 lines of
/// print and the like within faces of the learning seeds: half are within 0.67 of this sigma).
const WAVES: f64 = 1.4;
const LEAST_SIGMA_PX: f64 = 0.06;
/// Steps between flush boxes, px, 1 sigma: of both stripes together, and of each by itself, since one box is turned a little (median of
/// 800 sides of the learning seeds: 1.1 px). Some seams show none, and some lines within a face do, as where two flaps meet: shares.
const STEP_PX: f64 = 1.0;
const TURNED_PX: f64 = 0.4;
const SEAM_WITHOUT: f64 = 0.35;
const PRINT_WITH: f64 = 0.03;

/// A step, px across the stripe, and its sigma.
#[derive(Clone, Copy)]
struct Step {
    px: f64,
    sigma_px: f64,
}

/// How much likelier what both stripes do at a line is at the seam between two boxes than on print, as a logarithm; 0 unless the light of both
/// goes on beyond it.
pub(crate) fn log_odds(
    calibration: &Calibration,
    stripes: &FaceStripes,
    raster: &PlaneRaster,
    side: usize,
    offset_mm: f64,
) -> f64 {
    let (across, _) = SIDES[side];
    let mut steps = across.stripes().into_iter().map(|id| {
        let at = |offset_mm: f64| crossing_on_px(calibration, raster, across, offset_mm, id);
        let (line, beyond) = (at(offset_mm)?, at(offset_mm + outward_sign(side))?);
        let scan = StripeLine::new(calibration, id, &stripes.fit.plane).scan;
        let [from, to] = [line, beyond].map(|px| scan.along(px));
        // Px along the stripe, outwards, per px of the scan.
        let outwards = line.distance_px(beyond) / (to - from);
        let centres = stripes.stripes[id.index()].points.iter();
        step(centres.filter_map(|p| Some((outwards * (p.along_px - from), p.found?.residual_px))))
    });
    match (steps.next().flatten(), steps.next().flatten()) {
        (Some(p), Some(q)) => seam_over_print([p, q]),
        _ => 0.0,
    }
}

/// Two parallel lines through the centres inside and beyond (Tukey's weights): how far apart they are. Of each centre: how far outwards of the
/// line it lies along the stripe, and from the prediction, px.
fn step(centres: impl Iterator<Item = (f64, f64)>) -> Option<Step> {
    let near = centres.filter(|(at_px, _)| (NEAREST_PX..=FARTHEST_PX).contains(&at_px.abs()));
    let centres: Vec<(f64, f64)> =
        near.map(|(at_px, residual_px)| (at_px / FARTHEST_PX, residual_px)).collect();
    let beyond = centres.iter().filter(|(at, _)| *at > 0.0).count();
    if beyond < LEAST_CENTRES || centres.len() - beyond < LEAST_CENTRES {
        return None;
    }
    let row = |at: f64| Vector3::new(1.0, at, f64::from(u8::from(at > 0.0)));
    let mut weights = vec![1.0; centres.len()];
    let mut found = None;
    for _ in 0..ROUNDS {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (weight, (at, residual_px)) in weights.iter().zip(&centres) {
            let row = row(*at);
            normal += row * row.transpose() * *weight;
            right += row * (*residual_px * *weight);
        }
        let inverse = normal.try_inverse()?;
        let fitted = inverse * right;
        let off: Vec<f64> =
            centres.iter().map(|(at, residual_px)| residual_px - row(*at).dot(&fitted)).collect();
        let scatter_px = robust_sigma(off.iter().copied())?.max(LEAST_SCATTER_PX);
        weights = off.iter().map(|off| tukey_weight(off / scatter_px)).collect();
        found = Some(Step { px: fitted.z, sigma_px: inverse[(2, 2)].sqrt() * scatter_px });
    }
    found.filter(|step| step.px.is_finite() && step.sigma_px.is_finite())
}

fn seam_over_print(steps: [Step; 2]) -> f64 {
    let px = Vector2::from(steps.map(|step| step.px));
    let sigmas_px = steps.map(|step| WAVES * step.sigma_px.hypot(LEAST_SIGMA_PX));
    let none = Matrix2::from_diagonal(&Vector2::from(sigmas_px.map(|sigma_px| sigma_px * sigma_px)));
    let stepped = none
        + Matrix2::from_diagonal_element(TURNED_PX * TURNED_PX)
        + Matrix2::from_element(STEP_PX * STEP_PX);
    let log_density = |covariance: &Matrix2<f64>| {
        let inverse = covariance.try_inverse().unwrap_or_default();
        -0.5 * (px.dot(&(inverse * px)) + covariance.determinant().ln())
    };
    let [none, stepped] = [none, stepped].map(|covariance| log_density(&covariance));
    // So that neither is 0.
    let most = none.max(stepped);
    let [none, stepped] = [none, stepped].map(|log_density| (log_density - most).exp());
    let seam = (1.0 - SEAM_WITHOUT) * stepped + SEAM_WITHOUT * none;
    let print = (1.0 - PRINT_WITH) * none + PRINT_WITH * stepped;
    (seam / print).ln()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::Noise;

    /// Centres every 8 px that scatter by 0.05 px on a surface that bows, and steps at the line.
    fn stripe(noise: &mut Noise, step_px: f64) -> Vec<(f64, f64)> {
        let at = (-15..=15).map(|n| 8.0 * f64::from(n));
        at.map(|at| {
            let bow_px = 1e-5 * at * at + 0.002 * at;
            (at, bow_px + if at > 0.0 { step_px } else { 0.0 } + 0.05 * noise.normal())
        })
        .collect()
    }

    #[test]
    fn a_step_is_found_to_its_sigma_whatever_a_few_centres_do() {
        let mut noise = Noise::new(1);
        for step_px in [0.0, -0.4, 1.5] {
            let mut centres = stripe(&mut noise, step_px);
            centres[12].1 += 3.0;
            centres[20].1 -= 3.0;
            let found = step(centres.into_iter()).expect("centres on either hand");
            assert!((found.px - step_px).abs() < 4.0 * found.sigma_px, "{} px for {step_px}", found.px);
            assert!(found.sigma_px < 0.1, "{}", found.sigma_px);
        }
    }

    #[test]
    fn a_stripe_that_ends_at_the_line_says_nothing() {
        let centres = stripe(&mut Noise::new(2), 1.0);
        assert!(step(centres.into_iter().filter(|(at, _)| *at < 30.0)).is_none());
    }

    #[test]
    fn a_step_is_a_seams_and_none_is_prints() {
        let of = |[p, q]: [f64; 2], sigma_px| seam_over_print([p, q].map(|px| Step { px, sigma_px }));
        assert!(of([1.0, 1.2], 0.05) > 2.5, "a seam: {}", of([1.0, 1.2], 0.05));
        assert!(of([0.02, -0.05], 0.05) < -0.8, "print: {}", of([0.02, -0.05], 0.05));
        assert!(
            of([0.15, 0.15], 0.05) < of([0.5, 0.5], 0.05) - 1.0,
            "hardly a step: {}",
            of([0.15, 0.15], 0.05)
        );
        assert!(of([0.5, 0.5], 2.0).abs() < 0.2, "not known: {}", of([0.5, 0.5], 2.0));
        let most = ((1.0 - SEAM_WITHOUT) / PRINT_WITH).ln();
        assert!(of([9.0, 9.0], 0.05) <= most + 1e-9 && of([9.0, 9.0], 0.05).is_finite());
    }
}
