//! The colour of a hit: surface and stamps, diffuse light, lamps, gloss, lasers.

use super::laser::{Spot, Trace};
use super::lit::{self, Grid, face_id};
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
        let light = if hit.rounded && (!grid.coarse() || self.is_wide(solid, hit)) {
            exact()
        } else {
            grid.lit(id, pixel.0, pixel.1).unwrap_or_else(exact)
        };
        let (u, v) = face_uv(hit.face, hit.local);
        // A pixel covers more of a face seen at a slant; between its long and its short side.
        let foot = self.cell_per_mm * hit.depth * face.stretch;
        let mut albedo = self.surfaces[solid].colour(hit.face, u, v, foot, self.photos);
        let mut gloss = self.gloss[solid];
        for stamp in &self.stamps[solid][hit.face] {
            stamp.lay(u, v, foot, &mut albedo, &mut gloss, self.photos);
        }
        let arriving = ambient * light.open + light.lamps;
        let colour = albedo.times(arriving) * (1.0 - 0.5 * gloss) + light.shine * gloss;
        let mut colour = colour * self.exposure;
        let spot = Spot { own: solid, ray, depth: hit.depth, normal };
        self.add_lasers(&mut colour, albedo, gloss, &spot, [true; 4], pixel, traces);
        colour
    }

    /// Whether a rounding is more than a pixel or two wide, so that even a small frame shows its shading.
    fn is_wide(&self, solid: usize, hit: &Hit) -> bool {
        self.solids[solid].radius > 3.0 * self.cell_per_mm * hit.depth
    }
}
