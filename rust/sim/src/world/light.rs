//! Lamps, sky and lasers' strength: the light of a scene, in units in which 1 is a well lit white surface.

use crate::rng::Rng;
use crate::vec3::{V3, v3};
use nalgebra::Vector3;

/// A lamp, a window or the sun.
#[derive(Clone, Copy, Debug)]
pub struct Lamp {
    /// Where, mm in the world.
    pub at_mm: Vector3<f64>,
    /// Tangent of its half opening seen from the scene: softness of its shadows.
    pub width: f32,
    /// Irradiance on a surface that faces it at the scene's middle.
    pub power: V3,
}

/// All light of a scene.
#[derive(Clone, Debug)]
pub struct Lighting {
    /// office, warehouse, dim, mixed or sun.
    pub ambient: &'static str,
    /// Lamps that cast shadows.
    pub lamps: Vec<Lamp>,
    /// Diffuse irradiance from above.
    pub sky: V3,
    /// Diffuse irradiance from below.
    pub ground: V3,
    /// What is seen where there is nothing.
    pub backdrop: V3,
    /// Peak irradiance of a laser of power 1 at 1 m, over the ambient's on the target.
    pub laser_to_ambient: f64,
    /// Noise: standard deviation of one sensor pixel at full scale.
    pub noise: f64,
}

impl Lighting {
    /// Irradiance (luminance) on a free surface with this world normal at a world point, no shadows.
    #[must_use]
    pub fn free_irradiance(&self, point: Vector3<f64>, normal: Vector3<f64>) -> f64 {
        let up = 0.5 + 0.5 * normal.z as f32;
        let mut sum = self.sky * up + self.ground * (1.0 - up);
        for lamp in &self.lamps {
            let to = lamp.at_mm - point;
            sum += lamp.power * (normal.dot(&to) / to.norm()).max(0.0) as f32;
        }
        f64::from(0.3 * sum.x + 0.6 * sum.y + 0.1 * sum.z)
    }
}

/// Draws the light about a target that the head sees from a distance. The lasers' strength is drawn at that distance: a
/// stripe may drown in the sun or glare, but heads are built so that most are neither.
pub fn lighting(rng: &mut Rng, target: Vector3<f64>, distance_mm: f64) -> Lighting {
    let ambient = rng.pick(["office", "warehouse", "dim", "mixed", "sun", "office", "warehouse"]);
    let warm = |rng: &mut Rng, strength: f32, warmth: f32| {
        let w = warmth + rng.range_f32(-0.03, 0.03);
        v3(strength * (1.0 + w), strength, strength * (1.0 - 1.3 * w))
    };
    // Lamps are put above and towards the viewer, or no visible face would be lit.
    let place = |rng: &mut Rng, height: (f64, f64), reach: f64| {
        target
            + Vector3::new(
                rng.range(-reach, reach),
                rng.range(-reach, 0.3 * reach),
                rng.range(height.0, height.1),
            )
    };
    let mut lamps = Vec::new();
    let (sky, ground, ratio, noise);
    match ambient {
        "office" => {
            for _ in 0..2 {
                let at_mm = place(rng, (1500.0, 2600.0), 2200.0);
                let (width, s) = (rng.range_f32(0.12, 0.4), rng.range_f32(0.2, 0.6));
                lamps.push(Lamp { at_mm, width, power: warm(rng, s, 0.03) });
            }
            (sky, ground) = (warm(rng, 0.55, 0.02), warm(rng, 0.28, 0.05));
            (ratio, noise) = (rng.log_range(1.2, 7.0), rng.log_range(0.012, 0.03));
        }
        "warehouse" => {
            for _ in 0..2 {
                let at_mm = place(rng, (3000.0, 7000.0), 5000.0);
                let (width, s) = (rng.range_f32(0.04, 0.15), rng.range_f32(0.3, 0.9));
                lamps.push(Lamp { at_mm, width, power: warm(rng, s, -0.02) });
            }
            (sky, ground) = (warm(rng, 0.4, -0.02), warm(rng, 0.2, 0.02));
            (ratio, noise) = (rng.log_range(1.5, 9.0), rng.log_range(0.015, 0.035));
        }
        "dim" => {
            let at_mm = place(rng, (1200.0, 5000.0), 4000.0);
            let (width, s) = (rng.range_f32(0.05, 0.3), rng.range_f32(0.3, 1.2));
            lamps.push(Lamp { at_mm, width, power: warm(rng, s, 0.08) });
            (sky, ground) = (warm(rng, 0.35, 0.05), warm(rng, 0.15, 0.06));
            (ratio, noise) = (rng.log_range(3.0, 14.0), rng.log_range(0.025, 0.06));
        }
        "mixed" => {
            let at_mm = place(rng, (200.0, 900.0), 3500.0); // a window, low
            lamps.push(Lamp { at_mm, width: rng.range_f32(0.2, 0.5), power: warm(rng, 0.9, -0.08) });
            let at_mm = place(rng, (1500.0, 3000.0), 2500.0);
            lamps.push(Lamp { at_mm, width: rng.range_f32(0.05, 0.2), power: warm(rng, 0.4, 0.12) });
            (sky, ground) = (warm(rng, 0.35, 0.0), warm(rng, 0.2, 0.03));
            (ratio, noise) = (rng.log_range(1.2, 8.0), rng.log_range(0.012, 0.035));
        }
        _ => {
            let turn = rng.range(-2.6, -0.5);
            let high: f64 = rng.range(0.4, 1.2);
            let to = Vector3::new(turn.cos() * high.cos(), turn.sin() * high.cos(), high.sin());
            lamps.push(Lamp { at_mm: target + to * 1e6, width: 0.006, power: warm(rng, 2.2, 0.04) });
            (sky, ground) = (v3(0.5, 0.6, 0.78), warm(rng, 0.3, 0.05));
            (ratio, noise) = (rng.log_range(0.15, 1.3), rng.log_range(0.006, 0.015));
        }
    }
    let backdrop = if ambient == "sun" { v3(0.75, 0.85, 1.0) } else { sky * 0.15 };
    Lighting {
        ambient,
        lamps,
        sky,
        ground,
        backdrop,
        laser_to_ambient: ratio * (distance_mm / 1000.0),
        noise,
    }
}
