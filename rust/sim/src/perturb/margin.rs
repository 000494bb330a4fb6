//! Changes beside the face: black bars as a change of format leaves them, a date as cameras stamp it.

use super::like;
use crate::Error;
use crate::material::font;
use boxline::Frame;
use std::fmt;

/// Bars are this share of the picture's side, or less where the face leaves less room.
const BAR_SHARE: f64 = 0.08;
/// Thinner bars are no bars.
const THINNEST_BAR_PX: f64 = 12.0;
/// What stays free round the face.
const CLEARANCE_PX: f64 = 12.0;
/// Height of the date's letters, and its distance from the picture's borders, as shares of the picture's height.
const LETTER_SHARE: f64 = 0.025;
const OFFSET_SHARE: f64 = 0.02;
const DATE: &str = "2024-06-18 14:35";
/// The orange of a camera's date.
const DATE_RGB: [u8; 3] = [255, 150, 30];

/// Which borders have bars.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sides {
    /// Above and below.
    TopAndBottom,
    /// Left and right.
    LeftAndRight,
}

impl Sides {
    /// Both ways.
    pub const ALL: [Self; 2] = [Self::TopAndBottom, Self::LeftAndRight];
}

impl fmt::Display for Sides {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::TopAndBottom => "top and bottom",
            Self::LeftAndRight => "left and right",
        })
    }
}

/// A corner of the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Corner {
    bottom: bool,
    right: bool,
}

impl Corner {
    /// All four.
    pub const ALL: [Self; 4] = [
        Self { bottom: false, right: false },
        Self { bottom: false, right: true },
        Self { bottom: true, right: false },
        Self { bottom: true, right: true },
    ];
}

impl fmt::Display for Corner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let row = if self.bottom { "bottom" } else { "top" };
        write!(f, "{row} {}", if self.right { "right" } else { "left" })
    }
}

pub fn with_bars(frame: &Frame, face: Option<&[[f64; 2]; 4]>, sides: Sides) -> Result<Option<Frame>, Error> {
    let (width, height) = (frame.width_px(), frame.height_px());
    let (axis, extent) = match sides {
        Sides::LeftAndRight => (0, width),
        Sides::TopAndBottom => (1, height),
    };
    let most = BAR_SHARE * extent as f64;
    let low = face.map_or(f64::INFINITY, |f| f.iter().map(|px| px[axis]).fold(f64::INFINITY, f64::min));
    let high = face.map_or(0.0, |f| f.iter().map(|px| px[axis]).fold(0.0, f64::max));
    let bars = [low, extent as f64 - 1.0 - high]
        .map(|room| most.min(room - CLEARANCE_PX))
        .map(|bar| if bar < THINNEST_BAR_PX { 0 } else { bar as usize });
    if bars == [0, 0] {
        return Ok(None);
    }
    let inside = bars[0]..extent - bars[1];
    let mut rgb = frame.rgb().to_vec();
    for (row, line) in rgb.chunks_exact_mut(width * 3).enumerate() {
        if axis == 1 && !inside.contains(&row) {
            line.fill(0);
        } else if axis == 0 {
            line[..inside.start * 3].fill(0);
            line[inside.end * 3..].fill(0);
        }
    }
    like(frame, rgb).map(Some)
}

pub fn with_date(
    frame: &Frame,
    face: Option<&[[f64; 2]; 4]>,
    corner: Corner,
) -> Result<Option<Frame>, Error> {
    let (width, height) = (frame.width_px() as f64, frame.height_px() as f64);
    let (letter, offset) = (LETTER_SHARE * height, OFFSET_SHARE * height);
    let unit = letter / 6.0;
    let text_width = f64::from(font::width(DATE)) * unit;
    let left = if corner.right { width - offset - text_width } else { offset };
    let top = if corner.bottom { height - offset - letter } else { offset };
    let area = [
        [left - CLEARANCE_PX, left + text_width + CLEARANCE_PX],
        [top - CLEARANCE_PX, top + letter + CLEARANCE_PX],
    ];
    if left < 0.0 || face.is_some_and(|face| touches(area, face)) {
        return Ok(None);
    }
    let mut rgb = frame.rgb().to_vec();
    let pen = 0.45 * unit;
    for [x0, y0, x1, y1] in font::segments(DATE) {
        let [x0, x1] = [x0, x1].map(|x| left + f64::from(x) * unit);
        let [y0, y1] = [y0, y1].map(|y| top + f64::from(y) * unit);
        draw_segment(&mut rgb, frame.width_px(), [x0, y0], [x1, y1], pen);
    }
    like(frame, rgb).map(Some)
}

/// Mixes a stroke with round ends into the picture, which holds it with a margin.
fn draw_segment(rgb: &mut [u8], width: usize, from: [f64; 2], to: [f64; 2], pen_px: f64) {
    let reach = pen_px + 1.0;
    let span = |i: usize| {
        let (low, high) = (from[i].min(to[i]) - reach, from[i].max(to[i]) + reach);
        low.max(0.0) as usize..=high.max(0.0) as usize
    };
    let along = [to[0] - from[0], to[1] - from[1]];
    let squared = (along[0] * along[0] + along[1] * along[1]).max(1e-9);
    for row in span(1) {
        for column in span(0) {
            let d = [column as f64 - from[0], row as f64 - from[1]];
            let t = ((d[0] * along[0] + d[1] * along[1]) / squared).clamp(0.0, 1.0);
            let distance = (d[0] - t * along[0]).hypot(d[1] - t * along[1]);
            let share = (pen_px + 0.5 - distance).clamp(0.0, 1.0);
            let at = (row * width + column) * 3;
            if let Some(px) = rgb.get_mut(at..at + 3) {
                for (level, ink) in px.iter_mut().zip(DATE_RGB) {
                    *level = (f64::from(*level) * (1.0 - share) + f64::from(ink) * share + 0.5) as u8;
                }
            }
        }
    }
}

/// Whether an upright rectangle ([low, high] of u and of v) and a convex quadrilateral have a point in common: no line along a side
/// of either separates them.
fn touches(area: [[f64; 2]; 2], quad: &[[f64; 2]; 4]) -> bool {
    let [[u0, u1], [v0, v1]] = area;
    let rectangle = [[u0, v0], [u1, v0], [u1, v1], [u0, v1]];
    let separates = |normal: [f64; 2]| {
        let span = |points: &[[f64; 2]; 4]| {
            let along = points.map(|p| p[0] * normal[0] + p[1] * normal[1]);
            [
                along.iter().copied().fold(f64::INFINITY, f64::min),
                along.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            ]
        };
        let ([a0, a1], [b0, b1]) = (span(&rectangle), span(quad));
        a1 < b0 || b1 < a0
    };
    let sides = (0..4).map(|i| {
        let (a, b) = (quad[i], quad[(i + 1) % 4]);
        [b[1] - a[1], a[0] - b[0]]
    });
    !sides.chain([[1.0, 0.0], [0.0, 1.0]]).any(separates)
}
