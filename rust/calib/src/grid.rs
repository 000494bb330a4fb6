//! Orders blobs into a grid: from a blob with neighbours on all four sides outwards, each next circle predicted from those
//! that have a place already. No homography of the whole is used, so distortion does no harm, and no corner or border of
//! the board need be in view.

use super::blobs::Blob;
use nalgebra::Vector2;
use std::collections::{BTreeMap, VecDeque};

/// Column and row, from any origin.
pub(super) type Cell = (i32, i32);

/// Neighbours are at most this many radii apart: circles of a third of the pitch.
const MAX_PITCH_RADII: f64 = 7.0;
/// How far from its predicted place a circle may be, in pitches: perspective changes the pitch by less than a fifth from
/// one circle to the next.
const TOLERANCE: f64 = 0.25;
/// Seeds that are tried: most blobs of a board in view are good ones.
const MAX_SEEDS: usize = 60;

/// The largest grid among the blobs: which blob is in which cell.
pub(super) fn largest_grid(blobs: &[Blob]) -> BTreeMap<Cell, usize> {
    let mut best = BTreeMap::new();
    let mut taken = vec![false; blobs.len()];
    let mut tried = 0;
    let seeds = (0..blobs.len()).filter_map(|s| Some((s, seed_steps(blobs, s)?)));
    for (seed, steps) in seeds.collect::<Vec<_>>() {
        if taken[seed] || tried == MAX_SEEDS {
            continue;
        }
        tried += 1;
        let grid = grow(blobs, seed, steps);
        for blob in grid.values() {
            taken[*blob] = true;
        }
        if grid.len() > best.len() {
            best = grid;
        }
    }
    without_strays(blobs, best)
}

/// The two steps to the next column and row at a blob that has neighbours on all four sides. They turn like x and y of the
/// board seen from its printed side: against the clock.
fn seed_steps(blobs: &[Blob], seed: usize) -> Option<[Vector2<f64>; 2]> {
    let blob = &blobs[seed];
    let mut near: Vec<(f64, Vector2<f64>)> = blobs
        .iter()
        .enumerate()
        .filter(|(i, other)| *i != seed && alike(blob, other))
        .map(|(_, other)| (blob.in_radii(other.at - blob.at), other.at - blob.at))
        .filter(|(distance, _)| (2.0..MAX_PITCH_RADII).contains(distance))
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    let nearest = near.first()?.0;
    near.retain(|(distance, _)| *distance < 1.3 * nearest);
    let find = |wanted: Vector2<f64>| {
        near.iter()
            .map(|(_, v)| *v)
            .filter(|v| blob.in_radii(v - wanted) < TOLERANCE * 1.4 * nearest)
            .min_by(|a, b| (a - wanted).norm().total_cmp(&(b - wanted).norm()))
    };
    let a = near.first()?.1;
    let back = find(-a)?;
    // Perpendicular on the board is perpendicular in the metric of the ellipse.
    let metric = blob.moments.try_inverse()?;
    let b = near.iter().map(|(_, v)| *v).find(|v| {
        let cosine = (a.dot(&(metric * v))) / (a.dot(&(metric * a)) * v.dot(&(metric * v))).sqrt();
        cosine.abs() < 0.35
    })?;
    let other = find(-b)?;
    let (a, b) = (0.5 * (a - back), 0.5 * (b - other));
    Some(if a.perp(&b) < 0.0 { [a, b] } else { [a, -b] })
}

/// Neighbours on a board have nearly the same size.
fn alike(a: &Blob, b: &Blob) -> bool {
    (0.6..1.7).contains(&(a.radius_px() / b.radius_px()))
}

fn grow(blobs: &[Blob], seed: usize, steps: [Vector2<f64>; 2]) -> BTreeMap<Cell, usize> {
    let mut cells = BTreeMap::from([((0, 0), seed)]);
    let mut used = vec![false; blobs.len()];
    used[seed] = true;
    let mut steps_at = BTreeMap::from([((0, 0), steps)]);
    let mut queue = VecDeque::from([(0, 0)]);
    while let Some((i, j)) = queue.pop_front() {
        let steps = steps_at[&(i, j)];
        let here = blobs[cells[&(i, j)]].at;
        for (di, dj) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            let next = (i + di, j + dj);
            if cells.contains_key(&next) {
                continue;
            }
            let axis = usize::from(di == 0);
            let sign = f64::from(di + dj);
            // From the circle before, else from the row beside, else the step that led here.
            let at = |c: Cell| cells.get(&c).map(|b| blobs[*b].at);
            let straight = at((i - di, j - dj)).map(|before| here - before);
            let beside = [(dj, di), (-dj, -di)]
                .into_iter()
                .find_map(|(si, sj)| Some(at((i + si + di, j + sj + dj))? - at((i + si, j + sj))?));
            let step = match (straight, beside) {
                (Some(a), Some(b)) => 0.5 * (a + b),
                (Some(a), None) | (None, Some(a)) => a,
                (None, None) => steps[axis] * sign,
            };
            let wanted = here + step;
            let reach = TOLERANCE * step.norm();
            let found = (0..blobs.len())
                .filter(|b| !used[*b] && alike(&blobs[*b], &blobs[cells[&(i, j)]]))
                .map(|b| (b, (blobs[b].at - wanted).norm()))
                .filter(|(_, distance)| *distance < reach)
                .min_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((blob, _)) = found {
                used[blob] = true;
                cells.insert(next, blob);
                let mut own = steps;
                own[axis] = (blobs[blob].at - here) * sign;
                steps_at.insert(next, own);
                queue.push_back(next);
            }
        }
    }
    cells
}

/// Without circles that are not half way between their neighbours: print beside the board that fell into a cell.
fn without_strays(blobs: &[Blob], grid: BTreeMap<Cell, usize>) -> BTreeMap<Cell, usize> {
    let at = |c: Cell| grid.get(&c).map(|b| blobs[*b].at);
    let keeps = |cell: &Cell| {
        let here = blobs[grid[cell]].at;
        let mut links = 0;
        let mut bad = 0;
        for (di, dj) in [(1, 0), (0, 1)] {
            let (before, after) = (at((cell.0 - di, cell.1 - dj)), at((cell.0 + di, cell.1 + dj)));
            links += usize::from(before.is_some()) + usize::from(after.is_some());
            if let (Some(before), Some(after)) = (before, after)
                && (0.5 * (before + after) - here).norm() > 0.5 * TOLERANCE * (after - before).norm()
            {
                bad += 1;
            }
        }
        links >= 2 && bad < 2
    };
    grid.iter().filter(|(cell, _)| keeps(cell)).map(|(c, b)| (*c, *b)).collect()
}
