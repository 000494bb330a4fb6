//! The four light sheets on a surface point: fan, thickness, distance, incidence, what stands in the way, speckle.

use super::prepare::{CamBeam, Stage};
use crate::rng::Rng;
use crate::vec3::{V3, v3};
use std::sync::OnceLock;

/// Beams at most: four, and four mirrored ones.
pub(super) const BEAMS: usize = 8;
/// Reach of a sheet in standard deviations.
const REACH: f32 = 4.0;
/// What a red laser leaves in the three channels.
const COLOUR: [f32; 3] = [1.0, 0.085, 0.035];

const SIDE: usize = 512;

/// Correlated speckle of unit mean, one value a sensor pixel.
fn speckle() -> &'static [f32] {
    static FIELD: OnceLock<Vec<f32>> = OnceLock::new();
    FIELD.get_or_init(|| {
        let mut rng = Rng::new(17, 0x5BEC);
        // Intensity of a sum of random phasors blurred over about one and a half pixels; three exposures' worth of
        // averaging (roughness, bandwidth, pixel area) brings the contrast from 1 to about 0.45.
        let mut sum = vec![0.0f32; SIDE * SIDE];
        for _ in 0..5 {
            let re = blur(&(0..SIDE * SIDE).map(|_| rng.normal() as f32).collect::<Vec<_>>());
            let im = blur(&(0..SIDE * SIDE).map(|_| rng.normal() as f32).collect::<Vec<_>>());
            for ((s, a), b) in sum.iter_mut().zip(re).zip(im) {
                *s += a * a + b * b;
            }
        }
        let mean = sum.iter().sum::<f32>() / sum.len() as f32;
        sum.iter().map(|s| s / mean).collect()
    })
}

fn blur(field: &[f32]) -> Vec<f32> {
    let at = |x: usize, y: usize| field[(y % SIDE) * SIDE + x % SIDE];
    (0..SIDE * SIDE)
        .map(|i| {
            let (x, y) = (i % SIDE + SIDE, i / SIDE + SIDE);
            let cross = at(x + 1, y) + at(x - 1, y) + at(x, y + 1) + at(x, y - 1);
            let diagonal = at(x + 1, y + 1) + at(x - 1, y + 1) + at(x + 1, y - 1) + at(x - 1, y - 1);
            at(x, y) + 0.55 * cross + 0.3 * diagonal
        })
        .collect()
}

/// Blur of the head's lens in sensor px: the middle of what `Sensor::random` draws. Averaging bytes notices it.
const LENS_BLUR_PX: f32 = 0.75;

/// What a Gaussian profile, its middle `off` cells away across the stripe, adds to a cell of light `base`, once the bytes of
/// the sensor's own pixels have been averaged: each clips by itself at `most` above the base, and bytes go about with the root of the light.
fn mean_profile(off: f32, sigma: f32, across: [f32; 2], peak: f32, base: f32, most: f32) -> f32 {
    // A square cell seen across the stripe is as wide as its shadow; five samples suffice from 0.3 cells of sigma on.
    let wide = across[0].abs() + across[1].abs();
    if off.abs() > REACH * sigma + 0.5 * wide {
        return 0.0;
    }
    let sample = |share: f32| {
        let x = (off + share * wide) / sigma;
        (base + (peak * (-0.5 * x * x).exp()).min(most)).sqrt()
    };
    // The shadow of a square at 45 degrees is a triangle, of an upright one a box: weights in between.
    let root =
        0.25 * sample(0.0) + 0.225 * (sample(-0.2) + sample(0.2)) + 0.15 * (sample(-0.4) + sample(0.4));
    (root * root - base).max(0.0)
}

/// A surface point that lasers may meet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    /// Its solid.
    pub own: usize,
    /// The ray that sees it.
    pub ray: V3,
    /// Its depth, mm.
    pub depth: f32,
    /// Its normal.
    pub normal: V3,
}

/// A stripe seen at a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Trace {
    /// Index of the pixel.
    pub pixel: u32,
    /// 0 to 3.
    pub laser: u8,
    /// Signed distance of the pixel from the stripe's middle, pixels of the raster.
    pub off_px: f32,
    /// Unit vector across the stripe (columns, rows) along which that distance counts.
    pub across: [f32; 2],
    /// What the stripe adds to the red channel, full scale 1 (not clipped).
    pub red: f32,
}

/// Share of a laser's light that a surface sends back: a glossy coat sends part of it elsewhere.
pub(super) fn coated(albedo: V3, gloss: f32) -> f32 {
    albedo.x.max(0.0) * (1.0 - 0.6 * gloss)
}

impl Stage<'_> {
    /// Peak irradiance of a sheet where it meets a surface point and the sheet's standard deviation there, mm;
    /// `None` outside its fan or behind the surface.
    #[inline]
    pub(super) fn sheet(&self, beam: &CamBeam, point: V3, normal: V3) -> Option<(f32, f32)> {
        let to = point - beam.source;
        let inverse = 1.0 / to.norm();
        let cosine = -normal.dot(to) * inverse;
        let fan = beam.forward.dot(to) * inverse;
        if cosine <= 0.0 || fan < beam.fan_cos {
            return None;
        }
        // Line lenses are a little weaker to their ends and stop softly.
        let end = ((fan - beam.fan_cos) * beam.fan_rise).min(1.0);
        // The fan spreads with the distance; a focused sheet hardly thickens, what its image shows is mostly the lens.
        let law = 1000.0 * inverse;
        Some((beam.at_1m * cosine * end * (0.6 + 0.4 * fan * fan) * law, beam.sigma_rad / inverse))
    }

    /// Whether laser `k` (0 to 3) sees a point of solid `own`.
    #[must_use]
    pub fn laser_sees(&self, k: usize, own: usize, point: V3) -> bool {
        let source = self.beams[k].source;
        !self.laser_casters[k].iter().any(|&j| j != own && self.solids[j].blocks(point, source - point))
    }

    /// Whether the light of beam `k`, one of the four or one of those mirrored in another face, reaches a point of solid `own`.
    fn beam_reaches(&self, k: usize, own: usize, point: V3) -> bool {
        let Some(bounce) = self.bounce.filter(|_| k >= 4) else { return self.laser_sees(k, own, point) };
        let to = self.beams[k].source - point;
        let above = bounce.normal.dot(point) - bounce.offset;
        if above <= 0.5 || own == bounce.solid {
            return false;
        }
        // Where the light comes from the face, which must be there and be lit itself.
        let way = to * (-above / bounce.normal.dot(to));
        let at = point + way;
        let mirror = &self.solids[bounce.solid];
        let over = mirror.local(at).abs() - mirror.half;
        let on_face = (0..3).all(|axis| axis == bounce.face / 2 || over[axis] <= 0.0);
        let blocks = |j: &usize| *j != own && *j != bounce.solid && self.solids[*j].blocks(point, way);
        on_face && !self.laser_casters[k].iter().any(blocks) && self.laser_sees(k - 4, bounce.solid, at)
    }

    /// Whether beam `k` may light a flat piece between four points, none of them deeper than `far`.
    pub(super) fn laser_near(&self, k: usize, points: &[V3; 4], far: f32) -> bool {
        let beam = &self.beams[k];
        let (low, high) = points.iter().fold((f32::MAX, f32::MIN), |(low, high), p| {
            let off = (beam.plane.dot(*p) - 1.0) * beam.plane_mm;
            (low.min(off), high.max(off))
        });
        let reach = self.reach_mm(beam, far);
        beam.at_1m > 0.0 && low <= reach && high >= -reach
    }

    /// How far from its plane a sheet can matter at a depth, mm.
    #[inline]
    fn reach_mm(&self, beam: &CamBeam, depth: f32) -> f32 {
        // Foreshortened faces spread the sheet over fewer pixels: 2 cells of grace.
        REACH * 1.15 * beam.sigma_rad * depth + 2.0 * self.cell_per_mm * depth
    }

    /// Adds what those lasers that are `near` send back from a spot to its colour; traces are kept if wanted.
    #[allow(clippy::too_many_arguments)] // two callers, for squares and for single pixels
    pub(super) fn add_lasers(
        &self,
        colour: &mut V3,
        albedo: V3,
        gloss: f32,
        spot: &Spot,
        near: [bool; BEAMS],
        pixel: (usize, usize),
        mut keep: Option<&mut Vec<Trace>>,
    ) {
        let Spot { own, ray, depth, normal } = *spot;
        let red = coated(albedo, gloss) * self.exposure;
        let base = colour.x.max(0.0);
        let room = (1.0 - base).max(0.0);
        let point = ray * depth;
        let cell = self.cell_per_mm * depth;
        let coarse = self.raster.scale() > 1.5;
        let mut sum = 0.0;
        for (k, beam) in self.beams.iter().enumerate().filter(|(k, _)| near[*k]) {
            let off = (beam.plane.dot(point) - 1.0) * beam.plane_mm;
            if off.abs() > self.reach_mm(beam, depth) || beam.at_1m <= 0.0 {
                continue;
            }
            let Some((peak, sigma)) = self.sheet(beam, point, normal) else { continue };
            let (off_px, across) = self.off_px(beam, ray, point, normal);
            let irradiance = if coarse {
                let sigma_px = (if off.abs() > 1e-3 { off_px / off * sigma } else { sigma / cell }).abs();
                let blurred_px = sigma_px.hypot(LENS_BLUR_PX / self.raster.scale() as f32);
                let whole = red.max(1e-6);
                mean_profile(off_px, blurred_px, across, peak * whole * sigma_px / blurred_px, base, room)
                    / whole
            } else {
                let x = off / sigma;
                if x.abs() > REACH { 0.0 } else { peak * (-0.5 * x * x).exp() }
            };
            if irradiance <= 1e-6 || !self.beam_reaches(k, own, point) {
                continue;
            }
            // A second stripe is nothing that anyone should find.
            if let Some(keep) = keep.as_deref_mut().filter(|_| k < 4) {
                keep.push(Trace {
                    pixel: (pixel.1 * self.raster.width + pixel.0) as u32,
                    laser: k as u8,
                    off_px,
                    across,
                    red: irradiance * red,
                });
            }
            sum += irradiance * self.speckle_at(k, pixel, coarse);
        }
        *colour += v3(COLOUR[0], COLOUR[1], COLOUR[2]) * (sum * red);
    }

    /// Signed distance of a pixel from the stripe on the tangent plane, in pixels of the raster, and its direction.
    fn off_px(&self, beam: &CamBeam, ray: V3, point: V3, normal: V3) -> (f32, [f32; 2]) {
        // On the plane q . X = 1 the stripe is the line (q - p) . x = 0 of the ideal image.
        let line = normal * (1.0 / normal.dot(point)) - beam.plane;
        let slope = 1.0 / (line.x * line.x + line.y * line.y).sqrt().max(1e-12);
        (line.dot(ray) * slope / self.cell_per_mm, [line.x * slope, line.y * slope])
    }

    fn speckle_at(&self, k: usize, pixel: (usize, usize), coarse: bool) -> f32 {
        if !self.options.speckle {
            return 1.0;
        }
        let shift = (self.options.seed as usize).wrapping_mul(7919).wrapping_add(k * 131);
        let (x, y) = ((pixel.0 + shift) % SIDE, (pixel.1 + shift / SIDE) % SIDE);
        let s = speckle()[y * SIDE + x];
        // A coarse cell averages some 25 pixels, a handful of them across the stripe.
        if coarse { 1.0 + 0.3 * (s - 1.0) } else { s }
    }
}
