//! The whole of this side's work for a frame of 1 MB, from USB transfers to the frame: `cargo bench -p boxline-uvc`. It must leave
//! time for measuring: 2 ms is the most.

#![allow(missing_docs)] // of the function that criterion_group! makes

#[path = "../tests/support/mod.rs"]
mod support;

use boxline_uvc::Assembler;
use boxline_uvc::bulk::BulkSplitter;
use boxline_uvc::emulator::{FrameRequest, InReply, Settings, Setup, SoftwareHead};
use boxline_uvc::probe::Probe;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::sync::Arc;
use std::time::Duration;

const FRAME_BYTES: usize = 1_000_000;
const TRANSFER_BYTES: usize = 65536;
const PAYLOAD_BYTES: u32 = 4096;

/// What the software head sends for one frame over a bulk pipe.
fn transfers() -> Vec<Vec<u8>> {
    let settings = Settings { max_payload_bytes: PAYLOAD_BYTES, ..Settings::default() };
    let source = Box::new(|shot: FrameRequest| {
        (shot.number < 2).then(|| Arc::from(support::picture(shot.number, FRAME_BYTES)))
    });
    let mut head = SoftwareHead::new(settings, source);
    let commit = Setup { request_type: 0x21, request: 1, value: 0x200, index: 1, length: 34 };
    head.control(commit, &Probe::default().encode(34), Duration::ZERO).expect("the head streams");
    let mut transfers = Vec::new();
    while let InReply::Data(bytes) = head.bulk_in(TRANSFER_BYTES, Duration::ZERO) {
        transfers.push(bytes);
    }
    transfers
}

fn frame(criterion: &mut Criterion) {
    let transfers = transfers();
    let mut group = criterion.benchmark_group("assembly");
    group.throughput(Throughput::Bytes(2 * FRAME_BYTES as u64));
    group.bench_function("two frames of 1 MB", |bencher| {
        bencher.iter(|| {
            let mut frames = Assembler::new(2 * FRAME_BYTES);
            let mut splitter = BulkSplitter::new(PAYLOAD_BYTES as usize);
            for bytes in &transfers {
                splitter.transfer(bytes, bytes.len() < TRANSFER_BYTES, &mut frames);
                frames.take_ready().for_each(drop);
            }
            assert_eq!(frames.counters().delivered, 2);
        });
    });
    group.finish();
}

criterion_group!(benches, frame);
criterion_main!(benches);
