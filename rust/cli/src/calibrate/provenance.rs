//! Where a calibration comes from: program, date, settings and the SHA-256 of every input, so that anyone can tell later
//! which pictures made it. For people: nothing reads it back.

use super::input::Input;
use crate::input::sha256;
use anyhow::Context;
use serde_json::{Value, json};

/// The calibration's `provenance`; `used` are the names of the frames that take part.
pub fn value(input: &Input, used: &[&str]) -> anyhow::Result<Value> {
    let board = &input.board;
    let mut inputs = Vec::with_capacity(input.frames.len() + 2);
    for path in input.all_files() {
        // Names without folders: a calibration is passed on, and folders are nobody's business.
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        // A frame that could not be read is left out by name already; it has no hash.
        let hash = sha256(path).ok();
        inputs.push(json!({"file": name, "sha256": hash}));
    }
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
