//! A step in brightness where only a tear can make one.
//!
//! Levels are told as differences, so a wrong one shifts all that follow it in the scan: from some place within a row of units to that
//! row's end, and in the next row up to the same place, each unit differs from the one above it by the same jump. A picture has edges
//! as long as a row, but hardly ever one that changes rows from one unit to the next.

use std::ops::Range;

/// The least jump, in grey levels; a smaller one hardly changes a measurement. Of 554 whole rendered frames one has such a jump in one
/// colour, 5 levels, where a faint edge of the scene is nearly level with the rows: so two colours must show it (`scan`).
const JUMP: i32 = 4;
/// In a quarter of a row's units the picture may hide the jump.
const HIDDEN: usize = 4;
/// Units on both sides of the tear, most of which must show the jump or lack it.
const BESIDE: usize = 10;

/// A tear that its levels show: the first unit behind it, and by how many grey levels it is too bright.
pub(super) struct Seam {
    pub(super) unit: usize,
    pub(super) jump: i32,
}

/// Looks for a seam. `levels` are those of one colour in grey levels, a unit each, in rows of `across`.
pub(super) fn find(levels: &[i16], across: usize) -> Option<Seam> {
    if across < 3 * BESIDE {
        return None;
    }
    let below = levels.get(across..)?;
    let brighter: Vec<i32> =
        levels.iter().zip(below).map(|(above, here)| i32::from(*here) - i32::from(*above)).collect();
    let darker: Vec<i32> = brighter.iter().map(|step| -step).collect();
    upwards(&brighter, across)
        .or_else(|| upwards(&darker, across).map(|seam| Seam { jump: -seam.jump, ..seam }))
}

/// Looks for a seam whose levels are too large. `steps` are the differences of each unit but the first row's from the one above.
fn upwards(steps: &[i32], across: usize) -> Option<Seam> {
    let shows = |step: Option<&i32>| usize::from(step.is_some_and(|step| *step >= JUMP));
    let mut count = steps.iter().take(across).map(|step| shows(Some(step))).sum::<usize>();
    for start in 0..steps.len().saturating_sub(across + BESIDE) {
        let (column, end) = (start % across, start + across);
        if count >= across - across / HIDDEN && (BESIDE..=across - BESIDE).contains(&column) {
            let outside = middle(steps, start - BESIDE..start).max(middle(steps, end..end + BESIDE));
            let inside = middle(steps, start..start + BESIDE).min(middle(steps, end - BESIDE..end));
            if inside >= JUMP && inside > 2 * outside {
                return Some(Seam { unit: end, jump: inside });
            }
        }
        count = count + shows(steps.get(end)) - shows(steps.get(start));
    }
    None
}

/// The median of some steps.
fn middle(steps: &[i32], range: Range<usize>) -> i32 {
    let mut some = steps[range].to_vec();
    some.sort_unstable();
    some[some.len() / 2]
}

#[cfg(test)]
mod tests {
    use super::*;

    const ACROSS: usize = 60;

    /// Twenty rows of a picture that is brighter to one side and has an edge below its eighth row, two units of it higher at the right.
    fn picture() -> Vec<i16> {
        let level = |unit: usize| {
            let (x, y) = (unit % ACROSS, unit / ACROSS);
            let wave = (unit * 7919 % 13) as i16 - 6;
            x as i16 + wave / 2 + if 8 * ACROSS + y < y * ACROSS + x / 30 { 90 } else { 0 }
        };
        (0..20 * ACROSS).map(level).collect()
    }

    #[test]
    fn a_picture_has_no_seam() {
        assert!(find(&picture(), ACROSS).is_none());
        assert!(find(&[], ACROSS).is_none());
        assert!(find(&[100; 20], 1).is_none());
    }

    #[test]
    fn a_shift_from_the_middle_of_a_row_on_is_a_seam() {
        for (unit, jump) in [(3 * ACROSS + 20, 12), (7 * ACROSS + 40, -30), (12 * ACROSS + 30, 9)] {
            let mut levels = picture();
            for level in &mut levels[unit..] {
                *level += jump;
            }
            let seam = find(&levels, ACROSS).expect("a seam");
            assert!(seam.unit.abs_diff(unit) < ACROSS / HIDDEN + BESIDE, "{} for {unit}", seam.unit);
            assert!((seam.jump - i32::from(jump)).abs() <= 4, "{} for {jump}", seam.jump);
        }
    }
}
