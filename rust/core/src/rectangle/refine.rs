//! The joint fit: a rectangle on a plane (plane 3, direction 1, four side offsets: 8 unknowns) to all stripe centres and
//! all edge points at once, in pixels, robust, with a covariance (physics.md, "Face fit").

use crate::calibration::Calibration;
use crate::edges::EdgePoint;
use crate::face::outline::{RoughRectangle, SIDES};
use crate::face::plane_fit::{StripeObservation, stripe_residual_px};
use crate::face::raster::PlaneRaster;
use crate::frames::Plane;
use crate::units::Px;
use nalgebra::{SMatrix, SVector, Vector3};

/// Unknowns: plane (3, 1/mm), direction (rad), offsets of the four sides (mm).
pub(crate) type Params = SVector<f64, 8>;
/// Their covariance.
pub(crate) type Covariance = SMatrix<f64, 8, 8>;

/// Two pixels that fix the raster's origin and axis for every plane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Anchor {
    pub at: Px,
    pub towards: Px,
}

/// A fitted rectangle.
#[derive(Clone, Debug)]
pub(crate) struct FittedRectangle {
    pub raster: PlaneRaster,
    /// Offsets of the sides, mm, in the order of [`SIDES`].
    pub offsets_mm: [f64; 4],
    pub params: Params,
    pub covariance: Covariance,
    /// Root mean square of all residuals that count, px.
    pub rms_px: f64,
    /// ... of the edges alone.
    pub edge_rms_px: f64,
    /// Which edge points count.
    pub edge_inliers: [Vec<bool>; 4],
}

/// Tukey's constant: 95 % efficiency for normal residuals.
const TUKEY: f64 = 4.685;
pub(crate) const ITERATIONS: usize = 12;
/// Neighbouring edge points share print, shadow and rounding: about one in so many is independent.
const EDGE_CORRELATION: f64 = 4.0;
/// The same for stripe points (texture, after speckle is averaged in the block).
const STRIPE_CORRELATION: f64 = 2.0;

struct Problem<'a> {
    calibration: &'a Calibration,
    anchor: Anchor,
}

/// Weighted residual of one observation: value in sigmas, derivative, and px per sigma.
struct Row {
    px: f64,
    sigma_px: f64,
    derivative_px: Params,
}

impl Problem<'_> {
    fn raster(&self, params: &Params) -> Option<PlaneRaster> {
        let plane = Plane::new(Vector3::new(params[0], params[1], params[2]));
        Some(
            PlaneRaster::new(self.calibration, &plane, self.anchor.at, self.anchor.towards)?
                .turned(params[3]),
        )
    }

    fn stripe_row(&self, params: &Params, o: &StripeObservation) -> Option<Row> {
        let plane = Plane::new(Vector3::new(params[0], params[1], params[2]));
        let (px, per, x) = stripe_residual_px(self.calibration, &plane, o.laser, o.at)?;
        let mut derivative_px = Params::zeros();
        derivative_px.fixed_rows_mut::<3>(0).copy_from(&(x * per));
        Some(Row { px, sigma_px: o.sigma_px, derivative_px })
    }

    fn edge_row(&self, params: &Params, rasters: &Rasters, side: usize, p: &EdgePoint) -> Option<Row> {
        let (across, _) = SIDES[side];
        let offset =
            |raster: &PlaneRaster, px: Px| raster.on_plane(self.calibration, px).map(|at| across.offset(at));
        let here = offset(&rasters.here, p.at)?;
        // Millimetres of offset per pixel across the side, from the raster itself.
        let right = offset(&rasters.here, Px::new(p.at.u + 0.5, p.at.v))?
            - offset(&rasters.here, Px::new(p.at.u - 0.5, p.at.v))?;
        let down = offset(&rasters.here, Px::new(p.at.u, p.at.v + 0.5))?
            - offset(&rasters.here, Px::new(p.at.u, p.at.v - 0.5))?;
        let mm_per_px = right.hypot(down).max(1e-9);
        let mut derivative_px = Params::zeros();
        for (i, (raster, step)) in rasters.moved.iter().enumerate() {
            derivative_px[i] = (offset(raster, p.at)? - here) / step / mm_per_px;
        }
        derivative_px[4 + side] = -1.0 / mm_per_px;
        Some(Row { px: (here - params[4 + side]) / mm_per_px, sigma_px: p.sigma_px, derivative_px })
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

/// Fits the rectangle. `None` if the observations do not fix all eight unknowns.
pub(crate) fn refine(
    calibration: &Calibration,
    stripes: &[StripeObservation],
    edges: &[Vec<EdgePoint>; 4],
    anchor: Anchor,
    start: &Params,
    iterations: usize,
) -> Option<FittedRectangle> {
    let problem = Problem { calibration, anchor };
    let mut params = *start;
    let mut covariance = Covariance::zeros();
    let mut rms = (0.0, 0.0);
    let mut edge_inliers = edges.each_ref().map(|e| vec![false; e.len()]);
    for _ in 0..iterations {
        let rasters = Rasters::new(&problem, &params)?;
        let stripe_rows: Vec<Row> =
            stripes.iter().map(|o| problem.stripe_row(&params, o)).collect::<Option<_>>()?;
        let mut edge_rows: Vec<Row> = Vec::new();
        for (side, points) in edges.iter().enumerate() {
            for p in points {
                edge_rows.push(problem.edge_row(&params, &rasters, side, p)?);
            }
        }
        let mut normal = Covariance::zeros();
        let mut right = Params::zeros();
        let (mut sum, mut count, mut edge_sum, mut edge_count) = (0.0, 0.0, 0.0, 0.0);
        for (class, rows) in [&stripe_rows, &edge_rows].into_iter().enumerate() {
            let scale = robust_scale(rows);
            let correlation = if class == 0 { STRIPE_CORRELATION } else { EDGE_CORRELATION };
            for (i, row) in rows.iter().enumerate() {
                let sigma = row.sigma_px * scale;
                let t = row.px / (sigma * TUKEY);
                let robust = (1.0 - t * t).max(0.0).powi(2);
                if class == 1 {
                    mark(&mut edge_inliers, i, robust > 0.1);
                }
                if robust <= 0.0 {
                    continue;
                }
                let weight = robust / (sigma * sigma * correlation);
                normal += row.derivative_px * row.derivative_px.transpose() * weight;
                right -= row.derivative_px * (weight * row.px);
                sum += robust * row.px * row.px;
                count += robust;
                if class == 1 {
                    edge_sum += robust * row.px * row.px;
                    edge_count += robust;
                }
            }
        }
        rms = ((sum / f64::max(count, 1.0)).sqrt(), (edge_sum / f64::max(edge_count, 1.0)).sqrt());
        // The unknowns have sizes from 1e-4 to 1e3: scale before solving.
        let units = Params::from_fn(|i, _| 1.0 / normal[(i, i)].max(1e-300).sqrt());
        let scaled = Covariance::from_diagonal(&units) * normal * Covariance::from_diagonal(&units);
        let factor = scaled.cholesky()?;
        let step = units.component_mul(&factor.solve(&right.component_mul(&units)));
        covariance = Covariance::from_diagonal(&units) * factor.inverse() * Covariance::from_diagonal(&units);
        params += step;
        if step.component_div(&covariance.diagonal().map(|c| c.max(0.0).sqrt().max(1e-300))).amax() < 1e-3 {
            break;
        }
    }
    let raster = problem.raster(&params)?;
    params.iter().all(|p| p.is_finite()).then(|| FittedRectangle {
        raster,
        params,
        offsets_mm: [params[4], params[5], params[6], params[7]],
        covariance,
        rms_px: rms.0,
        edge_rms_px: rms.1,
        edge_inliers,
    })
}

fn mark(inliers: &mut [Vec<bool>; 4], mut index: usize, value: bool) {
    for side in inliers {
        if index < side.len() {
            side[index] = value;
            return;
        }
        index -= side.len();
    }
}

fn robust_scale(rows: &[Row]) -> f64 {
    if rows.is_empty() {
        return 1.0;
    }
    let mut sizes: Vec<f64> = rows.iter().map(|r| (r.px / r.sigma_px).abs()).collect();
    let middle = sizes.len() / 2;
    (*sizes.select_nth_unstable_by(middle, f64::total_cmp).1 / 0.6745).max(0.5)
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
    ]))
}
