//! What the image shows of a rounded edge: the profile of brightness across a quarter cylinder, from rays and Lambert's law, blurred,
//! and the place of its strongest gradient. Physics alone; core's rules for it (`rectangle/sharp_edge`, `rectangle/rounding`) are not
//! used here.

use crate::rng::Rng;
use nalgebra::Vector3;

/// Light on a box, in its own axes.
#[derive(Clone, Debug)]
pub(super) struct Light {
    up: Vector3<f64>,
    /// Irradiance from above and from below.
    sky: f64,
    ground: f64,
    /// Directions to lamps, as long as their irradiance.
    lamps: Vec<Vector3<f64>>,
}

/// What one edge looks like.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    /// Outward normal of the face, and the direction out of it across the edge, in the box's axes.
    pub normal: Vector3<f64>,
    pub out: Vector3<f64>,
    /// Tangent of the angle from the face's normal to the line of sight, positive towards `out`: then the neighbouring face is
    /// in view.
    pub view_tan: f64,
    pub radius_px: f64,
    /// Blur of lens, motion and demosaicing, px.
    pub blur_px: f64,
    /// Brightness behind a silhouette over that of the face.
    pub behind: f64,
}

/// The picture of an edge.
#[derive(Clone, Debug)]
pub(super) struct EdgePicture {
    /// How far inside the sharp edge, on the face's plane and in radii, the strongest gradient appears.
    pub inside_share: f64,
    first_px: f64,
    strongest_px: f64,
    light: Vec<f64>,
}

impl EdgePicture {
    /// Brightness so far beyond the strongest gradient, px in the image.
    pub fn light(&self, beyond_px: f64) -> f64 {
        let place = (self.strongest_px + beyond_px - self.first_px) * PER_PX as f64;
        let last = self.light.len() - 1;
        let place = place.clamp(0.0, last as f64);
        let low = (place as usize).min(last - 1);
        let w = place - low as f64;
        self.light[low] * (1.0 - w) + self.light[low + 1] * w
    }
}

/// Samples a px of the profile, and steps along the rounding.
const PER_PX: usize = 8;
const STEPS: usize = 400;
/// The edge is looked for on its rounding and this far beside it, px.
const BESIDE_PX: f64 = 1.5;

impl Light {
    /// Rooms and yards: hemispheres above and below, one or two lamps above, mostly on the viewer's side. `normals` are the
    /// outward normals of the faces that are looked at; none of them is the underside.
    pub fn draw(rng: &mut Rng, normals: [Vector3<f64>; 2]) -> Self {
        let up = loop {
            let mut up = Vector3::zeros();
            up[rng.below(3)] = rng.sign();
            if normals.iter().all(|n| n.dot(&up) > -0.5) {
                break up;
            }
        };
        let towards = normals[0] + normals[1];
        let lamps = (0..1 + rng.below(2))
            .map(|_| {
                let mut to = Vector3::from_fn(|_, _| rng.normal());
                to *= if to.dot(&up) < 0.0 { -1.0 } else { 1.0 };
                if to.dot(&towards) < 0.0 && rng.chance(0.7) {
                    to -= towards * (2.0 * to.dot(&towards) / towards.norm_squared());
                }
                to.normalize() * rng.range(0.2, 1.0)
            })
            .collect();
        Self { up, sky: rng.range(0.35, 0.55), ground: rng.range(0.15, 0.3), lamps }
    }

    /// Irradiance on a surface.
    fn on(&self, normal: &Vector3<f64>) -> f64 {
        let up = 0.5 + 0.5 * self.up.dot(normal);
        self.sky * up
            + self.ground * (1.0 - up)
            + self.lamps.iter().map(|l| l.dot(normal).max(0.0)).sum::<f64>()
    }
}

impl Edge {
    pub fn picture(&self, light: &Light) -> EdgePicture {
        let view = self.view_tan.atan();
        // Across the image: out of the face, and into the box, where the slanted view shows it as well.
        let (by_out, by_depth) = (view.cos(), view.sin());
        let crease = self.view_tan > 0.0;
        // The rounding ends at the neighbouring face, or where the line of sight touches it.
        let end = if crease { std::f64::consts::FRAC_PI_2 } else { by_out.atan2(-by_depth) };
        let brightness = |turn: f64| light.on(&(self.normal * turn.cos() + self.out * turn.sin()));
        let place =
            |turn: f64| self.radius_px * ((turn.sin() - 1.0) * by_out + (1.0 - turn.cos()) * by_depth);
        let beyond = if crease { brightness(end) } else { self.behind * brightness(0.0) };
        let (first, last) = (place(0.0), place(end));
        let margin = 6.0 + 4.0 * self.blur_px;
        let samples = ((last - first + 2.0 * margin) * PER_PX as f64).ceil() as usize;
        let at = |i: usize| first - margin + i as f64 / PER_PX as f64;
        let mut step = 0;
        let sharp: Vec<f64> = (0..samples)
            .map(|i| {
                let x = at(i);
                // The rounding runs on in one direction across the image.
                while step < STEPS && place(end * step as f64 / STEPS as f64) < x {
                    step += 1;
                }
                match step {
                    _ if x >= last => beyond,
                    0 => brightness(0.0),
                    _ => brightness(end * (step as f64 - 0.5) / STEPS as f64),
                }
            })
            .collect();
        let blurred = blurred(&sharp, self.blur_px * PER_PX as f64);
        let window = (first - BESIDE_PX)..(last + BESIDE_PX);
        let mut best = (-1.0, 0.0);
        for i in PER_PX..samples.saturating_sub(PER_PX) {
            let gradient = (blurred[i + PER_PX] - blurred[i - PER_PX]).abs();
            if window.contains(&at(i)) && gradient > best.0 {
                best = (gradient, at(i));
            }
        }
        EdgePicture {
            inside_share: -best.1 / by_out / self.radius_px,
            first_px: first - margin,
            strongest_px: best.1,
            light: blurred,
        }
    }
}

/// A Gaussian blur; what lies beyond the ends goes on as it is there.
fn blurred(values: &[f64], sigma: f64) -> Vec<f64> {
    let reach = (3.5 * sigma).ceil() as isize;
    let kernel: Vec<f64> = (-reach..=reach).map(|k| (-0.5 * (k as f64 / sigma).powi(2)).exp()).collect();
    let sum: f64 = kernel.iter().sum();
    let last = values.len() as isize - 1;
    (0..=last)
        .map(|i| {
            let part = |(k, weight): (isize, &f64)| weight * values[(i + k).clamp(0, last) as usize];
            (-reach..).zip(&kernel).map(part).sum::<f64>() / sum
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edge(view_tan: f64, radius_px: f64) -> Edge {
        let (normal, out) = (-Vector3::z(), Vector3::x());
        Edge { normal, out, view_tan, radius_px, blur_px: 0.9, behind: 0.3 }
    }

    fn even() -> Light {
        Light { up: Vector3::y(), sky: 1.0, ground: 1.0, lamps: Vec::new() }
    }

    #[test]
    fn an_evenly_lit_silhouette_appears_where_the_line_of_sight_touches() {
        for tan in [0.0, -0.3, -0.6] {
            let touching = 1.0 - tan - (1.0f64 + tan * tan).sqrt();
            let found = edge(tan, 8.0).picture(&even()).inside_share;
            assert!((found - touching).abs() < 0.03, "{tan}: {found}, {touching} expected");
        }
    }

    #[test]
    fn a_crease_appears_at_the_end_of_its_rounding_where_brightness_changes_fastest() {
        let from = |lamp: Vector3<f64>| Light { up: Vector3::y(), sky: 0.1, ground: 0.1, lamps: vec![lamp] };
        // A lamp that lights the neighbour only: its light begins where the face ends, with the full slope there.
        let darker = edge(0.2, 10.0).picture(&from(Vector3::x())).inside_share;
        assert!((0.6..1.05).contains(&darker), "{darker}");
        // A lamp behind the camera lights the face: the light ends where the neighbour begins.
        let brighter = edge(0.2, 10.0).picture(&from(-Vector3::z())).inside_share;
        assert!((-0.35..0.05).contains(&brighter), "{brighter}");
    }

    #[test]
    fn over_all_light_edges_lie_inside_by_these_shares() {
        // The numbers from which core's rule comes; see `rectangle/sharp_edge`.
        let mut rng = Rng::new(1, 0);
        let (normal, out) = (-Vector3::z(), Vector3::x());
        let mut mean = |low: f64, high: f64, expected: &dyn Fn(f64) -> f64| {
            let all: Vec<f64> = (0..1500)
                .map(|_| {
                    let light = Light::draw(&mut rng, [normal, -Vector3::y()]);
                    let view_tan = rng.range(low, high);
                    let (radius_px, blur_px) = (rng.log_range(1.5, 15.0), rng.range(0.8, 1.3));
                    let behind = (0.8 * rng.normal() - 0.4).exp();
                    let edge = Edge { normal, out, view_tan, radius_px, blur_px, behind };
                    edge.picture(&light).inside_share - expected(view_tan)
                })
                .collect();
            let mean = all.iter().sum::<f64>() / all.len() as f64;
            let variance = all.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / all.len() as f64;
            (mean, variance.sqrt())
        };
        let silhouette = mean(-0.6, 0.0, &|t| 1.0 - t - (1.0 + t * t).sqrt());
        let crease = mean(0.0, 0.6, &|t| 0.29 * (1.0 - t));
        println!(
            "silhouette beyond the touching ray {silhouette:?}, crease beyond 0.29 (1 - tan) {crease:?}"
        );
        assert!((0.05..0.13).contains(&silhouette.0) && (0.15..0.3).contains(&silhouette.1));
        assert!((0.0..0.2).contains(&crease.0) && (0.3..0.5).contains(&crease.1));
    }
}
