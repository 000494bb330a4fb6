//! Time of each stage and of the whole way on recorded frames, on one thread, with the networks that ship and without:
//! `cargo bench -p boxline-edgenet`. A stage's time is what the pipeline itself notes while it measures a face, so each is timed on the data
//! that it really gets. What the times mean and where they go: `rust/SPEED.md`.

#![allow(missing_docs)] // of the function that criterion_group! makes

use boxline::{Calibration, EdgeMethod, Frame, Settings, measure_box, measure_face};
use boxline_edgenet::{EdgeNet, Options};
use boxline_proto::json::{read_calibration, read_recording};
use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use std::num::NonZeroUsize;
use std::path::Path;
use std::time::Duration;

/// Small and near; ordinary; large and far.
const RECORDINGS: [&str; 3] = ["b01", "b02", "b04"];
/// As the pipeline names them.
const STAGES: [&str; 8] = ["network", "ridge", "grid", "stripes", "outline", "sides", "edges", "fit"];

/// The calibration and both JPEGs of a recording.
fn recording(name: &str) -> (Calibration, [Vec<u8>; 2]) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data").join(name);
    let recording = read_recording(&folder).expect("the recording is in the repository");
    let calibration = read_calibration(&recording.calibration_file).expect("so is its calibration");
    let jpeg = |id: &str| {
        let frame = recording.frames.iter().find(|f| f.id == id).expect("frames a and b");
        std::fs::read(&frame.file).expect("the frame is in the repository")
    };
    (calibration, [jpeg("a"), jpeg("b")])
}

fn stages(criterion: &mut Criterion) {
    let one_thread = Options { threads: NonZeroUsize::MIN, ..Options::default() };
    let network = EdgeNet::embedded(&one_thread).expect("it is in the program");
    let default = Settings { network: Some(&network), ..Settings::default() };
    let alone = Settings { edges: EdgeMethod::Gradient, ..Settings::default() };
    time_with(criterion, "", &default);
    time_with(criterion, " without network", &alone);
}

fn time_with(criterion: &mut Criterion, how: &str, settings: &Settings) {
    for name in RECORDINGS {
        let (calibration, jpegs) = recording(name);
        let frame = Frame::from_jpeg(&jpegs[0]).expect("a whole JPEG");
        let mut group = criterion.benchmark_group(format!("{name}{how}"));
        group.sample_size(10);
        group.bench_function("decode_jpeg", |bench| bench.iter(|| Frame::from_jpeg(black_box(&jpegs[0]))));
        for stage in STAGES {
            group.bench_function(stage, |bench| {
                bench.iter_custom(|rounds| {
                    let mut nanos = 0;
                    for _ in 0..rounds {
                        let face = measure_face(black_box(&frame), &calibration, settings);
                        let report = black_box(face).expect("the sizes fit");
                        nanos += report
                            .times
                            .iter()
                            .filter(|(name, _)| *name == stage)
                            .map(|(_, n)| n)
                            .sum::<u64>();
                    }
                    Duration::from_nanos(nanos)
                });
            });
        }
        // Two JPEGs in memory to a result.
        group.bench_function("whole_pair", |bench| {
            bench.iter(|| {
                let [a, b] =
                    jpegs.each_ref().map(|bytes| Frame::from_jpeg(black_box(bytes)).expect("a whole JPEG"));
                measure_box(&[&a, &b], &calibration, settings)
            });
        });
        group.finish();
    }
}

criterion_group!(benches, stages);
criterion_main!(benches);
