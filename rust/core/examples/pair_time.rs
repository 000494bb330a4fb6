//! Processor time, wall time on two threads and peak memory of a whole pair without network, from two JPEGs in memory to a result:
//!
//! ```text
//! cargo run --release -p boxline --example pair_time -- tests/data/b02 [loops]
//! ```
//! `tests/turbo/decode.c` says what libjpeg-turbo takes to decode the two alone; `rust/SPEED.md` compares. Processor
//! time of one thread does not depend on who else uses the machine, but for caches and clock. Linux only: reads /proc.

use boxline::{EdgeMethod, Frame, Settings, StageTimes, Workers, measure_box};
use boxline_proto::json::{read_calibration, read_recording};
use std::path::PathBuf;
use std::time::Instant;

/// A number of `/proc/self/<file>` after a name.
fn proc_number(file: &str, name: &str) -> f64 {
    let text = std::fs::read_to_string(format!("/proc/self/{file}")).unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix(name)).unwrap_or_default();
    line.split_whitespace().next().and_then(|n| n.parse().ok()).unwrap_or(f64::NAN)
}

/// Time on the processor so far, ms.
fn processor_ms() -> f64 {
    std::thread::yield_now(); // the kernel counts when it switches
    proc_number("schedstat", "") * 1e-6
}

/// A second thread for the second frame.
struct TwoThreads;

impl Workers for TwoThreads {
    fn both(&self, first: &mut (dyn FnMut() + Send), second: &mut (dyn FnMut() + Send)) {
        std::thread::scope(|scope| {
            scope.spawn(second);
            first();
        });
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("a recording's folder is needed")?);
    let loops: usize = arguments.next().map_or(Ok(15), |n| n.parse())?;
    let recording = read_recording(&folder)?;
    let calibration = read_calibration(&recording.calibration_file)?;
    let jpegs = ["a", "b"].map(|id| {
        let frame = recording.frames.iter().find(|f| f.id == id);
        frame.map(|f| std::fs::read(&f.file)).transpose().ok().flatten().unwrap_or_default()
    });
    let settings = Settings { edges: EdgeMethod::Gradient, ..Settings::default() };
    let (mut decode, mut whole, mut wall) = (Vec::new(), Vec::new(), Vec::new());
    let mut stages: Vec<(&str, f64)> = Vec::new();
    for _ in 0..loops {
        let start = processor_ms();
        let frames = [Frame::from_jpeg(&jpegs[0])?, Frame::from_jpeg(&jpegs[1])?];
        let decoded = processor_ms();
        let mut times = StageTimes::new();
        measure_box(&[&frames[0], &frames[1]], &calibration, &settings, &mut times)?;
        whole.push(processor_ms() - start);
        decode.push(decoded - start);
        let side_by_side = Settings { workers: Some(&TwoThreads), ..settings };
        let start = Instant::now();
        let (mut a, mut b) = (None, None);
        TwoThreads.both(&mut || a = Some(Frame::from_jpeg(&jpegs[0])), &mut || {
            b = Some(Frame::from_jpeg(&jpegs[1]));
        });
        if let (Some(a), Some(b)) = (a, b) {
            measure_box(&[&a?, &b?], &calibration, &side_by_side, &mut StageTimes::new())?;
        }
        wall.push(start.elapsed().as_secs_f64() * 1e3);
        for (stage, nanos) in times {
            let ms = nanos as f64 * 1e-6;
            match stages.iter_mut().find(|(name, _)| *name == stage) {
                Some((_, least)) => *least = least.min(ms),
                None => stages.push((stage, ms)),
            }
        }
    }
    let named = [
        ("processor time: decode both, zune-jpeg", decode),
        ("processor time: whole pair", whole),
        ("wall time: whole pair on two threads", wall),
    ];
    for (name, mut times) in named {
        times.sort_by(f64::total_cmp);
        println!("{name}: median {:.1} ms, least {:.1} ms of {loops}", times[loops / 2], times[0]);
    }
    for (stage, least) in stages {
        println!("  {stage}: least {least:.1} ms of wall time");
    }
    println!("peak memory: {:.0} MB", proc_number("status", "VmHWM:") / 1024.0);
    Ok(())
}
