//! Frames come out as the head sent them, or not at all and counted.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

mod support;

use boxline_uvc::bulk::BulkSplitter;
use boxline_uvc::emulator::{Fault, InReply, Pipe, Settings, Setup, SoftwareHead};
use boxline_uvc::payload::{FrameTag, PayloadHeader};
use boxline_uvc::probe::Probe;
use boxline_uvc::{Assembler, Counters, Frame};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::time::Duration;
use support::{FAULTS, picture, pictures, size_of};

const MOST: usize = 9000;
const NOW: Duration = Duration::ZERO;

/// Streams everything that a head has. The transfers named in `lost` fail.
fn stream(mut head: SoftwareHead, pipe: Pipe, transfer: usize, lost: &[u64]) -> (Vec<Frame>, Counters) {
    let mut frames = Assembler::new(MOST);
    let mut delivered = Vec::new();
    match pipe {
        Pipe::Bulk => {
            let commit = Setup { request_type: 0x21, request: 1, value: 0x200, index: 1, length: 34 };
            head.control(commit, &Probe::default().encode(34), NOW).unwrap();
            let mut splitter = BulkSplitter::new(4096);
            for number in 0.. {
                let InReply::Data(bytes) = head.bulk_in(transfer, NOW) else { break };
                if lost.contains(&number) {
                    splitter.failed(&mut frames);
                } else {
                    splitter.transfer(&bytes, bytes.len() < transfer, &mut frames);
                }
                delivered.extend(frames.take_ready());
            }
        }
        Pipe::Isochronous => {
            head.set_alternate(2, NOW).unwrap();
            for number in 0.. {
                let packet = head.iso_in(2048, NOW);
                if packet.is_empty() {
                    break;
                }
                if lost.contains(&number) {
                    frames.failed_transfer();
                } else {
                    frames.payload(&packet);
                }
                delivered.extend(frames.take_ready());
            }
        }
    }
    frames.finish();
    (delivered, frames.counters())
}

fn head(pipe: Pipe, tagged: bool, count: u64, faults: BTreeMap<u64, Fault>) -> SoftwareHead {
    let settings = Settings { pipe, tagged, max_payload_bytes: 4096, ..Settings::default() };
    SoftwareHead::new(settings, pictures(count, MOST)).with_faults(Box::new(move |n| faults.get(&n).copied()))
}

fn assert_whole(frames: &[Frame]) {
    for frame in frames {
        let number = u64::from(frame.tag.unwrap().sequence);
        assert!(frame.jpeg == picture(number, size_of(number, MOST)), "frame {number} is not what was sent");
    }
}

#[test]
fn all_frames_of_a_good_stream_arrive() {
    for pipe in [Pipe::Bulk, Pipe::Isochronous] {
        for transfer in [512, 2048, 4096, 16384, 65536] {
            let (frames, counters) = stream(head(pipe, true, 40, BTreeMap::new()), pipe, transfer, &[]);
            assert_eq!(counters.delivered, 40, "{pipe:?} {transfer} {counters:?}");
            assert_eq!(counters.dropped() + counters.missing + counters.bad_payloads, 0, "{counters:?}");
            assert_whole(&frames);
        }
    }
}

#[test]
fn a_camera_without_tags_loses_only_its_first_frame() {
    for pipe in [Pipe::Bulk, Pipe::Isochronous] {
        let (frames, counters) = stream(head(pipe, false, 40, BTreeMap::new()), pipe, 16384, &[]);
        assert_eq!((counters.delivered, counters.first), (39, 1), "{counters:?}");
        for (number, frame) in (1..).zip(&frames) {
            assert!(frame.jpeg == picture(number, size_of(number, MOST)));
        }
    }
}

/// What must be counted for each fault, of a head with tags.
#[test]
fn each_fault_costs_its_own_frame_and_no_other() {
    for pipe in [Pipe::Bulk, Pipe::Isochronous] {
        for fault in FAULTS {
            let (frames, c) = stream(head(pipe, true, 10, BTreeMap::from([(4, fault)])), pipe, 16384, &[]);
            let harmless = matches!(fault, Fault::LostEof | Fault::StuckFid);
            assert_eq!(c.delivered, if harmless { 10 } else { 9 }, "{pipe:?} {fault:?} {c:?}");
            assert_eq!(c.delivered + c.dropped() + c.missing, 10, "{pipe:?} {fault:?} {c:?}");
            let counted = match fault {
                Fault::LostEof | Fault::StuckFid => 0,
                Fault::ErrorBit => c.device_error,
                Fault::NotJpeg | Fault::TornJpeg => c.not_jpeg,
                Fault::Huge => c.too_large,
                Fault::Vanished => c.missing,
                _ => c.torn,
            };
            assert_eq!(counted, u64::from(!harmless), "{pipe:?} {fault:?} {c:?}");
            assert_whole(&frames);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn any_mixture_of_faults_is_accounted_for(
        isochronous: bool,
        faults in proptest::collection::btree_map(2u64..58, proptest::sample::select(&FAULTS[..]), 0..30),
        lost in proptest::collection::vec(20u64..300, 0..20), // the first frame shows where counting starts
        transfer in proptest::sample::select(&[512usize, 4096, 16384, 65536][..]),
    ) {
        let pipe = if isochronous { Pipe::Isochronous } else { Pipe::Bulk };
        // The last two frames stay whole, or a frame that vanishes at the end could not be missed.
        let (frames, counters) = stream(head(pipe, true, 60, faults), pipe, transfer, &lost);
        assert_whole(&frames);
        let last = frames.last().map_or(0, |frame| u64::from(frame.tag.unwrap().sequence));
        let counted = counters.delivered + counters.dropped() + counters.missing;
        prop_assert!(counted <= 60 && counted > last, "{:?}", counters);
        if lost.is_empty() {
            prop_assert_eq!(counted, 60, "{:?}", counters);
        }
    }

    #[test]
    fn any_bytes_are_frames_or_faults(
        payloads in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..64), 0..40),
        cuts: [u8; 8],
    ) {
        let mut frames = Assembler::new(100);
        let mut splitter = BulkSplitter::new(usize::from(cuts[0]));
        for (i, payload) in payloads.iter().enumerate() {
            match cuts[i % 8] % 4 {
                0 => frames.failed_transfer(),
                1 => splitter.transfer(payload, cuts[i % 8] & 4 == 0, &mut frames),
                _ => frames.payload(payload),
            }
            for frame in frames.take_ready() {
                prop_assert!(frame.jpeg.starts_with(&[0xFF, 0xD8]));
            }
        }
    }
}

#[test]
fn a_frame_is_not_moved_while_it_grows() {
    let mut frames = Assembler::new(100_000);
    let mut head = head(Pipe::Isochronous, true, 1, BTreeMap::new());
    head.set_alternate(1, NOW).unwrap();
    loop {
        let packet = head.iso_in(1024, NOW);
        if packet.is_empty() {
            break;
        }
        frames.payload(&packet);
    }
    let frame = frames.take_ready().next().unwrap();
    assert_eq!(frame.jpeg.capacity(), 100_000, "one allocation, so each byte was copied once");
}

#[test]
fn bytes_of_a_picture_that_look_like_a_header_count_no_frames_as_missing() {
    let header = |sequence, offset_bytes| PayloadHeader {
        length: 0,
        frame_id: false,
        end_of_frame: false,
        error: false,
        still: false,
        pts: Some(0),
        scr: Some((0, 0)),
        tag: Some(FrameTag { lasers: 0xF, switched: false, sequence, offset_bytes }),
    };
    let payload = |header: &PayloadHeader| {
        let mut bytes = header.encode();
        bytes.resize(4096, 0x55);
        bytes
    };
    let mut frames = Assembler::new(10_000);
    let mut splitter = BulkSplitter::new(8192);
    splitter.transfer(&payload(&header(7, 0)), false, &mut frames);
    splitter.failed(&mut frames);
    // The rest of a picture: another sequence number, an offset that no frame reaches, the length of another header.
    splitter.transfer(&payload(&header(9000, 4076)), false, &mut frames);
    splitter.transfer(&payload(&header(8, u32::MAX)), false, &mut frames);
    let mut longer = payload(&header(8, 0));
    longer[0] += 1;
    splitter.transfer(&longer, false, &mut frames);
    assert_eq!(frames.counters().missing, 0);
    // And what does come next.
    splitter.transfer(&payload(&header(8, 0)), true, &mut frames);
    assert_eq!(frames.counters().missing, 0);
    assert_eq!(frames.counters().dropped(), 1, "{:?}", frames.counters());
}
