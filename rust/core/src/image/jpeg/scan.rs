//! Reads a scan through without keeping its picture: torn data ends early or late, or says what no picture can.
//!
//! A lost piece shifts all bits behind it. Codes find their way again after some blocks, but the number of blocks is then another one,
//! and the brightness is off by what was lost, so that it leaves its range sooner or later, or shows a seam.

use super::bits::{Mark, Part};
use super::block::{Block, of_unit};
use super::header::Header;
use super::{Error, invalid, seam};

/// A block that takes so many bytes from a run of equal ones is no picture.
const BYTES_OF_RUN: usize = 8;

/// Where the scan ends.
pub(super) struct End {
    /// Just behind the last byte of its data.
    pub(super) data: usize,
    /// An end marker stands right there.
    pub(super) marked: bool,
}

/// Reads all blocks that the header declares.
pub(super) fn read(file: &[u8], header: &Header) -> Result<End, Error> {
    let units = header.units[0] * header.units[1];
    let in_unit = header.blocks_in_unit();
    let data = file.len().saturating_sub(header.data_at);
    // The shortest block has two codes of one bit.
    if data * 8 < units * in_unit * 2 {
        return Err(invalid(format!(
            "the frame's data has {data} bytes, {} blocks take at least {}",
            units * in_unit,
            (units * in_unit * 2).div_ceil(8)
        )));
    }
    let unit = of_unit(header)?;
    let mut walk = Walk { unit: &unit, done: 0, all: units * in_unit, levels: Default::default() };
    let mut part = Part::new(data);
    let (mut at, mut done, mut restarts) = (header.data_at, 0, 0u8);
    loop {
        let mark = part.take(file, at);
        let wanted = if header.restart == 0 { units } else { header.restart.min(units - done) };
        let read = walk.read(&part, wanted)?;
        done += wanted;
        let (blocks, all) = (done * in_unit, units * in_unit);
        let whole_bytes = read.div_ceil(8);
        if !part.only_padding_from(whole_bytes) {
            return Err(invalid(format!(
                "the frame's data goes on for {} bytes after {blocks} of {all} blocks, where {} is due",
                part.len() - whole_bytes,
                if done == units { "its end" } else { "a restart marker" }
            )));
        }
        if done == units {
            walk.refuse_seams(header.units[0])?;
        }
        match mark {
            // Whatever marker stands here: some cameras close the last interval as they close all others.
            Mark::At(marker, behind) if done == units => {
                return Ok(End { data: behind - 2, marked: marker == 0xd9 });
            }
            Mark::Nothing if done == units => return Ok(End { data: file.len(), marked: false }),
            Mark::At(marker, behind) if marker == 0xd0 + restarts => at = behind,
            Mark::At(marker @ 0xd0..=0xd7, _) => {
                return Err(invalid(format!(
                    "restart marker {} stands after {blocks} of {all} blocks, {restarts} is due",
                    marker - 0xd0
                )));
            }
            Mark::At(..) | Mark::Nothing => return Err(ends_after(blocks, all)),
        }
        restarts = (restarts + 1) % 8;
    }
}

fn ends_after(done: usize, all: usize) -> Error {
    invalid(format!("the frame's data ends after {done} of {all} blocks"))
}

/// A way through a scan.
struct Walk<'a> {
    /// The blocks of a unit.
    unit: &'a [Block<'a>],
    done: usize,
    all: usize,
    /// Of each colour the level of each unit's last block.
    levels: [Vec<i16>; 3],
}

impl Walk<'_> {
    /// Reads units of a part, from its beginning; returns the bits that they take.
    fn read(&mut self, part: &Part, wanted: usize) -> Result<usize, Error> {
        let mut bits = part.bits();
        let mut level = [0i32; 3];
        let mut runs = part.runs();
        let end = part.len() * 8;
        for _ in 0..wanted {
            for block in self.unit {
                let start = bits.read();
                let torn = block.read(&mut bits, &mut level[block.colour]).err();
                let at = bits.read();
                if at > end {
                    return Err(ends_after(self.done, self.all));
                }
                if let Some(torn) = torn {
                    return Err(self.torn(torn));
                }
                while let Some((run, others)) = runs.split_first() {
                    if at.min(run[1] * 8) / 8 >= (start / 8).max(run[0]) + BYTES_OF_RUN {
                        return Err(self.torn(format!("is filled with {} equal bytes", run[1] - run[0])));
                    }
                    if at / 8 < run[1] {
                        break;
                    }
                    runs = others;
                }
                self.done += 1;
            }
            let mut last = usize::MAX;
            for block in
                self.unit.iter().filter(|block| std::mem::replace(&mut last, block.colour) != block.colour)
            {
                self.levels[block.colour].push(block.grey(level[block.colour]));
            }
        }
        Ok(bits.read())
    }

    fn torn(&self, what: impl std::fmt::Display) -> Error {
        invalid(format!("block {} of {} of the frame's data {what}", self.done, self.all))
    }

    /// After all units.
    fn refuse_seams(&self, across: usize) -> Result<(), Error> {
        match self.levels.iter().find_map(|levels| seam::find(levels, across)) {
            Some(seam) => Err(invalid(format!(
                "the frame's data jumps by {} grey levels before block {} of {}, and all that follows",
                seam.jump,
                seam.unit * self.unit.len(),
                self.all
            ))),
            None => Ok(()),
        }
    }
}
