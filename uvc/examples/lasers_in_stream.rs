//! Switches lasers in the middle of a stream of the head that is attached, and checks what the frames say of them: each frame
//! before a switch the old lasers, after it the new ones, and the frame that saw both that it did.

use boxline_uvc::head::Lasers;
use boxline_uvc::{Device, Selector, StreamSettings};
use std::time::Duration;

const PATIENCE: Duration = Duration::from_secs(3);
/// Frames that may be under way when lasers are switched: those that wait here, one on the wire, one in the sensor.
const ON_THE_WAY: usize = 8;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let device = Device::open(&Selector::default())?;
    let stream = device.start(&StreamSettings { waiting_frames: 30 })?;
    stream.next_frame(PATIENCE)?; // may tell of a switch before the stream
    let mut before = Lasers::OFF.bits();
    for lasers in [0b0001, 0b1010, 0b1111, 0b0000] {
        for _ in 0..3 {
            let said = stream.next_frame(PATIENCE)?.tag.ok_or("a frame without a tag")?;
            if said.lasers != before || said.switched {
                return Err(format!("{before:04b} are on, the frame says {said:?}").into());
            }
        }
        device.set_lasers(Lasers::from_bits(lasers)?)?;
        let mut old = 0;
        let first = loop {
            let said = stream.next_frame(PATIENCE)?.tag.ok_or("a frame without a tag")?;
            if said.lasers == lasers || said.switched {
                break said;
            }
            old += 1;
            if said.lasers != before || old > ON_THE_WAY {
                return Err(
                    format!("{before:04b} became {lasers:04b}, frame {old} after it says {said:?}").into()
                );
            }
        };
        println!("{before:04b} to {lasers:04b}: {old} frames more of the old lasers, then {first:?}");
        if !first.switched {
            return Err("no frame says that lasers were switched".into());
        }
        before = lasers;
    }
    println!("{:?}", stream.stop()?);
    Ok(())
}
