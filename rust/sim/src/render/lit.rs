//! Light that changes slowly over a face (shadow, occlusion) is computed on a coarse grid and interpolated within faces.

use super::prepare::Stage;
use crate::solid::Hit;
use crate::vec3::{V3, v3};

/// No face.
pub const NOTHING: u16 = u16::MAX;

/// Pixels between nodes; a power of two, since every pixel divides by it.
pub(super) const STEP: usize = 8;

/// How much of the diffuse light and of each lamp arrives.
#[derive(Clone, Copy, Debug, Default)]
pub struct Illumination {
    /// Share of the sky seen.
    pub open: f32,
    /// Light of the lamps that arrives: cosine, distance and shadows counted.
    pub lamps: V3,
    /// What a perfect coat would send on to the camera.
    pub shine: V3,
}

impl Illumination {
    fn brightness(&self) -> f32 {
        self.open + self.lamps.y + 0.2 * self.shine.y
    }
}

/// The coarse grid.
pub struct Grid {
    coarse: bool,
    across: usize,
    most: f32,
    nodes: Vec<(u16, Illumination)>,
    /// Of the cell to the right of and below each node: whether all its nodes are on one face in even light.
    even: Vec<bool>,
}

/// Identity of a face of a solid for the whole frame.
#[inline]
#[must_use]
pub fn face_id(solid: usize, face: usize) -> u16 {
    (solid * 8 + face) as u16
}

/// Normal of a hit in the camera frame.
#[inline]
#[must_use]
pub fn normal(stage: &Stage<'_>, solid: usize, hit: &Hit) -> V3 {
    let local = hit.bent.unwrap_or_else(|| {
        let side = if hit.face.is_multiple_of(2) { 1.0 } else { -1.0 };
        match hit.face / 2 {
            0 => v3(side, 0.0, 0.0),
            1 => v3(0.0, side, 0.0),
            _ => v3(0.0, 0.0, side),
        }
    });
    stage.solids[solid].cam_dir(local)
}

impl Grid {
    /// Whether the frame is a small one, in which a rounding is a pixel or two and takes the light of its face.
    #[must_use]
    pub const fn coarse(&self) -> bool {
        self.coarse
    }

    /// Computes the light at every eighth pixel.
    #[must_use]
    pub fn new(stage: &Stage<'_>) -> Self {
        let coarse = stage.raster.scale() > 1.5;
        let most = if coarse { 0.8 } else { 0.12 };
        let across = stage.raster.width.div_ceil(STEP) + 1;
        let down = stage.raster.height.div_ceil(STEP) + 1;
        let mut nodes = Vec::with_capacity(across * down);
        for j in 0..down {
            for i in 0..across {
                let column = (i * STEP).min(stage.raster.width - 1);
                let row = (j * STEP).min(stage.raster.height - 1);
                let ray = stage.ray(column as f64, row as f64);
                nodes.push(match stage.cast(ray, column, row) {
                    Some((solid, hit)) if !hit.rounded => {
                        let n = normal(stage, solid, &hit);
                        (face_id(solid, hit.face), at(stage, solid, ray, hit.depth, n))
                    }
                    _ => (NOTHING, Illumination::default()),
                });
            }
        }
        let spread = |cell: [usize; 4]| {
            let (low, high) = cell.iter().fold((f32::MAX, f32::MIN), |(l, h), i| {
                let b = nodes[*i].1.brightness();
                (l.min(b), h.max(b))
            });
            high - low
        };
        let even = (0..nodes.len())
            .map(|i| {
                let cell = [i, i + 1, i + across, i + across + 1];
                cell[3] < nodes.len() && cell.iter().all(|n| nodes[*n].0 == nodes[i].0) && spread(cell) < most
            })
            .collect();
        Self { coarse, across, most, nodes, even }
    }

    /// Solid, face and light at the four corners of a cell that is on one face in even light.
    #[must_use]
    pub(super) fn even_cell(&self, i: usize, j: usize) -> Option<(usize, usize, [Illumination; 4])> {
        let at = j * self.across + i;
        let id = usize::from(self.nodes[at].0);
        let corners = [at, at + 1, at + self.across, at + self.across + 1];
        (self.even[at] && self.nodes[at].0 != NOTHING)
            .then(|| (id / 8, id % 8, corners.map(|n| self.nodes[n].1)))
    }

    /// Light at a pixel of a face; `None` where no node of the cell is on that face, or light changes too fast.
    #[inline]
    #[must_use]
    pub fn lit(&self, id: u16, column: usize, row: usize) -> Option<Illumination> {
        let (i, j) = (column / STEP, row / STEP);
        let inverse = 1.0 / STEP as f32;
        let (x, y) = ((column - i * STEP) as f32 * inverse, (row - j * STEP) as f32 * inverse);
        let at = j * self.across + i;
        let (upper, lower) = (&self.nodes[at..at + 2], &self.nodes[at + self.across..at + self.across + 2]);
        let weights = [(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y];
        let cell = [&upper[0], &upper[1], &lower[0], &lower[1]];
        if self.even[at] && upper[0].0 == id {
            let mut sum = Illumination::default();
            for ((_, lit), w) in cell.iter().zip(weights) {
                sum.open += lit.open * w;
                sum.lamps += lit.lamps * w;
                sum.shine += lit.shine * w;
            }
            return Some(sum);
        }
        let mut sum = Illumination::default();
        let mut total = 0.0;
        let (mut low, mut high) = (f32::MAX, f32::MIN);
        for ((node, lit), weight) in cell.iter().zip(weights) {
            if *node == id {
                let w = weight + 1e-4;
                total += w;
                (low, high) = (low.min(lit.brightness()), high.max(lit.brightness()));
                sum.open += lit.open * w;
                sum.lamps += lit.lamps * w;
                sum.shine += lit.shine * w;
            }
        }
        if total <= 0.0 && self.coarse {
            return self.nearby(id, i, j);
        }
        // The border of a shadow runs through this cell: interpolation would show the grid.
        if total <= 0.0 || high - low > self.most {
            return None;
        }
        let s = 1.0 / total;
        Some(Illumination { open: sum.open * s, lamps: sum.lamps * s, shine: sum.shine * s })
    }
}

impl Grid {
    /// In small frames a thin face may lie between the nodes of its cell: one of the twelve around will do.
    #[cold]
    fn nearby(&self, id: u16, i: usize, j: usize) -> Option<Illumination> {
        let down = self.nodes.len() / self.across;
        let rows = j.saturating_sub(1)..(j + 3).min(down);
        rows.flat_map(|y| (i.saturating_sub(1)..(i + 3).min(self.across)).map(move |x| y * self.across + x))
            .find(|at| self.nodes[*at].0 == id)
            .map(|at| self.nodes[at].1)
    }
}

/// Light at a hit of a solid with a normal, computed in full.
#[must_use]
pub fn at(stage: &Stage<'_>, own: usize, ray: V3, depth: f32, normal: V3) -> Illumination {
    let point = ray * depth;
    let open = open(stage, own, point, normal);
    let back = -ray.unit();
    let slant = normal.dot(back).max(0.0);
    let grazing = (1.0 - slant) * (1.0 - slant);
    let mirror = normal * (2.0 * slant) - back;
    let up = 0.5 + 0.5 * mirror.dot(stage.up);
    let around = stage.sky * up + stage.ground * (1.0 - up);
    let mut lit = Illumination {
        open,
        lamps: V3::default(),
        shine: around * (open * (0.06 + grazing * grazing * (1.0 - slant))),
    };
    for lamp in &stage.lamps {
        let to = lamp.at - point;
        let distance = to.norm();
        let direction = to * (1.0 / distance);
        let cosine = normal.dot(direction);
        if cosine <= 0.0 {
            continue;
        }
        let law = (lamp.reference_mm / distance).powi(2).clamp(0.2, 2.5);
        let arrives = lamp.power * (law * seen(stage, own, point, direction, distance, lamp.width));
        lit.lamps += arrives * cosine;
        // A soft spot of some 10 degrees: boards and tapes are never mirrors.
        let half = normal.dot((direction + back).unit()).max(0.0);
        let spot = (half * half).powi(24);
        lit.shine += arrives * (1.2 * spot);
    }
    lit
}

/// Light at a point as if nothing stood in its way: enough for what a floor mirrors.
#[must_use]
pub fn unshadowed(stage: &Stage<'_>, point: V3, normal: V3) -> Illumination {
    let mut lit = Illumination { open: 0.7, ..Illumination::default() };
    for lamp in &stage.lamps {
        let to = lamp.at - point;
        let distance = to.norm();
        let law = (lamp.reference_mm / distance).powi(2).clamp(0.2, 2.5);
        lit.lamps += lamp.power * (law * (normal.dot(to) / distance).max(0.0));
    }
    lit
}

/// Share of a lamp that is seen from a point.
fn seen(stage: &Stage<'_>, own: usize, point: V3, direction: V3, distance: f32, width: f32) -> f32 {
    let mut share = 1.0f32;
    // The sun is so far that single precision would lose the box: a few metres of the way are enough.
    let reach = distance.min(8000.0);
    let way = direction * reach;
    for &(centre, bound, j) in &stage.casters {
        let c = centre - point;
        let along = c.dot(direction);
        let wide = bound + width * along.max(0.0) + 1.0;
        if along < -bound || c.dot(c) - along * along > wide * wide || along > reach + bound || j == own {
            continue;
        }
        let s = &stage.solids[j];
        share *= s.lets_through(point, way, width);
        if share < 0.01 {
            return 0.0;
        }
    }
    share
}

/// Share of the sky that other solids leave open, from their distance to three points above the surface.
fn open(stage: &Stage<'_>, own: usize, point: V3, normal: V3) -> f32 {
    const HEIGHTS: [f32; 3] = [22.0, 110.0, 420.0];
    const WEIGHTS: [f32; 3] = [0.30, 0.28, 0.26];
    let mut gaps = HEIGHTS;
    for (j, (centre, bound)) in stage.spheres.iter().enumerate() {
        let c = *centre - point;
        let far = bound + 2.0 * HEIGHTS[2];
        if c.dot(c) > far * far || j == own {
            continue;
        }
        let s = &stage.solids[j];
        let p = s.local(point);
        if s.gap_local(p) > 2.0 * HEIGHTS[2] {
            continue; // a far wall: its sphere is everywhere
        }
        let n = s.local_dir(normal);
        for (gap, height) in gaps.iter_mut().zip(HEIGHTS) {
            *gap = gap.min(s.gap_local(p + n * height));
        }
    }
    let mut open = 1.0;
    for ((gap, height), weight) in gaps.iter().zip(HEIGHTS).zip(WEIGHTS) {
        open -= weight * (1.0 - gap.max(0.0) / height);
    }
    open.max(0.05)
}
