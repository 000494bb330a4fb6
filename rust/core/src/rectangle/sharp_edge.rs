//! From the edge that the image shows to the edge of the sharp box. Cardboard edges are rounded: what the image shows lies
//! inside the sharp edge by a part of the radius. Two sources correct it, each with its own sigma:
//!
//! - Beyond a crease (or where the box stands on the floor) the stripes run on over a surface at a right angle to the face
//!   that contains the sharp edge. Each of their points is triangulated on its laser plane; its coordinate across the side
//!   is the side's place, whatever the radius.
//! - The arc's shading tells radius and place ([`rounding`]); where it does not, geometry and the radius of the other sides or, at
//!   last, of cardboard.

use super::refine::FittedRectangle;
use super::rounding::{self, EdgeProfile};
use super::side_view::{Correction, Rule, SideView, middle, normal, outwards, touching_share};
use super::stripe_ends::{self, StripeEnds};
use crate::calibration::Calibration;
use crate::face::extent::FaceStripes;
use crate::face::outline::SIDES;
use crate::frames::Plane;
use crate::image::Frame;
use crate::statistics::{median, robust_sigma, tukey_weight};
use crate::stripe::centres::{CentreSettings, find_centres};
use crate::stripe::stripe_line::{ScanDirection, StripeLine};
use crate::units::{LaserId, Px};
use nalgebra::{Matrix2, Vector2};

/// Mean radius of cardboard's edges (0.5 to 4 mm, PHYSICS.md, every scale alike).
pub(crate) const USUAL_RADIUS_MM: f64 = 1.7;
/// Stripe points up to this far behind the face are used, mm: nearer ones lie on the rounding, farther ones only tell of
/// the neighbouring face's own angle.
const DEPTH_MM: (f64, f64) = (5.0, 120.0);
/// Squareness of cartons, rad, 1 sigma: half a degree.
const SQUARE_RAD: f64 = 0.009;
/// The stripes beyond the edge are followed this far, px.
const FOLLOW_PX: f64 = 400.0;
/// The sharp edge lies within this range outside the image's edge, mm: more than the largest radius is another surface.
const RANGE_MM: (f64, f64) = (-1.5, 4.5);
/// Texture moves single centres by this much, px.
const TEXTURE_PX: f64 = 0.2;
/// Fewest stripe points that count as a surface.
const MIN_POINTS: usize = 8;
/// What remains of a measured side, mm: flatness of the neighbouring face near the edge.
const FLATNESS_MM: f64 = 0.15;

/// What is known of the four sides, in the order of [`SIDES`].
pub(crate) struct Sharpened {
    pub corrections: [Correction; 4],
    /// How far outwards, mm, the stripes' ends want each side; 0 where they are not far from its line.
    pub misplaced_mm: [f64; 4],
}

/// Both ends of a side want it elsewhere if that is farther than this many sigmas and px: edges and ends scatter by 1 to 2 px.
const MISPLACED: (f64, f64) = (3.0, 4.0);
/// Beyond a crease with a greater tangent of the view a stripe may run on along nearly the same line in the picture.
const STEEP_TAN: f64 = 0.15;

/// Finds the way from the fitted lines to the sharp edges; `keep_out` are places with laser light.
pub(crate) fn sharpen(
    frame: &Frame,
    calibration: &Calibration,
    face: &FaceStripes,
    fit: &FittedRectangle,
    at_ends: &[bool; 4],
    keep_out: &[(Px, f64)],
) -> Sharpened {
    let views = views(calibration, fit);
    let rules = views.map(|view| Rule::new(&view));
    let mut tables = [0, 1, 2, 3].map(|side| {
        let view = &views[side];
        let profile =
            at_ends[side].then(|| rounding::profile(frame, calibration, fit, side, view, keep_out))??;
        rounding::explain(&profile, &rules[side], view)
    });
    let by_shading = rounding::corrections(&rules, &views, &tables);
    let mut misplaced_mm = [0.0; 4];
    let mut contradicted = [None; 4];
    for side in 0..4 {
        let Some(ends) = stripe_ends::find(
            frame,
            calibration,
            &fit.raster,
            fit.offsets_mm[side],
            side,
            face.half_width_px,
        ) else {
            continue;
        };
        let off_mm = off_mm(&ends, &by_shading[side], &views[side]);
        let far = off_mm.abs() > MISPLACED.0 * by_shading[side].sigma_mm.hypot(ends.sigma_mm);
        if far && ends.agree && off_mm.abs() > MISPLACED.1 * ends.mm_per_px {
            misplaced_mm[side] = off_mm;
        }
        if far {
            contradicted[side] = Some(off_mm);
        } else if at_ends[side] {
            let explained = rounding::explain_ends(&ends, &rules[side], &views[side]);
            tables[side] = Some(tables[side].map_or(explained, |table| table + explained));
        }
    }
    let expected = rounding::corrections(&rules, &views, &tables);
    let corrections = [0, 1, 2, 3].map(|side| {
        if !at_ends[side] {
            // A seam between flush boxes is dark where both roundings meet: at the sharp edge.
            return Correction { outwards_mm: 0.0, sigma_mm: 0.3, by_radius_mm: 0.0 };
        }
        if let Some(off_mm) = contradicted[side] {
            return between(expected[side], off_mm);
        }
        match from_stripes(frame, calibration, face, fit, side) {
            Some((outwards_mm, sigma_mm)) => combine(expected[side], outwards_mm, sigma_mm),
            None => expected[side],
        }
    });
    Sharpened { corrections, misplaced_mm }
}

/// How far outwards of the expected sharp edge the stripes' ends want it, mm.
fn off_mm(ends: &StripeEnds, expected: &Correction, view: &SideView) -> f64 {
    let off_mm = ends.outwards_mm + touching_share(view) * USUAL_RADIUS_MM - expected.outwards_mm;
    if view.tan > STEEP_TAN { off_mm.min(0.0) } else { off_mm }
}

/// Edge and stripes contradict each other: either may be right.
fn between(expected: Correction, off_mm: f64) -> Correction {
    Correction {
        outwards_mm: expected.outwards_mm + 0.5 * off_mm,
        sigma_mm: expected.sigma_mm.hypot(0.5 * off_mm),
        by_radius_mm: expected.by_radius_mm,
    }
}

fn views(calibration: &Calibration, fit: &FittedRectangle) -> [SideView; 4] {
    let straight_on = SideView { tan: 0.0, mm_per_px: 1.0 };
    [0, 1, 2, 3].map(|side| rounding::view(calibration, fit, side).unwrap_or(straight_on))
}

/// What shading and geometry tell of all four sides.
pub(crate) fn from_shading(
    calibration: &Calibration,
    fit: &FittedRectangle,
    profiles: &[Option<EdgeProfile>; 4],
) -> [Correction; 4] {
    let views = views(calibration, fit);
    let rules = views.map(|view| Rule::new(&view));
    let tables =
        [0, 1, 2, 3].map(|side| rounding::explain(profiles[side].as_ref()?, &rules[side], &views[side]));
    rounding::corrections(&rules, &views, &tables)
}

/// Weighted mean of what shading and radius tell and what the stripes measured.
pub(crate) fn combine(expected: Correction, outwards_mm: f64, sigma_mm: f64) -> Correction {
    let (w1, w2) = (expected.sigma_mm.powi(-2), sigma_mm.powi(-2));
    Correction {
        outwards_mm: (expected.outwards_mm * w1 + outwards_mm * w2) / (w1 + w2),
        sigma_mm: (w1 + w2).sqrt().recip(),
        by_radius_mm: expected.by_radius_mm * w1 / (w1 + w2),
    }
}

/// The side's place from stripe points beyond it, outwards from the image's edge, and its sigma, mm.
fn from_stripes(
    frame: &Frame,
    calibration: &Calibration,
    face: &FaceStripes,
    fit: &FittedRectangle,
    side: usize,
) -> Option<(f64, f64)> {
    let (across, _) = SIDES[side];
    let (out, at) = (outwards(fit, side), middle(fit, side));
    if -at.dot(&out) <= 0.0 {
        return None; // the neighbouring surface faces away
    }
    // The surface at a right angle through the side.
    let neighbour = Plane::new(out / out.dot(&at));
    let mut samples = Vec::new();
    for id in across.stripes() {
        collect(frame, calibration, face, fit, side, id, &neighbour, &mut samples);
    }
    robust_line(&samples)
}

/// A stripe point beyond the edge.
struct Sample {
    /// Place across the side, outwards from the image's edge, mm.
    outwards_mm: f64,
    /// Distance behind the face, mm.
    depth_mm: f64,
    sigma_mm: f64,
}

#[allow(clippy::too_many_arguments)] // one call, all of it needed
fn collect(
    frame: &Frame,
    calibration: &Calibration,
    face: &FaceStripes,
    fit: &FittedRectangle,
    side: usize,
    id: LaserId,
    neighbour: &Plane<crate::frames::Cam>,
    samples: &mut Vec<Sample>,
) -> Option<()> {
    let (across, _) = SIDES[side];
    let along = fit.along_side_mm(calibration, id, side)?;
    let end = fit.raster.pixel(calibration, across.at(fit.offsets_mm[side], along))?;
    let line = StripeLine::new(calibration, id, neighbour);
    let place = |p: Px| match line.scan {
        ScanDirection::Rows => p.v,
        ScanDirection::Columns => p.u,
    };
    // Outwards is where a point a little behind the face, on the neighbouring surface, appears.
    let laser = calibration.laser(id);
    let out = outwards(fit, side);
    let behind = {
        let edge = fit.raster.cam_point(across.at(fit.offsets_mm[side], along)).mm;
        // On the laser's plane and the neighbouring surface: their common direction.
        let direction = laser.per_mm.cross(&out).try_normalize(1e-9)?;
        let direction = if direction.dot(&normal(fit)) > 0.0 { direction } else { -direction };
        calibration.camera().px_from_point(&crate::frames::Point::from_vector(edge + direction * 10.0))?
    };
    let (from, to) = (place(end), place(behind));
    if (to - from).abs() < 1.0 {
        return None;
    }
    let range = if to > from { from..from + FOLLOW_PX } else { from - FOLLOW_PX..from };
    let start = line.px_at(calibration, range.start.max(0.0), line.scan.across(end))?.0;
    let settings = CentreSettings { half_width_px: face.half_width_px, ..CentreSettings::default() };
    let inside = normal(fit);
    let reference = middle(fit, side);
    for found in
        find_centres(frame, calibration, &line, range, start, &settings).iter().filter_map(|p| p.found)
    {
        let coordinate = |px: Px| {
            let x = laser.intersect(&calibration.camera().ray_from_px(px))?.mm - reference;
            Some((x.dot(&out), x.dot(&inside)))
        };
        let (outwards_mm, depth_mm) = coordinate(found.at)?;
        if !(DEPTH_MM.0..DEPTH_MM.1).contains(&depth_mm) {
            continue;
        }
        let moved = match line.scan {
            ScanDirection::Rows => Px::new(found.at.u + 1.0, found.at.v),
            ScanDirection::Columns => Px::new(found.at.u, found.at.v + 1.0),
        };
        let per_px = (coordinate(moved)?.0 - outwards_mm).abs();
        let sigma_mm = per_px * found.sigma_px.hypot(TEXTURE_PX);
        samples.push(Sample { outwards_mm, depth_mm, sigma_mm: sigma_mm.max(1e-3) });
    }
    Some(())
}

/// Place of the surface at the face's depth: a robust line over the depth with a prior on its slope (squareness).
fn robust_line(samples: &[Sample]) -> Option<(f64, f64)> {
    let near = |s: &&Sample| {
        let spread = SQUARE_RAD * s.depth_mm + 3.0 * s.sigma_mm;
        s.outwards_mm > RANGE_MM.0 - spread && s.outwards_mm < RANGE_MM.1 + spread
    };
    let samples: Vec<&Sample> = samples.iter().filter(near).collect();
    if samples.len() < MIN_POINTS {
        return None;
    }
    let mut state = Vector2::new(median(samples.iter().map(|s| s.outwards_mm))?, 0.0);
    let mut covariance = Matrix2::zeros();
    let mut used = 0.0;
    let mut scale = 1.0;
    for _ in 0..10 {
        let residual = |s: &Sample| (s.outwards_mm - state.x - state.y * s.depth_mm) / s.sigma_mm;
        scale = robust_sigma(samples.iter().map(|s| residual(s)))?.max(1.0);
        let mut information = Matrix2::new(0.0, 0.0, 0.0, SQUARE_RAD.powi(-2));
        let mut right = Vector2::zeros();
        used = 0.0;
        for s in &samples {
            let robust = tukey_weight(residual(s) / scale);
            let weight = robust / (s.sigma_mm * scale).powi(2);
            let row = Vector2::new(1.0, s.depth_mm);
            information += row * row.transpose() * weight;
            right += row * (weight * s.outwards_mm);
            used += robust;
        }
        covariance = information.try_inverse()?;
        state = covariance * right;
    }
    // Neighbouring points share texture: one in two is independent.
    let sigma = (2.0 * covariance[(0, 0)]).sqrt().hypot(FLATNESS_MM);
    let good = used >= MIN_POINTS as f64 && scale < 4.0 && state.x > RANGE_MM.0 && state.x < RANGE_MM.1;
    good.then_some((state.x, sigma))
}
