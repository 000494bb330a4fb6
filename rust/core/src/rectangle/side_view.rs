//! How a side of a fitted face is seen, and where the strongest gradient of its rounded edge then lies.

use super::refine::FittedRectangle;
use crate::face::outline::{SIDES, span_mm};
use nalgebra::{Vector2, Vector3};

/// A side's correction outwards, mm, and its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Correction {
    pub outwards_mm: f64,
    pub sigma_mm: f64,
    /// The part of sigma that all edges of a box share: what is not known of its radius.
    pub by_radius_mm: f64,
}

/// Where the strongest gradient of an edge lies: this share of its radius inside the sharp edge, and the scatter of that.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rule {
    /// A larger one makes boxes larger.
    pub share: f64,
    /// One standard deviation. A larger one makes shading and stripes' ends count for more.
    pub share_sigma: f64,
}

/// The rules of both kinds of edges.
#[derive(Clone, Copy, Debug)]
struct EdgeKinds {
    /// The strongest gradient on a crease lies this share of the radius inside the sharp edge when the face is seen straight on,
    /// less by the tangent of the view where the neighbouring face shows; and its scatter. It lies where the rounding begins if the
    /// neighbour is the brighter one and where it ends if it is darker, which light decides. Means over light, views and blur
    /// of a quarter cylinder under Lambert's law (`rust/sim/src/points/rounding.rs`); rendered boxes: 0.1 to 0.3, scatter 0.35. A larger share
    /// makes boxes larger, a larger scatter makes shading and stripes' ends count for more.
    crease: Rule,
    /// The strongest gradient of a silhouette lies this share of the radius inside the touching ray, since the rounding's
    /// shading begins before it ends; and the scatter of that: shading, a neighbour of the same brightness behind. From the same
    /// model (0.09, 0.26) and the same from rendered boxes (0.1). Larger values do as those of a crease.
    silhouette: Rule,
}

impl EdgeKinds {
    const DEFAULT: Self = Self {
        crease: Rule { share: 0.37, share_sigma: 0.41 },
        silhouette: Rule { share: 0.09, share_sigma: 0.26 },
    };
}

impl Default for EdgeKinds {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// How a side is seen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SideView {
    /// Tangent of the angle from the face's normal to the line of sight, towards outside: positive where the neighbouring face is in
    /// view (a crease), else a silhouette.
    pub tan: f64,
    /// Across the side, on the face's plane.
    pub mm_per_px: f64,
}

/// Unit vector across the side, outwards.
pub(crate) fn outwards(fit: &FittedRectangle, side: usize) -> Vector3<f64> {
    let (across, high) = SIDES[side];
    let axis = fit.raster.cam_point(across.at(1.0, 0.0)).mm - fit.raster.cam_point(Vector2::zeros()).mm;
    if high { axis } else { -axis }
}

/// The middle of the side.
pub(crate) fn middle(fit: &FittedRectangle, side: usize) -> Vector3<f64> {
    let (from, to) = span_mm(&fit.offsets_mm, side);
    fit.raster.cam_point(SIDES[side].0.at(fit.offsets_mm[side], 0.5 * (from + to))).mm
}

/// Unit normal of the face, away from the camera.
pub(crate) fn normal(fit: &FittedRectangle) -> Vector3<f64> {
    fit.raster.plane.normal_and_distance_mm().0
}

impl Rule {
    pub fn new(view: &SideView) -> Self {
        let EdgeKinds { crease, silhouette } = EdgeKinds::DEFAULT;
        if view.tan > 0.0 {
            // The neighbouring face is in view: between both ends of the rounding as it appears.
            Self { share: crease.share * (1.0 - view.tan).max(0.0), ..crease }
        } else {
            // The ray that touches the rounding meets the face's plane inside the edge.
            Self { share: touching_share(view) + silhouette.share, ..silhouette }
        }
    }
}

/// How far inside the sharp edge of a silhouette the line of sight touches it, on the face's plane and in radii.
pub(crate) fn touching_share(view: &SideView) -> f64 {
    if view.tan < 0.0 { 1.0 - view.tan - 1.0f64.hypot(view.tan) } else { 0.0 }
}
