//! `boxline drift`: from many measurements of ordinary boxes, whether the lasers have moved since the calibration, and how.

use crate::Finished;
use crate::args::MeasureOptions;
use crate::input::{Usage, lit_faces, own_name, read_frame, sha256};
use crate::output::check_outputs;
use crate::say::say;
use anyhow::Context;
use boxline::{Calibration, Error, ErrorKind, FaceMeasurement, FaceOutcome, LaserId, measure_face};
use boxline_calib::drift::{Direction, DirectionKind, Drift, LaserMotion, ObservedFace, estimate_drift};
use boxline_proto::json::{Recording, calibration_json, read_calibration, read_recording, write_json};
use clap::{Args as ClapArgs, ValueEnum};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const DONE: u8 = 0;
const MOVED: u8 = 3;
/// A side is the known one if it is within this share of it: more is no laser that moved but another side.
const SAME_SHARE: f64 = 0.03;
/// chi^2 of a face (8 degrees of freedom) beyond which it is named: the 99.9 % quantile.
const ODD_FACE: f64 = 26.1;

#[derive(ClapArgs)]
pub struct DriftArgs {
    /// Recordings of boxes, unknown ones too; all of one head
    #[arg(required = true, value_name = "FOLDER")]
    pub folders: Vec<PathBuf>,
    /// The calibration to judge; without it the one that the first recording names
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// A known side of the first recording's box, mm: settles the scale
    #[arg(long, value_name = "MM", value_parser = crate::verify::positive)]
    pub length: Option<f64>,
    /// Which side is known, if two are alike
    #[arg(long, value_enum, requires = "length")]
    pub side: Option<Side>,
    /// Write the calibration with the lasers where the boxes see them
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    #[command(flatten)]
    pub measuring: MeasureOptions,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// A side of a face.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Side {
    /// The longer side of its face
    Length,
    /// The shorter side of its face
    Width,
}

/// A face that was measured, or why not.
struct FaceResult {
    name: String,
    face: Result<ObservedFace, String>,
}

/// Runs `boxline drift`.
pub fn drift(args: &DriftArgs) -> anyhow::Result<Finished> {
    let recordings: Vec<_> =
        args.folders.iter().map(|folder| read_recording(folder)).collect::<Result<_, _>>()?;
    let file = args.calibration.clone().unwrap_or_else(|| recordings[0].calibration_file.clone());
    if let Some(output) = &args.output {
        let own = |recording: &Recording| recording.folder.join("recording.json");
        let of_recordings = recordings
            .iter()
            .flat_map(|recording| recording.frames.iter().map(|f| f.file.clone()).chain([own(recording)]));
        let inputs: Vec<PathBuf> = of_recordings.chain([file.clone()]).collect();
        check_outputs(&[output], inputs.iter().map(PathBuf::as_path))?;
    }
    let calibration = read_calibration(&file)?;
    let network = args.measuring.network.load(args.measuring.edges)?;
    let settings = args.measuring.settings(None, network.as_ref());
    let mut seen: Vec<FaceResult> = Vec::new();
    let mut ruled = 0;
    // A frame says what it says once: given twice, it would halve the variance of nothing new.
    let mut names: BTreeMap<String, String> = BTreeMap::new();
    for (index, recording) in recordings.iter().enumerate() {
        if recording.serial != calibration.serial() {
            say(&format!(
                "warning: {} is of head {}, the calibration of head {}",
                recording.folder.display(),
                recording.serial,
                calibration.serial()
            ));
        }
        let folder = own_name(&recording.folder);
        for recorded in lit_faces(recording) {
            let name = format!("{folder}/{}", recorded.id);
            let hash = sha256(&recorded.file)
                .with_context(|| format!("{}: cannot read", recorded.file.display()))?;
            if let Some(earlier) = names.get(&hash) {
                let face = Err(format!("the same frame as {earlier}"));
                seen.push(FaceResult { name, face });
                continue;
            }
            names.insert(hash, name.clone());
            let frame = read_frame(&recorded.file)?;
            let report = measure_face(&frame, &calibration, &settings)
                .map_err(|e| e.in_context(recorded.file.display()))?;
            let face = match &report.outcome {
                FaceOutcome::Measured(measured) => ObservedFace::new(&calibration, measured)
                    .map(|face| match args.length.filter(|_| index == 0) {
                        Some(known_mm) => with_known(face, measured, known_mm, args.side, &mut ruled),
                        None => face,
                    })
                    .ok_or_else(|| "too few points on a side or stripe".to_owned()),
                FaceOutcome::Rejected(reject) => Err(reject.to_string()),
            };
            seen.push(FaceResult { name, face });
        }
    }
    if let (Some(known_mm), 0) = (args.length, ruled) {
        let folder = args.folders[0].display();
        let text = format!("{folder}: no measured side is within 3 % of {known_mm} mm");
        return Err(Usage(text).into());
    }
    let faces: Vec<ObservedFace> = seen.iter().filter_map(|s| s.face.as_ref().ok().cloned()).collect();
    let drift = estimate_drift(&calibration, &faces).map_err(|e| match e.kind() {
        ErrorKind::InvalidFrame => anyhow::Error::from(Usage(too_few(&e, &seen))),
        _ => e.into(),
    })?;
    if let Some(output) = &args.output {
        write_json(output, &proposed(&calibration, &drift)?)?;
    }
    let stdout = if args.json {
        drift_json(&drift, &seen, &calibration).to_string()
    } else {
        text(&drift, &seen, &calibration, args.output.as_deref())
    };
    Ok(Finished { stdout, exit_code: if drift.test.significant() { MOVED } else { DONE } })
}

/// What is told where too few faces are left, and why the others are not among them.
fn too_few(e: &Error, seen: &[FaceResult]) -> String {
    let why = seen.iter().filter_map(|s| Some(format!("\n  {}: {}", s.name, s.face.as_ref().err()?)));
    let why: String = why.collect();
    if why.is_empty() {
        return e.to_string();
    }
    format!("{e}; faces left out (a laser that turned by 0.35 mrad makes most be refused):{why}")
}

/// The face with its side that is nearest to the known length, if one is near enough.
fn with_known(
    face: ObservedFace,
    measured: &FaceMeasurement,
    known_mm: f64,
    side: Option<Side>,
    ruled: &mut usize,
) -> ObservedFace {
    let off = [measured.length, measured.width].map(|e| (e.value_mm / known_mm - 1.0).abs());
    let nearest = match side {
        Some(Side::Length) => 0,
        Some(Side::Width) => 1,
        None => usize::from(off[1] < off[0]),
    };
    if off[nearest] > SAME_SHARE {
        return face;
    }
    *ruled += 1;
    face.with_known(nearest, known_mm)
}

fn proposed(calibration: &Calibration, drift: &Drift) -> anyhow::Result<Value> {
    let updated = drift.apply(calibration)?;
    let mut value = calibration_json(&updated);
    value["provenance"] = json!({
        "program": concat!("boxline drift ", env!("CARGO_PKG_VERSION")),
        "faces": drift.face_chi_squares.iter().flatten().count(),
        "p_value": drift.test.p_value,
        "lasers": lasers_json(drift),
    });
    Ok(value)
}

fn lasers_json(drift: &Drift) -> Value {
    let motion =
        |m: &LaserMotion| json!({"tilt_rad": m.tilt_rad, "twist_rad": m.twist_rad, "shift_mm": m.shift_mm});
    let laser = |(change, sigma): &(LaserMotion, LaserMotion)| json!({"change": motion(change), "sigma": motion(sigma)});
    drift.lasers.iter().map(laser).collect::<Vec<_>>().into()
}

fn drift_json(drift: &Drift, seen: &[FaceResult], calibration: &Calibration) -> Value {
    let mut chi_squares = drift.face_chi_squares.iter();
    let faces: Vec<Value> = seen
        .iter()
        .map(|s| match &s.face {
            Ok(_) => {
                json!({"frame": s.name, "chi_square": chi_squares.next().copied().flatten(), "why_not": null})
            }
            Err(why) => json!({"frame": s.name, "chi_square": null, "why_not": why}),
        })
        .collect();
    let direction = |d: &Direction| {
        json!({
            "kind": d.kind.text(), "share": d.share, "observable": d.observable(), "eigenvalue": d.eigenvalue,
            "turn_sigma_rad": d.turn_sigma_rad(), "scale_sigma": d.scale_sigma,
        })
    };
    json!({
        "outcome": if drift.test.significant() { "moved" } else { "unchanged" },
        "chi_square": drift.test.chi_square,
        "degrees_of_freedom": drift.test.degrees_of_freedom,
        "p_value": drift.test.p_value,
        "variance_factor": drift.variance_factor,
        "calibration_has_covariance": calibration.covariance().is_some(),
        "lasers": lasers_json(drift),
        "directions": drift.directions.iter().map(direction).collect::<Vec<_>>(),
        "faces": faces,
    })
}

fn text(drift: &Drift, seen: &[FaceResult], calibration: &Calibration, output: Option<&Path>) -> String {
    let mut lines = Vec::new();
    let used = drift.face_chi_squares.iter().flatten().count();
    lines.push(format!("{used} of {} faces used", seen.len()));
    let mut chi_squares = drift.face_chi_squares.iter();
    for s in seen {
        match &s.face {
            Err(why) => lines.push(format!("left out   {}: {why}", s.name)),
            Ok(_) => match chi_squares.next().copied().flatten() {
                None => lines.push(format!("left out   {}: no rectangle fits its lines", s.name)),
                Some(odd) if odd > ODD_FACE * drift.variance_factor => lines.push(format!(
                    "odd        {}: chi-square {odd:.0} of 8, it counts less (a bulge, a flap, a wrong edge)",
                    s.name
                )),
                Some(_) => {}
            },
        }
    }
    lines.push(String::new());
    lines.push("laser      tilt, mrad          twist, mrad         shift, mm".to_owned());
    for (id, (change, sigma)) in LaserId::ALL.iter().zip(&drift.lasers) {
        lines.push(format!(
            "{id}          {:+.3} ± {:<10.3} {:+.3} ± {:<10.3} {:+.3} ± {:.3}",
            change.tilt_rad * 1e3,
            sigma.tilt_rad * 1e3,
            change.twist_rad * 1e3,
            sigma.twist_rad * 1e3,
            change.shift_mm,
            sigma.shift_mm
        ));
    }
    lines.push(String::new());
    for kind in [DirectionKind::Stripes, DirectionKind::Depth, DirectionKind::Scale] {
        lines.extend(directions_line(drift, kind));
    }
    lines.push(String::new());
    let test = &drift.test;
    lines.push(format!(
        "{}: chi-square {:.1} with {} degrees of freedom, p = {:.2e} (1 % is the limit)",
        if test.significant() { "MOVED" } else { "no significant change" },
        test.chi_square,
        test.degrees_of_freedom,
        test.p_value
    ));
    if drift.variance_factor > 1.0 {
        lines.push(format!(
            "residuals are {:.2} times what was expected: all ± are larger by it",
            drift.variance_factor.sqrt()
        ));
    }
    if calibration.covariance().is_none() {
        lines.push("the calibration has no covariance: it is taken as exact".to_owned());
    }
    match output {
        Some(path) => lines.push(format!("proposed   {}", path.display())),
        None if test.significant() => {
            lines.push("-o FILE writes the calibration that the boxes propose".to_owned())
        }
        None => {}
    }
    lines.push("(± is one standard deviation)".to_owned());
    lines.join("\n")
}

/// What the faces tell of one kind of change, in words.
fn directions_line(drift: &Drift, kind: DirectionKind) -> Option<String> {
    let of_kind: Vec<&Direction> = drift.directions.iter().filter(|d| d.kind == kind).collect();
    if of_kind.is_empty() {
        return None;
    }
    let observable: Vec<&&Direction> = of_kind.iter().filter(|d| d.observable()).collect();
    let name = kind.text();
    if kind == DirectionKind::Scale {
        return Some(match observable.first() {
            Some(d) => format!("{name}: observable, ± {:.3} %", d.scale_sigma * 100.0),
            None => format!("{name}: not observable ({}); kept as it is", kind.needs()),
        });
    }
    let sigma = |d: &&&Direction| d.turn_sigma_rad() * 1e3;
    let (best, worst) =
        observable.iter().map(sigma).fold((f64::INFINITY, 0.0f64), |(b, w), s| (b.min(s), w.max(s)));
    let range =
        if observable.is_empty() { String::new() } else { format!(", ± {best:.4} to {worst:.4} mrad") };
    let more = if observable.len() < of_kind.len() {
        format!("; the rest needs {}", kind.needs())
    } else {
        String::new()
    };
    Some(format!("{name}: {} of {} directions observable{range}{more}", observable.len(), of_kind.len()))
}
