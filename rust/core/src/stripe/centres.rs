//! Follows one stripe across the whole image along the line that a plane predicts, and reports at each place whether the
//! stripe is there and how far from the prediction.
//!
//! A stripe runs near a diagonal of the image, so profiles are taken along rows (or along columns if it is flatter than
//! 45 degrees): contiguous memory, no interpolation. Several neighbouring rows are added along the predicted line into one
//! profile; faint light takes more of them.

use super::colour_projection::ColourProjection;
use super::peak::{Estimator, find_peak, foot_half_width_px, speckle_px};
use super::stripe_line::{OnLine, ScanDirection, StripeLine};
use crate::calibration::Calibration;
use crate::image::Frame;
use crate::units::Px;

/// One place along a stripe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StripePoint {
    /// Row (or column) of the middle of the block: position along the stripe, px.
    pub along_px: f64,
    /// Where the plane predicts the stripe.
    pub predicted: Px,
    /// The peak that was found there, if any.
    pub found: Option<StripeCentre>,
    /// Noise of one sample of the averaged profile, grey levels; tells whether a stripe could have been seen.
    pub noise: f64,
}

impl StripePoint {
    /// The same place as another plane predicts it, which does not change the peak; `None` if that is too far to know.
    fn predicted_anew(&self, scan: ScanDirection, place: &OnLine, settings: &CentreSettings) -> Option<Self> {
        let across = scan.across(place.px);
        if (across - scan.across(self.predicted)).abs() * place.factor > settings.same_px {
            return None;
        }
        let found = self.found.map(|found| StripeCentre {
            residual_px: (scan.across(found.at) - across) * place.factor,
            ..found
        });
        // As a look at it would have it.
        let found = found.filter(|found| found.residual_px.abs() <= settings.search_px + 1.0);
        Some(Self { predicted: place.px, found, ..*self })
    }
}

/// A peak near the predicted place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StripeCentre {
    /// Centre on the sensor.
    pub at: Px,
    /// Distance from the prediction across the stripe, px, signed.
    pub residual_px: f64,
    /// Standard deviation of the centre across the stripe, px.
    pub sigma_px: f64,
    /// Height over the background, grey levels of laser response.
    pub amplitude: f64,
}

/// How to follow a stripe. Where no reason stands, there is no record of how a value was chosen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CentreSettings {
    /// Rows per profile. More see fainter light and blur the ends of the stripe.
    pub rows: usize,
    /// Largest distance from the prediction across the stripe, px. More finds a worse prediction and more wrong peaks.
    pub search_px: f64,
    /// Smallest peak over noise of the averaged profile. Less finds fainter light and more wrong peaks.
    pub min_signal_to_noise: f64,
    /// Half the width of the stripe at its foot across it, px. Less cuts the stripe, more takes in what lies beside it.
    pub half_width_px: f64,
    /// In which mixture of colours: [`measure_projections`](super::colour_projection::measure_projections) finds the one in which the stripe
    /// stands out.
    pub projection: ColourProjection,
    /// How the centre is found (`decisions/0003-stripe-centre.md`).
    pub estimator: Estimator,
    /// Across how much each profile is averaged before a peak is looked for, px; 0 for none. More finds fainter light (a stripe
    /// is then judged by all of its width) and blurs a clear one.
    pub smooth_px: f64,
    /// A peak below this many grey levels of laser response is no stripe whatever the noise: JPEG steps are of that size. Less finds such steps.
    pub min_amplitude: f64,
    /// ... where profiles are smoothed, of which more than a hundred rows are added, which leaves little of such steps.
    pub min_smooth_amplitude: f64,
    /// Predictions that differ by less than this find the same peak, px. More is quicker and less exact.
    pub same_px: f64,
}

impl CentreSettings {
    pub const DEFAULT: Self = Self {
        rows: 4,
        search_px: 8.0,
        min_signal_to_noise: 4.0,
        half_width_px: 10.0,
        projection: ColourProjection::LASER_RESPONSE,
        estimator: Estimator::CentreOfGravity,
        smooth_px: 0.0,
        min_amplitude: 2.0,
        min_smooth_amplitude: 0.8,
        same_px: 0.25,
    };
}

impl Default for CentreSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Sums of so many rows of bytes fit 16 bits.
const MOST_ROWS: usize = 257;

/// Follows the stripe of laser `id` on `plane` from `from_px` to `to_px` along its walk (both inside the image), starting
/// at a pixel of it. Points come in order of `along_px`.
pub(crate) fn find_centres(
    frame: &Frame,
    calibration: &Calibration,
    line: &StripeLine,
    range_px: std::ops::Range<f64>,
    start: Px,
    settings: &CentreSettings,
) -> Vec<StripePoint> {
    find_centres_again(frame, calibration, line, range_px, start, settings, &[])
}

/// As [`find_centres`]; places of an earlier look on another plane along the same walk, `seen`, are not looked at again if their prediction
/// has hardly moved.
pub(crate) fn find_centres_again(
    frame: &Frame,
    calibration: &Calibration,
    line: &StripeLine,
    range_px: std::ops::Range<f64>,
    start: Px,
    settings: &CentreSettings,
    mut seen: &[StripePoint],
) -> Vec<StripePoint> {
    let (along_size, across_size) = match line.scan {
        ScanDirection::Rows => (frame.height_px(), frame.width_px()),
        ScanDirection::Columns => (frame.width_px(), frame.height_px()),
    };
    let first = range_px.start.max(0.0).ceil() as usize;
    let last = (range_px.end.min(along_size as f64)).max(0.0).floor() as usize;
    // The curve bends so little that Newton reaches it from a straight guess.
    let Some(begin) = line.place_at(calibration, first as f64, line.scan.across(start)) else {
        return Vec::new();
    };
    let half = ((2.0 * settings.half_width_px + settings.search_px) / begin.bounded_factor()).ceil() as usize;
    let mut profile = vec![0f32; 2 * half + 1];
    let mut sums = vec![0u16; 3 * profile.len()];
    let mut begins = Vec::new();
    let mut points = Vec::with_capacity((last.saturating_sub(first)) / settings.rows.max(1) + 1);
    let rows = settings.rows.clamp(1, MOST_ROWS);
    let mut row = first;
    let mut before = (first as f64, begin);
    while row + rows <= last {
        let middle = row as f64 + 0.5 * (rows as f64 - 1.0);
        let guess = line.scan.across(before.1.px) + before.1.slope * (middle - before.0);
        let Some(place) = line.place_at(calibration, middle, guess) else { break };
        before = (middle, place);
        let (predicted, factor) = (place.px, place.factor);
        while let [point, rest @ ..] = seen
            && point.along_px < middle
        {
            seen = rest;
        }
        if let Some(point) = seen.first().filter(|point| point.along_px == middle)
            && let Some(point) = point.predicted_anew(line.scan, &place, settings)
        {
            points.push(point);
            row += rows;
            continue;
        }
        begins.clear();
        let mut rest = 0.0;
        for r in row..row + rows {
            // Straight within a block: distortion bends 64 rows by a hundredth of a pixel.
            let other = line.scan.across(predicted) + place.slope * (r as f64 - middle);
            if other >= half as f64 && other + half as f64 + 1.0 < across_size as f64 {
                let base = (other + 0.5) as usize;
                begins.push(base - half);
                rest += other - base as f64;
            }
        }
        let first_row = row;
        row += rows;
        if begins.len() < rows {
            continue; // the window leaves the image here
        }
        sums.fill(0);
        add_profiles(&mut sums, frame, line.scan, first_row, &begins);
        let scale = 1.0 / rows as f32;
        for (p, sum) in profile.iter_mut().zip(sums.chunks_exact(3)) {
            *p = settings.projection.of([sum[0], sum[1], sum[2]].map(f32::from)) * scale;
        }
        let expected = half as f64 + rest / rows as f64;
        let beside = (settings.smooth_px / factor).round() as usize;
        smooth(&mut profile, beside);
        // Smoothed noise goes together over so many samples.
        let together = ((2 * beside + 1) as f64).sqrt();
        let least = if beside > 0 { settings.min_smooth_amplitude } else { settings.min_amplitude };
        let found = find_peak(
            &profile,
            expected,
            settings.search_px / factor,
            settings.half_width_px / factor,
            settings.estimator,
        );
        let noise = found.map_or(0.0, |p| p.noise);
        let found = found
            .filter(|p| {
                p.amplitude > least
                    && p.amplitude > settings.min_signal_to_noise * p.noise
                    && (p.position - expected).abs() * factor <= settings.search_px + 1.0
            })
            .map(|p| {
                let shift = p.position - expected;
                let at = match line.scan {
                    ScanDirection::Rows => Px::new(predicted.u + shift, predicted.v),
                    ScanDirection::Columns => Px::new(predicted.u, predicted.v + shift),
                };
                let speckle = speckle_px(rows as f64);
                StripeCentre {
                    at,
                    residual_px: shift * factor,
                    sigma_px: (p.sigma * together * factor).hypot(speckle),
                    amplitude: p.amplitude,
                }
            });
        points.push(StripePoint { along_px: middle, predicted, found, noise });
    }
    points
}

/// Adds up the colours of the profiles of neighbouring rows (or columns) of the walk from `first` on, three sums a pixel; `begins`
/// are their first places.
///
/// Colours are added first and mixed once: whole rows of bytes at once.
fn add_profiles(sums: &mut [u16], frame: &Frame, scan: ScanDirection, first: usize, begins: &[usize]) {
    let (rgb, width) = (frame.stripe_rgb(), frame.width_px());
    let add = |sums: &mut [u16], bytes: &[u8]| {
        for (sum, byte) in sums.iter_mut().zip(bytes) {
            *sum = sum.wrapping_add(u16::from(*byte)); // MOST_ROWS fit
        }
    };
    match scan {
        ScanDirection::Rows => {
            for (row, begin) in begins.iter().enumerate() {
                add(sums, &rgb[((first + row) * width + begin) * 3..]);
            }
        }
        ScanDirection::Columns => {
            // The first pixels of the rows from there on.
            for (column, begin) in begins.iter().enumerate() {
                let pixels = rgb[(begin * width + first + column) * 3..].chunks(width * 3);
                for (sum, pixel) in sums.chunks_exact_mut(3).zip(pixels) {
                    add(sum, &pixel[..3]);
                }
            }
        }
    }
}

/// Averages each sample with so many on either side; the ends keep what they have.
fn smooth(profile: &mut [f32], beside: usize) {
    if beside == 0 {
        return;
    }
    let sharp = profile.to_vec();
    for (p, window) in profile[beside..].iter_mut().zip(sharp.windows(2 * beside + 1)) {
        *p = window.iter().sum::<f32>() / window.len() as f32;
    }
}

/// Offsets across the stripe that the mean profile covers, px: more than twice the widest stripe's foot.
const PROFILE_PX: usize = 36;

/// Half the width of the stripes at their foot, px across, from the mean profile along all given pieces, each in its tint.
pub(crate) fn measure_half_width_px(
    frame: &Frame,
    calibration: &Calibration,
    pieces: &[(StripeLine, std::ops::Range<f64>, Px)],
    projections: &[ColourProjection],
) -> Option<f64> {
    const N: usize = 2 * PROFILE_PX + 1;
    /// Every so many rows is looked at.
    const ROW_STEP: usize = 2;
    let mut sum = [0f64; N];
    let mut count = 0.0;
    for ((line, range, start), projection) in pieces.iter().zip(projections) {
        let (along_stride, across_stride, along_size, across_size) = match line.scan {
            ScanDirection::Rows => (frame.width_px(), 1, frame.height_px(), frame.width_px()),
            ScanDirection::Columns => (1, frame.width_px(), frame.width_px(), frame.height_px()),
        };
        let mut other = line.scan.across(*start);
        let mut row = range.start.max(0.0).ceil() as usize;
        let mut colours = [[0u32; 3]; N];
        while (row as f64) < range.end.min(along_size as f64) {
            let Some(place) = line.place_at(calibration, row as f64, other) else { break };
            let here = line.scan.across(place.px);
            other = here + ROW_STEP as f64 * place.slope;
            let spacing = 1.0 / place.bounded_factor();
            let reach = PROFILE_PX as f64 * spacing;
            if here > reach && here + reach + 1.0 < across_size as f64 {
                for (k, s) in colours.iter_mut().enumerate() {
                    let at = (here - reach + k as f64 * spacing + 0.5) as usize;
                    let p = &frame.stripe_rgb()[(row * along_stride + at * across_stride) * 3..][..3];
                    *s = [s[0] + u32::from(p[0]), s[1] + u32::from(p[1]), s[2] + u32::from(p[2])];
                }
                count += 1.0;
            }
            row += ROW_STEP;
        }
        for (s, colours) in sum.iter_mut().zip(colours) {
            *s += f64::from(projection.of(colours.map(|c| c as f32)));
        }
    }
    if count < 16.0 {
        return None;
    }
    // The profile is made even: a slope of the background drops out.
    let even: Vec<f64> =
        (0..=PROFILE_PX).map(|d| (sum[PROFILE_PX - d] + sum[PROFILE_PX + d]) / (2.0 * count)).collect();
    let outer = &even[PROFILE_PX - 8..];
    let level = outer.iter().sum::<f64>() / outer.len() as f64;
    let top = even[..3].iter().copied().fold(f64::NEG_INFINITY, f64::max) - level;
    if top <= 0.0 {
        return None;
    }
    let below = even.iter().position(|y| y - level < 0.5 * top)?;
    Some(foot_half_width_px(below as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::{Cam, Plane};
    use crate::paper_head::paper_head;
    use crate::units::LaserId;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    const WIDTH: usize = 648;
    const HEIGHT: usize = 486;

    /// A grey frame with the stripe of one laser on a plane, dark between two rows.
    fn stripe_frame(
        calibration: &Calibration,
        plane: &Plane<Cam>,
        id: LaserId,
        width_px: f64,
        dark_rows: std::ops::Range<usize>,
    ) -> Frame {
        let line = plane.per_mm - calibration.laser(id).per_mm;
        let mut rgb = vec![40u8; WIDTH * HEIGHT * 3];
        for (i, pixel) in rgb.chunks_exact_mut(3).enumerate() {
            if dark_rows.contains(&(i / WIDTH)) {
                continue;
            }
            let at = Px::new((i % WIDTH) as f64, (i / WIDTH) as f64);
            let (ray, jacobian) = calibration.camera().ray_from_px_with_jacobian(at);
            let distance_px = line.dot(&ray.xy1) / (jacobian.transpose() * line.xy()).norm();
            pixel[0] = (40.0 + 150.0 * (-0.5 * (distance_px / width_px).powi(2)).exp()).round() as u8;
        }
        Frame::from_rgb(WIDTH, HEIGHT, rgb).expect("the size fits")
    }

    fn settings(rows: usize, width_px: f64, estimator: Estimator) -> CentreSettings {
        CentreSettings {
            rows,
            search_px: 5.0,
            min_signal_to_noise: 3.0,
            half_width_px: 3.0 * width_px,
            estimator,
            ..CentreSettings::default()
        }
    }

    fn whole(
        calibration: &Calibration,
        plane: &Plane<Cam>,
        id: LaserId,
    ) -> (StripeLine, std::ops::Range<f64>, Px) {
        let line = StripeLine::new(calibration, id, plane);
        let size = match line.scan {
            ScanDirection::Rows => HEIGHT,
            ScanDirection::Columns => WIDTH,
        } as f64;
        let (start, _) = line.px_at(calibration, 0.0, 300.0).expect("the line crosses the image");
        (line, 0.0..size, start)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn a_clean_stripe_is_found_where_its_laser_meets_the_plane(
            laser in 1..=4u8, x in -0.3..0.3, y in -0.3..0.3, depth_mm in 700.0..2000.0, width_px in 1.5..4.0,
            rows in prop::sample::select(vec![1usize, 4, 16])
        ) {
            let calibration = paper_head(0.25);
            let id = LaserId::new(laser).expect("1 to 4");
            let plane = Plane::new(Vector3::new(x, y, 1.0) / depth_mm);
            let frame = stripe_frame(&calibration, &plane, id, width_px, 0..0);
            let (line, range, start) = whole(&calibration, &plane, id);
            for estimator in [Estimator::CentreOfGravity, Estimator::Steger] {
                let settings = settings(rows, width_px, estimator);
                let points = find_centres(&frame, &calibration, &line, range.clone(), start, &settings);
                prop_assert!(points.len() > 300 / rows, "{} points", points.len());
                for p in &points {
                    let found = p.found.expect("nothing hides it");
                    prop_assert!(found.residual_px.abs() < 0.1, "{estimator:?}: {} px off", found.residual_px);
                    prop_assert!(found.sigma_px > 0.0 && found.sigma_px < 0.5, "sigma {}", found.sigma_px);
                }
                prop_assert!(points.windows(2).all(|p| p[0].along_px < p[1].along_px));
            }
        }
    }

    #[test]
    fn a_shadow_is_a_gap() {
        let calibration = paper_head(0.25);
        let plane = Plane::new(Vector3::new(0.1, 0.1, 1.0) / 1000.0);
        for id in LaserId::ALL {
            let frame = stripe_frame(&calibration, &plane, id, 2.5, 200..260);
            let (line, range, start) = whole(&calibration, &plane, id);
            let settings = settings(4, 2.5, Estimator::CentreOfGravity);
            for p in find_centres(&frame, &calibration, &line, range, start, &settings) {
                let v = p.predicted.v;
                if (212.0..248.0).contains(&v) {
                    assert!(p.found.is_none(), "stripe {id} found in the dark at {:?}", p.predicted);
                } else if !(185.0..275.0).contains(&v) {
                    assert!(p.found.is_some(), "stripe {id} lost at {:?}", p.predicted);
                }
            }
        }
    }

    #[test]
    fn the_width_of_a_stripe_is_measured() {
        let calibration = paper_head(0.25);
        let plane = Plane::new(Vector3::new(0.1, 0.1, 1.0) / 1000.0);
        for width_px in [2.5, 4.0, 6.0] {
            let pieces = LaserId::ALL.map(|id| whole(&calibration, &plane, id));
            for (id, piece) in LaserId::ALL.into_iter().zip(pieces) {
                let frame = stripe_frame(&calibration, &plane, id, width_px, 0..0);
                let half = measure_half_width_px(
                    &frame,
                    &calibration,
                    &[piece],
                    &[ColourProjection::LASER_RESPONSE],
                )
                .expect("a stripe");
                // The foot of a bell, where it has fallen to 5 to 20 %: 1.8 to 2.5 widths from its middle.
                assert!(
                    (1.7 * width_px..3.0 * width_px).contains(&half),
                    "stripe {id}: {half} for {width_px}"
                );
            }
        }
    }

    #[test]
    fn nothing_is_found_where_nothing_is() {
        let calibration = paper_head(0.25);
        let plane = Plane::new(Vector3::new(0.1, 0.1, 1.0) / 1000.0);
        let frame = Frame::from_rgb(WIDTH, HEIGHT, vec![90; WIDTH * HEIGHT * 3]).expect("the size fits");
        for id in LaserId::ALL {
            let (line, range, start) = whole(&calibration, &plane, id);
            let settings = settings(4, 2.5, Estimator::CentreOfGravity);
            let points = find_centres(&frame, &calibration, &line, range.clone(), start, &settings);
            assert!(points.iter().all(|p| p.found.is_none()));
            assert_eq!(
                measure_half_width_px(
                    &frame,
                    &calibration,
                    &[(line, range, start)],
                    &[ColourProjection::LASER_RESPONSE]
                ),
                None
            );
        }
    }
}
