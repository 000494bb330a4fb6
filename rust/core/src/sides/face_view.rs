//! The picture of a face in the face's own plane, as the network of sides sees it.
//!
//! The stripes give the plane before anything else is known. Rectified onto it, a face is a rectangle whatever the head and the pose;
//! turned along the face, its sides are rows and columns. Between the outermost crossings of the stripes the raster is even; outwards
//! its steps grow with the distance, so that a side is seen equally well, relative to the face, wherever it lies, and neighbours far
//! out are still in view.

use crate::calibration::Calibration;
use crate::face::extent::{crossing_px, outermost_crossing_mm};
use crate::face::outline::{Across, SIDES, outward_sign};
use crate::face::raster::{OnPlane, PlaneRaster};
use crate::frames::{Cam, Plane, Point};
use crate::image::small::SmallPicture;
use crate::units::{LaserId, Px};
use crate::view::{BINS, CELLS, FaceView, INNER, VIEW};
use nalgebra::Vector3;

/// A bin at distance d from the crossing is (d + FINEST * grid) / PER_STEP wide: 1 % of the face or so everywhere.
const FINEST: f64 = 0.5;
const PER_STEP: f64 = 64.0;
/// Height above the plane of the second line of each stripe: what stands in front of a face is seen by it.
const NEARER_MM: f64 = 50.0;
/// Standard deviation of a drawn stripe, cells, and how many of them away it is nothing: less than a tenth of a byte's step.
const DRAWN_CELLS: f64 = 0.8;
const DRAWN_TO: f64 = 4.0;
/// Cells between places that are projected exactly; between them straight lines are off by a thirtieth of a cell.
const NODE: usize = 4;

/// Coordinates of a view: which place of the plane each cell shows. Sides: low and high a (across stripes 1 and 2's run), low and high
/// b.
#[derive(Clone, Copy, Debug)]
pub struct ViewAxes {
    raster: PlaneRaster,
    /// Offsets of the outermost crossings, mm, in the order of the sides.
    inner_mm: [f64; 4],
    /// Mean size of the grid, mm.
    grid_mm: f64,
}

impl ViewAxes {
    /// Axes along a direction of the camera frame, which is that of the sides that stripes 1 and 2 run along. `None` if the stripes
    /// do not cross on the plane in front of the camera.
    #[must_use]
    pub fn along(calibration: &Calibration, plane: &Plane<Cam>, direction: &Vector3<f64>) -> Option<Self> {
        let [l1, _, l3, _] = LaserId::ALL;
        let at = crossing_px(calibration, plane, l1, l3)?;
        let origin = plane.intersect(&calibration.camera().ray_from_px(at))?;
        Self::of(calibration, PlaneRaster::along(plane, origin.mm, direction)?)
    }

    /// Axes of a raster that is turned along the face.
    pub(crate) fn of(calibration: &Calibration, raster: PlaneRaster) -> Option<Self> {
        let mut inner_mm = [0.0; 4];
        for (side, inner_mm) in inner_mm.iter_mut().enumerate() {
            *inner_mm = outward_sign(side) * outermost_crossing_mm(calibration, &raster, SIDES[side])?;
        }
        let grid_mm = 0.5 * (inner_mm[1] - inner_mm[0] + inner_mm[3] - inner_mm[2]);
        let sound = grid_mm.is_finite() && inner_mm[1] > inner_mm[0] && inner_mm[3] > inner_mm[2];
        sound.then_some(Self { raster, inner_mm, grid_mm })
    }

    /// Coordinates of a point of the plane along both axes, mm.
    #[must_use]
    pub fn on_plane_mm(&self, point: &Point<Cam>) -> [f64; 2] {
        let at = self.raster.of_cam(point);
        [at.x, at.y]
    }

    /// Where a pixel sees the plane, along both axes, mm.
    #[must_use]
    pub fn px_on_plane_mm(&self, calibration: &Calibration, px: Px) -> Option<[f64; 2]> {
        self.raster.on_plane(calibration, px).map(|at| [at.x, at.y])
    }

    /// In which bin a side at an offset is; below 0 if it is inside the crossings.
    #[must_use]
    pub fn bin(&self, side: usize, offset_mm: f64) -> f64 {
        let beyond = outward_sign(side) * (offset_mm - self.inner_mm[side]);
        let finest = FINEST * self.grid_mm;
        if beyond < 0.0 { beyond / finest } else { PER_STEP * (beyond / finest).ln_1p() }
    }

    /// The inverse of [`Self::bin`].
    #[must_use]
    pub fn offset_mm(&self, side: usize, bin: f64) -> f64 {
        self.inner_mm[side] + outward_sign(side) * FINEST * self.grid_mm * (bin / PER_STEP).exp_m1()
    }

    /// Bounds of the cells along an axis, mm.
    fn bounds_mm(&self, across: Across) -> Vec<f64> {
        let (low, high) = if across == Across::A { (0, 1) } else { (2, 3) };
        let (from, to) = (self.inner_mm[low], self.inner_mm[high]);
        let outer_low = (1..=BINS).rev().map(|bin| self.offset_mm(low, bin as f64));
        let inner = (0..=INNER).map(|i| from + (to - from) * i as f64 / INNER as f64);
        let outer_high = (1..=BINS).map(|bin| self.offset_mm(high, bin as f64));
        outer_low.chain(inner).chain(outer_high).collect()
    }

    /// The face of a picture in its own plane.
    #[must_use]
    pub fn view(&self, picture: &SmallPicture, calibration: &Calibration) -> FaceView {
        FaceView { values: values(picture, calibration, self) }
    }
}

fn values(picture: &SmallPicture, calibration: &Calibration, axes: &ViewAxes) -> Vec<f32> {
    let sensor = [f64::from(calibration.width_px()), f64::from(calibration.height_px())];
    let (a, b) = (axes.bounds_mm(Across::A), axes.bounds_mm(Across::B));
    let row_of_nodes = |b: f64| -> Vec<Option<Px>> {
        a.iter().step_by(NODE).map(|a| axes.raster.pixel(calibration, OnPlane::new(*a, b))).collect()
    };
    let nodes: Vec<Vec<Option<Px>>> = b.iter().step_by(NODE).map(|b| row_of_nodes(*b)).collect();
    let between = |p: Option<Px>, q: Option<Px>, w: f64| {
        let (p, q) = (p?, q?);
        Some(Px::new(p.u + (q.u - p.u) * w, p.v + (q.v - p.v) * w))
    };
    let share = |i: usize| (i % NODE) as f64 / NODE as f64;
    // The pixels of a row of corners.
    let row_of_px = |row: usize| -> Vec<Option<Px>> {
        let (upper, lower) = (&nodes[row / NODE], &nodes[(row / NODE + 1).min(nodes.len() - 1)]);
        let at_node: Vec<_> = upper.iter().zip(lower).map(|(p, q)| between(*p, *q, share(row))).collect();
        (0..=CELLS)
            .map(|i| between(at_node[i / NODE], at_node[(i / NODE + 1).min(at_node.len() - 1)], share(i)))
            .collect()
    };
    let stripes = Stripes::new(calibration, &axes.raster.plane);
    let plane = CELLS * CELLS;
    let mut values = vec![0.0; VIEW[0] * plane];
    let mut upper = row_of_px(0);
    for (row, b) in b.windows(2).enumerate() {
        let lower = row_of_px(row + 1);
        for (column, a) in a.windows(2).enumerate() {
            let corners = [upper[column], upper[column + 1], lower[column], lower[column + 1]];
            let [Some(p), Some(q), Some(r), Some(s)] = corners else { continue };
            let Some(colour) = mean_colour(picture, sensor, [p, q, r, s]) else { continue };
            let middle = OnPlane::new(0.5 * (a[0] + a[1]), 0.5 * (b[0] + b[1]));
            let lines = stripes.drawn(&axes.raster.cam_point(middle), [a[1] - a[0], b[1] - b[0]]);
            for (channel, value) in colour.into_iter().chain(lines).enumerate() {
                values[channel * plane + row * CELLS + column] = value;
            }
        }
        upper = lower;
    }
    values
}

/// The mean of a cell's four quarters; `None` if the middle of one is outside the picture.
fn mean_colour(picture: &SmallPicture, sensor: [f64; 2], [p, q, r, s]: [Px; 4]) -> Option<[f32; 3]> {
    let mut sum = [0.0; 3];
    for (x, y) in [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)] {
        let mix = |p: f64, q: f64, r: f64, s: f64| {
            (p * (1.0 - x) + q * x) * (1.0 - y) + (r * (1.0 - x) + s * x) * y
        };
        let at = Px::new(mix(p.u, q.u, r.u, s.u), mix(p.v, q.v, r.v, s.v));
        let colour = picture.at(sensor, at)?;
        sum.iter_mut().zip(colour).for_each(|(sum, value)| *sum += 0.25 * value);
    }
    Some(sum)
}

/// Where the stripes lie on a plane, and would lie on one a little nearer.
struct Stripes {
    /// Laser planes, 1/mm.
    lasers: [Vector3<f64>; 4],
    /// Length of each laser plane's vector along the face's plane, 1/mm.
    along_face: [f64; 4],
    /// A point of the plane is seen where the same ray meets the nearer plane, at this share of the distance.
    nearer: f64,
}

impl Stripes {
    fn new(calibration: &Calibration, plane: &Plane<Cam>) -> Self {
        let (normal, distance_mm) = plane.normal_and_distance_mm();
        let lasers = LaserId::ALL.map(|id| calibration.laser(id).per_mm);
        let along_face = lasers.map(|p| (p - normal * normal.dot(&p)).norm().max(1e-12));
        Self { lasers, along_face, nearer: 1.0 - (NEARER_MM / distance_mm).min(0.5) }
    }

    /// How much of a stripe of each pair is at a point whose cell has the size `[a, b]` mm.
    fn drawn(&self, point: &Point<Cam>, cell_mm: [f64; 2]) -> [f32; 2] {
        [0, 1].map(|pair| {
            // Stripes 1 and 2 run along a: their breadth is along b.
            let cell_mm = cell_mm[1 - pair];
            let mut most = 0.0f64;
            for laser in [2 * pair, 2 * pair + 1] {
                let at = self.lasers[laser].dot(&point.mm);
                for (value, here) in [(1.0, 1.0), (0.5, 1.0 / self.nearer)] {
                    let off = (here - at) / self.along_face[laser] / (DRAWN_CELLS * cell_mm);
                    if off.abs() < DRAWN_TO {
                        most = most.max(value * (-0.5 * off * off).exp());
                    }
                }
            }
            most as f32
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::paper_head::paper_head;
    use proptest::prelude::*;

    /// A face 1 m away, tilted, turned by 40 degrees against the picture.
    fn axes(calibration: &Calibration) -> ViewAxes {
        let plane = Plane::new(Vector3::new(0.2, -0.1, 1.0) * 1e-3);
        ViewAxes::along(calibration, &plane, &Vector3::new(1.0, 1.0, 0.0)).expect("the stripes cross there")
    }

    proptest! {
        #[test]
        fn a_bin_and_its_offset_lead_back(side in 0usize..4, bin in 0.0..112.0f64) {
            let axes = axes(&paper_head(1.0));
            let offset_mm = axes.offset_mm(side, bin);
            prop_assert!((axes.bin(side, offset_mm) - bin).abs() < 1e-9);
            prop_assert!(outward_sign(side) * (axes.offset_mm(side, bin + 1.0) - offset_mm) > 0.0);
        }
    }

    #[test]
    fn a_rectangle_of_the_plane_is_one_of_the_view_and_stripes_lie_where_they_are_drawn() {
        let calibration = paper_head(1.0);
        let axes = axes(&calibration);
        let size = [512, 384];
        let sensor = [f64::from(calibration.width_px()), f64::from(calibration.height_px())];
        let bounds = [0, 1, 2, 3].map(|side| axes.offset_mm(side, 25.0));
        // Bright where the face is.
        let mut rgb = vec![0.1f32; 3 * size[0] * size[1]];
        for y in 0..size[1] {
            for x in 0..size[0] {
                let px = Px::new(
                    (x as f64 + 0.5) * sensor[0] / size[0] as f64 - 0.5,
                    (y as f64 + 0.5) * sensor[1] / size[1] as f64 - 0.5,
                );
                let Some([a, b]) = axes.px_on_plane_mm(&calibration, px) else { continue };
                if a > bounds[0] && a < bounds[1] && b > bounds[2] && b < bounds[3] {
                    (0..3).for_each(|c| rgb[c * size[0] * size[1] + y * size[0] + x] = 0.8);
                }
            }
        }
        let view = axes.view(&SmallPicture { size, rgb: &rgb }, &calibration);
        let at =
            |channel: usize, row: usize, column: usize| view.values[(channel * CELLS + row) * CELLS + column];
        let (low, high) = (BINS - 25, BINS + INNER + 25);
        for k in [low + 4, CELLS / 2, high - 5] {
            for (inside, outside) in [([k, low + 3], [k, low - 4]), ([high - 4, k], [high + 3, k])] {
                assert!(at(1, inside[0], inside[1]) > 0.75, "{inside:?} is on the face");
                assert!((at(1, outside[0], outside[1]) - 0.1).abs() < 0.05, "{outside:?} is beside it");
            }
        }
        // Between the crossings both stripes of each pair are drawn from side to side.
        let brightest = |pair: usize| {
            let inner = BINS..BINS + INNER;
            inner
                .clone()
                .flat_map(|row| inner.clone().map(move |column| (row, column)))
                .filter(|(row, column)| at(3 + pair, *row, *column) > 0.9)
                .count()
        };
        assert!(brightest(0) > INNER && brightest(1) > INNER);
    }
}
