//! Descriptors of a head are understood; broken ones are told apart from them and never cause a panic.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

mod support;

use boxline_uvc::descriptor::{Configuration, Device, EndpointKind, UvcVersion, VideoFunction, lint};
use boxline_uvc::emulator::descriptors::{ISO_PACKETS, PRODUCT_ID, VENDOR_ID};
use boxline_uvc::emulator::{Pipe, Settings, SoftwareHead};
use boxline_uvc::head;
use boxline_uvc::mode::{alternates_to_try, choose_mode};
use proptest::prelude::*;

fn descriptors(version: UvcVersion, pipe: Pipe) -> (Vec<u8>, Vec<u8>) {
    let settings = Settings { version, pipe, ..Settings::default() };
    SoftwareHead::new(settings, support::pictures(0, 4000)).descriptors()
}

fn video(configuration: &[u8]) -> VideoFunction {
    VideoFunction::parse(&Configuration::parse(configuration).unwrap()).unwrap()
}

const VERSIONS: [UvcVersion; 3] = [UvcVersion::V1_0, UvcVersion::V1_1, UvcVersion::V1_5];

#[test]
fn a_head_of_each_version_is_understood() {
    for version in VERSIONS {
        for pipe in [Pipe::Bulk, Pipe::Isochronous] {
            let (device, configuration) = descriptors(version, pipe);
            let device_parsed = Device::parse(&device).unwrap();
            assert_eq!((device_parsed.vendor_id, device_parsed.product_id), (VENDOR_ID, PRODUCT_ID));
            let video = video(&configuration);
            assert_eq!(video.version, version);
            let (unit, extension) = video.extension(&head::GUID).unwrap();
            assert_eq!(unit, 3);
            assert!((1..=8).all(|selector| extension.has(selector)));
            assert!(!extension.has(0) && !extension.has(9));
            let mode = choose_mode(&video).unwrap();
            assert_eq!((mode.width, mode.height, mode.interval), (2592, 1944, 666_666));
            assert_eq!(mode.fallback, None);
            assert_eq!(lint(&device, &configuration), []);
        }
    }
}

#[test]
fn the_alternate_setting_follows_the_payload_and_falls_back_to_smaller_ones() {
    let (_, configuration) = descriptors(UvcVersion::V1_1, Pipe::Isochronous);
    let stream = &video(&configuration).streaming[0];
    let tried =
        |payload| -> Vec<u8> { alternates_to_try(stream, payload).iter().map(|a| a.setting).collect() };
    assert_eq!(tried(3072), [3, 2, 1]);
    assert_eq!(tried(2048), [2, 1]);
    assert_eq!(tried(1000), [1]);
    assert_eq!(tried(0), [3, 2, 1], "a payload of 0 is no information");
    assert_eq!(tried(u32::MAX), [3, 2, 1]);
    assert_eq!(ISO_PACKETS.len(), 3);
    let (_, configuration) = descriptors(UvcVersion::V1_1, Pipe::Bulk);
    let bulk = alternates_to_try(&video(&configuration).streaming[0], 0);
    assert_eq!((bulk.len(), bulk[0].endpoint.kind), (1, EndpointKind::Bulk));
}

#[test]
fn another_size_or_rate_is_taken_with_a_reason() {
    let (_, mut configuration) = descriptors(UvcVersion::V1_1, Pipe::Bulk);
    let at = configuration.windows(3).position(|w| w == [34, 0x24, 7]).unwrap();
    configuration[at + 5..at + 9].copy_from_slice(&[0x80, 0x07, 0x38, 0x04]); // 1920 x 1080
    configuration[at + 26..at + 30].copy_from_slice(&1_000_000u32.to_le_bytes());
    let mode = choose_mode(&video(&configuration)).unwrap();
    assert_eq!((mode.width, mode.height, mode.interval), (1920, 1080, 1_000_000));
    let reason = mode.fallback.unwrap();
    assert!(reason.contains("2592x1944") && reason.contains("10.0"), "{reason}");
}

/// The frame size of the head with its intervals as a range.
fn with_range(shortest: u32, longest: u32, step: u32) -> Vec<u8> {
    let (_, mut configuration) = descriptors(UvcVersion::V1_1, Pipe::Bulk);
    let at = configuration.windows(3).position(|w| w == [34, 0x24, 7]).unwrap();
    let mut frame = configuration[at..at + 26].to_vec();
    (frame[0], frame[25]) = (38, 0);
    [shortest, longest, step].iter().for_each(|interval| frame.extend(interval.to_le_bytes()));
    configuration.splice(at..at + 34, frame);
    let total = (configuration.len() as u16).to_le_bytes();
    configuration[2..4].copy_from_slice(&total);
    configuration
}

#[test]
fn a_range_of_intervals_offers_what_lies_in_it() {
    let cases = [
        (333_333, 2_000_000, 333_333, 666_666), // 5 to 30 frames/s
        (333_333, 2_000_000, 0, 666_666),       // every interval between them
        (333_333, 2_000_000, 1, 666_666),
        (333_333, 2_000_000, 500_000, 833_333), // the nearest step
        (333_333, 600_000, 100_000, 600_000),   // all too short: the longest, though no step ends at it
        (1_000_000, 2_000_000, 1, 1_000_000),
        (666_666, 666_666, 666_666, 666_666),
        (0, 0, 0, 666_666), // nothing said
        (u32::MAX, 0, u32::MAX, u32::MAX),
    ];
    for (shortest, longest, step, needed) in cases {
        let mode = choose_mode(&video(&with_range(shortest, longest, step))).unwrap();
        assert_eq!(mode.interval, needed, "{shortest} to {longest} in steps of {step}");
        assert_eq!(mode.fallback.is_none(), needed == 666_666, "{:?}", mode.fallback);
    }
    let device = boxline_uvc::emulator::descriptors::device();
    assert!(
        !lint(&device, &with_range(333_333, 2_000_000, 333_333)).iter().any(|f| f.text.contains("interval"))
    );
    for (shortest, longest) in [(0, 9), (9, 8)] {
        let found = lint(&device, &with_range(shortest, longest, 1));
        assert!(found.iter().any(|f| f.text.contains("interval")), "{found:?}");
    }
}

#[test]
fn what_is_broken_beside_the_video_is_skipped_and_told() {
    let (device, good) = descriptors(UvcVersion::V1_1, Pipe::Bulk);
    let microphone = [9, 4, 2, 0, 1, 1, 2, 0, 0];
    let with = |more: &[&[u8]], total: isize| {
        let mut bytes = [&[&good[..]], more].concat().concat();
        let total = bytes.len().checked_add_signed(total).unwrap() as u16;
        bytes[2..4].copy_from_slice(&total.to_le_bytes());
        bytes
    };
    let cases = [
        ("a short endpoint of the microphone", with(&[&microphone, &[5, 5, 0x86, 5, 16]], 0)),
        ("an endpoint of two bytes", with(&[&microphone, &[2, 5]], 0)),
        ("a short interface, and an endpoint after it", with(&[&[4, 4, 2, 0], &[7, 5, 0x81, 1, 0, 4, 1]], 0)),
        ("a total that is too long", with(&[], 7)),
        ("zeros at the end", with(&[&[0, 0]], 0)),
        ("a descriptor that does not end", with(&[&microphone, &[7, 5, 0x86]], 0)),
    ];
    let head = video(&good);
    for (what, bytes) in cases {
        assert_eq!(video(&bytes), head, "{what}");
        assert!(!lint(&device, &bytes).is_empty(), "{what}");
    }
}

#[test]
fn the_linter_finds_what_hosts_forgive() {
    let find =
        |bytes: &[u8], pattern: &[u8]| bytes.windows(pattern.len()).position(|w| w == pattern).unwrap();
    let (device, good) = descriptors(UvcVersion::V1_1, Pipe::Bulk);
    let vc = find(&good, &[13, 0x24, 1]);
    let xu = find(&good, &[26, 0x24, 6]);
    let vs = find(&good, &[14, 0x24, 1]);
    let format = find(&good, &[11, 0x24, 6]);
    let cases = [
        (2, good[2] + 1, "wTotalLength"),
        (2, good[2] - 7, "wTotalLength"),
        (4, 3, "bNumInterfaces"),
        (vc + 5, good[vc + 5] + 1, "class-specific"),
        (vc + 12, 5, "streaming interface 5"),
        (xu + 22, 9, "fed by unit 9"),
        (xu + 20, 7, "bNumControls is 7"),
        (xu + 3, 1, "more than once"),
        (vs + 6, 0x82, "endpoint 0x82"),
        (vs + 8, 9, "terminal 9"),
        (format + 4, 2, "bNumFrameDescriptors is 2"),
    ];
    for (at, byte, needed) in cases {
        let mut broken = good.clone();
        broken[at] = byte;
        let findings = lint(&device, &broken);
        assert!(
            findings.iter().any(|finding| finding.text.contains(needed)),
            "byte {at} = {byte}: {needed:?} is not in {findings:?}"
        );
    }
}

proptest! {
    #[test]
    fn spoilt_descriptors_never_panic(
        version in 0usize..3, bulk: bool, cut in 0usize..300,
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8),
    ) {
        let pipe = if bulk { Pipe::Bulk } else { Pipe::Isochronous };
        let (device, mut bytes) = descriptors(VERSIONS[version], pipe);
        for (at, byte) in changes {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        bytes.truncate(bytes.len().saturating_sub(cut / 2));
        use_descriptors(&device, &bytes);
    }

    #[test]
    fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        use_descriptors(&bytes, &bytes);
    }
}

/// Everything that is done with descriptors before anything is asked of a device.
fn use_descriptors(device: &[u8], configuration: &[u8]) {
    lint(device, configuration);
    let Ok(video) = Configuration::parse(configuration).and_then(|parsed| VideoFunction::parse(&parsed))
    else {
        return;
    };
    if let Ok(mode) = choose_mode(&video) {
        let stream = video.streaming.iter().find(|stream| stream.number == mode.interface).unwrap();
        assert!(!alternates_to_try(stream, 3072).is_empty());
    }
}
