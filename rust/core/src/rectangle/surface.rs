//! How far the surface lies from the fitted plane along each stripe: what bends a stripe is a bulge or a dent (PHYSICS.md). The
//! plane has taken up what it could, so heights are against the mean plane; where one bow explains all stripes, against that
//! of the sides.

use super::refine::FittedRectangle;
use crate::calibration::Calibration;
use crate::face::model::{Row, Source};
use crate::face::raster::OnPlane;
use crate::measurement::SurfacePoint;
use crate::statistics::{median, robust_sigma};
use crate::units::Estimate;

/// Pieces of each stripe: a bulge over the whole face is 12 pieces wide.
const PIECES_A_STRIPE: usize = 12;
/// Fewest centres in a piece.
const LEAST_CENTRES: usize = 3;

/// Mean height of each piece of each stripe that lies between the corners, in the order of the lasers, along each.
pub(super) fn surface(
    calibration: &Calibration,
    fit: &FittedRectangle,
    corners: &[OnPlane; 4],
) -> Vec<SurfacePoint> {
    let middle = corners.iter().sum::<OnPlane>() * 0.25;
    let along_length = (corners[1] - corners[0]).normalize();
    let along_width = (corners[3] - corners[0]).normalize();
    let mut found = Vec::with_capacity(4 * PIECES_A_STRIPE);
    for laser in 0..4 {
        let of_stripe: Vec<&Row> = fit.rows.iter().filter(|r| r.source == Source::Stripe(laser)).collect();
        let size = of_stripe.len().div_ceil(PIECES_A_STRIPE).max(LEAST_CENTRES);
        for piece in of_stripe.chunks(size).filter(|p| p.len() >= LEAST_CENTRES) {
            let places = piece.iter().filter_map(|r| fit.raster.on_plane(calibration, r.at));
            let at = places.sum::<OnPlane>() / piece.len() as f64 - middle;
            let height = height(fit, piece);
            found.extend(
                height.map(|height| SurfacePoint {
                    at_mm: [at.dot(&along_length), at.dot(&along_width)],
                    height,
                }),
            );
        }
    }
    found
}

/// Median height of some centres: print moves single ones. Its sigma is from their own scatter, neighbours counted as the fit
/// does.
fn height(fit: &FittedRectangle, piece: &[&Row]) -> Option<Estimate> {
    let heights = || piece.iter().map(|r| r.px * height_of_px(fit, r));
    let middle = median(heights())?;
    // What the fit's weights say of one centre's variance, px^2, where it has a weight.
    let (sum, count) = piece
        .iter()
        .filter(|r| r.robust > 0.0)
        .fold((0.0, 0.0), |(s, n), r| (s + r.robust / r.weight * height_of_px(fit, r).powi(2), n + 1.0));
    let known = if count > 0.0 { sum / count } else { 0.0 };
    let scatter = robust_sigma(heights().map(|h| h - middle))?;
    // The median has pi / 2 times the variance of the mean.
    let variance = std::f64::consts::FRAC_PI_2 * known.max(scatter * scatter) / piece.len() as f64;
    let found = Estimate::new(middle, variance.sqrt());
    (found.value_mm.is_finite() && found.sigma_mm.is_finite()).then_some(found)
}

/// How far towards the camera a point lies that is seen 1 px across from where the plane predicts its stripe, mm: on a plane nearer by h,
/// whose 1 / distance is larger by h / distance^2, it would have no residual.
pub(super) fn height_of_px(fit: &FittedRectangle, row: &Row) -> f64 {
    let px_per_mm = -row.derivative_px[2] * fit.state.per_mm.powi(2);
    if px_per_mm.abs() > 1e-12 { 1.0 / px_per_mm } else { 0.0 }
}
