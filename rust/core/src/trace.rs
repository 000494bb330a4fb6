//! What each stage of a measurement found, for whoever wants to look on ([`Settings::trace`](crate::Settings::trace)): `boxline measure
//! --explain` draws it. Looking on changes no result.

use crate::image::Frame;
use crate::image::laser_response::{RidgeMap, Z_STEPS};
use crate::network::FaceMaps;
use crate::units::Px;

/// Is told what each stage found.
pub trait Trace: Sync {
    /// Called after each stage that came to an end, from the thread that measures the frame. Stages of one frame come in order; those of
    /// several frames mix where [`Settings::workers`](crate::Settings::workers) has threads. A stage that refuses is not told.
    fn found(&self, frame: &Frame, stage: &Stage<'_>);
}

/// What a stage found. All positions are px of the frame; arrays of four have laser 1 first.
#[derive(Clone, Copy)]
#[non_exhaustive]
pub enum Stage<'a> {
    /// The network's maps.
    Network(&'a FaceMaps),
    /// The search for planes that carry the grid of four stripes. Comes again, with wider means, where light is faint.
    Planes {
        /// Where it was searched.
        response: LaserResponse<'a>,
        /// The planes, strongest first, perhaps none. They are tried in this order until one can be measured.
        planes: &'a [TracedPlane],
    },
    /// The stripes were followed on one of the planes: each try of a plane begins with this.
    Stripes(&'a [TracedStripe; 4]),
    /// The lines that a side of the face may be, and the outlines that they make.
    Outlines {
        /// Of all four sides: lines of the picture, weighed.
        lines: &'a [TracedLine],
        /// Likeliest first. Each is measured, for which its lines are found exactly.
        outlines: &'a [TracedOutline],
    },
}

/// How much each pixel looks like a stripe.
#[derive(Clone, Copy)]
pub struct LaserResponse<'a> {
    maps: &'a [RidgeMap; 2],
}

impl<'a> LaserResponse<'a> {
    pub(crate) const fn new(maps: &'a [RidgeMap; 2]) -> Self {
        Self { maps }
    }

    /// Ridge strength of stripes 1 and 2 (pair 0) or 3 and 4 (pair 1) at a pixel, in units of the local noise, from -3 to 3; 0 outside.
    ///
    /// # Panics
    /// If there is no such pair.
    #[must_use]
    pub fn sigmas(&self, pair: usize, at: Px) -> f32 {
        self.maps[pair].steps_at(at) as f32 / Z_STEPS
    }
}

/// The grid of four stripes on one plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TracedPlane {
    /// Each stripe from one of its crossings to the other.
    pub segments_px: [[Px; 2]; 4],
    /// Mean ridge strength of each segment, sigmas.
    pub strength: [f32; 4],
}

/// One stripe on a face's plane.
#[derive(Clone, Debug, PartialEq)]
pub struct TracedStripe {
    /// Centres that lie on the plane.
    pub on_plane_px: Vec<Px>,
    /// Centres found beyond its two ends: light on other surfaces, or print.
    pub beyond_px: Vec<Px>,
    /// Where it leaves the plane.
    pub ends_px: [Px; 2],
}

/// A line that may be a side of the face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TracedLine {
    /// Its ends.
    pub ends_px: [Px; 2],
    /// Its share of what speaks for all lines of this side, 0 to 1.
    pub share: f64,
}

/// An outline of the face, to some px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TracedOutline {
    /// Its corners, going round.
    pub corners_px: [Px; 4],
    /// Probability that all four of its sides are right.
    pub probability: f64,
}
