//! Recorded frames, torn in all ways that a cable, a hub or a buffer may tear them: how many are refused.

mod jpegs;

use boxline::Frame;
use jpegs::{recorded, refusal, scan};

const FRAMES: [&str; 7] =
    ["b01/a.jpg", "b02/a.jpg", "b03/b.jpg", "b04/a.jpg", "b05/a.jpg", "b06/b.jpg", "board/c09.jpg"];

/// What became of torn frames.
#[derive(Debug, Default)]
struct Count {
    torn: usize,
    refused: usize,
    /// The same pixels as the whole frame: nothing was lost.
    same: usize,
    /// Pixels that differ, as a share of those of a frame, where the frame passed.
    passed: Vec<f64>,
}

/// Tears each frame some times and counts. `tear` gets the frame, the frame after it, and a chunk's place in the data.
fn count(
    each: usize,
    mut tear: impl FnMut(&mut Vec<u8>, &[u8], std::ops::Range<usize>, &mut fastrand::Rng),
) -> Count {
    let mut numbers = fastrand::Rng::with_seed(0x9e37_79b9_7f4a_7c15);
    let files = FRAMES.map(recorded);
    let mut count = Count::default();
    for (i, file) in files.iter().enumerate() {
        let whole = Frame::from_jpeg(file).expect("the recorded frame is whole");
        let (_, data) = scan(file);
        for n in 0..each {
            let size = 512 << (n % 8);
            let at = data + numbers.usize(..file.len() - data - size);
            let mut torn = file.clone();
            tear(&mut torn, &files[(i + 1) % files.len()], at..at + size, &mut numbers);
            count.torn += 1;
            match Frame::from_jpeg(&torn) {
                Err(_) => count.refused += 1,
                Ok(frame) if frame == whole => count.same += 1,
                Ok(frame) => {
                    let pixels = frame.rgb().chunks_exact(3).zip(whole.rgb().chunks_exact(3));
                    let differ = pixels.filter(|(a, b)| a != b).count();
                    count.passed.push(differ as f64 / (whole.width_px() * whole.height_px()) as f64);
                }
            }
        }
    }
    count.passed.sort_by(f64::total_cmp);
    count
}

fn all_refused(count: &Count) {
    assert_eq!(count.torn, count.refused + count.same, "{count:?}");
}

#[test]
fn cut_frames_are_refused() {
    // All over the frame, and so near its end that little is missing.
    all_refused(&count(24, |torn, _, chunk, _| torn.truncate(chunk.start)));
    all_refused(&count(24, |torn, _, _, numbers| torn.truncate(torn.len() - 3 - numbers.usize(..200))));
}

#[test]
fn frames_that_lack_a_chunk_are_refused() {
    all_refused(&count(32, |torn, _, chunk, _| drop(torn.drain(chunk))));
}

#[test]
fn frames_with_a_chunk_of_equal_bytes_are_refused() {
    all_refused(&count(24, |torn, _, chunk, _| torn[chunk].fill(0)));
    for byte in [0xff, 0x55, 0x80] {
        all_refused(&count(8, |torn, _, chunk, _| torn[chunk].fill(byte)));
    }
    // The rest of the frame is missing, its buffer was cleared before.
    all_refused(&count(8, |torn, _, chunk, _| torn[chunk.start..].fill(0)));
}

/// Bytes of the same kind at the same place: about one of a hundred gives as many blocks by chance, with levels that a picture may
/// have.
#[test]
fn nearly_all_frames_with_a_foreign_chunk_are_refused() {
    for (name, count) in [
        (
            "of the same frame",
            count(40, |torn, _, chunk, numbers| {
                let (_, data) = scan(torn);
                let from = data + numbers.usize(..torn.len() - data - chunk.len());
                torn.copy_within(from..from + chunk.len(), chunk.start);
            }),
        ),
        (
            "of another frame",
            count(40, |torn, other, chunk, _| {
                let end = chunk.end.min(other.len());
                let start = chunk.start.min(end);
                torn[start..end].copy_from_slice(&other[start..end]);
            }),
        ),
    ] {
        println!("a chunk {name}: {} of {} pass", count.passed.len(), count.torn);
        assert!(count.passed.len() * 40 <= count.torn, "{name}: {count:?}");
    }
}

/// A single byte is another matter: its block gets another coefficient, or some blocks until the codes find their way again.
#[test]
fn of_frames_with_one_wrong_byte_a_part_is_refused() {
    let count = count(40, |torn, _, chunk, numbers| torn[chunk.start] ^= 1 + numbers.u8(..255));
    let passed = &count.passed;
    let share = |part: usize| passed[(passed.len() - 1) * part / 4];
    println!(
        "one wrong byte: {} of {} refused; of the others' pixels differ: half of them less than {:.4} %, three quarters {:.2} %",
        count.refused,
        count.torn,
        share(2) * 100.0,
        share(3) * 100.0
    );
    assert!(count.refused * 5 > count.torn, "{count:?}");
}

/// What is wrong is named with numbers.
#[test]
fn a_refusal_says_what_was_found() {
    let file = recorded("b02/b.jpg");
    let (_, data) = scan(&file);
    let blocks = 162 * 122 * 6;
    let cut = refusal(&file[..file.len() / 2]);
    assert!(
        cut.starts_with("the frame's data ends after ") && cut.ends_with(&format!("of {blocks} blocks")),
        "{cut}"
    );
    let little = refusal(&file[..data + 1000]);
    assert_eq!(little, format!("the frame's data has 1000 bytes, {blocks} blocks take at least 29646"));
    let mut filled = file.clone();
    filled[data + 100_000..data + 101_024].fill(0);
    let filled = refusal(&filled);
    assert!(filled.contains(&format!("of {blocks} of the frame's data is filled with 10")), "{filled}");
    let mut long = file[..file.len() - 2].to_vec();
    long.extend([0x12, 0x34, 0x56, 0xff, 0xd9]);
    let long = refusal(&long);
    assert!(long.contains(&format!("goes on for 3 bytes after {blocks} of {blocks} blocks")), "{long}");
}
