//! Training labels on a raster of half the frame's size: what a network is to find, from the truth that the rays met.
//!
//! Nine channels of 0..255: lasers 1 to 4 on the target face, spill (lasers elsewhere), edges of the target face, edges of
//! other faces and boxes, the face's mask, its corners. Lines are Gaussians about the exact curve: an edge that waves is drawn
//! where it is, corners are those of the sharp box.

use crate::pose::{FacePose, px_of};
use crate::render::lit::{NOTHING, face_id};
use crate::render::{Film, Stage};
use crate::solid::{FACES, Solid};
use crate::vec3::{V3, v3};
use crate::world::Role;
use crate::{Head, Raster};
use boxline::frames::Ray;
use nalgebra::Vector3;

/// Names of the channels, in order.
pub const CHANNELS: [&str; 9] =
    ["L1", "L2", "L3", "L4", "spill", "face_edge", "other_edge", "face_mask", "corner"];
const SPILL: usize = 4;
const FACE_EDGE: usize = 5;
const OTHER_EDGE: usize = 6;
const MASK: usize = 7;
const CORNER: usize = 8;

/// Standard deviation of a line, label px.
const LINE_SIGMA: f32 = 0.8;
/// Standard deviation of a corner, label px.
const CORNER_SIGMA: f32 = 1.5;

/// Labels of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Labels {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// One channel after the other, rows top to bottom.
    pub bytes: Vec<u8>,
    /// Median of what each laser adds to the red channel on the target face, in levels of 255; 0 where it is not.
    pub contrast: [f32; 4],
}

struct Canvas {
    width: usize,
    height: usize,
    bytes: Vec<u8>,
    line: [u8; 256],
    corner: [u8; 256],
}

impl Canvas {
    fn new(width: usize, height: usize) -> Self {
        // Value by squared distance in sixteenths of a px (lines) and quarters (corners).
        let table = |sigma: f32, unit: f32| {
            let mut t = [0u8; 256];
            for (i, v) in t.iter_mut().enumerate() {
                *v = (255.0 * (-0.5 * i as f32 * unit / (sigma * sigma)).exp() + 0.5) as u8;
            }
            t
        };
        Self {
            width,
            height,
            bytes: vec![0; width * height * CHANNELS.len()],
            line: table(LINE_SIGMA, 1.0 / 32.0),
            corner: table(CORNER_SIGMA, 1.0 / 8.0),
        }
    }

    /// A dot at (x, y) label px; dots closer than half a px join to a line.
    fn dot(&mut self, channel: usize, x: f32, y: f32, corner: bool) {
        let reach = if corner { 5 } else { 3 };
        if !(x > -8.0 && y > -8.0 && x < self.width as f32 + 8.0 && y < self.height as f32 + 8.0) {
            return;
        }
        let (cx, cy) = (x.round() as i32, y.round() as i32);
        let (w, h) = (self.width as i32, self.height as i32);
        let (table, unit) = if corner { (&self.corner, 8.0) } else { (&self.line, 32.0) };
        let plane = channel * self.width * self.height;
        for py in (cy - reach).max(0)..=(cy + reach).min(h - 1) {
            for px in (cx - reach).max(0)..=(cx + reach).min(w - 1) {
                let d2 = (px as f32 - x).powi(2) + (py as f32 - y).powi(2);
                let value = table.get((d2 * unit) as usize).copied().unwrap_or(0);
                let byte = &mut self.bytes[plane + (py * w + px) as usize];
                *byte = (*byte).max(value);
            }
        }
    }
}

/// Labels of a film; `face` is the target's face in view, if there is a target.
#[must_use]
pub fn labels(stage: &Stage<'_>, film: &Film, head: &Head, face: Option<(&FacePose, usize)>) -> Labels {
    let (width, height) = (film.width / 2, film.height / 2);
    let mut canvas = Canvas::new(width, height);
    let target = face.and_then(|(pose, index)| Some((stage.target()?, pose, index)));
    let own = target.map_or(NOTHING, |(solid, _, index)| face_id(solid, index));
    let mut red: [Vec<f32>; 4] = Default::default();
    for trace in &film.traces {
        let at = trace.pixel as usize;
        if trace.off_px.abs() > 0.75 {
            continue;
        }
        let (column, row) = ((at % film.width) as f32, (at / film.width) as f32);
        let x = (column - trace.off_px * trace.across[0] - 0.5) * 0.5;
        let y = (row - trace.off_px * trace.across[1] - 0.5) * 0.5;
        let on_face = film.ids[at] == own;
        canvas.dot(if on_face { usize::from(trace.laser) } else { SPILL }, x, y, false);
        if on_face && trace.off_px.abs() <= 0.5 {
            let after = film.light[at].x;
            let levels = level(after) - level(after - trace.red);
            red[usize::from(trace.laser)].push(levels);
        }
    }
    let raster = Raster::covering([head.calibration.width_px(), head.calibration.height_px()], width, height);
    for (i, solid) in stage.solids.iter().enumerate() {
        let own_face = target.filter(|(t, ..)| *t == i).map(|(.., index)| index);
        if matches!(stage.roles[i], Role::Target | Role::Carton | Role::Flap) {
            edges(&mut canvas, stage, film, &raster, i, solid, own_face);
        }
    }
    if let Some((solid, pose, index)) = target {
        mask(&mut canvas, film, face_id(solid, index));
        for (i, corner) in pose.corners().iter().enumerate() {
            let inward = (pose.centre - corner).normalize();
            let cell = f64::from(stage.raster.cell_per_mm(&stage.camera) as f32) * corner.z;
            let seen = [1.5, 3.0, 5.0].iter().any(|s| {
                id_at(film, &stage.raster, head, &(corner + inward * (s * cell))) == face_id(solid, index)
            });
            if let (true, Some(px)) = (seen || i > 3, px_of(head, corner)) {
                let [x, y] = raster.from_px(px);
                canvas.dot(CORNER, x as f32, y as f32, true);
            }
        }
    }
    // An edge that is both belongs to the face.
    let n = width * height;
    for i in 0..n {
        let keep = 255 - u16::from(canvas.bytes[FACE_EDGE * n + i]);
        let byte = &mut canvas.bytes[OTHER_EDGE * n + i];
        *byte = (u16::from(*byte) * keep / 255) as u8;
    }
    let contrast = red.map(|mut levels| {
        levels.sort_by(f32::total_cmp);
        levels.get(levels.len() / 2).copied().unwrap_or(0.0)
    });
    Labels { width, height, bytes: canvas.bytes, contrast }
}

/// Level of 255 that a plain sRGB curve gives to linear light.
fn level(x: f32) -> f32 {
    let x = x.clamp(0.0, 1.0);
    255.0 * if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

fn mask(canvas: &mut Canvas, film: &Film, id: u16) {
    let n = canvas.width * canvas.height;
    for y in 0..canvas.height {
        for x in 0..canvas.width {
            let at = 2 * y * film.width + 2 * x;
            let count = [at, at + 1, at + film.width, at + film.width + 1]
                .iter()
                .filter(|i| film.ids[**i] == id)
                .count();
            canvas.bytes[MASK * n + y * canvas.width + x] = (count * 255 / 4) as u8;
        }
    }
}

fn id_at(film: &Film, raster: &Raster, head: &Head, point: &Vector3<f64>) -> u16 {
    let Some(px) = px_of(head, point) else { return NOTHING };
    let [c, r] = raster.from_px(px).map(f64::round);
    let inside = c >= 0.0 && r >= 0.0 && c < film.width as f64 && r < film.height as f64;
    if inside { film.ids[r as usize * film.width + c as usize] } else { NOTHING }
}

/// Draws the visible parts of a box's edges; those of `own_face` are the target's.
fn edges(
    canvas: &mut Canvas,
    stage: &Stage<'_>,
    film: &Film,
    raster: &Raster,
    index: usize,
    solid: &Solid,
    own_face: Option<usize>,
) {
    let camera = solid.local(V3::default());
    let facing = |face: usize| {
        let side = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
        camera[face / 2] * side > solid.half[face / 2]
    };
    for first in 0..FACES {
        for second in first + 1..FACES {
            if first / 2 == second / 2 || !(facing(first) || facing(second)) {
                continue;
            }
            let side = |face: usize| if face.is_multiple_of(2) { 1.0 } else { -1.0 };
            let (a, b) = (first / 2, second / 2);
            let along = 3 - a - b;
            let mut ends = [[0.0f32; 3]; 2];
            for (end, sign) in ends.iter_mut().zip([-1.0, 1.0]) {
                end[a] = solid.half[a] * side(first);
                end[b] = solid.half[b] * side(second);
                end[along] = solid.half[along] * sign;
            }
            let ends = ends.map(|e| v3(e[0], e[1], e[2]));
            // From the edge into each face that is seen: there the film must show that face.
            let into = |face: usize, other: usize| {
                let mut d = [0.0f32; 3];
                d[other / 2] = -side(other);
                facing(face).then(|| (face_id(index, face), v3(d[0], d[1], d[2])))
            };
            let sides = [into(first, second), into(second, first)];
            let is_own = own_face.is_some_and(|f| f == first || f == second);
            let channel = if is_own { FACE_EDGE } else { OTHER_EDGE };
            // The target's edge is seen where its face is; any other where either face is.
            let sides = sides
                .map(|s| s.filter(|(id, _)| !is_own || own_face.is_some_and(|f| *id == face_id(index, f))));
            edge(canvas, stage, film, raster, solid, &Edge { ends, faces: [first, second], sides, channel });
        }
    }
}

/// An edge of a solid, in its frame: ends, the faces that meet there, those that are seen with the way into them, where it is
/// drawn.
struct Edge {
    ends: [V3; 2],
    faces: [usize; 2],
    sides: [Option<(u16, V3)>; 2],
    channel: usize,
}

/// One edge: dots every half a label px where a neighbouring face is seen.
fn edge(canvas: &mut Canvas, stage: &Stage<'_>, film: &Film, raster: &Raster, solid: &Solid, edge: &Edge) {
    let Edge { ends, faces, sides, channel } = *edge;
    const PIECES: usize = 8;
    let cam = |local: V3| solid.centre + solid.cam_dir(local);
    let at = |i: usize, shift: V3| {
        let local = solid.on_edge(faces, ends[0] + (ends[1] - ends[0]) * (i as f32 / PIECES as f32));
        let p = cam(local);
        if p.z < 30.0 {
            return None;
        }
        // 1.3 pixels of the film at this depth, more where the face is seen at a slant.
        let step = 1.3 * p.z * stage.raster.cell_per_mm(&stage.camera) as f32;
        let q = cam(local + shift * step);
        let ray = Ray::new(f64::from(q.x / q.z), f64::from(q.y / q.z));
        stage.camera.px_from_ray(&ray).map(|px| (raster.from_px(px), p.z))
    };
    for i in 0..PIECES {
        let none = V3::default();
        let (Some((p, _)), Some((q, _))) = (at(i, none), at(i + 1, none)) else { continue };
        let outside = |k: usize, n: usize| p[k].max(q[k]) < 0.0 || p[k].min(q[k]) > n as f64;
        let length = (q[0] - p[0]).hypot(q[1] - p[1]);
        if outside(0, canvas.width) || outside(1, canvas.height) || length > 4.0 * canvas.width as f64 {
            continue;
        }
        let shifted = sides.map(|s| {
            let (id, d) = s?;
            // At a slant the shift shrinks on the image: lengthen it to 1.3 px again, within reason.
            let (a, _) = at(i, d)?;
            let moved = 2.0 * (a[0] - p[0]).hypot(a[1] - p[1]);
            let d = d * (1.3 / moved.clamp(0.2, 1.3)) as f32;
            let ((a, _), (b, _)) = (at(i, d)?, at(i + 1, d)?);
            Some((id, a, b))
        });
        let count = (length / 0.5).ceil().max(1.0) as usize;
        for k in 0..count {
            let t = (k as f64 + 0.5) / count as f64;
            let seen = shifted.iter().flatten().any(|(id, a, b)| {
                // Label to film pixels: twice, about the corner of the raster.
                let film_px = |n: usize| ((a[n] + (b[n] - a[n]) * t) * 2.0 + 0.5).round();
                let (c, r) = (film_px(0), film_px(1));
                let inside = c >= 0.0 && r >= 0.0 && c < film.width as f64 && r < film.height as f64;
                inside && film.ids[r as usize * film.width + c as usize] == *id
            });
            if seen {
                let point = [p[0] + (q[0] - p[0]) * t, p[1] + (q[1] - p[1]) * t];
                canvas.dot(channel, point[0] as f32, point[1] as f32, false);
            }
        }
    }
}
