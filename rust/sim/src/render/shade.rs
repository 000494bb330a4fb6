//! The colour of a hit: surface, stamps and film, diffuse light, lamps, gloss, lasers.

use super::laser::{BEAMS, Spot, Trace, coated};
use super::lit::{self, Grid, Illumination, face_id};
use super::prepare::Stage;
use crate::material::Stamp;
use crate::material::wrap::Glint;
use crate::solid::{FACES, Hit, face_uv};
use crate::vec3::V3;

/// What encoding leaves of a pixel's value: two levels of 255.
const ENCODING_NOISE: f32 = 2.0 / 255.0;
/// A floor in use is never a better mirror than this.
const MOST_MIRRORED: f32 = 0.3;
/// A mirrored stripe that adds less than a level is none.
const LEAST_TRACE: f32 = 0.004;

/// What a place of a face is like.
pub(super) struct SurfaceSample {
    albedo: V3,
    pub(super) gloss: f32,
    /// Share of all light that folds of film send on.
    sheen: f32,
    /// The albedo that lasers meet.
    pub(super) laser: V3,
}

impl SurfaceSample {
    /// What it sends to the camera of the diffuse light that arrives and of what a perfect coat would send on.
    #[inline]
    pub(super) fn lit(&self, arriving: V3, shine: V3) -> V3 {
        let diffuse = self.albedo.times(arriving) * (1.0 - 0.5 * self.gloss);
        diffuse + arriving * self.sheen + shine * self.gloss
    }
}

impl Stage<'_> {
    /// What a solid's face is like at (u, v) mm under some of its stamps, seen with pixels of `foot` mm.
    #[inline]
    pub(super) fn coat<'s>(
        &self,
        (solid, face): (usize, usize),
        (u, v): (f32, f32),
        foot: f32,
        stamps: impl Iterator<Item = &'s Stamp>,
    ) -> SurfaceSample {
        let mut albedo = self.surfaces[solid].colour(face, u, v, foot, self.photos);
        let mut gloss = self.gloss[solid];
        for stamp in stamps {
            stamp.lay(u, v, foot, &mut albedo, &mut gloss, self.photos);
        }
        let Glint { sheen, laser } = match &self.wraps[solid] {
            Some(wrap) => wrap.lay(face, u, v, foot, &mut albedo, &mut gloss),
            None => Glint { sheen: 0.0, laser: albedo },
        };
        SurfaceSample { albedo, gloss, sheen, laser }
    }

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
        let (mut colour, coat) = self.unlit(solid, hit, ambient, &light);
        let spot = Spot { own: solid, ray, depth: hit.depth, normal };
        let near = std::array::from_fn::<bool, BEAMS, _>(|k| k < self.beams.len());
        self.add_lasers(&mut colour, coat.laser, coat.gloss, &spot, near, pixel, traces.as_deref_mut());
        if self.mirror[solid] > 0.0 {
            self.mirror_in(&mut colour, self.mirror[solid], ray, normal, pixel, traces);
        }
        colour
    }

    /// Light without lasers from a hit, and what the face is like there.
    fn unlit(&self, solid: usize, hit: &Hit, ambient: V3, light: &Illumination) -> (V3, SurfaceSample) {
        // A pixel covers more of a face seen at a slant; between its long and its short side.
        let foot = self.cell_per_mm * hit.depth * self.faces[solid * FACES + hit.face].stretch;
        let stamps = self.stamps[solid][hit.face].iter();
        let coat = self.coat((solid, hit.face), face_uv(hit.face, hit.local), foot, stamps);
        (coat.lit(ambient * light.open + light.lamps, light.shine) * self.exposure, coat)
    }

    /// By how many sigmas of a pixel of the picture the middle of a stripe stands out in red where a ray meets a solid; 0 where none can be.
    #[must_use]
    pub fn contrast(&self, laser: usize, solid: usize, hit: &Hit, ray: V3) -> f32 {
        let normal = lit::normal(self, solid, hit);
        let Some((peak, _)) = self.sheet(&self.beams[laser], ray * hit.depth, normal) else { return 0.0 };
        let light = lit::at(self, solid, ray, hit.depth, normal);
        let (colour, coat) = self.unlit(solid, hit, self.ambient(normal), &light);
        let added = peak * coated(coat.laser, coat.gloss) * self.exposure;
        let base = colour.x.clamp(0.0, 1.0);
        // Shot noise is even in the root of the light, where its sigma is half of that at full scale.
        let sigma = (0.5 * self.noise as f32).max(ENCODING_NOISE);
        ((base + added).min(1.0).sqrt() - base.sqrt()) / sigma
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
