//! The network of lines that ships: the same numbers as in training, on both runtimes.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::network::{LineStrip, Network, STRIP};
use boxline::{ErrorKind, Px};
use boxline_edgenet::{EdgeNet, Options, Runtime};
use std::io::Write;
use std::num::NonZeroUsize;
use std::path::Path;

/// Different orders of summing in f32 give about 1e-5 of numbers around 10.
const SAME: f64 = 1e-3;

/// Made-up strip `n`, the same as in `training/lines.py`.
fn strip(n: usize) -> LineStrip {
    let [channels, rows, columns] = STRIP;
    let mut values = Vec::new();
    for c in 0..channels {
        for row in 0..rows {
            for column in 0..columns {
                let level = (n * 41 + c * 29 + row * 13 + column * 7 + (row * column) % 31) % 256;
                values.push(level as f32 / 255.0);
            }
        }
    }
    LineStrip { values, side: 0, middle: Px::new(0.0, 0.0), outwards: [1.0, 0.0], log_odds: 0.0 }
}

fn network(runtime: Runtime) -> EdgeNet {
    EdgeNet::embedded(&Options { runtime, threads: NonZeroUsize::MIN }).unwrap()
}

fn gives_what_torch_gave(network: &EdgeNet) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/lines.check.json");
    let stored: Vec<f64> = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    assert!(stored.len() > 1);
    for (n, stored) in stored.into_iter().enumerate() {
        let told = f64::from(network.line_log_odds(&strip(n)).unwrap());
        assert!((told - stored).abs() < SAME, "strip {n}: {told}, torch gave {stored}");
    }
}

#[test]
fn tract_gives_what_torch_gave() {
    gives_what_torch_gave(&network(Runtime::Tract));
}

#[test]
fn onnx_runtime_gives_what_torch_gave() {
    let named = |variable| std::env::var_os(variable).filter(|path| !path.is_empty());
    match named("ORT_DYLIB_PATH").or_else(|| named("BOXLINE_TEST_ONNX_RUNTIME")) {
        Some(path) => gives_what_torch_gave(&network(Runtime::OnnxRuntime(path.into()))),
        // Straight to stdout: the test harness hides what a passing test prints, and a skipped test must be seen.
        None => {
            let mut stdout = std::io::stdout().lock();
            writeln!(stdout, "SKIPPED: BOXLINE_TEST_ONNX_RUNTIME names no library of ONNX Runtime").unwrap();
        }
    }
}

#[test]
fn a_strip_that_does_not_fit_or_is_no_number_is_an_error() {
    let network = network(Runtime::Tract);
    let short = LineStrip { values: vec![0.0; 7], ..strip(0) };
    assert_eq!(network.line_log_odds(&short).unwrap_err().kind(), ErrorKind::ModelFile);
    let nan = LineStrip { values: vec![f32::NAN; strip(0).values.len()], ..strip(0) };
    assert_eq!(network.line_log_odds(&nan).unwrap_err().kind(), ErrorKind::ModelFile);
    assert!(network.line_log_odds(&strip(0)).is_ok(), "the next one is not hurt");
}
