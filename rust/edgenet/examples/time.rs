//! Milliseconds and peak memory of networks on both runtimes, side by side in one run:
//! `cargo run --release -p boxline-edgenet --example time -- [--threads 1] [--runs 20] [--json] [MODEL.onnx ...]`.
//!
//! Without a file it times the embedded network, and the making of its input from a 5-megapixel frame. ONNX Runtime is timed if
//! `ORT_DYLIB_PATH` names its library. Every pair of file and runtime runs in a process of its own (this program
//! again, with `--only`), so that peak memory (VmHWM, Linux) is that pair's; pairs take turns, so that other work on the
//! machine touches all of them. The least of all runs is printed: what disturbs only adds.

use boxline::Frame;
use boxline::network::Network;
use boxline_edgenet::{EdgeNet, Engine, Options, Runtime};
use std::error::Error;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

type Outcome<T> = Result<T, Box<dyn Error>>;

fn main() -> Outcome<()> {
    let (mut threads, mut runs, mut json, mut only) = (NonZeroUsize::MIN, 20usize, false, None);
    let mut models = Vec::new();
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or_else(|| format!("{argument} needs a value"));
        match argument.as_str() {
            "--threads" => threads = value()?.parse()?,
            "--runs" => runs = value()?.parse::<usize>()?.max(1),
            "--json" => json = true,
            "--only" => only = Some(value()?),
            _ => models.push(PathBuf::from(argument)),
        }
    }
    if let Some(runtime) = only {
        let timed = time(models.first().map(PathBuf::as_path), &runtime, threads, runs)?;
        println!("{} {} {}", timed.best_ms, timed.whole_ms, timed.peak_mb);
        return Ok(());
    }
    let mut runtimes = vec!["embedded"];
    if std::env::var_os("ORT_DYLIB_PATH").is_some() {
        runtimes.insert(0, "ort");
    }
    let files: Vec<Option<&Path>> =
        if models.is_empty() { vec![None] } else { models.iter().map(|m| Some(m.as_path())).collect() };
    let mut rows = Vec::new();
    for file in &files {
        for runtime in &runtimes {
            rows.push((*file, *runtime, Timed { best_ms: f64::MAX, whole_ms: f64::MAX, peak_mb: 0.0 }));
        }
    }
    for _ in 0..3 {
        for (file, runtime, best) in &mut rows {
            let timed = in_own_process(*file, runtime, threads, runs)?;
            best.best_ms = best.best_ms.min(timed.best_ms);
            best.whole_ms = best.whole_ms.min(timed.whole_ms);
            best.peak_mb = best.peak_mb.max(timed.peak_mb);
        }
    }
    for (file, runtime, timed) in rows {
        let name = file.map_or("embedded".into(), |f| f.display().to_string());
        let Timed { best_ms, whole_ms, peak_mb } = timed;
        let input_ms = whole_ms - best_ms;
        if json {
            println!(
                r#"{{"model":{name:?},"runtime":"{runtime}","threads":{threads},"ms":{best_ms:.2},"input_ms":{input_ms:.2},"peak_mb":{peak_mb:.1}}}"#
            );
        } else {
            println!(
                "{name:40} {runtime:8} {threads} threads {best_ms:8.1} ms, input {input_ms:4.1} ms, peak {peak_mb:5.0} MB"
            );
        }
    }
    Ok(())
}

struct Timed {
    /// A run of the network.
    best_ms: f64,
    /// The same with a 5-megapixel frame to start from; of a file, the run alone.
    whole_ms: f64,
    peak_mb: f64,
}

fn in_own_process(file: Option<&Path>, runtime: &str, threads: NonZeroUsize, runs: usize) -> Outcome<Timed> {
    let mut command = Command::new(std::env::current_exe()?);
    command
        .args(["--only", runtime, "--threads", &threads.to_string(), "--runs", &runs.to_string()])
        .args(file);
    let output = command.output()?;
    if !output.status.success() {
        return Err(format!("{runtime}: {}", String::from_utf8_lossy(&output.stderr)).into());
    }
    let text = String::from_utf8(output.stdout)?;
    let mut numbers = text.split_whitespace().map(str::parse::<f64>);
    let mut next = || -> Outcome<f64> { Ok(numbers.next().ok_or("a number is missing")??) };
    Ok(Timed { best_ms: next()?, whole_ms: next()?, peak_mb: next()? })
}

fn time(file: Option<&Path>, runtime: &str, threads: NonZeroUsize, runs: usize) -> Outcome<Timed> {
    let runtime = if runtime == "embedded" {
        Runtime::Embedded
    } else {
        Runtime::OnnxRuntime(std::env::var_os("ORT_DYLIB_PATH").ok_or("ORT_DYLIB_PATH is not set")?.into())
    };
    let options = Options { runtime, threads };
    let Some(file) = file else {
        // As in the product: a whole frame in, maps out. What the frame adds to the network's time is its input.
        let frame =
            Frame::from_rgb(2592, 1944, (0..2592 * 1944 * 3).map(|i| (i * 31 % 253) as u8).collect())?;
        let bytes = include_bytes!("../models/boxnet.onnx");
        let engine = Engine::load(bytes, 3, &options)?;
        let input = vec![0.0; engine.input_len()];
        let best_ms = best_of(runs, || engine.run(&input).map(drop))?;
        drop(engine);
        let net = EdgeNet::embedded(&options)?;
        let whole_ms = best_of(runs, || net.maps(&frame).map(drop))?;
        return Ok(Timed { best_ms, whole_ms, peak_mb: peak_mb() });
    };
    let engine = Engine::load(&std::fs::read(file)?, 3, &options)?;
    let input: Vec<f32> = (0..engine.input_len()).map(|i| (i * 31 % 253) as f32 / 255.0).collect();
    let best_ms = best_of(runs, || engine.run(&input).map(drop))?;
    Ok(Timed { best_ms, whole_ms: best_ms, peak_mb: peak_mb() })
}

/// The least time of several runs after one that warms up, ms.
fn best_of(runs: usize, mut run: impl FnMut() -> Result<(), boxline::Error>) -> Outcome<f64> {
    run()?;
    let mut best_ms = f64::MAX;
    for _ in 0..runs {
        let start = Instant::now();
        run()?;
        best_ms = best_ms.min(start.elapsed().as_secs_f64() * 1e3);
    }
    Ok(best_ms)
}

/// Most memory this process ever had resident, MB of 10^6 bytes; 0 where the kernel does not say.
fn peak_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|l| l.split_whitespace().next()?.parse::<f64>().ok()).map_or(0.0, |kib| kib * 1024e-6)
}
