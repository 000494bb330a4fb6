//! Doors for programs that compare ways of doing one step against truth (`examples/`). No part of the product's interface.

use crate::calibration::Calibration;
use crate::face::end_outline::end_outline;
use crate::face::extent::{StripeContrast, follow_stripes, inner_segments};
use crate::face::outline::{SIDES, outward_sign, span_mm};
use crate::frames::{Cam, Plane};
use crate::image::Frame;
use crate::image::bands::band_maps;
use crate::network::StripeLight;
use crate::rectangle::line_evidence::{Evidence as LineEvidence, LineSettings};
use crate::scene::lit::LitLines;
use crate::stripe::centres::{CentreSettings, find_centres, measure_half_width_px};
use crate::stripe::colour_projection::ColourProjection;
use crate::stripe::grid_search::{self, Evidence, GridSearchSettings};
pub use crate::stripe::peak::Estimator;
use crate::stripe::stripe_line::{ScanDirection, StripeLine};
use crate::units::{LaserId, Px};

/// Farthest from the true stripe that a centre is looked for, px: beyond that it is another thing.
const SEARCH_PX: f64 = 6.0;
/// As on the way through the pipeline.
const MIN_SIGNAL_TO_NOISE: f64 = 3.0;

/// A stripe's centre beside the truth.
#[derive(Clone, Copy, Debug)]
pub struct Centre {
    /// Signed distance across the stripe, px.
    pub residual_px: f64,
    /// Height over the background, grey levels of laser response.
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
    let along = |px: Px| match line.scan {
        ScanDirection::Rows => px.v,
        ScanDirection::Columns => px.u,
    };
    let [p, q] = endpoints_px;
    let (first, last) = if along(p) <= along(q) { (p, q) } else { (q, p) };
    let range = along(first)..along(last);
    let half_width_px = measure_half_width_px(
        frame,
        calibration,
        &[(line, range.clone(), first)],
        &[ColourProjection::LASER_RESPONSE],
    );
    let settings = CentreSettings {
        rows,
        search_px: SEARCH_PX,
        min_signal_to_noise: MIN_SIGNAL_TO_NOISE,
        half_width_px: half_width_px.unwrap_or(CentreSettings::DEFAULT.half_width_px),
        estimator,
        ..CentreSettings::default()
    };
    find_centres(frame, calibration, &line, range, first, &settings)
        .into_iter()
        .map(|point| point.found.map(|f| Centre { residual_px: f.residual_px, amplitude: f.amplitude }))
        .collect()
}

/// A line of the picture that may be a side of the face, and what is said of it without a network.
#[derive(Clone, Copy, Debug)]
pub struct SideLine {
    /// 0 to 3, the two that stripes 1 and 2 cross first.
    pub side: usize,
    /// The middle of the side on this line, and a unit vector that points out of the face.
    pub middle: Px,
    /// See `middle`.
    pub outwards: [f64; 2],
    /// Size of a pixel on the face, mm.
    pub mm_per_px: f64,
    /// What is looked at, in the order of the weights in `rectangle/line_evidence`.
    pub clues: [f64; 11],
    /// What the stripes' light says of it.
    pub light: StripeLight,
}

/// The lines that may be the sides of the face on the strongest plane, without a network; none if no face is found.
#[must_use]
pub fn side_lines(frame: &Frame, calibration: &Calibration) -> Vec<SideLine> {
    let found = || {
        let ridges = band_maps(frame, grid_search::diagonals(calibration));
        let grid = GridSearchSettings::default();
        let evidence = LaserId::ALL.map(|id| Evidence::ridge(&ridges[id.index() / 2]));
        let planes = grid_search::find_planes(calibration, &evidence, &grid, grid.clear, 1);
        let inner = inner_segments(frame, calibration, &planes.first()?.plane, StripeContrast::Clear)?;
        let wide = follow_stripes(frame, calibration, &inner, None)?;
        let outline = end_outline(frame, calibration, &wide).ok()?;
        let raster = outline.raster.on(&wide.fit.plane);
        let lit = LitLines::of(frame, calibration, &wide);
        let evidence = LineEvidence {
            frame,
            calibration,
            raster: &raster,
            outline: &outline,
            network: None,
            wide: &wide,
            seen: None,
            lit: &lit,
            settings: &LineSettings::DEFAULT,
        };
        let mut all = Vec::new();
        for (side, lines) in evidence.settled()?.iter().enumerate() {
            let (from, to) = span_mm(&outline.offsets_mm, side);
            for line in lines {
                let at = |out_mm: f64| {
                    let offset = line.offset_mm + outward_sign(side) * out_mm;
                    raster.pixel(calibration, SIDES[side].0.at(offset, 0.5 * (from + to)))
                };
                let (middle, outside) = (at(0.0)?, at(outline.mm_per_px)?);
                let length_px = middle.distance_px(outside).max(f64::MIN_POSITIVE);
                all.push(SideLine {
                    side,
                    middle,
                    outwards: [(outside.u - middle.u) / length_px, (outside.v - middle.v) / length_px],
                    mm_per_px: outline.mm_per_px,
                    clues: line.clues.values(),
                    light: line.stripes_light,
                });
            }
        }
        Some(all)
    };
    found().unwrap_or_default()
}
