//! Runs a fuzz target's check on a toolchain without a fuzzer: over every file of its corpus, and some thousand spoilt copies of each.
//! `REGENERATE=1` writes the seeds anew. The tests of boxline-proto and boxline use this file too.

use std::path::{Path, PathBuf};

const SPOILT: u32 = 3000;

/// The files of a folder, by name.
pub fn files_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> = entries.filter(|path| path.is_file()).collect();
    files.sort();
    files
}

/// `beside`: seeds that lie elsewhere.
pub fn run(folder: &Path, seeds: Vec<(String, Vec<u8>)>, beside: Vec<PathBuf>, check: fn(&[u8])) {
    if std::env::var_os("REGENERATE").is_some() {
        std::fs::create_dir_all(folder).unwrap();
        for (name, bytes) in seeds {
            std::fs::write(folder.join(name), bytes).unwrap();
        }
    }
    let mut files = files_in(folder);
    assert!(!files.is_empty(), "no seeds in {}", folder.display());
    files.extend(beside);
    for file in files {
        let seed = std::fs::read(&file).unwrap();
        check(&seed);
        let mut random = fastrand::Rng::with_seed(7);
        for _ in 0..SPOILT {
            let mut bytes = seed.clone();
            for _ in 0..=random.usize(..4) {
                let at = random.usize(..bytes.len());
                match random.u8(..4) {
                    0 => bytes[at] = random.u8(..),
                    1 => bytes[at] ^= 1 << random.u8(..8),
                    2 => bytes.truncate(at + 1),
                    _ => bytes.insert(at, [0, 1, 0x7F, 0x80, 0xFF][random.usize(..5)]),
                }
            }
            check(&bytes);
        }
    }
}
