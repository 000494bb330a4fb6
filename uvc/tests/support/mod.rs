//! Pictures for the software head: not decodable, but each different, so that a mixed-up frame is seen.
#![allow(dead_code)] // each test program uses its part

use boxline_uvc::emulator::{Fault, FrameRequest, Source};
use std::sync::Arc;

/// SOI, bytes that depend on the number and hold no marker, EOI.
pub fn picture(number: u64, bytes: usize) -> Vec<u8> {
    let mut jpeg = vec![0xFF, 0xD8];
    let mut random = fastrand::Rng::with_seed(number);
    jpeg.resize_with(bytes - 2, || random.u8(..0x80));
    jpeg.extend([0xFF, 0xD9]);
    jpeg
}

/// How large picture `number` is: 2 kB to `most`.
pub fn size_of(number: u64, most: usize) -> usize {
    2000 + (number.wrapping_mul(2_654_435_761) % (most as u64 - 2000 + 1)) as usize
}

/// `count` pictures of up to `most` bytes.
pub fn pictures(count: u64, most: usize) -> Source {
    Box::new(move |shot: FrameRequest| {
        (shot.number < count).then(|| Arc::from(picture(shot.number, size_of(shot.number, most))))
    })
}

/// Every fault that can spoil a frame without the connection's doing.
pub const FAULTS: [Fault; 13] = [
    Fault::LostEof,
    Fault::StuckFid,
    Fault::ErrorBit,
    Fault::LostPayload,
    Fault::TwicePayload,
    Fault::TornJpeg,
    Fault::NotJpeg,
    Fault::Huge,
    Fault::HeaderLength(0),
    Fault::HeaderLength(1),
    Fault::HeaderLength(3),
    Fault::TooLongHeader,
    Fault::Vanished,
];
