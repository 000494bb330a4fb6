//! Where a calibration comes from: program, date, settings and the SHA-256 of every input, so that anyone can tell later
//! which pictures made it. For people: nothing reads it back.

use super::Solved;
use anyhow::Context;
use boxline::calib::Board;
use boxline_proto::json::RecordedFrame;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::path::Path;

/// The calibration's `provenance`.
pub fn value(
    folder: &Path,
    board_file: &Path,
    board: &Board,
    frames: &[&RecordedFrame],
    solved: &Solved,
) -> anyhow::Result<Value> {
    let recording = folder.join("recording.json");
    let mut inputs = Vec::with_capacity(frames.len() + 2);
    for path in [recording.as_path(), board_file].into_iter().chain(frames.iter().map(|f| f.file.as_path())) {
        // Names without folders: a calibration is passed on, and folders are nobody's business.
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        // A frame that could not be read is left out by name already; it has no hash.
        let hash = sha256(path).ok();
        inputs.push(json!({"file": name, "sha256": hash}));
    }
    let used: Vec<&str> =
        solved.solution.frames.iter().map(|f| solved.names[solved.views[f.view]].as_str()).collect();
    // Whole seconds: `2026-01-01T00:00:00Z`.
    let now = jiff::Timestamp::now().round(jiff::Unit::Second).context("the clock's date is out of range")?;
    Ok(json!({
        "program": concat!("boxline ", env!("CARGO_PKG_VERSION")),
        "date": now.to_string(),
        "board": {"columns": board.columns, "rows": board.rows, "pitch_mm": board.pitch_mm, "diameter_mm": board.diameter_mm},
        "frames": used,
        "inputs": inputs,
    }))
}

fn sha256(path: &Path) -> std::io::Result<String> {
    let mut hasher = Sha256::new();
    std::io::copy(&mut std::fs::File::open(path)?, &mut hasher)?;
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}
