//! Time of each public step on a recorded frame: `cargo bench -p boxline`.

#![allow(missing_docs)] // of the function that criterion_group! makes

use boxline::{Calibration, Frame, Settings, measure_box, measure_face};
use boxline_proto::json::{read_calibration, read_recording};
use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use std::path::Path;

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
    let (calibration, jpegs) = recording("b02");
    let [a, b] = jpegs.each_ref().map(|bytes| Frame::from_jpeg(bytes).expect("a whole JPEG"));
    let settings = Settings::default();
    let mut group = criterion.benchmark_group("b02");
    group.sample_size(10);
    group.bench_function("decode_jpeg", |bench| bench.iter(|| Frame::from_jpeg(black_box(&jpegs[0]))));
    group.bench_function("measure_face", |bench| {
        bench.iter(|| measure_face(black_box(&a), &calibration, &settings, &mut Vec::new()));
    });
    group.bench_function("measure_box", |bench| {
        bench.iter(|| measure_box(black_box(&a), &b, &calibration, &settings, &mut Vec::new()));
    });
    group.finish();
}

criterion_group!(benches, stages);
criterion_main!(benches);
