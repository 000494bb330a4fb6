//! `truth.json` (what the scene was; only for testing) and `board.json` (the calibration board).

use super::field::Field;
use super::file;
use super::syntax::parse_json;
use boxline::{Error, ErrorKind};
use std::collections::BTreeMap;
use std::path::Path;

/// Pitches and diameters of boards, mm: others are of another unit.
pub const BOARD_SIZES_MM: std::ops::RangeInclusive<f64> = 1.0..=1000.0;

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
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TruthFace {
    /// Id of the frame in the recording.
    pub frame: String,
    /// Length and width of the face, mm, the longer first; `None` if no face is in view.
    pub size_mm: Option<[f64; 2]>,
    /// Corners (u, v) going round the face: 0-1 and 3-2 are `length` edges. They may lie outside the image.
    pub corners_px: Option<[[f64; 2]; 4]>,
    /// The same corners in the camera frame, mm.
    pub corners_cam_mm: Option<[[f64; 3]; 4]>,
    /// Where stripe 1-4 crosses the two edges of the face, (u, v), in no promised order; absent if it does not.
    pub key_points_px: BTreeMap<u8, [[f64; 2]; 2]>,
    /// Why the frame must be refused, in words.
    pub refuse: Option<String>,
    /// The light: `office`, `sun`, ...
    pub ambient: Option<String>,
    /// What is known of the scene beside the geometry.
    pub notes: TruthNotes,
    /// Where the stripes end on the face and what lies beyond; empty if the file does not say.
    pub stripe_ends: Vec<TruthEnd>,
    /// Lines parallel to a side that can be taken for it.
    pub false_lines: Vec<TruthLine>,
    /// What an object before the face hides.
    pub hidden: Option<TruthHidden>,
    /// From the camera of the lit frame to that of its unlit twin; `None` if there is no twin, or the file does not say.
    pub cam_off_from_cam_on: Option<TruthMotion>,
    /// The corners were clicked on a photograph, to so many px (`notes.click_px`): they tell lines, not millimetres.
    pub clicked_px: Option<f64>,
}

/// Notes of one frame; a file need not have any.
#[derive(Clone, Debug, Default, PartialEq)]
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
    pub bulge_mm: Option<f64>,
    /// From the innermost to the outermost place of each side's edge, mm; side k joins corners k and k + 1.
    pub wave_mm: Option<[f64; 4]>,
}

/// What lies beyond a stripe's end, as the picture shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
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

const END_CLASSES: [(&str, EndClass); 8] = [
    ("convex", EndClass::Convex),
    ("farther", EndClass::Farther),
    ("nearer", EndClass::Nearer),
    ("flush", EndClass::Flush),
    ("concave", EndClass::Concave),
    ("dark", EndClass::Dark),
    ("border", EndClass::Border),
    ("occluded", EndClass::Occluded),
];

/// One end of a stripe on the face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthEnd {
    /// 1 to 4.
    pub stripe: u8,
    /// 0 or 1, in the order of the stripe's key points.
    pub end: usize,
    /// Side k joins corners k and k + 1.
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
#[derive(Clone, Debug, PartialEq)]
pub struct TruthLine {
    /// Side k joins corners k and k + 1.
    pub side: usize,
    /// Distance from the side along the face, mm; outwards is positive.
    pub offset_mm: f64,
    /// What it is: `neighbour`, `fan_end`, or a word for print, tape, straps, seams.
    pub kind: String,
}

/// What an object before the face hides of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TruthHidden {
    /// Sides, wholly or in part.
    pub sides: Vec<usize>,
    /// Corners.
    pub corners: Vec<usize>,
    /// Ends of stripes: stripe 1 to 4, end 0 or 1.
    pub stripe_ends: Vec<(u8, usize)>,
    /// How near the object comes to the face, mm.
    pub in_front_mm: Option<f64>,
}

/// A movement of the head: p_off = R p_on + t.
#[derive(Clone, Copy, Debug, PartialEq)]
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
    let value = parse_json(bytes, name, ErrorKind::InvalidFile)?;
    let root = Field::root(&value, name, ErrorKind::InvalidFile);
    // A calibration set's truth has board poses in place of faces.
    let faces = if root.optional("board_poses")?.is_some() {
        root.optional("faces")?
    } else {
        Some(root.get("faces")?)
    };
    let faces = faces.map_or(Ok(Vec::new()), |f| f.list())?;
    Ok(Truth {
        box_mm: root.optional("box_mm")?.map(|f| f.numbers()).transpose()?,
        must_refuse: root.optional("must_refuse")?.map_or(Ok(false), |f| f.boolean())?,
        faces: faces.iter().map(truth_face).collect::<Result<_, _>>()?,
    })
}

fn truth_face(face: &Field<'_>) -> Result<TruthFace, Error> {
    let text =
        |key: &str| Ok::<_, Error>(face.optional(key)?.map(|f| f.text()).transpose()?.map(str::to_owned));
    let mut key_points_px = BTreeMap::new();
    let stripes = face.optional("key_points_px")?.map_or(Ok(Vec::new()), |f| f.entries())?;
    for (key, points) in stripes {
        let number = key.strip_prefix("stripe ").and_then(|n| n.parse().ok()).filter(|n| (1..=4).contains(n));
        let number: u8 = number.ok_or_else(|| points.error("\"stripe 1\" to \"stripe 4\" are allowed"))?;
        if !points.list()?.is_empty() {
            key_points_px.insert(number, points.array(Field::numbers)?);
        }
    }
    Ok(TruthFace {
        frame: face.get("frame")?.text()?.to_owned(),
        size_mm: face.optional("size_mm")?.map(|f| f.numbers()).transpose()?,
        corners_px: face.optional("corners_px")?.map(|f| f.array(Field::numbers)).transpose()?,
        corners_cam_mm: face.optional("corners_cam_mm")?.map(|f| f.array(Field::numbers)).transpose()?,
        key_points_px,
        refuse: text("refuse")?,
        ambient: text("ambient")?,
        notes: face.optional("notes")?.map_or(Ok(TruthNotes::default()), |f| notes(&f))?,
        stripe_ends: list(face, "stripe_ends", stripe_end)?,
        false_lines: list(face, "false_lines", false_line)?,
        hidden: face.optional("hidden")?.map(|f| hidden(&f)).transpose()?,
        cam_off_from_cam_on: match face.optional("off")? {
            Some(off) => off.optional("cam_from_on")?.map(|f| motion(&f)).transpose()?,
            None => None,
        },
        clicked_px: match face.optional("notes")? {
            Some(notes) => notes.optional("click_px")?.map(|f| f.positive()).transpose()?,
            None => None,
        },
    })
}

/// A list that need not be there.
fn list<T>(
    field: &Field<'_>,
    key: &str,
    read: impl Fn(&Field<'_>) -> Result<T, Error>,
) -> Result<Vec<T>, Error> {
    field.optional(key)?.map_or(Ok(Vec::new()), |f| f.list())?.iter().map(read).collect()
}

fn notes(field: &Field<'_>) -> Result<TruthNotes, Error> {
    let number = |key: &str| field.optional(key)?.map(|f| f.number()).transpose();
    let words = |key: &str| {
        let text = |f: &Field<'_>| f.text().map(str::to_owned);
        field.optional(key)?.map(|f| f.list()?.iter().map(text).collect()).transpose()
    };
    let bulge_mm = match field.optional("bulge_mm")? {
        // Older files have an object: faces that bulge, by name.
        Some(bulge) if bulge.is_object() => match field.optional("face")? {
            Some(face) => Some(bulge.optional(face.text()?)?.map_or(Ok(0.0), |f| f.number())?),
            None => bulge.entries()?.is_empty().then_some(0.0),
        },
        Some(bulge) => Some(bulge.number()?),
        None => None,
    };
    Ok(TruthNotes {
        hazards: words("hazards")?,
        neighbours: words("neighbours")?,
        distance_mm: number("distance_mm")?,
        angle_to_normal_deg: number("angle_to_normal_deg")?,
        edge_radius_mm: number("edge_radius_mm")?,
        bulge_mm,
        wave_mm: field.optional("wave_mm")?.map(|f| f.numbers()).transpose()?,
    })
}

/// A whole number from `low` to `high`.
fn index(field: &Field<'_>, low: u32, high: u32) -> Result<u32, Error> {
    let found = field.count()?;
    let wrong = || field.error(format_args!("found {found}, {low} to {high} are allowed"));
    if (low..=high).contains(&found) { Ok(found) } else { Err(wrong()) }
}

fn stripe(field: &Field<'_>) -> Result<u8, Error> {
    index(field, 1, 4).map(|n| n as u8)
}

fn side(field: &Field<'_>) -> Result<usize, Error> {
    index(field, 0, 3).map(|n| n as usize)
}

fn end(field: &Field<'_>) -> Result<usize, Error> {
    index(field, 0, 1).map(|n| n as usize)
}

fn stripe_end(field: &Field<'_>) -> Result<TruthEnd, Error> {
    Ok(TruthEnd {
        stripe: stripe(&field.get("stripe")?)?,
        end: end(&field.get("end")?)?,
        side: side(&field.get("side")?)?,
        class: field.get("class")?.one_of(&END_CLASSES)?,
        at_px: field.optional("at_px")?.map(|f| f.numbers()).transpose()?,
        at_mm: field.get("at_mm")?.numbers()?,
        beyond_mm: field.optional("beyond_mm")?.map(|f| f.number()).transpose()?,
        light_beyond: field.get("light_beyond")?.boolean()?,
    })
}

fn false_line(field: &Field<'_>) -> Result<TruthLine, Error> {
    Ok(TruthLine {
        side: side(&field.get("side")?)?,
        offset_mm: field.get("offset_mm")?.number()?,
        kind: field.get("kind")?.text()?.to_owned(),
    })
}

fn hidden(field: &Field<'_>) -> Result<TruthHidden, Error> {
    let pair = |f: &Field<'_>| match f.list()?.as_slice() {
        [a, b] => Ok((stripe(a)?, end(b)?)),
        other => Err(f.error(format_args!("found a list of {}, stripe and end are needed", other.len()))),
    };
    Ok(TruthHidden {
        sides: list(field, "sides", side)?,
        corners: list(field, "corners", side)?,
        stripe_ends: list(field, "stripe_ends", pair)?,
        in_front_mm: field.optional("in_front_mm")?.map(|f| f.number()).transpose()?,
    })
}

fn motion(field: &Field<'_>) -> Result<TruthMotion, Error> {
    Ok(TruthMotion {
        rotation_mrad: field.get("rotation_mrad")?.numbers()?,
        translation_mm: field.get("translation_mm")?.numbers()?,
    })
}

/// The calibration board: black circles on white. Circle (i, j) has its centre at
/// ((i - (columns - 1) / 2) pitch, (j - (rows - 1) / 2) pitch, 0) in the board frame.
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
    /// Board along x, mm.
    pub width_mm: f64,
    /// Board along y, mm.
    pub height_mm: f64,
    /// Thickness, behind the printed side, mm.
    pub thickness_mm: f64,
}

impl From<Board> for boxline::calib::Board {
    fn from(board: Board) -> Self {
        let Board { columns, rows, pitch_mm, diameter_mm, .. } = board;
        Self { columns, rows, pitch_mm, diameter_mm }
    }
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
    let value = parse_json(bytes, name, ErrorKind::InvalidFile)?;
    let root = Field::root(&value, name, ErrorKind::InvalidFile);
    root.check_format("boxline-board/1")?;
    root.get("kind")?.one_of(&[("circles", ())])?;
    // A detector takes memory for every circle: an absurd number is refused here.
    let circles = |key: &str| {
        let field = root.get(key)?;
        let count = field.count()?;
        if (2..=1000).contains(&count) {
            Ok(count)
        } else {
            Err(field.error(format_args!("found {count}, 2 to 1000 are allowed")))
        }
    };
    let size = |key: &str| {
        let field = root.get(key)?;
        let mm = field.positive()?;
        if BOARD_SIZES_MM.contains(&mm) {
            return Ok(mm);
        }
        let (least, most) = (BOARD_SIZES_MM.start(), BOARD_SIZES_MM.end());
        Err(field.error(format_args!("found {mm}, {least} to {most} mm are allowed")))
    };
    let board = Board {
        columns: circles("columns")?,
        rows: circles("rows")?,
        pitch_mm: size("pitch_mm")?,
        diameter_mm: size("diameter_mm")?,
        width_mm: root.get("width_mm")?.positive()?,
        height_mm: root.get("height_mm")?.positive()?,
        thickness_mm: root.get("thickness_mm")?.positive()?,
    };
    if board.diameter_mm >= board.pitch_mm {
        let (d, pitch) = (board.diameter_mm, board.pitch_mm);
        return Err(root
            .get("diameter_mm")?
            .error(format_args!("found {d}, less than pitch_mm ({pitch}) is needed")));
    }
    Ok(board)
}
