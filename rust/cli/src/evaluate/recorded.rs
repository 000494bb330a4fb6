//! Recordings with known truth, decoded and judged: from folders, or made by the renderer without one.

use super::score::{BoxScore, FaceScore, RecordingScore};
use crate::input::{Usage, box_frames, lit_faces, read_recorded};
use boxline::{
    Calibration, Error, ErrorKind, Frame, Method, Settings, StageTimes, measure_box, measure_face,
};
use boxline_proto::json::{RecordedFrame, Recording, Truth, TruthFace, read_recording, read_truth};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What there is to measure in folders.
#[derive(Default)]
pub struct Listed {
    pub recordings: Vec<(Recording, Truth)>,
    /// Those that cannot be read, by name.
    pub broken: Vec<(String, Error)>,
}

impl Listed {
    /// Adds the recording in a folder, or those in the folders inside it.
    pub fn add(&mut self, folder: &Path) -> anyhow::Result<()> {
        if folder.join("recording.json").is_file() {
            if !folder.join("truth.json").is_file() {
                let text = format!(
                    "{}: no such file; there is nothing to compare with",
                    folder.join("truth.json").display()
                );
                return Err(Error::new(ErrorKind::Io, text).into());
            }
            self.add_one(folder, false);
            return Ok(());
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
        let before = self.recordings.len() + self.broken.len();
        inside.iter().for_each(|path| self.add_one(path, true));
        if self.recordings.len() + self.broken.len() == before {
            let text = format!("{}: no recording with recording.json and truth.json in it", folder.display());
            return Err(Usage(text).into());
        }
        Ok(())
    }

    fn add_one(&mut self, folder: &Path, only_boxes: bool) {
        let both = read_recording(folder).and_then(|recording| Ok((recording, read_truth(folder)?)));
        match both {
            // A calibration set has truth too, but no faces of boxes.
            Ok((recording, _)) if only_boxes && lit_faces(&recording).is_empty() => {}
            Ok((recording, truth)) => self.recordings.extend(truth.map(|truth| (recording, truth))),
            Err(e) => self.broken.push((long_name(folder), e)),
        }
    }
}

/// The recordings of a folder; the first that cannot be read is an error.
pub fn recordings_in(folder: &Path) -> anyhow::Result<Vec<(Recording, Truth)>> {
    let mut listed = Listed::default();
    listed.add(folder)?;
    match listed.broken.into_iter().next() {
        Some((_, error)) => Err(error.into()),
        None => Ok(listed.recordings),
    }
}

/// The name of a recording with that of the folder it is in: `data/b02`.
pub fn long_name(folder: &Path) -> String {
    let whole = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let last = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    match whole.parent().map(last).filter(|name| !name.is_empty()) {
        Some(parent) => format!("{parent}/{}", last(&whole)),
        None => last(&whole),
    }
}

/// The decoded frames of a recording, each with its truth.
pub struct Recorded {
    pub name: String,
    pub must_refuse: bool,
    /// Judged as one box; otherwise every frame by itself.
    pub true_box_mm: Option<[f64; 3]>,
    pub frames: Vec<(RecordedFrame, TruthFace, Frame)>,
    decode_nanos: u64,
}

impl Recorded {
    /// Reads the frames from their files, with the views with the lasers off if they are wanted.
    pub fn read(recording: &Recording, truth: &Truth, with_off: bool) -> Result<Self, Error> {
        Self::decode(recording, truth, |frame| read_recorded(recording, frame, with_off))
    }

    /// Takes the frames from where `read` finds them.
    pub fn decode(
        recording: &Recording,
        truth: &Truth,
        read: impl Fn(&RecordedFrame) -> Result<Frame, Error>,
    ) -> Result<Self, Error> {
        let true_box_mm = if truth.must_refuse { None } else { truth.box_mm };
        let used = if true_box_mm.is_some() { box_frames(recording)? } else { lit_faces(recording) };
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
            frames.push((frame.clone(), true_face.clone(), read(frame)?));
            decode_nanos += u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX);
        }
        let folder = recording.folder.as_path();
        let name = folder.file_name().unwrap_or(folder.as_os_str()).to_string_lossy().into_owned();
        Ok(Self { name, must_refuse: truth.must_refuse, true_box_mm, frames, decode_nanos })
    }

    /// Keeps the first faces of a box.
    pub fn with_faces(mut self, most: u8) -> Self {
        if self.true_box_mm.is_some() {
            self.frames.truncate(usize::from(most));
        }
        self
    }

    /// Measures and compares.
    pub fn judge(
        &self,
        calibration: &Calibration,
        settings: &Settings,
        method: Method,
    ) -> Result<RecordingScore, Error> {
        let mut stages = vec![("decode".to_owned(), self.decode_nanos)];
        let mut cuboid = None;
        let mut faces = Vec::new();
        if let Some(truth_mm) = self.true_box_mm {
            let frames: Vec<&Frame> = self.frames.iter().map(|(_, _, frame)| frame).collect();
            let report = measure_box(&frames, calibration, settings).map_err(|e| e.in_context(&self.name))?;
            add_times(&mut stages, &report.times);
            for (face, (_, true_face, _)) in report.faces.into_iter().zip(&self.frames) {
                faces.push(FaceScore::new(true_face, false, face));
            }
            cuboid = Some(BoxScore {
                truth_mm,
                outcome: report.outcome,
                two_are_right: all_same_sides(&self.frames),
                confidence: report.confidence,
                likeliest: report.likeliest.first().copied(),
                warnings: report.warnings,
            });
        } else {
            for (recorded, true_face, frame) in &self.frames {
                let report = measure_face(frame, calibration, settings)
                    .map_err(|e| e.in_context(recorded.file.display()))?;
                add_times(&mut stages, &report.times);
                faces.push(FaceScore::new(true_face, self.must_refuse, report.outcome));
            }
        }
        Ok(RecordingScore { name: self.name.clone(), method, cuboid, faces, stages })
    }
}

/// Adds times of stages, those of the first stages first.
fn add_times(stages: &mut Vec<(String, u64)>, times: &StageTimes) {
    for &(stage, nanos) in times {
        match stages.iter_mut().find(|(name, _)| name == stage) {
            Some((_, sum)) => *sum += nanos,
            None => stages.push((stage.to_owned(), nanos)),
        }
    }
}

/// Do all faces have the same two lengths? Then no measurement of theirs tells the box.
fn all_same_sides(frames: &[(RecordedFrame, TruthFace, Frame)]) -> bool {
    frames.windows(2).all(|two| same_sides(&two[0].1, &two[1].1))
}

/// Have two faces the same two lengths, within what no measurement could tell apart from one box side?
fn same_sides(a: &TruthFace, b: &TruthFace) -> bool {
    a.size_mm.zip(b.size_mm).is_some_and(|(a, b)| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 0.01 * a))
}
