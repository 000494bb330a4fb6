//! The four sides of a face: how they are named and ordered, and a rectangle to within some pixels.

use super::raster::{OnPlane, PlaneRaster};
use crate::units::LaserId;

/// Largest angle between a stripe and a side of the box on the face: the head is rolled by eye, and a tilted face shears.
pub(crate) const MOST_TURN_RAD: f64 = 0.56;

/// Which raster coordinate tells a side's place; the side runs along the other one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Across {
    /// Sides that stripes 1 and 2 cross: offset along a.
    A,
    /// Sides that stripes 3 and 4 cross: offset along b.
    B,
}

impl Across {
    /// A raster position from the offset across the side and the position along it, mm.
    pub fn at(self, offset: f64, along: f64) -> OnPlane {
        match self {
            Self::A => OnPlane::new(offset, along),
            Self::B => OnPlane::new(along, offset),
        }
    }

    /// The offset of a raster position, mm.
    pub fn offset(self, at: OnPlane) -> f64 {
        match self {
            Self::A => at.x,
            Self::B => at.y,
        }
    }

    /// The position along the side of a raster position, mm.
    pub fn along(self, at: OnPlane) -> f64 {
        match self {
            Self::A => at.y,
            Self::B => at.x,
        }
    }

    /// The two stripes that cross such a side.
    pub fn stripes(self) -> [LaserId; 2] {
        let [l1, l2, l3, l4] = LaserId::ALL;
        match self {
            Self::A => [l1, l2],
            Self::B => [l3, l4],
        }
    }
}

/// The four sides and whether each is the high one: low and high a, low and high b. All arrays of four sides follow it.
pub(crate) const SIDES: [(Across, bool); 4] =
    [(Across::A, false), (Across::A, true), (Across::B, false), (Across::B, true)];

/// Sign of the direction outwards in a side's offsets.
pub(crate) fn outward_sign(side: usize) -> f64 {
    if SIDES[side].1 { 1.0 } else { -1.0 }
}

/// A line that a side may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct WeightedLine {
    pub offset_mm: f64,
    /// Of the evidence for all lines of the side.
    pub share: f64,
}

/// A rectangle to within some pixels: sides parallel to the raster's axes.
#[derive(Clone, Debug)]
pub(crate) struct InitialRectangle {
    pub raster: PlaneRaster,
    /// Offsets of the sides in the order [`SIDES`], mm.
    pub offsets_mm: [f64; 4],
    /// Whether the ends of both stripes lie on the side (not so beside a flush neighbour).
    pub at_ends: [bool; 4],
    /// Lines that each side may be; none where nothing tells.
    pub lines: [Vec<WeightedLine>; 4],
    /// Size of a pixel on the face, mm.
    pub mm_per_px: f64,
}

impl InitialRectangle {
    /// Of which no more is known.
    pub fn new(raster: PlaneRaster, offsets_mm: [f64; 4], mm_per_px: f64) -> Self {
        Self { raster, offsets_mm, at_ends: [true; 4], lines: Default::default(), mm_per_px }
    }

    /// Where a side begins and ends along its direction, mm.
    pub fn span_mm(&self, side: usize) -> (f64, f64) {
        span_mm(&self.offsets_mm, side)
    }
}

/// Where a side begins and ends along its direction, mm, from the offsets of all four.
pub(crate) fn span_mm(offsets_mm: &[f64; 4], side: usize) -> (f64, f64) {
    match SIDES[side].0 {
        Across::A => (offsets_mm[2], offsets_mm[3]),
        Across::B => (offsets_mm[0], offsets_mm[1]),
    }
}
