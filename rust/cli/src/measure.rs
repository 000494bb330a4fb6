//! `boxline measure` and `boxline face`: a few frames in, one result out.

use crate::Finished;
use crate::args::{FaceArgs, MeasureArgs, Output};
use crate::input::{Usage, add_off, box_frames, read_frame};
use crate::output::check_places;
use crate::overlay::explain::{self, Stages};
use crate::overlay::{self, Headline, View};
use crate::say::say;
use crate::text;
use boxline::trace::Trace;
use boxline::{FaceOutcome, Frame, Outcome, Settings, measure_box, measure_face};
use boxline_proto::json::{RecordedFrame, face_json, read_calibration, read_recording, report_json};
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

const MEASURED: u8 = 0;
const REFUSED: u8 = 3;
const AMBIGUOUS: u8 = 4;

/// A frame to read, and the same view with the lasers off.
struct Source {
    name: String,
    file: PathBuf,
    off: Option<PathBuf>,
}

/// Which files to read: frames with their names, the calibration, and the head that a recording names.
struct Sources {
    frames: Vec<Source>,
    calibration: PathBuf,
    serial: Option<String>,
}

/// Runs `boxline measure`.
pub fn measure(args: &MeasureArgs) -> anyhow::Result<Finished> {
    let Sources { frames: sources, calibration, serial } = sources(args)?;
    let inputs: Vec<&Path> = sources
        .iter()
        .flat_map(|source| [Some(&source.file), source.off.as_ref()])
        .flatten()
        .chain([&calibration])
        .map(PathBuf::as_path)
        .collect();
    check_overlay(&args.output, &inputs)?;
    if let Some(folder) = args.explain.as_ref().filter(|folder| folder.exists()) {
        return Err(
            Usage(format!("{}: is there already; --explain takes a new folder", folder.display())).into()
        );
    }
    let calibration = read_calibration(&calibration)?;
    if let Some(serial) = serial.filter(|serial| serial != calibration.serial()) {
        say(&format!(
            "warning: the recording is of head {serial}, the calibration of head {}",
            calibration.serial()
        ));
    }
    let read = |source: &Source| {
        let mut frame = read_frame(&source.file)?;
        source.off.iter().for_each(|off| add_off(&mut frame, off, read_frame(off)));
        Ok(frame)
    };
    let frames: Vec<Frame> = sources.par_iter().map(read).collect::<Result<_, boxline::Error>>()?;
    let frames: Vec<&Frame> = frames.iter().collect();
    let network = args.measuring.network.load(args.measuring.edges)?;
    let stages = args.explain.is_some().then(|| Stages::new(&frames));
    let trace = stages.as_ref().map(|stages| stages as &dyn Trace);
    let settings = Settings { trace, ..args.measuring.settings(args.choose, network.as_ref()) };
    let report = measure_box(&frames, &calibration, &settings).map_err(|e| {
        // The library knows frames, not files: the culprit is the one that does not fit.
        let fits = |frame: &Frame| {
            (frame.width_px(), frame.height_px())
                == (calibration.width_px() as usize, calibration.height_px() as usize)
        };
        let culprit = frames.iter().position(|frame| !fits(frame)).unwrap_or(0);
        e.in_context(sources[culprit].file.display())
    })?;
    let names: Vec<&str> = sources.iter().map(|source| source.name.as_str()).collect();

    if let (Some(folder), Some(stages)) = (&args.explain, stages) {
        let count = explain::write(folder, stages, &report, &names)?;
        say(&format!("{}: {count} pictures", folder.display()));
    }
    if let Some(path) = &args.output.overlay {
        let shown = names.iter().zip(&frames).zip(&report.faces);
        let views: Vec<View> =
            shown.map(|((name, frame), face)| View { name, frame, face, truth: None }).collect();
        overlay::write(&overlay::draw(&views, &Headline::of_box(&report.outcome))?, path)?;
    }
    let stdout = if args.output.json {
        report_json(&report, &names).to_string()
    } else {
        text::of_box(&report, &names)
    };
    let exit_code = match report.outcome {
        Outcome::Measured(_) => MEASURED,
        Outcome::Ambiguous(_) => AMBIGUOUS,
        Outcome::Rejected(_) => REFUSED,
    };
    Ok(Finished { stdout, exit_code })
}

/// Runs `boxline face`.
pub fn face(args: &FaceArgs) -> anyhow::Result<Finished> {
    check_overlay(&args.output, &[&args.frame, &args.calibration])?;
    let calibration = read_calibration(&args.calibration)?;
    let frame = read_frame(&args.frame)?;
    let network = args.measuring.network.load(args.measuring.edges)?;
    let settings = args.measuring.settings(None, network.as_ref());
    let report =
        measure_face(&frame, &calibration, &settings).map_err(|e| e.in_context(args.frame.display()))?;
    let face = &report.outcome;
    let name = file_name(&args.frame);

    if let Some(path) = &args.output.overlay {
        let view = View { name: &name, frame: &frame, face, truth: None };
        overlay::write(&overlay::draw(&[view], &Headline::of_face(face))?, path)?;
    }
    let stdout =
        if args.output.json { face_json(&report, &name).to_string() } else { text::of_face(&report, &name) };
    let exit_code = match face {
        FaceOutcome::Measured(_) => MEASURED,
        FaceOutcome::Rejected(_) => REFUSED,
    };
    Ok(Finished { stdout, exit_code })
}

fn sources(args: &MeasureArgs) -> anyhow::Result<Sources> {
    match &args.inputs[..] {
        [folder] if folder.is_file() => Err(Usage(format!(
            "{}: is a file; give a recording's folder, or two frames (one face alone: `boxline face`)",
            folder.display()
        ))
        .into()),
        [folder] => {
            let recording = read_recording(folder)?;
            let frames = box_frames(&recording)?;
            let source = |frame: &&RecordedFrame| Source {
                name: frame.id.clone(),
                file: frame.file.clone(),
                off: recording.twin_of(frame).filter(|_| !args.ignore_off).map(|off| off.file.clone()),
            };
            if !args.off.is_empty() {
                return Err(Usage("--off is for frames; a recording names its own".into()).into());
            }
            let frames = frames.iter().map(source).collect();
            let calibration = args.calibration.clone().unwrap_or_else(|| recording.calibration_file.clone());
            Ok(Sources { frames, calibration, serial: Some(recording.serial) })
        }
        files @ ([_, _] | [_, _, _]) => {
            let Some(calibration) = args.calibration.clone() else {
                return Err(Usage("frames need --calibration FILE".into()).into());
            };
            let short: BTreeSet<String> = files.iter().map(|path| file_name(path)).collect();
            let name = |path: &PathBuf| match short.len() == files.len() {
                true => file_name(path),
                false => path.display().to_string(),
            };
            if !args.off.is_empty() && args.off.len() != files.len() {
                let text =
                    format!("{} frames and {} --off, one for each is needed", files.len(), args.off.len());
                return Err(Usage(text).into());
            }
            let source = |(i, path): (usize, &PathBuf)| Source {
                name: name(path),
                file: path.clone(),
                off: args.off.get(i).cloned(),
            };
            let frames = files.iter().enumerate().map(source).collect();
            Ok(Sources { frames, calibration, serial: None })
        }
        more => {
            Err(Usage(format!("{} inputs, one folder or two or three frames are needed", more.len())).into())
        }
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// A wrong name for the overlay is told before the work, and no input is ever overwritten.
fn check_overlay(output: &Output, inputs: &[&Path]) -> anyhow::Result<()> {
    let Some(overlay) = &output.overlay else { return Ok(()) };
    overlay::format_of(overlay).map_err(|e| Usage(e.to_string()))?;
    Ok(check_places(&[overlay], inputs.iter().copied())?)
}
