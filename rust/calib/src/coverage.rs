//! Where on the sensor a solved set says nothing: its empty corners. No reason to refuse (a box need not reach a corner), but
//! the distortion there is extrapolated, which no residual and no covariance shows.

use super::solve::CalibrationSolution;
use boxline::units::Px;

/// A corner of the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Corner {
    /// At pixel (0, 0).
    TopLeft,
    /// At the last column of the first row.
    TopRight,
    /// At the first column of the last row.
    BottomLeft,
    /// At the last column of the last row.
    BottomRight,
}

impl std::fmt::Display for Corner {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::TopLeft => "top left",
            Self::TopRight => "top right",
            Self::BottomLeft => "bottom left",
            Self::BottomRight => "bottom right",
        })
    }
}

/// A corner is seen if a circle lies this share of the way out to it, in columns and in rows. A lens whose r^4 is wrong by
/// 0.1 px (what residuals hide) there is wrong by 0.1 / 0.7^4 = 0.4 px in the corner itself.
const REACH: f64 = 0.7;

/// The corners without circles.
#[must_use]
pub fn empty_corners(solution: &CalibrationSolution) -> Vec<Corner> {
    let used = || solution.frames.iter().flat_map(|f| &f.centres).filter(|c| c.used).map(|c| c.at);
    corners_without(used, solution.image_px)
}

/// The corners without any of these places.
pub(super) fn corners_without<I: Iterator<Item = Px>>(
    places: impl Fn() -> I,
    image_px: [usize; 2],
) -> Vec<Corner> {
    let [half_width, half_height] = image_px.map(|n| 0.5 * (n as f64 - 1.0));
    let seen = |to_right: f64, down: f64| {
        places().any(|at| {
            to_right * (at.u / half_width - 1.0) > REACH && down * (at.v / half_height - 1.0) > REACH
        })
    };
    [
        (Corner::TopLeft, -1.0, -1.0),
        (Corner::TopRight, 1.0, -1.0),
        (Corner::BottomLeft, -1.0, 1.0),
        (Corner::BottomRight, 1.0, 1.0),
    ]
    .into_iter()
    .filter(|(_, to_right, down)| !seen(*to_right, *down))
    .map(|(corner, ..)| corner)
    .collect()
}
