//! `boxline evaluate --edges`: scores of the network's maps, on frames of the renderer that training never showed, or on
//! recordings. Thresholds are chosen on validation frames.

mod fits;
mod lines;
mod recorded;
mod scores;

use super::recordings_in;
use super::tables::table;
use crate::Finished;
use crate::args::EvaluateArgs;
use crate::input::{lit_faces, read_frame};
use boxline::network::{CHANNELS, FaceMaps, Network};
use boxline::{Error, ErrorKind, Frame};
use boxline_edgenet::EdgeNet;
use boxline_proto::json::read_calibration;
use boxline_sim::stream::{FRAME_PX, sample};
use boxline_sim::{Split, Stock};
use indicatif::{ProgressBar, ProgressStyle};
use scores::{Labels, Scores, Thresholds};
use serde_json::{Value, json};
use std::path::Path;

/// Seeds that training stays below (`rust/edgenet/training`: `VALIDATION_SEED`, `TEST_SEED`).
const VALIDATION_SEED: u64 = 1 << 40;
const TEST_SEED: u64 = 1 << 41;
const VALIDATION_FRAMES: u64 = 200;

/// Runs `boxline evaluate --edges`.
pub fn evaluate(args: &EvaluateArgs) -> anyhow::Result<Finished> {
    let network = args.network.load_anyway()?;
    let of_recordings = !args.folders.is_empty();
    let total = VALIDATION_FRAMES + if of_recordings { 0 } else { args.frames };
    // Drawn on standard error, and only on a terminal.
    let progress =
        ProgressBar::new(total).with_style(ProgressStyle::with_template("{bar:30} {pos}/{len} {msg}")?);
    let mut validation = Scores::default();
    let stock = stock(Split::Training, args.photos.as_deref())?;
    for seed in (VALIDATION_SEED..).take(VALIDATION_FRAMES as usize) {
        let (frame, labels) = simulated(seed, &stock)?;
        validation.add(&network.maps(&frame)?, &labels, None);
        progress.inc(1);
    }
    let thresholds = validation.best_thresholds();
    let mut scores = Scores::default();
    let frames = if of_recordings {
        for folder in &args.folders {
            add_recordings(folder, &network, &thresholds, &mut scores)?;
        }
        "recordings".to_owned()
    } else {
        let stock = self::stock(Split::HeldOut, args.photos.as_deref())?;
        for seed in TEST_SEED..TEST_SEED.saturating_add(args.frames) {
            let (frame, labels) = simulated(seed, &stock)?;
            scores.add(&network.maps(&frame)?, &labels, Some(&thresholds));
            progress.inc(1);
        }
        format!("rendered, {}, seeds from {TEST_SEED}", Split::HeldOut.word())
    };
    progress.finish_and_clear();
    let mut all = scores.json(&thresholds);
    all["data"] = json!(frames);
    all["runtime"] = json!(network.runtime_name());
    all["thresholds_chosen_on"] =
        json!(format!("{VALIDATION_FRAMES} rendered frames, seeds from {VALIDATION_SEED}"));
    let stdout = if args.json { all.to_string() } else { text(&all) };
    Ok(Finished { stdout, exit_code: 0 })
}

fn stock(split: Split, photos: Option<&Path>) -> anyhow::Result<Stock> {
    Ok(match photos {
        Some(folder) => Stock::with_photos(split, folder)?,
        None => Stock::new(split),
    })
}

/// A rendered frame and its labels.
fn simulated(seed: u64, stock: &Stock) -> anyhow::Result<(Frame, Labels)> {
    let sample = sample(seed, stock)?;
    let [width, height] = FRAME_PX;
    let values = sample.labels.iter().map(|v| f32::from(*v) / 255.0).collect();
    let maps = FaceMaps::new(width / 2, height / 2, FRAME_PX, values).ok_or_else(|| {
        Error::new(ErrorKind::InvalidFrame, format!("the renderer does not give {CHANNELS} channels"))
    })?;
    let meta: Value = serde_json::from_str(&sample.meta)?;
    let contrast = [0, 1, 2, 3].map(|i| meta["contrast"][i].as_f64().unwrap_or(0.0));
    let measurable = meta["measurable"].as_bool().unwrap_or(false);
    let frame = Frame::from_rgb(width, height, sample.rgb)?;
    Ok((frame, Labels { maps, contrast: Some(contrast), measurable, face_only: false }))
}

fn add_recordings(
    folder: &Path,
    network: &EdgeNet,
    thresholds: &Thresholds,
    scores: &mut Scores,
) -> anyhow::Result<()> {
    for (recording, truth) in recordings_in(folder)? {
        let calibration = read_calibration(&recording.calibration_file)?;
        for recorded in lit_faces(&recording) {
            let frame = read_frame(&recorded.file)?;
            let size = [frame.width_px(), frame.height_px()];
            let face = truth.faces.iter().find(|face| face.frame == recorded.id);
            if let Some(labels) = face.and_then(|face| recorded::labels(face, &calibration, size)) {
                scores.add(&network.maps(&frame)?, &labels, Some(thresholds));
            }
        }
    }
    Ok(())
}

/// The same as a table and a few lines.
fn text(all: &Value) -> String {
    let number = |value: &Value| value.as_f64().map_or_else(|| "-".to_owned(), |v| format!("{v:.3}"));
    let mut table = table(&["lines", "F", "precision", "recall", "threshold"], 1);
    for (name, score) in all["lines"].as_object().into_iter().flatten() {
        let columns = ["f", "precision", "recall", "threshold"].map(|key| number(&score[key]));
        table.add_row(std::iter::once(name.clone()).chain(columns));
    }
    let mut lines = vec![
        format!(
            "{} frames: {}; {}",
            all["frames"],
            all["data"].as_str().unwrap_or("-"),
            all["runtime"].as_str().unwrap_or("-")
        ),
        format!(
            "thresholds from {}; a line is right within 3 px at 512",
            all["thresholds_chosen_on"].as_str().unwrap_or("-")
        ),
        String::new(),
        table.to_string(),
        String::new(),
        format!("F of the four lasers  {}", number(&all["laser_f"])),
        format!(
            "face mask IoU         {} mean, {} median",
            number(&all["mask_iou_mean"]),
            number(&all["mask_iou_median"])
        ),
        format!("mask without a face   {} of the frame", number(&all["mask_share_without_face"])),
    ];
    for (name, error) in all["line_px"].as_object().into_iter().flatten() {
        let [median, p90, below] = ["median", "p90", "below_2"].map(|key| number(&error[key]));
        lines.push(format!(
            "laser line, {name:9} {median} px median, {p90} p90, {below} below 2 px (of {})",
            error["n"]
        ));
    }
    lines.push(format!(
        "four lasers < 2 px    {} of measurable frames, {} where none is dim",
        number(&all["four_lasers_below_2px"]),
        number(&all["four_lasers_below_2px_not_dim"])
    ));
    let points = &all["key_points_px"];
    lines.push(format!(
        "key points            {} found of {}, {} px off ({} p90); with signs, eq. 21: {}, {}",
        number(&points["found"]),
        points["n"],
        number(&points["unsigned"]),
        number(&points["p90"]),
        number(&points["signed"][0]),
        number(&points["signed"][1])
    ));
    lines.join("\n")
}
