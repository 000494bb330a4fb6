//! Sizes of arrays, axes, and where values lie.

use super::build::{Outcome, wrong};
use super::len_of;
use super::ops::{Lanes, Spread};
use crate::onnx::bad;

/// The number of an axis that may be counted from the end.
pub(super) fn axis_of(axis: i64, rank: usize) -> Outcome<usize> {
    let counted = if axis < 0 {
        usize::try_from(axis.unsigned_abs()).ok().and_then(|a| rank.checked_sub(a))
    } else {
        usize::try_from(axis).ok()
    };
    counted.filter(|axis| *axis < rank).ok_or_else(|| bad(format!("axis {axis} of {rank}")))
}

pub(super) fn size_of(size: i64) -> Outcome<usize> {
    usize::try_from(size).or_else(|_| wrong(format!("a size is {size}")))
}

/// How far apart neighbours along each axis are.
pub(super) fn steps_of(sizes: &[usize]) -> Vec<usize> {
    let mut steps = vec![1; sizes.len()];
    for axis in (1..sizes.len()).rev() {
        steps[axis - 1] = steps[axis] * sizes[axis];
    }
    steps
}

/// Places in an array: of each axis these, where neighbours are so far apart.
pub(super) fn places(picks: &[Vec<usize>], steps: &[usize]) -> Vec<u32> {
    let mut places = vec![0u32];
    for (picks, step) in picks.iter().zip(steps) {
        let one = |place: &u32, pick: &usize| place + u32::try_from(pick * step).unwrap_or(u32::MAX);
        places = places.iter().flat_map(|place| picks.iter().map(move |pick| one(place, pick))).collect();
    }
    places
}

/// All of every axis.
pub(super) fn all_of(sizes: &[usize]) -> Vec<Vec<usize>> {
    sizes.iter().map(|size| (0..*size).collect()).collect()
}

/// The sizes that two arrays have together, where an axis of one is repeated.
pub(super) fn spread_sizes(a: &[usize], b: &[usize]) -> Outcome<Vec<usize>> {
    let rank = a.len().max(b.len());
    let size =
        |sizes: &[usize], axis: usize| (axis + sizes.len()).checked_sub(rank).map_or(1, |axis| sizes[axis]);
    let both = (0..rank).map(|axis| match (size(a, axis), size(b, axis)) {
        (a, b) if a == b => Ok(a),
        (a, 1) => Ok(a),
        (1, b) => Ok(b),
        _ => wrong(format!("arrays of {a:?} and {b:?} do not go together")),
    });
    both.collect()
}

/// Where each value of the larger array is in one whose axes are repeated.
pub(super) fn spread_places(sizes: &[usize], over: &[usize]) -> Vec<u32> {
    let mut padded = vec![1; over.len() - sizes.len()];
    padded.extend(sizes);
    let steps = steps_of(&padded);
    let picks: Vec<Vec<usize>> = padded
        .iter()
        .zip(over)
        .map(|(own, over)| if own == over { (0..*over).collect() } else { vec![0; *over] })
        .collect();
    places(&picks, &steps)
}

pub(super) fn spread(sizes: &[usize], over: &[usize]) -> Spread {
    match (len_of(sizes), len_of(over)) {
        (one, all) if one == all => Spread::Same,
        (Some(1), _) => Spread::One,
        _ if over.ends_with(&sizes[sizes.iter().take_while(|size| **size == 1).count()..]) => Spread::Cycle,
        _ => Spread::Table(spread_places(sizes, over)),
    }
}

/// Axes that lie side by side, as one.
pub(super) fn lanes(sizes: &[usize], axes: &[usize]) -> Outcome<Lanes> {
    let (Some(first), Some(last)) = (axes.iter().min(), axes.iter().max()) else {
        return wrong("it has no axes");
    };
    if !(*first..=*last).all(|axis| axes.contains(&axis)) {
        return wrong(format!(
            "axes {axes:?} do not lie side by side, as the engine inside wants; ONNX Runtime can run it"
        ));
    }
    let product = |sizes: &[usize]| sizes.iter().product::<usize>();
    let (len, inner) = (product(&sizes[*first..=*last]), product(&sizes[last + 1..]));
    if len == 0 || inner == 0 {
        return wrong("nothing to work on");
    }
    Ok(Lanes { len, inner })
}

/// Places in an array of four axes for twice as many rows and columns.
pub(super) fn doubled(sizes: &[usize]) -> Vec<u32> {
    let twice = |axis: usize| if axis < 2 { 1 } else { 2 };
    let picks: Vec<Vec<usize>> = (0..sizes.len())
        .map(|axis| (0..sizes[axis] * twice(axis)).map(|n| n / twice(axis)).collect())
        .collect();
    places(&picks, &steps_of(sizes))
}
