//! Rendered recordings for `boxline evaluate --simulate`, in memory: the same bytes that `boxline render --held-out` writes into a
//! folder for the same kind, seed, photographs and hazards.

use super::recorded::Recorded;
use crate::input::add_off;
use boxline::{Calibration, Error, ErrorKind, Frame};
use boxline_proto::json::{RecordedFrame, parse_calibration, parse_recording, parse_truth};
use boxline_sim::Stock;
use boxline_sim::recording::{HeadHold, Kind, Recipe, render_recording};
use std::collections::BTreeMap;
use std::path::Path;

/// Renders the recording of a seed and decodes it.
pub fn recorded(
    name: &str,
    kind: Kind,
    seed: u64,
    off: bool,
    stock: &Stock,
) -> anyhow::Result<(Recorded, Calibration)> {
    let mut files = BTreeMap::new();
    let recipe = Recipe { off: off.then_some(HeadHold::Hand), ..Recipe::new(seed, kind) };
    render_recording(&recipe, stock, |name, bytes| {
        files.insert(name.to_owned(), bytes);
        Ok(())
    })?;
    let file = |file: &str| {
        files.get(file).ok_or_else(|| Error::new(ErrorKind::Io, format!("{name}: {file}: was not rendered")))
    };
    let recording = parse_recording(file("recording.json")?, name, Path::new(name))?;
    let truth = parse_truth(file("truth.json")?, name)?;
    let calibration = parse_calibration(file("calibration.json")?, name)?;
    let decoded = |frame: &RecordedFrame| {
        let jpeg = frame.file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Frame::from_jpeg(file(&jpeg)?).map_err(|e| e.in_context(frame.file.display()))
    };
    let frame = |lit: &RecordedFrame| {
        let mut frame = decoded(lit)?;
        if let Some(off) = recording.twin_of(lit) {
            add_off(&mut frame, &off.file, decoded(off));
        }
        Ok(frame)
    };
    Ok((Recorded::decode(&recording, &truth, frame)?, calibration))
}
