//! The file of a scored run: a line that says how it was made, then one row a side (CSV). Rows are added as recordings finish, and a
//! second run goes on where the first stopped.
//!
//! | Column | Holds |
//! |---|---|
//! | `box`, `seed` | the recording: `folder/name`, or kind and seed of a rendered one |
//! | `frames` | the frames it was measured in, with a space between |
//! | `row`, `rows` | number of the row in its recording, and how many it has |
//! | `due`, `due_reason` | `measure` or `refuse`, and why |
//! | `outcome`, `reason` | `measured`, `refused` and why, or `ambiguous` (two boxes possible): `same_lengths` if both faces have the same two, else `undecided` |
//! | `confidence` | stated probability of the result; of a refused box, of its likeliest candidate |
//! | `side`, `truth_mm` | `length`, `width` or `height`, and the true one |
//! | `value_mm`, `sigma_mm`, `error_mm` | as measured; of two possible boxes the one nearer to the truth; empty if refused |
//! | `candidate_mm`, `candidate_sigma_mm` | of a refused box, its likeliest candidate, if there is one |
//! | `wrong` | a result whose side is off by more than 5 mm, or by more than 3 mm and 4 sigma; every side of a result where a refusal was due |
//! | `cause` | why, of a wrong box: `print`, `neighbour`, `occluder`, `fan_end`, `rounding`, `other` |
//! | `size_class` | of the true side |
//! | `free` | no other box touches this one |
//! | `hazards`, `ambient` | what makes it hard, the light |
//! | `distance_mm`, `angle_deg` | the largest of its frames: to the face's middle, and off its normal |
//! | `warnings` | kinds of checks that failed |
//! | `seconds` | time of the measurement |
//!
//! A refused box has as many rows as a measured one, so that its sides and its class are known.

use super::cause::{self, Cause};
use super::recorded::Recorded;
use super::score::{FaceScore, RecordingScore, sides_of};
use crate::input::Usage;
use anyhow::Context;
use boxline::frames::Point;
use boxline::{Calibration, Error, ErrorKind, Estimate, FaceMeasurement, FaceOutcome, Outcome, feasibility};
use boxline_proto::json::{TruthFace, is_wrong_side};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{ErrorKind as IoErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

const FORMAT: &str = "# boxline-evaluate/1 ";
/// A box that is whole in view but farther away than the head is made for: its size is right or wrong, but no result is due.
pub const TOO_FAR: &str = "too_far";
/// Two boxes are possible although the two faces differ, which tells them apart.
pub const UNDECIDED: &str = "undecided";

/// How the boxes of a file were made and measured. Rows that were made otherwise do not go into it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunSettings {
    /// `folders`, or the kind of rendered recordings.
    pub source: String,
    /// Frames of each box that were used at most.
    pub faces: u8,
    /// Of rendered ones: hazards, and the photographs by number and hash.
    pub hazards: Option<String>,
    pub photos: Option<String>,
    /// Serial number of the head whose calibration replaced the recordings' own.
    pub calibration: Option<String>,
    /// Whether views with the lasers off are used where there are any; not in files of older programs.
    #[serde(default)]
    pub off: bool,
    pub method: String,
    pub edges: String,
    /// `embedded`, or the hash of a model file.
    pub network: String,
    /// As on the command line.
    pub least_confidence: String,
    /// Version and fingerprint of the program.
    pub program: String,
}

/// What is right to do with a box.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Expected {
    #[default]
    Measure,
    Refuse,
}

/// What was done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ResultKind {
    #[default]
    Measured,
    Refused,
    Ambiguous,
}

/// One side; the module's table says what the columns hold.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Row {
    #[serde(rename = "box")]
    pub name: String,
    pub seed: Option<u64>,
    pub frames: String,
    pub row: usize,
    pub rows: usize,
    pub due: Expected,
    pub due_reason: String,
    pub outcome: ResultKind,
    pub reason: String,
    pub confidence: Option<f64>,
    pub side: String,
    pub truth_mm: Option<f64>,
    pub value_mm: Option<f64>,
    pub sigma_mm: Option<f64>,
    pub error_mm: Option<f64>,
    pub candidate_mm: Option<f64>,
    pub candidate_sigma_mm: Option<f64>,
    pub wrong: bool,
    pub cause: Option<Cause>,
    pub size_class: String,
    pub free: Option<bool>,
    pub hazards: String,
    pub ambient: String,
    pub distance_mm: Option<f64>,
    pub angle_deg: Option<f64>,
    pub warnings: String,
    pub seconds: f64,
}

/// Upper bounds of the classes of sides, mm, with their names; the last one has none.
pub const SIZE_CLASSES: [(f64, &str); 4] =
    [(200.0, "to 200"), (400.0, "200-400"), (800.0, "400-800"), (f64::INFINITY, "over 800")];

/// The class of a side.
pub fn size_class(truth_mm: f64) -> &'static str {
    SIZE_CLASSES.iter().find(|(most_mm, _)| truth_mm <= *most_mm).map_or("", |(_, name)| name)
}

/// What is measured as one: a box in two frames, or a face in one.
struct Subject<'a> {
    frames: Vec<(&'a str, &'a TruthFace)>,
    faces: Vec<&'a FaceScore>,
    truth_mm: Vec<Option<f64>>,
    outcome: ResultKind,
    reason: &'a str,
    confidence: Option<f64>,
    sides: Vec<Estimate>,
    candidate: Vec<Estimate>,
    warnings: BTreeSet<&'static str>,
}

const SIDE_NAMES: [&str; 3] = ["length", "width", "height"];

/// The rows of a judged recording.
pub fn rows_of(
    name: &str,
    seed: Option<u64>,
    recorded: &Recorded,
    calibration: &Calibration,
    score: &RecordingScore,
) -> Vec<Row> {
    let truths = || recorded.frames.iter().map(|(frame, truth, _)| (frame.id.as_str(), truth));
    let subjects = match &score.cuboid {
        Some(cuboid) => {
            let measurement = cuboid.measurement();
            vec![Subject {
                frames: truths().collect(),
                faces: score.faces.iter().collect(),
                truth_mm: cuboid.truth_mm.map(Some).to_vec(),
                outcome: match &cuboid.outcome {
                    Outcome::Measured(_) => ResultKind::Measured,
                    Outcome::Ambiguous(_) => ResultKind::Ambiguous,
                    Outcome::Rejected(_) => ResultKind::Refused,
                },
                reason: match &cuboid.outcome {
                    Outcome::Ambiguous(_) if cuboid.two_are_right => "same_lengths",
                    Outcome::Ambiguous(_) => UNDECIDED,
                    _ => cuboid.reason().unwrap_or_default(),
                },
                confidence: cuboid.confidence.or(cuboid.likeliest.map(|l| l.confidence)),
                sides: measurement.map_or_else(Vec::new, |m| sides_of(&m).to_vec()),
                candidate: cuboid.likeliest.map_or_else(Vec::new, |l| sides_of(&l.sides).to_vec()),
                warnings: cuboid.warnings.iter().map(|w| w.kind.name()).collect(),
            }]
        }
        None => truths().zip(&score.faces).map(|(frame, face)| Subject::of_face(frame, face)).collect(),
    };
    let nanos: u64 = score.stages.iter().map(|(_, nanos)| nanos).sum();
    let seconds = nanos as f64 * 1e-9 / subjects.len().max(1) as f64;
    let mut rows: Vec<Row> =
        subjects.iter().flat_map(|subject| subject.rows(recorded.must_refuse, calibration)).collect();
    let count = rows.len();
    for (index, row) in rows.iter_mut().enumerate() {
        *row = Row {
            name: name.to_owned(),
            seed,
            row: index + 1,
            rows: count,
            seconds: round(seconds, 3),
            ..std::mem::take(row)
        };
    }
    rows
}

impl<'a> Subject<'a> {
    fn of_face(frame: (&'a str, &'a TruthFace), face: &'a FaceScore) -> Self {
        let confidence = match &face.outcome {
            FaceOutcome::Measured(m) => m.confidence,
            FaceOutcome::Rejected(_) => None,
        };
        Self {
            frames: vec![frame],
            faces: vec![face],
            truth_mm: face.truth_mm.map_or(vec![None; 2], |mm| mm.map(Some).to_vec()),
            outcome: if face.sides().is_some() { ResultKind::Measured } else { ResultKind::Refused },
            reason: face.reason().unwrap_or_default(),
            confidence,
            sides: face.sides().map_or_else(Vec::new, |sides| sides.to_vec()),
            candidate: Vec::new(),
            warnings: BTreeSet::new(),
        }
    }

    fn measured(&self) -> impl Iterator<Item = (&'a TruthFace, &'a FaceMeasurement)> {
        self.frames.iter().zip(&self.faces).filter_map(|((_, truth), face)| match &face.outcome {
            FaceOutcome::Measured(found) => Some((*truth, &**found)),
            FaceOutcome::Rejected(_) => None,
        })
    }

    fn due(&self, must_refuse: bool, calibration: &Calibration) -> (Expected, String) {
        let too_far = |face: &TruthFace| {
            let corners = face.corners_cam_mm?.map(|[x, y, z]| Point::new(x, y, z));
            feasibility::too_far(calibration, corners)
        };
        let mut faces = self.frames.iter().map(|(_, face)| *face);
        if let Some(why) = faces.clone().find_map(|face| face.refuse.clone()) {
            (Expected::Refuse, why)
        } else if must_refuse || faces.clone().any(|face| face.size_mm.is_none()) {
            (Expected::Refuse, "any".to_owned())
        } else if faces.any(|face| too_far(face).is_some()) {
            (Expected::Refuse, TOO_FAR.to_owned())
        } else {
            (Expected::Measure, String::new())
        }
    }

    fn rows(&self, must_refuse: bool, calibration: &Calibration) -> Vec<Row> {
        let (due, due_reason) = self.due(must_refuse, calibration);
        let refusal_due = due == Expected::Refuse && due_reason != TOO_FAR;
        let answered = self.outcome != ResultKind::Refused;
        let is_wrong = |index: usize| {
            let off =
                self.sides.get(index).zip(self.truth_mm[index]).is_some_and(|(s, mm)| is_wrong_side(*s, mm));
            answered && (refusal_due || off)
        };
        let cause = (0..self.truth_mm.len()).any(is_wrong).then(|| {
            // The words of our truth files and of others.
            if ["face_hidden", "occluded"].contains(&due_reason.as_str()) {
                return Cause::Occluder;
            }
            cause::of_faces(&self.measured().collect::<Vec<_>>(), calibration)
        });
        let notes = || self.frames.iter().map(|(_, face)| &face.notes);
        let largest = |values: &mut dyn Iterator<Item = f64>| values.reduce(f64::max);
        let neighbours: Option<Vec<bool>> =
            notes().map(|n| n.neighbours.as_ref().map(Vec::is_empty)).collect();
        let hazards: BTreeSet<&str> =
            notes().flat_map(|n| n.hazards.iter().flatten().map(String::as_str)).collect();
        let of_faces = self.measured().flat_map(|(_, face)| face.warnings.iter().map(|w| w.kind.name()));
        let warnings: BTreeSet<&str> = self.warnings.iter().copied().chain(of_faces).collect();
        let joined = |words: BTreeSet<&str>| words.into_iter().collect::<Vec<_>>().join(" ");
        let common = Row {
            frames: self.frames.iter().map(|(id, _)| *id).collect::<Vec<_>>().join(" "),
            due,
            due_reason,
            outcome: self.outcome,
            reason: self.reason.to_owned(),
            confidence: self.confidence.map(|c| round(c, 5)),
            cause,
            free: neighbours.map(|free| free.into_iter().all(|free| free)),
            hazards: joined(hazards),
            ambient: self.frames.iter().find_map(|(_, face)| face.ambient.clone()).unwrap_or_default(),
            distance_mm: largest(&mut notes().filter_map(|n| n.distance_mm)).map(|mm| round(mm, 1)),
            angle_deg: largest(&mut notes().filter_map(|n| n.angle_to_normal_deg)).map(|deg| round(deg, 2)),
            warnings: joined(warnings),
            ..Row::default()
        };
        let side = |(index, truth_mm): (usize, &Option<f64>)| {
            let (side, candidate) = (self.sides.get(index), self.candidate.get(index));
            Row {
                side: SIDE_NAMES[index].to_owned(),
                truth_mm: truth_mm.map(|mm| round(mm, 4)),
                value_mm: side.map(|s| round(s.value_mm, 4)),
                sigma_mm: side.map(|s| round(s.sigma_mm, 5)),
                error_mm: side.zip(*truth_mm).map(|(s, mm)| round(s.value_mm - mm, 4)),
                candidate_mm: candidate.map(|s| round(s.value_mm, 4)),
                candidate_sigma_mm: candidate.map(|s| round(s.sigma_mm, 5)),
                wrong: is_wrong(index),
                size_class: truth_mm.map_or("", size_class).to_owned(),
                ..common.clone()
            }
        };
        self.truth_mm.iter().enumerate().map(side).collect()
    }
}

fn round(value: f64, digits: i32) -> f64 {
    let scale = 10f64.powi(digits);
    (value * scale).round() / scale
}

/// The rows of a run, and the file that keeps them.
pub struct Book {
    rows: Vec<Row>,
    done: BTreeSet<String>,
    file: Option<(File, PathBuf)>,
}

impl Book {
    /// Kept nowhere.
    pub fn in_memory() -> Self {
        Self { rows: Vec::new(), done: BTreeSet::new(), file: None }
    }

    /// Opens a file to go on with it, or begins one. What was torn at its end when a run was stopped is dropped. A file that was made
    /// otherwise is refused and left as it is.
    pub fn open(path: &Path, made: &RunSettings) -> anyhow::Result<Self> {
        let failed = || format!("{}: cannot open", path.display());
        let mut options = File::options();
        let mut file =
            options.read(true).write(true).create(true).truncate(false).open(path).with_context(failed)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).with_context(failed)?;
        let head = head_of(made)?;
        let mut rows = Vec::new();
        if head.as_bytes().starts_with(&bytes) {
            file.set_len(0).and_then(|()| file.rewind()).with_context(failed)?;
            file.write_all(head.as_bytes()).with_context(failed)?;
        } else {
            let (found, whole_rows, end) = parse(&bytes, &path.display().to_string())?;
            if found != *made {
                return Err(Usage(format!(
                    "{}: was made otherwise; give another file, or repeat what it was made with:\n  it has {}\n  now    {}",
                    path.display(),
                    serde_json::to_string(&found)?,
                    serde_json::to_string(made)?,
                ))
                .into());
            }
            rows = whole_rows;
            file.set_len(end as u64).and_then(|()| file.seek(SeekFrom::End(0))).with_context(failed)?;
        }
        let done = rows.iter().map(|row| row.name.clone()).collect();
        Ok(Self { rows, done, file: Some((file, path.to_owned())) })
    }

    /// Whether a recording is there.
    pub fn has(&self, name: &str) -> bool {
        self.done.contains(name)
    }

    /// Adds the rows of a recording, and writes them at once.
    pub fn add(&mut self, rows: Vec<Row>) -> anyhow::Result<()> {
        if let Some((file, path)) = &mut self.file {
            let mut writer = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
            rows.iter().try_for_each(|row| writer.serialize(row))?;
            let bytes = writer.into_inner().map_err(|e| std::io::Error::other(e.to_string()))?;
            file.write_all(&bytes).with_context(|| format!("{}: cannot write", path.display()))?;
        }
        self.done.extend(rows.first().map(|row| row.name.clone()));
        self.rows.extend(rows);
        Ok(())
    }

    /// All rows, those of earlier runs too.
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }
}

/// Reads a file that runs have written.
pub fn read(path: &Path) -> anyhow::Result<(RunSettings, Vec<Row>)> {
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == IoErrorKind::NotFound => {
            return Err(Error::new(ErrorKind::Io, format!("{}: no such file", path.display())).into());
        }
        Err(e) => return Err(e).with_context(|| format!("{}: cannot read", path.display())),
    };
    let (made, rows, _) = parse(&bytes, &path.display().to_string())?;
    Ok((made, rows))
}

/// The first two lines.
fn head_of(made: &RunSettings) -> anyhow::Result<String> {
    Ok(format!("{FORMAT}{}\n{}\n", serde_json::to_string(made)?, header()?))
}

/// The names of the columns, as the writer puts them.
fn header() -> anyhow::Result<String> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.serialize(Row::default())?;
    let bytes = writer.into_inner().map_err(|e| std::io::Error::other(e.to_string()))?;
    Ok(String::from_utf8_lossy(&bytes).lines().next().unwrap_or_default().to_owned())
}

/// How it was made, the rows of whole recordings, and where the last of them ends.
fn parse(bytes: &[u8], name: &str) -> anyhow::Result<(RunSettings, Vec<Row>, usize)> {
    let invalid = |text: String| Error::new(ErrorKind::InvalidFile, format!("{name}: {text}"));
    // The last line may be torn.
    let whole_lines = bytes.iter().rposition(|b| *b == b'\n').map_or(&[][..], |end| &bytes[..=end]);
    let text = std::str::from_utf8(whole_lines).map_err(|e| invalid(e.to_string()).with_source(e))?;
    let not_ours = || invalid(format!("its first line does not begin with {:?}", FORMAT.trim_end()));
    let (first, body) = text.split_once('\n').ok_or_else(not_ours)?;
    let made = first.strip_prefix(FORMAT).ok_or_else(not_ours)?;
    let made: RunSettings =
        serde_json::from_str(made).map_err(|e| invalid(format!("line 1: {e}")).with_source(e))?;
    let header = header()?;
    let found = body.lines().next().unwrap_or_default();
    if found != header {
        return Err(invalid(format!("line 2: other columns than this program writes: {found:?}")).into());
    }
    let mut reader = csv::Reader::from_reader(body.as_bytes());
    let (mut rows, mut whole, mut end) = (Vec::<Row>::new(), 0, header.len() + 1);
    let headers = reader.headers()?.clone();
    let mut record = csv::StringRecord::new();
    loop {
        let line = reader.position().line() + 1;
        let at_line = |e: csv::Error| invalid(format!("line {line}: {e}")).with_source(e);
        if !reader.read_record(&mut record).map_err(at_line)? {
            break;
        }
        let row: Row = record.deserialize(Some(&headers)).map_err(at_line)?;
        let expected = match rows.last() {
            Some(last) if last.row < last.rows => (last.name.clone(), last.row + 1, last.rows),
            _ => (row.name.clone(), 1, row.rows.max(1)),
        };
        if (row.name.clone(), row.row, row.rows) != expected {
            let (name, number, of) = expected;
            return Err(invalid(format!("line {line}: row {number} of {of} of {name} is needed here")).into());
        }
        let last_of_box = row.row == row.rows;
        rows.push(row);
        if last_of_box {
            whole = rows.len();
            end = usize::try_from(reader.position().byte())?;
        }
    }
    rows.truncate(whole);
    Ok((made, rows, first.len() + 1 + end))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn made() -> RunSettings {
        RunSettings {
            source: "box".into(),
            faces: 3,
            hazards: Some("all".into()),
            photos: None,
            calibration: None,
            off: true,
            method: "fit".into(),
            edges: "net".into(),
            network: "embedded".into(),
            least_confidence: "0.97".into(),
            program: "0.1.0".into(),
        }
    }

    fn rows(name: &str) -> Vec<Row> {
        let row = |row: usize| Row {
            name: name.into(),
            seed: Some(7),
            frames: "a b".into(),
            row,
            rows: 3,
            side: SIDE_NAMES[row - 1].into(),
            truth_mm: Some(100.5 * row as f64),
            cause: (row == 2).then_some(Cause::FanEnd),
            hazards: "film strap".into(),
            reason: "a, \"b\"".into(),
            seconds: 1.25,
            ..Row::default()
        };
        (1..=3).map(row).collect()
    }

    /// Wherever a run is stopped, the next one ends with the same file.
    #[test]
    fn a_file_that_was_torn_anywhere_is_gone_on_with() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.csv");
        let names = ["box-1", "box-2"];
        let mut book = Book::open(&path, &made()).unwrap();
        for name in names {
            book.add(rows(name)).unwrap();
        }
        drop(book);
        let whole = std::fs::read(&path).unwrap();
        assert_eq!(read(&path).unwrap(), (made(), [rows("box-1"), rows("box-2")].concat()));
        for length in 0..=whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            let mut book = Book::open(&path, &made()).unwrap();
            let left: Vec<_> = names.into_iter().filter(|name| !book.has(name)).collect();
            assert_eq!(left.is_empty(), length == whole.len(), "{length}");
            for name in left {
                book.add(rows(name)).unwrap();
            }
            assert_eq!(book.rows().len(), 6);
            assert_eq!(std::fs::read(&path).unwrap(), whole, "torn after {length} bytes");
        }
    }

    #[test]
    fn another_file_is_refused_and_left_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.csv");
        Book::open(&path, &made()).unwrap().add(rows("box-1")).unwrap();
        let before = std::fs::read_to_string(&path).unwrap();
        let said = |made: &RunSettings| Book::open(&path, made).map(|_| ()).unwrap_err().to_string();
        let other = RunSettings { hazards: Some("none".into()), ..made() };
        assert!(said(&other).contains("was made otherwise") && said(&other).contains("\"hazards\":\"none\""));
        // Another build of the same version, too.
        assert!(
            said(&RunSettings { program: "0.1.0, 0123".into(), ..made() }).contains("was made otherwise")
        );
        assert_eq!(std::fs::read_to_string(&path).unwrap(), before);

        for (text, complaint) in [
            ("a,b\n1,2\n".to_owned(), "first line"),
            (before.replace("size_class", "class"), "line 2: other columns"),
            (before.replacen("100.5", "long", 1), "line 3: "),
            (before.replacen("a b,1,3", "a b,2,3", 1), "line 3: row 1 of 3 of box-1 is needed"),
        ] {
            std::fs::write(&path, &text).unwrap();
            assert!(said(&made()).contains(complaint), "{}", said(&made()));
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        }
    }

    #[test]
    fn classes_of_sides() {
        let found = [99.0, 200.0, 200.1, 800.0, 1801.0].map(size_class);
        assert_eq!(found, ["to 200", "to 200", "200-400", "400-800", "over 800"]);
    }
}
