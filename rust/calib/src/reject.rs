//! Why a frame was left out, and why a set of frames gives no calibration.

use super::detect::MIN_CIRCLES;
use boxline::units::LaserId;

/// Why a frame does not take part, with what was found and what is needed.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum FrameReject {
    /// No grid of dark circles.
    NoBoard {
        /// Elliptic dark blobs in the frame.
        blobs: usize,
        /// The most of them that make a grid.
        in_grid: usize,
    },
    /// A grid, but most of its circles are hidden, cut or not round.
    TooFewCircles {
        /// Circles with a clean rim.
        found: usize,
        /// Fewest that can be used.
        needed: usize,
    },
    /// Out of focus or moved.
    Blurred {
        /// Width of the circles' rims, 10 to 90 %, px.
        rim_width_px: f64,
    },
    /// Another image size than most frames have.
    OtherSize {
        /// Width and height, px.
        found: [usize; 2],
        /// Width and height of the others, px.
        needed: [usize; 2],
    },
    /// Its circles do not fit the camera that fits all others.
    Outlier {
        /// Root mean square of its residuals, px an axis.
        rms_px: f64,
        /// The most that the scatter of the others allows, px.
        limit_px: f64,
    },
    /// It shows the board where an earlier frame does, to less than two shots of a board that stands still differ by: it is a copy, and
    /// counts once.
    Copy {
        /// Number of the earlier view.
        of: usize,
        /// Root mean square of the circles' distances, px.
        rms_px: f64,
    },
    /// The file cannot be read as a picture.
    Unreadable {
        /// Why.
        text: String,
    },
}

impl std::fmt::Display for FrameReject {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NoBoard { blobs, in_grid } => write!(
                f,
                "no board: {blobs} round dark spots, at most {in_grid} of them in a grid ({MIN_CIRCLES} are needed)"
            ),
            Self::TooFewCircles { found, needed } => {
                write!(f, "{found} whole circles in at least 3 columns and rows, {needed} are needed")
            }
            Self::Blurred { rim_width_px } => {
                write!(f, "blurred: the circles' rims are {rim_width_px:.1} px wide")
            }
            Self::OtherSize { found: [w, h], needed: [nw, nh] } => {
                write!(f, "{w} x {h} px, the others have {nw} x {nh} px")
            }
            Self::Outlier { rms_px, limit_px } => write!(
                f,
                "its circles are off by {rms_px:.2} px rms, {limit_px:.2} px are allowed beside the other frames"
            ),
            Self::Copy { rms_px, .. } => {
                write!(f, "a copy of an earlier frame: its circles are {rms_px:.4} px from that one's")
            }
            Self::Unreadable { text } => f.write_str(text),
        }
    }
}

/// Why a set of frames gives no calibration.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum CalibrationReject {
    /// Too few frames show the board.
    TooFewFrames {
        /// Frames that can be used.
        usable: usize,
        /// Fewest that are needed.
        needed: usize,
    },
    /// More circles in a row than the board file has.
    MoreCirclesThanBoard {
        /// Columns and rows seen.
        seen: (u32, u32),
        /// Columns and rows of the board file.
        board: (u32, u32),
    },
    /// The circles are too large or too small for their distance.
    OtherRatio {
        /// Diameter over pitch as seen.
        seen: f64,
        /// ... of the board file.
        board: f64,
    },
    /// The frames do not fix the camera: all boards are nearly parallel to the sensor.
    NoTilt {
        /// Largest tilt, degrees.
        largest_deg: f64,
        /// Needed in at least two frames, degrees.
        needed_deg: f64,
    },
    /// All frames are taken from nearly the same distance.
    OneDistance {
        /// Nearest and farthest place of a stripe, mm.
        range_mm: (f64, f64),
        /// Farthest over nearest that is needed.
        needed_ratio: f64,
    },
    /// A laser is seen in too few frames.
    LaserSeenTooRarely {
        /// Which.
        laser: LaserId,
        /// In how many frames.
        frames: usize,
        /// Fewest that are needed.
        needed: usize,
    },
    /// Two lasers are seen together in too few frames, and which of them is missing cannot be told.
    PairSeenTooRarely {
        /// Which two.
        pair: [LaserId; 2],
        /// In how many frames both are seen.
        frames: usize,
        /// Fewest that are needed.
        needed: usize,
    },
    /// The adjustment found no camera that explains the frames.
    NoSolution {
        /// Root mean square of the circles' residuals, px an axis; not finite if there is no solution at all.
        rms_px: f64,
        /// The most that is allowed.
        limit_px: f64,
    },
}

impl CalibrationReject {
    /// Stable name for programs.
    #[must_use]
    pub const fn reason(&self) -> &'static str {
        match self {
            Self::TooFewFrames { .. } => "too_few_frames",
            Self::MoreCirclesThanBoard { .. } => "more_circles_than_board",
            Self::OtherRatio { .. } => "other_ratio",
            Self::NoTilt { .. } => "no_tilt",
            Self::OneDistance { .. } => "one_distance",
            Self::LaserSeenTooRarely { .. } => "laser_seen_too_rarely",
            Self::PairSeenTooRarely { .. } => "pair_seen_too_rarely",
            Self::NoSolution { .. } => "no_solution",
        }
    }
}

impl std::fmt::Display for CalibrationReject {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::TooFewFrames { usable, needed } => {
                let frames = if *usable == 1 { "frame shows" } else { "frames show" };
                write!(f, "{usable} {frames} the board, {needed} are needed")
            }
            Self::MoreCirclesThanBoard { seen, board } => write!(
                f,
                "a frame shows {} x {} circles, the board file has {} x {}",
                seen.0, seen.1, board.0, board.1
            ),
            Self::OtherRatio { seen, board } => write!(
                f,
                "the circles' diameter is {seen:.3} of their pitch, {board:.3} in the board file: pitch_mm or diameter_mm is wrong"
            ),
            Self::NoTilt { largest_deg, needed_deg } => write!(
                f,
                "no tilted frame: the largest tilt is {largest_deg:.0} degrees, two frames with at least {needed_deg:.0} are needed"
            ),
            Self::OneDistance { range_mm: (near, far), needed_ratio } => write!(
                f,
                "all boards at one distance: stripes are seen from {near:.0} to {far:.0} mm, the farthest must be at least {needed_ratio:.1} times the nearest"
            ),
            Self::LaserSeenTooRarely { laser, frames, needed } => {
                write!(f, "laser {laser} is seen in {frames} frames only, {needed} are needed")
            }
            Self::PairSeenTooRarely { pair: [first, second], frames, needed } => write!(
                f,
                "lasers {first} and {second} are seen together in {frames} frames only, {needed} are needed"
            ),
            Self::NoSolution { rms_px, limit_px } => write!(
                f,
                "no camera explains the frames: residuals of {rms_px:.2} px rms, at most {limit_px:.1} px are allowed; is the board flat and the focus fixed?"
            ),
        }
    }
}
