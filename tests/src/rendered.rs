//! Recordings that are rendered in memory.

use boxline::{Calibration, Frame};
use boxline_proto::json::{Recording, Truth, parse_calibration, parse_recording, parse_truth};
use boxline_sim::Stock;
use boxline_sim::recording::{Recipe, render_recording};
use std::collections::BTreeMap;
use std::path::Path;

/// A rendered recording with what belongs to it: what `boxline render` would write into a folder.
#[derive(Debug)]
pub struct Rendered {
    files: BTreeMap<String, Vec<u8>>,
    recording: Recording,
    /// The head's.
    pub calibration: Calibration,
    /// What the scene is.
    pub truth: Truth,
}

impl Rendered {
    /// Renders a recipe.
    #[must_use]
    pub fn new(recipe: &Recipe, stock: &Stock) -> Self {
        let mut files = BTreeMap::new();
        let rendered = render_recording(recipe, stock, |name, bytes| {
            files.insert(name.to_owned(), bytes);
            Ok(())
        });
        rendered.unwrap_or_else(|e| panic!("{recipe:?}: {e}"));
        let recording = parse_recording(&files["recording.json"], "recording.json", Path::new(""))
            .unwrap_or_else(|e| panic!("{recipe:?}: {e}"));
        let calibration = parse_calibration(&files["calibration.json"], "calibration.json")
            .unwrap_or_else(|e| panic!("{recipe:?}: {e}"));
        let truth =
            parse_truth(&files["truth.json"], "truth.json").unwrap_or_else(|e| panic!("{recipe:?}: {e}"));
        Self { files, recording, calibration, truth }
    }

    /// A frame, decoded.
    #[must_use]
    pub fn frame(&self, id: &str) -> Frame {
        let frame = self.recording.frames.iter().find(|frame| frame.id == id);
        let file = &frame.unwrap_or_else(|| panic!("no frame {id}")).file;
        let file = file.to_string_lossy();
        Frame::from_jpeg(&self.files[file.as_ref()]).unwrap_or_else(|e| panic!("{file}: {e}"))
    }
}
