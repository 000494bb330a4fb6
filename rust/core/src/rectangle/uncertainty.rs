//! What moves a measured face beside noise (GUM: type B), and by how much: calibration, drift of the lasers, blur of edges.
//! Every cause is scaled to one standard deviation and independent of the others; its effect on each residual gives its
//! effect on the fit (implicit function: `d unknowns = -inverse(normal) sum(weight * derivative * d residual)`).

use super::refine::FittedRectangle;
use super::side_view::Correction;
use crate::calibration::{
    CAMERA, Calibration, CalibrationCovariance, CalibrationStep, FIRST_PLANE, PARAMETERS, moved,
};
use crate::eigen::symmetric_eigen;
use crate::face::model::{OFFSETS, SHAPE, Source, TURNS, UNKNOWNS, Unknowns};
use crate::face_geometry::SIDE_SYSTEMATIC_PX;
use crate::measurement::{SHARED_CAUSES, SideUncertainty};
use crate::units::{AngleEstimate, LaserId};
use nalgebra::{Matrix2, SMatrix, SVector, Vector3};

/// First of the tilts of the four lasers.
pub(super) const TILTS: usize = PARAMETERS;
/// First of the causes that each frame has for itself: a shift and a turn of each side.
pub(super) const EDGES: usize = TILTS + 4;
/// All causes.
pub(super) const CAUSES: usize = EDGES + 8;

/// Effect of one sigma of every cause on every residual, px; one row per [`crate::face::model::Row`].
pub(super) struct Causes {
    pub on_residuals_px: Vec<SVector<f64, CAUSES>>,
    /// ... and on the unknowns.
    pub on_unknowns: SMatrix<f64, UNKNOWNS, CAUSES>,
}

/// Works out all causes at a fit.
pub(super) fn causes(calibration: &Calibration, fit: &FittedRectangle, tilts_rad: [f64; 4]) -> Causes {
    let root = calibration.covariance().map(|covariance| root_of(covariance).transpose());
    // What is known exactly moves nothing.
    let moves = |i: &usize| calibration.covariance().is_some_and(|covariance| covariance[(*i, *i)] > 0.0);
    let cameras = CAMERA.into_iter().filter(moves).map(|i| {
        let mut step = CalibrationStep::zeros();
        step[i] = if i < 4 { 0.01 } else { 1e-4 };
        (i, *calibration.stepped(&step).camera(), step[i])
    });
    let cameras: Vec<_> = cameras.collect();
    let turned: [Vector3<f64>; 4] = LaserId::ALL.map(|id| {
        let angle_rad = 1e-4;
        let p = calibration.with_turned_laser(id, angle_rad).laser(id).per_mm;
        (p - calibration.laser(id).per_mm) / angle_rad * tilts_rad[id.index()]
    });
    let half_mm = half_sides_mm(&fit.offsets_mm);
    let mut on_residuals_px = Vec::with_capacity(fit.rows.len());
    let mut pull = SMatrix::<f64, CAUSES, UNKNOWNS>::zeros();
    for row in &fit.rows {
        let mut by_calibration = SVector::<f64, PARAMETERS>::zeros();
        let mut effect = SVector::<f64, CAUSES>::zeros();
        let ray = calibration.camera().ray_from_px(row.at).xy1;
        for (k, camera, step) in &cameras {
            by_calibration[*k] = row.by_ray_px.dot(&(camera.ray_from_px(row.at).xy1 - ray)) / step;
        }
        match row.source {
            Source::Stripe(laser) => {
                by_calibration.fixed_rows_mut::<3>(FIRST_PLANE + 3 * laser).copy_from(&row.by_laser_px);
                effect[TILTS + laser] = row.by_laser_px.dot(&turned[laser]);
            }
            Source::Edge(side) => {
                // As much at a side's ends, since what lies behind it changes along it.
                effect[EDGES + side] = SIDE_SYSTEMATIC_PX;
                effect[EDGES + 4 + side] = SIDE_SYSTEMATIC_PX * row.along_mm / half_mm[side];
            }
        }
        if let Some(root) = &root {
            let mut by_sigmas = effect.fixed_rows_mut::<PARAMETERS>(0);
            for (root, by) in root.column_iter().zip(&by_calibration).filter(|(_, by)| **by != 0.0) {
                by_sigmas += root * *by;
            }
        }
        for (mut pull, by) in pull.column_iter_mut().zip(&row.derivative_px).filter(|(_, by)| **by != 0.0) {
            pull += effect * (by * row.weight);
        }
        on_residuals_px.push(effect);
    }
    Causes { on_residuals_px, on_unknowns: -fit.covariance * pull.transpose() }
}

/// Half the length of each side, mm.
fn half_sides_mm([a0, a1, b0, b1]: &[f64; 4]) -> [f64; 4] {
    let (a, b) = (0.5 * (a1 - a0).abs().max(1.0), 0.5 * (b1 - b0).abs().max(1.0));
    [b, b, a, a]
}

/// A square root S of a covariance, `S S^T = C`, also where some parameters have none.
fn root_of(covariance: &CalibrationCovariance) -> CalibrationCovariance {
    // In units of the sigmas, since the parameters have sizes from 1e-7 to 1.
    let sigmas = covariance.diagonal().map(|v| v.max(0.0).sqrt());
    let units = sigmas.map(|s| if s > 0.0 { 1.0 / s } else { 0.0 });
    let even = CalibrationCovariance::from_diagonal(&units)
        * covariance
        * CalibrationCovariance::from_diagonal(&units);
    let eigen = symmetric_eigen(&even);
    let roots = eigen.values.map(|v| v.max(0.0).sqrt());
    CalibrationCovariance::from_diagonal(&sigmas)
        * eigen.vectors
        * CalibrationCovariance::from_diagonal(&roots)
}

/// How both lengths of the face vary: across the first two sides and across the others.
pub(super) fn of_sides(
    fit: &FittedRectangle,
    causes: &Causes,
    corrections: &[Correction; 4],
) -> SideUncertainty {
    let mut pick = SMatrix::<f64, 2, UNKNOWNS>::zeros();
    for i in 0..2 {
        pick[(i, OFFSETS + 2 * i)] = -1.0;
        pick[(i, OFFSETS + 2 * i + 1)] = 1.0;
    }
    let by_cause = pick * causes.on_unknowns;
    let by_edges: SMatrix<f64, 2, 8> = by_cause.fixed_columns::<8>(EDGES).into();
    let mut own_mm2: Matrix2<f64> =
        pick * fit.covariance * pick.transpose() + by_edges * by_edges.transpose();
    let mut shared_mm = SMatrix::<f64, 2, SHARED_CAUSES>::zeros();
    shared_mm.fixed_columns_mut::<EDGES>(0).copy_from(&by_cause.fixed_columns::<EDGES>(0));
    for (side, correction) in corrections.iter().enumerate() {
        let by_radius_mm = correction.by_radius_mm;
        own_mm2[(side / 2, side / 2)] += (correction.sigma_mm.powi(2) - by_radius_mm.powi(2)).max(0.0);
        // One box, one kind of edge: the radius is the same all round.
        shared_mm[(side / 2, EDGES)] += by_radius_mm;
    }
    SideUncertainty { own_mm2, shared_mm }
}

/// The four angles between neighbouring sides in the order of the raster's corners (low a low b, high a low b, high a
/// high b, low a high b).
pub(super) fn corner_angles(fit: &FittedRectangle, causes: &Causes) -> [AngleEstimate; 4] {
    [(0, 2, 1.0), (1, 2, -1.0), (1, 3, 1.0), (0, 3, -1.0)].map(|(a, b, sign)| {
        let value_rad = sign * (fit.state.turn_rad(a) - fit.state.turn_rad(b));
        let by_unknowns = Unknowns::from_fn(|i, _| {
            let turn = |side: usize| i.checked_sub(SHAPE).map_or(0.0, |k| TURNS[side][k]);
            sign * (turn(a) - turn(b))
        });
        let noise = (by_unknowns.transpose() * fit.covariance * by_unknowns)[0];
        let sigma_rad = (noise + (by_unknowns.transpose() * causes.on_unknowns).norm_squared()).sqrt();
        AngleEstimate { value_rad: std::f64::consts::FRAC_PI_2 + value_rad, sigma_rad }
    })
}

/// The lasers' tilts that sigma must allow for, rad: the stated drift, or more where this face shows that one has moved.
pub(super) fn tilts_rad(drift_rad: f64, seen_rad: Option<f64>) -> [f64; 4] {
    [seen_rad.map_or(drift_rad, |seen| drift_rad.max(seen.abs())); 4]
}

impl Calibration {
    /// The same head with its parameters moved, without covariance.
    fn stepped(&self, step: &CalibrationStep) -> Self {
        let (camera, lasers) = moved(self.camera(), self.lasers(), step);
        self.with_parameters(camera, lasers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1024))]
        /// Three parameters of a laser go together far better than they are known, and all a little with the camera: in one
        /// such covariance of 60 nalgebra lists the eigenvalues in another order than their vectors.
        #[test]
        fn a_covariance_is_its_root_times_itself(
            along in prop::collection::vec(0.0..1.0f64, PARAMETERS),
            common in prop::collection::vec(-0.5..0.5f64, PARAMETERS),
            alone in prop::collection::vec(-12.0..-2.0f64, 6),
            together in -8.0..0.0f64
        ) {
            let common = SVector::<f64, PARAMETERS>::from_vec(common);
            let mut covariance = common * common.transpose() * 10f64.powf(together);
            for (block, alone) in alone.iter().enumerate() {
                for i in 0..3 {
                    let i = 3 * block + i;
                    covariance[(i, i)] += 10f64.powf(*alone);
                    (3 * block..3 * block + 3).for_each(|j| covariance[(i, j)] += along[i] * along[j]);
                }
            }
            let root = root_of(&covariance);
            let again = root * root.transpose();
            let units = covariance.diagonal().map(|v| 1.0 / v.sqrt());
            let off = (again - covariance).component_mul(&(units * units.transpose())).amax();
            prop_assert!(off < 1e-9, "off by {off} of the sigmas");
        }
    }
}
