//! One frame in, the circles of the board out, or why it cannot be used.

use super::blobs::dark_blobs;
use super::board::{Board, BoardView, Circle};
use super::grid::largest_grid;
use super::reject::FrameReject;
use super::rim::find_rim;
use boxline::image::Frame;
use boxline::statistics::median;

/// Fewest circles of a frame: 6 unknowns of its pose leave 12 equations to check it and to tell about the camera.
pub const MIN_CIRCLES: usize = 9;
/// Columns and rows that must be seen at least.
pub const MIN_SPAN: u32 = 3;
/// Rims wider than this share of the radius leave no level dark inside to compare with.
const MAX_BLUR_RADII: f64 = 0.6;

/// Finds the board in a frame.
///
/// # Errors
/// [`FrameReject`] with what was found and what is needed.
pub fn find_board(frame: &Frame, board: &Board) -> Result<BoardView, FrameReject> {
    let blobs = dark_blobs(frame);
    let grid = largest_grid(&blobs);
    if grid.len() < MIN_CIRCLES {
        return Err(FrameReject::NoBoard { blobs: blobs.len(), in_grid: grid.len() });
    }
    let mut circles = Vec::with_capacity(grid.len());
    let mut widths = Vec::new();
    let mut wide = 0;
    for ((column, row), blob) in &grid {
        let Some(rim) = find_rim(frame, &blobs[*blob]) else { continue };
        widths.push(rim.width_px);
        wide += usize::from(rim.width_px > MAX_BLUR_RADII * blobs[*blob].radius_px());
        circles.push(Circle {
            column: *column,
            row: *row,
            ellipse_centre: rim.ellipse_centre,
            rim: rim.points,
            rim_rms_px: rim.rms_px,
        });
    }
    let rim_width_px = median(widths).unwrap_or(f64::INFINITY);
    if 2 * wide > circles.len() {
        return Err(FrameReject::Blurred { rim_width_px });
    }
    let mut view =
        BoardView { width_px: frame.width_px(), height_px: frame.height_px(), circles, rim_width_px };
    let (columns, rows) = view.span();
    if view.circles.len() < MIN_CIRCLES || columns < MIN_SPAN || rows < MIN_SPAN {
        return Err(FrameReject::TooFewCircles { found: view.circles.len(), needed: MIN_CIRCLES });
    }
    place(&mut view, board);
    Ok(view)
}

/// Gives the circles columns and rows of the board: turned by 90 degrees if that fits better, and moved to its middle.
fn place(view: &mut BoardView, board: &Board) {
    let (columns, rows) = view.span();
    let outside = |c: u32, r: u32| c.saturating_sub(board.columns) + r.saturating_sub(board.rows);
    if outside(rows, columns) < outside(columns, rows) {
        for c in &mut view.circles {
            (c.column, c.row) = (-c.row, c.column);
        }
    }
    let (columns, rows) = view.span();
    let lowest = |of: fn(&Circle) -> i32| view.circles.iter().map(of).min().unwrap_or(0);
    let (left, top) = (lowest(|c| c.column), lowest(|c| c.row));
    let shift = |seen: u32, all: u32| (all.saturating_sub(seen) / 2) as i32;
    let (right, down) = (shift(columns, board.columns) - left, shift(rows, board.rows) - top);
    for c in &mut view.circles {
        c.column += right;
        c.row += down;
    }
    view.circles.sort_by_key(|c| (c.row, c.column));
}
