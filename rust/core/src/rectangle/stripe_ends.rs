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
use crate::scene::lit::{LightSettings, StripeWidth};
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

/// How a stripe's end is looked for at a line. Where no reason stands, there is no record of how a value was chosen.
#[derive(Clone, Copy, Debug)]
struct StripeEndSettings {
    /// The stripe is looked at from so far inside the side's line to so far beyond it, px along it. More meets print and other ends.
    inside_px: u16,
    beyond_px: u16,
    /// Fewest samples inside and beyond the step. More loses ends far inside and far beyond the line, less takes a few bright or dark samples for one.
    least_inside: usize,
    least_beyond: usize,
    /// Half width of the stripe's bright middle. More takes in its dimmer flanks, less scatters more.
    middle: StripeWidth,
    /// Where its surroundings begin. More compares with what lies on other print, less takes its own light for that of its surroundings.
    beside: StripeWidth,
    /// Surroundings are so wide, px. More averages noise away and takes in other print.
    surroundings_px: usize,
    /// An end that is farther beyond the line, px, counts only if the stripe is straight up to it: on the floor or a neighbouring face it bends away.
    /// More lets an end on a neighbouring face count unchecked.
    runs_on_px: f64,
    /// Straight: the stripe's mean place across itself is beyond the line within so many px of where it is inside. More lets ends on a
    /// neighbouring face count, less loses ends of faces that bow.
    bent_px: f64,
    /// A step counts that is this many times the scatter of single samples and leaves less than this share of the light: of ends of
    /// rendered stripes 7 in 10 do, and where two of a side do and agree, 1 in 50 of these pairs is more than 6 px off. A higher step and a
    /// lower share lose ends, the opposite takes print for them.
    least_step: f64,
    most_left: f64,
    /// Smallest scatter of a sample that is believed, grey levels. More loses ends of faint stripes.
    least_noise: f64,
    /// Blur carries a step so far beyond the end, px (rendered stripes). More makes boxes smaller.
    blur_px: f64,
    /// By how much a single end scatters, and the mean of two that agree, px (rendered stripes). More lets ends say less.
    sigma_of_one_px: f64,
    sigma_of_two_px: f64,
    /// How far two ends of a side that agree may differ, px. More takes the mean of two different things.
    agree_px: f64,
}

impl StripeEndSettings {
    const DEFAULT: Self = Self {
        inside_px: 60,
        beyond_px: 40,
        least_inside: 20,
        least_beyond: 6,
        middle: StripeWidth { share: 0.3, least_px: 1.0, most_px: 3.0 },
        beside: StripeWidth { share: 0.9, least_px: 4.0, most_px: 12.0 },
        surroundings_px: LightSettings::DEFAULT.surroundings_px as usize,
        runs_on_px: 4.0,
        bent_px: 0.7,
        least_step: 2.0,
        most_left: 0.35,
        least_noise: 0.5,
        blur_px: 0.6,
        sigma_of_one_px: 2.0,
        sigma_of_two_px: 1.2,
        agree_px: 5.0,
    };
}

impl Default for StripeEndSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What the two stripes across a side's line tell; `None` if neither ends there clearly.
pub(crate) fn find(
    frame: &Frame,
    calibration: &Calibration,
    raster: &PlaneRaster,
    offset_mm: f64,
    side: usize,
    half_width_px: f64,
) -> Option<StripeEnds> {
    let settings = &StripeEndSettings::DEFAULT;
    let look = Look { frame, calibration, raster, settings, half_width_px };
    let of_stripe = |id| look.along(offset_mm, side, id)?.end_px();
    let ends: Vec<(f64, f64)> = SIDES[side].0.stripes().into_iter().filter_map(of_stripe).collect();
    let mm_per_px = ends.iter().map(|e| e.1).sum::<f64>() / ends.len() as f64;
    let (px, sigma_px, agree) = match ends[..] {
        [(px, _)] => (px, settings.sigma_of_one_px, false),
        [(p, _), (q, _)] if (p - q).abs() < settings.agree_px => {
            (0.5 * (p + q), settings.sigma_of_two_px, true)
        }
        _ => return None,
    };
    Some(StripeEnds {
        outwards_mm: (px - settings.blur_px) * mm_per_px,
        sigma_mm: sigma_px * mm_per_px,
        agree,
        mm_per_px,
    })
}

/// A picture in which stripes are looked at.
struct Look<'a> {
    frame: &'a Frame,
    calibration: &'a Calibration,
    raster: &'a PlaneRaster,
    settings: &'a StripeEndSettings,
    half_width_px: f64,
}

/// Laser response along the line that a stripe would take on the face's plane, from inside a side to beyond it.
struct Scan<'a> {
    settings: &'a StripeEndSettings,
    /// Across the line, one row for each px along it; the side is at [`StripeEndSettings::inside_px`].
    rows: Vec<Vec<f64>>,
    /// Half widths of the bright middle and of all that is the stripe's, px.
    middle: usize,
    beside: usize,
    /// Across the side, for each px along the stripe.
    mm_per_px: f64,
}

impl<'a> Look<'a> {
    fn along(&self, offset_mm: f64, side: usize, id: LaserId) -> Option<Scan<'a>> {
        let Self { frame, calibration, raster, settings, half_width_px } = *self;
        let ((across, _), sign) = (SIDES[side], outward_sign(side));
        let at =
            |beyond_mm: f64| crossing_on_px(calibration, raster, across, offset_mm + sign * beyond_mm, id);
        let mm_per_px = at(-0.5)?.distance_px(at(0.5)?).recip();
        let px = |width: StripeWidth| width.bounded(width.share * half_width_px);
        let (middle, beside) = (px(settings.middle).round() as usize, px(settings.beside).ceil() as usize);
        let reach = (beside + settings.surroundings_px) as i32;
        // Between the rows.
        let places: Vec<Px> = (-i32::from(settings.inside_px)..=i32::from(settings.beyond_px) + 1)
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
        Some(Scan { settings, rows, middle, beside, mm_per_px })
    }
}

impl Scan<'_> {
    /// The stripe's end, px outwards from the line along the stripe, and mm across the side for each of these px.
    fn end_px(&self) -> Option<(f64, f64)> {
        let settings = self.settings;
        let light: Vec<f64> = self.rows.iter().map(|row| self.height(row)).collect();
        let (at, inside, beyond, noise) = step(&light, settings)?;
        if inside - beyond <= settings.least_step * noise.max(settings.least_noise)
            || beyond >= settings.most_left * inside
        {
            return None;
        }
        let end_px = at - f64::from(settings.inside_px);
        if end_px > settings.runs_on_px {
            // On the face's own plane it goes straight on; on the floor or a neighbouring face it bends away.
            let (line, end) = (usize::from(settings.inside_px), at as usize);
            let from = line + (end - line) / 3;
            if (self.place(&self.rows[from..end]) - self.place(&self.rows[..line])).abs() > settings.bent_px {
                return None;
            }
        }
        Some((end_px, self.mm_per_px))
    }

    /// The darker side of a row: a label or another stripe lies on one only.
    fn ground(&self, row: &[f64]) -> f64 {
        let width = self.settings.surroundings_px;
        mean(&row[..width]).min(mean(&row[row.len() - width..]))
    }

    /// Light of the bright middle over its surroundings.
    fn height(&self, row: &[f64]) -> f64 {
        let centre = row.len() / 2;
        mean(&row[centre - self.middle..=centre + self.middle]) - self.ground(row)
    }

    /// Where in the rows the stripe lies on the mean, px across.
    fn place(&self, rows: &[Vec<f64>]) -> f64 {
        let centre = self.beside + self.settings.surroundings_px;
        let weights = (centre - self.beside..=centre + self.beside).map(|k| {
            let light = rows.iter().map(|row| row[k] - self.ground(row)).sum::<f64>();
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
fn step(light: &[f64], settings: &StripeEndSettings) -> Option<(f64, f64, f64, f64)> {
    let StripeEndSettings { least_inside, least_beyond, .. } = *settings;
    let total: f64 = light.iter().sum();
    let squares: f64 = light.iter().map(|l| l * l).sum();
    let mut sum: f64 = light.iter().take(least_inside).sum();
    let mut best: Option<(f64, f64, f64, f64)> = None;
    for i in least_inside..light.len().saturating_sub(least_beyond) {
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
        let (at, inside, beyond, noise) = step(&light, &StripeEndSettings::DEFAULT).expect("long enough");
        assert!(
            (at - 41.5).abs() < 1e-9 && (inside - 10.5).abs() < 0.1 && (beyond - 1.5).abs() < 0.1,
            "{at}"
        );
        assert!((noise - 0.5).abs() < 0.05, "{noise}");
        assert!(step(&[1.0; 20], &StripeEndSettings::DEFAULT).is_none());
    }
}
