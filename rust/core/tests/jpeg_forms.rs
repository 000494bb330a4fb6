//! The forms of JPEG that cameras send decode to the same pixels; forms that they do not send are refused by name.

mod jpegs;

use boxline::{ErrorKind, Frame};
use jpeg_encoder::SamplingFactor;
use jpegs::{SMALL, recorded, refusal, scan, small, without};
use std::io::Write as _;
use std::path::Path;

#[track_caller]
fn same(changed: &[u8], whole: &[u8]) {
    let whole = Frame::from_jpeg(whole).expect("a whole frame");
    match Frame::from_jpeg(changed) {
        Ok(frame) => assert!(frame == whole, "other pixels"),
        Err(error) => panic!("{error}"),
    }
}

#[test]
fn bytes_behind_the_end_do_not_matter() {
    for whole in [recorded("b01/a.jpg"), small(|_| {}), small(|e| e.set_restart_interval(4))] {
        for behind in [&[0; 4096][..], &[0xff; 7], b"\xff", b"\xff\xd8\xff\xe0", &whole[..1000]] {
            same(&[&whole, behind].concat(), &whole);
        }
    }
}

#[test]
fn a_missing_end_marker_does_not_matter() {
    for whole in [recorded("b03/a.jpg"), small(|_| {}), small(|e| e.set_restart_interval(4))] {
        let data = &whole[..whole.len() - 2];
        same(data, &whole);
        for padding in [&[0; 512][..], &[0xff; 5], b"\xff\xff\xff\xd9", b"\0\0\xff\xd9"] {
            same(&[data, padding].concat(), &whole);
        }
        // Half of the marker.
        same(&whole[..whole.len() - 1], &whole);
    }
}

#[test]
fn restart_markers_in_order_pass() {
    let whole = small(|_| {});
    for interval in [1, 2, 13, 64, 1000] {
        let marked = small(|e| e.set_restart_interval(interval));
        same(&marked, &whole);
        // Closed like all other intervals.
        let count =
            marked.windows(2).filter(|pair| pair[0] == 0xff && (0xd0..=0xd7).contains(&pair[1])).count();
        let last = 0xd0 + (count % 8) as u8;
        same(&[&marked[..marked.len() - 2], &[0xff, last, 0xff, 0xd9]].concat(), &whole);
    }
}

#[test]
fn restart_markers_that_are_lost_or_out_of_order_are_refused() {
    let marked = small(|e| e.set_restart_interval(2));
    let places: Vec<usize> = (scan(&marked).1..marked.len() - 1)
        .filter(|at| marked[*at] == 0xff && (0xd0..=0xd7).contains(&marked[at + 1]))
        .collect();
    let mut other = marked.clone();
    other[places[3] + 1] = 0xd6;
    assert!(
        refusal(&other).contains("restart marker 6 stands after 48 of 624 blocks, 3 is due"),
        "{}",
        refusal(&other)
    );
    // One interval is missing, then eight of them: the next marker is the right one again.
    for lost in [1, 8] {
        refusal(&[&marked[..places[3]], &marked[places[3 + lost]..]].concat());
    }
    let without_interval = without(&marked, 0xdd);
    assert!(
        refusal(&without_interval).contains("ends after 12 of 624 blocks"),
        "{}",
        refusal(&without_interval)
    );
}

#[test]
fn mjpeg_without_huffman_tables_has_those_of_the_standard() {
    for whole in [recorded("b02/a.jpg"), small(|_| {}), small(|e| e.set_restart_interval(4))] {
        let bare = without(&whole, 0xc4);
        assert!(bare.len() < whole.len());
        same(&bare, &whole);
        same(&bare[..bare.len() - 2], &whole);
        refusal(&bare[..bare.len() / 2]);
    }
}

#[test]
fn every_sampling_passes_and_torn_ones_do_not() {
    use SamplingFactor::*;
    let frame = Frame::from_jpeg(&small(|e| e.set_sampling_factor(F_1_1))).unwrap();
    for sampling in [F_1_1, F_2_1, F_1_2, F_2_2] {
        let jpeg = small(|e| e.set_sampling_factor(sampling));
        let other = Frame::from_jpeg(&jpeg).unwrap();
        assert_eq!([other.width_px(), other.height_px()], SMALL.map(usize::from));
        let apart: u32 = other.rgb().iter().zip(frame.rgb()).map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
        assert!(f64::from(apart) < 12.0 * frame.rgb().len() as f64, "{sampling:?}: other pixels");
        refusal(&jpeg[..jpeg.len() - 30]);
    }
}

#[test]
fn an_extended_frame_passes() {
    let whole = small(|_| {});
    let mut extended = whole.clone();
    let at = whole.windows(2).position(|pair| pair == [0xff, 0xc0]).unwrap();
    extended[at + 1] = 0xc1;
    same(&extended, &whole);
}

#[test]
fn other_forms_are_refused_by_name() {
    // This encoder puts each colour in a scan of its own if it makes its own tables.
    let apart = small(|e| e.set_optimized_huffman_tables(true));
    assert!(
        refusal(&apart).contains("not interleaved: its first scan has 1 of 3 colours"),
        "{}",
        refusal(&apart)
    );
    assert!(refusal(&small(|e| e.set_progressive(true))).contains("progressive"));
    let with = |kind: u8, at: usize, byte: u8| {
        let mut changed = small(|_| {});
        let start = changed.windows(2).position(|pair| pair == [0xff, kind]).unwrap();
        changed[start + at] = byte;
        refusal(&changed)
    };
    assert!(with(0xc0, 1, 0xc9).contains("of kind c9"));
    assert!(with(0xc0, 4, 12).contains("12 bits, 8 are allowed"));
    assert!(refusal(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR").contains("is a PNG, a JPEG is needed"));
    assert!(with(0xc0, 9, 4).contains("4 colours, 1 or 3 are allowed"));
    assert!(with(0xc0, 11, 0x33).contains("sampled 3 x 3"));
    assert!(with(0xc0, 14, 0x44).contains("21 blocks, 10 are allowed"));
    assert!(with(0xda, 6, 0x33).contains("lacks Huffman table 3"));
    assert!(with(0xdb, 5, 0).contains("a step of 0"));
}

/// Pictures that are not in the repository.
#[test]
fn shared_cases() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/cases/jpeg");
    let cases: [(&str, Result<(), &str>); 5] = [
        ("b02_a_without_dht.jpg", Ok(())),
        ("b04_a_q93.jpg", Ok(())),
        ("b02_a_non_interleaved.jpg", Err("not interleaved")),
        ("b03_a_torn.jpg", Err("filled with")),
        ("declares_too_much.jpg", Err("progressive")),
    ];
    let mut skipped = 0;
    for (name, expected) in cases {
        let Ok(bytes) = std::fs::read(folder.join(name)) else {
            skipped += 1;
            continue;
        };
        match (Frame::from_jpeg(&bytes), expected) {
            (Ok(frame), Ok(())) => assert_eq!((frame.width_px(), frame.height_px()), (2592, 1944), "{name}"),
            (Err(error), Err(text)) => {
                assert_eq!(error.kind(), ErrorKind::InvalidFrame);
                assert!(error.to_string().contains(text), "{name}: {error}");
            }
            (found, _) => panic!("{name}: {found:?}, {expected:?} is expected"),
        }
    }
    if skipped > 0 {
        // Straight to stdout: the test harness hides what a passing test prints, and a skipped test must be seen.
        writeln!(
            std::io::stdout(),
            "SKIPPED {skipped} of {} JPEGs: not in {}",
            cases.len(),
            folder.display()
        )
        .unwrap();
    }
}
