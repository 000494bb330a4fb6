//! The networks of lines and of sides that ship: the same numbers as in training, on both runtimes.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::network::{LineStrip, Network, STRIP, StripeLight};
use boxline::view::{BINS, FaceView, Orientation, SideOdds, VIEW};
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
    LineStrip {
        values,
        side: 0,
        middle: Px::new(0.0, 0.0),
        outwards: [1.0, 0.0],
        log_odds: 0.0,
        bin: None,
        light: StripeLight::default(),
    }
}

fn network(runtime: Runtime) -> EdgeNet {
    EdgeNet::embedded(&Options { runtime, threads: NonZeroUsize::MIN }).unwrap()
}

fn stored(name: &str) -> Vec<f64> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("models").join(name);
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// A made-up view, the same as in `training/sides.py`.
fn view() -> FaceView {
    let [channels, rows, columns] = VIEW;
    let mut values = Vec::new();
    for c in 0..channels {
        for row in 0..rows {
            for column in 0..columns {
                let inside = (70..190).contains(&column) && (90..170).contains(&row);
                let base = if inside { 150 - 30 * c } else { 60 + 10 * c };
                let level = base + (c * 29 + row * 13 + column * 7 + (row * column) % 31) % 23;
                values.push(level as f32 / 255.0);
            }
        }
    }
    FaceView { values }
}

fn gives_what_torch_gave(network: &EdgeNet) {
    let logits: Vec<f32> = stored("sides.check.json").into_iter().map(|v| v as f32).collect();
    let due = SideOdds::from_logits(&logits).unwrap();
    let found = network.sides_seen(&view(), Orientation::ALL[0]).unwrap();
    for side in 0..4 {
        assert!((found.hidden(side) - due.hidden(side)).abs() < SAME, "side {side}");
        for bin in 0..BINS {
            let (found, due) = (found.at(side, bin as f64), due.at(side, bin as f64));
            assert!((found - due).abs() < SAME, "side {side} bin {bin}: {found}, torch gave {due}");
        }
    }
    let stored = stored("lines.check.json");
    assert!(stored.len() > 1);
    for (n, stored) in stored.into_iter().enumerate() {
        let found = f64::from(network.line_log_odds(&strip(n)).unwrap());
        assert!((found - stored).abs() < SAME, "strip {n}: {found}, torch gave {stored}");
    }
}

#[test]
fn the_engine_inside_gives_what_torch_gave() {
    gives_what_torch_gave(&network(Runtime::Embedded));
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
    let network = network(Runtime::Embedded);
    let short = LineStrip { values: vec![0.0; 7], ..strip(0) };
    assert_eq!(network.line_log_odds(&short).unwrap_err().kind(), ErrorKind::ModelFile);
    let nan = LineStrip { values: vec![f32::NAN; strip(0).values.len()], ..strip(0) };
    assert_eq!(network.line_log_odds(&nan).unwrap_err().kind(), ErrorKind::ModelFile);
    assert!(network.line_log_odds(&strip(0)).is_ok(), "the next one is not hurt");
    let short = FaceView { values: vec![0.0; 7] };
    assert_eq!(network.sides(&short).unwrap_err().kind(), ErrorKind::ModelFile);
    assert!(network.sides(&view()).is_ok(), "the next one is not hurt");
}
