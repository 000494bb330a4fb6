//! The joint fit: a face ([`crate::face::model`]: plane 3, direction 1, four side offsets, 8 unknowns) to all stripe centres and all
//! edge points at once, in pixels, robust (PHYSICS.md, "Face fit"); with right angles relaxed it has 3 unknowns more.
//! What its residuals say of the face is in [`super::consistency_checks`], what it means for sigma in [`super::uncertainty`].

use crate::calibration::Calibration;
use crate::edges::EdgePoint;
use crate::face::extent::{crossing_on, crossing_on_px};
use crate::face::model::{Covariance, FaceState, Observation, Row, SHAPE, Source, UNKNOWNS, Unknowns, solve};
use crate::face::outline::SIDES;
use crate::face::plane_fit::StripeObservation;
use crate::face::raster::{OnPlane, PlaneRaster};
use crate::statistics::{median, robust_sigma, tukey_weight};
use crate::units::{LaserId, Px};
use nalgebra::SMatrix;

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

/// A fitted face.
#[derive(Clone, Debug)]
pub(crate) struct FittedRectangle {
    pub state: FaceState,
    /// The state's raster, and its offsets in the order of [`crate::face::outline::SIDES`], corrected since if edges were sharpened.
    pub raster: PlaneRaster,
    pub offsets_mm: [f64; 4],
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
}

impl FittedRectangle {
    /// Where a side of the raster's first direction (0, 1) meets one of the second (2, 3).
    pub fn corner(&self, side_a: usize, side_b: usize) -> OnPlane {
        // a + slope_a (b - middle_a) = offset_a, b + slope_b (a - middle_b) = offset_b
        let [sa, sb] = [side_a, side_b].map(|side| self.state.slope(side));
        let [ma, mb] = [side_a, side_b].map(|side| self.state.middle_mm(side));
        let (oa, ob) = (self.offsets_mm[side_a], self.offsets_mm[side_b]);
        let a = (oa - sa * (ob + sb * mb - ma)) / (1.0 - sa * sb);
        OnPlane::new(a, ob - sb * (a - mb))
    }

    /// Position along a side (mm) where a stripe crosses it.
    pub fn along_side_mm(&self, calibration: &Calibration, id: LaserId, side: usize) -> Option<f64> {
        crossing_on(calibration, &self.raster, SIDES[side].0, self.offsets_mm[side], id)
    }

    /// The crossings of stripes and sides, two a stripe (the paper's D1 to D8), on the sensor.
    pub fn key_points_px(&self, calibration: &Calibration) -> Option<[[Px; 2]; 4]> {
        let mut result = [[Px::new(0.0, 0.0); 2]; 4];
        for ((across, high), offset_mm) in SIDES.into_iter().zip(self.offsets_mm) {
            for id in across.stripes() {
                result[id.index()][usize::from(high)] =
                    crossing_on_px(calibration, &self.raster, across, offset_mm, id)?;
            }
        }
        Some(result)
    }
}

/// How the fit weighs what is seen. UNCERTAINTY.md has how well the sigmas that follow hold; no record says how each value was chosen.
#[derive(Clone, Copy, Debug)]
struct RefineSettings {
    /// Steps at most. More takes longer where weights do not settle.
    steps: usize,
    /// A step that is so short ends the fit: its square in its own sigmas. More ends it before it has settled.
    settled: f64,
    /// Least robust scatter that is believed, in sigmas of the points. More lets outliers in and makes sigmas larger.
    least_scale: f64,
    /// Edge points with at least this weight are told as those that count. More tells fewer.
    inlier: f64,
    /// Neighbouring edge points share print, shadow and rounding: about one in so many is independent, where the residuals
    /// cannot tell. More lets edges say less and makes sigmas larger.
    edge_correlation: f64,
    /// The same for stripe points (texture, after speckle is averaged in the block).
    stripe_correlation: f64,
    /// So many observations tell the correlation as well as what is known beforehand. More hears the residuals less.
    correlation_prior: f64,
    /// Neighbours up to this distance can be correlated; beyond it the estimate is noise alone. More adds noise to the sum.
    most_neighbours: usize,
    /// A correlation below so many of its own sigmas is lost in noise, and the sum ends. More ends it early, and sigmas come out too small.
    lost_sigmas: f64,
}

impl RefineSettings {
    const DEFAULT: Self = Self {
        steps: 12,
        settled: 1e-6,
        least_scale: 0.5,
        inlier: 0.1,
        edge_correlation: 4.0,
        stripe_correlation: 2.0,
        correlation_prior: 30.0,
        most_neighbours: 12,
        lost_sigmas: 2.0,
    };
}

impl Default for RefineSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What is seen of a face.
pub(crate) struct Problem<'a> {
    calibration: &'a Calibration,
    /// Stripes first, then edges, side by side.
    seen: Vec<Observation>,
    /// What the face's bow adds to the residual of each stripe point, px; empty for a flat face.
    pub bow_px: &'a [f64],
}

impl<'a> Problem<'a> {
    pub fn new(
        calibration: &'a Calibration,
        stripes: &[StripeObservation],
        edges: &[Vec<EdgePoint>; 4],
    ) -> Self {
        let seen = |source, at, sigma_px| Observation::new(calibration.camera(), source, at, sigma_px);
        let stripes = stripes.iter().map(|o| seen(Source::Stripe(o.laser.index()), o.at, o.sigma_px));
        let edges = edges.iter().enumerate();
        let edges = edges.flat_map(|(side, points)| {
            points.iter().map(move |p| seen(Source::Edge(side), p.at, p.sigma_px))
        });
        Self { calibration, seen: stripes.chain(edges).collect(), bow_px: &[] }
    }

    /// The face with each side where half of its points lie on either side of it: Tukey's weights settle on those points that
    /// lie near where they begin, and a rough side may be some px beside its edge.
    pub fn at_medians(&self, face: &FaceState) -> FaceState {
        let lines = face.lines(self.calibration.lasers());
        let mut moved = *face;
        for (side, offset_mm) in moved.offsets_mm.iter_mut().enumerate() {
            let points = self.seen.iter().filter(|seen| seen.source == Source::Edge(side));
            let rows = points.filter_map(|seen| lines.row(seen));
            *offset_mm += median(rows.map(|row| row.px * row.mm_per_px)).unwrap_or(0.0);
        }
        moved
    }

    /// All observations at this face, weighted.
    fn rows(&self, face: &FaceState) -> Option<Vec<Row>> {
        let lines = face.lines(self.calibration.lasers());
        let mut rows = Vec::with_capacity(self.seen.len());
        for seen in &self.seen {
            rows.push(lines.row(seen)?);
        }
        for (row, bow_px) in rows.iter_mut().zip(self.bow_px) {
            row.px -= bow_px;
        }
        weigh_all(&mut rows);
        Some(rows)
    }
}

/// Weighs stripes, which come first, and edges.
pub(super) fn weigh_all(rows: &mut [Row]) {
    let RefineSettings { edge_correlation, stripe_correlation, .. } = RefineSettings::DEFAULT;
    let stripes = rows.partition_point(|r| matches!(r.source, Source::Stripe(_)));
    let (stripe_rows, edge_rows) = rows.split_at_mut(stripes);
    weigh(stripe_rows, stripe_correlation);
    weigh(edge_rows, edge_correlation);
}

/// Robust weights in units of the rows' own scatter; neighbours that say the same count once.
fn weigh(rows: &mut [Row], usual_correlation: f64) {
    let scale = robust_scale(rows);
    for row in rows.iter_mut() {
        row.robust = tukey_weight(row.px / (row.sigma_px * scale));
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
    let RefineSettings { correlation_prior, most_neighbours, lost_sigmas, .. } = RefineSettings::DEFAULT;
    let mut sum = 1.0;
    for distance in 1..=most_neighbours {
        let of_runs = rows.chunk_by(|a, b| a.source == b.source).scan(0, |end, run| {
            *end += run.len();
            let units = &units[*end - run.len()..*end];
            Some(units.iter().zip(units.iter().skip(distance)).map(|(a, b)| a * b).sum::<f64>())
        });
        let rho = of_runs.sum::<f64>() / power;
        if rho < lost_sigmas / count.sqrt() {
            break;
        }
        sum += 2.0 * rho;
    }
    ((count * sum + correlation_prior * usual) / (count + correlation_prior)).max(1.0)
}

/// Fits the face. `None` if the observations do not fix all its unknowns.
pub(crate) fn refine(problem: &Problem, start: &FaceState, shape: Shape) -> Option<FittedRectangle> {
    let RefineSettings { steps, settled, inlier, .. } = RefineSettings::DEFAULT;
    let mut state = *start;
    let mut covariance = Covariance::zeros();
    let mut rows = problem.rows(&state)?;
    for _ in 0..steps {
        let mut normal = Covariance::zeros();
        let mut right = Unknowns::zeros();
        for row in rows.iter().filter(|r| r.robust > 0.0) {
            let by = &row.derivative_px.as_slice()[..shape.unknowns()];
            for (a, x) in by.iter().enumerate().filter(|(_, x)| **x != 0.0) {
                let weighted = x * row.weight;
                for (b, y) in by.iter().enumerate() {
                    normal[(b, a)] += y * weighted;
                }
                right[a] -= weighted * row.px;
            }
        }
        covariance = inverse(&normal, shape)?;
        let step = covariance * right;
        state = state.plus(&step);
        rows = problem.rows(&state)?;
        // The step in its sigmas, in any unknowns.
        if step.dot(&right) < settled {
            break;
        }
    }
    let rms = |edges_only: bool| {
        let counted = rows.iter().filter(|r| !edges_only || matches!(r.source, Source::Edge(_)));
        let (sum, count) = counted.fold((0.0, 0.0), |(s, n), r| (s + r.robust * r.px * r.px, n + r.robust));
        (sum / f64::max(count, 1.0)).sqrt()
    };
    let edge_inliers = [0, 1, 2, 3].map(|side| {
        rows.iter().filter(|r| r.source == Source::Edge(side)).map(|r| r.robust > inlier).collect()
    });
    let (rms_px, edge_rms_px) = (rms(false), rms(true));
    let numbers = [state.per_mm].into_iter().chain(state.offsets_mm).chain(state.shape_rad);
    let finite = state.axes.iter().copied().chain(numbers).all(f64::is_finite);
    finite.then(|| FittedRectangle {
        state,
        raster: state.raster(),
        offsets_mm: state.offsets_mm,
        covariance,
        rms_px,
        edge_rms_px,
        edge_inliers,
        rows,
    })
}

/// Inverse of the normal matrix over the unknowns of a shape; zero for the others.
fn inverse(normal: &Covariance, shape: Shape) -> Option<Covariance> {
    match shape {
        Shape::Quadrilateral => solve(normal, &Covariance::identity()),
        Shape::Rectangle => {
            let own: SMatrix<f64, SHAPE, SHAPE> = normal.fixed_view::<SHAPE, SHAPE>(0, 0).into();
            let mut inverse = Covariance::zeros();
            inverse.fixed_view_mut::<SHAPE, SHAPE>(0, 0).copy_from(&solve(&own, &SMatrix::identity())?);
            Some(inverse)
        }
    }
}

fn robust_scale(rows: &[Row]) -> f64 {
    robust_sigma(rows.iter().map(|r| r.px / r.sigma_px))
        .map_or(1.0, |sigma| sigma.max(RefineSettings::DEFAULT.least_scale))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Px;
    use nalgebra::Vector3;

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
                    derivative_px: Unknowns::zeros(),
                    by_ray_px: Vector3::zeros(),
                    by_laser_px: Vector3::zeros(),
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
}
