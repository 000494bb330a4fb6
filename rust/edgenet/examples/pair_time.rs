//! Processor time, wall time on two threads and peak memory of a whole pair, from two JPEGs in memory to a result, and its stages:
//!
//! ```text
//! cargo run --release -p boxline-edgenet --example pair_time -- tests/data/b02 [loops] [gradient]
//! ```
//! With the network on one thread or, with the word `gradient`, without any. `tests/turbo/decode.c` says what libjpeg-turbo takes to decode
//! the two alone; `rust/SPEED.md` compares. Processor time of one thread does not depend on who else uses the machine, but for caches and
//! clock. Linux only: reads /proc.

mod processor;

use boxline::{EdgeMethod, Frame, Network, Settings, Workers, measure_box};
use boxline_edgenet::{EdgeNet, Options};
use boxline_proto::json::{read_calibration, read_recording};
use processor::{proc_number, processor_ms};
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Instant;

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
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let gradient = arguments.pop_if(|word| word == "gradient").is_some();
    let mut arguments = arguments.into_iter();
    let folder = PathBuf::from(arguments.next().ok_or("a recording's folder is needed")?);
    let loops: usize = arguments.next().map_or(Ok(15), |n| n.parse())?;
    let recording = read_recording(&folder)?;
    let calibration = read_calibration(&recording.calibration_file)?;
    let read = |id: &str| {
        let frame = recording.frames.iter().find(|f| f.id == id).ok_or("a and b are needed")?;
        Ok::<_, Box<dyn std::error::Error>>(std::fs::read(&frame.file)?)
    };
    let jpegs = [read("a")?, read("b")?];
    let start = Instant::now();
    let one_thread = Options { threads: NonZeroUsize::MIN, ..Options::default() };
    let network = (!gradient).then(|| EdgeNet::embedded(&one_thread)).transpose()?;
    if let Some(network) = &network {
        let ms = start.elapsed().as_secs_f64() * 1e3;
        println!("network: {} loaded in {ms:.1} ms", network.runtime_name());
    }
    let edges = if gradient { EdgeMethod::Gradient } else { EdgeMethod::Net };
    let network = network.as_ref().map(|network| network as &dyn Network);
    let settings = Settings { edges, network, ..Settings::default() };
    let (mut decode, mut whole, mut wall) = (Vec::new(), Vec::new(), Vec::new());
    let mut stages: Vec<(&str, f64)> = Vec::new();
    for _ in 0..loops {
        let start = processor_ms();
        let frames = [Frame::from_jpeg(&jpegs[0])?, Frame::from_jpeg(&jpegs[1])?];
        let decoded = processor_ms();
        let times = measure_box(&[&frames[0], &frames[1]], &calibration, &settings)?.times;
        whole.push(processor_ms() - start);
        decode.push(decoded - start);
        let side_by_side = Settings { workers: Some(&TwoThreads), ..settings };
        let start = Instant::now();
        let (mut a, mut b) = (None, None);
        TwoThreads.both(&mut || a = Some(Frame::from_jpeg(&jpegs[0])), &mut || {
            b = Some(Frame::from_jpeg(&jpegs[1]));
        });
        if let (Some(a), Some(b)) = (a, b) {
            measure_box(&[&a?, &b?], &calibration, &side_by_side)?;
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
        ("processor time: decode both", decode),
        ("processor time: whole pair", whole),
        ("wall time: whole pair on two threads", wall),
    ];
    for (name, mut times) in named {
        let first = times.first().copied().ok_or("a loop at least is needed")?;
        times.sort_by(f64::total_cmp);
        println!(
            "{name}: median {:.1} ms, least {:.1} ms of {loops}, the first {first:.1} ms",
            times[loops / 2],
            times[0]
        );
    }
    for (stage, least) in stages {
        println!("  {stage}: least {least:.1} ms of wall time");
    }
    println!("peak memory: {:.0} MB", proc_number("status", "VmHWM:") / 1024.0);
    Ok(())
}
