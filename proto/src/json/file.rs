//! Files: read with a limit, written whole or not at all.

use boxline::{Error, ErrorKind};
use serde_json::Value;
use std::fs::{self, File, OpenOptions};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

/// Larger JSON files are refused before memory is taken for them; real ones have less than 1 MB.
const MAX_BYTES: u64 = 64 * 1024 * 1024;

/// Opens a file for reading. What is neither file nor folder (a pipe, a device) is refused: opening or reading it may never end.
///
/// # Errors
/// As [`File::open`], and [`std::io::ErrorKind::InvalidInput`] for what is no plain file.
pub fn open_plain_file(path: &Path) -> std::io::Result<File> {
    let kind = fs::metadata(path)?.file_type();
    if !kind.is_file() && !kind.is_dir() {
        return Err(std::io::Error::new(std::io::ErrorKind::InvalidInput, "it is not a plain file"));
    }
    File::open(path)
}

/// The bytes of a file, or `None` if there is none.
pub(super) fn read_if_there(path: &Path) -> Result<Option<Vec<u8>>, Error> {
    let io = |e: std::io::Error| io_error("cannot read", path, e);
    let file = match open_plain_file(path) {
        Ok(file) => file,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(io(e)),
    };
    let mut bytes = Vec::new();
    file.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(io)?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(Error::new(
            ErrorKind::InvalidFile,
            format!("{}: larger than {MAX_BYTES} bytes, the most that is allowed", path.display()),
        ));
    }
    Ok(Some(bytes))
}

/// The bytes of a file that must be there.
pub(super) fn read(path: &Path) -> Result<Vec<u8>, Error> {
    read_if_there(path)?.ok_or_else(|| Error::new(ErrorKind::Io, format!("{}: no such file", path.display())))
}

/// Writes a JSON file, indented and ending in a newline, by way of a temporary file beside it: readers see the old file
/// or the whole new one.
///
/// # Errors
/// [`ErrorKind::Io`]; the old file is then unchanged and the temporary one removed.
pub fn write_json(path: &Path, value: &Value) -> Result<(), Error> {
    let mut text = format!("{value:#}");
    text.push('\n');
    let temporary = temporary_beside(path);
    let written = OpenOptions::new().write(true).create_new(true).open(&temporary).and_then(|mut file| {
        let done = file.write_all(text.as_bytes()).and_then(|()| file.sync_all());
        done.and_then(|()| fs::rename(&temporary, path)).inspect_err(|_| {
            // The first error is the one to tell; a file that stays behind is named after its target.
            fs::remove_file(&temporary).unwrap_or_default();
        })
    });
    written.map_err(|e| io_error("cannot write", path, e))
}

/// A name in the same folder that no other writer uses, neither in this process nor in another.
fn temporary_beside(path: &Path) -> PathBuf {
    use std::sync::atomic::{AtomicU32, Ordering};
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let name = path.file_name().map_or("boxline".into(), |n| n.to_string_lossy());
    path.with_file_name(format!(
        ".{name}.{}-{}.tmp",
        std::process::id(),
        NEXT.fetch_add(1, Ordering::Relaxed)
    ))
}

fn io_error(what: &str, path: &Path, e: std::io::Error) -> Error {
    Error::new(ErrorKind::Io, format!("{}: {what}: {e}", path.display())).with_source(e)
}
