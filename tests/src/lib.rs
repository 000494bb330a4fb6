//! Harness of the recorded-frame tests: reads a folder of `tests/data` with its calibration and truth, and keeps today's
//! results in `expected.json` beside them. What a folder must hold is not there: a panic, with its name.
#![allow(clippy::missing_panics_doc)]

mod expected;
mod rendered;

pub use expected::{check_expected, face_summary, report_summary};
pub use rendered::Rendered;

use boxline::{Calibration, Frame, Network, Settings, Workers};
use boxline_edgenet::{EdgeNet, Options};
use boxline_proto::json::{Recording, Truth, read_calibration, read_recording, read_truth};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// The settings that ship: with the network.
#[must_use]
pub fn shipped() -> Settings<'static> {
    static NETWORK: OnceLock<EdgeNet> = OnceLock::new();
    let network = NETWORK.get_or_init(|| {
        EdgeNet::embedded(&Options::default()).unwrap_or_else(|e| panic!("the network that ships: {e}"))
    });
    Settings { network: Some(network as &dyn Network), ..Settings::default() }
}

/// A recording of `tests/data` with what belongs to it.
#[derive(Debug)]
pub struct Recorded {
    /// Where it lies.
    pub folder: PathBuf,
    /// Its frames.
    pub recording: Recording,
    /// The calibration that it names.
    pub calibration: Calibration,
    /// What the scene was.
    pub truth: Truth,
}

impl Recorded {
    /// Reads `tests/data/<name>`.
    #[must_use]
    pub fn read(name: &str) -> Self {
        Self::read_from(&Path::new(env!("CARGO_MANIFEST_DIR")).join("data").join(name))
    }

    /// Reads the recording of a folder.
    #[must_use]
    pub fn read_from(folder: &Path) -> Self {
        let name = folder.display();
        let recording = read_recording(folder).unwrap_or_else(|e| panic!("{name}: {e}"));
        let calibration =
            read_calibration(&recording.calibration_file).unwrap_or_else(|e| panic!("{name}: {e}"));
        let truth = read_truth(folder).unwrap_or_else(|e| panic!("{name}: {e}"));
        let truth = truth.unwrap_or_else(|| panic!("{name}: no truth.json"));
        Self { folder: folder.to_owned(), recording, calibration, truth }
    }

    /// The folder's name.
    #[must_use]
    pub fn name(&self) -> String {
        self.folder.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// The bytes of a frame's file.
    #[must_use]
    pub fn jpeg(&self, id: &str) -> Vec<u8> {
        let frame = self.recording.frames.iter().find(|f| f.id == id);
        let file = &frame.unwrap_or_else(|| panic!("{}: no frame {id}", self.folder.display())).file;
        std::fs::read(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()))
    }

    /// A frame, decoded.
    #[must_use]
    pub fn frame(&self, id: &str) -> Frame {
        Frame::from_jpeg(&self.jpeg(id)).unwrap_or_else(|e| panic!("{} {id}: {e}", self.folder.display()))
    }
}

/// A folder or file beside this repository; where it is missing, says that the test was skipped.
#[must_use]
pub fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared").join(name);
    if path.exists() {
        return Some(path);
    }
    let mut stdout = std::io::stdout(); // what `println!` writes is hidden if the test passes
    writeln!(stdout, "SKIPPED: {} is not there", path.display())
        .unwrap_or_else(|e| panic!("standard output: {e}"));
    None
}

/// A thread for each frame of a box.
#[derive(Debug)]
pub struct FrameThreads;

impl Workers for FrameThreads {
    fn both(&self, first: &mut (dyn FnMut() + Send), second: &mut (dyn FnMut() + Send)) {
        std::thread::scope(|scope| {
            scope.spawn(second);
            first();
        });
    }
}
