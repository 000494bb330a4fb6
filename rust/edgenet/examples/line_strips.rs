//! What the network of lines learns from: every line that may be a side in recordings with known truth, and how far it is from the
//! true one:
//! `cargo run --release -p boxline-edgenet --example line_strips -- OUT RECORDINGS...`, where `RECORDINGS` is a folder of them.
//!
//! Writes one file a frame, `OUT/<recording><frame>.strips`; those that are there stay. A record for each line: little-endian f32
//! with the side (0 to 3), the distance outwards from the true side in px, the radius of the box's edges in px, the logarithm of the
//! odds without this network and the three facts of [`LineStrip::values`]' last row; then the other rows as bytes of 1/255.

mod true_face;

use boxline::network::{FaceMaps, LineStrip, Network, STRIP};
use boxline::{Error, Frame, Settings, StageTimes, measure_face};
use boxline_edgenet::{EdgeNet, Options};
use boxline_proto::json::{read_calibration, read_recording, read_truth};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use true_face::{TrueFace, with_truth};

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// The network that ships, which keeps what it is asked.
struct Recorder {
    network: EdgeNet,
    strips: Mutex<Vec<LineStrip>>,
}

impl Network for Recorder {
    fn maps(&self, frame: &Frame) -> Result<FaceMaps, Error> {
        self.network.maps(frame)
    }

    fn line_log_odds(&self, strip: &LineStrip) -> Result<f32, Error> {
        self.strips.lock().unwrap_or_else(PoisonError::into_inner).push(strip.clone());
        Ok(strip.log_odds)
    }
}

fn main() -> Outcome<()> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let out = arguments.next().ok_or("a folder to write to and a folder with recordings are needed")?;
    std::fs::create_dir_all(&out)?;
    let recorder =
        Recorder { network: EdgeNet::embedded(&Options::default())?, strips: Mutex::new(Vec::new()) };
    for recordings in arguments {
        for folder in with_truth(&recordings)? {
            frames(&recorder, &folder, &out)?;
        }
    }
    Ok(())
}

/// Writes the strips of a recording's frames.
fn frames(recorder: &Recorder, folder: &Path, out: &Path) -> Outcome<()> {
    let truth = read_truth(folder)?.unwrap_or_default();
    let recording = read_recording(folder)?;
    let calibration = read_calibration(&recording.calibration_file)?;
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    for frame in &recording.frames {
        let file = out.join(format!("{name}{}.strips", frame.id));
        let face = truth.faces.iter().find(|f| f.frame == frame.id);
        let Some(truth) = face.and_then(TrueFace::of).filter(|_| !file.exists()) else { continue };
        let picture = Frame::from_jpeg(&std::fs::read(&frame.file)?)?;
        let settings = Settings { network: Some(recorder), ..Settings::default() };
        // What it measures does not matter here.
        let _ = measure_face(&picture, &calibration, &settings, &mut StageTimes::new())?;
        let strips = std::mem::take(&mut *recorder.strips.lock().unwrap_or_else(PoisonError::into_inner));
        let mut bytes = Vec::new();
        let mut before = 0;
        // Other planes are tried after the first one: the sides begin again.
        for strip in
            strips.iter().take_while(|strip| std::mem::replace(&mut before, strip.side) <= strip.side)
        {
            let Some(off_px) = truth.off_px(strip.middle, strip.outwards) else { continue };
            bytes.extend(record(strip, off_px as f32, (truth.radius_mm / truth.mm_per_px) as f32));
        }
        let unfinished = file.with_extension("unfinished");
        std::fs::write(&unfinished, bytes)?;
        std::fs::rename(unfinished, &file)?;
    }
    Ok(())
}

fn record(strip: &LineStrip, off_px: f32, radius_px: f32) -> Vec<u8> {
    let [channels, rows, columns] = STRIP;
    let fact = |channel: usize| strip.values[(channel * rows + rows - 1) * columns];
    let told = [strip.side as f32, off_px, radius_px, strip.log_odds, fact(0), fact(1), fact(2)];
    let mut bytes: Vec<u8> = told.into_iter().flat_map(f32::to_le_bytes).collect();
    for channel in 0..channels {
        let values = &strip.values[channel * rows * columns..][..(rows - 1) * columns];
        bytes.extend(values.iter().map(|v| (v * 255.0).round() as u8));
    }
    bytes
}
