//! `truth.json` (what the scene was; only for testing) and `board.json` (the calibration board).

use super::field::{Field, parse};
use super::file;
use boxline::{Error, ErrorKind};
use std::collections::BTreeMap;
use std::path::Path;

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
    /// The corners were clicked on a photograph, to so many px (`notes.click_px`): they tell lines, not millimetres.
    pub clicked_px: Option<f64>,
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
    let value = parse(bytes, name, ErrorKind::InvalidFile)?;
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
        clicked_px: match face.optional("notes")? {
            Some(notes) => notes.optional("click_px")?.map(|f| f.positive()).transpose()?,
            None => None,
        },
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
    let value = parse(bytes, name, ErrorKind::InvalidFile)?;
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
    let board = Board {
        columns: circles("columns")?,
        rows: circles("rows")?,
        pitch_mm: root.get("pitch_mm")?.positive()?,
        diameter_mm: root.get("diameter_mm")?.positive()?,
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
