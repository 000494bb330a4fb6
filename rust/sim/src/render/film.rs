//! Casts the rays of a frame: one a pixel, a finer grid where faces meet; the result is linear light.

use super::laser::Trace;
use super::lit::{Grid, NOTHING, face_id};
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

/// Renders a stage.
#[must_use]
pub fn expose_film(stage: &Stage<'_>) -> Film {
    let (width, height) = (stage.raster.width, stage.raster.height);
    let coarse = stage.raster.scale() > 1.5;
    let grid = Grid::new(stage);
    let n = width * height;
    let mut film = Film {
        width,
        height,
        light: Vec::with_capacity(n),
        ids: Vec::with_capacity(n),
        depth: Vec::with_capacity(n),
        traces: Vec::new(),
    };
    for row in 0..height {
        for column in 0..width {
            let ray = stage.ray(column as f64, row as f64);
            let (colour, id, depth) = match stage.cast(ray, column, row) {
                Some((solid, hit)) => {
                    let colour = stage.shade(&grid, solid, &hit, ray, (column, row), Some(&mut film.traces));
                    (colour, face_id(solid, hit.face), hit.depth)
                }
                None => (stage.nothing(ray), NOTHING, f32::INFINITY),
            };
            film.light.push(colour);
            film.ids.push(id);
            film.depth.push(depth);
        }
    }
    smooth_edges(stage, &grid, &mut film, if coarse { &TURNED } else { &SQUARE });
    film
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

/// Casts several rays in the pixels where the face changes.
fn smooth_edges(stage: &Stage<'_>, grid: &Grid, film: &mut Film, samples: &[[f64; 2]]) {
    let (width, height) = (film.width, film.height);
    let share = 1.0 / samples.len() as f32;
    for row in 0..height {
        for column in 0..width {
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
            for [x, y] in samples {
                let ray = stage.ray(column as f64 + x, row as f64 + y);
                let colour = match stage.cast(ray, column, row) {
                    Some((solid, hit)) => stage.shade(grid, solid, &hit, ray, (column, row), None),
                    None => stage.nothing(ray),
                };
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
