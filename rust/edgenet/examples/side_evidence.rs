//! What speaks for each line that may be a side, in recordings with known truth: from this the weights of the evidence are fitted
//! (`training/weights.py`):
//! `cargo run --release -p boxline-edgenet --example side_evidence -- RECORDINGS... > lines.csv`
//!
//! A row for each line: recording and frame, side, px outwards from the true side, mm and px, radius of the box's edges in px, the
//! logarithm of its odds by all but the networks of lines and sides, the strength of its edge, what the network of lines says,
//! the probability that the network of sides gives its place, that it gives the side to be hidden, and to be outside the picture; how far outwards of the true side
//! the measured one is, mm, if the face could be measured however unsure it is, and the larger sigma of its length and width; what the
//! stripes' light says of the line (`StripeLight`), and how much of what lies beyond it is the face in the map (`FaceMaps::face_beyond`).
//!
//! With `--without-network` before the recordings it is what is looked at without one (`diagnostics::SideLine`), for `training/weights_alone.py`.

mod true_face;

use boxline::diagnostics::side_lines;
use boxline::network::{FaceMaps, LineStrip, Network};
use boxline::view::{FaceView, SideOdds};
use boxline::{Calibration, Error, FaceMeasurement, FaceOutcome, Frame, Px, Settings, measure_face};
use boxline_edgenet::{EdgeNet, Options};
use boxline_proto::json::{read_calibration, read_recording, read_truth};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use true_face::TrueFace;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// A line and what is said of it.
struct Row {
    strip: LineStrip,
    line_log_odds: f32,
    seen: f64,
    hidden: f64,
    not_in_view: f64,
    mask_beyond: f32,
}

/// The network that ships, which keeps what it says.
struct Recorder<'a> {
    network: &'a EdgeNet,
    maps: Mutex<Option<FaceMaps>>,
    odds: Mutex<Option<SideOdds>>,
    rows: Mutex<Vec<Row>>,
}

impl Network for Recorder<'_> {
    fn maps(&self, frame: &Frame) -> Result<FaceMaps, Error> {
        let maps = self.network.maps(frame)?;
        *self.maps.lock().unwrap_or_else(PoisonError::into_inner) = Some(maps.clone());
        Ok(maps)
    }

    fn sides(&self, view: &FaceView) -> Result<Option<SideOdds>, Error> {
        let odds = self.network.sides(view)?;
        *self.odds.lock().unwrap_or_else(PoisonError::into_inner) = odds.clone();
        Ok(odds)
    }

    fn line_log_odds(&self, strip: &LineStrip) -> Result<f32, Error> {
        let line_log_odds = self.network.line_log_odds(strip)?;
        let odds = self.odds.lock().unwrap_or_else(PoisonError::into_inner);
        let seen = odds.as_ref().zip(strip.bin);
        let seen = seen.map(|(odds, bin)| {
            [odds.at(strip.side, bin), odds.hidden(strip.side), odds.not_in_view(strip.side)]
        });
        let [seen, hidden, not_in_view] = seen.unwrap_or([f64::NAN; 3]);
        let maps = self.maps.lock().unwrap_or_else(PoisonError::into_inner);
        let mask_beyond = maps.as_ref().map_or(f32::NAN, |m| m.face_beyond(strip.middle, strip.outwards));
        let row = Row { strip: strip.clone(), line_log_odds, seen, hidden, not_in_view, mask_beyond };
        self.rows.lock().unwrap_or_else(PoisonError::into_inner).push(row);
        Ok(line_log_odds)
    }
}

fn main() -> Outcome<()> {
    let mut arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    if arguments.first().is_some_and(|first| first.as_os_str() == "--without-network") {
        println!(
            "recording,frame,refuse,side,off_px,mm_per_px,radius_mm,{},beyond_least,beyond_most,missing,measured_off_mm",
            (0..11).map(|i| format!("clue_{i}")).collect::<Vec<_>>().join(",")
        );
        for recordings in arguments.drain(1..) {
            for folder in with_truth(&recordings)? {
                each_view(&folder, alone)?;
            }
        }
        return Ok(());
    }
    let network = EdgeNet::embedded(&Options::default())?;
    println!(
        "recording,frame,refuse,side,off_px,mm_per_px,radius_mm,known,strength,told,seen,hidden,not_in_view,measured_off_mm,sigma_mm,beyond_least,beyond_most,missing,to_border,step,mask_beyond"
    );
    for recordings in arguments {
        for folder in with_truth(&recordings)? {
            each_view(&folder, |view, calibration| with_network(&network, view, calibration))?;
        }
    }
    Ok(())
}

/// The recordings with truth in a folder, by name.
fn with_truth(recordings: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut folders: Vec<PathBuf> =
        std::fs::read_dir(recordings)?.filter_map(|entry| Some(entry.ok()?.path())).collect();
    folders.retain(|folder| folder.join("truth.json").is_file());
    folders.sort();
    Ok(folders)
}

/// How far the measured side that looks this way is from the true one, and the face's sigma, mm.
fn measured_side(face: &FaceMeasurement, truth: &TrueFace, [o, p]: [f64; 2]) -> Option<[f64; 2]> {
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

/// A frame with its true face.
struct View {
    /// Recording, frame, and why it must be refused (0: it need not): the first columns of a row.
    columns: String,
    truth: TrueFace,
    picture: Frame,
}

impl View {
    /// How far the measured side that looks this way is from the true one, and the face's sigma, mm; not numbers if it was not measured.
    fn measured_mm(&self, measured: &FaceOutcome, outwards: [f64; 2]) -> [f64; 2] {
        let side = measured.measured().and_then(|face| measured_side(face, &self.truth, outwards));
        side.unwrap_or([f64::NAN; 2])
    }
}

/// Does something with each frame of a recording that shows a face.
fn each_view(folder: &Path, print: impl Fn(&View, &Calibration) -> Outcome<()>) -> Outcome<()> {
    let truth = read_truth(folder)?.unwrap_or_default();
    let recording = read_recording(folder)?;
    let calibration = read_calibration(&recording.calibration_file)?;
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    for frame in &recording.frames {
        let Some(face) = truth.faces.iter().find(|f| f.frame == frame.id) else { continue };
        let Some(truth) = TrueFace::of(face) else { continue };
        let picture = Frame::from_jpeg(&std::fs::read(&frame.file)?)?;
        let columns = format!("{name},{},{}", frame.id, face.refuse.as_deref().unwrap_or("0"));
        print(&View { columns, truth, picture }, &calibration)?;
    }
    Ok(())
}

/// Prints the lines of a frame.
fn with_network(network: &EdgeNet, view: &View, calibration: &Calibration) -> Outcome<()> {
    let View { columns, truth, picture } = view;
    let recorder =
        Recorder { network, maps: Mutex::new(None), odds: Mutex::new(None), rows: Mutex::new(Vec::new()) };
    let settings = Settings { network: Some(&recorder), least_confidence: 0.0, ..Settings::default() };
    let measured = measure_face(picture, calibration, &settings)?.outcome;
    let rows = recorder.rows.into_inner().unwrap_or_else(PoisonError::into_inner);
    let mut before = 0;
    // Other planes are tried after the first one: the sides begin again.
    for Row { strip, line_log_odds, seen, hidden, not_in_view, mask_beyond } in
        rows.iter().take_while(|row| std::mem::replace(&mut before, row.strip.side) <= row.strip.side)
    {
        let Some(off_px) = truth.off_px(strip.middle, strip.outwards) else { continue };
        let [off_mm, sigma_mm] = view.measured_mm(&measured, strip.outwards);
        let [p, q] = strip.light.beyond;
        let strength = strip.values[(boxline::network::STRIP[1] * 2 - 1) * boxline::network::STRIP[2]];
        println!(
            "{columns},{},{off_px:.2},{:.4},{:.2},{:.4},{strength:.3},{line_log_odds:.4},{seen:.6},{hidden:.4},{not_in_view:.6},{off_mm:.3},{sigma_mm:.3},{p:.2},{q:.2},{:.2},{:.2},{:.3},{mask_beyond:.4}",
            strip.side,
            truth.mm_per_px,
            truth.radius_mm,
            strip.log_odds,
            strip.light.missing,
            strip.light.to_border,
            strip.light.step,
        );
    }
    Ok(())
}

/// The same without a network.
fn alone(view: &View, calibration: &Calibration) -> Outcome<()> {
    let View { columns, truth, picture } = view;
    let settings = Settings { least_confidence: 0.0, ..Settings::default() };
    let measured = measure_face(picture, calibration, &settings)?.outcome;
    for line in side_lines(picture, calibration) {
        let Some(off_px) = truth.off_px(line.middle, line.outwards) else { continue };
        let [off_mm, _] = view.measured_mm(&measured, line.outwards);
        let clues = line.clues.map(|clue| format!("{clue:.4}")).join(",");
        let [p, q] = line.light.beyond;
        println!(
            "{columns},{},{off_px:.2},{:.4},{:.2},{clues},{p:.2},{q:.2},{:.2},{off_mm:.3}",
            line.side, truth.mm_per_px, truth.radius_mm, line.light.missing,
        );
    }
    Ok(())
}
