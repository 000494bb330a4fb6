//! Doors for programs that compare ways of doing one step against truth (`examples/`). No part of the product's interface.

use crate::calibration::Calibration;
use crate::frames::{Cam, Plane};
use crate::image::Frame;
pub use crate::stripe::peak::Estimator;
use crate::stripe::tint::Tint;
use crate::stripe::trace::{StripeLine, TraceSettings, Walk, measure_half_width_px, trace};
use crate::units::{LaserId, Px};

/// Farthest from the true stripe that a centre is looked for, px: beyond that it is another thing.
const SEARCH_PX: f64 = 6.0;
/// As on the way through the pipeline.
const MIN_SIGNAL_TO_NOISE: f64 = 3.0;
/// Stripe width where it cannot be measured, px.
const HALF_WIDTH_PX: f64 = 10.0;

/// A stripe's centre beside the truth.
#[derive(Clone, Copy, Debug)]
pub struct Centre {
    /// Signed distance across the stripe, px.
    pub residual_px: f64,
    /// Height over the background, grey levels of redness.
    pub amplitude: f64,
}

/// The stripe centres of `laser` beside where its plane and `plane` meet, one for every `rows` rows between two places on the
/// stripe; `None` where no centre was found.
#[must_use]
pub fn stripe_residuals(
    frame: &Frame,
    calibration: &Calibration,
    plane: &Plane<Cam>,
    laser: LaserId,
    endpoints_px: [Px; 2],
    rows: usize,
    estimator: Estimator,
) -> Vec<Option<Centre>> {
    let line = StripeLine::new(calibration, laser, plane);
    let along = |px: Px| match line.walk {
        Walk::Rows => px.v,
        Walk::Columns => px.u,
    };
    let [p, q] = endpoints_px;
    let (first, last) = if along(p) <= along(q) { (p, q) } else { (q, p) };
    let range = along(first)..along(last);
    let half_width_px =
        measure_half_width_px(frame, calibration, &[(line, range.clone(), first)], &[Tint::REDNESS]);
    let settings = TraceSettings {
        rows,
        search_px: SEARCH_PX,
        min_signal_to_noise: MIN_SIGNAL_TO_NOISE,
        half_width_px: half_width_px.unwrap_or(HALF_WIDTH_PX),
        tint: Tint::REDNESS,
        estimator,
        smooth_px: 0.0,
    };
    trace(frame, calibration, &line, range, first, &settings)
        .into_iter()
        .map(|point| point.found.map(|f| Centre { residual_px: f.residual_px, amplitude: f.amplitude }))
        .collect()
}
