//! The fuzz targets on a toolchain without a fuzzer: every file of their corpus, and some thousand spoilt copies of each.
//! `REGENERATE=1` writes the seeds anew.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

#[path = "support/corpus.rs"]
mod corpus;
#[path = "support/hostile.rs"]
mod hostile;
mod support;

use boxline_uvc::descriptor::UvcVersion;
use boxline_uvc::emulator::{Pipe, Settings, SoftwareHead, WithoutBus};
use boxline_uvc::head::{Control, Controls};
use boxline_uvc::store;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

fn folder(target: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target)
}

/// Descriptors of real cameras, which lie beside the tree.
fn real_cameras() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/cases/descriptors");
    if !folder.is_dir() {
        let mut stdout = std::io::stdout(); // what `println!` writes is hidden if the test passes
        writeln!(stdout, "SKIPPED real cameras: {} is not there", folder.display()).unwrap();
        return Vec::new();
    }
    let all = [corpus::files_in(&folder), corpus::files_in(&folder.join("broken"))].concat();
    all.into_iter().filter(|file| file.metadata().unwrap().len() > 0).collect()
}

fn run(target: &str, seeds: Vec<(String, Vec<u8>)>, beside: Vec<PathBuf>, check: fn(&[u8])) {
    corpus::run(&folder(target), seeds, beside, check);
}

#[test]
fn descriptors() {
    let mut seeds = Vec::new();
    for version in [UvcVersion::V1_0, UvcVersion::V1_1, UvcVersion::V1_5] {
        for pipe in [Pipe::Bulk, Pipe::Isochronous] {
            let settings = Settings { version, pipe, ..Settings::default() };
            let (_, bytes) = SoftwareHead::new(settings, support::pictures(0, 4000)).descriptors();
            seeds.push((format!("{version:?}_{pipe:?}"), bytes));
        }
    }
    run("descriptors", seeds, real_cameras(), hostile::descriptors);
}

#[test]
fn payloads() {
    let mut seeds = Vec::new();
    for tagged in [false, true] {
        let settings = Settings { pipe: Pipe::Isochronous, tagged, ..Settings::default() };
        let mut head = SoftwareHead::new(settings, support::pictures(3, 2001));
        head.set_alternate(1, Duration::ZERO).unwrap();
        let mut bytes = Vec::new();
        loop {
            let payload = head.iso_in(200, Duration::ZERO);
            if payload.is_empty() {
                break;
            }
            bytes.extend([2, payload.len() as u8]);
            bytes.extend(payload);
        }
        seeds.push((if tagged { "tagged" } else { "plain" }.to_owned(), bytes));
    }
    run("payloads", seeds, Vec::new(), hostile::payloads);
}

#[test]
fn stores() {
    let device = WithoutBus::new(SoftwareHead::new(Settings::default(), support::pictures(0, 4000)));
    store::write(&device, &[7; 300], |_, _| ()).unwrap();
    let mut answers = Vec::new();
    let mut add = |answer: Vec<u8>| {
        answers.extend((answer.len() as u16).to_le_bytes());
        answers.extend(answer);
    };
    add(device.get(Control::StoreInfo).unwrap());
    for page in 0..2 {
        let select = [4, 0, page, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        device.set(Control::StoreCommand, &select).unwrap();
        add(device.get(Control::StorePage).unwrap());
    }
    assert_eq!(answers.len(), 18 + 2 * 266);
    let page = answers[20..284].to_vec();
    run(
        "store",
        vec![("answers".to_owned(), answers), ("page".to_owned(), page)],
        Vec::new(),
        hostile::store,
    );
}
