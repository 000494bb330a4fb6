//! Attaches a head whose descriptors are broken in one of three ways, for the test that Linux refuses them: `broken_head 0|1|2`.

use boxline_uvc::emulator::{Settings, SoftwareHead, usbip};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let which: usize = std::env::args().nth(1).ok_or("which? 0, 1 or 2")?.parse()?;
    // What precedes the byte, where it is from there, and what is put there.
    let (pattern, at, byte): (&[u8], usize, u8) = [
        (&[26, 0x24, 6][..], 0, 25), // an extension unit one byte short
        (&[14, 0x24, 1][..], 8, 77), // a stream that is fed by no terminal
        (&[34, 0x24, 7][..], 0, 20), // a frame size that ends early
    ]
    .get(which)
    .copied()
    .ok_or("which? 0, 1 or 2")?;
    let head = SoftwareHead::new(Settings::default(), Box::new(|_| None));
    let (_, mut configuration) = head.descriptors();
    let start = configuration.windows(3).position(|window| window == pattern).ok_or("no such descriptor")?;
    configuration[start + at] = byte;
    let (_, result) =
        usbip::attach(head.with_configuration(configuration), Path::new("/sys/devices/platform/vhci_hcd.0"));
    Ok(result?)
}
