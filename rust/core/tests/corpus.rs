//! The fuzz target on a toolchain without a fuzzer, see `uvc/tests/support/corpus.rs`.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

#[path = "../../../uvc/tests/support/corpus.rs"]
mod corpus;
#[path = "support/hostile.rs"]
mod hostile;
mod jpegs;

use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use std::path::Path;

/// A JPEG of 24 x 20 px.
fn tiny(colour: ColorType, bytes_per_px: usize, form: impl FnOnce(&mut Encoder<&mut Vec<u8>>)) -> Vec<u8> {
    let pixels: Vec<u8> = (0..24 * 20 * bytes_per_px).map(|i| (i * i / 7) as u8).collect();
    let mut jpeg = Vec::new();
    let mut encoder = Encoder::new(&mut jpeg, 60);
    form(&mut encoder);
    encoder.encode(&pixels, 24, 20, colour).unwrap();
    jpeg
}

#[test]
fn jpeg() {
    let plain = tiny(ColorType::Rgb, 3, |e| e.set_sampling_factor(SamplingFactor::F_2_2));
    let size = plain.windows(2).position(|pair| pair == [0xff, 0xc0]).unwrap() + 5;
    let mut huge = plain.clone();
    huge[size..size + 4].fill(0xff);
    let seeds = [
        ("without_tables", jpegs::without(&plain, 0xc4)),
        ("full_colour", tiny(ColorType::Rgb, 3, |e| e.set_sampling_factor(SamplingFactor::F_1_1))),
        ("wide_colour", tiny(ColorType::Rgb, 3, |e| e.set_sampling_factor(SamplingFactor::F_2_1))),
        ("grey", tiny(ColorType::Luma, 1, |_| {})),
        ("restarts", tiny(ColorType::Rgb, 3, |e| e.set_restart_interval(1))),
        ("progressive", tiny(ColorType::Rgb, 3, |e| e.set_progressive(true))),
        ("own_tables", tiny(ColorType::Rgb, 3, |e| e.set_optimized_huffman_tables(true))),
        ("cmyk", tiny(ColorType::Cmyk, 4, |_| {})),
        ("huge", huge),
        ("plain", plain),
    ];
    let seeds = seeds.map(|(name, bytes)| (name.to_owned(), bytes)).to_vec();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus/jpeg");
    corpus::run(&folder, seeds, Vec::new(), hostile::jpeg);
}
