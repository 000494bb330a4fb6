//! One picture with all four lasers on, from the head on the cable: `cargo run --release -p boxline-uvc --example capture -- [FILE.jpg]`.

use boxline_uvc::head::Lasers;
use boxline_uvc::{Device, Error, Frame, Selector, StreamSettings};
use std::time::Duration;

/// The first frame whose whole exposure saw all lasers and no others. They go out with the stream.
pub fn lit_frame(device: &Device) -> Result<Frame, Error> {
    let stream = device.start(&StreamSettings { waiting_frames: 2 })?;
    device.set_lasers(Lasers::ALL)?;
    loop {
        let frame = stream.next_frame(Duration::from_secs(3))?;
        if frame.tag.is_some_and(|tag| tag.lasers == Lasers::ALL.bits() && !tag.switched) {
            return Ok(frame);
        }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = std::env::args().nth(1).unwrap_or_else(|| "frame.jpg".to_owned());
    let device = Device::open(&Selector::default())?;
    let frame = lit_frame(&device)?;
    std::fs::write(&file, &frame.jpeg)?;
    println!("{file}: {} bytes of head {}, {:?}", frame.jpeg.len(), device.serial(), frame.tag);
    Ok(())
}
