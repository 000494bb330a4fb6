//! The colour of a hit: surface and stamps, diffuse light, lamps, gloss, lasers.

use super::laser::{COLOUR, Trace};
use super::lit::{self, Grid, Lit, face_id};
use super::prepare::Stage;
use crate::solid::{Hit, face_uv};
use crate::vec3::{V3, v3};

impl Stage<'_> {
    /// Light from a hit towards the camera, in units of the film (full scale 1).
    pub(super) fn shade(
        &self,
        grid: &Grid,
        solid: usize,
        hit: &Hit,
        ray: V3,
        pixel: (usize, usize),
        traces: Option<&mut Vec<Trace>>,
    ) -> V3 {
        let id = face_id(solid, hit.face);
        let normal = lit::normal(self, solid, hit);
        let exact = || lit::at(self, solid, ray * hit.depth, normal);
        let light = if hit.rounded { exact() } else { grid.lit(id, pixel.0, pixel.1).unwrap_or_else(exact) };
        let (u, v) = face_uv(hit.face, hit.local);
        let slant = (-normal.dot(ray) / ray.norm()).max(0.15);
        let foot = self.cell_per_mm * hit.depth / slant.sqrt();
        let mut albedo = self.surfaces[solid].colour(hit.face, u, v, foot, self.photos);
        let mut gloss = self.gloss[solid];
        for stamp in &self.stamps[solid][hit.face] {
            stamp.lay(u, v, foot, &mut albedo, &mut gloss, self.photos);
        }
        let up = 0.5 + 0.5 * normal.dot(self.up);
        let mut arriving = (self.sky * up + self.ground * (1.0 - up)) * light.open;
        for (lamp, share) in self.lamps.iter().zip(light.lamps) {
            arriving += lamp.power * share;
        }
        let mut colour = albedo.times(arriving);
        if gloss > 0.015 {
            colour = colour * (1.0 - 0.5 * gloss) + self.shine(ray, hit.depth, normal, gloss, slant, &light);
        }
        colour = colour * self.exposure;
        // A glossy coat sends part of the laser elsewhere.
        let red = albedo.x.max(0.0) * (1.0 - 0.6 * gloss) * self.exposure;
        let laser = self.lasers(solid, ray, hit.depth, normal, pixel, traces, red, (1.0 - colour.x).max(0.0));
        if laser > 0.0 {
            colour += v3(COLOUR[0], COLOUR[1], COLOUR[2]) * (laser * red);
        }
        colour
    }

    /// What a coat reflects: lamps as soft spots, and the surroundings at grazing angles.
    fn shine(&self, ray: V3, depth: f32, normal: V3, gloss: f32, slant: f32, light: &Lit) -> V3 {
        let back = -ray.unit();
        let grazing = (1.0 - slant).powi(5);
        let mirror = normal * (2.0 * normal.dot(back)) - back;
        let up = 0.5 + 0.5 * mirror.dot(self.up);
        let around = self.sky * up + self.ground * (1.0 - up);
        let mut sum = around * (light.open * (0.06 * gloss + gloss * grazing));
        let sharp = if gloss > 0.15 { 90.0 } else { 18.0 };
        for (lamp, share) in self.lamps.iter().zip(light.lamps) {
            let to = (lamp.at - ray * depth).unit();
            let half = (to + back).unit();
            let spot = normal.dot(half).max(0.0).powf(sharp);
            let visible = share / normal.dot(to).max(0.15);
            sum += lamp.power * (gloss * spot * visible * 0.02 * sharp);
        }
        sum
    }
}
