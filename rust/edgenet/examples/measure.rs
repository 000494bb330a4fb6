//! A box from two pictures, with the networks: `cargo run --release -p boxline-edgenet --example measure -- [FOLDER]`.

use boxline::{Frame, Outcome, Settings, measure_box};
use boxline_edgenet::{EdgeNet, Options};
use boxline_proto::json::{RecordedFrame, read_calibration, read_recording};
use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "tests/data/b02".to_owned()));
    let recording = read_recording(&folder)?;
    let calibration = read_calibration(&recording.calibration_file)?;
    let read =
        |frame: &RecordedFrame| Ok::<_, Box<dyn Error>>(Frame::from_jpeg(&std::fs::read(&frame.file)?)?);
    let mut frames = Vec::new();
    for id in ["a", "b"] {
        let recorded = recording.frames.iter().find(|frame| frame.id == id).ok_or("no frames a and b")?;
        let mut frame = read(recorded)?;
        // The same view with the lasers off, if there is one: in the difference only the lasers' light is left.
        if let Some(off) = recording.twin_of(recorded) {
            frame.add_ambient(&read(off)?)?;
        }
        frames.push(frame);
    }

    let network = EdgeNet::embedded(&Options::default())?;
    let settings = Settings { network: Some(&network), ..Settings::default() };
    let report = measure_box(&[&frames[0], &frames[1]], &calibration, &settings)?;
    match &report.outcome {
        Outcome::Measured(size) => {
            for (name, side) in [("length", size.length), ("width", size.width), ("height", size.height)] {
                println!("{name:6} {:7.2} ± {:.2} mm", side.value_mm, side.sigma_mm);
            }
        }
        Outcome::Ambiguous([first, second]) => println!("one of two boxes: {first:?}, {second:?}"),
        Outcome::Rejected(reason) => println!("not measured: {reason}; how to move: {:?}", report.hints),
    }
    Ok(())
}
