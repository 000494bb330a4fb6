//! A face as one frame shows it, in 16 numbers: four stripes and four sides, each a line of the ideal image held by two
//! points. Eight unknowns ([`FaceState`]) explain them ([`fitted`]); the other eight numbers check the lasers. What a laser
//! may do between calibrations is in [`laser_motion`]. Drift (`boxline-calib`) estimates with it, [`crate::feasibility`] predicts with it.

pub mod fitted;
pub mod laser_motion;
#[cfg(test)]
pub(crate) mod simulation;
pub mod view;

use crate::calibration::Calibration;
use crate::camera::CameraModel;
pub use crate::face::model::FaceState;
use crate::face::model::{Observation, Source};
use crate::frames::Ray;
use crate::measurement::FaceMeasurement;
use crate::statistics::{TUKEY, robust_sigma, tukey_weight};
use crate::units::{LaserId, Px};
use nalgebra::{Matrix2, Vector2};

/// A point of a line with its standard deviation across the line.
#[derive(Clone, Copy, Debug)]
pub struct LinePoint {
    /// Where it is.
    pub at: Px,
    /// Standard deviation across the line, px.
    pub sigma_px: f64,
}

/// Two points that say all that a line's many points say: where it runs and how it is turned, independent of each other.
pub type Line = [LinePoint; 2];

/// The lines of one face.
#[derive(Clone, Copy, Debug)]
pub struct FaceLines {
    /// The stripes, laser 1 first.
    pub stripes: [Line; 4],
    /// The sides in the order of [`FaceState::offsets_mm`], a along the length.
    pub sides: [Line; 4],
}

/// What averaging along a stripe does not remove (texture of the board it lies on), px, 1 sigma.
const STRIPE_SYSTEMATIC_PX: f64 = 0.05;
/// The same for a side: blur and demosaicing move edges of unequal brightness, px, 1 sigma ...
pub(crate) const SIDE_SYSTEMATIC_PX: f64 = 0.2;
/// ... and cardboard is cut and folded to half a millimetre either way, evenly spread: mm, 1 sigma.
const SIDE_SHAPE_MM: f64 = 0.29;
/// A line needs so many points: two unknowns, and a scatter that means something.
const MIN_POINTS: usize = 8;
const ITERATIONS: usize = 8;

impl FaceLines {
    /// The lines of a measured face. `None` if one of them has too few points.
    pub fn from_measurement(calibration: &Calibration, face: &FaceMeasurement) -> Option<Self> {
        let distance_mm = face.corners.iter().map(|c| c.mm.z).sum::<f64>() / 4.0;
        let side_systematic = side_systematic_px(calibration, distance_mm);
        let stripe =
            |id: LaserId| line_through(calibration, &face.stripe_points_px[id.index()], STRIPE_SYSTEMATIC_PX);
        // Of a measured face they go round, the first along the length.
        let side = |i: usize| line_through(calibration, &face.edge_points_px[i], side_systematic);
        let [l1, l2, l3, l4] = LaserId::ALL;
        Some(Self {
            stripes: [stripe(l1)?, stripe(l2)?, stripe(l3)?, stripe(l4)?],
            sides: [side(3)?, side(1)?, side(0)?, side(2)?],
        })
    }

    /// All 16 points.
    fn seen(&self, camera: &CameraModel) -> Vec<Observation> {
        let stripes = self.stripes.iter().enumerate().map(|(k, line)| (Source::Stripe(k), line));
        let sides = self.sides.iter().enumerate().map(|(k, line)| (Source::Edge(k), line));
        let points = |(source, line): (Source, &Line)| {
            line.map(|p| Observation::new(camera, source, p.at, p.sigma_px))
        };
        stripes.chain(sides).flat_map(points).collect()
    }
}

/// What does not average out along a side at this distance, px, 1 sigma.
fn side_systematic_px(calibration: &Calibration, distance_mm: f64) -> f64 {
    SIDE_SYSTEMATIC_PX.hypot(SIDE_SHAPE_MM * focal_px(calibration) / distance_mm)
}

/// Mean focal length, px.
fn focal_px(calibration: &Calibration) -> f64 {
    (calibration.camera().fx * calibration.camera().fy).sqrt()
}

/// The line through points that scatter about it, in the ideal image, robust. Its two points stand one standard deviation
/// of the positions to either side of the middle: there the fitted offsets are independent, each of variance 2 s^2 / n.
fn line_through(calibration: &Calibration, points: &[Px], systematic_px: f64) -> Option<Line> {
    if points.len() < MIN_POINTS {
        return None;
    }
    let focal_px = focal_px(calibration);
    let rays: Vec<Vector2<f64>> =
        points.iter().map(|px| calibration.camera().ray_from_px(*px).xy1.xy()).collect();
    let mut weights = vec![1.0; rays.len()];
    let mut fitted = None;
    for iteration in 0..ITERATIONS {
        let sum: f64 = weights.iter().sum();
        let middle = rays.iter().zip(&weights).fold(Vector2::zeros(), |m, (r, w)| m + r * (*w / sum));
        let mut scatter = Matrix2::zeros();
        for (r, w) in rays.iter().zip(&weights) {
            scatter += (r - middle) * (r - middle).transpose() * (*w / sum);
        }
        // The long axis of the scatter, in closed form.
        let (s, c) = (0.5 * (2.0 * scatter[(0, 1)]).atan2(scatter[(0, 0)] - scatter[(1, 1)])).sin_cos();
        let along = Vector2::new(c, s);
        let spread = along.dot(&(scatter * along));
        let across = Vector2::new(-along.y, along.x);
        let off_px: Vec<f64> = rays.iter().map(|r| across.dot(&(r - middle)) * focal_px).collect();
        let scale_px = robust_sigma(off_px.iter().copied())?.max(1e-3);
        fitted = Some((middle, along, spread.max(0.0).sqrt(), off_px.clone(), scale_px));
        for (w, r) in weights.iter_mut().zip(&off_px) {
            let t = r / scale_px;
            // The first step takes all points with bounded influence: the line may be pulled by what is to go.
            *w = if iteration == 0 { 1.0 / (1.0 + t.abs() / TUKEY) } else { tukey_weight(t) };
        }
    }
    let (middle, along, spread, off_px, scale_px) = fitted?;
    let mut places: Vec<(f64, f64)> = rays
        .iter()
        .zip(&off_px)
        .filter(|(_, off)| off.abs() < TUKEY * scale_px)
        .map(|(r, off)| (along.dot(&(r - middle)), *off))
        .collect();
    if places.len() < MIN_POINTS || spread * focal_px < MIN_POINTS as f64 {
        return None;
    }
    places.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (variance_px2, independent) = independent_points(&places);
    let sigma_px = (2.0 * variance_px2 / independent).sqrt().hypot(systematic_px);
    let point = |side: f64| {
        let at = middle + along * (spread * side);
        Some(LinePoint { at: calibration.camera().px_from_ray(&Ray::new(at.x, at.y))?, sigma_px })
    };
    Some([point(-1.0)?, point(1.0)?])
}

/// Variance of the residuals and for how many independent ones they stand: n / (1 + 2 sum of the autocorrelation up to
/// where it first vanishes).
fn independent_points(sorted: &[(f64, f64)]) -> (f64, f64) {
    let n = sorted.len();
    let variance = sorted.iter().map(|(_, r)| r * r).sum::<f64>() / n as f64;
    let mut together = 1.0;
    for lag in 1..n / 4 {
        let product = sorted.windows(lag + 1).map(|w| w[0].1 * w[lag].1).sum::<f64>() / (n - lag) as f64;
        if product <= 0.0 || variance <= 0.0 {
            break;
        }
        together += 2.0 * product / variance;
    }
    (variance, (n as f64 / together).max(2.0))
}

#[cfg(test)]
mod tests {
    use super::simulation::head;
    use super::*;
    use crate::noise::Noise;

    /// Two hundred lines of noisy points, a tenth of them far off: the two points scatter about the truth as they say.
    #[test]
    fn a_lines_two_points_scatter_as_their_sigma_says() {
        let calibration = head();
        let mut noise = Noise::new(3);
        let (mut squares, mut count) = (0.0, 0.0);
        for _ in 0..200 {
            let angle = noise.uniform() * 3.1;
            let (along, across) =
                (Vector2::new(angle.cos(), angle.sin()), Vector2::new(-angle.sin(), angle.cos()));
            let middle = Vector2::new(noise.uniform() * 0.3 - 0.15, noise.uniform() * 0.3 - 0.15);
            let points: Vec<Px> = (0..150)
                .map(|i| {
                    let off_px =
                        if noise.uniform() < 0.1 { 30.0 * noise.uniform() } else { 0.4 * noise.normal() };
                    let at = middle
                        + along * (f64::from(i) / 150.0 - 0.5) * 0.4
                        + across * (off_px / focal_px(&calibration));
                    calibration.camera().px_from_ray(&Ray::new(at.x, at.y)).expect("near the axis")
                })
                .collect();
            let line = line_through(&calibration, &points, 0.0).expect("150 points");
            for p in line {
                let ray = calibration.camera().ray_from_px(p.at).xy1.xy();
                squares += (across.dot(&(ray - middle)) * focal_px(&calibration) / p.sigma_px).powi(2);
                count += 1.0;
            }
        }
        // Tukey's loss and a tenth of the points wrong cost some efficiency; 400 points scatter by 0.07 in this ratio.
        let ratio = squares / count;
        assert!((0.7..1.4).contains(&ratio), "variance over predicted {ratio}");
    }

    #[test]
    fn neighbours_that_go_together_count_less() {
        let calibration = head();
        let mut noise = Noise::new(4);
        let mut points = |together: usize| -> Vec<Px> {
            let mut off = 0.0;
            (0..240)
                .map(|i| {
                    if i % together == 0 {
                        off = 0.4 * noise.normal();
                    }
                    Px::new(600.0 + 5.0 * i as f64, 900.0 + off)
                })
                .collect()
        };
        let sigma = |points: &[Px]| line_through(&calibration, points, 0.0).expect("a line")[0].sigma_px;
        let (alone, grouped) = (sigma(&points(1)), sigma(&points(8)));
        assert!((1.8..4.0).contains(&(grouped / alone)), "{alone} {grouped}");
    }

    #[test]
    fn points_that_are_no_line_give_none() {
        let calibration = head();
        assert!(line_through(&calibration, &[], 0.1).is_none());
        assert!(line_through(&calibration, &[Px::new(500.0, 500.0); 50], 0.1).is_none());
        assert!(line_through(&calibration, &[Px::new(f64::NAN, 1.0); 50], 0.1).is_none());
    }
}
