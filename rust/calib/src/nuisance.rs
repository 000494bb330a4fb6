//! What may be wrong with head and board, in camera, planes and their covariance: whether it is named or not. Each pattern's unknowns are
//! normal about zero, and how large they are is unknown: nothing, or up to what heads and boards are found to be. Each size counts as much
//! as the frames make it likely (the evidence of a linear model, MacKay 1992; averaged over sizes as Hoeting et al. 1999), so what the
//! frames show is taken out, what they exclude costs nothing, and what they leave open is in the covariance.

use super::adjust::{FIXED, Fixed, Information, covariance, solve_scaled};
use super::fields::{Fields, TILTS};
use super::lens::LensTerms;
use super::misfit_kind::MisfitKind;
use super::model::{SHARED, SKEW, Shared};
use super::patterns::{Patterns, ReducedSystem, Solved};
use boxline::calibration::{CalibrationCovariance, CalibrationStep, FIRST_PLANE};
use nalgebra::{DMatrix, DVector, SVector};
use std::ops::Range;

/// What a lens's terms p1, p2 and k3 may be before frames are seen: half of 0.01 and 0.2, the most that `rust/sim` draws.
const LENS_SIGMAS: [(usize, f64); 3] = [(18, 0.005), (19, 0.005), (20, 0.1)];
/// Sizes of a pattern, from the most down by a factor of two, and none, which is as likely as all others together.
const SIZES: usize = 7;
/// Rounds of patterns and observations without them: weights and noise follow what is left.
const ROUNDS: usize = 2;
/// Sizes that are less likely than this, given the likeliest of the other patterns, do not count.
const LEAST_LIKELY: f64 = 0.01;

/// The last patterns, in this order: two ways to say much the same.
const OF_PITCH: [MisfitKind; 2] = [MisfitKind::BoardStretched, MisfitKind::BoardsDiffer];

/// Camera and planes over all sizes of what may be wrong.
pub(super) struct Averaged {
    pub shared: Shared,
    pub covariance: CalibrationCovariance,
    /// Of the skew, px, where it is an unknown.
    pub skew_sigma_px: Option<f64>,
    /// What the frames tell about these, and what is known of the lens's terms before.
    pub information: Information,
    /// Patterns that are rather not there than there, beside all others.
    pub absent: Vec<MisfitKind>,
}

/// One pattern, or the sensor's tilt: its unknowns, which are of one size.
struct Part {
    unknowns: Range<usize>,
    /// Logarithm of how likely it is that there is any.
    log_any: f64,
}

/// Camera and planes beside these patterns and all that may be there without being named. `left` is solved with observations from which
/// the patterns of these values are taken.
pub(super) fn averaged(
    solved: &Solved,
    mut left: Solved,
    named: &Patterns,
    values: &DVector<f64>,
) -> Option<Averaged> {
    let (mut patterns, mut values) = with_all(&left, named, values)?;
    let usual = patterns.usual();
    let parts = parts(&patterns);
    left = left.with_signs(solved, &mut patterns, &mut values)?;
    for _ in 0..ROUNDS {
        values = Beside::new(&left, &patterns, &values)?.over_sizes(&parts, &usual)?.mean;
        left = solved.without(&left, &patterns, &values)?;
    }
    let beside = Beside::new(&left, &patterns, &values)?;
    let over = beside.over_sizes(&parts, &usual)?;
    let (lens, inverse) = beside.shared(&over, &values);
    // How far a term that the lens has not would move from 0, and camera and planes with it, is one more standard deviation.
    let lens = CalibrationStep::from_fn(|i, _| if beside.fixed.contains(i) { 0.0 } else { lens[i] });
    // A camera has no terms for a tilted sensor. It and the planes take of it what they can, since boxes are seen through it too, and how far
    // that moves them is one more standard deviation: another part of the picture would take another share.
    let upright = left.shared.clone();
    values.rows_mut(patterns.tilt(), TILTS).fill(0.0);
    left = solved.without(&left, &patterns, &values)?;
    let tilted = left.shared.minus(&upright);
    let stretch = scale_sigma(&patterns, &over);
    let mut scaled = CalibrationStep::zeros();
    for (k, plane) in left.shared.planes.iter().enumerate().filter(|_| !left.fixed.planes) {
        scaled.fixed_rows_mut::<3>(FIRST_PLANE + 3 * k).copy_from(&(plane * stretch));
    }
    let (_, information) = solve_scaled(&inverse, &SVector::zeros())?;
    let covariance = covariance(&inverse)
        + lens * lens.transpose()
        + tilted * tilted.transpose()
        + scaled * scaled.transpose();
    let skew_by_tilt_px = left.shared.camera.skew - upright.camera.skew;
    let skew_sigma_px =
        (!left.fixed.contains(SKEW)).then(|| inverse[(SKEW, SKEW)].max(0.0).sqrt().hypot(skew_by_tilt_px));
    let absent = patterns.kinds.iter().zip(&over.none).filter(|(_, none)| **none > 0.5);
    let absent = absent.map(|(kind, _)| *kind).collect();
    Some(Averaged { shared: left.shared, covariance, skew_sigma_px, information, absent })
}

/// These patterns and all that may be there without being named.
fn with_all(left: &Solved, named: &Patterns, values: &DVector<f64>) -> Option<(Patterns, DVector<f64>)> {
    let mut patterns =
        Patterns { fields: Some(Fields::new(&left.shared.camera, left.image_px)?), ..named.clone() };
    patterns.kinds.retain(|kind| !OF_PITCH.contains(kind));
    let more = [MisfitKind::BoardBowed, MisfitKind::FocusChanges].into_iter();
    patterns.kinds.extend(more.filter(|kind| !named.kinds.contains(kind)));
    patterns.kinds.push(MisfitKind::BoardStretched);
    patterns.kinds.extend(named.kinds.iter().filter(|kind| **kind == MisfitKind::BoardsDiffer));
    patterns.signs.get_or_insert_with(|| vec![1.0; named.frames]);
    let mut all = DVector::zeros(patterns.all_columns());
    let mut first = 0;
    for kind in &patterns.kinds {
        if let Some(from) = named.first(*kind) {
            let n = patterns.columns(*kind);
            all.rows_mut(first, n).copy_from(&values.rows(from, n));
        }
        first += patterns.columns(*kind);
    }
    Some((patterns, all))
}

impl Solved {
    /// The frames' signs anew, by what is left with a board that is not stretched and boards that do not differ: two ways to say the same.
    /// Of what is left then, boards that differ stay taken out: they would hide in its noise.
    fn with_signs(&self, solved: &Self, patterns: &mut Patterns, values: &mut DVector<f64>) -> Option<Self> {
        let stretched = patterns.first(MisfitKind::BoardStretched)?;
        let mut neither = values.clone();
        neither.rows_mut(stretched, patterns.tilt() - stretched).fill(0.0);
        let mut others = patterns.clone();
        others.kinds.retain(|kind| !OF_PITCH.contains(kind));
        others.signs = None;
        patterns.signs = Some(solved.without(self, patterns, &neither)?.signs(&others)?);
        values.rows_mut(stretched, patterns.columns(MisfitKind::BoardStretched)).fill(0.0);
        solved.without(self, patterns, values)
    }
}

fn parts(patterns: &Patterns) -> Vec<Part> {
    let mut first = 0;
    let mut parts = Vec::new();
    for kind in &patterns.kinds {
        let unknowns = first..first + patterns.columns(*kind);
        first = unknowns.end;
        // Any of so many choices of the frames' signs, of which this is the best.
        let choices = patterns.free_signs(*kind);
        parts.push(Part { unknowns, log_any: -std::f64::consts::LN_2 * choices as f64 });
    }
    parts.push(Part { unknowns: patterns.tilt()..patterns.all_columns(), log_any: 0.0 });
    parts
}

/// Of a stretched board, which of its pitches is the file's is unknown: half of their difference, as a share of all lengths.
fn scale_sigma(patterns: &Patterns, over: &OverSizes) -> f64 {
    patterns.first(MisfitKind::BoardStretched).map_or(0.0, |first| {
        let square = |i: usize| over.mean[i].powi(2) + over.covariance[(i, i)];
        (square(first) + square(first + 1)).sqrt()
    })
}

/// Patterns' unknowns over all of their sizes.
struct OverSizes {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    /// How likely it is of each part that there is none.
    none: Vec<f64>,
}

/// What the frames tell about the patterns' unknowns, camera and planes free, and how these follow them.
struct Beside {
    /// About the difference to the present values.
    reduced: ReducedSystem,
    present: DVector<f64>,
    /// All of Brown's terms are free.
    fixed: Fixed,
    /// Camera and planes if no pattern were unknown.
    step: SVector<f64, SHARED>,
    inverse: Information,
    /// How they move with each unknown.
    by_pattern: DMatrix<f64>,
}

impl Beside {
    /// All of Brown's terms are free: one that the camera has not is 0 as long as the frames do not choose it, and that may be wrong. It is
    /// known as well as [`LENS_SIGMAS`] and the frames together tell.
    fn new(left: &Solved, patterns: &Patterns, values: &DVector<f64>) -> Option<Self> {
        let fixed = Fixed { lens: LensTerms::BROWN, ..left.fixed };
        let all = Solved { fixed, ..left.clone() }.normal_equations(patterns)?;
        let rest = values.len();
        let mut shared = Information::from_fn(|i, j| all.information[(i, j)]);
        for (i, sigma) in LENS_SIGMAS {
            if left.fixed.contains(i) && !fixed.contains(i) {
                shared[(i, i)] += sigma.powi(-2);
            }
        }
        (0..SHARED).filter(|i| fixed.contains(*i)).for_each(|i| shared[(i, i)] = FIXED);
        let (step, inverse) = solve_scaled(&shared, &SVector::from_fn(|i, _| all.right[i]))?;
        let across = all.information.view((0, SHARED), (SHARED, rest)).into_owned();
        let by_pattern = -(DMatrix::from_fn(SHARED, SHARED, |i, j| inverse[(i, j)]) * &across);
        let information =
            all.information.view((SHARED, SHARED), (rest, rest)) + across.transpose() * &by_pattern;
        let right = all.right.rows(SHARED, rest) - across.transpose() * step;
        let reduced = ReducedSystem { information, right, units: all.units.rows(SHARED, rest).into_owned() };
        Some(Self { reduced, present: values.clone(), fixed, step, inverse, by_pattern })
    }

    /// Averages over the sizes of all parts, `most` the standard deviations of the largest.
    fn over_sizes(&self, parts: &[Part], most: &DVector<f64>) -> Option<OverSizes> {
        let likely = self.likely_sizes(parts, most)?;
        let (mut total, mut best) = (0.0, f64::NEG_INFINITY);
        let n = most.len();
        let (mut mean, mut square) = (DVector::zeros(n), DMatrix::zeros(n, n));
        let mut none = vec![0.0; parts.len()];
        let mut sizes = vec![0; parts.len()];
        loop {
            let of_part: Vec<usize> = sizes.iter().zip(&likely).map(|(i, likely)| likely[*i]).collect();
            let sized = self.with_sizes(parts, &of_part, most)?;
            if sized.log_likely > best {
                let by = (best - sized.log_likely).exp();
                best = sized.log_likely;
                total *= by;
                mean *= by;
                square *= by;
                none.iter_mut().for_each(|none| *none *= by);
            }
            let weight = (sized.log_likely - best).exp();
            total += weight;
            let absent = none.iter_mut().zip(&of_part).filter(|(_, size)| **size == 0);
            absent.for_each(|(none, _)| *none += weight);
            mean += &sized.mean * weight;
            square += (sized.covariance + &sized.mean * sized.mean.transpose()) * weight;
            // The next combination.
            let Some(k) = (0..sizes.len()).find(|k| sizes[*k] + 1 < likely[*k].len()) else { break };
            sizes[k] += 1;
            sizes[..k].fill(0);
        }
        mean /= total;
        let covariance = square / total - &mean * mean.transpose();
        none.iter_mut().for_each(|none| *none /= total);
        Some(OverSizes { mean, covariance, none })
    }

    /// The sizes of each part that are likely enough, the others as large as they most likely are.
    fn likely_sizes(&self, parts: &[Part], most: &DVector<f64>) -> Option<Vec<Vec<usize>>> {
        let mut sizes = vec![SIZES / 2; parts.len()];
        let mut likely = vec![Vec::new(); parts.len()];
        // Each part in turn; the second time all others are known.
        for _ in 0..3 {
            for k in 0..parts.len() {
                let mut logs = Vec::with_capacity(SIZES);
                for size in 0..SIZES {
                    let mut tried = sizes.clone();
                    tried[k] = size;
                    logs.push(self.with_sizes(parts, &tried, most)?.log_likely);
                }
                let best = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                sizes[k] = logs.iter().position(|log| *log == best)?;
                likely[k] = (0..SIZES).filter(|size| logs[*size] > best + LEAST_LIKELY.ln()).collect();
            }
        }
        Some(likely)
    }

    /// With one size a part, 0 none.
    fn with_sizes(&self, parts: &[Part], sizes: &[usize], most: &DVector<f64>) -> Option<Sized> {
        let mut sigmas = most.clone();
        let mut log_likely = 0.0;
        for (part, size) in parts.iter().zip(sizes) {
            let share = if *size == 0 { 0.0 } else { 0.5f64.powi((SIZES - 1 - size) as i32) };
            sigmas.rows_mut(part.unknowns.start, part.unknowns.len()).scale_mut(share);
            log_likely += if *size == 0 { 0.0 } else { part.log_any - ((SIZES - 1) as f64).ln() };
        }
        let factor = self.reduced.beside(&sigmas).cholesky()?;
        let right = (&self.reduced.right + &self.reduced.information * &self.present).component_mul(&sigmas);
        let solved = factor.solve(&right);
        let scale = DMatrix::from_diagonal(&sigmas);
        log_likely += 0.5 * right.dot(&solved) - factor.l_dirty().diagonal().map(f64::ln).sum();
        Some(Sized {
            mean: solved.component_mul(&sigmas),
            covariance: &scale * factor.inverse() * &scale,
            log_likely,
        })
    }

    /// Step and inverse information of camera and planes over all sizes.
    fn shared(&self, over: &OverSizes, present: &DVector<f64>) -> (SVector<f64, SHARED>, Information) {
        let step = &self.by_pattern * (&over.mean - present);
        let wider = &self.by_pattern * &over.covariance * self.by_pattern.transpose();
        let step = SVector::<f64, SHARED>::from_fn(|i, _| self.step[i] + step[i]);
        (step, self.inverse + Information::from_fn(|i, j| wider[(i, j)]))
    }
}

/// Patterns' unknowns with one size each.
struct Sized {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    log_likely: f64,
}
