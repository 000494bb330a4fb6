//! One face of a rounded box under four lasers, as points.

use super::rounding::{Edge, EdgePicture, Light};
use super::truth::PointFace;
use crate::head::Head;
use crate::pose::{Along, Crossing, FacePose, px_of};
use crate::rng::Rng;
use boxline::points::{BrightnessProfile, PointWithSigma, SidePoints};
use boxline::{LaserId, Px};
use nalgebra::{Matrix3, Vector3};

/// How the face departs from a sharp flat rectangle, and what lights it.
#[derive(Clone, Debug)]
pub(super) struct Surface {
    /// Columns: the face's right, down and into the box, in the axes of the box and its light.
    pub box_from_face: Matrix3<f64>,
    pub light: Light,
    pub radius_mm: f64,
    pub bulge_mm: f64,
    pub skew_rad: f64,
}

/// Noise of one class of points, drawn for a frame.
struct Noise {
    sigma_px: f64,
    /// What the measurement believes its sigma to be.
    claimed_px: f64,
    /// Correlation of neighbours.
    rho: f64,
    spacing_px: f64,
}

/// Share of stripe centres that print or a scratch put elsewhere, and how far, px.
const OUTLIERS: (f64, f64) = (0.01, 4.0);
/// Blur and unequal brightness move a whole edge, and its ends against each other, px, 1 sigma (PHYSICS.md: sub-pixel
/// edges are good to about this).
const EDGE_SHIFT_PX: f64 = 0.2;
/// Blur of lens, motion and demosaicing, px.
const BLUR_PX: (f64, f64) = (0.8, 1.3);
/// Brightness of what lies behind a silhouette, of the face's: median, and scatter of its logarithm.
const BEHIND: (f64, f64) = (0.67, 0.8);
/// An edge lies beside its place, mm, 1 sigma: crushed, taped, a flap that stands off.
const WEAR_MM: f64 = 0.2;
/// Share of sides whose shading is seen: beside the others are print, shadows or flush boxes (of rendered sides three in four have a
/// clear profile).
const PROFILE_SHARE: f64 = 0.75;
/// A profile goes so far over the box, and so far beyond a silhouette.
const PROFILE_MM: f64 = 5.0;
const PROFILE_BEYOND_PX: usize = 5;
/// Scatter of its samples over the light on the face (texture, averaged along the side), and correlation of neighbours.
const PROFILE_NOISE: (f64, f64) = (0.002, 0.02);
const PROFILE_RHO: f64 = 0.5;
/// Part of a side at its corners without edge points.
const CORNER_SHARE: f64 = 0.03;
/// Around a stripe there are no edge points, px.
const STRIPE_HALF_PX: f64 = 15.0;
/// Share of creases beyond which stripes are seen, how well they tell the sharp edge (mm), and how far behind the face.
const BEYOND_SHARE: f64 = 0.7;
const BEYOND_MM: (f64, f64) = (0.15, 0.5);
const BEYOND_DEPTH_MM: f64 = 20.0;

impl Noise {
    fn draw(rng: &mut Rng, sigma_px: (f64, f64), rho: (f64, f64), spacing_px: (f64, f64)) -> Self {
        let sigma = rng.log_range(sigma_px.0, sigma_px.1);
        Self {
            sigma_px: sigma,
            claimed_px: sigma * rng.log_range(0.7, 1.4),
            rho: rng.range(rho.0, rho.1),
            spacing_px: rng.log_range(spacing_px.0, spacing_px.1),
        }
    }

    /// The next value of a chain with unit variance.
    fn next(&self, rng: &mut Rng, last: f64) -> f64 {
        self.rho * last + (1.0 - self.rho * self.rho).sqrt() * rng.normal()
    }
}

/// What the head sees of a face; `None` if a point lies behind it.
pub(super) fn see_face(rng: &mut Rng, head: &Head, pose: &FacePose, surface: &Surface) -> Option<PointFace> {
    let crossings = pose.crossings(head, 0.0, 0.0)?;
    let noise = Noise::draw(rng, (0.15, 0.5), (0.0, 0.6), (4.0, 12.0));
    let mut stripes: [Vec<PointWithSigma>; 4] = Default::default();
    for (index, crossing) in crossings.iter().enumerate() {
        stripes[index] = see_stripe(rng, head, pose, surface, index, crossing, &noise)?;
    }
    let noise = Noise::draw(rng, (0.2, 0.7), (0.0, 0.7), (8.0, 16.0));
    let mut sides: [SidePoints; 4] = Default::default();
    let mut inside_mm = [0.0; 4];
    for side in 0..4 {
        (sides[side], inside_mm[side]) = see_side(rng, head, pose, surface, side, &crossings, &noise)?;
    }
    Some(PointFace { stripes, sides, inside_mm })
}

impl Surface {
    /// A point of the face, mm right and down of its middle, as it bulges.
    fn point(&self, pose: &FacePose, right: f64, down: f64) -> Vector3<f64> {
        let (x, y) = (right / pose.half[0], down / pose.half[1]);
        let nearer = self.bulge_mm * (1.0 - x * x) * (1.0 - y * y);
        pose.point(right, down) - pose.cam_from_face.column(2) * nearer
    }
}

fn see_stripe(
    rng: &mut Rng,
    head: &Head,
    pose: &FacePose,
    surface: &Surface,
    index: usize,
    crossing: &Crossing,
    noise: &Noise,
) -> Option<Vec<PointWithSigma>> {
    let plane = head.plane(index);
    // Where the laser's sheet meets the surface for a place along the stripe: Newton across it.
    let lit = |along: f64| -> Vector3<f64> {
        let axis = usize::from(crossing.along == Along::Right);
        let mut across = crossing.at[0][axis];
        let at = |across: f64| match crossing.along {
            Along::Right => surface.point(pose, along, across),
            Along::Down => surface.point(pose, across, along),
        };
        for _ in 0..8 {
            let here = plane.dot(&at(across)) - 1.0;
            let slope = plane.dot(&(at(across + 0.5) - at(across - 0.5)));
            across -= here / slope;
        }
        at(across)
    };
    let half = pose.half[usize::from(crossing.along == Along::Down)] - surface.radius_mm;
    let [first, last] = [px_of(head, &lit(-half))?, px_of(head, &lit(half))?];
    let count = (first.distance_px(last) / noise.spacing_px).floor().max(12.0) as usize;
    let mut chain = rng.normal();
    let mut seen = Vec::with_capacity(count);
    for i in 0..count {
        let along = ((i as f64 + 0.5) / count as f64 * 2.0 - 1.0) * half;
        let (at, next) = (px_of(head, &lit(along))?, px_of(head, &lit(along + 1.0))?);
        chain = noise.next(rng, chain);
        let far = if rng.chance(OUTLIERS.0) { rng.sign() * OUTLIERS.1 } else { 0.0 };
        seen.push((beside(at, next, noise.sigma_px * chain + far), noise.claimed_px));
    }
    Some(seen)
}

/// A pixel position moved across the way to the next one, px.
fn beside(at: Px, next: Px, across_px: f64) -> Px {
    let length = at.distance_px(next).max(1e-9);
    let (du, dv) = ((next.u - at.u) / length, (next.v - at.v) / length);
    Px::new(at.u - dv * across_px, at.v + du * across_px)
}

/// The brightness across a side where the face has so many mm to a px.
fn see_profile(rng: &mut Rng, picture: &EdgePicture, mm_per_px: f64, crease: bool) -> BrightnessProfile {
    let sigma = rng.log_range(PROFILE_NOISE.0, PROFILE_NOISE.1) * picture.light(-PROFILE_MM / mm_per_px);
    let claimed = sigma * rng.log_range(0.7, 1.4);
    let mut chain = rng.normal();
    let inside_px = (PROFILE_MM / mm_per_px + 3.0).clamp(6.0, 30.0).round() as usize;
    let beyond_px = if crease { inside_px } else { PROFILE_BEYOND_PX };
    let samples = (0..=inside_px + beyond_px)
        .map(|i| {
            chain = PROFILE_RHO * chain + (1.0 - PROFILE_RHO * PROFILE_RHO).sqrt() * rng.normal();
            (picture.light(i as f64 - inside_px as f64) + sigma * chain, claimed)
        })
        .collect();
    BrightnessProfile { inside_px, samples }
}

/// A side, and how far inside the sharp edge it shows, mm. Side 0 is left, 1 right, 2 up, 3 down of the face's middle.
fn see_side(
    rng: &mut Rng,
    head: &Head,
    pose: &FacePose,
    surface: &Surface,
    side: usize,
    crossings: &[Crossing; 4],
    noise: &Noise,
) -> Option<(SidePoints, f64)> {
    let axis = side / 2;
    let sign = if side.is_multiple_of(2) { -1.0 } else { 1.0 };
    let out: Vector3<f64> = pose.cam_from_face.column(axis) * sign;
    let inwards: Vector3<f64> = pose.cam_from_face.column(2).into();
    let half_along = pose.half[1 - axis];
    // The sharp edge; a skewed face leans its left and right sides.
    let sharp = |along: f64| -> Vector3<f64> {
        let lean = if axis == 0 { along * surface.skew_rad.tan() } else { 0.0 };
        let across = sign * pose.half[axis] + lean;
        if axis == 0 { pose.point(across, along) } else { pose.point(along, across) }
    };
    let view = -sharp(0.0).normalize();
    let view_tan = view.dot(&out) / -view.dot(&inwards);
    let crease = view_tan > 0.0;
    let mm_per_px = sharp(0.0).norm() / head.calibration.camera().fx;
    let edge = Edge {
        normal: -surface.box_from_face.column(2),
        out: surface.box_from_face.column(axis) * sign,
        view_tan,
        radius_px: surface.radius_mm / mm_per_px,
        blur_px: rng.range(BLUR_PX.0, BLUR_PX.1),
        behind: (BEHIND.1 * rng.normal()).exp() * BEHIND.0,
    };
    let picture = edge.picture(&surface.light);
    let inside_mm = surface.radius_mm * picture.inside_share;
    let worn_mm = WEAR_MM * rng.normal();
    let shown = |along: f64| sharp(along) - out * (inside_mm + worn_mm);
    let stripes_px: Vec<Px> = crossings
        .iter()
        .flat_map(|c| c.at)
        .filter(|at| (at[axis] - sign * pose.half[axis]).abs() < 1e-6)
        .filter_map(|at| px_of(head, &sharp(at[1 - axis])))
        .collect();
    let reach = half_along * (1.0 - 2.0 * CORNER_SHARE);
    let [first, last] = [px_of(head, &shown(-reach))?, px_of(head, &shown(reach))?];
    let count = (first.distance_px(last) / noise.spacing_px).floor().max(12.0) as usize;
    let (shift, lean) = (EDGE_SHIFT_PX * rng.normal(), EDGE_SHIFT_PX * rng.normal());
    let mut chain = rng.normal();
    let mut points = Vec::with_capacity(count);
    for i in 0..count {
        let t = (i as f64 + 0.5) / count as f64 * 2.0 - 1.0;
        let (at, next) = (px_of(head, &shown(t * reach))?, px_of(head, &shown(t * reach + 1.0))?);
        chain = noise.next(rng, chain);
        if stripes_px.iter().all(|s| s.distance_px(at) > STRIPE_HALF_PX) {
            let across_px = noise.sigma_px * chain + shift + lean * t;
            points.push((beside(at, next, across_px), noise.claimed_px));
        }
    }
    let mut seen = SidePoints { points, ..SidePoints::default() };
    if rng.chance(PROFILE_SHARE) {
        seen.profile = Some(see_profile(rng, &picture, mm_per_px / view_tan.atan().cos(), crease));
    }
    if crease && rng.chance(BEYOND_SHARE) {
        seen.beyond_sigma_mm = rng.log_range(BEYOND_MM.0, BEYOND_MM.1);
        let off_mm = seen.beyond_sigma_mm * rng.normal();
        for (index, crossing) in crossings.iter().enumerate() {
            let along = match crossing.along {
                Along::Right if axis == 0 => crossing.at[usize::from(sign > 0.0)][1],
                Along::Down if axis == 1 => crossing.at[usize::from(sign > 0.0)][0],
                _ => continue,
            };
            // On the neighbouring surface the sheet of light runs on in its own plane.
            let plane = head.plane(index);
            let surface_at = |along: f64| sharp(along) + out * off_mm + inwards * BEYOND_DEPTH_MM;
            let slope = plane.dot(&(surface_at(along + 0.5) - surface_at(along - 0.5)));
            let along = along - (plane.dot(&surface_at(along)) - 1.0) / slope;
            seen.beyond.push((LaserId::ALL[index], px_of(head, &surface_at(along))?));
        }
    }
    Some((seen, inside_mm))
}
