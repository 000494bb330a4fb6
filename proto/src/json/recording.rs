//! `recording.json`, format `boxline-recording/1`: which frames a folder holds and which calibration belongs to them.

use super::file;
use super::syntax::{Object, field_error, read, text};
use boxline::{Error, ErrorKind};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::HashSet;
use std::path::{Component, Path, PathBuf};

const FORMAT: &str = "boxline-recording/1";

/// What a frame shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// One face of a box.
    Face,
    /// The calibration board.
    Board,
}

/// Whether the lasers were on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Laser {
    /// All four on.
    On,
    /// All four off.
    Off,
}

/// A frame of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordedFrame {
    /// Its name in the recording, unique there: `a`, `b`, `a_off`, ...
    pub id: String,
    /// The JPEG, resolved: the recording's folder joined with the path in the file.
    pub file: PathBuf,
    /// What it shows.
    pub role: Role,
    /// Whether the lasers were on.
    pub laser: Laser,
}

/// A folder of frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recording {
    /// The folder, as it was given.
    pub folder: PathBuf,
    /// Serial number of the head.
    pub serial: String,
    /// The head's calibration, resolved like the frames' files.
    pub calibration_file: PathBuf,
    /// The frames in the file's order.
    pub frames: Vec<RecordedFrame>,
}

impl Recording {
    /// The same view as a lit frame with the lasers off: `a_off` of `a`.
    #[must_use]
    pub fn twin_of(&self, lit: &RecordedFrame) -> Option<&RecordedFrame> {
        let id = format!("{}_off", lit.id);
        self.frames.iter().find(|f| f.laser == Laser::Off && f.role == lit.role && f.id == id)
    }

    /// A path as the file holds it; `field` goes into the error.
    pub(crate) fn relative(&self, path: &Path, field: &str) -> Result<String, Error> {
        let text = path.strip_prefix(&self.folder).ok().and_then(Path::to_str).map(str::to_owned);
        text.ok_or_else(|| {
            let (path, folder) = (path.display(), self.folder.display());
            Error::new(
                ErrorKind::InvalidFile,
                format!("{field}: {path} has no UTF-8 name relative to {folder}"),
            )
        })
    }
}

/// Reads `recording.json` of a folder. The files that it names are not opened.
///
/// # Errors
/// [`ErrorKind::Io`] if it cannot be read, else [`ErrorKind::InvalidFile`], naming file and field.
pub fn read_recording(folder: &Path) -> Result<Recording, Error> {
    let path = folder.join("recording.json");
    parse_recording(&file::read(&path)?, &path.display().to_string(), folder)
}

#[derive(Deserialize)]
struct File {
    device: Object<Device>,
    calibration: String,
    frames: Vec<Object<Frame>>,
}

#[derive(Deserialize)]
struct Device {
    #[serde(deserialize_with = "text")]
    serial: String,
}

#[derive(Deserialize)]
struct Frame {
    #[serde(deserialize_with = "text")]
    id: String,
    file: String,
    role: Role,
    laser: Laser,
}

/// Reads a recording from bytes; `name` goes into the errors, `folder` in front of the paths.
///
/// # Errors
/// [`ErrorKind::InvalidFile`], naming `name` and the field.
pub fn parse_recording(bytes: &[u8], name: &str, folder: &Path) -> Result<Recording, Error> {
    let kind = ErrorKind::InvalidFile;
    let File { device: Object(Device { serial }), calibration, frames: listed } =
        read(bytes, name, kind, Some(FORMAT))?;
    let resolved = |path: &str, field: &str| {
        resolved_path(path, folder).map_err(|why| field_error(kind, name, field, why))
    };
    let calibration_file = resolved(&calibration, "calibration")?;
    let mut frames: Vec<RecordedFrame> = Vec::new();
    let mut ids = HashSet::new();
    for (i, Object(Frame { id, file, role, laser })) in listed.into_iter().enumerate() {
        if !ids.insert(id.clone()) {
            return Err(field_error(kind, name, &format!("frames[{i}].id"), "another frame has the same id"));
        }
        let file = resolved(&file, &format!("frames[{i}].file"))?;
        frames.push(RecordedFrame { id, file, role, laser });
    }
    Ok(Recording { folder: folder.to_owned(), serial, calibration_file, frames })
}

/// A path in a recording is relative to its folder and may leave it (`../calibration_set/calibration.json`). The error
/// says why it is not one.
pub(crate) fn resolved_path(text: &str, folder: &Path) -> Result<PathBuf, String> {
    if text.is_empty() {
        return Err("an empty path".to_owned());
    }
    if Path::new(text).has_root() || matches!(Path::new(text).components().next(), Some(Component::Prefix(_)))
    {
        return Err(format!("{text:?} is absolute, a path relative to the recording is needed"));
    }
    if text.contains('\0') {
        return Err("a path with a NUL character".to_owned());
    }
    Ok(folder.join(text))
}

/// A recording as JSON, with paths relative to its folder.
///
/// # Errors
/// [`ErrorKind::InvalidFile`], naming the field, if a path does not start with the recording's folder or is not UTF-8.
pub fn recording_json(recording: &Recording) -> Result<Value, Error> {
    let mut frames = Vec::new();
    for frame in &recording.frames {
        frames.push(json!({
            "id": frame.id,
            "file": recording.relative(&frame.file, &format!("frame {:?}", frame.id))?,
            "role": frame.role,
            "laser": frame.laser,
        }));
    }
    Ok(json!({
        "format": FORMAT,
        "device": {"serial": recording.serial},
        "calibration": recording.relative(&recording.calibration_file, "calibration")?,
        "frames": frames,
    }))
}
