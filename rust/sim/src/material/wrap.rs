//! Stretch film around a carton: wrinkles that throw light about, most of them in one direction, a milky veil over what is
//! beneath, soft edges.

use super::noise::tiles;
use crate::rng::Rng;
use crate::solid::face_uv;
use crate::vec3::{V3, v3};
use nalgebra::Vector3;

/// The film around one carton.
#[derive(Clone, Copy, Debug)]
pub struct Wrap {
    /// Share of a surface's contrast that the veil takes, 0.05 to 0.25.
    pub veil: f32,
    /// How strongly wrinkles shine, about 0.5.
    pub strength: f32,
    /// Over this width along each edge the film lies double or stands off, and hides more, mm.
    pub soft_mm: f32,
    /// Direction of the wrinkles on a face.
    cos_sin: [f32; 2],
    /// Where their noise starts, texels.
    offset: [f32; 2],
    half: V3,
}

/// What the film's light is like on its way to the camera: white, with less than half of the light.
const MILK: f32 = 0.45;
/// Gloss of smooth film.
const GLOSS: f32 = 0.12;
/// Share of a stripe that is left beneath the film.
const STRIPE_LEFT: f32 = 0.85;

/// What film adds to a place.
#[derive(Clone, Copy, Debug, Default)]
pub struct Glint {
    /// Share of the light from anywhere that wrinkles send to the camera.
    pub sheen: f32,
    /// What a laser meets there, in place of the albedo.
    pub laser: V3,
}

impl Wrap {
    /// Film around a carton of these half sizes.
    pub fn new(rng: &mut Rng, half: &Vector3<f64>) -> Self {
        // Wound around the upright axis, pulled a little askew.
        let (sin, cos) = (rng.normal() as f32 * 0.12).sin_cos();
        Self {
            veil: rng.range_f32(0.05, 0.25),
            strength: rng.range_f32(0.3, 0.8),
            soft_mm: rng.range_f32(1.0, 4.0),
            cos_sin: [cos, sin],
            offset: [rng.range_f32(0.0, 500.0), rng.range_f32(0.0, 500.0)],
            half: (*half).into(),
        }
    }

    /// Lays the film over a colour and a gloss at (u, v) mm of a face, seen with pixels of `foot` mm.
    #[must_use]
    pub fn lay(&self, face: usize, u: f32, v: f32, foot: f32, colour: &mut V3, gloss: &mut f32) -> Glint {
        let t = tiles();
        let [cos, sin] = self.cos_sin;
        let x = u * cos + v * sin + self.offset[0] + 170.0 * face as f32;
        let y = v * cos - u * sin + self.offset[1];
        // Long folds, and short ones that cross them at a small angle.
        let long = t.streak.at(x * 0.4, y * 0.9, foot * 0.9);
        let short = t.streak.at(x * 1.1 + 0.25 * y, y * 2.3, foot * 2.3);
        let fold = ((long - 0.7).max(0.0) + 0.7 * (short - 1.0).max(0.0)).min(1.6);
        let (room_u, room_v) = face_uv(face, self.half);
        let to_edge = (room_u.abs() - u.abs()).min(room_v.abs() - v.abs());
        let soft = (1.0 - to_edge / self.soft_mm).clamp(0.0, 1.0);
        let veil = self.veil + (0.6 - self.veil) * soft;
        *colour = *colour * (1.0 - veil) + v3(MILK, MILK, MILK) * veil;
        *gloss = (gloss.max(GLOSS) + self.strength * (0.5 * fold + 0.3 * soft)).min(0.8);
        let sheen = self.strength * 0.3 * fold * fold;
        Glint { sheen, laser: *colour * STRIPE_LEFT + v3(2.0, 2.0, 2.0) * sheen }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn laid(face: usize, v: f32) -> Vec<(V3, f32, Glint)> {
        let wrap = Wrap::new(&mut Rng::new(1, 1), &Vector3::new(200.0, 150.0, 100.0));
        (0..150)
            .map(|i| {
                let (mut colour, mut gloss) = (v3(0.02, 0.02, 0.02), 0.02);
                let glint = wrap.lay(face, i as f32 - 75.0, v, 0.5, &mut colour, &mut gloss);
                (colour, gloss, glint)
            })
            .collect()
    }

    #[test]
    fn film_lifts_black_shines_in_folds_and_sparkles_under_a_laser() {
        let all = laid(3, 0.0);
        assert!(all.iter().all(|(c, g, _)| (0.04..0.15).contains(&c.x) && (0.1..=0.8).contains(g)));
        let least = all.iter().fold(f32::MAX, |a, (.., glint)| a.min(glint.sheen));
        let most = all.iter().chain(&laid(3, 20.0)).fold(0f32, |a, (.., glint)| a.max(glint.sheen));
        assert!(least < 0.01 && most > 0.05, "{least} {most}");
        for (colour, _, glint) in &all {
            let stripe = glint.laser.x / colour.x;
            assert!(if glint.sheen < 1e-4 { (0.84..0.86).contains(&stripe) } else { stripe > 0.85 });
        }
        // Half a millimetre from the edge it hides more.
        assert!(laid(3, 99.5)[75].0.x > 1.5 * all[75].0.x);
    }

    #[test]
    fn folds_run_along_the_film() {
        let wrap = Wrap::new(&mut Rng::new(1, 1), &Vector3::new(900.0, 900.0, 900.0));
        let sheen = |u: f32, v: f32| wrap.lay(3, u, v, 0.5, &mut V3::default(), &mut 0.0).sheen;
        let (mut along, mut across) = (0.0, 0.0);
        for i in 0..4000 {
            let (u, v) = ((i % 80) as f32 * 20.0 - 800.0, (i / 80) as f32 * 30.0 - 750.0);
            along += (sheen(u + 15.0, v) - sheen(u, v)).abs();
            across += (sheen(u, v + 15.0) - sheen(u, v)).abs();
        }
        assert!(across > 1.4 * along, "{across} {along}");
    }
}
