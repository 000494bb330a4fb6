//! Whether the surface steps at a line. A box that stands flush with its neighbour is so to a millimetre or two, and no print moves a stripe:
//! where light goes on in the face's plane beyond a line, a step of the stripes there tells the seam between two boxes from print on one.

use super::lit::LightSettings;
use crate::calibration::Calibration;
use crate::face::extent::{FaceStripes, crossing_on_px};
use crate::face::outline::{SIDES, outward_sign};
use crate::face::raster::PlaneRaster;
use crate::statistics::{robust_sigma, tukey_weight};
use crate::stripe::stripe_line::StripeLine;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// How a step is measured, and how steps are spread over seams and lines of print.
#[derive(Clone, Copy, Debug)]
struct StepSettings {
    /// Centres so far from the line count, px along the stripe: from where blur is over, to before the surface bends otherwise. Farther ones
    /// hold the lines better and bow more.
    nearest_px: f64,
    farthest_px: f64,
    /// So many on either hand are needed. More says nothing of narrow neighbours.
    least_centres: usize,
    /// Rounds of the robust fit. More takes longer.
    rounds: usize,
    /// Least scatter of centres that is believed, px. More lets outliers in.
    least_scatter_px: f64,
    /// Board waves, so that a step where there is none is larger than centres scatter: so many times, and by so much, px (5,750 lines of
    /// print and the like within faces of the learning seeds: half are within 0.67 of this sigma). More lets small steps say less.
    waves: f64,
    least_sigma_px: f64,
    /// Steps between flush boxes, px, 1 sigma: of both stripes together, and of each by itself, since one box is turned a little (median of
    /// 800 sides of the learning seeds: 1.1 px). More takes small steps for none.
    step_px: f64,
    turned_px: f64,
    /// Share of seams that show no step. More lets none say less against a seam.
    seam_without: f64,
    /// Share of lines within a face that show one, as where two flaps meet. More lets a step say less for a seam.
    print_with: f64,
}

impl StepSettings {
    const DEFAULT: Self = Self {
        nearest_px: LightSettings::DEFAULT.nearest_px,
        farthest_px: 100.0,
        least_centres: 4,
        rounds: 5,
        least_scatter_px: 0.03,
        waves: 1.4,
        least_sigma_px: 0.06,
        step_px: 1.0,
        turned_px: 0.4,
        seam_without: 0.35,
        print_with: 0.03,
    };
}

impl Default for StepSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

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
    let settings = &StepSettings::DEFAULT;
    let (across, _) = SIDES[side];
    let mut steps = across.stripes().into_iter().map(|id| {
        let at = |offset_mm: f64| crossing_on_px(calibration, raster, across, offset_mm, id);
        let (line, beyond) = (at(offset_mm)?, at(offset_mm + outward_sign(side))?);
        let scan = StripeLine::new(calibration, id, &stripes.fit.plane).scan;
        let [from, to] = [line, beyond].map(|px| scan.along(px));
        // Px along the stripe, outwards, per px of the scan.
        let outwards = line.distance_px(beyond) / (to - from);
        let centres = stripes.stripes[id.index()].points.iter();
        step(centres.filter_map(|p| Some((outwards * (p.along_px - from), p.found?.residual_px))), settings)
    });
    match (steps.next().flatten(), steps.next().flatten()) {
        (Some(p), Some(q)) => seam_over_print([p, q], settings),
        _ => 0.0,
    }
}

/// Two parallel lines through the centres inside and beyond (Tukey's weights): how far apart they are. Of each centre: how far outwards of the
/// line it lies along the stripe, and from the prediction, px.
fn step(centres: impl Iterator<Item = (f64, f64)>, settings: &StepSettings) -> Option<Step> {
    let StepSettings { nearest_px, farthest_px, least_centres, least_scatter_px, .. } = *settings;
    let near = centres.filter(|(at_px, _)| (nearest_px..=farthest_px).contains(&at_px.abs()));
    let centres: Vec<(f64, f64)> =
        near.map(|(at_px, residual_px)| (at_px / farthest_px, residual_px)).collect();
    let beyond = centres.iter().filter(|(at, _)| *at > 0.0).count();
    if beyond < least_centres || centres.len() - beyond < least_centres {
        return None;
    }
    let row = |at: f64| Vector3::new(1.0, at, f64::from(u8::from(at > 0.0)));
    let mut weights = vec![1.0; centres.len()];
    let mut found = None;
    for _ in 0..settings.rounds {
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
        let scatter_px = robust_sigma(off.iter().copied())?.max(least_scatter_px);
        weights = off.iter().map(|off| tukey_weight(off / scatter_px)).collect();
        found = Some(Step { px: fitted.z, sigma_px: inverse[(2, 2)].sqrt() * scatter_px });
    }
    found.filter(|step| step.px.is_finite() && step.sigma_px.is_finite())
}

fn seam_over_print(steps: [Step; 2], settings: &StepSettings) -> f64 {
    let StepSettings { waves, least_sigma_px, step_px, turned_px, seam_without, print_with, .. } = *settings;
    let px = Vector2::from(steps.map(|step| step.px));
    let sigmas_px = steps.map(|step| waves * step.sigma_px.hypot(least_sigma_px));
    let none = Matrix2::from_diagonal(&Vector2::from(sigmas_px.map(|sigma_px| sigma_px * sigma_px)));
    let stepped = none
        + Matrix2::from_diagonal_element(turned_px * turned_px)
        + Matrix2::from_element(step_px * step_px);
    let log_density = |covariance: &Matrix2<f64>| {
        let inverse = covariance.try_inverse().unwrap_or_default();
        -0.5 * (px.dot(&(inverse * px)) + covariance.determinant().ln())
    };
    let [none, stepped] = [none, stepped].map(|covariance| log_density(&covariance));
    // So that neither is 0.
    let most = none.max(stepped);
    let [none, stepped] = [none, stepped].map(|log_density| (log_density - most).exp());
    let seam = (1.0 - seam_without) * stepped + seam_without * none;
    let print = (1.0 - print_with) * none + print_with * stepped;
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
            let found = step(centres.into_iter(), &StepSettings::DEFAULT).expect("centres on either hand");
            assert!((found.px - step_px).abs() < 4.0 * found.sigma_px, "{} px for {step_px}", found.px);
            assert!(found.sigma_px < 0.1, "{}", found.sigma_px);
        }
    }

    #[test]
    fn a_stripe_that_ends_at_the_line_says_nothing() {
        let centres = stripe(&mut Noise::new(2), 1.0);
        let near = centres.into_iter().filter(|(at, _)| *at < 30.0);
        assert!(step(near, &StepSettings::DEFAULT).is_none());
    }

    #[test]
    fn a_step_is_a_seams_and_none_is_prints() {
        let settings = StepSettings::default();
        let of = |px: [f64; 2], sigma_px| seam_over_print(px.map(|px| Step { px, sigma_px }), &settings);
        assert!(of([1.0, 1.2], 0.05) > 2.5, "a seam: {}", of([1.0, 1.2], 0.05));
        assert!(of([0.02, -0.05], 0.05) < -0.8, "print: {}", of([0.02, -0.05], 0.05));
        assert!(
            of([0.15, 0.15], 0.05) < of([0.5, 0.5], 0.05) - 1.0,
            "hardly a step: {}",
            of([0.15, 0.15], 0.05)
        );
        assert!(of([0.5, 0.5], 2.0).abs() < 0.2, "not known: {}", of([0.5, 0.5], 2.0));
        let most = ((1.0 - settings.seam_without) / settings.print_with).ln();
        assert!(of([9.0, 9.0], 0.05) <= most + 1e-9 && of([9.0, 9.0], 0.05).is_finite());
    }
}
