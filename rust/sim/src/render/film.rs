//! Casts the rays of a frame: one a pixel, a finer grid where faces meet; the result is linear light.

use super::laser::Trace;
use super::lit::{Grid, NOTHING, STEP, face_id};
use super::patch::VisiblePlane;
use super::prepare::Stage;
use crate::vec3::V3;

/// Linear light and what was seen where.
pub struct Film {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Light per pixel, full scale 1, not clipped.
    pub light: Vec<V3>,
    /// Face seen at the pixel's middle: `solid * 8 + face`, or [`NOTHING`].
    pub ids: Vec<u16>,
    /// Depth at the pixel's middle, mm; infinite where nothing is.
    pub depth: Vec<f32>,
    /// Stripes at pixels' middles.
    pub traces: Vec<Trace>,
}

/// Columns and rows, from and before which.
pub type Window = [[usize; 2]; 2];

/// Outside of the window one pixel stands for a square of so many by so many.
const COARSE: usize = 4;

/// Renders a stage.
#[must_use]
pub fn expose_film(stage: &Stage<'_>) -> Film {
    expose_film_around(stage, [[0, stage.raster.width], [0, stage.raster.height]])
}

/// Renders a stage finely in a window and, outside of it, as coarsely as a small frame, which saves most of the time there.
#[must_use]
pub fn expose_film_around(stage: &Stage<'_>, window: Window) -> Film {
    let (width, height) = (stage.raster.width, stage.raster.height);
    let coarse = stage.raster.scale() > 1.5;
    let grid = Grid::new(stage);
    let n = width * height;
    let mut film = Film {
        width,
        height,
        light: vec![V3::default(); n],
        ids: vec![NOTHING; n],
        depth: vec![f32::INFINITY; n],
        traces: Vec::new(),
    };
    for (j, top) in (0..height).step_by(STEP).enumerate() {
        for (i, left) in (0..width).step_by(STEP).enumerate() {
            let patch = stage.patch(&grid, i, j);
            let fine = [left, top].iter().zip(window).all(|(at, [from, to])| at + STEP > from && *at < to);
            let block = if fine { 1 } else { COARSE };
            for row in (top..(top + STEP).min(height)).step_by(block) {
                let line = patch.as_ref().map(|p| (p, p.row(row)));
                for column in (left..(left + STEP).min(width)).step_by(block) {
                    let pixel = (column, row);
                    let seen = match &line {
                        Some((patch, line)) => Some(stage.shade_patch(patch, line, pixel, &mut film.traces)),
                        None => single(stage, &grid, pixel, &mut film.traces),
                    };
                    let at = row * width + column;
                    match seen {
                        Some(seen) => {
                            film.light[at] = seen.colour;
                            film.ids[at] = seen.id;
                            film.depth[at] = seen.depth;
                        }
                        None => film.light[at] = stage.nothing(stage.ray(column as f64, row as f64)),
                    }
                    if !fine {
                        film.spread(column, row);
                    }
                }
            }
        }
    }
    smooth_edges(stage, &grid, &mut film, window, if coarse { &TURNED } else { &SQUARE });
    film
}

impl Film {
    /// The square to the right of and below a pixel becomes like it.
    fn spread(&mut self, column: usize, row: usize) {
        let at = row * self.width + column;
        let (light, id, depth) = (self.light[at], self.ids[at], self.depth[at]);
        for y in row..(row + COARSE).min(self.height) {
            let square = y * self.width + column..y * self.width + (column + COARSE).min(self.width);
            self.light[square.clone()].fill(light);
            self.ids[square.clone()].fill(id);
            self.depth[square].fill(depth);
        }
    }
}

/// What one pixel shows, by itself.
fn single(
    stage: &Stage<'_>,
    grid: &Grid,
    pixel: (usize, usize),
    traces: &mut Vec<Trace>,
) -> Option<VisiblePlane> {
    let ray = stage.ray(pixel.0 as f64, pixel.1 as f64);
    let (solid, hit) = stage.cast(ray, pixel.0, pixel.1)?;
    let colour = stage.shade(Some(grid), solid, &hit, ray, pixel, Some(traces));
    Some(VisiblePlane { colour, id: face_id(solid, hit.face), depth: hit.depth })
}

/// A turned square: four samples that see four columns and four rows.
const TURNED: [[f64; 2]; 4] = [[-0.125, -0.375], [0.375, -0.125], [0.125, 0.375], [-0.375, 0.125]];

/// Sixteen samples, one in each column and row of sixteenths.
const SQUARE: [[f64; 2]; 16] = {
    let mut all = [[0.0; 2]; 16];
    let mut i = 0;
    while i < 16 {
        let swapped = (i % 4) * 4 + i / 4; // digits in base four, exchanged
        all[i] = [(i as f64 + 0.5) / 16.0 - 0.5, (swapped as f64 + 0.5) / 16.0 - 0.5];
        i += 1;
    }
    all
};

/// Casts several rays in the pixels of a window where the face changes.
fn smooth_edges(stage: &Stage<'_>, grid: &Grid, film: &mut Film, window: Window, samples: &[[f64; 2]]) {
    let (width, height) = (film.width, film.height);
    let share = 1.0 / samples.len() as f32;
    let mut known = Vec::with_capacity(samples.len() + 1);
    let [columns, rows] = window;
    for row in rows[0]..rows[1].min(height) {
        for column in columns[0]..columns[1].min(width) {
            let at = row * width + column;
            let id = film.ids[at];
            let differs = (column > 0 && film.ids[at - 1] != id)
                || (column + 1 < width && film.ids[at + 1] != id)
                || (row > 0 && film.ids[at - width] != id)
                || (row + 1 < height && film.ids[at + width] != id);
            if !differs {
                continue;
            }
            let mut sum = V3::default();
            // In a small frame a face has one colour within a pixel; in a full one its rounding may not.
            known.clear();
            known.push((id, film.light[at]));
            for [x, y] in samples {
                let ray = stage.ray(column as f64 + x, row as f64 + y);
                let hit = stage.cast(ray, column, row);
                let seen = hit.as_ref().map_or(NOTHING, |(solid, hit)| face_id(*solid, hit.face));
                let colour = match known.iter().find(|k| k.0 == seen && grid.coarse()) {
                    Some((_, colour)) => *colour,
                    None => match hit {
                        Some((solid, hit)) => stage.shade(Some(grid), solid, &hit, ray, (column, row), None),
                        None => stage.nothing(ray),
                    },
                };
                known.push((seen, colour));
                // One glint must not outshine the pixel's other parts.
                sum += clip(colour, 4.0);
            }
            film.light[at] = sum * share;
        }
    }
}

fn clip(c: V3, most: f32) -> V3 {
    V3 { x: c.x.min(most), y: c.y.min(most), z: c.z.min(most) }
}
