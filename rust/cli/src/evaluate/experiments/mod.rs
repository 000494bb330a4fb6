//! `boxline evaluate --experiments`: the paper's experiments (section 4: Tables 3 to 5, figure 22, section 4.4) repeated on rendered
//! twins and on recordings, the product's way beside the paper's. [`plan`] says what is measured, [`ledger`] keeps each shot beside
//! the page, so that a run that was stopped goes on; from it come the page ([`page`]) and its picture ([`figure`]). Everything
//! follows from the seed.

mod figure;
mod ledger;
mod page;
mod plan;
mod series;

use super::score::BoxScore;
use super::stock::stock;
use super::{Recorded, recordings_in};
use crate::Finished;
use crate::args::EvaluateArgs;
use crate::input::{Usage, fingerprint, this_program};
use anyhow::Context;
use boxline::network::{EdgeMapNetwork, Network};
use boxline::{
    EdgeMethod, FaceMeasurement, FaceOutcome, Frame, Method, Outcome, Settings, measure_box, measure_face,
};
use boxline_edgenet::{EdgeMapNet, EdgeNet, Options};
use boxline_proto::json::read_calibration;
use boxline_sim::recording::{Detail, Exposure, expose_full_frame, jpeg};
use boxline_sim::rng::mix;
use boxline_sim::world::Scene;
use boxline_sim::world::twin::trembled;
use boxline_sim::{Head, Rng, Split, Stock};
use indicatif::{ProgressBar, ProgressStyle};
use ledger::Ledger;
use plan::{Experiment, Subject, Table};
use rayon::prelude::*;
use serde_json::{Value, json};
use series::{ShotResult, Tally};
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// A way from the picture to the millimetre.
struct Pipeline {
    /// In the csv: what its results follow from.
    id: String,
    /// On the page.
    name: &'static str,
    method: Method,
    edges: EdgeMethod,
    /// On the map of the paper's own network.
    by_ihed: bool,
}

/// The product's way, the paper's chain on the product's map, and the paper's own system if its network is given.
fn ways(args: &EvaluateArgs) -> anyhow::Result<Vec<Pipeline>> {
    let way =
        |id: &str, name, method, edges, by_ihed| Pipeline { id: id.to_owned(), name, method, edges, by_ihed };
    let mut ways = vec![
        way("fit", "Fit", Method::Fit, EdgeMethod::Net, false),
        way("keypoints", "Key points", Method::Keypoints, EdgeMethod::Hough, false),
    ];
    if let Some(path) = &args.ihed {
        let id = format!("ihed {}", fingerprint(path)?);
        ways.push(way(&id, "Paper's system", Method::Keypoints, EdgeMethod::Hough, true));
    }
    Ok(ways)
}

/// The networks of one thread.
struct Nets {
    boxnet: EdgeNet,
    ihed: Option<EdgeMapNet>,
    least_confidence: f64,
}

impl Nets {
    fn load(args: &EvaluateArgs, options: &Options) -> Result<Self, boxline::Error> {
        let boxnet = match &args.network.model {
            Some(path) => EdgeNet::from_path(path, options)?,
            None => EdgeNet::embedded(options)?,
        };
        let ihed = args.ihed.as_deref().map(|path| EdgeMapNet::from_path(path, options)).transpose()?;
        Ok(Self { boxnet, ihed, least_confidence: args.network.least_confidence })
    }

    fn settings(&self, way: &Pipeline) -> Settings<'_> {
        Settings {
            method: way.method,
            edges: way.edges,
            network: Some(&self.boxnet as &dyn Network),
            edge_map: self.ihed.as_ref().filter(|_| way.by_ihed).map(|net| net as &dyn EdgeMapNetwork),
            least_confidence: self.least_confidence,
            ..Settings::default()
        }
    }
}

/// What does not change from shot to shot.
struct Bench {
    head: Head,
    stock: Stock,
    /// One for each thread.
    nets: Vec<Nets>,
    ways: Vec<Pipeline>,
    seed: u64,
}

/// All that was found.
struct ExperimentResults {
    /// Of each way: id and name.
    ways: Vec<(String, &'static str)>,
    /// A tally for each way.
    lines: Vec<(Experiment, Vec<Tally>)>,
    /// Recordings, a score for each way.
    recorded: Vec<(String, Vec<BoxScore>)>,
}

/// Runs `boxline evaluate --experiments`.
pub fn evaluate(args: &EvaluateArgs, out: &Path) -> anyhow::Result<Finished> {
    if out.extension().is_none_or(|e| e != "md") {
        return Err(Usage(format!("{}: the page is an .md", out.display())).into());
    }
    // Shots are made side by side, so each network has one thread unless it is told.
    let threads = args.network.threads.unwrap_or(NonZeroUsize::MIN);
    let options = Options { threads, ..args.network.options() };
    let nets = (0..rayon::current_num_threads()).map(|_| Nets::load(args, &options));
    let bench = Bench {
        head: Head::nominal()?,
        stock: stock(Split::HeldOut, args.photos.as_deref())?,
        nets: nets.collect::<Result<_, _>>()?,
        ways: ways(args)?,
        seed: args.seed,
    };
    let model = args.network.model.as_deref().map_or_else(|| Ok("shipped".to_owned()), fingerprint)?;
    let photos = bench.stock.photos.all.len();
    let program = this_program()?;
    let limit = args.network.least_confidence;
    let made_with = format!(
        "boxline {program}, seed {}, network {model}, limit {limit}, {photos} photographs",
        args.seed
    );
    let mut ledger = Ledger::open(&out.with_extension("csv"), &made_with)?;
    let subjects = plan::subjects(&bench.head, &bench.stock, args.seed)?;
    bench.shoot(&subjects, args.shots, &mut ledger)?;
    let mut recorded = Vec::new();
    for folder in &args.folders {
        recorded.extend(bench.recorded(folder)?);
    }
    let found = bench.found(&subjects, args.shots, &ledger, recorded);
    let svg = out.with_extension("svg");
    let name = svg.file_name().unwrap_or_default().to_string_lossy().into_owned();
    write(&svg, &figure::draw(&found).map_err(anyhow::Error::msg)?)?;
    write(out, &page::text(&found, args, &name))?;
    let stdout = if args.json {
        found.json(args).to_string()
    } else {
        format!("{}\n{}\n{}", out.display(), svg.display(), out.with_extension("csv").display())
    };
    Ok(Finished { stdout, exit_code: 0 })
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    std::fs::write(path, text).with_context(|| format!("{}: cannot write", path.display()))
}

/// How often each line of a table is measured.
fn shots_of(table: Table, at_most: Option<u64>) -> u64 {
    table.papers_shots().min(at_most.unwrap_or(u64::MAX))
}

impl Bench {
    /// Makes the shots that the ledger lacks, on all cores.
    fn shoot(&self, subjects: &[Subject], at_most: Option<u64>, ledger: &mut Ledger) -> anyhow::Result<()> {
        let mut missing = Vec::new();
        let mut total = 0;
        for subject in subjects {
            for shot in 0..shots_of(subject.what.table, at_most) {
                total += 1;
                let ways: Vec<&Pipeline> = self
                    .ways
                    .iter()
                    .filter(|way| ledger.shot(&subject.what, &way.id, shot).is_none())
                    .collect();
                if !ways.is_empty() {
                    missing.push((subject, shot, ways));
                }
            }
        }
        // Drawn on standard error, and only on a terminal.
        let progress = ProgressBar::new(total)
            .with_style(ProgressStyle::with_template(
                "{bar:30} {pos}/{len} shots {elapsed}, {eta} left {msg}",
            )?)
            .with_position(total - missing.len() as u64);
        progress.reset_eta();
        let ledger = Mutex::new(ledger);
        missing.par_iter().try_for_each(|(subject, shot, ways)| -> anyhow::Result<()> {
            let nets = &self.nets[rayon::current_thread_index().unwrap_or(0)];
            let found = self.shot(subject, *shot, ways, nets)?;
            ledger.lock().unwrap_or_else(PoisonError::into_inner).add(&subject.what, *shot, found)?;
            progress.set_message(format!("{}, {}", subject.what.table.word(), subject.what.name));
            progress.inc(1);
            Ok(())
        })?;
        progress.finish_and_clear();
        Ok(())
    }

    /// One shot, measured in some ways.
    fn shot(
        &self,
        subject: &Subject,
        shot: u64,
        ways: &[&Pipeline],
        nets: &Nets,
    ) -> anyhow::Result<Vec<(String, ShotResult)>> {
        let mut rng = Rng::new(mix(self.seed ^ mix(subject.seed)), shot);
        let scene = trembled(&mut rng, &self.head, &subject.scene);
        let mut frames = Vec::with_capacity(2);
        for (i, view) in subject.views(shot).iter().enumerate() {
            let seed = mix(self.seed ^ mix((subject.seed << 32) + 2 * shot + i as u64));
            frames.push(self.frame(&scene, *view, seed, subject)?);
        }
        let mut found = Vec::with_capacity(ways.len());
        for way in ways {
            let (settings, calibration) = (nets.settings(way), &self.head.calibration);
            let became = match &frames[..] {
                [first, second] => {
                    let report = measure_box(&[first, second], calibration, &settings)?;
                    match report.outcome {
                        Outcome::Measured(m) => ShotResult::Measured {
                            sides: vec![m.length, m.width, m.height],
                            warned: !report.warnings.is_empty() || report.faces.iter().any(has_warnings),
                        },
                        Outcome::Ambiguous(_) => ShotResult::Refused("ambiguous".into()),
                        Outcome::Rejected(reject) => ShotResult::Refused(reject.reason().into()),
                    }
                }
                [frame] => match measure_face(frame, calibration, &settings)?.outcome {
                    FaceOutcome::Measured(face) => ShotResult::Measured {
                        sides: vec![face.length, face.width],
                        warned: face_has_warnings(&face),
                    },
                    FaceOutcome::Rejected(reject) => ShotResult::Refused(reject.reason().into()),
                },
                _ => anyhow::bail!("{}: a shot has one view or two", subject.what.name),
            };
            found.push((way.id.clone(), became));
        }
        Ok(found)
    }

    /// A full frame through the camera's JPEG.
    fn frame(&self, scene: &Scene, view: usize, seed: u64, subject: &Subject) -> anyhow::Result<Frame> {
        let view = &scene.views[view];
        let exposure = Exposure { optics: subject.optics, ..Exposure::of(seed, Detail::Everywhere) };
        let rgb = expose_full_frame(&self.head, scene, view, &exposure, &self.stock);
        Ok(Frame::from_jpeg(&jpeg(&rgb, seed)?)?)
    }

    /// Recordings of boxes, measured in each way.
    fn recorded(&self, folder: &Path) -> anyhow::Result<Vec<(String, Vec<BoxScore>)>> {
        let mut found = Vec::new();
        for (recording, truth) in recordings_in(folder)? {
            let calibration = read_calibration(&recording.calibration_file)?;
            let recorded = Recorded::read(&recording, &truth, false)?;
            let mut boxes = Vec::with_capacity(self.ways.len());
            for way in &self.ways {
                let settings = self.nets[0].settings(way);
                boxes.extend(recorded.judge(&calibration, &settings, way.method)?.cuboid);
            }
            if !boxes.is_empty() {
                found.push((recorded.name.clone(), boxes));
            }
        }
        Ok(found)
    }

    fn found(
        &self,
        subjects: &[Subject],
        at_most: Option<u64>,
        ledger: &Ledger,
        recorded: Vec<(String, Vec<BoxScore>)>,
    ) -> ExperimentResults {
        let line = |subject: &Subject| {
            let tally = |way: &Pipeline| {
                let shots = 0..shots_of(subject.what.table, at_most);
                Tally::new(&subject.what, shots.filter_map(|shot| ledger.shot(&subject.what, &way.id, shot)))
            };
            (subject.what.clone(), self.ways.iter().map(tally).collect())
        };
        ExperimentResults {
            ways: self.ways.iter().map(|way| (way.id.clone(), way.name)).collect(),
            lines: subjects.iter().map(line).collect(),
            recorded,
        }
    }
}

fn has_warnings(face: &FaceOutcome) -> bool {
    matches!(face, FaceOutcome::Measured(face) if face_has_warnings(face))
}

fn face_has_warnings(face: &FaceMeasurement) -> bool {
    !face.warnings.is_empty()
}

impl ExperimentResults {
    /// The lines of a table.
    fn of(&self, table: Table) -> impl Iterator<Item = &(Experiment, Vec<Tally>)> + Clone {
        self.lines.iter().filter(move |(what, _)| what.table == table)
    }

    fn json(&self, args: &EvaluateArgs) -> Value {
        let by_way = |tallies: &[Tally]| -> Value {
            self.ways.iter().zip(tallies).map(|((id, _), tally)| (id.clone(), tally.json())).collect()
        };
        let line = |(what, tallies): &(Experiment, Vec<Tally>)| {
            json!({
                "table": what.table.word(), "what": what.name, "true_mm": what.sides_mm,
                "distance_mm": what.distance_mm, "ways": by_way(tallies),
            })
        };
        let recorded = |(name, scores): &(String, Vec<BoxScore>)| {
            let errors: Value =
                self.ways.iter().zip(scores).map(|((id, _), s)| (id.clone(), json!(s.errors_mm()))).collect();
            json!({"name": name, "error_mm": errors})
        };
        json!({
            "seed": args.seed,
            "lines": self.lines.iter().map(line).collect::<Vec<_>>(),
            "recorded": self.recorded.iter().map(recorded).collect::<Vec<_>>(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    fn args(words: &[&str]) -> EvaluateArgs {
        let all = [&["boxline", "evaluate", "--experiments", "--out", "rust/EXPERIMENTS.md"], words].concat();
        match crate::args::Args::parse_from(all).command {
            crate::args::Command::Evaluate(args) => args,
            _ => panic!("another command"),
        }
    }

    #[test]
    fn shots_are_made_once_are_the_same_again_and_are_right() {
        // That shots are measured rightly is asked, not how sure their sides are.
        let args = args(&["--shots", "2", "--least-confidence", "0.9"]);
        let options = Options { threads: NonZeroUsize::MIN, ..args.network.options() };
        let threads = rayon::current_num_threads();
        let bench = Bench {
            head: Head::nominal().unwrap(),
            stock: stock(Split::HeldOut, None).unwrap(),
            nets: (0..threads).map(|_| Nets::load(&args, &options).unwrap()).collect(),
            ways: ways(&args).unwrap(),
            seed: 1,
        };
        let mut subjects = plan::subjects(&bench.head, &bench.stock, 1).unwrap();
        assert_eq!(subjects.len(), 9 + 3 + 6 + 9 + 6);
        subjects.truncate(1); // straight on
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("page.csv");
        let mut ledger = Ledger::open(&path, "test").unwrap();
        bench.shoot(&subjects, Some(1), &mut ledger).unwrap();
        let first = ledger.shot(&subjects[0].what, "fit", 0).unwrap().clone();
        let mut ledger = Ledger::open(&path, "test").unwrap();
        bench.shoot(&subjects, args.shots, &mut ledger).unwrap();
        assert_eq!(ledger.shot(&subjects[0].what, "fit", 0), Some(&first));
        assert_ne!(ledger.shot(&subjects[0].what, "fit", 1), Some(&first), "another shot is another picture");
        let again = bench.shot(&subjects[0], 0, &[&bench.ways[0]], &bench.nets[0]).unwrap();
        assert_eq!(again, [("fit".to_owned(), first)], "the same shot, another result");

        let found = bench.found(&subjects, args.shots, &ledger, Vec::new());
        let (_, tallies) = found.of(Table::Poses).next().unwrap();
        for (tally, (_, way)) in tallies.iter().zip(&found.ways) {
            assert_eq!((tally.shots, tally.measured(), tally.wrong), (2, 2, 0), "{way}: {tally:?}");
        }
        let page = page::text(&found, &args, "EXPERIMENTS.svg");
        for expected in [
            "## Table 3",
            "straight on",
            "--shots 2 --seed 1 --least-confidence 0.9",
            "EXPERIMENTS.svg",
            "| 2 of 2 |",
        ] {
            assert!(page.contains(expected), "{expected} is missing in\n{page}");
        }
        assert!(figure::draw(&found).unwrap().contains("<svg"));
    }
}
