//! Reads a scan through without keeping its picture: torn data ends early or late, or says what no picture can.
//!
//! A lost piece shifts all bits behind it. Codes find their way again after some blocks, but the number of blocks is then another one,
//! and the brightness is off by what was lost, so that it leaves its range sooner or later, or shows a seam.

use super::bits::{Bits, Mark, next_run};
use super::block::{Block, of_unit};
use super::header::Header;
use super::{Error, invalid, seam};

/// A block that takes so many bytes from a run of equal ones is no picture.
const BYTES_OF_RUN: usize = 8;
/// Seams of two colours are one if they are nearer than this part of a row: where a faint jump begins is known to that.
const SAME_PLACE: usize = 4;

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
    let mut scan = ScanReader {
        unit: &unit,
        file,
        run: next_run(file, header.data_at),
        done: 0,
        all: units * in_unit,
        levels: Default::default(),
    };
    let (mut at, mut done, mut restarts) = (header.data_at, 0, 0u8);
    loop {
        let wanted = if header.restart == 0 { units } else { header.restart.min(units - done) };
        let mut bits = scan.read(at, wanted)?;
        done += wanted;
        let (blocks, all) = (done * in_unit, units * in_unit);
        let left = bits.finish();
        if left > 0 {
            return Err(invalid(format!(
                "the frame's data goes on for {left} bytes after {blocks} of {all} blocks, where {} is due",
                if done == units { "its end" } else { "a restart marker" }
            )));
        }
        if done == units {
            scan.refuse_seams(header.units[0])?;
        }
        let (end, mark) = bits.mark();
        if done == units {
            // Whatever marker stands here: some cameras close the last interval as they close all others.
            return Ok(End { data: end, marked: file.get(end..end + 2) == Some(&[0xff, 0xd9]) });
        }
        match mark {
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

/// Reads a scan from one restart marker to the next.
struct ScanReader<'a> {
    /// The blocks of a unit.
    unit: &'a [Block<'a>],
    file: &'a [u8],
    /// The next run of equal bytes.
    run: Option<[usize; 2]>,
    done: usize,
    all: usize,
    /// Of each colour the level of each unit's last block.
    levels: [Vec<i16>; 3],
}

impl<'a> ScanReader<'a> {
    /// Reads units from a place on, up to a marker at most; returns what follows.
    fn read(&mut self, at: usize, wanted: usize) -> Result<Bits<'a>, Error> {
        let mut bits = Bits::new(self.file, at);
        let mut level = [0i32; 3];
        for _ in 0..wanted {
            for block in self.unit {
                let start = bits.place();
                let torn = block.read(&mut bits, &mut level[block.colour]).err();
                if bits.is_beyond() {
                    return Err(ends_after(self.done, self.all));
                }
                if let Some(torn) = torn {
                    return Err(self.torn(torn));
                }
                let end = bits.place();
                while let Some(run) = self.run {
                    if end.min(run[1]) >= start.max(run[0]) + BYTES_OF_RUN {
                        return Err(self.torn(format!("is filled with {} equal bytes", run[1] - run[0])));
                    }
                    if end < run[1] {
                        break;
                    }
                    self.run = next_run(self.file, run[1]);
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
        Ok(bits)
    }

    fn torn(&self, what: impl std::fmt::Display) -> Error {
        invalid(format!("block {} of {} of the frame's data {what}", self.done, self.all))
    }

    /// After all units. A tear leaves each colour with a wrong level; a faint edge of the scene that is nearly level with the rows
    /// looks the same in one of them.
    fn refuse_seams(&self, across: usize) -> Result<(), Error> {
        let seams: Vec<_> = self.levels.iter().filter_map(|levels| seam::find(levels, across)).collect();
        let together = seams.iter().enumerate().find(|(i, seam)| {
            seams[..*i].iter().any(|other| other.unit.abs_diff(seam.unit) <= across / SAME_PLACE)
        });
        match together.map(|(_, seam)| seam) {
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
