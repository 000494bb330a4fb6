//! Doors for programs that look into the stages: what [`crate::trace`] is told, and one step against truth (`examples/`). No part of the
//! product's interface.

use crate::calibration::Calibration;
use crate::face::extent::{FaceStripes, crossing_lasers, crossing_px};
use crate::face::outline::{SIDES, WeightedLine, span_mm};
use crate::face::raster::PlaneRaster;
use crate::frames::{Cam, Plane};
use crate::image::Frame;
use crate::image::redness::RidgeMap;
use crate::network::FaceMaps;
use crate::rectangle::corner_points;
use crate::stripe::grid_search::GridHypothesis;
pub use crate::stripe::peak::Estimator;
use crate::stripe::tint::Tint;
use crate::stripe::trace::{StripeLine, TraceSettings, Walk, measure_half_width_px, trace};
use crate::trace::{GridSeen, LaserResponse, LineSeen, OutlineSeen, Stage, StripeSeen, Trace};
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

/// Tells a [`Trace`], if there is one, what the stages found in a frame.
#[derive(Clone, Copy)]
pub(crate) struct Told<'a> {
    pub trace: Option<&'a dyn Trace>,
    pub frame: &'a Frame,
    pub calibration: &'a Calibration,
}

/// An outline on the face's plane, and the lines that its sides may be.
#[derive(Clone, Copy)]
pub(crate) struct Outlined<'a> {
    pub raster: &'a PlaneRaster,
    pub offsets_mm: &'a [f64; 4],
    pub lines: &'a [Vec<WeightedLine>; 4],
    pub probability: Option<f64>,
}

impl Told<'_> {
    pub fn network(&self, maps: &FaceMaps) {
        if let Some(trace) = self.trace {
            trace.found(self.frame, &Stage::Network(maps));
        }
    }

    pub fn planes(&self, ridges: &[RidgeMap; 2], planes: &[GridHypothesis]) {
        let grid = |hypothesis: &GridHypothesis| {
            let segment = |id| {
                let [i, j] = crossing_lasers(id)
                    .map(|other| crossing_px(self.calibration, &hypothesis.plane, id, other));
                Some([i?, j?])
            };
            let [a, b, c, d] = LaserId::ALL.map(segment);
            Some(GridSeen { segments_px: [a?, b?, c?, d?], strength: hypothesis.strength })
        };
        if let Some(trace) = self.trace {
            let planes: Vec<GridSeen> = planes.iter().filter_map(grid).collect();
            let response = LaserResponse::new(ridges);
            trace.found(self.frame, &Stage::Planes { response, planes: &planes });
        }
    }

    pub fn stripes(&self, face: &FaceStripes) {
        let stripe = |id: LaserId| {
            let stripe = &face.stripes[id.index()];
            let beyond = stripe.points.iter().enumerate().filter(|(i, _)| !stripe.on_plane.contains(i));
            StripeSeen {
                on_plane_px: face.centres(id).map(|centre| centre.at).collect(),
                beyond_px: beyond.filter_map(|(_, point)| Some(point.found?.at)).collect(),
                ends_px: stripe.ends.map(|end| end.at),
            }
        };
        if let Some(trace) = self.trace {
            trace.found(self.frame, &Stage::Stripes(&LaserId::ALL.map(stripe)));
        }
    }

    pub fn outlines<'o>(&self, outlines: impl Iterator<Item = Outlined<'o>> + Clone) {
        let outline = |outline: Outlined<'_>| {
            let [a, b, c, d] = corner_points(outline.offsets_mm)
                .map(|corner| outline.raster.pixel(self.calibration, corner));
            Some(OutlineSeen { corners_px: [a?, b?, c?, d?], probability: outline.probability })
        };
        let (Some(trace), Some(likeliest)) = (self.trace, outlines.clone().next()) else { return };
        let lines = (0..4).flat_map(|side| {
            let (from, to) = span_mm(likeliest.offsets_mm, side);
            let (raster, across) = (likeliest.raster, SIDES[side].0);
            likeliest.lines[side].iter().filter_map(move |line| {
                let [a, b] =
                    [from, to].map(|along| raster.pixel(self.calibration, across.at(line.offset_mm, along)));
                Some(LineSeen { ends_px: [a?, b?], share: line.share })
            })
        });
        let lines: Vec<LineSeen> = lines.collect();
        let outlines: Vec<OutlineSeen> = outlines.filter_map(outline).collect();
        trace.found(self.frame, &Stage::Outlines { lines: &lines, outlines: &outlines });
    }
}
