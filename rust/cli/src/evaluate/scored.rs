//! `boxline evaluate` with `--simulate`, `--csv`, `--report` or `--overlays`: many recordings, scored from rows.

use super::in_order::in_order;
use super::page::{self, Pictures};
use super::recorded::{Listed, Recorded, long_name};
use super::rows::{Book, Row, RunSettings, read, rows_of};
use super::score::{RecordingScore, method_name};
use super::summary::{Summary, summary};
use super::{Broken, figures, progress_bar};
#[cfg(feature = "render")]
use super::{simulated, stock};
use crate::Finished;
use crate::args::EvaluateArgs;
use crate::input::{Usage, fingerprint, this_program};
use crate::output::check_places;
use crate::overlay::{self, Headline, View};
use anyhow::Context;
use boxline::{Calibration, Method, Px};
use boxline_edgenet::AnyNet;
use boxline_proto::json::{Recording, Truth, read_calibration};
use clap::ValueEnum;
use serde_json::json;
#[cfg(feature = "render")]
use sha2::{Digest, Sha256};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// One recording.
struct Job<'a> {
    name: String,
    what: JobSource<'a>,
    /// Its rows are there; only its overlay is missing.
    only_overlay: bool,
}

enum JobSource<'a> {
    Folder(&'a Recording, &'a Truth),
    #[cfg(feature = "render")]
    Seed(u64),
}

/// What all jobs share.
struct Bench<'a> {
    args: &'a EvaluateArgs,
    method: Method,
    calibration: Option<Calibration>,
    #[cfg(feature = "render")]
    stock: Option<boxline_sim::Stock>,
}

/// Runs it.
pub fn evaluate(args: &EvaluateArgs) -> anyhow::Result<Finished> {
    let [method] = args.method.methods() else {
        return Err(
            Usage("--method both is for the table of a few folders; rows are of one method".into()).into()
        );
    };
    check_outputs(args)?;
    let csv = match &args.csv[..] {
        [] => None,
        [file] => Some(file),
        _ => return Err(Usage("one --csv can be written; several only with --report alone".into()).into()),
    };
    let bench = Bench {
        args,
        method: *method,
        calibration: args.calibration.as_deref().map(read_calibration).transpose()?,
        #[cfg(feature = "render")]
        stock: args.simulate.map(|_| bench_stock(args)).transpose()?,
    };
    let mut listed = Listed::default();
    for folder in &args.folders {
        listed.add(folder)?;
    }
    let mut broken: Vec<Broken> = std::mem::take(&mut listed.broken).into_iter().map(Broken::from).collect();
    let made = bench.made()?;
    let mut book = csv.map_or_else(|| Ok(Book::in_memory()), |file| Book::open(file, &made))?;
    let jobs = jobs(args, &listed, &book)?;
    let edges = args.edges.flatten().unwrap_or_default();
    let progress = progress_bar(jobs.len())?;
    in_order(
        &jobs,
        || Ok(args.network.load_one_of_many(edges)?),
        |network: &mut Option<AnyNet>, job| bench.rows(job, network.as_ref()),
        |job, rows| {
            progress.inc(1);
            match rows {
                Ok(_) if job.only_overlay => {}
                Ok(rows) => book.add(rows)?,
                Err(error) => broken.push(Broken { name: job.name.clone(), error }),
            }
            Ok(())
        },
    )?;
    progress.finish_and_clear();
    if book.rows().is_empty() && !broken.is_empty() {
        return Err(broken.swap_remove(0).error); // nothing else is there to tell
    }
    report(args, vec![summary(made, book.rows())], &broken)
}

/// Runs `boxline evaluate --report PAGE --csv FILE...`: nothing is measured.
pub fn report_files(args: &EvaluateArgs) -> anyhow::Result<Finished> {
    check_outputs(args)?;
    let parts = args.csv.iter().map(|file| {
        let (made, rows) = read(file)?;
        Ok(summary(made, &rows))
    });
    report(args, parts.collect::<anyhow::Result<_>>()?, &[])
}

/// Wrong names are told before the work.
fn check_outputs(args: &EvaluateArgs) -> anyhow::Result<()> {
    match &args.report {
        Some(page) if page.extension().is_none_or(|e| e != "md") => {
            Err(Usage(format!("{}: the page is an .md", page.display())).into())
        }
        Some(page) => Ok(check_places(&[page], args.csv.iter().map(PathBuf::as_path))?),
        None => Ok(()),
    }
}

/// Prints the numbers or, if there is to be a page, writes it and its pictures.
fn report(args: &EvaluateArgs, parts: Vec<Summary>, broken: &[Broken]) -> anyhow::Result<Finished> {
    let object = if args.json { json!({"parts": parts}) } else { serde_json::Value::Null };
    let note = args.note.as_deref();
    let Some(page) = &args.report else {
        let text = page::text(&parts.into_iter().map(|part| (part, None)).collect::<Vec<_>>(), note);
        return Ok(Broken::finish(broken, text, object));
    };
    let mut written = vec![page.display().to_string()];
    let mut pictured = Vec::new();
    for (index, part) in parts.into_iter().enumerate() {
        let pictures = part.confidence.as_ref().map(|confidence| {
            let folder = page.parent().unwrap_or(Path::new("")).join("docs");
            std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot make", folder.display()))?;
            let stem = page.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
            let mut write = |kind: &str, svg: Result<String, String>| {
                let source =
                    if page::two_of_three(&part.made) { "three-two" } else { part.made.source.as_str() };
                let name = format!("{stem}-{}-{source}-{kind}.svg", index + 1);
                let path = folder.join(&name);
                written.push(path.display().to_string());
                write_text(&path, &svg.map_err(anyhow::Error::msg)?)?;
                Ok::<_, anyhow::Error>(format!("docs/{name}"))
            };
            Ok::<_, anyhow::Error>(Pictures {
                reliability: write("reliability", figures::reliability(confidence))?,
                risk: write("risk", figures::risk(confidence))?,
            })
        });
        let pictures = pictures.transpose()?;
        pictured.push((part, pictures));
    }
    write_text(page, &page::text(&pictured, note))?;
    Ok(Broken::finish(broken, format!("{}\n", written.join("\n")), object))
}

fn write_text(path: &Path, text: &str) -> anyhow::Result<()> {
    std::fs::write(path, text).with_context(|| format!("{}: cannot write", path.display()))
}

/// What is not in the book yet, and what lacks its overlay.
fn jobs<'a>(args: &EvaluateArgs, listed: &'a Listed, book: &Book) -> anyhow::Result<Vec<Job<'a>>> {
    let mut all: Vec<(String, JobSource<'a>)> = listed
        .recordings
        .iter()
        .map(|(recording, truth)| (long_name(&recording.folder), JobSource::Folder(recording, truth)))
        .collect();
    #[cfg(feature = "render")]
    if let Some(count) = args.simulate {
        if matches!(args.kind, crate::args::RenderKind::Board) {
            return Err(Usage("--kind board: sets of the board are for `boxline calibrate`".into()).into());
        }
        let last = args.seed.checked_add(count).context("--seed and --simulate: too large together")?;
        all.extend(
            (args.seed..last)
                .map(|seed| (format!("{}-{seed}", value_name(args.kind)), JobSource::Seed(seed))),
        );
    }
    #[cfg(not(feature = "render"))]
    if args.simulate.is_some() {
        return Err(super::no_renderer());
    }
    let mut names = BTreeSet::new();
    if let Some((twice, _)) = all.iter().find(|(name, _)| !names.insert(name.clone())) {
        return Err(Usage(format!("two recordings are called {twice}: rows could not be told apart")).into());
    }
    let wrong: BTreeSet<(&str, &str)> = book
        .rows()
        .iter()
        .filter(|row| row.wrong)
        .map(|row| (row.name.as_str(), row.frames.as_str()))
        .collect();
    let lacks_overlay = |name: &str| {
        let Some(folder) = &args.overlays else { return false };
        wrong.iter().any(|(of, frames)| *of == name && !overlay_path(folder, name, frames).exists())
    };
    Ok(all
        .into_iter()
        .filter_map(|(name, what)| {
            let only_overlay = book.has(&name);
            (!only_overlay || lacks_overlay(&name)).then_some(Job { name, what, only_overlay })
        })
        .collect())
}

fn overlay_path(folder: &Path, name: &str, frames: &str) -> PathBuf {
    folder.join(format!("{name}_{frames}.jpg").replace(['/', ' '], "_"))
}

#[cfg(feature = "render")]
fn bench_stock(args: &EvaluateArgs) -> anyhow::Result<boxline_sim::Stock> {
    let mut stock = stock::stock(boxline_sim::Split::HeldOut, args.photos.as_deref())?;
    stock.hazards = args.hazards;
    Ok(stock)
}

/// The name of a choice on the command line.
fn value_name(value: impl ValueEnum) -> String {
    value.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

impl Bench<'_> {
    fn made(&self) -> anyhow::Result<RunSettings> {
        let args = self.args;
        let network = match &args.network.model {
            Some(path) => fingerprint(path)?,
            None => "embedded".to_owned(),
        };
        let mut made = RunSettings {
            source: "folders".into(),
            faces: args.faces,
            hazards: None,
            photos: None,
            calibration: self.calibration.as_ref().map(|c| c.serial().to_owned()),
            off: !args.ignore_off,
            method: method_name(self.method).into(),
            edges: value_name(args.edges.flatten().unwrap_or_default()),
            network,
            least_confidence: args.network.least_confidence.to_string(),
            program: this_program()?,
        };
        #[cfg(feature = "render")]
        if let Some(stock) = &self.stock {
            made.source = value_name(args.kind);
            made.off = args.off;
            made.hazards = Some(args.hazards.to_string());
            let mut names = Sha256::new();
            stock.photos.all.iter().for_each(|photo| names.update(format!("{}\n", photo.name)));
            let hash = format!("{:x}", names.finalize());
            made.photos = (!stock.photos.all.is_empty())
                .then(|| format!("{} (names' hash {})", stock.photos.all.len(), &hash[..8]));
        }
        Ok(made)
    }

    /// Measures a recording; what is wrong in it is drawn if overlays are wanted.
    fn rows(&self, job: &Job<'_>, network: Option<&AnyNet>) -> anyhow::Result<Vec<Row>> {
        let (recorded, calibration, seed) = match &job.what {
            JobSource::Folder(recording, truth) => {
                let calibration = match &self.calibration {
                    Some(calibration) => calibration.clone(),
                    None => read_calibration(&recording.calibration_file)?,
                };
                (Recorded::read(recording, truth, !self.args.ignore_off)?, calibration, None)
            }
            #[cfg(feature = "render")]
            JobSource::Seed(seed) => {
                let stock = self.stock.as_ref().context("no stock to render from")?;
                let (recorded, calibration) =
                    simulated::recorded(&job.name, self.args.kind.of(1), *seed, self.args.off, stock)?;
                (recorded, calibration, Some(*seed))
            }
        };
        let edges = self.args.edges.flatten().unwrap_or_default();
        let settings = self.args.network.settings(self.method, edges, network);
        let recorded = recorded.with_faces(self.args.faces);
        let score = recorded.judge(&calibration, &settings, self.method)?;
        let rows = rows_of(&job.name, seed, &recorded, &calibration, &score);
        if let Some(folder) = &self.args.overlays {
            std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot make", folder.display()))?;
            draw_wrong(folder, &rows, &recorded, &score)?;
        }
        Ok(rows)
    }
}

/// Draws what was found in each wrong box or face, with the true outline.
fn draw_wrong(
    folder: &Path,
    rows: &[Row],
    recorded: &Recorded,
    score: &RecordingScore,
) -> anyhow::Result<()> {
    for sides in rows.chunk_by(|a, b| a.frames == b.frames) {
        let Some(first) = sides.first().filter(|_| sides.iter().any(|row| row.wrong)) else { continue };
        let shown: BTreeSet<&str> = first.frames.split(' ').collect();
        let pairs: Vec<_> = recorded
            .frames
            .iter()
            .zip(&score.faces)
            .filter(|((frame, ..), _)| shown.contains(frame.id.as_str()))
            .collect();
        let views: Vec<View<'_>> = pairs
            .iter()
            .map(|((recorded, truth, frame), face)| View {
                name: &recorded.id,
                frame,
                face: &face.outcome,
                truth: truth.corners_px.map(|corners| corners.map(|[u, v]| Px::new(u, v))),
            })
            .collect();
        let headline = match (&score.cuboid, pairs.first()) {
            (Some(cuboid), _) => Headline::of_box(&cuboid.outcome),
            (None, Some((_, face))) => Headline::of_face(&face.outcome),
            (None, None) => continue,
        };
        let truth: Vec<String> =
            sides.iter().filter_map(|row| row.truth_mm).map(|mm| format!("{mm:.1}")).collect();
        let due = if first.due_reason.is_empty() {
            String::new()
        } else {
            format!(", to be refused: {}", first.due_reason)
        };
        let cause = first.cause.map_or("", super::cause::Cause::words);
        let line = format!("{}, true: {} mm{due}; {cause}", first.name, truth.join(" × "));
        let picture = overlay::draw(&views, &headline.wrong(line))?;
        overlay::write(&picture, &overlay_path(folder, &first.name, &first.frames))?;
    }
    Ok(())
}
