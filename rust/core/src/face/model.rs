//! A face as numbers, and what a point of a stripe or of a side says of them: the one model of the joint fit
//! (`rectangle::refine`), of the lasers' drift and of `feasibility`.
//!
//! The plane is q, `q . X = 1`; the ray x meets it at X = x / (q . x). A side with the offset d along the axis e, turned about
//! its middle m on the other axis f by the slope s, is where `e . X + s (f . X - m) = d`, which is
//! **(e + s f - (d + s m) q) . x = 0**: a line of the ideal image, as the stripe of a laser p is, (q - p) . x = 0. Derivatives
//! are analytic; the factor from there to px across the line is taken as constant.

use super::outline::{Across, SIDES, span_mm};
use super::plane_fit::PxView;
use super::raster::PlaneRaster;
use crate::camera::CameraModel;
use crate::frames::{Cam, Plane};
use crate::measurement::FaceMeasurement;
use crate::units::Px;
use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector3};

/// Number of unknowns.
pub(crate) const UNKNOWNS: usize = 11;
/// First of the offsets of the four sides.
pub(crate) const OFFSETS: usize = 4;
/// First of the three that a rectangle does not have.
pub(crate) const SHAPE: usize = 8;
/// Changes of the unknowns: turns about the face's own axes a and b (rad), 1 / distance (1/mm), turn about the normal (rad),
/// offsets of the sides (mm), shape (rad). The first three are those of the plane.
pub(crate) type Unknowns = SVector<f64, UNKNOWNS>;
/// Their covariance.
pub(crate) type Covariance = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Turns of the four sides for the three unknowns of the shape, rad: `turn = TURNS[side] . shape`.
pub(crate) const TURNS: [[f64; 3]; 4] =
    [[-0.5, -0.5, 0.0], [-0.5, 0.5, 0.0], [0.5, 0.0, -0.5], [0.5, 0.0, 0.5]];

/// Where a face is. Its origin is the point of its plane nearest to the camera.
#[derive(Clone, Copy, Debug)]
pub struct FaceState {
    /// Columns: axes a and b of the sides, and the normal away from the camera.
    pub axes: Matrix3<f64>,
    /// 1 / distance of the plane from the camera.
    pub per_mm: f64,
    /// Offsets of the sides at their middles, mm: the two across axis a, low side first, then those across b.
    pub offsets_mm: [f64; 4],
    /// Zero for a rectangle: the angle from sides a to sides b beyond a right one, and the angle between each two opposite
    /// sides.
    pub shape_rad: [f64; 3],
}

/// What a point belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Source {
    /// Index of the laser.
    Stripe(usize),
    /// Index of the side.
    Edge(usize),
}

/// A point of a stripe or of a side.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Observation {
    pub source: Source,
    pub at: Px,
    /// Standard deviation across the stripe or side.
    pub sigma_px: f64,
    view: PxView,
}

impl Observation {
    pub fn new(camera: &CameraModel, source: Source, at: Px, sigma_px: f64) -> Self {
        Self { source, at, sigma_px, view: PxView::new(camera, at) }
    }
}

/// A point against the model.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row {
    pub source: Source,
    pub at: Px,
    /// Residual across the stripe or side.
    pub px: f64,
    pub sigma_px: f64,
    pub derivative_px: Unknowns,
    /// Derivative by the point's ray (x, y, 1).
    pub by_ray_px: Vector3<f64>,
    /// Derivative by the plane of the stripe's laser, px mm; zero for a side.
    pub by_laser_px: Vector3<f64>,
    /// Millimetres across the side per px (edges only).
    pub mm_per_px: f64,
    /// Position along the side from its middle, mm (edges only).
    pub along_mm: f64,
    /// Robust weight, 0 to 1.
    pub robust: f64,
    /// Weight in a fit, 1/px^2.
    pub weight: f64,
}

impl FaceState {
    /// A rectangle with these offsets on a raster.
    pub(crate) fn of_raster(raster: &PlaneRaster, offsets_mm: &[f64; 4]) -> Self {
        let (normal, distance_mm) = raster.plane.normal_and_distance_mm();
        let [a, b] = [raster.axis_a.dot(&raster.origin), raster.axis_b.dot(&raster.origin)];
        let [a0, a1, b0, b1] = offsets_mm;
        Self {
            axes: Matrix3::from_columns(&[raster.axis_a, raster.axis_b, normal]),
            per_mm: 1.0 / distance_mm,
            offsets_mm: [a0 + a, a1 + a, b0 + b, b1 + b],
            shape_rad: [0.0; 3],
        }
    }

    /// A measured face, its corners as they are, with a along its length.
    #[must_use]
    pub fn from_measurement(face: &FaceMeasurement) -> Option<Self> {
        let [c0, c1, ..] = &face.corners;
        let raster = PlaneRaster::along(&face.plane, c0.mm, &(c1.mm - c0.mm))?;
        let [p0, p1, p2, p3] = face.corners.each_ref().map(|c| raster.of_cam(c));
        let offsets_mm = [p3.x + p0.x, p1.x + p2.x, p0.y + p1.y, p2.y + p3.y].map(|sum| 0.5 * sum);
        Some(Self::of_raster(&raster, &offsets_mm))
    }

    /// Coordinates on the face's plane in which its offsets are.
    pub(crate) fn raster(&self) -> PlaneRaster {
        let column = |i: usize| self.axes.column(i).into_owned();
        let origin = column(2) / self.per_mm;
        PlaneRaster { plane: self.plane(), origin, axis_a: column(0), axis_b: column(1) }
    }

    /// The face's plane.
    #[must_use]
    pub fn plane(&self) -> Plane<Cam> {
        Plane::new(self.axes.column(2) * self.per_mm)
    }

    /// Distances of opposite sides across a and across b.
    #[must_use]
    pub fn lengths_mm(&self) -> [f64; 2] {
        let [a0, a1, b0, b1] = self.offsets_mm;
        [(a1 - a0).abs(), (b1 - b0).abs()]
    }

    /// Turn of a side, rad.
    pub(crate) fn turn_rad(&self, side: usize) -> f64 {
        TURNS[side].iter().zip(self.shape_rad).map(|(t, shape)| t * shape).sum()
    }

    /// How much the position along a side adds to its offset: `offset + slope (along - middle)` is the same all along it.
    pub(crate) fn slope(&self, side: usize) -> f64 {
        lever(side) * self.turn_rad(side).tan()
    }

    /// The middle of a side along its direction, about which it turns.
    pub(crate) fn middle_mm(&self, side: usize) -> f64 {
        let (from, to) = span_mm(&self.offsets_mm, side);
        0.5 * (from + to)
    }

    /// The face with its unknowns changed.
    pub(crate) fn plus(&self, change: &Unknowns) -> Self {
        let turn = Rotation3::new(Vector3::new(change[0], change[1], change[3]));
        let mut next = *self;
        next.axes *= turn.matrix();
        next.per_mm += change[2];
        for (value, by) in
            next.offsets_mm.iter_mut().chain(&mut next.shape_rad).zip(change.iter().skip(OFFSETS))
        {
            *value += by;
        }
        next
    }

    /// The lines on which its stripes and sides are seen.
    pub(crate) fn lines(&self, lasers: &[Plane<Cam>; 4]) -> Lines {
        let side = |side: usize| {
            let (slope, middle_mm) = (self.slope(side), self.middle_mm(side));
            let reach_mm = self.offsets_mm[side] + slope * middle_mm;
            let on_axes = SIDES[side].0.at(1.0, slope).push(-reach_mm * self.per_mm);
            SideLine { on_axes, in_camera: self.axes * on_axes, slope, middle_mm, reach_mm }
        };
        Lines {
            axes: self.axes,
            per_mm: self.per_mm,
            stripes: lasers.map(|laser| self.plane().per_mm - laser.per_mm),
            sides: [0, 1, 2, 3].map(side),
        }
    }
}

/// The lines of a face in the ideal image.
pub(crate) struct Lines {
    axes: Matrix3<f64>,
    per_mm: f64,
    stripes: [Vector3<f64>; 4],
    sides: [SideLine; 4],
}

/// The line of a side: `e + s f - (d + s m) q`.
struct SideLine {
    /// In the face's own axes.
    on_axes: Vector3<f64>,
    in_camera: Vector3<f64>,
    slope: f64,
    middle_mm: f64,
    /// `d + s m`.
    reach_mm: f64,
}

impl Lines {
    /// A point against its line. `None` where the model says nothing of it.
    pub fn row(&self, seen: &Observation) -> Option<Row> {
        match seen.source {
            Source::Stripe(laser) => self.stripe_row(laser, seen),
            Source::Edge(side) => self.side_row(side, seen),
        }
    }

    fn stripe_row(&self, laser: usize, seen: &Observation) -> Option<Row> {
        let (mut row, ray) = Row::new(seen, &self.stripes[laser])?;
        let on_axes = self.axes.tr_mul(&ray);
        row.derivative_px[0] = -self.per_mm * on_axes.y;
        row.derivative_px[1] = self.per_mm * on_axes.x;
        row.derivative_px[2] = on_axes.z;
        row.by_laser_px = -ray;
        Some(row)
    }

    fn side_row(&self, side: usize, seen: &Observation) -> Option<Row> {
        let (across, _) = SIDES[side];
        let line = &self.sides[side];
        let (mut row, ray) = Row::new(seen, &line.in_camera)?;
        let on_axes = self.axes.tr_mul(&ray);
        let px_per_mm = self.per_mm * on_axes.z;
        row.mm_per_px = 1.0 / px_per_mm;
        row.along_mm = across.along(on_axes.xy()) * row.mm_per_px - line.middle_mm;
        let turned = line.on_axes.cross(&on_axes);
        let by = &mut row.derivative_px;
        (by[0], by[1], by[3]) = (turned.x, turned.y, turned.z);
        by[2] = -line.reach_mm * on_axes.z;
        // The neighbours' offsets say where the middle is.
        let beside = match across {
            Across::A => OFFSETS + 2,
            Across::B => OFFSETS,
        };
        (by[beside], by[beside + 1]) = (-0.5 * line.slope * px_per_mm, -0.5 * line.slope * px_per_mm);
        by[OFFSETS + side] = -px_per_mm;
        let by_turn = lever(side) * (1.0 + line.slope * line.slope) * row.along_mm * px_per_mm;
        for (by, turn) in by.iter_mut().skip(SHAPE).zip(TURNS[side]) {
            *by = turn * by_turn;
        }
        (row.mm_per_px.is_finite() && row.mm_per_px > 0.0).then_some(row)
    }
}

/// The slope of a side that turns by a small angle is this times the angle.
fn lever(side: usize) -> f64 {
    match SIDES[side].0 {
        Across::A => 1.0,
        Across::B => -1.0,
    }
}

impl Row {
    /// A point against a line `line . x = 0`, without the face's derivatives, and the point's ray times the factor to px.
    fn new(seen: &Observation, line: &Vector3<f64>) -> Option<(Self, Vector3<f64>)> {
        let factor_px = seen.view.factor_px(line)?;
        let ray = seen.view.ray.xy1 * factor_px;
        let row = Self {
            source: seen.source,
            at: seen.at,
            px: line.dot(&ray),
            sigma_px: seen.sigma_px,
            derivative_px: Unknowns::zeros(),
            by_ray_px: line * factor_px,
            by_laser_px: Vector3::zeros(),
            mm_per_px: 0.0,
            along_mm: 0.0,
            robust: 1.0,
            weight: seen.sigma_px.powi(-2),
        };
        Some((row, ray))
    }
}

/// `normal^-1 right` for unknowns of any sizes: they go from 1e-4 to 1e3. `None` if the observations do not fix all.
pub(crate) fn solve<const N: usize, const M: usize>(
    normal: &SMatrix<f64, N, N>,
    right: &SMatrix<f64, N, M>,
) -> Option<SMatrix<f64, N, M>> {
    let units = SMatrix::from_diagonal(&normal.diagonal().map(|n| 1.0 / n.max(1e-300).sqrt()));
    Some(units * (units * normal * units).cholesky()?.solve(&(units * right)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::paper_head::paper_head;
    use proptest::prelude::*;

    /// Five points of each stripe and side, anywhere: the model is no approximation near its lines.
    fn points(camera: &CameraModel) -> Vec<Observation> {
        let sources = (0..4).flat_map(|k| [Source::Stripe(k), Source::Edge(k)]);
        let places = [(1250.0, 960.0), (700.0, 1300.0), (1900.0, 600.0), (1500.0, 1500.0), (900.0, 400.0)];
        let seen = |source| places.map(|(u, v)| Observation::new(camera, source, Px::new(u, v), 0.3));
        sources.flat_map(seen).collect()
    }

    /// The residual over the factor from `line . x` to px, which the model takes as constant.
    fn without_factor(face: &FaceState, camera: &CameraModel, row: &Row) -> (f64, f64) {
        let factor_px = match row.source {
            Source::Stripe(_) => -row.by_laser_px.z,
            Source::Edge(_) => {
                1.0 / (row.mm_per_px * face.plane().inverse_depth_per_mm(&camera.ray_from_px(row.at)))
            }
        };
        (row.px / factor_px, factor_px)
    }

    fn faces() -> impl Strategy<Value = FaceState> {
        let tilt = (-0.6..0.6, -0.6..0.6, 0.0..std::f64::consts::TAU);
        let sizes = (400.0..2000.0f64, prop::array::uniform4(0.1..0.2f64));
        (tilt, sizes, prop::array::uniform3(-0.03..0.03f64)).prop_map(
            |((x, y, angle), (depth_mm, sides), shape_rad)| {
                let plane = Plane::new(Vector3::new(x, y, 1.0) / depth_mm);
                let middle = Vector3::z() * depth_mm;
                let along = Vector3::new(angle.cos(), angle.sin(), 0.0);
                let raster = PlaneRaster::along(&plane, middle, &along).expect("a direction");
                let [a0, a1, b0, b1] = sides.map(|s| s * depth_mm);
                FaceState { shape_rad, ..FaceState::of_raster(&raster, &[-a0, a1, -b0, b1]) }
            },
        )
    }

    #[test]
    fn sides_turn_as_their_shape_says() {
        let turns = |shape_rad: [f64; 3]| {
            let face = FaceState { axes: Matrix3::identity(), per_mm: 1e-3, offsets_mm: [0.0; 4], shape_rad };
            [0, 1, 2, 3].map(|side| face.turn_rad(side))
        };
        // Skewed by 20 mrad, nothing else: sides a turn one way, sides b the other.
        assert_eq!(turns([0.02, 0.0, 0.0]), [-0.01, -0.01, 0.01, 0.01]);
        // Sides 0 and 1 at an angle of 20 mrad to each other.
        assert_eq!(turns([0.0, 0.02, 0.0]), [-0.01, 0.01, 0.0, 0.0]);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// All unknowns of the face, the lasers' and the rays.
        #[test]
        fn derivatives_are_differences_of_the_residual(face in faces()) {
            let calibration = paper_head(1.0);
            let (camera, lasers) = (calibration.camera(), calibration.lasers());
            let steps = [1e-6, 1e-6, 1e-10, 1e-6, 1e-3, 1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6];
            for p in &points(calibration.camera()) {
                let here = face.lines(lasers).row(p).expect("in view");
                let (_, factor_px) = without_factor(&face, camera, &here);
                let px = |face: &FaceState, lasers: &[Plane<Cam>; 4], p: &Observation| {
                    let row = face.lines(lasers).row(p).expect("in view");
                    without_factor(face, camera, &row).0 * factor_px
                };
                let close = |analytic: f64, up_px: f64, down_px: f64, size: f64, what: &str| {
                    let off_px = analytic * size - 0.5 * (up_px - down_px);
                    prop_assert!(off_px.abs() < 1e-5 * (1e-3 + (analytic * size).abs()),
                        "{:?} by {what}: {analytic}, {}", p.source, 0.5 * (up_px - down_px) / size);
                    Ok(())
                };
                for (i, size) in steps.into_iter().enumerate() {
                    let mut step = Unknowns::zeros();
                    step[i] = size;
                    let (up, down) = (face.plus(&step), face.plus(&-step));
                    let (up_px, down_px) = (px(&up, lasers, p), px(&down, lasers, p));
                    close(here.derivative_px[i], up_px, down_px, size, &format!("unknown {i}"))?;
                }
                for k in 0..12 {
                    let moved = |by: f64| {
                        let mut moved = *lasers;
                        moved[k / 3].per_mm[k % 3] += by;
                        px(&face, &moved, p)
                    };
                    let by = if p.source == Source::Stripe(k / 3) { here.by_laser_px[k % 3] } else { 0.0 };
                    close(by, moved(1e-9), moved(-1e-9), 1e-9, &format!("laser plane {k}"))?;
                }
                for axis in 0..2 {
                    let moved = |by: f64| {
                        let mut moved = *p;
                        moved.view.ray.xy1[axis] += by;
                        face.lines(lasers).row(&moved).expect("in view")
                    };
                    // The factor is that of the line, which has not moved.
                    let (up_px, down_px) = (moved(1e-6).px, moved(-1e-6).px);
                    close(here.by_ray_px[axis], up_px, down_px, 1e-6, "the ray")?;
                }
            }
        }

        /// A side's residual in mm is the distance on the plane.
        #[test]
        fn residuals_of_sides_are_offsets_on_the_plane(face in faces()) {
            let calibration = paper_head(1.0);
            for p in &points(calibration.camera()) {
                let Source::Edge(side) = p.source else { continue };
                let row = face.lines(calibration.lasers()).row(p).expect("in view");
                let (across, _) = SIDES[side];
                let on = face.raster().on_plane(&calibration, p.at).expect("in front");
                let along_mm = across.along(on) - face.middle_mm(side);
                let beside_mm = across.offset(on) + face.slope(side) * along_mm - face.offsets_mm[side];
                prop_assert!((row.px * row.mm_per_px - beside_mm).abs() < 1e-8);
                prop_assert!((row.along_mm - along_mm).abs() < 1e-8);
            }
        }
    }
}
