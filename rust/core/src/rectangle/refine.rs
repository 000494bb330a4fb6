//! The joint fit: a rectangle on a plane (plane 3, direction 1, four side offsets: 8 unknowns) to all stripe centres and
//! all edge points at once, in pixels, robust (PHYSICS.md, "Face fit"); with right angles relaxed it has 3 unknowns more.
//! What its residuals say of the face is in [`super::self_check`], what it means for sigma in [`super::uncertainty`].

use crate::calibration::Calibration;
use crate::edges::EdgePoint;
use crate::face::outline::{Across, RoughRectangle, SIDES, span_mm};
use crate::face::plane_fit::{PxView, StripeObservation, residual_px};
use crate::face::raster::{OnPlane, PlaneRaster};
use crate::frames::{Cam, Plane, Ray};
use crate::units::Px;
use nalgebra::{SMatrix, SVector, Vector3};

/// Number of unknowns.
pub(crate) const UNKNOWNS: usize = 11;
/// First of the offsets of the four sides.
pub(crate) const OFFSETS: usize = 4;
/// First of the three that a rectangle does not have.
pub(crate) const SHAPE: usize = 8;
/// Unknowns: plane (3, 1/mm), direction (rad), offsets of the four sides at their middles (mm); then, zero for a rectangle,
/// the angle from sides a to sides b beyond a right one and the angle between each two opposite sides (rad).
pub(crate) type Params = SVector<f64, UNKNOWNS>;
/// Their covariance.
pub(crate) type Covariance = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// What the four sides may form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Shape {
    Rectangle,
    /// `--free`: any four straight sides.
    Quadrilateral,
}

impl Shape {
    fn unknowns(self) -> usize {
        match self {
            Self::Rectangle => SHAPE,
            Self::Quadrilateral => UNKNOWNS,
        }
    }
}

/// Two pixels that fix the raster's origin and axis for every plane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Anchor {
    pub at: Px,
    pub towards: Px,
}

/// A fitted face.
#[derive(Clone, Debug)]
pub(crate) struct FittedRectangle {
    pub raster: PlaneRaster,
    /// Offsets of the sides, mm, in the order of [`SIDES`].
    pub offsets_mm: [f64; 4],
    pub params: Params,
    /// Of the noise alone.
    pub covariance: Covariance,
    /// Root mean square of all residuals that count, px.
    pub rms_px: f64,
    /// ... of the edges alone.
    pub edge_rms_px: f64,
    /// Which edge points count.
    pub edge_inliers: [Vec<bool>; 4],
    /// All observations at the solution.
    pub rows: Vec<Row>,
    /// Middle of each side along its direction, about which it turns, mm.
    middles_mm: [f64; 4],
}

impl FittedRectangle {
    /// Where a side of the raster's first direction (0, 1) meets one of the second (2, 3), with other offsets than the
    /// fit's own if they were corrected since.
    pub fn corner(&self, side_a: usize, side_b: usize) -> OnPlane {
        let slope = |side: usize| -lever(side) * turn_rad(&self.params, side).tan();
        let (ta, tb) = (slope(side_a), slope(side_b));
        // a = offset_a + ta (b - middle_a), b = offset_b + tb (a - middle_b)
        let (oa, ob) = (self.offsets_mm[side_a], self.offsets_mm[side_b]);
        let (ma, mb) = (self.middles_mm[side_a], self.middles_mm[side_b]);
        let a = (oa + ta * (ob - tb * mb - ma)) / (1.0 - ta * tb);
        OnPlane::new(a, ob + tb * (a - mb))
    }
}

/// Tukey's constant: 95 % efficiency for normal residuals.
const TUKEY: f64 = 4.685;
pub(crate) const ITERATIONS: usize = 12;
/// Neighbouring edge points share print, shadow and rounding: about one in so many is independent, where the residuals
/// cannot tell.
const EDGE_CORRELATION: f64 = 4.0;
/// The same for stripe points (texture, after speckle is averaged in the block).
const STRIPE_CORRELATION: f64 = 2.0;
/// So many observations tell the correlation as well as what is known beforehand.
const CORRELATION_PRIOR: f64 = 30.0;
/// Neighbours up to this distance can be correlated; beyond it the estimate is noise alone.
const MOST_NEIGHBOURS: usize = 12;

/// The observations and the coordinates in which they are compared.
pub(crate) struct Problem<'a> {
    pub calibration: &'a Calibration,
    pub stripes: &'a [StripeObservation],
    pub edges: &'a [Vec<EdgePoint>; 4],
    pub anchor: Anchor,
    /// Middle of each side along its direction, about which it turns, mm.
    pub middles_mm: [f64; 4],
    /// What the face's bow adds to the residual of each stripe point, px; empty for a flat face.
    pub bow_px: &'a [f64],
}

/// What a residual belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Source {
    /// Index of the laser.
    Stripe(usize),
    /// Index of the side.
    Edge(usize),
}

/// The unknowns on which a residual depends.
pub(super) fn unknowns_of(source: Source) -> &'static [usize] {
    match source {
        Source::Stripe(_) => &[0, 1, 2],
        Source::Edge(0) => &[0, 1, 2, 3, 4, 8, 9, 10],
        Source::Edge(1) => &[0, 1, 2, 3, 5, 8, 9, 10],
        Source::Edge(2) => &[0, 1, 2, 3, 6, 8, 9, 10],
        Source::Edge(_) => &[0, 1, 2, 3, 7, 8, 9, 10],
    }
}

/// One observation against the model.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row {
    pub source: Source,
    pub at: Px,
    /// Residual across the stripe or side.
    pub px: f64,
    pub sigma_px: f64,
    pub derivative_px: Params,
    /// Millimetres across the side per px (edges only).
    pub mm_per_px: f64,
    /// Position along the side from its middle, mm (edges only).
    pub along_mm: f64,
    /// Robust weight, 0 to 1.
    pub robust: f64,
    /// Weight in the fit: robust weight over variance, correlated neighbours counted once, 1/px^2.
    pub weight: f64,
}

/// Turns of the four sides for the three unknowns of the shape, rad: `turn = TURNS[side] . shape`.
pub(crate) const TURNS: [[f64; 3]; 4] =
    [[-0.5, -0.5, 0.0], [-0.5, 0.5, 0.0], [0.5, 0.0, -0.5], [0.5, 0.0, 0.5]];

/// Turn of a side, rad.
pub(crate) fn turn_rad(params: &Params, side: usize) -> f64 {
    TURNS[side].iter().zip(params.iter().skip(SHAPE)).map(|(t, p)| t * p).sum()
}

/// The offset of a side that turns by +1 rad about its middle changes by this, per mm along it.
pub(crate) fn lever(side: usize) -> f64 {
    match SIDES[side].0 {
        Across::A => 1.0,
        Across::B => -1.0,
    }
}

impl<'a> Problem<'a> {
    fn raster(&self, params: &Params) -> Option<PlaneRaster> {
        self.raster_in(self.calibration, params)
    }

    /// The raster as another calibration has it.
    pub fn raster_in(&self, calibration: &Calibration, params: &Params) -> Option<PlaneRaster> {
        let plane = Plane::new(Vector3::new(params[0], params[1], params[2]));
        Some(PlaneRaster::new(calibration, &plane, self.anchor.at, self.anchor.towards)?.turned(params[3]))
    }

    /// Offset of an edge pixel from its side, mm.
    pub fn beside_mm(
        &self,
        calibration: &Calibration,
        raster: &PlaneRaster,
        params: &Params,
        side: usize,
        at: Px,
    ) -> Option<f64> {
        let slope = lever(side) * turn_rad(params, side).tan();
        Some(self.beside_and_along_mm(raster, params, side, slope, &calibration.camera().ray_from_px(at))?.0)
    }

    /// Offset of a ray from its side, which changes by `slope` along it, and its place along the side from the middle, mm.
    fn beside_and_along_mm(
        &self,
        raster: &PlaneRaster,
        params: &Params,
        side: usize,
        slope: f64,
        ray: &Ray<Cam>,
    ) -> Option<(f64, f64)> {
        let (across, _) = SIDES[side];
        let on = raster.of_ray(ray)?;
        let along = across.along(on) - self.middles_mm[side];
        Some((across.offset(on) + slope * along - params[OFFSETS + side], along))
    }

    /// The unknowns with each side where half of its points lie on either side of it: Tukey's weights settle on those points that
    /// lie near where they begin, and a rough side may be some px beside its edge.
    pub fn at_medians(&self, params: &Params) -> Option<Params> {
        let raster = self.raster(params)?;
        let mut moved = *params;
        for (side, points) in self.edges.iter().enumerate() {
            let mut beside_mm: Vec<f64> = points
                .iter()
                .filter_map(|p| self.beside_mm(self.calibration, &raster, params, side, p.at))
                .collect();
            if !beside_mm.is_empty() {
                let middle = beside_mm.len() / 2;
                moved[OFFSETS + side] += *beside_mm.select_nth_unstable_by(middle, f64::total_cmp).1;
            }
        }
        Some(moved)
    }

    fn stripe_row(&self, plane: &Plane<Cam>, o: &StripeObservation, view: &PxView) -> Option<Row> {
        let (px, per) = residual_px(self.calibration, plane, o.laser, view)?;
        let mut derivative_px = Params::zeros();
        derivative_px.fixed_rows_mut::<3>(0).copy_from(&(view.ray.xy1 * per));
        Some(Row {
            source: Source::Stripe(o.laser.index()),
            at: o.at,
            px,
            sigma_px: o.sigma_px,
            derivative_px,
            mm_per_px: 0.0,
            along_mm: 0.0,
            robust: 1.0,
            weight: 0.0,
        })
    }

    fn edge_row(
        &self,
        params: &Params,
        rasters: &Rasters,
        (side, slope): (usize, f64),
        p: &EdgePoint,
        cross: &Cross,
    ) -> Option<Row> {
        let beside =
            |raster: &PlaneRaster, ray: &Ray<Cam>| self.beside_and_along_mm(raster, params, side, slope, ray);
        let (here, along_mm) = beside(&rasters.here, &cross.middle)?;
        // Millimetres of offset per pixel across the side, from the raster itself.
        let [right, left, down, up] = &cross.around;
        let right = beside(&rasters.here, right)?.0 - beside(&rasters.here, left)?.0;
        let down = beside(&rasters.here, down)?.0 - beside(&rasters.here, up)?.0;
        let mm_per_px = right.hypot(down).max(1e-9);
        let mut derivative_px = Params::zeros();
        for (i, (raster, step)) in rasters.moved.iter().enumerate() {
            derivative_px[i] = (beside(raster, &cross.middle)?.0 - here) / step / mm_per_px;
        }
        derivative_px[OFFSETS + side] = -1.0 / mm_per_px;
        for (i, turn) in TURNS[side].iter().enumerate() {
            derivative_px[SHAPE + i] = turn * lever(side) * along_mm / mm_per_px;
        }
        Some(Row {
            source: Source::Edge(side),
            at: p.at,
            px: here / mm_per_px,
            sigma_px: p.sigma_px,
            derivative_px,
            mm_per_px,
            along_mm,
            robust: 1.0,
            weight: 0.0,
        })
    }

    /// All observations at these unknowns, weighted.
    fn rows(&self, params: &Params, seen: &Seen) -> Option<Vec<Row>> {
        let rasters = Rasters::new(self, params)?;
        let plane = Plane::new(Vector3::new(params[0], params[1], params[2]));
        let edges = self.edges.iter().map(Vec::len).sum::<usize>();
        let mut rows: Vec<Row> = Vec::with_capacity(self.stripes.len() + edges);
        for (o, view) in self.stripes.iter().zip(&seen.stripes) {
            rows.push(self.stripe_row(&plane, o, view)?);
        }
        for (row, bow_px) in rows.iter_mut().zip(self.bow_px) {
            row.px -= bow_px;
        }
        for (side, (points, crosses)) in self.edges.iter().zip(&seen.edges).enumerate() {
            let slope = lever(side) * turn_rad(params, side).tan();
            for (p, cross) in points.iter().zip(crosses) {
                rows.push(self.edge_row(params, &rasters, (side, slope), p, cross)?);
            }
        }
        weigh_all(&mut rows);
        Some(rows)
    }
}

/// The rays of all observations, which no unknown changes.
struct Seen {
    stripes: Vec<PxView>,
    edges: [Vec<Cross>; 4],
}

/// The ray of an edge point and those half a pixel to its right, left, below and above.
struct Cross {
    middle: Ray<Cam>,
    around: [Ray<Cam>; 4],
}

impl Seen {
    fn new(problem: &Problem) -> Self {
        let camera = problem.calibration.camera();
        let ray = |at: Px, du: f64, dv: f64| camera.ray_from_px(Px::new(at.u + du, at.v + dv));
        Self {
            stripes: problem.stripes.iter().map(|o| PxView::new(problem.calibration, o.at)).collect(),
            edges: problem.edges.each_ref().map(|points| {
                let cross = |p: &EdgePoint| Cross {
                    middle: ray(p.at, 0.0, 0.0),
                    around: [(0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5)]
                        .map(|(du, dv)| ray(p.at, du, dv)),
                };
                points.iter().map(cross).collect()
            }),
        }
    }
}

/// The raster at the parameters and moved a little along each of the first four.
struct Rasters {
    here: PlaneRaster,
    moved: [(PlaneRaster, f64); 4],
}

impl Rasters {
    fn new(problem: &Problem, params: &Params) -> Option<Self> {
        let size = params.fixed_rows::<3>(0).norm();
        let moved = [0, 1, 2, 3].map(|i| {
            let step = if i < 3 { 1e-6 * size } else { 1e-7 };
            let mut p = *params;
            p[i] += step;
            Some((problem.raster(&p)?, step))
        });
        let [a, b, c, d] = moved;
        Some(Self { here: problem.raster(params)?, moved: [a?, b?, c?, d?] })
    }
}

/// Weighs stripes, which come first, and edges.
pub(super) fn weigh_all(rows: &mut [Row]) {
    let stripes = rows.partition_point(|r| matches!(r.source, Source::Stripe(_)));
    let (stripe_rows, edge_rows) = rows.split_at_mut(stripes);
    weigh(stripe_rows, STRIPE_CORRELATION);
    weigh(edge_rows, EDGE_CORRELATION);
}

/// Robust weights in units of the rows' own scatter; neighbours that say the same count once.
fn weigh(rows: &mut [Row], usual_correlation: f64) {
    let scale = robust_scale(rows);
    for row in rows.iter_mut() {
        let t = row.px / (row.sigma_px * scale * TUKEY);
        row.robust = (1.0 - t * t).max(0.0).powi(2);
    }
    let correlation = correlation(rows, usual_correlation);
    for row in rows.iter_mut() {
        row.weight = row.robust / ((row.sigma_px * scale).powi(2) * correlation);
    }
}

/// How many neighbouring residuals say as much as one independent one: `1 + 2 (rho_1 + rho_2 + ...)`, summed until rho is
/// lost in its own noise, and drawn towards what is usual where there are few. Never below 1.
fn correlation(rows: &[Row], usual: f64) -> f64 {
    let units: Vec<f64> = rows.iter().map(|r| r.px / r.sigma_px * r.robust.sqrt()).collect();
    let count = rows.len() as f64;
    let power: f64 = units.iter().map(|u| u * u).sum();
    if power <= 0.0 {
        return usual;
    }
    let mut sum = 1.0;
    for distance in 1..=MOST_NEIGHBOURS {
        let of_runs = rows.chunk_by(|a, b| a.source == b.source).scan(0, |end, run| {
            *end += run.len();
            let units = &units[*end - run.len()..*end];
            Some(units.iter().zip(units.iter().skip(distance)).map(|(a, b)| a * b).sum::<f64>())
        });
        let rho = of_runs.sum::<f64>() / power;
        if rho < 2.0 / count.sqrt() {
            break;
        }
        sum += 2.0 * rho;
    }
    ((count * sum + CORRELATION_PRIOR * usual) / (count + CORRELATION_PRIOR)).max(1.0)
}

/// Fits the face. `None` if the observations do not fix all its unknowns.
pub(crate) fn refine(
    problem: &Problem,
    start: &Params,
    shape: Shape,
    iterations: usize,
) -> Option<FittedRectangle> {
    let mut params = *start;
    let mut covariance = Covariance::zeros();
    let seen = Seen::new(problem);
    let mut rows = problem.rows(&params, &seen)?;
    for _ in 0..iterations {
        let mut normal = Covariance::zeros();
        let mut right = Params::zeros();
        for row in rows.iter().filter(|r| r.robust > 0.0) {
            let unknowns = unknowns_of(row.source);
            for &a in unknowns {
                let weighted = row.derivative_px[a] * row.weight;
                for &b in unknowns {
                    normal[(b, a)] += row.derivative_px[b] * weighted;
                }
                right[a] -= weighted * row.px;
            }
        }
        covariance = inverse(&normal, shape)?;
        let step = covariance * right;
        params += step;
        rows = problem.rows(&params, &seen)?;
        if step.component_div(&covariance.diagonal().map(|c| c.max(0.0).sqrt().max(1e-300))).amax() < 1e-3 {
            break;
        }
    }
    let raster = problem.raster(&params)?;
    let rms = |edges_only: bool| {
        let counted = rows.iter().filter(|r| !edges_only || matches!(r.source, Source::Edge(_)));
        let (sum, count) = counted.fold((0.0, 0.0), |(s, n), r| (s + r.robust * r.px * r.px, n + r.robust));
        (sum / f64::max(count, 1.0)).sqrt()
    };
    let edge_inliers = [0, 1, 2, 3]
        .map(|side| rows.iter().filter(|r| r.source == Source::Edge(side)).map(|r| r.robust > 0.1).collect());
    let (rms_px, edge_rms_px) = (rms(false), rms(true));
    params.iter().all(|p| p.is_finite()).then_some(FittedRectangle {
        raster,
        offsets_mm: [params[4], params[5], params[6], params[7]],
        params,
        covariance,
        rms_px,
        edge_rms_px,
        edge_inliers,
        rows,
        middles_mm: problem.middles_mm,
    })
}

/// Inverse of the normal matrix over the unknowns of a shape; zero for the others.
pub(crate) fn inverse(normal: &Covariance, shape: Shape) -> Option<Covariance> {
    let free = |i: usize| i < shape.unknowns();
    // The unknowns have sizes from 1e-4 to 1e3: scale before solving.
    let units = Params::from_fn(|i, _| if free(i) { 1.0 / normal[(i, i)].max(1e-300).sqrt() } else { 0.0 });
    let mut scaled = Covariance::from_diagonal(&units) * normal * Covariance::from_diagonal(&units);
    for i in (0..UNKNOWNS).filter(|i| !free(*i)) {
        scaled[(i, i)] = 1.0;
    }
    let inverse = scaled.cholesky()?.inverse();
    Some(Covariance::from_diagonal(&units) * inverse * Covariance::from_diagonal(&units))
}

fn robust_scale(rows: &[Row]) -> f64 {
    if rows.is_empty() {
        return 1.0;
    }
    let mut sizes: Vec<f64> = rows.iter().map(|r| (r.px / r.sigma_px).abs()).collect();
    let middle = sizes.len() / 2;
    (*sizes.select_nth_unstable_by(middle, f64::total_cmp).1 / 0.6745).max(0.5)
}

/// Middles of the four sides along their directions, mm.
pub(crate) fn middles_mm(params: &Params) -> [f64; 4] {
    let offsets_mm = [params[4], params[5], params[6], params[7]];
    [0, 1, 2, 3].map(|side| {
        let (from, to) = span_mm(&offsets_mm, side);
        0.5 * (from + to)
    })
}

/// The unknowns of a rough rectangle.
pub(crate) fn start_from(
    calibration: &Calibration,
    rough: &RoughRectangle,
    anchor: Anchor,
) -> Option<Params> {
    let q = rough.raster.plane.per_mm;
    let base = PlaneRaster::new(calibration, &rough.raster.plane, anchor.at, anchor.towards)?;
    // The rough raster has the same origin; its angle is that of its a axis in the base raster.
    let origin = rough.raster.cam_point(nalgebra::Vector2::zeros());
    let tip = rough.raster.cam_point(nalgebra::Vector2::new(1.0, 0.0));
    let (o, t) = (base.of_cam(&origin), base.of_cam(&tip));
    let direction = t - o;
    let angle = direction.y.atan2(direction.x);
    let (s, c) = angle.sin_cos();
    let shift = nalgebra::Vector2::new(o.x * c + o.y * s, o.y * c - o.x * s);
    let [a0, a1, b0, b1] = rough.offsets_mm;
    Some(Params::from_column_slice(&[
        q.x,
        q.y,
        q.z,
        angle,
        a0 + shift.x,
        a1 + shift.x,
        b0 + shift.y,
        b1 + shift.y,
        0.0,
        0.0,
        0.0,
    ]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Residuals of one stripe, each `rho` of the last one and the rest new.
    fn chain(rho: f64, count: usize) -> Vec<Row> {
        let mut state = 1u64;
        let mut normal = || {
            let uniform = (0..12).map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1u64 << 53) as f64
            });
            uniform.sum::<f64>() - 6.0
        };
        let mut px = 0.0;
        (0..count)
            .map(|_| {
                px = rho * px + (1.0 - rho * rho).sqrt() * normal();
                Row {
                    source: Source::Stripe(0),
                    at: Px::new(0.0, 0.0),
                    px,
                    sigma_px: 0.3,
                    derivative_px: Params::zeros(),
                    mm_per_px: 0.0,
                    along_mm: 0.0,
                    robust: 1.0,
                    weight: 0.0,
                }
            })
            .collect()
    }

    #[test]
    fn neighbours_that_say_the_same_count_once() {
        // A chain with rho has (1 + rho) / (1 - rho) residuals to an independent one.
        for (rho, expected) in [(0.0, 1.0), (0.4, 2.33), (0.7, 5.67)] {
            let found = correlation(&chain(rho, 3000), 2.0);
            assert!((found / expected - 1.0).abs() < 0.2, "rho {rho}: {found}, {expected} expected");
        }
        // Few residuals tell nothing.
        let few = correlation(&chain(0.0, 6), 4.0);
        assert!((2.5..=4.5).contains(&few), "{few}");
    }

    #[test]
    fn sides_turn_as_their_shape_says() {
        // Skewed by 20 mrad, nothing else: sides a turn one way, sides b the other.
        let mut params = Params::zeros();
        params[SHAPE] = 0.02;
        let turns = [0, 1, 2, 3].map(|side| turn_rad(&params, side));
        assert_eq!(turns, [-0.01, -0.01, 0.01, 0.01]);
        // Sides 0 and 1 at an angle of 20 mrad to each other.
        let mut params = Params::zeros();
        params[SHAPE + 1] = 0.02;
        assert_eq!([0, 1, 2, 3].map(|side| turn_rad(&params, side)), [-0.01, 0.01, 0.0, 0.0]);
    }
}
