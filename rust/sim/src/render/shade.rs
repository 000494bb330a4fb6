//! The colour of a hit: surface and stamps, diffuse light, lamps, gloss, lasers.

use super::laser::{BEAMS, Spot, Trace};
use super::lit::{self, Grid, face_id};
use super::prepare::Stage;
use crate::solid::{FACES, Hit, face_uv};
use crate::vec3::V3;

/// A floor in use is never a better mirror than this.
const MOST_MIRRORED: f32 = 0.3;
/// A mirrored stripe that adds less than a level is none.
const LEAST_TRACE: f32 = 0.004;

impl Stage<'_> {
    /// Light from a hit towards the camera, in units of the film (full scale 1); without a grid, as a floor mirrors it.
    pub(super) fn shade(
        &self,
        grid: Option<&Grid>,
        solid: usize,
        hit: &Hit,
        ray: V3,
        pixel: (usize, usize),
        mut traces: Option<&mut Vec<Trace>>,
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
        let light = match grid {
            None => lit::unshadowed(self, ray * hit.depth, normal),
            Some(grid) if hit.rounded && (!grid.coarse() || self.is_wide(solid, hit)) => exact(),
            Some(grid) => grid.lit(id, pixel.0, pixel.1).unwrap_or_else(exact),
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
        let near = std::array::from_fn::<bool, BEAMS, _>(|k| k < self.beams.len());
        self.add_lasers(&mut colour, albedo, gloss, &spot, near, pixel, traces.as_deref_mut());
        if self.mirror[solid] > 0.0 {
            self.mirror_in(&mut colour, self.mirror[solid], ray, normal, pixel, traces);
        }
        colour
    }

    /// Whether a rounding is more than a pixel or two wide, so that even a small frame shows its shading.
    fn is_wide(&self, solid: usize, hit: &Hit) -> bool {
        self.solids[solid].radius > 3.0 * self.cell_per_mm * hit.depth
    }

    /// Mixes what a polished floor mirrors into its colour (Schlick's law: more at a slant).
    pub(super) fn mirror_in(
        &self,
        colour: &mut V3,
        mirror: f32,
        ray: V3,
        normal: V3,
        pixel: (usize, usize),
        traces: Option<&mut Vec<Trace>>,
    ) {
        let Some(image) = &self.image else { return };
        let slant = (-normal.dot(ray.unit())).clamp(0.0, 1.0);
        let share = (mirror + (1.0 - mirror) * (1.0 - slant).powi(5)).min(MOST_MIRRORED);
        let mut mirrored = Vec::new();
        let light = match image.cast(ray, pixel.0, pixel.1) {
            Some((solid, hit)) => image.shade(None, solid, &hit, ray, pixel, Some(&mut mirrored)),
            None => image.nothing(ray),
        };
        *colour = *colour * (1.0 - share) + light * share;
        if let Some(traces) = traces {
            let seen = mirrored.into_iter().map(|t| Trace { red: t.red * share, ..t });
            traces.extend(seen.filter(|t| t.red > LEAST_TRACE));
        }
    }
}
