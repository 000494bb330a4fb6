//! `boxline measure` and `boxline face`: a few frames in, one result out.

use crate::Finished;
use crate::args::{FaceArgs, MeasureArgs, Output};
use crate::input::{Usage, pair, read_frame};
use crate::overlay::{self, Headline, View};
use crate::text;
use boxline::{FaceOutcome, Frame, Outcome, StageTimes, measure_box_with_hints, measure_face_with_hint};
use boxline_proto::json::{face_json, read_calibration, read_recording, report_json};
use std::path::{Path, PathBuf};

const MEASURED: u8 = 0;
const REFUSED: u8 = 3;
const AMBIGUOUS: u8 = 4;

/// Which files to read: frames with their names, the calibration, and the head that a recording names.
struct Sources {
    frames: [(String, PathBuf); 2],
    calibration: PathBuf,
    serial: Option<String>,
}

/// Runs `boxline measure`.
pub fn measure(args: &MeasureArgs) -> anyhow::Result<Finished> {
    let Sources { frames: [first, second], calibration, serial } = sources(args)?;
    check_overlay(&args.output, &[&first.1, &second.1, &calibration])?;
    let calibration = read_calibration(&calibration)?;
    if let Some(serial) = serial.filter(|serial| serial != calibration.serial()) {
        eprintln!(
            "warning: the recording is of head {serial}, the calibration of head {}",
            calibration.serial()
        );
    }
    let (frame_a, frame_b) = rayon::join(|| read_frame(&first.1), || read_frame(&second.1));
    let (frame_a, frame_b) = (frame_a?, frame_b?);
    let network = args.how.network.load(args.how.edges)?;
    let settings = args.how.settings(args.choose, network.as_ref());
    let (report, hints) =
        measure_box_with_hints(&frame_a, &frame_b, &calibration, &settings, &mut StageTimes::new()).map_err(
            |e| {
                // The library knows frames, not files: the culprit is the one that does not fit.
                let fits = |frame: &Frame| {
                    (frame.width_px(), frame.height_px())
                        == (calibration.width_px() as usize, calibration.height_px() as usize)
                };
                e.in_context(if fits(&frame_a) { second.1.display() } else { first.1.display() })
            },
        )?;
    let names = [first.0.as_str(), second.0.as_str()];

    if let Some(path) = &args.output.overlay {
        let views = [
            View { name: names[0], frame: &frame_a, face: &report.faces[0], truth: None },
            View { name: names[1], frame: &frame_b, face: &report.faces[1], truth: None },
        ];
        overlay::write(&overlay::draw(&views, &Headline::of_box(&report.outcome))?, path)?;
    }
    let stdout = if args.output.json {
        report_json(&report, &hints, names).to_string()
    } else {
        text::of_box(&report, names, &hints)
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
    let network = args.how.network.load(args.how.edges)?;
    let settings = args.how.settings(None, network.as_ref());
    let (face, hint) = measure_face_with_hint(&frame, &calibration, &settings, &mut StageTimes::new())
        .map_err(|e| e.in_context(args.frame.display()))?;
    let name = file_name(&args.frame);

    if let Some(path) = &args.output.overlay {
        let view = View { name: &name, frame: &frame, face: &face, truth: None };
        overlay::write(&overlay::draw(&[view], &Headline::of_face(&face))?, path)?;
    }
    let stdout = if args.output.json {
        face_json(&face, hint.as_ref(), &name).to_string()
    } else {
        text::of_face(&face, &name, hint.as_ref())
    };
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
            let frames = pair(&recording)?.map(|frame| (frame.id.clone(), frame.file.clone()));
            let calibration = args.calibration.clone().unwrap_or_else(|| recording.calibration_file.clone());
            Ok(Sources { frames, calibration, serial: Some(recording.serial) })
        }
        [first, second] => {
            let Some(calibration) = args.calibration.clone() else {
                return Err(Usage("two frames need --calibration FILE".into()).into());
            };
            let mut frames = [first, second].map(|path| (file_name(path), path.clone()));
            if frames[0].0 == frames[1].0 {
                frames = [first, second].map(|path| (path.display().to_string(), path.clone()));
            }
            Ok(Sources { frames, calibration, serial: None })
        }
        more => Err(Usage(format!("{} inputs, one folder or two frames are needed", more.len())).into()),
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// A wrong name for the overlay is told before the work, and no input is ever overwritten.
fn check_overlay(output: &Output, inputs: &[&Path]) -> anyhow::Result<()> {
    let Some(overlay) = &output.overlay else { return Ok(()) };
    overlay::format_of(overlay).map_err(|e| Usage(e.to_string()))?;
    let same = |input: &&&Path| match (input.canonicalize(), overlay.canonicalize()) {
        (Ok(input), Ok(overlay)) => input == overlay,
        _ => false,
    };
    if inputs.iter().any(|input| same(&input)) {
        return Err(Usage(format!("{}: the overlay would overwrite an input", overlay.display())).into());
    }
    Ok(())
}
