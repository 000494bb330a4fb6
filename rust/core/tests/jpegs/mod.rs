//! JPEGs for tests: recorded ones, small ones of any form, and places in them.
#![allow(dead_code)] // each test uses a part of it

use boxline::{ErrorKind, Frame};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use std::path::Path;

/// A recorded frame's file.
pub fn recorded(name: &str) -> Vec<u8> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data");
    std::fs::read(folder.join(name)).expect("the frame is in the repository")
}

/// Where the scan's header starts, and its data.
pub fn scan(jpeg: &[u8]) -> (usize, usize) {
    let header = jpeg.windows(2).position(|pair| pair == [0xff, 0xda]).expect("a scan");
    (header, header + 2 + usize::from(u16::from_be_bytes([jpeg[header + 2], jpeg[header + 3]])))
}

/// The JPEG without its segments of a kind.
pub fn without(jpeg: &[u8], kind: u8) -> Vec<u8> {
    let (header, _) = scan(jpeg);
    let mut left = jpeg[..2].to_vec();
    let mut at = 2;
    while at < header {
        let end = at + 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
        if jpeg[at + 1] != kind {
            left.extend_from_slice(&jpeg[at..end]);
        }
        at = end;
    }
    left.extend_from_slice(&jpeg[header..]);
    left
}

pub const SMALL: [u16; 2] = [203, 117];

/// A small picture with edges, gradients and noise; its sides are no multiples of a block.
pub fn small(form: impl FnOnce(&mut Encoder<&mut Vec<u8>>)) -> Vec<u8> {
    let mut numbers = fastrand::Rng::with_seed(7);
    let mut rgb = Vec::new();
    for y in 0..i32::from(SMALL[1]) {
        for x in 0..i32::from(SMALL[0]) {
            let noise = numbers.i32(..12);
            let check = if (x / 30 + y / 30) % 2 == 0 { 230 } else { 15 };
            rgb.extend([x + noise, 2 * y + noise, check + noise].map(|v| v.clamp(0, 255) as u8));
        }
    }
    let mut jpeg = Vec::new();
    let mut encoder = Encoder::new(&mut jpeg, 85);
    encoder.set_sampling_factor(SamplingFactor::F_2_2);
    form(&mut encoder);
    encoder.encode(&rgb, SMALL[0], SMALL[1], ColorType::Rgb).expect("the sizes fit");
    jpeg
}

/// What is wrong with a JPEG that must be refused.
pub fn refusal(jpeg: &[u8]) -> String {
    let error = Frame::from_jpeg(jpeg).expect_err("this frame must be refused");
    assert_eq!(error.kind(), ErrorKind::InvalidFrame, "{error}");
    error.to_string()
}
