//! `truth.json` (what the scene was; only for testing) and `board.json` (the calibration board).

use super::file;
use super::syntax::{Within, field_error, missing, positive, read, text, within};
use boxline::{Error, ErrorKind};
use serde::Deserialize;
use serde::de::{Deserializer, Error as _, IgnoredAny};
use std::collections::BTreeMap;
use std::path::Path;

/// Pitches and diameters of boards, mm: others are of another unit.
pub const BOARD_SIZES_MM: std::ops::RangeInclusive<f64> = 1.0..=1000.0;

/// Circles of a row or column of a board.
pub const BOARD_CIRCLES_IN_ROW: std::ops::RangeInclusive<u32> = 2..=1000;

/// The most circles of a board: 10 000 of them fill a head's picture of 2592 x 1944 px at a pitch of 22 px, and the rims of smaller ones
/// cannot be measured. A million keep a program busy for minutes.
pub const MOST_BOARD_CIRCLES: u32 = 10_000;

/// What a recording's scene was.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Truth {
    /// Sides of the sharp box, sorted descending, mm; `None` for single faces.
    pub box_mm: Option<[f64; 3]>,
    /// No frame of this folder can be measured.
    pub must_refuse: bool,
    /// One entry a frame with the lasers on; empty in a calibration set.
    pub faces: Vec<TruthFace>,
}

/// What one frame shows.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct TruthFace {
    /// Id of the frame in the recording.
    #[serde(deserialize_with = "text")]
    pub frame: String,
    /// Length and width of the face, mm, the longer first; `None` if no face is in view.
    pub size_mm: Option<[f64; 2]>,
    /// Corners (u, v) going round the face: 0-1 and 3-2 are `length` edges. They may lie outside the image.
    pub corners_px: Option<[[f64; 2]; 4]>,
    /// The same corners in the camera frame, mm.
    pub corners_cam_mm: Option<[[f64; 3]; 4]>,
    /// Where stripe 1-4 crosses the two edges of the face, (u, v), in no promised order; absent if it does not.
    #[serde(default, deserialize_with = "key_points")]
    pub key_points_px: BTreeMap<u8, [[f64; 2]; 2]>,
    /// Why the frame must be refused, in words.
    pub refuse: Option<String>,
    /// The light: `office`, `sun`, ...
    pub ambient: Option<String>,
    /// What is known of the scene beside the geometry.
    #[serde(default)]
    pub notes: TruthNotes,
    /// Where the stripes end on the face and what lies beyond; empty if the file does not say.
    #[serde(default)]
    pub stripe_ends: Vec<TruthEnd>,
    /// Lines parallel to a side that can be taken for it.
    #[serde(default)]
    pub false_lines: Vec<TruthLine>,
    /// What an object before the face hides.
    pub hidden: Option<TruthHidden>,
    /// From the camera of the lit frame to that of its unlit twin; `None` if there is no twin, or the file does not say.
    #[serde(default, rename = "off", deserialize_with = "twin")]
    pub cam_off_from_cam_on: Option<TruthMotion>,
}

/// Notes of one frame; a file need not have any.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct TruthNotes {
    /// Hazards that were drawn, by name; `None` in files that know of none.
    pub hazards: Option<Vec<String>>,
    /// Where boxes touch the box: `left`, `on_top`, ...; `None` if the file does not say.
    pub neighbours: Option<Vec<String>>,
    /// From the camera to the face's middle, mm.
    pub distance_mm: Option<f64>,
    /// Between the line of sight to the face's middle and its normal, degrees.
    pub angle_to_normal_deg: Option<f64>,
    /// Rounding of the edges, mm.
    pub edge_radius_mm: Option<f64>,
    /// Outward bulge in the middle of the face that is looked at, mm.
    #[serde(deserialize_with = "bulge")]
    pub bulge_mm: Option<f64>,
    /// From the innermost to the outermost place of each side's edge, mm; side k joins corners k and k + 1.
    pub wave_mm: Option<[f64; 4]>,
    /// The corners were clicked on a photograph, to so many px: they tell lines, not millimetres.
    pub click_px: Option<f64>,
}

/// What lies beyond a stripe's end, as the picture shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EndClass {
    /// The stripe bends away from the head: the next face of the box.
    Convex,
    /// It jumps to something farther, or nothing lit is seen beyond.
    Farther,
    /// It jumps to something nearer.
    Nearer,
    /// It goes on in the face's plane.
    Flush,
    /// It bends towards the head.
    Concave,
    /// It cannot be told from its surroundings.
    Dark,
    /// It is at the picture's border, or outside.
    Border,
    /// Something hides it.
    Occluded,
}

/// One end of a stripe on the face.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct TruthEnd {
    /// 1 to 4.
    #[serde(deserialize_with = "within::<_, _, 1, 4>")]
    pub stripe: u8,
    /// 0 or 1, in the order of the stripe's key points.
    #[serde(deserialize_with = "within::<_, _, 0, 1>")]
    pub end: usize,
    /// Side k joins corners k and k + 1.
    #[serde(deserialize_with = "within::<_, _, 0, 3>")]
    pub side: usize,
    /// What lies beyond.
    pub class: EndClass,
    /// On the sharp edge, (u, v).
    pub at_px: Option<[f64; 2]>,
    /// The same in the camera frame, mm.
    pub at_mm: [f64; 3],
    /// How high above the face's plane, towards the head, the next lit surface begins that is seen, mm; `None` if there is none.
    pub beyond_mm: Option<f64>,
    /// The stripe is seen 6 to 18 px beyond the end, and nowhere there more than 2 px off its line in the face's plane.
    pub light_beyond: bool,
}

/// A straight line near a side and parallel to it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct TruthLine {
    /// Side k joins corners k and k + 1.
    #[serde(deserialize_with = "within::<_, _, 0, 3>")]
    pub side: usize,
    /// Distance from the side along the face, mm; outwards is positive.
    pub offset_mm: f64,
    /// What it is: `neighbour`, `fan_end`, or a word for print, tape, straps, seams.
    #[serde(deserialize_with = "text")]
    pub kind: String,
}

/// What an object before the face hides of it.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct TruthHidden {
    /// Sides, wholly or in part.
    #[serde(deserialize_with = "sides")]
    pub sides: Vec<usize>,
    /// Corners.
    #[serde(deserialize_with = "sides")]
    pub corners: Vec<usize>,
    /// Ends of stripes: stripe 1 to 4, end 0 or 1.
    #[serde(deserialize_with = "ends")]
    pub stripe_ends: Vec<(u8, usize)>,
    /// How near the object comes to the face, mm.
    pub in_front_mm: Option<f64>,
}

/// A movement of the head: p_off = R p_on + t.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct TruthMotion {
    /// Rotation vector, mrad.
    pub rotation_mrad: [f64; 3],
    /// Translation, mm.
    pub translation_mm: [f64; 3],
}

/// Reads `truth.json` of a folder; `None` if there is none.
///
/// # Errors
/// [`ErrorKind::Io`] if it cannot be read, else [`ErrorKind::InvalidFile`], naming file and field.
pub fn read_truth(folder: &Path) -> Result<Option<Truth>, Error> {
    let path = folder.join("truth.json");
    let Some(bytes) = file::read_if_there(&path)? else { return Ok(None) };
    parse_truth(&bytes, &path.display().to_string()).map(Some)
}

/// Reads a truth from bytes; `name` goes into the errors.
///
/// # Errors
/// [`ErrorKind::InvalidFile`], naming `name` and the field.
pub fn parse_truth(bytes: &[u8], name: &str) -> Result<Truth, Error> {
    #[derive(Deserialize)]
    struct File {
        box_mm: Option<[f64; 3]>,
        must_refuse: Option<bool>,
        faces: Option<Vec<TruthFace>>,
        board_poses: Option<IgnoredAny>,
    }
    let file: File = read(bytes, name, ErrorKind::InvalidFile, None)?;
    // A calibration set's truth has board poses in place of faces.
    if file.faces.is_none() && file.board_poses.is_none() {
        return Err(missing(ErrorKind::InvalidFile, name, "faces"));
    }
    Ok(Truth {
        box_mm: file.box_mm,
        must_refuse: file.must_refuse.unwrap_or_default(),
        faces: file.faces.unwrap_or_default(),
    })
}

fn sides<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<usize>, D::Error> {
    let found = Option::<Vec<Within<usize, 0, 3>>>::deserialize(deserializer)?;
    Ok(found.unwrap_or_default().into_iter().map(|Within(k)| k).collect())
}

fn ends<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<(u8, usize)>, D::Error> {
    let found = Option::<Vec<(Within<u8, 1, 4>, Within<usize, 0, 1>)>>::deserialize(deserializer)?;
    Ok(found.unwrap_or_default().into_iter().map(|(Within(stripe), Within(end))| (stripe, end)).collect())
}

/// Of `"stripe 1"` to `"stripe 4"`, two points each, or none.
fn key_points<'de, D: Deserializer<'de>>(deserializer: D) -> Result<BTreeMap<u8, [[f64; 2]; 2]>, D::Error> {
    #[derive(PartialEq, Eq, PartialOrd, Ord, Deserialize)]
    enum Stripe {
        #[serde(rename = "stripe 1")]
        One = 1,
        #[serde(rename = "stripe 2")]
        Two,
        #[serde(rename = "stripe 3")]
        Three,
        #[serde(rename = "stripe 4")]
        Four,
    }
    let found = Option::<BTreeMap<Stripe, Vec<[f64; 2]>>>::deserialize(deserializer)?.unwrap_or_default();
    let crossed = found.into_iter().filter(|(_, points)| !points.is_empty());
    let two = |(stripe, points): (Stripe, Vec<_>)| {
        let stripe = stripe as u8;
        let wrong =
            |points: Vec<_>| format!("{} points of stripe {stripe}, two or none are needed", points.len());
        Ok((stripe, points.try_into().map_err(wrong).map_err(D::Error::custom)?))
    };
    crossed.map(two).collect()
}

fn twin<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<TruthMotion>, D::Error> {
    #[derive(Deserialize)]
    struct Twin {
        cam_from_on: Option<TruthMotion>,
    }
    Ok(Option::<Twin>::deserialize(deserializer)?.and_then(|off| off.cam_from_on))
}

/// Older files have an object of the faces that bulge, with none in it.
fn bulge<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "a number is needed")]
    enum Bulge {
        Mm(f64),
        NoFace(NoFace),
    }
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct NoFace {}
    Ok(Option::<Bulge>::deserialize(deserializer)?.map(|bulge| match bulge {
        Bulge::Mm(mm) => mm,
        Bulge::NoFace(NoFace {}) => 0.0,
    }))
}

/// The calibration board: black circles on white. Circle (i, j) has its centre at
/// ((i - (columns - 1) / 2) pitch, (j - (rows - 1) / 2) pitch, 0) in the board frame.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct Board {
    /// What is printed on it.
    pub kind: BoardKind,
    /// Circles along x. A detector takes memory for every circle: an absurd number is refused.
    #[serde(deserialize_with = "within::<_, _, 2, 1000>")]
    pub columns: u32,
    /// Circles along y.
    #[serde(deserialize_with = "within::<_, _, 2, 1000>")]
    pub rows: u32,
    /// Distance of neighbouring centres, mm.
    #[serde(deserialize_with = "size_mm")]
    pub pitch_mm: f64,
    /// Diameter of a circle, mm.
    #[serde(deserialize_with = "size_mm")]
    pub diameter_mm: f64,
    /// Board along x, mm.
    #[serde(deserialize_with = "positive")]
    pub width_mm: f64,
    /// Board along y, mm.
    #[serde(deserialize_with = "positive")]
    pub height_mm: f64,
    /// Thickness, behind the printed side, mm.
    #[serde(deserialize_with = "positive")]
    pub thickness_mm: f64,
}

/// What is printed on a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BoardKind {
    /// Circles in a square grid.
    Circles,
}

/// Reads a `board.json`.
///
/// # Errors
/// [`ErrorKind::Io`] if it cannot be read, else [`ErrorKind::InvalidFile`], naming file and field.
pub fn read_board(path: &Path) -> Result<Board, Error> {
    parse_board(&file::read(path)?, &path.display().to_string())
}

/// Reads a board from bytes; `name` goes into the errors.
///
/// # Errors
/// [`ErrorKind::InvalidFile`], naming `name` and the field.
pub fn parse_board(bytes: &[u8], name: &str) -> Result<Board, Error> {
    let kind = ErrorKind::InvalidFile;
    let board: Board = read(bytes, name, kind, Some("boxline-board/1"))?;
    let circles = board.columns * board.rows;
    if circles > MOST_BOARD_CIRCLES {
        let what = format_args!("{circles} circles with columns, at most {MOST_BOARD_CIRCLES} are allowed");
        return Err(field_error(kind, name, "rows", what));
    }
    if board.diameter_mm >= board.pitch_mm {
        let Board { diameter_mm, pitch_mm, .. } = board;
        let what = format_args!("found {diameter_mm}, less than pitch_mm ({pitch_mm}) is needed");
        return Err(field_error(kind, name, "diameter_mm", what));
    }
    Ok(board)
}

fn size_mm<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let mm = positive(deserializer)?;
    if BOARD_SIZES_MM.contains(&mm) {
        return Ok(mm);
    }
    let (least, most) = (BOARD_SIZES_MM.start(), BOARD_SIZES_MM.end());
    Err(D::Error::custom(format_args!("found {mm}, {least} to {most} mm are allowed")))
}
