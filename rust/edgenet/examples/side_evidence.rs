//! What speaks for each line that may be a side, in recordings with known truth: from this the weights of the evidence are fitted
//! (`training/weights.py`):
//! `cargo run --release -p boxline-edgenet --example side_evidence -- RECORDINGS... > lines.csv`
//!
//! A row for each line: recording and frame, side, px outwards from the true side, mm and px, radius of the box's edges in px, the
//! logarithm of its odds by all but the networks of lines and sides, the strength of its edge, what the network of lines says,
//! the probability that the network of sides gives its place, and that it gives the side to be hidden; how far outwards of the true side
//! the measured one is, mm, if the face could be measured however unsure it is, and the larger sigma of its length and width.

use boxline::network::{FaceMaps, LineStrip, Network};
use boxline::view::{FaceView, SideOdds};
use boxline::{Error, FaceMeasurement, FaceOutcome, Frame, Px, Settings, StageTimes, measure_face};
use boxline_edgenet::{EdgeNet, Options};
use boxline_proto::json::{TruthFace, read_calibration, read_recording, read_truth};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// A line and what is said of it.
struct Row {
    strip: LineStrip,
    told: f32,
    seen: f64,
    hidden: f64,
}

/// The network that ships, which keeps what it says.
struct Recorder<'a> {
    network: &'a EdgeNet,
    odds: Mutex<Option<SideOdds>>,
    rows: Mutex<Vec<Row>>,
}

impl Network for Recorder<'_> {
    fn maps(&self, frame: &Frame) -> Result<FaceMaps, Error> {
        self.network.maps(frame)
    }

    fn sides(&self, view: &FaceView) -> Result<Option<SideOdds>, Error> {
        let odds = self.network.sides(view)?;
        *self.odds.lock().unwrap_or_else(PoisonError::into_inner) = odds.clone();
        Ok(odds)
    }

    fn line_log_odds(&self, strip: &LineStrip) -> Result<f32, Error> {
        let told = self.network.line_log_odds(strip)?;
        let odds = self.odds.lock().unwrap_or_else(PoisonError::into_inner);
        let seen = odds.as_ref().zip(strip.bin);
        let seen = seen.map(|(odds, bin)| [odds.at(strip.side, bin), odds.hidden(strip.side)]);
        let [seen, hidden] = seen.unwrap_or([f64::NAN; 2]);
        let row = Row { strip: strip.clone(), told, seen, hidden };
        self.rows.lock().unwrap_or_else(PoisonError::into_inner).push(row);
        Ok(told)
    }
}

/// The true face in the frame.
struct Truth {
    corners_px: [[f64; 2]; 4],
    mm_per_px: f64,
    radius_mm: f64,
}

impl Truth {
    /// `None` if no face is in view.
    fn of(face: &TruthFace) -> Option<Self> {
        let (corners_px, [length_mm, width_mm]) = (face.corners_px?, face.size_mm?);
        let doubled: f64 = (0..4)
            .map(|i| {
                let ([u, v], [x, y]) = (corners_px[i], corners_px[(i + 1) % 4]);
                u * y - v * x
            })
            .sum();
        let mm_per_px = (length_mm * width_mm / (0.5 * doubled.abs())).sqrt();
        Some(Self { corners_px, mm_per_px, radius_mm: face.notes.edge_radius_mm.unwrap_or(0.0) })
    }

    /// How far a line with this middle, seen from the face's inside in this direction, is from the true side that looks the same way, px outwards.
    fn off_px(&self, middle: Px, [o, p]: [f64; 2]) -> Option<f64> {
        let centre = [0, 1].map(|i| self.corners_px.iter().map(|c| c[i]).sum::<f64>() / 4.0);
        let sides = (0..4).map(|i| {
            let ([u, v], [x, y]) = (self.corners_px[i], self.corners_px[(i + 1) % 4]);
            let length = (x - u).hypot(y - v);
            let normal = [(y - v) / length, (u - x) / length];
            let outside = (0.5 * (u + x) - centre[0]) * normal[0] + (0.5 * (v + y) - centre[1]) * normal[1];
            let normal = normal.map(|n| n * outside.signum());
            let facing = normal[0] * o + normal[1] * p;
            (facing, (normal[0] * (middle.u - u) + normal[1] * (middle.v - v)) / facing)
        });
        let (facing, off_px) = sides.max_by(|a, b| a.0.total_cmp(&b.0))?;
        (facing > 0.5).then_some(off_px)
    }
}

fn main() -> Outcome<()> {
    let network = EdgeNet::embedded(&Options::default())?;
    println!(
        "recording,frame,refuse,side,off_px,mm_per_px,radius_mm,known,strength,told,seen,hidden,measured_off_mm,sigma_mm"
    );
    for recordings in std::env::args_os().skip(1).map(PathBuf::from) {
        let mut folders: Vec<PathBuf> =
            std::fs::read_dir(&recordings)?.filter_map(|entry| Some(entry.ok()?.path())).collect();
        folders.sort();
        for folder in folders.iter().filter(|folder| folder.join("truth.json").is_file()) {
            frames(&network, folder)?;
        }
    }
    Ok(())
}

/// How far the measured side that looks this way is from the true one, and the face's sigma, mm.
fn measured_side(face: &FaceMeasurement, truth: &Truth, [o, p]: [f64; 2]) -> Option<[f64; 2]> {
    let corners = face.corners_px;
    let centre =
        [corners.iter().map(|c| c.u).sum::<f64>() / 4.0, corners.iter().map(|c| c.v).sum::<f64>() / 4.0];
    let middles = (0..4).map(|i| {
        let (a, b) = (corners[i], corners[(i + 1) % 4]);
        Px::new(0.5 * (a.u + b.u), 0.5 * (a.v + b.v))
    });
    let facing = |m: &Px| (m.u - centre[0]) * o + (m.v - centre[1]) * p;
    let middle = middles.max_by(|a, b| facing(a).total_cmp(&facing(b)))?;
    let off_px = truth.off_px(middle, [o, p])?;
    Some([off_px * truth.mm_per_px, face.length.sigma_mm.max(face.width.sigma_mm)])
}

/// Prints the lines of a recording's frames.
fn frames(network: &EdgeNet, folder: &Path) -> Outcome<()> {
    let truth = read_truth(folder)?.unwrap_or_default();
    let recording = read_recording(folder)?;
    let calibration = read_calibration(&recording.calibration_file)?;
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    for frame in &recording.frames {
        let Some(face) = truth.faces.iter().find(|f| f.frame == frame.id) else { continue };
        let Some(truth) = Truth::of(face) else { continue };
        let picture = Frame::from_jpeg(&std::fs::read(&frame.file)?)?;
        let recorder = Recorder { network, odds: Mutex::new(None), rows: Mutex::new(Vec::new()) };
        let settings = Settings { network: Some(&recorder), least_confidence: 0.0, ..Settings::default() };
        let measured = measure_face(&picture, &calibration, &settings, &mut StageTimes::new())?;
        let rows = recorder.rows.into_inner().unwrap_or_else(PoisonError::into_inner);
        let mut before = 0;
        // Other planes are tried after the first one: the sides begin again.
        for Row { strip, told, seen, hidden } in
            rows.iter().take_while(|row| std::mem::replace(&mut before, row.strip.side) <= row.strip.side)
        {
            let Some(off_px) = truth.off_px(strip.middle, strip.outwards) else { continue };
            let [off_mm, sigma_mm] = match &measured {
                FaceOutcome::Measured(face) => measured_side(face, &truth, strip.outwards),
                FaceOutcome::Rejected(_) => None,
            }
            .unwrap_or([f64::NAN; 2]);
            let strength = strip.values[(boxline::network::STRIP[1] * 2 - 1) * boxline::network::STRIP[2]];
            println!(
                "{name},{},{},{},{off_px:.2},{:.4},{:.2},{:.4},{strength:.3},{told:.4},{seen:.6},{hidden:.4},{off_mm:.3},{sigma_mm:.3}",
                frame.id,
                u8::from(face.refuse.is_some()),
                strip.side,
                truth.mm_per_px,
                truth.radius_mm,
                strip.log_odds,
            );
        }
    }
    Ok(())
}
