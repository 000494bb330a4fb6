//! The rectangle of a face on its plane: which lines may be its sides ([`line_evidence`], [`outlines`]), the picture's edges beside them
//! ([`snap`]), its joint fit ([`refine`]), the lines beside its sides ([`nearby_lines`]), the way from rounded to sharp edges ([`sharp_edge`], [`rounding`]), its sigmas
//! ([`uncertainty`]), what the residuals tell ([`consistency_checks`], [`surface`]), and the result (this file).

mod consistency_checks;
pub(crate) mod line_evidence;
mod line_strip;
mod nearby_lines;
pub(crate) mod outlines;
pub(crate) mod refine;
pub(crate) mod rounding;
pub(crate) mod sharp_edge;
pub(crate) mod side_view;
pub(crate) mod snap;
mod straightness;
pub(crate) mod stripe_ends;
mod surface;
mod uncertainty;

use crate::calibration::Calibration;
use crate::edges::EdgePoint;
use crate::face::extent::{FaceStripes, crossing_on_px};
use crate::face::model::FaceState;
use crate::face::outline::{InitialRectangle, SIDES, span_mm};
use crate::face::plane_fit::StripeObservation;
use crate::face::raster::{OnPlane, PlaneRaster};
use crate::image::Frame;
use crate::measurement::{FaceMeasurement, Settings, SideUncertainty};
use crate::reject::Reject;
use crate::units::{AngleEstimate, Estimate, LaserId, Px};
use crate::warning::Warning;
use nalgebra::Matrix2;
use nearby_lines::NearbyLines;
use refine::{FittedRectangle, Problem, Shape, refine};
use sharp_edge::Sharpened;
use side_view::Correction;

/// What is seen of a face that may be measured, and when its fit is refused. Where a field gives no reason for its value, none is on record.
#[derive(Clone, Copy, Debug)]
struct RectangleSettings {
    /// Fewest edge points on a side. More refuses sides of which little is seen.
    least_edge_points: usize,
    /// Stripe centres so far inside the sides count, px of the middle of the face. More leaves out centres that are sound, less takes in those on a
    /// rounded edge.
    inside_px: f64,
    /// Edge points so far beyond a stripe's foot are not disturbed by its light, px. More leaves out edge points that are sound.
    beside_stripe_px: f64,
    /// Largest rms of the residuals of stripes, px: they scatter by 0.2 to 0.5 px. More measures what is not planar.
    most_stripe_rms_px: f64,
    /// ... and of edges, px: they scatter by 0.3 to 1 px. More measures what is no rectangle.
    most_edge_rms_px: f64,
    /// ... or in sigmas of the edge points, which are larger where these come from a coarse map. The same.
    most_edge_rms_sigmas: f64,
    /// ... or in mm: edges of real boxes bow and wave by up to 4 mm, the rms of which is half of that; sigma takes it in. The same.
    most_edge_rms_mm: f64,
    /// A side that lies so far beyond where both its stripes end, px, is none: nothing that is not the face can be nearer to the head
    /// than its stripes. More measures faces at lines beyond them.
    too_far_px: f64,
    /// ... or so many mm: near the head a stripe ends earlier by more px, where the edge is rounder than is taken for usual. The same.
    too_far_mm: f64,
}

impl RectangleSettings {
    const DEFAULT: Self = Self {
        least_edge_points: 8,
        inside_px: 2.0,
        beside_stripe_px: 5.0,
        most_stripe_rms_px: 1.5,
        most_edge_rms_px: 1.5,
        most_edge_rms_sigmas: 3.0,
        most_edge_rms_mm: 2.0,
        too_far_px: 10.0,
        too_far_mm: *rounding::CARDBOARD_MM.end() - sharp_edge::USUAL_RADIUS_MM,
    };
}

impl Default for RectangleSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Sides from eight key points.
pub(crate) struct KeyPointSides {
    /// Across A (low to high a) and across B, mm.
    pub sides_mm: [f64; 2],
    /// Their variances, mm^2.
    pub variances_mm2: [f64; 2],
}

/// Sides in another way than by the joint fit, of a rectangle that was fitted.
pub(crate) type SidesOf<'a> = &'a dyn Fn(&FittedRectangle) -> Option<KeyPointSides>;

/// Fits the rectangle of a face and judges it. Its sides are those of the fit, or those of `key_points`.
pub(crate) fn measure(
    frame: &Frame,
    calibration: &Calibration,
    face: &FaceStripes,
    initial: &InitialRectangle,
    edges: &[Vec<EdgePoint>; 4],
    settings: &Settings,
    key_points: Option<SidesOf<'_>>,
) -> Result<FaceMeasurement, Reject> {
    let limits = &RectangleSettings::DEFAULT;
    let sides_found = edges.iter().filter(|e| e.len() >= limits.least_edge_points).count() as u8;
    let open = || Reject::RectangleOpen { sides_found };
    if sides_found < 4 {
        return Err(open());
    }
    let (rms_px, limit_px) = (face.fit.rms_px, limits.most_stripe_rms_px);
    if rms_px > limit_px {
        return Err(Reject::FaceNotPlanar { rms_px, limit_px });
    }
    let stripes = face_observations(calibration, face, initial);
    let observed = FaceObservations { calibration, stripes: &stripes, edges };
    let fitted = observed.fit(initial, settings).ok_or_else(open)?;
    let fit = &fitted.fit;
    let limit_px = edge_limit_px(edges).max(limits.most_edge_rms_mm / initial.mm_per_px);
    if fit.edge_rms_px > limit_px {
        return Err(Reject::NotARectangle { rms_px: fit.edge_rms_px, limit_px });
    }
    check_crossings(frame, calibration, fit)?;
    let lit = keep_out(calibration, face, initial);
    let Sharpened { mut corrections, misplaced_mm } =
        sharp_edge::sharpen(frame, calibration, face, fit, &initial.at_ends, &lit);
    let nearby = [0, 1, 2, 3].map(|side| NearbyLines::of(fit, initial, side));
    for (correction, nearby) in corrections.iter_mut().zip(&nearby) {
        correction.sigma_mm = correction.sigma_mm.hypot(nearby.sigma_mm);
    }
    let too_far_mm = limits.too_far_mm.max(limits.too_far_px * initial.mm_per_px);
    let beyond_ends = misplaced_mm.iter().filter(|off| **off < -too_far_mm).count() as u8;
    if beyond_ends > 0 {
        return Err(Reject::RectangleOpen { sides_found: 4 - beyond_ends });
    }
    let face = match key_points {
        Some(sides_of) => observed.by_key_points(&fitted, &corrections, &sides_of(fit).ok_or_else(open)?),
        None => observed.by_fit(fitted, &corrections),
    };
    let mut face = face.ok_or_else(open)?;
    face.warnings.extend(NearbyLines::warning(&nearby));
    Ok(face)
}

/// What was seen of a face.
#[derive(Clone, Copy)]
pub(crate) struct FaceObservations<'a> {
    pub calibration: &'a Calibration,
    pub stripes: &'a [StripeObservation],
    pub edges: &'a [Vec<EdgePoint>; 4],
}

/// A face fitted to it, before its edges are sharpened.
pub(crate) struct Fitted {
    pub fit: FittedRectangle,
    causes: uncertainty::Causes,
    checks: consistency_checks::ConsistencyChecks,
    corner_angles: Option<[AngleEstimate; 4]>,
}

impl FaceObservations<'_> {
    /// Fits and checks the face.
    pub fn fit(&self, initial: &InitialRectangle, settings: &Settings) -> Option<Fitted> {
        let calibration = self.calibration;
        let mut problem = Problem::new(calibration, self.stripes, self.edges);
        let start = problem.at_medians(&FaceState::of_raster(&initial.raster, &initial.offsets_mm));
        let mut fit = refine(&problem, &start, Shape::Rectangle)?;
        let drift_rad = settings.drift_rad.max(f64::EPSILON);
        let mut causes = uncertainty::causes(calibration, &fit, [drift_rad; 4]);
        let checks = consistency_checks::check(calibration, &fit, &causes, drift_rad).unwrap_or_default();
        let mut corner_angles = None;
        // The plane that counts is that of the sides.
        let bowed = !checks.bow_px.is_empty();
        if bowed {
            problem.bow_px = &checks.bow_px;
            fit = refine(&problem, &fit.state, Shape::Rectangle)?;
        }
        if settings.free {
            fit = refine(&problem, &fit.state, Shape::Quadrilateral)?;
        }
        if settings.free || bowed || checks.tilt_rad.is_some() {
            causes =
                uncertainty::causes(calibration, &fit, uncertainty::tilts_rad(drift_rad, checks.tilt_rad));
        }
        for (row, bow_px) in fit.rows.iter_mut().zip(problem.bow_px) {
            row.px += bow_px;
        }
        if settings.free {
            corner_angles = Some(uncertainty::corner_angles(&fit, &causes));
        }
        Some(Fitted { fit, causes, checks, corner_angles })
    }

    /// The face with sharp edges.
    pub fn by_fit(&self, fitted: Fitted, corrections: &[Correction; 4]) -> Option<FaceMeasurement> {
        let key_points_px = fitted.fit.key_points_px(self.calibration)?;
        let Fitted { mut fit, causes, checks, corner_angles } = fitted;
        let straight = straightness::of_sides(&fit);
        let mut uncertainty = uncertainty::of_sides(&fit, &causes, corrections);
        for (side, straight) in straight.iter().enumerate() {
            uncertainty.own_mm2[(side / 2, side / 2)] += straight.reported.rms_mm.powi(2);
        }
        for (i, tilted_mm) in checks.tilted_mm.into_iter().enumerate() {
            uncertainty.own_mm2[(i, i)] += tilted_mm.powi(2);
        }
        for ((offset, correction), (_, high)) in fit.offsets_mm.iter_mut().zip(corrections).zip(SIDES) {
            *offset += if high { correction.outwards_mm } else { -correction.outwards_mm };
        }
        let values_mm = lengths_mm(&fit.offsets_mm);
        // A face whose sides lie off the fitted plane is seen as a plane that far nearer or farther.
        let (_, distance_mm) = fit.raster.plane.normal_and_distance_mm();
        let bulge = nalgebra::Vector2::from(values_mm) * (checks.off_plane_mm / distance_mm);
        uncertainty.own_mm2 += bulge * bulge.transpose();
        let sides = SideLengths { values_mm, uncertainty, corner_angles, straight };
        assemble(self, &fit, sides, key_points_px, checks.warnings)
    }

    /// The face as the paper has it: what the rounding of its edges takes is part of its error.
    fn by_key_points(
        &self,
        fitted: &Fitted,
        corrections: &[Correction; 4],
        points: &KeyPointSides,
    ) -> Option<FaceMeasurement> {
        let Fitted { fit, causes, checks, corner_angles } = fitted;
        let mut uncertainty = uncertainty::of_sides(fit, causes, corrections);
        for (i, pair) in corrections.chunks_exact(2).enumerate() {
            let outwards_mm: f64 = pair.iter().map(|c| c.outwards_mm).sum();
            uncertainty.own_mm2[(i, i)] += outwards_mm.powi(2) + points.variances_mm2[i];
        }
        let key_points_px = fit.key_points_px(self.calibration)?;
        let straight = straightness::of_sides(fit);
        let sides =
            SideLengths { values_mm: points.sides_mm, uncertainty, corner_angles: *corner_angles, straight };
        assemble(self, fit, sides, key_points_px, checks.warnings.clone())
    }
}

/// Distances of opposite sides, mm.
fn lengths_mm(offsets_mm: &[f64; 4]) -> [f64; 2] {
    [offsets_mm[1] - offsets_mm[0], offsets_mm[3] - offsets_mm[2]]
}

/// What edge residuals may be: more where the points come from a coarse map.
fn edge_limit_px(edges: &[Vec<EdgePoint>; 4]) -> f64 {
    let (sum, count) = edges.iter().flatten().fold((0.0, 0.0), |(s, n), e| (s + e.sigma_px, n + 1.0));
    let RectangleSettings { most_edge_rms_px, most_edge_rms_sigmas, .. } = RectangleSettings::DEFAULT;
    most_edge_rms_px.max(most_edge_rms_sigmas * sum / f64::max(count, 1.0))
}

/// The stripe centres that lie within the rectangle.
fn face_observations(
    calibration: &Calibration,
    face: &FaceStripes,
    initial: &InitialRectangle,
) -> Vec<StripeObservation> {
    let margin = RectangleSettings::DEFAULT.inside_px * initial.mm_per_px;
    let [a0, a1, b0, b1] = initial.offsets_mm;
    let inside = |o: &StripeObservation| {
        initial
            .raster
            .on_plane(calibration, o.at)
            .is_some_and(|p| p.x > a0 + margin && p.x < a1 - margin && p.y > b0 + margin && p.y < b1 - margin)
    };
    LaserId::ALL.into_iter().flat_map(|id| face.centres(id)).filter(inside).collect()
}

/// Every stripe must cross its two sides between their corners, and every corner must be in the image.
fn check_crossings(frame: &Frame, calibration: &Calibration, fit: &FittedRectangle) -> Result<(), Reject> {
    if let Some(cut) = corners_outside(frame, calibration, &fit.raster, &fit.offsets_mm) {
        return Err(cut);
    }
    let mut missed = None;
    let mut on_face = 4;
    for id in LaserId::ALL {
        let crosses = [0, 1].into_iter().all(|end| {
            let side = if id.number() <= 2 { end } else { 2 + end };
            fit.along_side_mm(calibration, id, side).is_some_and(|along| {
                let (low, high) = span_mm(&fit.offsets_mm, side);
                along > low && along < high
            })
        });
        if !crosses {
            on_face -= 1;
            missed = missed.or(Some(id));
        }
    }
    match missed {
        Some(laser) => Err(Reject::StripeMissing { laser, stripes_on_face: on_face }),
        None => Ok(()),
    }
}

/// The refusal if a corner lies outside the image.
fn corners_outside(
    frame: &Frame,
    calibration: &Calibration,
    raster: &PlaneRaster,
    offsets_mm: &[f64; 4],
) -> Option<Reject> {
    let (right, bottom) = (frame.width_px() as f64 - 0.5, frame.height_px() as f64 - 0.5);
    let outside = |p: &Px| p.u < -0.5 || p.v < -0.5 || p.u > right || p.v > bottom;
    let corners = corner_points(offsets_mm)
        .map(|corner| raster.pixel(calibration, corner).unwrap_or(Px::new(-1.0, -1.0)));
    let first = corners.iter().find(|p| outside(p))?;
    let sides_cut = corners.iter().filter(|p| outside(p)).count() as u8;
    Some(Reject::FaceCutByBorder { sides_cut, at: *first })
}

/// Corners on the raster, going round from low a, low b along a.
pub(crate) fn corner_points([a0, a1, b0, b1]: &[f64; 4]) -> [OnPlane; 4] {
    [OnPlane::new(*a0, *b0), OnPlane::new(*a1, *b0), OnPlane::new(*a1, *b1), OnPlane::new(*a0, *b1)]
}

/// The two lengths in the order of the raster.
struct SideLengths {
    values_mm: [f64; 2],
    uncertainty: SideUncertainty,
    corner_angles: Option<[AngleEstimate; 4]>,
    straight: [straightness::Side; 4],
}

fn assemble(
    observed: &FaceObservations,
    fit: &FittedRectangle,
    sides: SideLengths,
    key_points_px: [[Px; 2]; 4],
    mut warnings: Vec<Warning>,
) -> Option<FaceMeasurement> {
    let SideLengths { values_mm, mut uncertainty, mut corner_angles, straight } = sides;
    warnings.extend(straightness::bowed(&straight));
    let calibration = observed.calibration;
    let round = [fit.corner(0, 2), fit.corner(1, 2), fit.corner(1, 3), fit.corner(0, 3)];
    // Sides going round from corner 0: low b, high a, high b, low a.
    let mut order = [0, 1, 2, 3];
    let mut going_round = [2, 1, 3, 0];
    let mut values_mm = values_mm;
    // Of both sides that a length lies between.
    let mut beyond = [0, 2].map(|side| [straight[side].outermost, straight[side + 1].outermost]);
    if values_mm[0] < values_mm[1] {
        values_mm.swap(0, 1);
        beyond.swap(0, 1);
        let swap = Matrix2::new(0.0, 1.0, 1.0, 0.0);
        uncertainty.own_mm2 = swap * uncertainty.own_mm2 * swap;
        uncertainty.shared_mm = swap * uncertainty.shared_mm;
        order = [0, 3, 2, 1];
        going_round = [0, 3, 1, 2];
    }
    corner_angles = corner_angles.map(|angles| order.map(|i| angles[i]));
    let corners = order.map(|i| round[i]);
    let px = |c: OnPlane| fit.raster.pixel(calibration, c);
    let corners_px = [px(corners[0])?, px(corners[1])?, px(corners[2])?, px(corners[3])?];
    let used = |side: usize| -> Vec<Px> {
        observed.edges[side]
            .iter()
            .zip(&fit.edge_inliers[side])
            .filter(|(_, used)| **used)
            .map(|(e, _)| e.at)
            .collect()
    };
    let variances = uncertainty.covariance_mm2().diagonal();
    let estimate = |i: usize| Estimate::new(values_mm[i], variances[i].max(0.0).sqrt());
    let enclosing = |i: usize| {
        let [low, high] = beyond[i];
        let variance = variances[i].max(0.0) + low.sigma_mm.powi(2) + high.sigma_mm.powi(2);
        Estimate::new(values_mm[i] + low.value_mm + high.value_mm, variance.sqrt())
    };
    Some(FaceMeasurement {
        length: estimate(0),
        width: estimate(1),
        plane: fit.raster.plane,
        corners_px,
        corners: corners.map(|c| fit.raster.cam_point(c)),
        key_points_px,
        rms_px: fit.rms_px,
        stripe_points_px: LaserId::ALL
            .map(|id| observed.stripes.iter().filter(|s| s.laser == id).map(|s| s.at).collect()),
        edge_points_px: going_round.map(used),
        uncertainty,
        corner_angles,
        warnings,
        surface: surface::surface(calibration, fit, &corners),
        confidence: None,
        straightness: going_round.map(|side| straight[side].reported),
        light: None,
        enclosing: [enclosing(0), enclosing(1)],
    })
}

/// The places on the sides where the stripes cross, with the radius in which their light disturbs edges, px.
pub(crate) fn keep_out(
    calibration: &Calibration,
    face: &FaceStripes,
    initial: &InitialRectangle,
) -> Vec<(Px, f64)> {
    let radius = face.half_width_px + RectangleSettings::DEFAULT.beside_stripe_px;
    let mut places = Vec::with_capacity(8);
    for (side, (across, _)) in SIDES.iter().enumerate() {
        for id in across.stripes() {
            let at = crossing_on_px(calibration, &initial.raster, *across, initial.offsets_mm[side], id);
            places.extend(at.map(|at| (at, radius)));
        }
    }
    places
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::face::extent::{crossing_on, crossing_px};
    use crate::frames::Plane;
    use crate::paper_head::paper_head;
    use nalgebra::Vector3;

    const SIDES_MM: [f64; 4] = [-60.0, 160.0, -50.0, 150.0];

    /// A face with these sides, some 600 mm away.
    fn face(calibration: &Calibration) -> InitialRectangle {
        let plane = Plane::new(Vector3::new(0.15, -0.1, 1.0) / 600.0);
        let [l1, _, l3, l4] = LaserId::ALL;
        let at = crossing_px(calibration, &plane, l1, l3).expect("in view");
        let towards = crossing_px(calibration, &plane, l1, l4).expect("in view");
        let raster = PlaneRaster::new(calibration, &plane, at, towards).expect("in view");
        let mm_per_px = raster.mm_per_px(calibration, OnPlane::zeros()).expect("in view");
        InitialRectangle {
            raster,
            offsets_mm: SIDES_MM,
            at_ends: [true; 4],
            lines: Default::default(),
            mm_per_px,
        }
    }

    /// Its stripes, where it bulges by so much in the middle.
    fn stripes(calibration: &Calibration, face: &InitialRectangle, bow_mm: f64) -> Vec<StripeObservation> {
        let [a0, a1, b0, b1] = SIDES_MM;
        let share = |x: f64, from: f64, to: f64| 1.0 - (2.0 * (x - from) / (to - from) - 1.0).powi(2);
        let (normal, _) = face.raster.plane.normal_and_distance_mm();
        let surface = |at: OnPlane| {
            face.raster.cam_point(at).mm - normal * (bow_mm * share(at.x, a0, a1) * share(at.y, b0, b1))
        };
        let mut found = Vec::new();
        for (across, _) in [SIDES[0], SIDES[2]] {
            for laser in across.stripes() {
                let p = calibration.laser(laser).per_mm;
                for step in 0..45 {
                    let offset = -45.0 + 4.4 * f64::from(step);
                    let nearby = |along: f64| p.dot(&surface(across.at(offset, along))) - 1.0;
                    let mut along =
                        crossing_on(calibration, &face.raster, across, offset, laser).expect("it crosses");
                    for _ in 0..6 {
                        along -= nearby(along) / (nearby(along + 0.5) - nearby(along - 0.5));
                    }
                    let at = crate::frames::Point::from_vector(surface(across.at(offset, along)));
                    let at = calibration.camera().px_from_point(&at).expect("in view");
                    found.push(StripeObservation { laser, at, sigma_px: 0.3 });
                }
            }
        }
        found
    }

    /// Points along all sides, where `offset_mm` says that the point of this number lies.
    fn edges(
        calibration: &Calibration,
        face: &InitialRectangle,
        offset_mm: impl Fn(usize, u32) -> f64,
    ) -> [Vec<EdgePoint>; 4] {
        [0, 1, 2, 3].map(|side| {
            let (from, to) = span_mm(&SIDES_MM, side);
            let point = |i: u32| {
                let along = from + (to - from) * (f64::from(i) + 0.5) / 50.0;
                let at = face.raster.pixel(calibration, SIDES[side].0.at(offset_mm(side, i), along));
                EdgePoint { at: at.expect("in view"), sigma_px: 0.3 }
            };
            (0..50).map(point).collect()
        })
    }

    /// Print along an edge takes two in five points of each side; the rough sides lie on the print.
    #[test]
    fn the_line_of_most_points_is_the_side_wherever_the_rough_one_lies() {
        let calibration = paper_head(1.0);
        let truth = face(&calibration);
        let print_mm = 4.0 * truth.mm_per_px;
        let printed_mm =
            [0, 1, 2, 3].map(|side| SIDES_MM[side] + if SIDES[side].1 { -print_mm } else { print_mm });
        let stripes = stripes(&calibration, &truth, 0.0);
        let edges =
            edges(&calibration, &truth, |side, i| if i % 5 < 2 { printed_mm[side] } else { SIDES_MM[side] });
        let initial = InitialRectangle { offsets_mm: printed_mm, ..truth.clone() };
        let observed = FaceObservations { calibration: &calibration, stripes: &stripes, edges: &edges };
        let fitted = observed.fit(&initial, &Settings::default()).expect("a rectangle");
        for (found, true_mm) in lengths_mm(&fitted.fit.offsets_mm).into_iter().zip(lengths_mm(&SIDES_MM)) {
            assert!((found - true_mm).abs() < 0.2 * truth.mm_per_px, "{found} mm, {true_mm} mm are true");
        }
    }

    /// A face as a plane would come out 2 mm wrong.
    #[test]
    fn a_bowed_face_has_the_size_of_its_sides() {
        let calibration = paper_head(1.0);
        let truth = face(&calibration);
        let edges = edges(&calibration, &truth, |side, _| SIDES_MM[side]);
        for bow_mm in [8.0, -8.0] {
            let stripes = stripes(&calibration, &truth, bow_mm);
            let observed = FaceObservations { calibration: &calibration, stripes: &stripes, edges: &edges };
            let fitted = observed.fit(&truth, &Settings::default()).expect("a rectangle");
            assert!(!fitted.checks.warnings.is_empty(), "{bow_mm} mm are not reported");
            for (found, true_mm) in lengths_mm(&fitted.fit.offsets_mm).into_iter().zip(lengths_mm(&SIDES_MM))
            {
                assert!((found - true_mm).abs() < 0.4, "{bow_mm}: {found} mm, {true_mm} mm are true");
            }
        }
    }
}
