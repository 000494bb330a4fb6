//! The network that ships, on both runtimes: the same maps as in training, on any frame, and no panic on any file.
//!
//! ONNX Runtime is tested where `BOXLINE_TEST_ONNX_RUNTIME` or `ORT_DYLIB_PATH` names its library; the second is also what the
//! product itself looks at.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::network::{Channel, EdgeMapNetwork, FaceMaps, Network};
use boxline::{ErrorKind, Frame};
use boxline_edgenet::{AnyNet, EdgeMapNet, EdgeNet, Engine, Options, Runtime};
use std::io::Write;
use std::num::NonZeroUsize;
use std::path::Path;

const MODEL: &[u8] = include_bytes!("../models/boxnet.onnx");
/// Of the paper's kind; untrained.
const IHED_TINY: &[u8] = include_bytes!("data/ihed-tiny.onnx");

fn options(runtime: Runtime) -> Options {
    Options { runtime, threads: NonZeroUsize::MIN }
}

fn onnx_runtime() -> Option<Runtime> {
    let named = |variable| std::env::var_os(variable).filter(|path| !path.is_empty());
    let path = named("ORT_DYLIB_PATH").or_else(|| named("BOXLINE_TEST_ONNX_RUNTIME"));
    if path.is_none() {
        // Straight to stdout: the test harness hides what a passing test prints, and a skipped test must be seen.
        let mut stdout = std::io::stdout().lock();
        writeln!(stdout, "SKIPPED: BOXLINE_TEST_ONNX_RUNTIME names no library of ONNX Runtime").unwrap();
    }
    path.map(|p| Runtime::OnnxRuntime(p.into()))
}

fn recorded(name: &str) -> Frame {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data");
    Frame::from_jpeg(&std::fs::read(root.join(name)).unwrap()).unwrap()
}

/// The picture of `check_image` in training/export.py, red, green and blue planes.
fn check_image(width: usize, height: usize) -> Vec<f32> {
    let mut planes = Vec::with_capacity(3 * width * height);
    for c in 0..3 {
        for y in 0..height {
            for x in 0..width {
                let inside = (120..400).contains(&x) && (70..320).contains(&y);
                let base = if inside { [190, 150, 110][c] } else { [60, 70, 80][c] };
                let stripe = [
                    (x + y) % 512 == 390,
                    (x + y) % 512 == 470,
                    (x + 500 - y) % 512 == 380,
                    (x + 500 - y) % 512 == 40,
                ];
                let red = if c == 0 && stripe.contains(&true) { 60 } else { 0 };
                let texture = (x * 7 + y * 13 + (x * y) % 31) % 23;
                planes.push((base + red + texture).min(255) as f32 / 255.0);
            }
        }
    }
    planes
}

/// The file of a network, and what torch gave for [`check_image`] when it was exported.
type Exported = (&'static [u8], &'static str);
const BOXNET: Exported = (MODEL, include_str!("../models/boxnet.check.json"));
const IHED: Exported = (IHED_TINY, include_str!("data/ihed-tiny.check.json"));

/// Largest difference to the outputs that torch gave.
fn difference_to_torch(runtime: Runtime, (model, check): Exported) -> f64 {
    let stored: serde_json::Value = serde_json::from_str(check).unwrap();
    let step = usize::try_from(stored["step"].as_u64().unwrap()).unwrap();
    let engine = Engine::load(model, 3, &options(runtime)).unwrap();
    let [_, _, height, width] = engine.input_shape();
    let values = engine.run(&check_image(width, height)).unwrap();
    let [_, channels, rows, columns] = engine.output_shape();
    let mut stored = stored["values"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap());
    let mut worst = 0.0f64;
    for c in 0..channels {
        for y in (0..rows).step_by(step) {
            for x in (0..columns).step_by(step) {
                let found = f64::from(values[(c * rows + y) * columns + x]);
                worst = worst.max((found - stored.next().unwrap()).abs());
            }
        }
    }
    assert_eq!(stored.next(), None, "as many values as were stored");
    worst
}

/// Different orders of summing in f32 give about 1e-6.
const SAME: f64 = 1e-4;

#[test]
fn the_engine_inside_gives_what_torch_gave() {
    for exported in [BOXNET, IHED] {
        let difference = difference_to_torch(Runtime::Embedded, exported);
        assert!(difference < SAME, "{difference}");
    }
}

#[test]
fn onnx_runtime_gives_what_torch_gave() {
    let Some(runtime) = onnx_runtime() else { return };
    for exported in [BOXNET, IHED] {
        let difference = difference_to_torch(runtime.clone(), exported);
        assert!(difference < SAME, "{difference}");
    }
}

#[test]
fn every_network_that_ships_gives_the_same_on_both_runtimes() {
    let Some(runtime) = onnx_runtime() else { return };
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    for (name, channels) in [("boxnet.onnx", 3), ("lines.onnx", 3), ("sides.onnx", 5), ("ihed.onnx", 3)] {
        let model = std::fs::read(models.join(name)).unwrap();
        let inside = Engine::load(&model, channels, &options(Runtime::Embedded)).unwrap();
        let onnx = Engine::load(&model, channels, &options(runtime.clone())).unwrap();
        assert_eq!(inside.input_shape(), onnx.input_shape(), "{name}");
        assert_eq!(inside.output_shape(), onnx.output_shape(), "{name}");
        for seed in 0..3 {
            // Smooth with some noise, as pictures are.
            let value =
                |n: usize| ((n * 31 + seed * 97) % 253) as f32 / 1000.0 + (n as f32 * 0.01).sin() * 0.3 + 0.4;
            let input: Vec<f32> = (0..inside.input_len()).map(value).collect();
            let (inside, onnx) = (inside.run(&input).unwrap(), onnx.run(&input).unwrap());
            for (n, (a, b)) in inside.iter().zip(&onnx).enumerate() {
                assert!(
                    f64::from((a - b).abs()) < SAME * f64::from(b.abs()).max(1.0),
                    "{name} {n}: {a}, {b}"
                );
            }
        }
    }
}

#[test]
fn both_runtimes_and_several_threads_see_the_same_in_a_frame() {
    let frame = recorded("b02/a.jpg");
    let inside = EdgeNet::embedded(&options(Runtime::Embedded)).unwrap();
    assert_eq!(inside.runtime_name(), "embedded");
    let maps = inside.maps(&frame).unwrap();
    assert_eq!(maps, inside.maps(&frame).unwrap(), "a second run gives the same");
    let two = Options { runtime: Runtime::Embedded, threads: NonZeroUsize::new(2).unwrap() };
    assert_eq!(maps, EdgeNet::embedded(&two).unwrap().maps(&frame).unwrap(), "to the bit");
    let Some(runtime) = onnx_runtime() else { return };
    let onnx = EdgeNet::embedded(&options(runtime)).unwrap();
    assert_eq!(onnx.runtime_name(), "ONNX Runtime");
    assert!(largest_difference(&maps, &onnx.maps(&frame).unwrap()) < SAME);
    let found = EdgeNet::embedded(&Options::default()).unwrap().runtime_name();
    assert_eq!(found == "ONNX Runtime", std::env::var_os("ORT_DYLIB_PATH").is_some(), "{found}");
    let other = EdgeNet::embedded(&options(Runtime::OnnxRuntime("libother.so".into()))).unwrap_err();
    assert_eq!(other.kind(), ErrorKind::NetworkRuntime);
}

#[test]
fn the_8_bit_file_sees_the_same_lines_and_is_refused_by_the_engine_inside() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/boxnet-int8.onnx");
    let refused = EdgeNet::from_path(&path, &options(Runtime::Embedded)).unwrap_err();
    assert_eq!(refused.kind(), ErrorKind::ModelFile);
    for word in ["boxnet-int8.onnx", "ONNX Runtime can run it"] {
        assert!(refused.to_string().contains(word), "{refused}");
    }
    let Some(runtime) = onnx_runtime() else { return };
    let frame = recorded("b02/a.jpg");
    let float = EdgeNet::embedded(&options(Runtime::Embedded)).unwrap().maps(&frame).unwrap();
    let small = EdgeNet::from_path(&path, &options(runtime)).unwrap().maps(&frame).unwrap();
    for channel in Channel::ALL {
        let line = |map: &FaceMaps| map.channel(channel).iter().map(|p| *p >= 0.5).collect::<Vec<_>>();
        let (a, b) = (line(&float), line(&small));
        let both = a.iter().zip(&b).filter(|(x, y)| **x && **y).count();
        let either = a.iter().zip(&b).filter(|(x, y)| **x || **y).count();
        // An eighth of a line's pixels lie at its rim, where a step of 8 bits decides.
        assert!(both as f64 >= 0.75 * either as f64, "{channel:?}: {both} of {either}");
    }
}

fn largest_difference(a: &FaceMaps, b: &FaceMaps) -> f64 {
    let of =
        |channel| a.channel(channel).iter().zip(b.channel(channel)).map(|(a, b)| f64::from((a - b).abs()));
    Channel::ALL.into_iter().flat_map(of).fold(0.0, f64::max)
}

#[test]
fn frames_of_any_size_and_shape_give_maps_that_cover_them() {
    let net = EdgeNet::embedded(&options(Runtime::Embedded)).unwrap();
    for (w, h) in [(1, 1), (2, 3), (512, 384), (640, 481), (3000, 7), (2592, 1944)] {
        let frame = Frame::from_rgb(w, h, (0..w * h * 3).map(|i| (i * 37 % 256) as u8).collect()).unwrap();
        let maps = net.maps(&frame).unwrap();
        assert_eq!(maps.size(), [256, 192]);
        let end = maps.raster_from_px(boxline::Px::new(w as f64 - 0.5, h as f64 - 0.5));
        assert!((end[0] - 255.5).abs() < 1e-9 && (end[1] - 191.5).abs() < 1e-9, "{w} x {h}: {end:?}");
    }
}

#[test]
fn where_there_is_no_box_the_network_says_so() {
    let net = EdgeNet::embedded(&options(Runtime::Embedded)).unwrap();
    let black = vec![0; 2592 * 1944 * 3];
    // Grey with the noise of a dim sensor.
    let grey = (0..2592 * 1944 * 3).map(|i: u32| 90 + (i.wrapping_mul(2_654_435_761) >> 28) as u8).collect();
    for (name, rgb) in [("black", black), ("grey", grey)] {
        let maps = net.maps(&Frame::from_rgb(2592, 1944, rgb).unwrap()).unwrap();
        for channel in [Channel::FaceMask, Channel::FaceEdge, Channel::ALL[0], Channel::ALL[3]] {
            let yes = maps.channel(channel).iter().filter(|v| **v > 0.5).count();
            let share = yes as f64 / (256.0 * 192.0);
            assert!(share < 0.002, "{name}: {channel:?} is seen on {share:.4} of the frame");
        }
    }
}

#[test]
fn broken_files_are_errors_that_say_what_is_wrong() {
    let kind = |bytes: &[u8]| EdgeNet::from_bytes(bytes, &options(Runtime::Embedded)).unwrap_err();
    for bytes in [&b""[..], b"not a network", &MODEL[..MODEL.len() / 2], &MODEL[1..]] {
        let e = kind(bytes);
        assert_eq!(e.kind(), ErrorKind::ModelFile, "{e}");
    }
    let missing = EdgeNet::from_path(Path::new("no/such.onnx"), &options(Runtime::Embedded)).unwrap_err();
    assert_eq!(missing.kind(), ErrorKind::Io);
    assert!(missing.to_string().contains("no/such.onnx"), "{missing}");
}

#[test]
fn a_file_of_one_map_is_the_papers_network_and_no_other() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (one, nine) = (folder.join("tests/data/ihed-tiny.onnx"), folder.join("models/boxnet.onnx"));
    let options = options(Runtime::Embedded);
    let any = |path| AnyNet::from_path(path, &options).unwrap();
    let (ihed, boxnet) = (any(&one), any(&nine));
    assert!(ihed.network().is_none() && ihed.edge_map().is_some(), "{ihed:?}");
    assert!(boxnet.network().is_some() && boxnet.edge_map().is_none(), "{boxnet:?}");
    let frame =
        Frame::from_rgb(640, 481, (0..640 * 481 * 3).map(|i| (i * 37 % 256) as u8).collect()).unwrap();
    let map = ihed.edge_map().unwrap().edge_map(&frame).unwrap();
    assert_eq!(map.size(), [512, 384], "of the size of its input");
    assert_eq!(map, EdgeMapNet::from_path(&one, &options).unwrap().edge_map(&frame).unwrap());
    for (error, expected) in [
        (EdgeNet::from_path(&one, &options).unwrap_err(), "gives 1 maps, 9 are needed"),
        (EdgeMapNet::from_path(&nine, &options).unwrap_err(), "gives 9 maps, the paper's gives one"),
    ] {
        assert!(error.kind() == ErrorKind::ModelFile && error.to_string().contains(expected), "{error}");
        assert!(error.to_string().contains(".onnx"), "{error}");
    }
}

#[test]
fn damaged_files_never_panic() {
    // Damage where the graph is described, not in the weights: these are at the end of most nodes' bytes, the text is short.
    let mut random = fastrand::Rng::with_seed(1);
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    let (lines, sides) = (std::fs::read(models.join("lines.onnx")), std::fs::read(models.join("sides.onnx")));
    // With how many channels go in, and where the description ends.
    let files =
        [(MODEL, 3, 6000), (IHED_TINY, 3, 28_000), (&lines.unwrap(), 3, 9000), (&sides.unwrap(), 5, 30_000)];
    for (model, channels, described) in files {
        let mut refused = 0;
        for _ in 0..150 {
            let mut bytes = model.to_vec();
            for _ in 0..1 + random.usize(..4) {
                let at = random.usize(..described);
                bytes[at] = random.u8(..);
            }
            match Engine::load(&bytes, channels, &options(Runtime::Embedded)) {
                Ok(engine) => drop(engine.run(&vec![0.5; engine.input_len()])),
                Err(e) => {
                    refused += 1;
                    assert!(matches!(e.kind(), ErrorKind::ModelFile), "{e}");
                }
            }
        }
        assert!(refused > 10, "only {refused} of 150 were found broken: the damage is in the wrong place");
    }
}
