//! Most of a frame is squares of eight by eight pixels that show one face in even light, flat or so slightly bent that its
//! tangent plane in the middle of the square stands for it. What such a square has in common is computed once: its plane, light at its corners, which stamps and lasers come near. The pixels then cost a third.

use super::laser::{BEAMS, Spot, Trace};
use super::lit::{Grid, STEP, face_id};
use super::prepare::Stage;
use crate::material::Stamp;
use crate::solid::{FACES, face_axes};
use crate::vec3::V3;

/// Values at the corners of a square: upper left and right, lower left and right.
type Corners = [V3; 4];

/// A square of pixels on one face.
pub(super) struct Patch<'s> {
    solid: usize,
    face: usize,
    /// Its leftmost column and uppermost row.
    first: (usize, usize),
    rays: Corners,
    normal: V3,
    /// n . X of the plane, mm.
    offset_mm: f32,
    right: V3,
    down: V3,
    /// Picture coordinates of the camera's centre, mm.
    origin: [f32; 2],
    /// Diffuse light that arrives, and what a perfect coat sends on, exposure counted.
    arriving: Corners,
    shine: Corners,
    /// Size of a pixel on the face, mm.
    foot: f32,
    stamps: Vec<&'s Stamp>,
    /// Lasers that come near.
    lasers: [bool; BEAMS],
}

/// What changes along a row of a patch, at its left and right ends.
pub(super) struct Row {
    ray: [V3; 2],
    arriving: [V3; 2],
    shine: [V3; 2],
}

/// What a pixel of a patch shows.
pub(super) struct VisiblePlane {
    pub(super) colour: V3,
    pub(super) id: u16,
    pub(super) depth: f32,
}

#[inline]
fn mix(a: V3, b: V3, t: f32) -> V3 {
    a + (b - a) * t
}

impl Patch<'_> {
    /// The ends of a row.
    pub(super) fn row(&self, row: usize) -> Row {
        let t = (row - self.first.1) as f32 * (1.0 / STEP as f32);
        let between = |c: &Corners| [mix(c[0], c[2], t), mix(c[1], c[3], t)];
        Row { ray: between(&self.rays), arriving: between(&self.arriving), shine: between(&self.shine) }
    }
}

impl Stage<'_> {
    /// The patch of the cell to the right of and below node (i, j) of the grid; `None` if it shows more than one face.
    pub(super) fn patch(&self, grid: &Grid, i: usize, j: usize) -> Option<Patch<'_>> {
        let (solid, face, light) = grid.even_cell(i, j)?;
        let body = &self.solids[solid];
        let first = (i * STEP, j * STEP);
        let (x, y) = (first.0 as f64, first.1 as f64);
        let step = STEP as f64;
        let rays =
            [self.ray(x, y), self.ray(x + step, y), self.ray(x, y + step), self.ray(x + step, y + step)];
        let flat = self.faces[solid * FACES + face];
        let (normal, offset_mm, ambient) = if body.bent() {
            let middle = self.ray(x + 0.5 * step, y + 0.5 * step);
            let hit = body.hit(middle, f32::INFINITY).filter(|h| h.face == face && !h.rounded)?;
            let normal = body.cam_dir(hit.bent?);
            (normal, normal.dot(middle * hit.depth), self.ambient(normal))
        } else {
            (flat.normal, flat.normal.dot(body.centre) + body.half[face / 2], flat.ambient)
        };
        let points = rays.map(|r| r * (offset_mm / normal.dot(r)));
        let (near, far) = points.iter().fold((f32::MAX, f32::MIN), |(n, f), p| (n.min(p.z), f.max(p.z)));
        if near <= 0.0 || self.others_before(solid, first, &rays, &points.map(|p| 1.0 / p.z), far) {
            return None;
        }
        let (right, down) = face_axes(face);
        let (right, down) = (body.cam_dir(right.into()), body.cam_dir(down.into()));
        let origin = [-right.dot(body.centre), -down.dot(body.centre)];
        let foot = self.cell_per_mm * 0.5 * (near + far) * flat.stretch;
        let span = |axis: V3, from: f32| {
            points.iter().fold([f32::MAX, f32::MIN], |[low, high], p| {
                let at = axis.dot(*p) + from;
                [low.min(at), high.max(at)]
            })
        };
        let (us, vs) = (span(right, origin[0]), span(down, origin[1]));
        let stamps = self.stamps[solid][face].iter().filter(|s| s.reaches(us, vs, foot)).collect();
        Some(Patch {
            solid,
            face,
            first,
            rays,
            normal,
            offset_mm,
            right,
            down,
            origin,
            arriving: light.map(|l| (ambient * l.open + l.lamps) * self.exposure),
            shine: light.map(|l| l.shine * self.exposure),
            foot,
            stamps,
            lasers: std::array::from_fn(|k| k < self.beams.len() && self.laser_near(k, &points, far)),
        })
    }

    /// Whether a solid other than `own` may be seen in a square whose own face has these inverse depths at its corners, `far`
    /// the depth of the farthest.
    fn others_before(
        &self,
        own: usize,
        first: (usize, usize),
        rays: &Corners,
        inverse_depths: &[f32; 4],
        far: f32,
    ) -> bool {
        let (x, y) = (first.0 as f64, first.1 as f64);
        let step = STEP as f64;
        let span = [[x, x + step], [y, y + step], [x + y, x + y + 2.0 * step], [x - y - step, x - y + step]];
        self.candidates(first.0, first.1).iter().take_while(|(nearest, _)| *nearest < far).any(|(_, i)| {
            let i = usize::from(*i);
            i != own && self.may_cover(i, &span) && !self.solids[i].behind(rays, inverse_depths)
        })
    }

    /// The face, its depth and the light of a pixel in a row of a patch.
    #[inline]
    pub(super) fn shade_patch(
        &self,
        patch: &Patch<'_>,
        line: &Row,
        pixel: (usize, usize),
        traces: &mut Vec<Trace>,
    ) -> VisiblePlane {
        let t = (pixel.0 - patch.first.0) as f32 * (1.0 / STEP as f32);
        let between = |ends: &[V3; 2]| mix(ends[0], ends[1], t);
        let ray = between(&line.ray);
        let depth = patch.offset_mm / patch.normal.dot(ray);
        let point = ray * depth;
        let (u, v) = (patch.right.dot(point) + patch.origin[0], patch.down.dot(point) + patch.origin[1]);
        let coat = self.coat((patch.solid, patch.face), (u, v), patch.foot, patch.stamps.iter().copied());
        let mut colour = coat.lit(between(&line.arriving), between(&line.shine));
        if patch.lasers.contains(&true) {
            let spot = Spot { own: patch.solid, ray, depth, normal: patch.normal };
            self.add_lasers(&mut colour, coat.laser, coat.gloss, &spot, patch.lasers, pixel, Some(traces));
        }
        if self.mirror[patch.solid] > 0.0 {
            self.mirror_in(&mut colour, self.mirror[patch.solid], ray, patch.normal, pixel, Some(traces));
        }
        VisiblePlane { colour, id: face_id(patch.solid, patch.face), depth }
    }
}
