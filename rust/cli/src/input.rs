//! From paths to decoded frames and a calibration. Every complaint names the file.

use crate::say::say;
use anyhow::Context;
use boxline::{Error, ErrorKind, Frame};
use boxline_proto::json::{Laser, RecordedFrame, Recording, Role, open_plain_file};
use sha2::{Digest, Sha256};
use std::io::Read;
use std::path::Path;

/// Larger files are refused before memory is taken for them; a frame has about 2 MB.
const MAX_BYTES: u64 = 64 * 1024 * 1024;

/// A command line that parses but makes no sense.
#[derive(Debug)]
pub struct Usage(pub String);

impl std::fmt::Display for Usage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Usage {}

/// A folder's own name, whatever it is called by: `.` has one too, the file system's root none.
pub fn own_name(folder: &Path) -> String {
    let whole = folder.canonicalize().unwrap_or_else(|_no_such_folder| folder.into());
    whole.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The SHA-256 of a file, in hexadecimal digits.
pub fn sha256(path: &Path) -> std::io::Result<String> {
    let mut hasher = Sha256::new();
    std::io::copy(&mut open_plain_file(path)?, &mut hasher)?;
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

/// What tells one file from another in a result: the first digits of its hash.
pub fn fingerprint(path: &Path) -> anyhow::Result<String> {
    let mut digits = sha256(path).with_context(|| format!("{}: cannot read", path.display()))?;
    digits.truncate(16);
    Ok(digits)
}

/// This program: its version, and the fingerprint of its file. Results of two builds are never mixed in one file.
pub fn this_program() -> anyhow::Result<String> {
    let file = std::env::current_exe().context("the program's own file cannot be found")?;
    Ok(format!("{}, {}", env!("CARGO_PKG_VERSION"), fingerprint(&file)?))
}

/// Reads and decodes a JPEG frame.
pub fn read_frame(path: &Path) -> Result<Frame, Error> {
    let name = path.display();
    let failed =
        |e: std::io::Error| Error::new(ErrorKind::Io, format!("{name}: cannot read: {e}")).with_source(e);
    let mut bytes = Vec::new();
    open_plain_file(path).map_err(failed)?.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(Error::new(
            ErrorKind::InvalidFrame,
            format!("{name}: larger than {MAX_BYTES} bytes, the most that is allowed"),
        ));
    }
    Frame::from_jpeg(&bytes).map_err(|e| e.in_context(name))
}

/// Reads a frame of a recording, together with the same view with the lasers off if the recording has it (`a_off` of `a`) and it is wanted.
/// One that cannot be read or laid over the frame is named and left out: nothing is lost without it.
pub fn read_recorded(recording: &Recording, frame: &RecordedFrame, with_off: bool) -> Result<Frame, Error> {
    let mut lit = read_frame(&frame.file)?;
    if let Some(off) = recording.twin_of(frame).filter(|_| with_off) {
        add_off(&mut lit, &off.file, read_frame(&off.file));
    }
    Ok(lit)
}

/// Adds the same view with the lasers off to a frame; one that could not be read, or cannot be laid over it, is named and left out.
pub fn add_off(lit: &mut Frame, path: &Path, off: Result<Frame, Error>) {
    let added = off.and_then(|off| lit.add_ambient(&off).map_err(|e| e.in_context(path.display())));
    if let Err(e) = added {
        say(&format!("warning: {e}; it is not used"));
    }
}

/// The frames of a recording that make a measurement: `a`, `b` and, if there is one, `c`; or else the only two faces with the
/// lasers on.
pub fn box_frames(recording: &Recording) -> Result<Vec<&RecordedFrame>, Error> {
    let faces = lit_faces(recording);
    let named = |id: &str| faces.iter().copied().find(|frame| frame.id == id);
    if let (Some(a), Some(b)) = (named("a"), named("b")) {
        return Ok([Some(a), Some(b), named("c")].into_iter().flatten().collect());
    }
    if faces.len() == 2 {
        return Ok(faces);
    }
    let found: Vec<_> = faces.iter().map(|frame| frame.id.as_str()).collect();
    Err(Error::new(
        ErrorKind::InvalidFile,
        format!(
            "{}: two face frames with the lasers on are needed, `a` and `b` (and `c`) or no others; found {}{}{}",
            recording.folder.join("recording.json").display(),
            found.len(),
            if found.is_empty() { "" } else { ": " },
            found.join(", "),
        ),
    ))
}

/// All frames of box faces with the lasers on.
pub fn lit_faces(recording: &Recording) -> Vec<&RecordedFrame> {
    recording.frames.iter().filter(|frame| frame.role == Role::Face && frame.laser == Laser::On).collect()
}
