//! One block of a scan, read for its length, its level and what no picture can have.

use super::bits::Bits;
use super::header::{Component, Header};
use super::huffman::{ASIDE, END, Sizes, Steps};
use super::{Error, invalid};

/// The largest coefficient that samples of 8 bits can give: eight times 128.
const FULL: i32 = 1024;
/// Energy of the largest coefficients, FULL², and a tenth for encoders that calculate roughly.
const FULL_ENERGY: i64 = 1_153_434;

/// A block's tables, and the place of its colour.
pub(super) struct Block<'a> {
    pub(super) colour: usize,
    dc: &'a Sizes,
    ac: &'a Steps,
    component: &'a Component,
}

/// The blocks of a unit, in the order of the data.
pub(super) fn of_unit(header: &Header) -> Result<Vec<Block<'_>>, Error> {
    let mut all = Vec::new();
    for (colour, component) in header.components.iter().enumerate() {
        let missing = || invalid("the JPEG lacks a Huffman table");
        let dc = header.dc[component.dc].as_ref().ok_or_else(missing)?;
        let ac = header.ac[component.ac].as_ref().ok_or_else(missing)?;
        all.extend((0..component.across * component.down).map(|_| Block { colour, dc, ac, component }));
    }
    Ok(all)
}

/// What no picture has.
pub(super) enum Torn {
    /// Bits that are no code.
    Code,
    /// A code whose run and size do not exist.
    Kind(u8),
    /// A change of level by too many bits.
    Change(u8),
    /// A level, and the largest that is allowed.
    Level(i32, i32),
    /// A coefficient that, with those before it, is too large.
    Coefficient(i64),
    /// More coefficients than a block has.
    Count(usize),
}

impl std::fmt::Display for Torn {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Code => write!(f, "has a code that does not exist"),
            Self::Kind(kind) => write!(f, "has a coefficient of kind {kind:02x}, which does not exist"),
            Self::Change(bits) => write!(f, "changes its level by {bits} bits, 11 are allowed"),
            Self::Level(level, allowed) => {
                write!(f, "has a level of {level}, -{allowed} to {allowed} are allowed")
            }
            Self::Coefficient(size) => write!(f, "has a coefficient of {size}, {FULL} are allowed"),
            Self::Count(count) => write!(f, "has {count} coefficients, 64 are allowed"),
        }
    }
}

impl Block<'_> {
    /// A first coefficient in grey levels.
    pub(super) fn grey(&self, level: i32) -> i16 {
        // What `read` lets pass is less than 2^17.
        (level * i32::from(self.component.steps[0]) / 8) as i16
    }

    /// Reads one block. `level` is the colour's last first coefficient.
    #[inline]
    pub(super) fn read(&self, bits: &mut Bits<'_>, level: &mut i32) -> Result<(), Torn> {
        bits.fill();
        let (size, length) = self.dc.symbol(bits.seen).ok_or(Torn::Code)?;
        bits.skip(length);
        if size > 11 {
            return Err(Torn::Change(size));
        }
        *level += bits.value(u32::from(size));
        let step = i32::from(self.component.steps[0]);
        // A level in steps is rounded, hence one step more.
        if level.abs().saturating_mul(step) > FULL + step {
            return Err(Torn::Level(level.saturating_mul(step), FULL + step));
        }
        let mut at = 1;
        let mut energy = 0;
        // A copy, which can stay in registers.
        let mut next_bits = *bits;
        while at < 64 {
            next_bits.fill();
            let step = self.ac.several(next_bits.seen);
            let next = at + step.passed();
            // Of several codes none but the last may be the block's last, which needs no end.
            if next & ASIDE != 0 {
                (next_bits, at, energy) = self.aside(next_bits, at, energy)?;
                continue;
            }
            next_bits.skip(step.bits());
            at = next;
        }
        *bits = next_bits;
        if at > 64 && at < END { Err(Torn::Count(at)) } else { Ok(()) }
    }

    /// Reads one code that the tables do not hold, or the last; returns the place behind it.
    #[cold]
    fn aside<'b>(&self, mut bits: Bits<'b>, at: usize, energy: i64) -> Result<(Bits<'b>, usize, i64), Torn> {
        let step = self.ac.one(bits.seen);
        if step.passed() != ASIDE {
            bits.skip(step.bits());
            return Ok((bits, at + step.passed(), energy));
        }
        let (symbol, length) = self.ac.codes.symbol(bits.seen).ok_or(Torn::Code)?;
        bits.skip(length);
        let (run, size) = (usize::from(symbol >> 4), u32::from(symbol & 15));
        match (run, size) {
            (0, 0) => return Ok((bits, at + END, energy)),
            (15, 0) => return Ok((bits, at + 16, energy)),
            (_, 1..=10) => {}
            _ => return Err(Torn::Kind(symbol)),
        }
        let value = bits.value(size).abs();
        let step = *self.component.steps.get(at + run).ok_or(Torn::Count(at + run + 1))?;
        // A value in steps is rounded: it was at least half a step less.
        let least = (i64::from(value) * 2 - 1) * i64::from(step) / 2;
        let energy = energy + least * least;
        if energy > FULL_ENERGY { Err(Torn::Coefficient(least)) } else { Ok((bits, at + run + 1, energy)) }
    }
}
