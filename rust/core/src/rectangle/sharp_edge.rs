//! From the edge that the image shows to the edge of the sharp box. Cardboard edges are rounded: what the image shows lies
//! inside the sharp edge by a part of the radius. Two sources correct it, each with its own sigma:
//!
//! - Beyond a crease (or where the box stands on the floor) the stripes run on over a surface at a right angle to the face
//!   that contains the sharp edge. Each of their points is triangulated on its laser plane; its coordinate across the side
//!   is the side's place, whatever the radius.
//! - The arc's shading tells radius and place ([`rounding`]); where it does not, geometry and the radius of the other sides or, at
//!   last, of cardboard.

use super::refine::FittedRectangle;
use super::rounding::{self, EdgeProfile, RoundingSettings};
use super::side_view::{Correction, Rule, SideView, middle, normal, outwards, touching_share};
use super::stripe_ends::{self, StripeEnds};
use crate::calibration::Calibration;
use crate::face::extent::FaceStripes;
use crate::face::outline::SIDES;
use crate::frames::{Plane, Point};
use crate::image::Frame;
use crate::statistics::{median, robust_sigma, tukey_weight};
use crate::stripe::centres::{CentreSettings, find_centres};
use crate::stripe::stripe_line::{ScanDirection, StripeLine};
use crate::units::{LaserId, Px};
use nalgebra::{Matrix2, Vector2, Vector3};
use std::ops::Range;

/// Mean radius of cardboard's edges (0.5 to 4 mm, PHYSICS.md, every scale alike).
pub(crate) const USUAL_RADIUS_MM: f64 = 1.7;

/// Which stripe points beyond a side tell of its sharp edge, and when stripes' ends contradict its line.
#[derive(Clone, Copy, Debug)]
struct SharpEdgeSettings {
    /// Stripe points so far behind the face are used, mm: nearer ones lie on the rounding, farther ones only tell of
    /// the neighbouring face's own angle. A larger range takes the rounding, or another surface, for that face.
    depth_mm: [f64; 2],
    /// Squareness of cartons, rad, 1 sigma: half a degree. More lets the points' own slope decide, less lets a skewed box move its side.
    square_rad: f64,
    /// The stripes beyond the edge are followed this far, px. More takes longer.
    follow_px: f64,
    /// The sharp edge lies within this range outside the image's edge, mm: more than the largest radius is another surface, which a larger
    /// range takes for the neighbouring face.
    range_mm: [f64; 2],
    /// Texture moves single centres by this much, px. More lets the stripes say less.
    texture_px: f64,
    /// Fewest stripe points that count as a surface. More loses narrow neighbouring faces.
    least_points: usize,
    /// What remains of a measured side, mm: flatness of the neighbouring face near the edge. More lets the stripes say less.
    flatness_mm: f64,
    /// Stripes' ends contradict a side's line from this many sigmas on; the side may then be at either place. More takes the line where the
    /// ends are right.
    misplaced_sigmas: f64,
    /// ... and two ends that agree want it elsewhere if that is farther than so many px too: edges and ends scatter by 1 to 2 px. More keeps
    /// a side that lies on print.
    misplaced_px: f64,
    /// Beyond a crease with a greater tangent of the view a stripe may run on along nearly the same line in the picture. More takes its end on
    /// the neighbouring face for that of the face.
    steep_tan: f64,
    /// How far a seam between flush boxes is from both sharp edges, mm, 1 sigma. More makes intervals too wide.
    seam_mm: f64,
}

impl SharpEdgeSettings {
    const DEFAULT: Self = Self {
        depth_mm: [5.0, 120.0],
        square_rad: 0.009,
        follow_px: 400.0,
        range_mm: [-1.5, 4.5],
        texture_px: 0.2,
        least_points: 8,
        flatness_mm: 0.15,
        misplaced_sigmas: 3.0,
        misplaced_px: 4.0,
        steep_tan: 0.15,
        seam_mm: 0.3,
    };
}

impl Default for SharpEdgeSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What is known of the four sides, in the order of [`SIDES`].
pub(crate) struct Sharpened {
    pub corrections: [Correction; 4],
    /// How far outwards, mm, the stripes' ends want each side; 0 where they are not far from its line.
    pub misplaced_mm: [f64; 4],
}

/// Finds the way from the fitted lines to the sharp edges; `keep_out` are places with laser light.
pub(crate) fn sharpen(
    frame: &Frame,
    calibration: &Calibration,
    face: &FaceStripes,
    fit: &FittedRectangle,
    at_ends: &[bool; 4],
    keep_out: &[(Px, f64)],
) -> Sharpened {
    let (rounding, settings) = (RoundingSettings::default(), SharpEdgeSettings::default());
    let views = views(calibration, fit);
    let rules = views.map(|view| Rule::new(&view));
    let mut tables = [0, 1, 2, 3].map(|side| {
        let view = &views[side];
        let profile =
            at_ends[side].then(|| rounding.profile(frame, calibration, fit, side, view, keep_out))??;
        rounding.explain(&profile, &rules[side], view)
    });
    let by_shading = rounding.corrections(&rules, &views, &tables);
    let mut misplaced_mm = [0.0; 4];
    let mut contradicted = [None; 4];
    for side in 0..4 {
        let offset_mm = fit.offsets_mm[side];
        let ends = stripe_ends::find(frame, calibration, &fit.raster, offset_mm, side, face.half_width_px);
        let Some(ends) = ends else { continue };
        let off_mm = settings.off_mm(&ends, &by_shading[side], &views[side]);
        let sigma_mm = by_shading[side].sigma_mm.hypot(ends.sigma_mm);
        let far = off_mm.abs() > settings.misplaced_sigmas * sigma_mm;
        if far && ends.agree && off_mm.abs() > settings.misplaced_px * ends.mm_per_px {
            misplaced_mm[side] = off_mm;
        }
        if far {
            contradicted[side] = Some(off_mm);
        } else if at_ends[side] {
            let explained = rounding.explain_ends(&ends, &rules[side], &views[side]);
            tables[side] = Some(tables[side].map_or(explained, |table| table + explained));
        }
    }
    let expected = rounding.corrections(&rules, &views, &tables);
    let corrections = [0, 1, 2, 3].map(|side| {
        if !at_ends[side] {
            // A seam between flush boxes is dark where both roundings meet: at the sharp edge.
            return Correction { outwards_mm: 0.0, sigma_mm: settings.seam_mm, by_radius_mm: 0.0 };
        }
        if let Some(off_mm) = contradicted[side] {
            return between(expected[side], off_mm);
        }
        match settings.by_stripes(frame, calibration, face, fit, side) {
            Some((outwards_mm, sigma_mm)) => combine(expected[side], outwards_mm, sigma_mm),
            None => expected[side],
        }
    });
    Sharpened { corrections, misplaced_mm }
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
    let rounding = RoundingSettings::default();
    let views = views(calibration, fit);
    let rules = views.map(|view| Rule::new(&view));
    let tables =
        [0, 1, 2, 3].map(|side| rounding.explain(profiles[side].as_ref()?, &rules[side], &views[side]));
    rounding.corrections(&rules, &views, &tables)
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

/// A stripe point beyond the edge.
struct Sample {
    /// Place across the side, outwards from the image's edge, mm.
    outwards_mm: f64,
    /// Distance behind the face, mm.
    depth_mm: f64,
    sigma_mm: f64,
}

impl SharpEdgeSettings {
    /// How far outwards of the expected sharp edge the stripes' ends want it, mm.
    fn off_mm(&self, ends: &StripeEnds, expected: &Correction, view: &SideView) -> f64 {
        let off_mm = ends.outwards_mm + touching_share(view) * USUAL_RADIUS_MM - expected.outwards_mm;
        if view.tan > self.steep_tan { off_mm.min(0.0) } else { off_mm }
    }

    /// The side's place from stripe points beyond it, outwards from the image's edge, and its sigma, mm.
    fn by_stripes(
        &self,
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
        let half_width_px = face.half_width_px;
        let beyond = Beyond { frame, calibration, fit, side, out, half_width_px, settings: self };
        let mut samples = Vec::new();
        for id in across.stripes() {
            beyond.collect(id, &mut samples);
        }
        self.robust_line(&samples)
    }

    /// Place of the surface at the face's depth: a robust line over the depth with a prior on its slope (squareness).
    fn robust_line(&self, samples: &[Sample]) -> Option<(f64, f64)> {
        let near = |s: &&Sample| {
            let spread = self.square_rad * s.depth_mm + 3.0 * s.sigma_mm;
            s.outwards_mm > self.range_mm[0] - spread && s.outwards_mm < self.range_mm[1] + spread
        };
        let samples: Vec<&Sample> = samples.iter().filter(near).collect();
        if samples.len() < self.least_points {
            return None;
        }
        let mut state = Vector2::new(median(samples.iter().map(|s| s.outwards_mm))?, 0.0);
        let mut covariance = Matrix2::zeros();
        let mut used = 0.0;
        let mut scale = 1.0;
        for _ in 0..10 {
            let residual = |s: &Sample| (s.outwards_mm - state.x - state.y * s.depth_mm) / s.sigma_mm;
            scale = robust_sigma(samples.iter().map(|s| residual(s)))?.max(1.0);
            let mut information = Matrix2::new(0.0, 0.0, 0.0, self.square_rad.powi(-2));
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
        let sigma = (2.0 * covariance[(0, 0)]).sqrt().hypot(self.flatness_mm);
        let good = used >= self.least_points as f64
            && scale < 4.0
            && state.x > self.range_mm[0]
            && state.x < self.range_mm[1];
        good.then_some((state.x, sigma))
    }
}

/// The surface at a right angle to the face through a side.
struct Beyond<'a> {
    frame: &'a Frame,
    calibration: &'a Calibration,
    fit: &'a FittedRectangle,
    side: usize,
    /// Its normal, away from the face.
    out: Vector3<f64>,
    half_width_px: f64,
    settings: &'a SharpEdgeSettings,
}

impl Beyond<'_> {
    /// Adds the points of a stripe on it.
    fn collect(&self, id: LaserId, samples: &mut Vec<Sample>) -> Option<()> {
        let Self { calibration, fit, side, out, settings, .. } = *self;
        let reference = middle(fit, side);
        let line = StripeLine::new(calibration, id, &Plane::new(out / out.dot(&reference)));
        let (range, start) = self.range(id, &line)?;
        let centres = CentreSettings { half_width_px: self.half_width_px, ..CentreSettings::default() };
        let (laser, inside) = (calibration.laser(id), normal(fit));
        let found = find_centres(self.frame, calibration, &line, range, start, &centres);
        for found in found.iter().filter_map(|p| p.found) {
            let coordinate = |px: Px| {
                let x = laser.intersect(&calibration.camera().ray_from_px(px))?.mm - reference;
                Some((x.dot(&out), x.dot(&inside)))
            };
            let (outwards_mm, depth_mm) = coordinate(found.at)?;
            if !(settings.depth_mm[0]..settings.depth_mm[1]).contains(&depth_mm) {
                continue;
            }
            let moved = match line.scan {
                ScanDirection::Rows => Px::new(found.at.u + 1.0, found.at.v),
                ScanDirection::Columns => Px::new(found.at.u, found.at.v + 1.0),
            };
            let per_px = (coordinate(moved)?.0 - outwards_mm).abs();
            let sigma_mm = per_px * found.sigma_px.hypot(settings.texture_px);
            samples.push(Sample { outwards_mm, depth_mm, sigma_mm: sigma_mm.max(1e-3) });
        }
        Some(())
    }

    /// Where along its walk a stripe is followed from the side outwards, and a pixel of its line there.
    fn range(&self, id: LaserId, line: &StripeLine) -> Option<(Range<f64>, Px)> {
        let Self { calibration, fit, side, out, .. } = *self;
        let (across, _) = SIDES[side];
        let along = fit.along_side_mm(calibration, id, side)?;
        let on_side = across.at(fit.offsets_mm[side], along);
        let end = fit.raster.pixel(calibration, on_side)?;
        // Outwards is where a point a little behind the face, on the neighbouring surface, appears: on the laser's plane too, thus along
        // their common direction.
        let direction = calibration.laser(id).per_mm.cross(&out).try_normalize(1e-9)?;
        let direction = if direction.dot(&normal(fit)) > 0.0 { direction } else { -direction };
        let behind = Point::from_vector(fit.raster.cam_point(on_side).mm + direction * 10.0);
        let behind = calibration.camera().px_from_point(&behind)?;
        let (from, to) = (line.scan.along(end), line.scan.along(behind));
        if (to - from).abs() < 1.0 {
            return None;
        }
        let follow_px = self.settings.follow_px;
        let range = if to > from { from..from + follow_px } else { from - follow_px..from };
        let start = line.px_at(calibration, range.start.max(0.0), line.scan.across(end))?.0;
        Some((range, start))
    }
}
