//! `boxline evaluate`: measures recordings whose truth is known and says how far off the results are.

#[cfg(feature = "render")]
mod experiments;
#[cfg(feature = "render")]
mod maps;
#[cfg(feature = "render")]
mod perturb;
mod score;
#[cfg(feature = "render")]
mod shots;
#[cfg(feature = "render")]
mod simulated;
mod tables;

use crate::Finished;
use crate::args::EvaluateArgs;
use crate::input::{Usage, lit_faces, pair, read_frame};
use boxline::{
    Calibration, Error, ErrorKind, Frame, Method, Network, Settings, StageTimes, measure_box, measure_face,
};
use boxline_proto::json::{
    RecordedFrame, Recording, Truth, TruthFace, read_calibration, read_recording, read_truth,
};
use indicatif::{ProgressBar, ProgressStyle};
use score::{BoxScore, FaceScore, RecordingScore};
use std::path::{Path, PathBuf};
use std::time::Instant;
pub use tables::table;

/// Runs `boxline evaluate`.
pub fn evaluate(args: &EvaluateArgs) -> anyhow::Result<Finished> {
    if args.experiments || args.simulate.is_some() || args.perturb || args.edges == Some(None) {
        return rendered(args);
    }
    let edges = args.edges.flatten().unwrap_or_default();
    if args.folders.is_empty() {
        return Err(
            Usage("a folder with recording.json and truth.json is needed, or --edges alone".into()).into()
        );
    }
    let mut recordings = Vec::new();
    for folder in &args.folders {
        recordings.extend(recordings_in(folder)?);
    }
    let override_calibration = args.calibration.as_deref().map(read_calibration).transpose()?;
    let methods = args.method.methods();
    let network = args.network.load(edges)?;
    let network = network.as_ref().map(|n| n as &dyn Network);

    // Drawn on standard error, and only on a terminal.
    let progress = ProgressBar::new((recordings.len() * methods.len()) as u64)
        .with_style(ProgressStyle::with_template("{bar:30} {pos}/{len} {msg}")?);
    let mut scores = Vec::new();
    for (recording, truth) in &recordings {
        let calibration = match &override_calibration {
            Some(calibration) => calibration.clone(),
            None => read_calibration(&recording.calibration_file)?,
        };
        let recorded = Recorded::read(recording, truth)?;
        for &method in methods {
            progress.set_message(recorded.name.clone());
            let settings = Settings { method, edges: edges.into(), network, ..Settings::default() };
            scores.push(recorded.judge(&calibration, &settings, method)?);
            progress.inc(1);
        }
    }
    progress.finish_and_clear();

    let stdout = if args.json { tables::json(&scores).to_string() } else { tables::text(&scores, methods) };
    Ok(Finished { stdout, exit_code: 0 })
}

/// What needs the renderer.
#[cfg(feature = "render")]
fn rendered(args: &EvaluateArgs) -> anyhow::Result<Finished> {
    match (&args.out, args.simulate) {
        (Some(page), _) if args.experiments => experiments::evaluate(args, page),
        (_, Some(boxes)) => simulated::evaluate(args, boxes),
        _ if args.perturb => perturb::evaluate(args),
        _ => maps::evaluate(args),
    }
}

#[cfg(not(feature = "render"))]
fn rendered(_: &EvaluateArgs) -> anyhow::Result<Finished> {
    let text = "--edges without a name, --simulate, --perturb and --experiments need the renderer, which this program was built without";
    Err(Usage(text.into()).into())
}

/// The recording in a folder, or those in the folders inside it.
fn recordings_in(folder: &Path) -> anyhow::Result<Vec<(Recording, Truth)>> {
    if folder.join("recording.json").is_file() {
        return match read_truth(folder)? {
            Some(truth) => Ok(vec![(read_recording(folder)?, truth)]),
            None => Err(Error::new(
                ErrorKind::Io,
                format!(
                    "{}: no such file; there is nothing to compare with",
                    folder.join("truth.json").display()
                ),
            )
            .into()),
        };
    }
    let failed = |e: std::io::Error| {
        Error::new(ErrorKind::Io, format!("{}: cannot read: {e}", folder.display())).with_source(e)
    };
    let mut inside = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path: PathBuf = entry.map_err(failed)?.path();
        if path.join("recording.json").is_file() && path.join("truth.json").is_file() {
            inside.push(path);
        }
    }
    inside.sort();
    let mut found = Vec::new();
    for path in inside {
        let recording = read_recording(&path)?;
        // A calibration set has truth too, but no faces of boxes.
        if !lit_faces(&recording).is_empty()
            && let Some(truth) = read_truth(&path)?
        {
            found.push((recording, truth));
        }
    }
    if found.is_empty() {
        let text = format!("{}: no recording with recording.json and truth.json in it", folder.display());
        return Err(Usage(text).into());
    }
    Ok(found)
}

/// The decoded frames of a recording, each with its truth.
struct Recorded<'a> {
    name: String,
    truth: &'a Truth,
    /// Judged as one box; otherwise every frame by itself.
    true_box_mm: Option<[f64; 3]>,
    frames: Vec<(&'a RecordedFrame, &'a TruthFace, Frame)>,
    decode_nanos: u64,
}

impl<'a> Recorded<'a> {
    fn read(recording: &'a Recording, truth: &'a Truth) -> Result<Self, Error> {
        let true_box_mm = if truth.must_refuse { None } else { truth.box_mm };
        let used = if true_box_mm.is_some() { pair(recording)?.to_vec() } else { lit_faces(recording) };
        let mut frames = Vec::new();
        let mut decode_nanos = 0;
        for frame in used {
            let true_face = truth.faces.iter().find(|face| face.frame == frame.id).ok_or_else(|| {
                let file = recording.folder.join("truth.json");
                Error::new(
                    ErrorKind::InvalidFile,
                    format!("{}: faces: none for frame {:?} of the recording", file.display(), frame.id),
                )
            })?;
            let start = Instant::now();
            frames.push((frame, true_face, read_frame(&frame.file)?));
            decode_nanos += u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX);
        }
        let folder = recording.folder.as_path();
        let name = folder.file_name().unwrap_or(folder.as_os_str()).to_string_lossy().into_owned();
        Ok(Self { name, truth, true_box_mm, frames, decode_nanos })
    }

    fn judge(
        &self,
        calibration: &Calibration,
        settings: &Settings,
        method: Method,
    ) -> Result<RecordingScore, Error> {
        let mut times = StageTimes::new();
        let mut cuboid = None;
        let mut faces = Vec::new();
        if let (Some(truth_mm), [a, b]) = (self.true_box_mm, &self.frames[..]) {
            let report = measure_box(&a.2, &b.2, calibration, settings, &mut times)
                .map_err(|e| e.in_context(&self.name))?;
            for (face, (_, true_face, _)) in report.faces.into_iter().zip([a, b]) {
                faces.push(FaceScore::new(true_face, false, face));
            }
            let two_are_right = same_sides(a.1, b.1);
            cuboid = Some(BoxScore { truth_mm, outcome: report.outcome, two_are_right });
        } else {
            for (recorded, true_face, frame) in &self.frames {
                let face = measure_face(frame, calibration, settings, &mut times)
                    .map_err(|e| e.in_context(recorded.file.display()))?;
                faces.push(FaceScore::new(true_face, self.truth.must_refuse, face));
            }
        }
        Ok(RecordingScore { name: self.name.clone(), method, cuboid, faces, stages: self.stages(&times) })
    }

    /// The time of each stage over all frames, decoding first.
    fn stages(&self, times: &StageTimes) -> Vec<(String, u64)> {
        let mut stages = vec![("decode".to_owned(), self.decode_nanos)];
        for &(stage, nanos) in times {
            match stages.iter_mut().find(|(name, _)| name == stage) {
                Some((_, sum)) => *sum += nanos,
                None => stages.push((stage.to_owned(), nanos)),
            }
        }
        stages
    }
}

/// Do two faces have the same two lengths, within what no measurement could tell apart from one box side?
fn same_sides(a: &TruthFace, b: &TruthFace) -> bool {
    a.size_mm.zip(b.size_mm).is_some_and(|(a, b)| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 0.01 * a))
}
