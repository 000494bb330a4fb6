//! `boxline evaluate --perturb`: measures each recording as it is and once for every change of its pictures that leaves the sizes as
//! they are ([`boxline_sim::perturb`]). No result may become wrong, and no side may move by more than its sigma lets expect.
//!
//! Both frames of a box are changed alike. A side's move is counted in sigmas, the larger one of the two results: what both have
//! in common (calibration, rounding) is in it, so that honest results move by much less than 1.

mod tables;

use super::recorded::{Recorded, recordings_in};
use crate::Finished;
use crate::args::EvaluateArgs;
use crate::input::{Usage, lit_faces};
use crate::overlay::{self, Headline, View};
use anyhow::Context;
use boxline::{
    BoxReport, Calibration, Estimate, FaceOutcome, Frame, Method, Outcome, measure_box, measure_face,
};
use boxline_edgenet::AnyNet;
use boxline_proto::json::{TruthFace, is_wrong_box, read_calibration};
use boxline_sim::perturb::{Perturbation, Shot};
use indicatif::{ProgressBar, ProgressStyle};
use rayon::prelude::*;
use std::fs::File;
use std::path::Path;

/// What is measured at once: the two frames of a box, or a single frame.
struct Subject<'a> {
    recording: &'a str,
    /// The recording's name, and the frame's where it is a single one.
    name: String,
    due: Expected<'a>,
    frames: Vec<(&'a str, Shot<'a>, &'a Frame)>,
    calibration: &'a Calibration,
}

/// What a subject should give.
enum Expected<'a> {
    Box([f64; 3]),
    Face(&'a TruthFace),
    Refusal,
}

/// What a subject gave.
struct SubjectResult {
    answer: ResultKind,
    /// Length, width and, of a box, height; empty if it was not measured.
    sides: Vec<Estimate>,
    /// What is wrong with it, in words.
    wrong: Option<String>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum ResultKind {
    Measured,
    Ambiguous,
    Refused(&'static str),
}

impl ResultKind {
    const fn name(self) -> &'static str {
        match self {
            Self::Measured => "measured",
            Self::Ambiguous => "ambiguous",
            Self::Refused(_) => "refused",
        }
    }

    const fn reason(self) -> Option<&'static str> {
        match self {
            Self::Refused(reason) => Some(reason),
            _ => None,
        }
    }
}

/// A subject as it is, and after all changes that its pictures have room for.
struct PerturbedSubject {
    recording: String,
    name: String,
    truth_mm: Vec<f64>,
    before: SubjectResult,
    after: Vec<(Perturbation, SubjectResult)>,
}

impl PerturbedSubject {
    /// By how many sigmas each side moved.
    fn moves(&self, after: &SubjectResult) -> Vec<f64> {
        let pairs = self.before.sides.iter().zip(&after.sides);
        pairs.map(|(a, b)| (b.value_mm - a.value_mm) / a.sigma_mm.max(b.sigma_mm)).collect()
    }
}

/// One network a thread: ONNX Runtime takes one frame at a time.
struct Networks(Vec<AnyNet>);

impl Networks {
    fn load(args: &EvaluateArgs) -> Result<Self, boxline::Error> {
        let edges = args.edges.flatten().unwrap_or_default();
        let all = (0..rayon::current_num_threads())
            .filter_map(|_| args.network.load_one_of_many(edges).transpose());
        all.collect::<Result<_, _>>().map(Self)
    }

    /// This thread's.
    fn own(&self) -> Option<&AnyNet> {
        let thread = rayon::current_thread_index().unwrap_or(0);
        self.0.get(thread)
    }
}

/// Runs `boxline evaluate --perturb`.
pub fn evaluate(args: &EvaluateArgs) -> anyhow::Result<Finished> {
    let &[method] = args.method.methods() else {
        return Err(Usage("--perturb takes one method".into()).into());
    };
    if args.folders.is_empty() {
        return Err(Usage("--perturb needs a folder with recording.json and truth.json".into()).into());
    }
    if let Some(folder) = &args.overlays {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("{}: cannot make the folder", folder.display()))?;
    }
    let mut recordings = Vec::new();
    for folder in &args.folders {
        recordings.extend(recordings_in(folder)?);
    }
    let networks = Networks::load(args)?;
    let changes = Perturbation::all();
    let results = recordings.iter().map(|(recording, truth)| match truth.box_mm {
        Some(_) if !truth.must_refuse => 1,
        _ => lit_faces(recording).len(),
    });
    // Drawn on standard error, and only on a terminal.
    let progress = ProgressBar::new((results.sum::<usize>() * changes.len()) as u64)
        .with_style(ProgressStyle::with_template("{bar:30} {pos}/{len} {elapsed} of {duration} {msg}")?);
    let mut all = Vec::new();
    // One recording after the other: a changed frame takes 15 MB, a frame with the light of its face ten times that.
    for (recording, truth) in &recordings {
        let calibration = match &args.calibration {
            Some(file) => read_calibration(file)?,
            None => read_calibration(&recording.calibration_file)?,
        };
        let recorded = Recorded::read(recording, truth, false)?; // a view with the lasers off would have to change with it
        progress.set_message(recorded.name.clone());
        let bench = Bench { args, method, networks: &networks, progress: &progress };
        for subject in subjects(&recorded, &calibration) {
            all.push(bench.try_all(&subject, &changes)?);
        }
    }
    progress.finish_and_clear();
    if let Some(path) = args.csv.first() {
        let file = File::create(path).with_context(|| format!("{}: cannot write", path.display()))?;
        tables::csv(&all, file).with_context(|| format!("{}: cannot write", path.display()))?;
    }
    if let Some(path) = &args.report {
        write_section(path, &tables::section(&all, args))?;
    }
    let stdout = if args.json { tables::json(&all, args.seed).to_string() } else { tables::text(&all) };
    Ok(Finished { stdout, exit_code: 0 })
}

fn subjects<'a>(recorded: &'a Recorded, calibration: &'a Calibration) -> Vec<Subject<'a>> {
    let frames = recorded.frames.iter().map(|(named, truth, frame)| {
        (truth, (named.id.as_str(), Shot::new(frame, calibration, truth.corners_cam_mm), frame))
    });
    let subject =
        |name: String, due, frames| Subject { recording: &recorded.name, name, due, frames, calibration };
    if let Some(truth_mm) = recorded.true_box_mm {
        let frames = frames.map(|(_, frame)| frame).collect();
        return vec![subject(recorded.name.clone(), Expected::Box(truth_mm), frames)];
    }
    let singles = frames.map(|(truth, frame)| {
        let refused = recorded.must_refuse || truth.refuse.is_some() || truth.size_mm.is_none();
        let due = if refused { Expected::Refusal } else { Expected::Face(truth) };
        subject(format!("{} {}", recorded.name, frame.0), due, vec![frame])
    });
    singles.collect()
}

/// What measures.
struct Bench<'a> {
    args: &'a EvaluateArgs,
    method: Method,
    networks: &'a Networks,
    progress: &'a ProgressBar,
}

impl Bench<'_> {
    fn try_all(&self, subject: &Subject<'_>, changes: &[Perturbation]) -> anyhow::Result<PerturbedSubject> {
        let whole: Vec<&Frame> = subject.frames.iter().map(|(.., frame)| *frame).collect();
        let before = self.measure(subject, &whole, None)?;
        let after = changes.par_iter().filter_map(|change| {
            let found = self.changed(subject, change);
            self.progress.inc(1);
            found.transpose().map(|found| found.map(|found| (*change, found)))
        });
        let after = after.collect::<anyhow::Result<Vec<_>>>()?;
        let truth_mm = match &subject.due {
            Expected::Box(sides) => sides.to_vec(),
            Expected::Face(face) => face.size_mm.map_or_else(Vec::new, Vec::from),
            Expected::Refusal => Vec::new(),
        };
        Ok(PerturbedSubject {
            recording: subject.recording.into(),
            name: subject.name.clone(),
            truth_mm,
            before,
            after,
        })
    }

    /// The result after a change; `None` if none of the pictures has room for it.
    fn changed(&self, subject: &Subject<'_>, change: &Perturbation) -> anyhow::Result<Option<SubjectResult>> {
        let mut changed = Vec::new();
        for (n, (_, shot, _)) in subject.frames.iter().enumerate() {
            let seed = boxline_sim::rng::mix(self.args.seed) ^ n as u64;
            changed.push(change.apply(shot, seed)?);
        }
        if changed.iter().all(Option::is_none) {
            return Ok(None);
        }
        let originals = subject.frames.iter().map(|(.., frame)| *frame);
        let frames: Vec<&Frame> =
            changed.iter().zip(originals).map(|(changed, frame)| changed.as_ref().unwrap_or(frame)).collect();
        self.measure(subject, &frames, Some(change)).map(Some)
    }

    fn measure(
        &self,
        subject: &Subject<'_>,
        frames: &[&Frame],
        change: Option<&Perturbation>,
    ) -> anyhow::Result<SubjectResult> {
        let edges = self.args.edges.flatten().unwrap_or_default();
        let settings = self.args.network.settings(self.method, edges, self.networks.own());
        let calibration = subject.calibration;
        let in_context = |e: boxline::Error| e.in_context(&subject.name);
        let (found, faces, headline) = if let (Expected::Box(truth_mm), [a, b]) = (&subject.due, frames) {
            let report = measure_box(&[a, b], calibration, &settings).map_err(in_context)?;
            let headline = Headline::of_box(&report.outcome);
            (of_box(&report, *truth_mm), report.faces.to_vec(), headline)
        } else {
            let face = measure_face(frames[0], calibration, &settings).map_err(in_context)?.outcome;
            let headline = Headline::of_face(&face);
            (of_face(&face, &subject.due), vec![face], headline)
        };
        if let (Some(folder), Some(_)) = (&self.args.overlays, &found.wrong) {
            let what = change.map_or_else(|| "unchanged".to_owned(), ToString::to_string);
            let views = subject.frames.iter().zip(frames).zip(&faces);
            let views: Vec<View<'_>> =
                views.map(|(((name, ..), frame), face)| View { name, frame, face, truth: None }).collect();
            let name = format!("{}_{what}.jpg", subject.name).replace([' ', ',', ':'], "_");
            overlay::write(&overlay::draw(&views, &headline)?, &folder.join(name))?;
        }
        Ok(found)
    }
}

const SIDES: [&str; 3] = ["length", "width", "height"];

fn of_box(report: &BoxReport, truth_mm: [f64; 3]) -> SubjectResult {
    match &report.outcome {
        Outcome::Measured(m) => {
            let sides = vec![m.length, m.width, m.height];
            let wrong = is_wrong_box(m, truth_mm).then(|| beside_truth(&sides, &truth_mm));
            SubjectResult { answer: ResultKind::Measured, sides, wrong }
        }
        Outcome::Ambiguous(_) => {
            SubjectResult { answer: ResultKind::Ambiguous, sides: Vec::new(), wrong: None }
        }
        Outcome::Rejected(reject) => {
            SubjectResult { answer: ResultKind::Refused(reject.reason()), sides: Vec::new(), wrong: None }
        }
    }
}

fn of_face(face: &FaceOutcome, due: &Expected<'_>) -> SubjectResult {
    let face = match face {
        FaceOutcome::Measured(face) => face,
        FaceOutcome::Rejected(reject) => {
            return SubjectResult {
                answer: ResultKind::Refused(reject.reason()),
                sides: Vec::new(),
                wrong: None,
            };
        }
    };
    let sides = vec![face.length, face.width];
    let wrong = match due {
        Expected::Face(truth) if !truth.is_wrong(face) => None,
        Expected::Face(truth) if truth.notes.click_px.is_some() => {
            Some("a corner lies on another line".to_owned())
        }
        Expected::Face(TruthFace { size_mm: Some(truth_mm), .. }) => Some(beside_truth(&sides, truth_mm)),
        _ => Some("measured, a refusal was due".to_owned()),
    };
    SubjectResult { answer: ResultKind::Measured, sides, wrong }
}

/// The side that is farthest off.
fn beside_truth(sides: &[Estimate], truth_mm: &[f64]) -> String {
    let error = |(side, truth_mm): (&Estimate, &f64)| (side.value_mm - truth_mm).abs();
    let all = SIDES.iter().zip(sides.iter().zip(truth_mm));
    let worst = all.max_by(|(_, a), (_, b)| error(*a).total_cmp(&error(*b)));
    worst.map_or_else(String::new, |(name, (side, truth_mm))| {
        format!("{name} {:.1} ± {:.1} mm, truth {truth_mm:.1}", side.value_mm, side.sigma_mm)
    })
}

/// Puts a section into a page: in the place of the one with its heading, or at the end; the rest of the page stays.
fn write_section(page: &Path, section: &str) -> anyhow::Result<()> {
    let old = match std::fs::read_to_string(page) {
        Ok(text) => text,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => String::new(),
        Err(e) => return Err(e).with_context(|| format!("{}: cannot read", page.display())),
    };
    std::fs::write(page, with_section(&old, section))
        .with_context(|| format!("{}: cannot write", page.display()))
}

fn with_section(page: &str, section: &str) -> String {
    let heading = section.lines().next().unwrap_or_default();
    let mut kept = Vec::new();
    let mut place = None;
    let mut inside = false;
    for line in page.lines() {
        if line.starts_with("# ") || line.starts_with("## ") {
            inside = line == heading;
            if inside {
                place = Some(kept.len());
            }
        }
        if !inside {
            kept.push(line);
        }
    }
    let (above, below) = kept.split_at(place.unwrap_or(kept.len()));
    let parts = [above.join("\n"), section.to_owned(), below.join("\n")];
    let parts: Vec<&str> = parts.iter().map(|part| part.trim()).filter(|part| !part.is_empty()).collect();
    parts.join("\n\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_section_takes_its_own_place_in_a_page() {
        let page = "# Page\n\n## One\na\n\n## Mine\nold\n### of mine\nold\n\n## Two\nb\n";
        let with = with_section(page, "## Mine\nnew\n");
        assert_eq!(with, "# Page\n\n## One\na\n\n## Mine\nnew\n\n## Two\nb\n");
        assert_eq!(with_section(&with, "## Mine\nnew"), with);
        assert_eq!(with_section("", "## Mine\nnew"), "## Mine\nnew\n");
        assert_eq!(with_section("# Page\n", "## Mine\nnew"), "# Page\n\n## Mine\nnew\n");
    }

    #[test]
    fn the_side_that_is_farthest_off_is_named() {
        let sides = [1010.91, 899.1, 690.0].map(|mm| Estimate::new(mm, 1.32));
        assert_eq!(beside_truth(&sides, &[1200.0, 900.0, 700.0]), "length 1010.9 ± 1.3 mm, truth 1200.0");
    }
}
