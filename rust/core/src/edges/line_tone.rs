//! The tone added up along straight lines of the image in whole numbers, for scans of some hundred lines a side.
//!
//! A place is interpolated between four pixels in steps of a quarter: the nearest pixel alone has twice the noise. Eight bytes are
//! taken at once, two pixels of three colours; each byte has 16 bits of a word to itself, room for the sum over 16 lines.

use super::ColourTone;
use crate::image::{Frame, LANES, word};
use crate::units::Px;
use std::ops::Range;

/// Bits of a place's fraction.
const FRACTION: u32 = 16;
/// Lines that go farther than this outside hold no pixel and would not fit 32 bits.
const FARTHEST_PX: f64 = 30_000.0;

/// Bits of it that weigh two pixels against each other.
const WEIGHT: u32 = 2;
const ONE: u64 = 1 << WEIGHT;

/// So many places are fetched before they are added up: the memory answers many questions in the time of one.
const AT_ONCE: usize = 32;

/// The words of two pixels and more at a place and below it; `None` outside the image and for the last two bytes of a frame.
#[inline]
fn around(frame: &Frame, x: i32, y: i32) -> Option<(u64, u64)> {
    // A negative place is a huge one.
    let (x, y, width) = (x as usize, y as usize, frame.width_px());
    if x >= width - 1 || y >= frame.height_px() - 1 {
        return None;
    }
    let at = (y * width + x) * 3;
    Some((word(frame.rgb().get(at..)?)?, word(frame.rgb().get(at + width * 3..)?)?))
}

/// Sums over several lines at one place.
#[derive(Clone, Copy, Default)]
struct Sum {
    /// Red and blue in the lowest 16 bits and the next; what stands above is of no use.
    red_blue: u64,
    /// Green in the lowest 16 bits.
    green: u64,
    lines: u32,
}

/// Sums of the tone over several lines, place by place; at most 16 lines.
pub(crate) struct LineTones {
    sums: Vec<Sum>,
}

impl LineTones {
    /// No line yet.
    pub fn new(places: usize) -> Self {
        Self { sums: vec![Sum::default(); places] }
    }

    /// As new.
    pub fn clear(&mut self) {
        self.sums.fill(Sum::default());
    }

    /// Adds the tones along a line: the first of `places` is at `from`, the others follow in steps of `step_px` (u, v). What lies
    /// outside the image is left out.
    pub fn add(&mut self, frame: &Frame, places: Range<usize>, from: Px, step_px: [f64; 2]) {
        let length = places.len() as f64;
        let ends = [from.u, from.v, from.u + step_px[0] * length, from.v + step_px[1] * length];
        if !ends.iter().all(|x| x.abs() < FARTHEST_PX) {
            return;
        }
        let fixed = |px: f64| (px * f64::from(1u32 << FRACTION)) as i32;
        // Half a step of the weights is added, so that cutting off rounds.
        let half = 1 << (FRACTION - WEIGHT - 1);
        let (mut u, mut v) = (fixed(from.u) + half, fixed(from.v) + half);
        let (du, dv) = (fixed(step_px[0]), fixed(step_px[1]));
        let mut fetched = [(0, 0); AT_ONCE];
        for sums in self.sums[places].chunks_mut(AT_ONCE) {
            let (first_u, first_v) = (u, v);
            for (pixels, sum) in fetched.iter_mut().zip(&mut *sums) {
                let found = around(frame, u >> FRACTION, v >> FRACTION);
                sum.lines += u32::from(found.is_some());
                *pixels = found.unwrap_or_default();
                // The ends fit, so do all between.
                (u, v) = (u.wrapping_add(du), v.wrapping_add(dv));
            }
            let (mut u, mut v) = (first_u, first_v);
            for ((top, below), sum) in fetched.iter().zip(sums) {
                let weight = |fixed: i32| fixed as u64 >> (FRACTION - WEIGHT) & (ONE - 1);
                let (right, down) = (weight(u), weight(v));
                let mix = |top: u64, below: u64| (top & LANES) * (ONE - down) + (below & LANES) * down;
                // From the lowest lane: red, blue, the neighbour's green; and green, the neighbour's red and blue.
                let (even, odd) = (mix(*top, *below), mix(top >> 8, below >> 8));
                let between = |left: u64, next: u64| left * (ONE - right) + next * right;
                sum.red_blue = sum.red_blue.wrapping_add(between(even, odd >> 16));
                sum.green = sum.green.wrapping_add(between(odd, even >> 32));
                (u, v) = (u.wrapping_add(du), v.wrapping_add(dv));
            }
        }
    }

    /// The mean tone of each place, NaN where fewer than `least` lines were inside the image.
    pub fn means(&self, least: u32) -> impl Iterator<Item = ColourTone> + '_ {
        self.sums.iter().map(move |sum| {
            let scale = if sum.lines >= least.max(1) {
                0.5 / ((ONE * ONE) as f32 * sum.lines as f32)
            } else {
                f32::NAN
            };
            let lane = |word: u64, index: u32| (word >> (16 * index) & 0xffff) as f32;
            let (red, blue, green) = (lane(sum.red_blue, 0), lane(sum.red_blue, 1), lane(sum.green, 0));
            [(green + blue) * scale, (red - blue) * scale]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edges::tone;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn it_is_the_interpolated_tone(
            seed: u32, u in -20.0..60.0f64, v in -20.0..50.0f64, du in -1.5..1.5f64, dv in -1.5..1.5f64
        ) {
            let mut random = fastrand::Rng::with_seed(seed.into());
            let rgb = (0..40 * 30 * 3).map(|_| random.u8(..)).collect();
            let frame = Frame::from_rgb(40, 30, rgb).expect("the size fits");
            let mut tones = LineTones::new(40);
            tones.add(&frame, 3..37, Px::new(u, v), [du, dv]);
            tones.add(&frame, 3..37, Px::new(u, v), [du, dv]);
            for (k, found) in tones.means(1).enumerate() {
                let s = k as f64 - 3.0;
                let (u, v) = (u + du * s, v + dv * s);
                let quarter = |x: f64| (4.0 * x).round() / 4.0;
                let unsure = |x: f64| (4.0 * x - (4.0 * x).floor() - 0.5).abs() < 0.01;
                if unsure(u) || unsure(v) || (u > 37.8 && v > 27.8) {
                    continue; // rounding decides which quarter it is; the last two bytes have no word
                }
                let (u, v) = (quarter(u), quarter(v));
                match tone(&frame, u, v).filter(|_| (3..37).contains(&k)) {
                    Some(want) => for c in 0..2 {
                        prop_assert!((found[c] - want[c]).abs() < 1e-3, "{found:?} for {want:?} at {u}, {v}");
                    },
                    None => prop_assert!(found[0].is_nan(), "{found:?} outside, at {u}, {v}"),
                }
            }
        }
    }

    #[test]
    fn lines_far_outside_hold_nothing() {
        let frame = Frame::from_rgb(8, 8, vec![90; 8 * 8 * 3]).expect("the size fits");
        let mut tones = LineTones::new(32);
        for far in [1e9, -1e9, f64::NAN, f64::INFINITY] {
            tones.add(&frame, 0..32, Px::new(far, 4.0), [1.0, 0.0]);
            tones.add(&frame, 0..32, Px::new(4.0, 4.0), [0.0, far]);
        }
        assert!(tones.means(1).all(|t| t[0].is_nan()));
        tones.add(&frame, 0..4, Px::new(1.0, 1.0), [1.0, 1.0]);
        assert_eq!(tones.means(1).filter(|t| *t == [90.0, 0.0]).count(), 4);
    }
}
