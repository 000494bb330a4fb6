//! Runs the program and reads what it says.
#![allow(dead_code)] // each test program uses some of it

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A file or folder of `tests/data`.
pub fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data").join(name)
}

pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

pub fn boxline(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_boxline")).args(arguments).output().unwrap()
}

pub fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Standard output as the one JSON object that it must be.
pub fn json_of(output: &Output) -> Value {
    let text = stdout(output);
    serde_json::from_str(&text)
        .unwrap_or_else(|e| panic!("not one JSON object: {e}\n{text}\n{}", stderr(output)))
}
