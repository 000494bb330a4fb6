//! `boxline evaluate`: measures recordings whose truth is known and says how far off the results are.
//!
//! A few folders are told one by one ([`folders`]). Many, or rendered boxes, are scored: one row a side goes into a file ([`rows`]), from
//! which the numbers ([`summary`]), the page ([`page`]) and its pictures ([`figures`]) are made. The network's maps and the paper's
//! experiments are scored by themselves.

mod cause;
#[cfg(feature = "render")]
mod experiments;
mod figures;
mod folders;
mod in_order;
#[cfg(feature = "render")]
mod maps;
mod page;
#[cfg(feature = "render")]
mod perturb;
mod recorded;
mod rows;
mod score;
mod scored;
#[cfg(feature = "render")]
mod simulated;
mod statistics;
#[cfg(feature = "render")]
mod stock;
mod summary;
mod tables;

use crate::Finished;
use crate::args::EvaluateArgs;
use crate::input::Usage;
use crate::say::{say, text_of};
use indicatif::{ProgressBar, ProgressStyle};
#[cfg(feature = "render")]
use recorded::{Recorded, recordings_in};
use serde_json::{Value, json};
use std::path::Path;
pub use tables::table;

/// Runs `boxline evaluate`.
pub fn evaluate(args: &EvaluateArgs) -> anyhow::Result<Finished> {
    let scored = args.simulate.is_some() || !args.csv.is_empty() || args.report.is_some();
    if args.experiments || args.perturb || args.edges == Some(None) {
        return rendered(args);
    }
    if args.folders.is_empty() && args.simulate.is_none() {
        if args.report.is_some() && !args.csv.is_empty() {
            return scored::report_files(args);
        }
        let text = "a folder with recording.json and truth.json, --simulate, --edges alone, or --report with --csv is needed";
        return Err(Usage(text.into()).into());
    }
    if scored || args.overlays.is_some() { scored::evaluate(args) } else { folders::evaluate(args) }
}

/// What only renders.
#[cfg(feature = "render")]
fn rendered(args: &EvaluateArgs) -> anyhow::Result<Finished> {
    match &args.out {
        Some(page) if args.experiments => experiments::evaluate(args, page),
        _ if args.perturb => perturb::evaluate(args),
        _ => maps::evaluate(args),
    }
}

#[cfg(not(feature = "render"))]
fn rendered(_: &EvaluateArgs) -> anyhow::Result<Finished> {
    Err(no_renderer())
}

/// What `--simulate` and the like say without the renderer.
#[cfg(not(feature = "render"))]
fn no_renderer() -> anyhow::Error {
    let text = "--edges without a name, --simulate, --perturb and --experiments need the renderer, which this program was built without";
    Usage(text.into()).into()
}

/// Drawn on standard error, and only on a terminal.
fn progress_bar(steps: usize) -> anyhow::Result<ProgressBar> {
    let style = ProgressStyle::with_template("{bar:30} {pos}/{len} {elapsed} of {duration} {msg}")?;
    Ok(ProgressBar::new(steps as u64).with_style(style))
}

/// A recording that cannot be measured because its files are broken.
struct Broken {
    name: String,
    error: anyhow::Error,
}

impl From<(String, boxline::Error)> for Broken {
    fn from((name, error): (String, boxline::Error)) -> Self {
        Self { name, error: error.into() }
    }
}

impl Broken {
    fn of_folder(folder: &Path, error: anyhow::Error) -> Self {
        Self { name: recorded::long_name(folder), error }
    }

    /// The result with what was broken at its end: as text or, if there is one, as an object. Exit code 2 if anything was.
    fn finish(broken: &[Self], mut stdout: String, mut object: Value) -> Finished {
        for Self { name, error } in broken {
            let error = text_of(error);
            say(&format!("error: {name}: {error}"));
            stdout.push_str(&format!("!!! {name}: not evaluated: {error}\n"));
        }
        if !object.is_null() {
            let entry = |b: &Self| json!({"recording": b.name, "error": text_of(&b.error)});
            object["broken"] = json!(broken.iter().map(entry).collect::<Vec<_>>());
            stdout = object.to_string();
        }
        Finished { stdout, exit_code: if broken.is_empty() { 0 } else { crate::BROKEN_INPUT } }
    }
}
