//! The descriptors of the software head: one camera, the head's extension unit, and a stream that is bulk or isochronous.

use super::{Pipe, Settings};
use crate::descriptor::UvcVersion;
use crate::head::{Control, GUID};
use crate::mode::{PREFERRED_INTERVAL, PREFERRED_SIZE};

/// Vendor's number: pid.codes, which lends numbers for tests.
pub const VENDOR_ID: u16 = 0x1209;
/// Product's number: one of those set aside for tests.
pub const PRODUCT_ID: u16 = 0x0001;
/// Number of the extension unit.
pub const EXTENSION_UNIT: u8 = 3;
/// The stream's endpoint.
pub const STREAM_ENDPOINT: u8 = 0x81;
/// dwClockFrequency.
pub const CLOCK_HZ: u32 = 1_000_000;
/// dwMaxVideoFrameBufferSize.
pub const MAX_VIDEO_FRAME_BYTES: u32 = 5_000_000;
/// wMaxPacketSize of the alternate settings 1, 2, 3 of an isochronous stream: 1, 2, 3 packets of 1024 in a microframe.
pub const ISO_PACKETS: [u16; 3] = [0x0400, 0x0C00, 0x1400];
const BULK_PACKET: u16 = 512;
/// 5 frames a second, for slow buses.
const SLOW_INTERVAL: u32 = 2_000_000;

/// The device descriptor.
pub fn device() -> Vec<u8> {
    let mut d = vec![18, 1];
    d.extend(0x0200u16.to_le_bytes());
    d.extend([0xEF, 2, 1, 64]); // class by interface association
    d.extend(VENDOR_ID.to_le_bytes());
    d.extend(PRODUCT_ID.to_le_bytes());
    d.extend(0x0100u16.to_le_bytes());
    d.extend([1, 2, 3, 1]); // strings: maker, product, serial number; one configuration
    d
}

/// The configuration with all that belongs to it.
pub fn configuration(settings: &Settings) -> Vec<u8> {
    let mut c = vec![9, 2, 0, 0, 2, 1, 0, 0x80, 250];
    c.extend([8, 0x0B, 0, 2, 0x0E, 3, 0, 2]); // the two interfaces are one camera
    c.extend([9, 4, 0, 0, 0, 0x0E, 1, 0, 2]);
    c.extend(with_total(control_block(settings.version), 5));
    let endpoints = u8::from(settings.pipe == Pipe::Bulk && settings.bulk_alternate == 0);
    c.extend([9, 4, 1, 0, endpoints, 0x0E, 2, 0, 0]);
    c.extend(with_total(streaming_block(), 4));
    match settings.pipe {
        Pipe::Bulk => {
            if settings.bulk_alternate > 0 {
                c.extend([9, 4, 1, settings.bulk_alternate, 1, 0x0E, 2, 0, 0]);
            }
            c.extend(endpoint(2, BULK_PACKET, 0));
        }
        Pipe::Isochronous => {
            for (setting, packet) in (1..).zip(ISO_PACKETS) {
                c.extend([9, 4, 1, setting, 1, 0x0E, 2, 0, 0]);
                c.extend(endpoint(5, packet, 1));
            }
        }
    }
    with_total(c, 2)
}

fn endpoint(attributes: u8, packet: u16, interval: u8) -> [u8; 7] {
    let [low, high] = packet.to_le_bytes();
    [7, 5, STREAM_ENDPOINT, attributes, low, high, interval]
}

/// Writes the length of all bytes at `at`.
fn with_total(mut bytes: Vec<u8>, at: usize) -> Vec<u8> {
    let total = u16::try_from(bytes.len()).unwrap_or(u16::MAX); // some hundred
    bytes[at..at + 2].copy_from_slice(&total.to_le_bytes());
    bytes
}

fn control_block(version: UvcVersion) -> Vec<u8> {
    let mut c = vec![13, 0x24, 1];
    c.extend(version.bcd().to_le_bytes());
    c.extend([0, 0]);
    c.extend(CLOCK_HZ.to_le_bytes());
    c.extend([1, 1]);
    // Camera terminal 1 without controls, then the extension unit, which feeds output terminal 2.
    c.extend([18, 0x24, 2, 1, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0]);
    c.extend([26, 0x24, 6, EXTENSION_UNIT]);
    c.extend(GUID);
    let all = (1u32 << Control::ALL.len()) - 1;
    c.extend([8, 1, 1, 1, all.to_le_bytes()[0], 0]);
    c.extend([9, 0x24, 3, 2, 0x01, 0x01, 0, EXTENSION_UNIT, 0]);
    c
}

fn streaming_block() -> Vec<u8> {
    let mut s = vec![14, 0x24, 1, 1, 0, 0, STREAM_ENDPOINT, 0, 2, 0, 0, 0, 1, 0];
    s.extend([11, 0x24, 6, 1, 1, 1, 1, 0, 0, 0, 0]);
    let (width, height) = PREFERRED_SIZE;
    s.extend([26 + 8, 0x24, 7, 1, 0]);
    s.extend(width.to_le_bytes());
    s.extend(height.to_le_bytes());
    for interval in [SLOW_INTERVAL, PREFERRED_INTERVAL] {
        let bits_per_second = u64::from(MAX_VIDEO_FRAME_BYTES) * 8 * 10_000_000 / u64::from(interval);
        s.extend(u32::try_from(bits_per_second).unwrap_or(u32::MAX).to_le_bytes());
    }
    s.extend(MAX_VIDEO_FRAME_BYTES.to_le_bytes());
    s.extend(PREFERRED_INTERVAL.to_le_bytes());
    s.push(2);
    s.extend(PREFERRED_INTERVAL.to_le_bytes());
    s.extend(SLOW_INTERVAL.to_le_bytes());
    s.extend([6, 0x24, 0x0D, 1, 1, 4]); // colours: sRGB
    s
}

/// String descriptors: languages, maker, product, serial number.
pub fn string(index: u8, serial: &str) -> Option<Vec<u8>> {
    let text = match index {
        0 => return Some(vec![4, 3, 0x09, 0x04]),
        1 => "boxline",
        2 => "Laser head (software)",
        3 => serial,
        _ => return None,
    };
    let utf16: Vec<u8> = text.encode_utf16().take(126).flat_map(u16::to_le_bytes).collect();
    let length = u8::try_from(utf16.len() + 2).unwrap_or(u8::MAX); // at most 254
    Some([vec![length, 3], utf16].concat())
}
