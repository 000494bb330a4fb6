//! Tells who looks on ([`crate::trace`]) what each stage found in a frame.

use crate::calibration::Calibration;
use crate::face::extent::{FaceStripes, crossing_lasers, crossing_px};
use crate::face::outline::{InitialRectangle, SIDES, span_mm};
use crate::image::Frame;
use crate::image::laser_response::RidgeMap;
use crate::network::FaceMaps;
use crate::rectangle::corner_points;
use crate::rectangle::outlines::OutlineHypothesis;
use crate::stripe::grid_search::GridHypothesis;
use crate::trace::{LaserResponse, Stage, Trace, TracedLine, TracedOutline, TracedPlane, TracedStripe};
use crate::units::LaserId;

/// The one who looks on, if there is one, and at what.
#[derive(Clone, Copy)]
pub(super) struct Tracer<'a> {
    pub trace: Option<&'a dyn Trace>,
    pub frame: &'a Frame,
    pub calibration: &'a Calibration,
}

impl Tracer<'_> {
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
            Some(TracedPlane { segments_px: [a?, b?, c?, d?], strength: hypothesis.strength })
        };
        if let Some(trace) = self.trace {
            let planes: Vec<TracedPlane> = planes.iter().filter_map(grid).collect();
            let response = LaserResponse::new(ridges);
            trace.found(self.frame, &Stage::Planes { response, planes: &planes });
        }
    }

    pub fn stripes(&self, face: &FaceStripes) {
        let stripe = |id: LaserId| {
            let stripe = &face.stripes[id.index()];
            let beyond = stripe.points.iter().enumerate().filter(|(i, _)| !stripe.on_plane.contains(i));
            TracedStripe {
                on_plane_px: face.centres(id).map(|centre| centre.at).collect(),
                beyond_px: beyond.filter_map(|(_, point)| Some(point.found?.at)).collect(),
                ends_px: stripe.ends.map(|end| end.at),
            }
        };
        if let Some(trace) = self.trace {
            trace.found(self.frame, &Stage::Stripes(&LaserId::ALL.map(stripe)));
        }
    }

    pub fn outlines(&self, outlines: &[OutlineHypothesis]) {
        let corners = |hypothesis: &OutlineHypothesis| {
            let OutlineHypothesis { outline, probability, .. } = hypothesis;
            let [a, b, c, d] = corner_points(&outline.offsets_mm)
                .map(|corner| outline.raster.pixel(self.calibration, corner));
            Some(TracedOutline { corners_px: [a?, b?, c?, d?], probability: *probability })
        };
        let (Some(trace), Some(likeliest)) = (self.trace, outlines.first()) else { return };
        let InitialRectangle { raster, offsets_mm, lines, .. } = &likeliest.outline;
        let lines = (0..4).flat_map(|side| {
            let (from, to) = span_mm(offsets_mm, side);
            let across = SIDES[side].0;
            lines[side].iter().filter_map(move |line| {
                let [a, b] =
                    [from, to].map(|along| raster.pixel(self.calibration, across.at(line.offset_mm, along)));
                Some(TracedLine { ends_px: [a?, b?], share: line.share })
            })
        });
        let lines: Vec<TracedLine> = lines.collect();
        let outlines: Vec<TracedOutline> = outlines.iter().filter_map(corners).collect();
        trace.found(self.frame, &Stage::Outlines { lines: &lines, outlines: &outlines });
    }
}
