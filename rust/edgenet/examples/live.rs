//! A live view with nobody before the head: recorded frames again and again, as JPEGs. Says what a followed frame takes and what one that is
//! looked at in full, on one thread, and whether memory is steady:
//!
//! ```text
//! cargo run --release -p boxline-edgenet --example live -- tests/data/b02 [frames]
//! ```
//! Each of the recording's two faces stays in view for a while. Fails if no frame is followed, or if memory grows. Linux only: reads /proc.

mod processor;

use boxline::{Frame, LiveFace, Network, Settings, Tracker};
use boxline_edgenet::{EdgeNet, Options};
use boxline_proto::json::{read_calibration, read_recording};
use processor::{proc_number, processor_ms};
use std::num::NonZeroUsize;
use std::path::PathBuf;

/// Frames for which a face stays in view.
const STAYS: usize = 40;
/// Frames after which all buffers have been used.
const SETTLED: usize = 200;
/// Growth from then on that is none, kB: the heap takes and gives back pages. A leak of a kB and a quarter a frame is more in 2000 frames.
const STEADY_KB: f64 = 2048.0;

/// Median and least.
fn print(what: &str, times: &mut [f64]) {
    times.sort_by(f64::total_cmp);
    if let (Some(median), Some(least)) = (times.get(times.len() / 2), times.first()) {
        println!(
            "{} frames {what}: median {median:.1} ms of processor time, least {least:.1} ms",
            times.len()
        );
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("a recording's folder is needed")?);
    let frames: usize = arguments.next().map_or(Ok(400), |n| n.parse())?;
    let recording = read_recording(&folder)?;
    let calibration = read_calibration(&recording.calibration_file)?;
    let mut jpegs = Vec::new();
    for id in ["a", "b"] {
        let frame = recording.frames.iter().find(|f| f.id == id).ok_or("a and b are needed")?;
        jpegs.push(std::fs::read(&frame.file)?);
    }
    let network = EdgeNet::embedded(&Options { threads: NonZeroUsize::MIN, ..Options::default() })?;
    let settings = Settings { network: Some(&network as &dyn Network), ..Settings::default() };
    let mut tracker = Tracker::default();
    let (mut followed, mut looked) = (Vec::new(), Vec::new());
    let mut settled_kb = f64::NAN;
    for n in 0..frames {
        let jpeg = &jpegs[n / STAYS % jpegs.len()];
        let start = processor_ms();
        let frame = Frame::from_jpeg(jpeg)?;
        let seen = tracker.next(&frame, &calibration, &settings)?;
        let times = if matches!(seen, LiveFace::Followed(_)) { &mut followed } else { &mut looked };
        times.push(processor_ms() - start);
        if n == SETTLED {
            settled_kb = proc_number("status", "VmRSS:");
        }
    }
    print("followed", &mut followed);
    print("looked at", &mut looked);
    let kb = proc_number("status", "VmRSS:");
    println!("resident memory: {settled_kb:.0} kB after {SETTLED} frames, {kb:.0} kB after {frames}");
    if followed.is_empty() {
        return Err("no frame was followed: the faces cannot be measured".into());
    }
    if frames > SETTLED && (kb.is_nan() || kb - settled_kb > STEADY_KB) {
        return Err(format!("memory grew by {:.0} kB, {STEADY_KB} are allowed", kb - settled_kb).into());
    }
    Ok(())
}
