//! `boxline verify`: a calibration against one known length.

use crate::Finished;
use crate::input::{box_frames, lit_faces, read_recorded};
use boxline::{Error, ErrorKind, Estimate, FaceOutcome, Frame, Outcome, Settings, measure_box, measure_face};
use boxline_calib::uncertainty::{side_sigma_mm, usual_distance_mm};
use boxline_edgenet::{EdgeNet, Options};
use boxline_proto::json::{read_calibration, read_recording};
use clap::Args as ClapArgs;
use serde_json::json;
use std::path::PathBuf;

const IN: u8 = 0;
const OUT: u8 = 3;
/// In, if the known length lies within so many standard deviations.
const LIMIT_SIGMAS: f64 = 3.0;

#[derive(ClapArgs)]
pub struct VerifyArgs {
    /// A recording of a box with one known side
    #[arg(value_name = "FOLDER")]
    pub folder: PathBuf,
    /// The calibration to check
    #[arg(long, value_name = "FILE")]
    pub calibration: PathBuf,
    /// The known length of the nearest side, mm
    #[arg(long, value_name = "MM", value_parser = positive)]
    pub length: f64,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// A positive number of mm.
pub fn positive(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|x: &f64| x.is_finite() && *x > 0.0)
        .ok_or("a positive number of mm is needed".to_owned())
}

/// Runs `boxline verify`.
pub fn verify(args: &VerifyArgs) -> anyhow::Result<Finished> {
    let recording = read_recording(&args.folder)?;
    let calibration = read_calibration(&args.calibration)?;
    let network = EdgeNet::embedded(&Options::default())?;
    let settings = Settings { network: Some(&network), ..Settings::default() };
    let mut sides: Vec<Estimate> = Vec::new();
    let mut why = String::new();
    if let Ok(recorded) = box_frames(&recording) {
        let frames = recorded
            .iter()
            .map(|frame| read_recorded(&recording, frame, true))
            .collect::<Result<Vec<_>, _>>()?;
        let frames: Vec<&Frame> = frames.iter().collect();
        let named = |e: Error| e.in_context(recording.folder.display());
        let report = measure_box(&frames, &calibration, &settings).map_err(named)?;
        match &report.outcome {
            Outcome::Measured(found) => sides.extend([found.length, found.width, found.height]),
            Outcome::Ambiguous(both) => sides.extend(both.iter().flat_map(|b| [b.length, b.width, b.height])),
            Outcome::Rejected(reject) => why = reject.to_string(),
        }
    } else {
        let faces = lit_faces(&recording);
        if faces.is_empty() {
            let text = "no frame of a face with the lasers on, which is needed";
            let name = recording.folder.join("recording.json");
            return Err(Error::new(ErrorKind::InvalidFile, text).in_context(name.display()).into());
        }
        for recorded in faces {
            let frame = read_recorded(&recording, recorded, true)?;
            let named = |e: Error| e.in_context(recorded.file.display());
            match measure_face(&frame, &calibration, &settings).map_err(named)?.outcome {
                FaceOutcome::Measured(face) => sides.extend([face.length, face.width]),
                FaceOutcome::Rejected(reject) => why = reject.to_string(),
            }
        }
    }
    let off = |e: &Estimate| (e.value_mm - args.length).abs();
    let sides_mm: Vec<f64> = sides.iter().map(|side| side.value_mm).collect();
    let Some(side) = sides.into_iter().min_by(|a, b| off(a).total_cmp(&off(b))) else {
        let stdout = if args.json {
            json!({"outcome": "rejected", "reject": {"reason": "not_measured", "text": why}}).to_string()
        } else {
            format!("not verified: the object could not be measured: {why}")
        };
        return Ok(Finished { stdout, exit_code: OUT });
    };
    // What the calibration says of itself comes on top of what the measurement says.
    let own = calibration.covariance().and_then(|covariance| {
        let distance_mm = usual_distance_mm(args.length);
        side_sigma_mm(calibration.camera(), calibration.lasers(), covariance, args.length, distance_mm)
    });
    let sigma_mm = side.sigma_mm.hypot(own.unwrap_or(0.0));
    let error_mm = side.value_mm - args.length;
    let verdict = if error_mm.abs() <= LIMIT_SIGMAS * sigma_mm { "in" } else { "out" };
    let stdout = if args.json {
        json!({"outcome": verdict, "measured_mm": side.value_mm, "known_mm": args.length, "error_mm": error_mm, "sides_mm": sides_mm,
               "sigma_mm": sigma_mm, "calibration_sigma_mm": own, "limit_sigmas": LIMIT_SIGMAS})
        .to_string()
    } else {
        let all: Vec<String> = sides_mm.iter().map(|mm| format!("{mm:.1}")).collect();
        format!(
            "{verdict}: measured {:.2} ± {sigma_mm:.2} mm, known {:.2} mm: off by {error_mm:+.2} mm, {:.2} mm ({LIMIT_SIGMAS} sigmas) are allowed\n\
             (the nearest of the sides {} mm: is it the one that is known?){}",
            side.value_mm,
            args.length,
            LIMIT_SIGMAS * sigma_mm,
            all.join(", "),
            if own.is_none() {
                "\n(the calibration has no covariance: its own share of ± is not counted)"
            } else {
                ""
            }
        )
    };
    Ok(Finished { stdout, exit_code: if verdict == "in" { IN } else { OUT } })
}
