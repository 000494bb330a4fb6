//! Paint on a face: bands, frames, straps, tape and posters, near the sides and parallel to them. All of it is rectangles in the
//! face's own coordinates, mm from its middle along length and width.

use std::fmt;

/// Print and tape are about as sharp in the picture as the lens makes edges, px.
const SOFT_PX: f32 = 1.5;

/// What is painted, and how far from the sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paint {
    part: Part,
    ink: Ink,
}

/// Shapes of paint. "Inset" is the distance of its outer border from the side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Part {
    /// A line all round.
    Frame {
        /// From the sides, mm.
        inset_mm: f32,
        /// Its width, mm.
        line_mm: f32,
    },
    /// All of the face but a margin.
    Field {
        /// Of the margin, mm.
        inset_mm: f32,
    },
    /// A strip along a `length` side, or along both.
    AlongLength {
        /// From the side, mm.
        inset_mm: f32,
        /// Its width, mm.
        wide_mm: f32,
        /// Along both sides.
        both: bool,
    },
    /// A strip along a `width` side, or along both.
    AlongWidth {
        /// From the side, mm.
        inset_mm: f32,
        /// Its width, mm.
        wide_mm: f32,
        /// Along both sides.
        both: bool,
    },
    /// Tape over the middle seam and both `width` sides.
    H {
        /// Of the tape, mm.
        wide_mm: f32,
        /// That lies on this face where it is folded over a side, mm.
        folded_mm: f32,
    },
    /// Two rectangles in opposite corners, half as long and wide as the face.
    Posters {
        /// From both sides, mm.
        inset_mm: f32,
    },
    /// From the middle of the length to its end.
    Half,
}

/// Colours of paint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ink {
    /// Black print.
    Black,
    /// White print, film, label.
    White,
    /// Red, as the lasers are.
    Red,
    /// Dark blue.
    Blue,
    /// Green.
    Green,
    /// Brown parcel tape: little darker than board.
    Tape,
}

impl Ink {
    /// Share of R, G, B that it sends back.
    #[must_use]
    pub const fn albedo(self) -> [f32; 3] {
        match self {
            Self::Black => [0.04, 0.04, 0.04],
            Self::White => [0.80, 0.80, 0.78],
            Self::Red => [0.50, 0.05, 0.04],
            Self::Blue => [0.04, 0.09, 0.35],
            Self::Green => [0.06, 0.30, 0.10],
            Self::Tape => [0.36, 0.24, 0.13],
        }
    }
}

impl Paint {
    /// What `boxline evaluate --perturb` paints.
    pub const ALL: [Self; 15] = [
        Self { part: Part::Frame { inset_mm: 6.0, line_mm: 3.0 }, ink: Ink::Black },
        Self { part: Part::Frame { inset_mm: 15.0, line_mm: 8.0 }, ink: Ink::Red },
        Self { part: Part::Frame { inset_mm: 25.0, line_mm: 5.0 }, ink: Ink::White },
        Self { part: Part::Field { inset_mm: 4.0 }, ink: Ink::White },
        Self { part: Part::Field { inset_mm: 12.0 }, ink: Ink::Blue },
        Self { part: Part::AlongLength { inset_mm: 8.0, wide_mm: 30.0, both: false }, ink: Ink::Black },
        Self { part: Part::AlongLength { inset_mm: 0.0, wide_mm: 25.0, both: true }, ink: Ink::Tape },
        Self { part: Part::AlongLength { inset_mm: 20.0, wide_mm: 14.0, both: true }, ink: Ink::White },
        Self { part: Part::AlongWidth { inset_mm: 15.0, wide_mm: 40.0, both: true }, ink: Ink::Red },
        Self { part: Part::AlongWidth { inset_mm: 3.0, wide_mm: 20.0, both: false }, ink: Ink::Green },
        Self { part: Part::AlongWidth { inset_mm: 12.0, wide_mm: 14.0, both: true }, ink: Ink::Black },
        Self { part: Part::H { wide_mm: 50.0, folded_mm: 25.0 }, ink: Ink::Tape },
        Self { part: Part::Posters { inset_mm: 5.0 }, ink: Ink::White },
        Self { part: Part::Posters { inset_mm: 20.0 }, ink: Ink::Blue },
        Self { part: Part::Half, ink: Ink::Red },
    ];

    /// Its colour.
    #[must_use]
    pub const fn ink(&self) -> Ink {
        self.ink
    }

    /// The rectangles on a face that is seen to so far from its middle, mm.
    pub(super) fn patches(&self, half: [f32; 2]) -> Vec<Patch> {
        let [x, y] = half;
        let whole = [[-x, x], [-y, y]];
        // A strip across axis 0 or 1, at its high end or at both.
        let strips = |axis: usize, inset: f32, wide: f32, both: bool| {
            let high = [half[axis] - inset - wide, half[axis] - inset];
            let low = [-high[1], -high[0]];
            let patch = |span| {
                let mut spans = whole;
                spans[axis] = span;
                Patch { spans, hole: None }
            };
            if both { vec![patch(high), patch(low)] } else { vec![patch(high)] }
        };
        let within = |inset: f32| whole.map(|[low, high]| [low + inset, high - inset]);
        match self.part {
            Part::Frame { inset_mm, line_mm } => {
                vec![Patch { spans: within(inset_mm), hole: Some(within(inset_mm + line_mm)) }]
            }
            Part::Field { inset_mm } => vec![Patch { spans: within(inset_mm), hole: None }],
            Part::AlongLength { inset_mm, wide_mm, both } => strips(1, inset_mm, wide_mm, both),
            Part::AlongWidth { inset_mm, wide_mm, both } => strips(0, inset_mm, wide_mm, both),
            Part::H { wide_mm, folded_mm } => {
                let mut all = strips(0, 0.0, folded_mm, true);
                all.push(Patch { spans: [whole[0], [-0.5 * wide_mm, 0.5 * wide_mm]], hole: None });
                all
            }
            Part::Posters { inset_mm } => {
                let [[x0, x1], [y0, y1]] = within(inset_mm);
                vec![
                    Patch { spans: [[x0, x0 + x], [y0, y0 + y]], hole: None },
                    Patch { spans: [[x1 - x, x1], [y1 - y, y1]], hole: None },
                ]
            }
            Part::Half => vec![Patch { spans: [[0.0, x], whole[1]], hole: None }],
        }
    }
}

impl fmt::Display for Paint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ink = match self.ink {
            Ink::Black => "black",
            Ink::White => "white",
            Ink::Red => "red",
            Ink::Blue => "blue",
            Ink::Green => "green",
            Ink::Tape => "tape-brown",
        };
        let sides = |both: bool| if both { "sides" } else { "side" };
        match self.part {
            Part::Frame { inset_mm, line_mm } => {
                write!(f, "{ink} frame, {line_mm} mm wide, {inset_mm} mm inside")
            }
            Part::Field { inset_mm } => write!(f, "{ink} field, {inset_mm} mm inside"),
            Part::AlongLength { inset_mm, wide_mm, both } => {
                write!(f, "{ink} strip, {wide_mm} mm wide, {inset_mm} mm inside the length {}", sides(both))
            }
            Part::AlongWidth { inset_mm, wide_mm, both } => {
                write!(f, "{ink} strip, {wide_mm} mm wide, {inset_mm} mm inside the width {}", sides(both))
            }
            Part::H { wide_mm, folded_mm } => {
                write!(f, "{ink} H, {wide_mm} mm wide, {folded_mm} mm at the width sides")
            }
            Part::Posters { inset_mm } => write!(f, "{ink} posters, {inset_mm} mm inside"),
            Part::Half => write!(f, "{ink} half of the length"),
        }
    }
}

/// A painted rectangle: from where to where along length and width, mm, and what is left out of it.
pub(super) struct Patch {
    spans: [[f32; 2]; 2],
    hole: Option<[[f32; 2]; 2]>,
}

impl Patch {
    /// The painted share of a pixel at this place.
    pub(super) fn share(&self, at: [f32; 2], mm_per_px: [f32; 2]) -> f32 {
        let within = |spans: &[[f32; 2]; 2]| {
            [0, 1]
                .map(|i| {
                    let inside_mm = (at[i] - spans[i][0]).min(spans[i][1] - at[i]);
                    (inside_mm / (SOFT_PX * mm_per_px[i]).max(1e-6) + 0.5).clamp(0.0, 1.0)
                })
                .iter()
                .product::<f32>()
        };
        let share = within(&self.spans);
        if share <= 0.0 {
            return 0.0;
        }
        share * (1.0 - self.hole.as_ref().map_or(0.0, within))
    }
}
