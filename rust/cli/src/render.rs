//! `boxline render`: recordings whose truth is known, or labelled frames for training, from `rust/sim`.

use crate::Finished;
use crate::args::RenderArgs;
use crate::input::Usage;
use anyhow::Context;
use boxline_sim::recording::{HeadHold, Recipe, write_recording};
use boxline_sim::stream::{sample, write_stream};
use boxline_sim::views::write_views;
use boxline_sim::{Split, Stock};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Frames that `--time` renders unless told otherwise: some ten seconds.
const TIMED_FRAMES: u64 = 200;

/// Runs `boxline render`.
pub fn render(args: &RenderArgs) -> anyhow::Result<Finished> {
    let split = if args.held_out { Split::HeldOut } else { Split::Training };
    let mut stock = match &args.photos {
        Some(folder) => Stock::with_photos(split, folder)?,
        None => Stock::new(split),
    };
    stock.hazards = args.hazards;
    if args.time {
        return time(args, &stock);
    }
    let Some(out) = args.out.as_deref() else {
        if args.json {
            return Err(Usage("--stream writes frames, not JSON; --json goes with --time".into()).into());
        }
        // Frames go out as they are made: nothing else may be printed.
        let mut out = BufWriter::new(std::io::stdout().lock());
        if args.views {
            write_views(&mut out, args.seed, args.count, &stock)?;
        } else {
            write_stream(&mut out, args.seed, args.count, &stock)?;
        }
        return Ok(Finished { stdout: String::new(), exit_code: 0 });
    };
    recordings(args, out, &stock)
}

fn recordings(args: &RenderArgs, out: &Path, stock: &Stock) -> anyhow::Result<Finished> {
    let count = args.count.unwrap_or(1);
    let last = args.seed.checked_add(count).context("--seed and --count: too large together")?;
    let folders: Vec<(u64, PathBuf)> =
        (args.seed..last).map(|seed| (seed, out.join(format!("{seed:03}")))).collect();
    if let Some((_, taken)) = folders.iter().find(|(_, folder)| folder.exists()) {
        return Err(Usage(format!("{}: is there already; nothing is overwritten", taken.display())).into());
    }
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let kind = args.kind.of(args.frames);
    // Drawn on standard error, and only on a terminal.
    let progress = ProgressBar::new(count).with_style(ProgressStyle::with_template("{bar:30} {pos}/{len}")?);
    for (seed, folder) in &folders {
        let recipe = Recipe {
            off: args.off.then_some(if args.still { HeadHold::Still } else { HeadHold::Hand }),
            head: args.head.kind(),
            faults: args.faults,
            ..Recipe::new(*seed, kind)
        };
        // A recording appears whole or not at all: it is written beside its place and then moved there.
        let beside = tempfile::Builder::new()
            .prefix(".boxline-")
            .tempdir_in(out)
            .with_context(|| out.display().to_string())?;
        let unfinished = beside.path().join("recording");
        write_recording(&unfinished, &recipe, stock)?;
        std::fs::rename(&unfinished, folder).with_context(|| folder.display().to_string())?;
        progress.inc(1);
    }
    progress.finish_and_clear();
    let names: Vec<String> = folders.iter().map(|(_, folder)| folder.display().to_string()).collect();
    let stdout = if args.json {
        json!({"outcome": "rendered", "split": stock.split.word(), "recordings": names}).to_string()
    } else {
        names.join("\n")
    };
    Ok(Finished { stdout, exit_code: 0 })
}

/// How fast labelled frames are made on this machine.
fn time(args: &RenderArgs, stock: &Stock) -> anyhow::Result<Finished> {
    let count = args.count.unwrap_or(TIMED_FRAMES);
    sample(args.seed, stock)?; // makes what is made once: tiles of noise
    let (wall, processor) = (Instant::now(), processor_seconds());
    for n in 0..count {
        std::hint::black_box(sample(args.seed.wrapping_add(n), stock)?);
    }
    let (wall, processor) = (wall.elapsed().as_secs_f64(), processor_seconds() - processor);
    let per = |seconds: f64| (count as f64 / seconds * 10.0).round() / 10.0;
    let (wall, processor) = (per(wall), per(processor));
    let stdout = if args.json {
        json!({"outcome": "timed", "frames": count, "per_second": wall, "per_processor_second": processor})
            .to_string()
    } else {
        format!("{count} frames: {processor} a second of processor time, {wall} of wall time")
    };
    Ok(Finished { stdout, exit_code: 0 })
}

/// Processor time of this process from Linux's counter in hundredths of a second; 0 elsewhere.
fn processor_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The name may have spaces; after it come the state (a letter) and numbers, of which utime and stime are the 11th and 12th.
    let numbers: Vec<f64> =
        stat.rsplit(')').next().unwrap_or("").split_whitespace().filter_map(|t| t.parse().ok()).collect();
    numbers.get(10).zip(numbers.get(11)).map_or(0.0, |(user, system)| (user + system) / 100.0)
}
