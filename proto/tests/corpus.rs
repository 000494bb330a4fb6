//! The fuzz targets on a toolchain without a fuzzer, see `uvc/tests/support/corpus.rs`.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

#[path = "../../uvc/tests/support/corpus.rs"]
mod corpus;
#[path = "support/hostile.rs"]
mod hostile;
#[path = "support/samples.rs"]
mod samples;

use boxline::{Outcome, Reject};
use boxline_proto::json::{read_calibration, read_recording};
use boxline_proto::message::{encode_calibration, encode_recording, encode_report};
use std::path::{Path, PathBuf};

fn here(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

#[test]
fn json() {
    let files = [
        "calibration_set/board.json",
        "b02/recording.json",
        "b02/truth.json",
        "calibration_set/calibration.json",
    ];
    let seed = |name: &str| {
        let bytes = std::fs::read(here("../tests/data").join(name)).unwrap();
        (name.rsplit_once('/').unwrap().1.to_owned(), bytes)
    };
    let mut seeds = files.map(seed).to_vec();
    let deep = "[".repeat(200);
    for (name, text) in [
        ("twice", "{\"format\": \"boxline-board/1\", \"kind\": \"circles\", \"kind\": 1}"),
        ("large_number", "{\"faces\": [], \"box_mm\": [1e999, -1e-999, 1e308]}"),
        ("marked", "\u{feff}{\"faces\": []}"),
        (
            "ends",
            r#"{"faces": [{"frame": "a", "hidden": {"stripe_ends": [[1, 0]], "sides": [3]}, "notes": {"bulge_mm": {}}}]}"#,
        ),
        ("deep", &deep),
    ] {
        seeds.push((name.to_owned(), text.as_bytes().to_vec()));
    }
    corpus::run(&here("fuzz/corpus/json"), seeds, Vec::new(), hostile::json);
}

#[test]
fn message() {
    let data = |name: &str| here("../tests/data").join(name);
    let whole = read_calibration(&data("calibration_set/calibration.json")).unwrap();
    let estimated = read_calibration(&data("calibration_set/estimated.json")).unwrap();
    let measured = samples::report(Outcome::Measured(samples::sides(300.0)));
    let rejected = samples::report(Outcome::Rejected(Reject::RectangleOpen { sides_found: 3 }));
    let seeds = [
        ("calibration", encode_calibration(&whole)),
        ("covariance", encode_calibration(&estimated)),
        ("recording", encode_recording(&read_recording(&data("b02")).unwrap()).unwrap()),
        ("measured", encode_report(&measured, &["a", "b"])),
        ("rejected", encode_report(&rejected, &["a", "b"])),
    ];
    let seeds = seeds.map(|(name, bytes)| (name.to_owned(), bytes)).to_vec();
    corpus::run(&here("fuzz/corpus/message"), seeds, Vec::new(), hostile::message);
}
