//! The calibration board and what one frame shows of it.

use boxline::units::Px;
use nalgebra::Vector2;

/// Frame of the board: origin at the middle of its grid, x along the columns, y along the rows, z out of the printed
/// side, mm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OnBoard;

/// A grid of dark circles on a white board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Board {
    /// Circles along x.
    pub columns: u32,
    /// Circles along y.
    pub rows: u32,
    /// Distance of neighbouring centres, mm.
    pub pitch_mm: f64,
    /// Diameter of a circle, mm.
    pub diameter_mm: f64,
}

impl Board {
    /// Centre of the circle in a column and row, mm on the board.
    #[must_use]
    pub fn centre_mm(&self, column: i32, row: i32) -> Vector2<f64> {
        let middle = |n: u32| 0.5 * (f64::from(n) - 1.0);
        Vector2::new(f64::from(column) - middle(self.columns), f64::from(row) - middle(self.rows))
            * self.pitch_mm
    }

    /// Distance of a place on the board from the rim of the nearest circle, mm; negative inside it.
    #[must_use]
    pub fn from_rim_mm(&self, at_mm: Vector2<f64>) -> f64 {
        let shift = self.centre_mm(0, 0);
        let cell = (at_mm - shift) / self.pitch_mm;
        (cell - cell.map(f64::round)).norm() * self.pitch_mm - 0.5 * self.diameter_mm
    }
}

/// One circle of the board in a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Circle {
    /// Column on the board, from 0.
    pub column: i32,
    /// Row on the board, from 0.
    pub row: i32,
    /// Centre of the ellipse that fits its rim. Not the image of its centre: see `rim.rs`.
    pub ellipse_centre: Px,
    /// Points of its rim, free of laser light.
    pub rim: Vec<Px>,
    /// Scatter of the rim about the ellipse, px.
    pub rim_rms_px: f64,
}

/// The circles that one frame shows.
///
/// The grid has no mark, so a frame does not tell which way round the board is nor, if part of it is outside the frame,
/// which part. Calibration does not need it: a grid moved by a pitch or turned by 90 degrees is the same grid at another
/// pose, and every frame has its own pose.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardView {
    /// Width of the frame, px.
    pub width_px: usize,
    /// Height of the frame, px.
    pub height_px: usize,
    /// At least 9, in order of row and column.
    pub circles: Vec<Circle>,
    /// Width of the rims from dark to white, 10 to 90 %, px: a measure of blur.
    pub rim_width_px: f64,
}

impl BoardView {
    /// Numbers of columns and rows between the outermost circles.
    #[must_use]
    pub fn span(&self) -> (u32, u32) {
        let of = |coordinate: fn(&Circle) -> i32| {
            let all = || self.circles.iter().map(coordinate);
            all().max().zip(all().min()).map_or(0, |(high, low)| high.abs_diff(low) + 1)
        };
        (of(|c| c.column), of(|c| c.row))
    }
}
