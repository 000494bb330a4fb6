//! The colour of a hit: surface and stamps, diffuse light, lamps, gloss, lasers.

use super::laser::{Spot, Trace, coated};
use super::lit::{self, Grid, Lit, face_id};
use super::prepare::Stage;
use crate::solid::{FACES, Hit, face_uv};
use crate::vec3::V3;

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
        let face = &self.faces[solid * FACES + hit.face];
        let (normal, ambient) = match hit.bent {
            None => (face.normal, face.ambient),
            Some(_) => {
                let normal = lit::normal(self, solid, hit);
                (normal, self.ambient(normal))
            }
        };
        let exact = || lit::at(self, solid, ray, hit.depth, normal);
        let light = if hit.rounded && !grid.coarse() {
            exact()
        } else {
            grid.lit(id, pixel.0, pixel.1).unwrap_or_else(exact)
        };
        let (mut colour, albedo, gloss) = self.unlit(solid, hit, ambient, &light);
        let spot = Spot { own: solid, ray, depth: hit.depth, normal };
        self.add_lasers(&mut colour, albedo, gloss, &spot, [true; 4], pixel, traces);
        colour
    }

    /// Light without lasers from a hit, its albedo and its gloss.
    fn unlit(&self, solid: usize, hit: &Hit, ambient: V3, light: &Lit) -> (V3, V3, f32) {
        let (u, v) = face_uv(hit.face, hit.local);
        // A pixel covers more of a face seen at a slant; between its long and its short side.
        let foot = self.cell_per_mm * hit.depth * self.faces[solid * FACES + hit.face].stretch;
        let mut albedo = self.surfaces[solid].colour(hit.face, u, v, foot, self.photos);
        let mut gloss = self.gloss[solid];
        for stamp in &self.stamps[solid][hit.face] {
            stamp.lay(u, v, foot, &mut albedo, &mut gloss, self.photos);
        }
        let arriving = ambient * light.open + light.lamps;
        let colour = albedo.times(arriving) * (1.0 - 0.5 * gloss) + light.shine * gloss;
        (colour * self.exposure, albedo, gloss)
    }

    /// By how many sigmas of a sensor pixel the middle of a stripe stands out in red where a ray meets a solid; 0 where none can be.
    #[must_use]
    pub fn contrast(&self, laser: usize, solid: usize, hit: &Hit, ray: V3) -> f32 {
        let normal = lit::normal(self, solid, hit);
        let Some((peak, _)) = self.sheet(&self.beams[laser], ray * hit.depth, normal) else { return 0.0 };
        let light = lit::at(self, solid, ray, hit.depth, normal);
        let (colour, albedo, gloss) = self.unlit(solid, hit, self.ambient(normal), &light);
        let added = peak * coated(albedo, gloss) * self.exposure;
        let base = colour.x.clamp(0.0, 1.0);
        // Shot noise is even in the root of the light, where its sigma is half of that at full scale.
        ((base + added).min(1.0).sqrt() - base.sqrt()) / (0.5 * self.noise as f32).max(1e-6)
    }
}
