//! What the network of lines learns from: every line that may be a side of the faces of rendered boxes, and how far it is from the true
//! one:
//! `cargo run --release -p boxline-edgenet --example line_strips -- OUT FIRST_SEED COUNT training|held-out [PHOTOS]`
//!
//! Writes one file a frame, `OUT/<seed><frame>.strips`; those that are there stay. A record for each line: little-endian f32
//! with the side (0 to 3), the distance outwards from the true side in px, the radius of the box's edges in px, the logarithm of the
//! odds without this network and the three facts of [`LineStrip::values`]' last row; then the other rows as bytes of 1/255. Frames are
//! drawn finely only around the face and pass through the camera's JPEG, as `boxline render` writes it.

mod true_face;

use boxline::network::{FaceMaps, LineStrip, Network, STRIP};
use boxline::{Calibration, Error, Frame, Settings, measure_face};
use boxline_edgenet::{EdgeNet, Options};
use boxline_proto::json::{TruthFace, parse_calibration, parse_truth};
use boxline_sim::recording::{Detail, Kind, Recipe, render_recording};
use boxline_sim::{Split, Stock};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use true_face::TrueFace;

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
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [out, first, count, split, photos @ ..] = &words[..] else {
        return Err("OUT FIRST_SEED COUNT training|held-out [PHOTOS] are needed".into());
    };
    let split = [Split::Training, Split::HeldOut][usize::from(split == "held-out")];
    let stock = match photos {
        [folder, ..] => Stock::with_photos(split, Path::new(folder))?,
        [] => Stock::new(split),
    };
    let (out, first, count): (PathBuf, u64, u64) = (out.into(), first.parse()?, count.parse()?);
    std::fs::create_dir_all(&out)?;
    let recorder =
        Recorder { network: EdgeNet::embedded(&Options::default())?, strips: Mutex::new(Vec::new()) };
    for seed in first..first + count {
        if !["a", "b"].iter().all(|frame| out.join(format!("{seed}{frame}.strips")).exists()) {
            faces(&recorder, seed, &stock, &out)?;
        }
    }
    Ok(())
}

/// Writes the strips of a box's two faces.
fn faces(recorder: &Recorder, seed: u64, stock: &Stock, out: &Path) -> Outcome<()> {
    let recipe = Recipe { detail: Detail::AroundFace, ..Recipe::new(seed, Kind::Box) };
    let mut files = BTreeMap::new();
    render_recording(&recipe, stock, |name, bytes| {
        files.insert(name.to_owned(), bytes);
        Ok(())
    })?;
    let calibration = parse_calibration(&files["calibration.json"], "calibration.json")?;
    for face in &parse_truth(&files["truth.json"], "truth.json")?.faces {
        let picture = Frame::from_jpeg(&files[&format!("{}.jpg", face.frame)])?;
        let Some(bytes) = strips(recorder, &picture, &calibration, face)? else { continue };
        let unfinished = out.join(format!("{seed}{}.unfinished", face.frame));
        std::fs::write(&unfinished, bytes)?;
        std::fs::rename(&unfinished, unfinished.with_extension("strips"))?;
    }
    Ok(())
}

/// The strips of a frame's lines; `None` if it shows no face.
fn strips(
    recorder: &Recorder,
    picture: &Frame,
    calibration: &Calibration,
    face: &TruthFace,
) -> Outcome<Option<Vec<u8>>> {
    let Some(truth) = TrueFace::of(face) else { return Ok(None) };
    let settings = Settings { network: Some(recorder), ..Settings::default() };
    // What it measures does not matter here.
    let _ = measure_face(picture, calibration, &settings)?;
    let strips = std::mem::take(&mut *recorder.strips.lock().unwrap_or_else(PoisonError::into_inner));
    let mut bytes = Vec::new();
    let mut before = 0;
    // Other planes are tried after the first one: the sides begin again.
    for strip in strips.iter().take_while(|strip| std::mem::replace(&mut before, strip.side) <= strip.side) {
        let Some(off_px) = truth.off_px(strip.middle, strip.outwards) else { continue };
        bytes.extend(record(strip, off_px as f32, (truth.radius_mm / truth.mm_per_px) as f32));
    }
    Ok(Some(bytes))
}

fn record(strip: &LineStrip, off_px: f32, radius_px: f32) -> Vec<u8> {
    let [channels, rows, columns] = STRIP;
    let fact = |channel: usize| strip.values[(channel * rows + rows - 1) * columns];
    let facts = [strip.side as f32, off_px, radius_px, strip.log_odds, fact(0), fact(1), fact(2)];
    let mut bytes: Vec<u8> = facts.into_iter().flat_map(f32::to_le_bytes).collect();
    for channel in 0..channels {
        let values = &strip.values[channel * rows * columns..][..(rows - 1) * columns];
        bytes.extend(values.iter().map(|v| (v * 255.0).round() as u8));
    }
    bytes
}
