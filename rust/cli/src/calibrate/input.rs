//! What `boxline calibrate` is given: frames of a board, from a recording or from any folder of JPEGs, and the board.

use super::CalibrateArgs;
use crate::input::{Usage, own_name};
use boxline::{Error, ErrorKind};
use boxline_calib::Board;
use boxline_proto::json::{
    BOARD_CIRCLES_IN_ROW, BOARD_SIZES_MM, Laser, MOST_BOARD_CIRCLES, Role, read_board, read_recording,
};
use std::path::{Path, PathBuf};

/// A picture of the board.
pub struct BoardFrame {
    pub id: String,
    pub file: PathBuf,
}

/// Everything that is read.
pub struct Input {
    pub serial: String,
    pub frames: Vec<BoardFrame>,
    pub board: Board,
    /// Files beside the frames.
    pub files: Vec<PathBuf>,
}

/// The board as `--board` has it.
#[derive(Clone, Debug, PartialEq)]
pub enum BoardSpec {
    Grid(Board),
    File(PathBuf),
}

/// `COLUMNSxROWS:PITCH:DIAMETER` in mm, or a file.
///
/// # Errors
/// What is wrong with a text that begins like a grid.
pub fn parse_board_spec(text: &str) -> Result<BoardSpec, String> {
    let (grid, sizes) = text.split_once(':').unwrap_or((text, ""));
    // Numbers and an x, however they are written: no file is called so, and what is wrong with the grid helps more.
    let like_grid = |b: u8| b.is_ascii_digit() || b"xX.,+-* ".contains(&b);
    let is_grid = grid.bytes().all(like_grid) && grid.contains(['x', 'X', '*']);
    if !is_grid && !text.is_empty() {
        return Ok(BoardSpec::File(text.into()));
    }
    let circles = |text: &str| text.parse().ok().filter(|n| BOARD_CIRCLES_IN_ROW.contains(n));
    let size = |text: &str| text.parse().ok().filter(|mm| BOARD_SIZES_MM.contains(mm));
    let grid = grid.split_once('x').and_then(|(c, r)| Some((circles(c)?, circles(r)?)));
    let sizes = sizes.split_once(':').and_then(|(p, d)| Some((size(p)?, size(d)?)));
    match (grid, sizes) {
        (Some((columns, rows)), _) if columns * rows > MOST_BOARD_CIRCLES => {
            Err(format!("{text:?} has {} circles, at most {MOST_BOARD_CIRCLES} are allowed", columns * rows))
        }
        (Some((columns, rows)), Some((pitch_mm, diameter_mm))) if diameter_mm < pitch_mm => {
            Ok(BoardSpec::Grid(Board { columns, rows, pitch_mm, diameter_mm }))
        }
        _ => Err(format!(
            "{text:?} is no COLUMNSxROWS:PITCH:DIAMETER (7x7:37.5:18.75): 2 to 1000 circles, 1 to 1000 mm, circles apart from each other"
        )),
    }
}

impl Input {
    /// Reads recording and board, or lists the folder's pictures.
    pub fn read(folder: &Path, args: &CalibrateArgs) -> anyhow::Result<Self> {
        let recording_file = folder.join("recording.json");
        let mut files = Vec::new();
        let (serial, frames) = if recording_file.exists() {
            let recording = read_recording(folder)?;
            let boards = recording
                .frames
                .into_iter()
                .filter(|f| f.role == Role::Board && (f.laser == Laser::On || args.camera_only));
            files.push(recording_file);
            (recording.serial, boards.map(|f| BoardFrame { id: f.id, file: f.file }).collect())
        } else {
            let frames = pictures_in(folder)?;
            (own_name(folder), frames)
        };
        let board = read_board_of(args, folder, &mut files)?;
        let serial = args.serial.clone().unwrap_or(serial);
        if serial.is_empty() {
            let text = format!("{}: the folder has no name; --serial TEXT names the head", folder.display());
            return Err(Usage(text).into());
        }
        Ok(Self { serial, frames, board, files })
    }

    /// All files that are read.
    pub fn all_files(&self) -> impl Iterator<Item = &Path> {
        self.files.iter().map(PathBuf::as_path).chain(self.frames.iter().map(|f| f.file.as_path()))
    }
}

/// The board that `--board` names, or else the folder's; its file is added to those that are read.
pub fn read_board_of(args: &CalibrateArgs, folder: &Path, files: &mut Vec<PathBuf>) -> anyhow::Result<Board> {
    let file = match &args.board {
        Some(BoardSpec::Grid(board)) => return Ok(*board),
        Some(BoardSpec::File(file)) => file.clone(),
        None => folder.join("board.json"),
    };
    if args.board.is_none() && !file.exists() {
        let text = "no such file; --board 7x7:37.5:18.75 says what the board is";
        return Err(Error::new(ErrorKind::Io, text).in_context(file.display()).into());
    }
    files.push(file.clone());
    let written = read_board(&file)?;
    let (pitch_mm, diameter_mm) = (written.pitch_mm, written.diameter_mm);
    Ok(Board { columns: written.columns, rows: written.rows, pitch_mm, diameter_mm })
}

/// The JPEGs of a folder by name; at least one.
fn pictures_in(folder: &Path) -> anyhow::Result<Vec<BoardFrame>> {
    let frames = jpegs_of(folder)?;
    if frames.is_empty() {
        let text = "neither recording.json nor a .jpg is here";
        return Err(Error::new(ErrorKind::Io, text).in_context(folder.display()).into());
    }
    Ok(frames)
}

/// The JPEGs of a folder by name.
pub fn jpegs_of(folder: &Path) -> anyhow::Result<Vec<BoardFrame>> {
    use anyhow::Context;
    let mut frames = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let file = entry.with_context(|| folder.display().to_string())?.path();
        let jpeg =
            file.extension().is_some_and(|e| e.eq_ignore_ascii_case("jpg") || e.eq_ignore_ascii_case("jpeg"));
        if jpeg {
            frames.push(BoardFrame {
                id: file.file_name().unwrap_or_default().to_string_lossy().into_owned(),
                file,
            });
        }
    }
    frames.sort_by(|a, b| a.id.cmp(&b.id));
    Ok(frames)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_is_a_grid_or_a_file() {
        let grid = parse_board_spec("7x7:37.5:18.75").unwrap();
        assert_eq!(grid, BoardSpec::Grid(Board { columns: 7, rows: 7, pitch_mm: 37.5, diameter_mm: 18.75 }));
        for file in ["board.json", "C:/boards/b.json", "boards/7x7.json"] {
            assert_eq!(parse_board_spec(file), Ok(BoardSpec::File(file.into())));
        }
        // In metres, without a diameter, circles over each other, none, too many.
        for wrong in [
            "7x7:0.0375:0.01875",
            "7x7:37.5",
            "7x7:20:25",
            "7x0:37.5:18",
            "7x4000000000:37.5:18",
            "7x7",
            "7x7:nan:18",
            "",
            "7X7:37.5:18.75",
            "7.5x7:1:1",
            "-7x7:37.5:18.75",
        ] {
            assert!(parse_board_spec(wrong).unwrap_err().contains("COLUMNSxROWS"), "{wrong}");
        }
        let many = parse_board_spec("1000x1000:100:50").unwrap_err();
        assert!(many.contains("1000000 circles, at most 10000"), "{many}");
    }
}
