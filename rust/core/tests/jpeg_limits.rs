//! Bytes of any kind give a frame or an error: no panic, and no memory for what the bytes cannot hold. One test in a program of its
//! own, for its peak of memory is looked at.

mod jpegs;

use boxline::Frame;
use jpegs::{recorded, refusal, small, without};

/// The most memory that this program has had, kB; none where the system does not tell.
fn peak_kb() -> Option<usize> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?.trim().trim_end_matches(" kB").parse().ok()
}

/// The frame with another size in its header.
fn declaring(jpeg: &[u8], width: u16, height: u16) -> Vec<u8> {
    let mut changed = jpeg.to_vec();
    let at = jpeg.windows(2).position(|pair| matches!(pair, [0xff, 0xc0..=0xc2])).expect("a frame header");
    changed[at + 5..at + 7].copy_from_slice(&height.to_be_bytes());
    changed[at + 7..at + 9].copy_from_slice(&width.to_be_bytes());
    changed
}

#[test]
fn any_bytes_are_a_frame_or_an_error_within_bounds() {
    let forms = [
        small(|_| {}),
        small(|e| e.set_restart_interval(3)),
        small(|e| e.set_progressive(true)),
        small(|e| e.set_optimized_huffman_tables(true)),
        without(&small(|_| {}), 0xc4),
    ];
    let before = peak_kb();

    for form in &forms {
        for (width, height) in
            [(16_384, 16_384), (5792, 5792), (16_384, 2048), (65_535, 1), (0, 5), (5, 0), (65_535, 65_535)]
        {
            refusal(&declaring(form, width, height));
        }
    }
    let mut numbers = fastrand::Rng::with_seed(1);
    for round in 0..6000 {
        let mut bytes = forms[round % forms.len()].clone();
        let header = bytes.len().min(640);
        for _ in 0..1 + numbers.usize(..6) {
            // Most changes hit the header, where they do most harm.
            let place =
                if numbers.usize(..4) == 0 { numbers.usize(..bytes.len()) } else { numbers.usize(..header) };
            match numbers.usize(..3) {
                0 => bytes[place] ^= 1 << numbers.usize(..8),
                1 => bytes[place] = [0, 1, 0x7f, 0x80, 0xff][numbers.usize(..5)],
                _ => drop(bytes.drain(place..(place + 1 + numbers.usize(..40)).min(bytes.len()))),
            }
            if bytes.len() < 700 {
                break;
            }
        }
        drop(Frame::from_jpeg(&bytes));
    }
    for _ in 0..2000 {
        let mut bytes: Vec<u8> = (0..numbers.usize(..600)).map(|_| numbers.u8(..)).collect();
        drop(Frame::from_jpeg(&bytes));
        // Behind a beginning that is right.
        bytes.splice(0..0, forms[0][..numbers.usize(..forms[0].len())].iter().copied());
        drop(Frame::from_jpeg(&bytes));
    }
    if let (Some(before), Some(after)) = (before, peak_kb()) {
        assert!(after - before < 24 << 10, "{} kB were taken for frames of at most 12 kB", after - before);
    }

    // A whole frame is larger than all of that.
    Frame::from_jpeg(&recorded("b01/a.jpg")).expect("a whole frame");
}
