//! The fuzz targets on a toolchain without a fuzzer: every file of their corpus, and some thousand spoilt copies of each.
//! `REGENERATE=1` writes the seeds anew.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

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

const SPOILT: u64 = 3000;

fn folder(target: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target)
}

fn files_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> = entries.filter(|path| path.is_file()).collect();
    files.sort();
    files
}

/// Descriptors of real cameras, which lie beside the tree.
fn real_cameras() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/cases/descriptors");
    if !folder.is_dir() {
        let mut stdout = std::io::stdout(); // what `println!` writes is hidden if the test passes
        writeln!(stdout, "SKIPPED real cameras: {} is not there", folder.display()).unwrap();
        return Vec::new();
    }
    let all = [files_in(&folder), files_in(&folder.join("broken"))].concat();
    all.into_iter().filter(|file| file.metadata().unwrap().len() > 0).collect()
}

/// `beside`: seeds that lie elsewhere.
fn run(target: &str, seeds: Vec<(String, Vec<u8>)>, beside: Vec<PathBuf>, check: fn(&[u8])) {
    let folder = folder(target);
    if std::env::var_os("REGENERATE").is_some() {
        std::fs::create_dir_all(&folder).unwrap();
        for (name, bytes) in seeds {
            std::fs::write(folder.join(name), bytes).unwrap();
        }
    }
    let mut files = files_in(&folder);
    assert!(!files.is_empty(), "no seeds in {}", folder.display());
    files.extend(beside);
    for file in files {
        let seed = std::fs::read(&file).unwrap();
        check(&seed);
        let mut draw = 0x9E37_79B9_7F4A_7C15u64;
        let mut random = |most: usize| {
            draw ^= draw << 13;
            draw ^= draw >> 7;
            draw ^= draw << 17;
            draw as usize % most
        };
        for _ in 0..SPOILT {
            let mut bytes = seed.clone();
            for _ in 0..=random(4) {
                let at = random(bytes.len());
                match random(4) {
                    0 => bytes[at] = random(256) as u8,
                    1 => bytes[at] ^= 1 << random(8),
                    2 => bytes.truncate(at + 1),
                    _ => bytes.insert(at, [0, 1, 0x7F, 0x80, 0xFF][random(5)]),
                }
            }
            check(&bytes);
        }
    }
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
