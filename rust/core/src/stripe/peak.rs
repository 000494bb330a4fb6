//! The centre of a stripe across one profile: centre of gravity, and for comparison Steger's ridge point and a fitted bell.

use nalgebra::{Matrix3, Vector3};

/// A peak in a profile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Centre, in samples from the start of the profile.
    pub position: f64,
    /// Height above the background, in the profile's own unit.
    pub amplitude: f64,
    /// Standard deviation of `position` from the background's noise alone, samples.
    pub sigma: f64,
    /// Noise of one sample of the background, in the profile's unit.
    pub noise: f64,
}

/// How wide a stripe is taken to be and which samples are its own. Where a field gives no reason for its value, none is on record.
#[derive(Clone, Copy, Debug)]
struct PeakSettings {
    /// Speckle: the centre of one row scatters by this much, px (PHYSICS.md: 0.2 to 0.4). More makes sigmas larger.
    speckle_px: f64,
    /// ... and rows decorrelate after so many (PHYSICS.md: one to two). More makes sigmas larger.
    speckle_rows: f64,
    /// Least half width at the foot, px: optics and sensor blur set it. More takes in what lies beside narrow stripes.
    least_half_width_px: f64,
    /// Largest, px: a 3 mm beam at 0.35 m. More takes print beside a stripe for its flank.
    most_half_width_px: f64,
    /// Foot over half width at half height: 1.85 for a bell (3 sigma would be 2.55, but its foot is below 5 % there), less
    /// for a saturated stripe, where a wider window costs little. More takes in more noise.
    foot_per_half_height: f64,
    /// Samples of the background, on either hand: from one to so many half widths from the peak. They are enough to know it; farther away other
    /// things begin, and more takes these in.
    background: f64,
    /// So far from the highest sample the flat top of a saturated stripe is looked for, half widths. More joins two stripes.
    plateau: f64,
    /// Below this share of the peak a sample is background: keeps far noise out of the centre of gravity. More leaves out more of the flanks, and
    /// noise counts more.
    cut_off: f64,
    /// Steps of the window's centre; each shrinks the offset by more than half. More takes longer.
    recentre: usize,
    /// A step of it that is shorter ends them, samples. More ends them early.
    settled: f64,
}

impl PeakSettings {
    const DEFAULT: Self = Self {
        speckle_px: 0.3,
        speckle_rows: 1.5,
        least_half_width_px: 4.0,
        most_half_width_px: 18.0,
        foot_per_half_height: 1.9,
        background: 2.0,
        plateau: 1.5,
        cut_off: 0.08,
        recentre: 6,
        settled: 1e-3,
    };
}

impl Default for PeakSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Standard deviation that speckle gives the centre of a profile averaged over so many rows along the stripe, px.
#[must_use]
pub fn speckle_px(rows: f64) -> f64 {
    let PeakSettings { speckle_px, speckle_rows, .. } = PeakSettings::DEFAULT;
    speckle_px / (rows / speckle_rows).max(1.0).sqrt()
}

/// Half the width of a stripe at its foot, px, from half its width at half its height, px; 4 to 18 px.
#[must_use]
pub fn foot_half_width_px(at_half_height_px: f64) -> f64 {
    let PeakSettings { foot_per_half_height, least_half_width_px, most_half_width_px, .. } =
        PeakSettings::DEFAULT;
    (at_half_height_px * foot_per_half_height).clamp(least_half_width_px, most_half_width_px)
}

/// How the centre is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Estimator {
    /// Centre of gravity in a window that is centred on its own result.
    CentreOfGravity,
    /// Steger: zero of the first derivative of the profile smoothed by a Gaussian, where the second is most negative.
    Steger,
    /// Least squares of a Gaussian bell: height, centre, width.
    Gaussian,
}

/// Finds the highest peak within `search` samples of `expected` in a profile with a straight background.
///
/// `half_width` is half the stripe's width at its foot in samples; what lies farther than that from the peak is
/// background. Returns `None` if the profile is too short or flat.
#[must_use]
pub fn find_peak(
    profile: &[f32],
    expected: f64,
    search: f64,
    half_width: f64,
    estimator: Estimator,
) -> Option<Peak> {
    let n = profile.len();
    if n < 8 {
        return None;
    }
    let smooth = |i: usize| (profile[i - 1] + profile[i] + profile[i + 1]) / 3.0;
    let first = ((expected - search).ceil().max(1.0)) as usize;
    let last = ((expected + search).floor().min(n as f64 - 2.0)).max(0.0) as usize;
    let top = profile.get(first - 1..last + 2)?.windows(3).map(|w| w[0] + w[1] + w[2]).enumerate();
    let top = first + top.max_by(|(_, a), (_, b)| a.total_cmp(b))?.0;
    let top = middle_of_plateau(profile, top, half_width);
    let line = Background::fit(profile, top as f64, half_width)?;
    let net = |i: usize| f64::from(profile[i]) - line.at(i as f64);
    let amplitude = f64::from(smooth(top)) - line.at(top as f64);
    if amplitude <= 0.0 {
        return None;
    }
    let (position, lever) = match estimator {
        Estimator::CentreOfGravity => centre_of_gravity(net, n, top as f64, half_width, amplitude)?,
        Estimator::Steger => (steger(net, n, top, half_width)?, half_width),
        Estimator::Gaussian => (bell_centre(net, n, top, half_width, amplitude)?, half_width),
    };
    // Variance of a centre of gravity: noise^2 sum(x^2) / (sum p)^2; for a bell of this width sum p = amplitude x width.
    let samples = 2.0 * lever + 1.0;
    let sigma = line.noise * (samples * lever * lever / 3.0).sqrt() / (amplitude * half_width);
    Some(Peak { position, amplitude, sigma, noise: line.noise })
}

/// The middle of the samples above half height around `top`: the highest sample of a saturated stripe can be anywhere on
/// its flat top.
fn middle_of_plateau(profile: &[f32], top: usize, half_width: f64) -> usize {
    let reach = (PeakSettings::DEFAULT.plateau * half_width) as usize;
    let (lo, hi) = (top.saturating_sub(reach), (top + reach).min(profile.len() - 1));
    let half = 0.5 * (profile[top] + 0.5 * (profile[lo] + profile[hi]));
    let first = (lo..=top).rev().take_while(|i| profile[*i] >= half).last().unwrap_or(top);
    let last = (top..=hi).take_while(|i| profile[*i] >= half).last().unwrap_or(top);
    (first + last) / 2
}

fn centre_of_gravity(
    net: impl Fn(usize) -> f64,
    n: usize,
    top: f64,
    half_width: f64,
    amplitude: f64,
) -> Option<(f64, f64)> {
    let PeakSettings { cut_off, recentre, settled, .. } = PeakSettings::DEFAULT;
    // Sums of all samples before each, and their moments: the window's inner part at once. It may wander by its half width.
    let base = (top - 2.0 * half_width - 2.0).max(0.0) as usize;
    let n = ((top + 2.0 * half_width + 2.0) as usize).min(n);
    let mut before = Vec::with_capacity(n.saturating_sub(base) + 1);
    let (mut sum, mut moment) = (0.0, 0.0);
    before.push((sum, moment));
    let weight = |i: usize| (net(i) - cut_off * amplitude).max(0.0);
    for i in base..n {
        let weight = weight(i);
        sum += weight;
        moment += weight * i as f64;
        before.push((sum, moment));
    }
    let mut centre = top;
    for _ in 0..recentre {
        let lo = ((centre - half_width).floor().max(0.0) as usize).max(base);
        let hi = ((centre + half_width).ceil() as usize).min(n - 1);
        // The window's ends count in part, so that the result moves smoothly with the window.
        let inside = |i: usize| (half_width + 0.5 - (i as f64 - centre).abs()).clamp(0.0, 1.0);
        let first = (lo..=hi).find(|i| inside(*i) >= 1.0).unwrap_or(hi + 1);
        let last = (first..=hi).rev().find(|i| inside(*i) >= 1.0).map_or(first, |i| i + 1);
        let (to, from) = (before[last - base], before[first - base]);
        let (mut sum, mut moment) = (to.0 - from.0, to.1 - from.1);
        for i in (lo..first).chain(last..=hi) {
            let weight = weight(i) * inside(i);
            sum += weight;
            moment += weight * i as f64;
        }
        if sum <= 0.0 {
            return None;
        }
        let next = moment / sum;
        if (next - centre).abs() < settled {
            centre = next;
            break;
        }
        centre = next;
    }
    Some((centre, half_width))
}

fn steger(net: impl Fn(usize) -> f64, n: usize, top: usize, half_width: f64) -> Option<f64> {
    // Steger's rule for a bar of half width w: sigma >= w / sqrt(3); the foot is about twice the bar.
    let sigma = half_width / 2.0 / 3f64.sqrt();
    let reach = (3.0 * sigma).ceil() as isize;
    let derivative = |x: usize| {
        let (mut d1, mut d2) = (0.0, 0.0);
        for k in -reach..=reach {
            let i = (x as isize + k).clamp(0, n as isize - 1) as usize;
            let t = k as f64 / sigma;
            let g = (-0.5 * t * t).exp();
            d1 += net(i) * g * t / sigma;
            d2 += net(i) * g * (t * t - 1.0) / (sigma * sigma);
        }
        (d1, d2)
    };
    let (lo, hi) = (top.saturating_sub(half_width as usize), (top + half_width as usize).min(n - 1));
    let derivatives: Vec<(f64, f64)> = (lo..=hi).map(derivative).collect();
    // Zeros of the first derivative; the one with the strongest curvature is the ridge.
    derivatives
        .windows(2)
        .enumerate()
        .filter(|(_, d)| d[0].0 >= 0.0 && d[1].0 < 0.0)
        .map(|(i, d)| (lo as f64 + i as f64 + d[0].0 / (d[0].0 - d[1].0), d[0].1 + d[1].1))
        .filter(|(_, curvature)| *curvature < 0.0)
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(position, _)| position)
}

/// Foot of a bell over its standard deviation; half its height is reached at 1.177 of these.
const FOOT_PER_SIGMA: f64 = 1.177 * PeakSettings::DEFAULT.foot_per_half_height;
/// Gauss-Newton on three unknowns from a start within a pixel: quadratic.
const BELL_STEPS: usize = 12;

/// Centre of the bell that fits the samples within the stripe's foot best.
fn bell_centre(
    net: impl Fn(usize) -> f64,
    n: usize,
    top: usize,
    half_width: f64,
    amplitude: f64,
) -> Option<f64> {
    let reach = half_width.ceil() as usize;
    let (lo, hi) = (top.saturating_sub(reach), (top + reach).min(n - 1));
    // Height, centre, width.
    let mut bell = Vector3::new(amplitude, top as f64, half_width / FOOT_PER_SIGMA);
    for _ in 0..BELL_STEPS {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for i in lo..=hi {
            let t = (i as f64 - bell.y) / bell.z;
            let shape = (-0.5 * t * t).exp();
            let slope = bell.x * shape * t / bell.z;
            let row = Vector3::new(shape, slope, slope * t);
            normal += row * row.transpose();
            right += row * (net(i) - bell.x * shape);
        }
        let step: Vector3<f64> = normal.cholesky()?.solve(&right);
        bell += step;
        // A stripe is neither a single sample nor wider than what is looked at.
        let inside = (bell.y - top as f64).abs() <= half_width && (0.4..2.0 * half_width).contains(&bell.z);
        if !inside || bell.x <= 0.0 {
            return None;
        }
        if step.y.abs() < 1e-4 {
            break;
        }
    }
    Some(bell.y)
}

/// A straight line through the samples on both sides of a stripe.
struct Background {
    middle: f64,
    level: f64,
    slope: f64,
    noise: f64,
}

/// The first of `n` samples at or behind a place, and the first behind it.
fn at_least(place: f64, n: usize) -> usize {
    (place.ceil().max(0.0) as usize).min(n)
}

fn above(place: f64, n: usize) -> usize {
    ((place.floor() + 1.0).max(0.0) as usize).min(n)
}

impl Background {
    fn fit(profile: &[f32], centre: f64, half_width: f64) -> Option<Self> {
        let (mut count, mut sx, mut sy, mut sxx, mut sxy, mut syy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        let n = profile.len();
        let far = PeakSettings::DEFAULT.background * half_width;
        let left = at_least(centre - far, n)..at_least(centre - half_width, n);
        let right = above(centre + half_width, n)..above(centre + far, n);
        for i in left.clone().chain(right.clone()) {
            let (x, y) = (i as f64 - centre, f64::from(profile[i]));
            count += 1.0;
            sx += x;
            sy += y;
            sxx += x * x;
            sxy += x * y;
            syy += y * y;
        }
        let (left, right) = (left.len(), right.len());
        if left < 2 || right < 2 {
            return None;
        }
        let spread = sxx - sx * sx / count;
        let slope = (sxy - sx * sy / count) / spread;
        let level = (sy - slope * sx) / count;
        let rest = syy - level * sy - slope * sxy;
        let noise = (rest.max(0.0) / (count - 2.0).max(1.0)).sqrt();
        Some(Self { middle: centre, level, slope, noise })
    }

    fn at(&self, x: f64) -> f64 {
        self.level + self.slope * (x - self.middle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bell(centre: f64, width: f64, saturation: f64) -> Vec<f32> {
        (0..41)
            .map(|i| {
                let t = (f64::from(i) - centre) / width;
                (20.0 + 0.3 * f64::from(i) + (100.0 * (-0.5 * t * t).exp()).min(saturation)) as f32
            })
            .collect()
    }

    proptest! {
        #[test]
        fn all_find_the_centre_of_a_noiseless_stripe(centre in 16.0..24.0f64, saturation in 50.0..200.0f64) {
            let profile = bell(centre, 3.5, saturation);
            // Steger's parabola is flat on a saturated top that is wider than its kernel: it does less well there.
            for (estimator, limit) in
                [(Estimator::CentreOfGravity, 0.03), (Estimator::Steger, 0.1), (Estimator::Gaussian, 0.03)]
            {
                let peak = find_peak(&profile, 20.0, 8.0, 10.0, estimator).expect("there is a peak");
                prop_assert!((peak.position - centre).abs() < limit, "{estimator:?}: {} for {centre}", peak.position);
            }
        }
    }

    #[test]
    fn a_flat_or_short_profile_has_no_peak() {
        assert_eq!(find_peak(&[5.0; 41], 20.0, 8.0, 10.0, Estimator::CentreOfGravity), None);
        assert_eq!(find_peak(&[5.0; 3], 1.0, 1.0, 1.0, Estimator::Steger), None);
    }
}
