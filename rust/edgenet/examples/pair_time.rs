//! Processor time of a whole pair with the network, from two JPEGs in memory to a result, on one thread, and its stages:
//!
//! ```text
//! cargo run --release -p boxline-edgenet --example pair_time -- tests/data/b02 [loops]
//! ```
//! As the example of the same name in `rust/core`, which measures without a network. Linux only: reads /proc.

use boxline::{Frame, Settings, StageTimes, measure_box};
use boxline_edgenet::{EdgeNet, Options};
use boxline_proto::json::{read_calibration, read_recording};
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Instant;

/// Time on the processor so far, ms.
fn processor_ms() -> f64 {
    std::thread::yield_now(); // the kernel counts when it switches
    let text = std::fs::read_to_string("/proc/self/schedstat").unwrap_or_default();
    text.split_whitespace().next().and_then(|n| n.parse::<f64>().ok()).map_or(f64::NAN, |nanos| nanos * 1e-6)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
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
    let network = EdgeNet::embedded(&Options { threads: NonZeroUsize::MIN, ..Options::default() })?;
    let loaded_ms = start.elapsed().as_secs_f64() * 1e3;
    let settings = Settings { network: Some(&network), ..Settings::default() };
    let (mut decode, mut whole) = (f64::MAX, Vec::new());
    let mut stages: Vec<(&str, f64)> = Vec::new();
    for _ in 0..loops {
        let start = processor_ms();
        let frames = [Frame::from_jpeg(&jpegs[0])?, Frame::from_jpeg(&jpegs[1])?];
        decode = f64::min(decode, processor_ms() - start);
        let mut times = StageTimes::new();
        measure_box(&[&frames[0], &frames[1]], &calibration, &settings, &mut times)?;
        whole.push(processor_ms() - start);
        for (name, nanos) in times {
            let ms = nanos as f64 * 1e-6;
            match stages.iter_mut().find(|(known, _)| *known == name) {
                Some((_, least)) => *least = least.min(ms),
                None => stages.push((name, ms)),
            }
        }
    }
    let least = whole.iter().copied().fold(f64::MAX, f64::min);
    println!(
        "{}: {} loaded in {loaded_ms:.1} ms; decoding {decode:.1} ms, a pair {least:.1} ms, the first {:.1} ms",
        folder.display(),
        network.runtime_name(),
        whole.first().copied().unwrap_or(f64::NAN)
    );
    for (name, ms) in stages {
        println!("  {name} {ms:.1} ms");
    }
    Ok(())
}
