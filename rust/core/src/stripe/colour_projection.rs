//! In which mixture of red, green and blue a stripe stands out best. Laser response R - (G + B) / 2 does on brown cardboard; where a
//! white box or strong light drives red to its limit, green and blue carry the stripe, and on coloured ones something
//! between. Fisher's discriminant finds it: the step that the stripe makes, divided by the covariance of what lies beside.

use super::stripe_line::{ScanDirection, StripeLine};
use crate::calibration::Calibration;
use crate::image::Frame;
use crate::statistics::median;
use crate::units::Px;
use nalgebra::{Matrix3, Vector3};
use std::ops::{Range, RangeInclusive};

/// Weights of red, green and blue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ColourProjection([f32; 3]);

impl ColourProjection {
    /// `R - (G + B) / 2`.
    pub const LASER_RESPONSE: Self = Self([1.0, -0.5, -0.5]);

    /// The mixture at a pixel, grey levels; the caller stays inside the frame.
    #[inline]
    pub fn at(self, rgb: &[u8], index: usize) -> f32 {
        let p = &rgb[index * 3..index * 3 + 3];
        self.of([p[0], p[1], p[2]].map(f32::from))
    }

    /// The mixture of red, green and blue, grey levels.
    #[inline]
    pub fn of(self, [red, green, blue]: [f32; 3]) -> f32 {
        self.0[0] * red + self.0[1] * green + self.0[2] * blue
    }

    /// Weights along a direction, as long as those of laser response, so that noise keeps its size.
    fn along(direction: Vector3<f64>) -> Option<Self> {
        let w = direction.try_normalize(1e-9)? * 1.5f64.sqrt();
        w.iter().all(|x| x.is_finite()).then(|| Self([w.x as f32, w.y as f32, w.z as f32]))
    }
}

/// Settings of the measurement. Where no reason stands, there is no record of how a value was chosen.
#[derive(Clone, Debug)]
struct ProjectionSettings {
    /// The stripe's middle, px across: a stripe is 8 to 20 px wide at its foot, its place is known to 4 px here. Wider takes
    /// in its flanks and what lies beside, narrower misses a stripe that is not quite there.
    middle_px: RangeInclusive<i32>,
    /// What lies beside it, px to either side. Nearer has the stripe's own light, farther other things.
    beside_px: RangeInclusive<i32>,
    /// Noise of the mean of such a range that is always there, grey levels: JPEG's steps. More gives each colour more equal weight.
    floor: f64,
    /// What red laser light does to a camera if the picture tells nothing, grey levels: mostly red, some of it seen by green and blue. Added
    /// to what is seen: a longer one believes faint stripes' own colour less.
    laser: Vector3<f64>,
    /// Every so many rows is looked at. More is quicker and leaves short pieces with laser response.
    row_step: usize,
    /// Rows that are enough to believe the picture. More leaves short pieces with laser response.
    fewest: usize,
    /// Share of the rows, those with the least difference between both sides, that tell the noise: a letter that is crossed is none, but fine
    /// print and texture are. More takes letters for noise, less finds less noise than there is.
    quiet_share: f64,
    /// A piece on which the stripe is less than this share as high as usual lies on print for the most part, and has the usual step instead. More
    /// gives up the own colour of faint stripes, less takes that of print.
    least_step: f64,
}

impl Default for ProjectionSettings {
    fn default() -> Self {
        Self {
            middle_px: -3..=3,
            beside_px: 18..=24,
            floor: 1.0,
            laser: Vector3::new(1.0, 0.15, 0.1),
            row_step: 2,
            fewest: 24,
            quiet_share: 0.85,
            least_step: 0.35,
        }
    }
}

/// The projections of the pieces of stripes, each given as a line, a range along it and a pixel to start at.
pub(crate) fn measure_projections(
    frame: &Frame,
    calibration: &Calibration,
    pieces: &[(StripeLine, Range<f64>, Px)],
) -> Vec<ColourProjection> {
    let settings = ProjectionSettings::default();
    let seen: Vec<Crossings> =
        pieces.iter().map(|piece| crossings(frame, calibration, piece, &settings)).collect();
    let all: Vec<Vector3<f64>> = seen.iter().flat_map(|s| s.steps.iter().copied()).collect();
    let usual = median_step(&all);
    seen.iter()
        .map(|s| {
            if s.steps.len() < settings.fewest {
                return ColourProjection::LASER_RESPONSE;
            }
            let own = median_step(&s.steps);
            let step = if own.dot(&usual) < settings.least_step * usual.norm_squared() { usual } else { own };
            let noise = quiet_covariance(&s.differences, settings.quiet_share)
                + Matrix3::identity() * (settings.floor * settings.floor);
            noise
                .try_inverse()
                .and_then(|inverse| ColourProjection::along(inverse * (step + settings.laser)))
                .unwrap_or(ColourProjection::LASER_RESPONSE)
        })
        .collect()
}

/// What the rows across a piece show.
struct Crossings {
    /// Middle less the mean of both sides.
    steps: Vec<Vector3<f64>>,
    /// One side less the other.
    differences: Vec<Vector3<f64>>,
}

/// The median of each colour; light only adds.
fn median_step(steps: &[Vector3<f64>]) -> Vector3<f64> {
    Vector3::from_fn(|c, _| median(steps.iter().map(|s| s[c])).unwrap_or(0.0).max(0.0))
}

fn quiet_covariance(differences: &[Vector3<f64>], share: f64) -> Matrix3<f64> {
    let mut order: Vec<&Vector3<f64>> = differences.iter().collect();
    order.sort_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()));
    let count = ((order.len() as f64 * share) as usize).max(1);
    let sum = order.iter().take(count).fold(Matrix3::zeros(), |sum, d| sum + *d * d.transpose());
    sum / count as f64
}

fn crossings(
    frame: &Frame,
    calibration: &Calibration,
    (line, range, start): &(StripeLine, Range<f64>, Px),
    settings: &ProjectionSettings,
) -> Crossings {
    let (middle, beside) = (&settings.middle_px, &settings.beside_px);
    let left = -*beside.end()..=-*beside.start();
    let (along_stride, across_stride, along_size, across_size) = match line.scan {
        ScanDirection::Rows => (frame.width_px(), 1, frame.height_px(), frame.width_px()),
        ScanDirection::Columns => (1, frame.width_px(), frame.width_px(), frame.height_px()),
    };
    let mut other = line.scan.across(*start);
    let mut row = range.start.max(0.0).ceil() as usize;
    let mut seen = Crossings { steps: Vec::new(), differences: Vec::new() };
    while (row as f64) < range.end.min(along_size as f64) {
        let Some(place) = line.place_at(calibration, row as f64, other) else { break };
        let here = line.scan.across(place.px);
        other = here + settings.row_step as f64 * place.slope;
        let spacing = 1.0 / place.bounded_factor();
        let mean = |offsets: &RangeInclusive<i32>| -> Option<Vector3<f64>> {
            let mut sum = [0u32; 3];
            let count = f64::from(offsets.end() - offsets.start() + 1);
            for offset in offsets.clone() {
                let at = here + f64::from(offset) * spacing + 0.5;
                if !(at >= 0.0 && at < across_size as f64) {
                    return None;
                }
                let index = (row * along_stride + at as usize * across_stride) * 3;
                let p = frame.stripe_rgb().get(index..index + 3)?;
                sum = [sum[0] + u32::from(p[0]), sum[1] + u32::from(p[1]), sum[2] + u32::from(p[2])];
            }
            Some(Vector3::from(sum.map(f64::from)) / count)
        };
        if let (Some(l), Some(m), Some(r)) = (mean(&left), mean(middle), mean(beside)) {
            seen.steps.push(m - (l + r) * 0.5);
            seen.differences.push(l - r);
        }
        row += settings.row_step;
    }
    seen
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraModel;
    use crate::frames::Plane;
    use crate::units::LaserId;

    /// A frame whose background has one colour and some noise, with a stripe that adds `light`, cut off at 255.
    fn tint_on(background: [f64; 3], light: [f64; 3], common_noise: f64) -> ColourProjection {
        let camera = CameraModel {
            fx: 600.0,
            fy: 600.0,
            skew: 0.0,
            cx: 320.0,
            cy: 240.0,
            k1: 0.0,
            k2: 0.0,
            ..CameraModel::PINHOLE
        };
        let lasers = [
            [0.0079291, -0.00817394, 0.00018065, -1.0],
            [0.01078476, -0.01121147, 0.00223845, -1.0],
            [0.01037354, 0.00959161, 0.00170705, -1.0],
            [0.00799885, 0.00730513, -0.00038506, -1.0],
        ];
        let calibration = Calibration::new("test", [640, 480], camera, lasers).expect("a valid head");
        let plane = Plane::new(Vector3::new(0.0, 0.0, 1e-3));
        let line = StripeLine::new(&calibration, LaserId::ALL[2], &plane);
        assert_eq!(line.scan, ScanDirection::Rows);
        let mut random = fastrand::Rng::with_seed(1);
        let mut noise = || random.f64() - 0.5;
        let mut rgb = Vec::new();
        for y in 0..480 {
            let middle = line.px_at(&calibration, f64::from(y), 320.0).expect("on the line").0.u;
            for x in 0..640 {
                let bell = (-0.5 * ((f64::from(x) - middle) / 3.0).powi(2)).exp();
                let common = common_noise * noise();
                for c in 0..3 {
                    let value = background[c] + light[c] * bell + common + 2.0 * noise();
                    rgb.push(value.clamp(0.0, 255.0).round() as u8);
                }
            }
        }
        let frame = Frame::from_rgb(640, 480, rgb).expect("the size fits");
        let start = line.px_at(&calibration, 60.0, 320.0).expect("on the line").0;
        measure_projections(&frame, &calibration, &[(line, 60.0..420.0, start)])[0]
    }

    #[test]
    fn on_brown_cardboard_with_grey_texture_it_is_nearly_laser_response() {
        let ColourProjection([r, g, b]) = tint_on([150.0, 110.0, 80.0], [60.0, 8.0, 5.0], 40.0);
        assert!(r > 0.8 && g < -0.2 && b < -0.2, "{r} {g} {b}");
    }

    #[test]
    fn where_red_is_at_its_limit_green_and_blue_carry_the_stripe() {
        let ColourProjection([r, g, b]) = tint_on([254.0, 225.0, 215.0], [80.0, 25.0, 15.0], 0.0);
        assert!(g + b > 0.5, "{r} {g} {b}");
        let seen = 25.0 * g + 15.0 * b + r;
        assert!(seen > 25.0, "the stripe is {seen} grey levels high");
    }
}
