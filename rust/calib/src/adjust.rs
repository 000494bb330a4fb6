//! The joint adjustment: Levenberg-Marquardt over camera, laser planes and all board poses, on circle centres and stripe
//! centres in px with their own sigmas, robust.
//!
//! Poses meet only through the shared unknowns, so the normal equations are an arrow: every frame's 6 x 6 block is
//! eliminated by itself (Schur complement) and what is solved has 22 rows however many frames there are. That is why
//! this is not a general least-squares crate: none on crates.io uses the arrow.

use super::board::OnBoard;
use super::lens::LensTerms;
use super::model::{POSE, Row, SHARED, SKEW, Shared, centre_rows, moved, stripe_row};
use boxline::calibration::{CalibrationCovariance, PARAMETERS};
use boxline::frames::{Cam, Pose};
use boxline::statistics::{TUKEY, robust_sigma, tukey_weight};
use boxline::units::Px;
use nalgebra::{SMatrix, SVector, Vector2};

/// Where a circle's centre was seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct CentreObservation {
    pub board_mm: Vector2<f64>,
    pub at: Px,
    pub sigma_px: f64,
}

/// Where a stripe was seen on the board.
#[derive(Clone, Copy, Debug)]
pub(super) struct StripeObservation {
    /// 0 to 3.
    pub laser: usize,
    pub at: Px,
    pub sigma_px: f64,
}

/// One frame: what was seen and where the board is.
#[derive(Clone, Debug)]
pub(super) struct FrameObservations {
    pub pose: Pose<Cam, OnBoard>,
    pub centres: Vec<CentreObservation>,
    pub stripes: Vec<StripeObservation>,
}

/// How much larger the scatter is than the sigmas say, and how many neighbours share their deviation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scatter {
    pub centres: f64,
    pub stripes: f64,
    /// Variance of a mean of neighbouring stripe points over that of independent ones.
    pub stripe_correlation: f64,
    /// The same for circles next to each other on a board.
    pub centre_correlation: f64,
}

impl Scatter {
    /// Sigmas as they are, nothing shared.
    pub(super) const EVEN: Self =
        Self { centres: 1.0, stripes: 1.0, stripe_correlation: 1.0, centre_correlation: 1.0 };
}

/// Information of an unknown that stays as it is, and what its variance is below.
pub(super) const FIXED: f64 = 1e30;
const FIXED_VARIANCE: f64 = 1e-28;

/// The normal equations of the shared unknowns at the solution.
pub(super) type Information = SMatrix<f64, SHARED, SHARED>;

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Loss {
    /// Far residuals pull with constant force: finds the way from a rough start.
    Huber,
    /// Far residuals do not count.
    Tukey,
}

const HUBER: f64 = 1.345;
const ITERATIONS: usize = 40;
/// A step below this many sigmas in every shared unknown is the end.
const CONVERGED_SIGMAS: f64 = 1e-3;

pub(super) fn weight(t: f64, loss: Loss) -> f64 {
    match loss {
        Loss::Huber => (HUBER / t.abs().max(HUBER)).min(1.0),
        Loss::Tukey => tukey_weight(t),
    }
}

/// The value of the loss, for deciding about a step.
pub(super) fn cost(t: f64, loss: Loss) -> f64 {
    match loss {
        Loss::Huber if t.abs() > HUBER => HUBER * (t.abs() - 0.5 * HUBER),
        Loss::Huber => 0.5 * t * t,
        Loss::Tukey => TUKEY * TUKEY / 6.0 * (1.0 - (1.0 - (t / TUKEY).powi(2)).max(0.0).powi(3)),
    }
}

/// Which shared unknowns stay as they are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fixed {
    pub skew: bool,
    /// k1 and k2, and the terms that the lens has not.
    pub distortion: bool,
    pub lens: LensTerms,
    pub planes: bool,
    /// All of them, whatever the others say: only poses move.
    pub all: bool,
}

impl Fixed {
    pub(super) fn contains(self, index: usize) -> bool {
        self.all
            || match index {
                SKEW => self.skew,
                4 | 5 => self.distortion,
                18 | 19 => self.distortion || !self.lens.decentred,
                20 => self.distortion || !self.lens.k3,
                0..4 => false,
                _ => self.planes,
            }
    }
}

/// The covariance of a calibration's parameters in the inverse of all shared unknowns' information; none of those that were fixed, which
/// are exact.
pub(super) fn covariance(inverse: &Information) -> CalibrationCovariance {
    let covariance: CalibrationCovariance = inverse.fixed_view::<PARAMETERS, PARAMETERS>(0, 0).into();
    let covariance = 0.5 * (covariance + covariance.transpose());
    let known =
        SVector::<f64, PARAMETERS>::from_fn(|i, _| f64::from(u8::from(covariance[(i, i)] > FIXED_VARIANCE)));
    covariance.component_mul(&(known * known.transpose()))
}

/// Residuals in sigmas of all observations of a frame, with their derivatives over sigma.
fn rows_of(
    shared: &Shared,
    frame: &FrameObservations,
    scatter: &Scatter,
    mut each: impl FnMut(Row),
) -> Option<()> {
    let scaled = |row: Row, sigma: f64| Row {
        px: row.px / sigma,
        by_shared: row.by_shared / sigma,
        by_pose: row.by_pose / sigma,
    };
    for c in &frame.centres {
        let rows = centre_rows(shared, &frame.pose, c.board_mm, c.at)?;
        rows.into_iter().for_each(|row| each(scaled(row, c.sigma_px * scatter.centres)));
    }
    for s in &frame.stripes {
        each(scaled(stripe_row(shared, &frame.pose, s.laser, s.at)?, s.sigma_px * scatter.stripes));
    }
    Some(())
}

/// Normal equations with every pose eliminated.
struct Arrow {
    shared: Information,
    right: SVector<f64, SHARED>,
    frames: Vec<(SMatrix<f64, SHARED, POSE>, SMatrix<f64, POSE, POSE>, SVector<f64, POSE>)>,
    cost: f64,
}

fn normal_equations(
    shared: &Shared,
    frames: &[FrameObservations],
    scatter: &Scatter,
    loss: Loss,
) -> Option<Arrow> {
    let mut arrow = Arrow {
        shared: Information::zeros(),
        right: SVector::zeros(),
        frames: Vec::with_capacity(frames.len()),
        cost: 0.0,
    };
    for frame in frames {
        let mut mixed = SMatrix::<f64, SHARED, POSE>::zeros();
        let mut own = SMatrix::<f64, POSE, POSE>::zeros();
        let mut right = SVector::<f64, POSE>::zeros();
        // Centres come first, two rows each; a correlated observation counts for less.
        let mut left = 2 * frame.centres.len();
        let add = |row: Row| {
            let share = if left > 0 { scatter.centre_correlation } else { scatter.stripe_correlation };
            left = left.saturating_sub(1);
            let w = weight(row.px, loss) / share;
            arrow.cost += cost(row.px, loss) / share;
            if w > 0.0 {
                // Of the 22 shared unknowns a centre knows 10 and a stripe 13; the zeros cost little.
                arrow.shared.ger(w, &row.by_shared, &row.by_shared, 1.0);
                mixed.ger(w, &row.by_shared, &row.by_pose, 1.0);
                own.ger(w, &row.by_pose, &row.by_pose, 1.0);
                arrow.right -= row.by_shared * (w * row.px);
                right -= row.by_pose * (w * row.px);
            }
        };
        rows_of(shared, frame, scatter, add)?;
        arrow.frames.push((mixed, own, right));
    }
    Some(arrow)
}

fn cost_of(shared: &Shared, frames: &[FrameObservations], scatter: &Scatter, loss: Loss) -> f64 {
    let mut sum = 0.0;
    for frame in frames {
        let mut left = 2 * frame.centres.len();
        let add = |row: Row| {
            let share = if left > 0 { scatter.centre_correlation } else { scatter.stripe_correlation };
            left = left.saturating_sub(1);
            sum += cost(row.px, loss) / share;
        };
        if rows_of(shared, frame, scatter, add).is_none() {
            return f64::INFINITY;
        }
    }
    sum
}

impl Arrow {
    /// What the frames together say about the shared unknowns, poses eliminated, and the right side.
    fn reduced(&self, fixed: Fixed, damping: f64) -> Option<(Information, SVector<f64, SHARED>)> {
        let damped = |i: usize, value: f64| {
            if fixed.contains(i) { FIXED } else { value * (1.0 + damping) + f64::MIN_POSITIVE }
        };
        let mut information = self.shared;
        let mut right = self.right;
        for (mixed, own, own_right) in &self.frames {
            let mut own = *own;
            for i in 0..POSE {
                own[(i, i)] *= 1.0 + damping;
            }
            let inverse = own.cholesky()?.inverse();
            let product = mixed * inverse;
            information -= product * mixed.transpose();
            right -= product * own_right;
        }
        for i in 0..SHARED {
            // Damping belongs to the whole diagonal, not to what is left of it after elimination.
            information[(i, i)] += damped(i, self.shared[(i, i)]) - self.shared[(i, i)];
        }
        Some((information, right))
    }
}

/// Solves a positive definite system whose unknowns have sizes from 1e-9 to 1e4; also its inverse.
pub(super) fn solve_scaled(
    m: &Information,
    right: &SVector<f64, SHARED>,
) -> Option<(SVector<f64, SHARED>, Information)> {
    let units = SVector::<f64, SHARED>::from_fn(|i, _| 1.0 / m[(i, i)].max(1e-300).sqrt());
    let scale = Information::from_diagonal(&units);
    let factor = (scale * m * scale).cholesky()?;
    let x = units.component_mul(&factor.solve(&right.component_mul(&units)));
    Some((x, scale * factor.inverse() * scale))
}

/// Moves shared unknowns and poses to the least cost. `None` if the observations do not fix them.
pub(super) fn adjust(
    shared: &mut Shared,
    frames: &mut [FrameObservations],
    scatter: &Scatter,
    fixed: Fixed,
    loss: Loss,
) -> Option<Information> {
    let mut damping = 1e-3;
    let mut arrow = normal_equations(shared, frames, scatter, loss)?;
    for _ in 0..ITERATIONS {
        let (information, right) = arrow.reduced(fixed, damping)?;
        let (mut step, inverse) = solve_scaled(&information, &right)?;
        (0..SHARED).filter(|i| fixed.contains(*i)).for_each(|i| step[i] = 0.0);
        let candidate = shared.plus(&step);
        let mut moved_frames = frames.to_vec();
        for (frame, (mixed, own, own_right)) in moved_frames.iter_mut().zip(&arrow.frames) {
            let mut own = *own;
            for i in 0..POSE {
                own[(i, i)] *= 1.0 + damping;
            }
            let pose_step = own.cholesky()?.solve(&(own_right - mixed.transpose() * step));
            frame.pose = moved(&frame.pose, &pose_step);
        }
        let cost = cost_of(&candidate, &moved_frames, scatter, loss);
        let done = (0..SHARED)
            .all(|i| fixed.contains(i) || step[i].abs() < CONVERGED_SIGMAS * inverse[(i, i)].max(0.0).sqrt());
        if cost <= arrow.cost {
            *shared = candidate;
            frames.clone_from_slice(&moved_frames);
            damping = (damping * 0.1).max(1e-9);
            arrow = normal_equations(shared, frames, scatter, loss)?;
        } else {
            damping *= 10.0;
        }
        if done || damping > 1e9 {
            break;
        }
    }
    arrow.reduced(fixed, 0.0).map(|(information, _)| information)
}

/// Residuals of all centres (u, v) and stripes of a frame, px. Not finite where a point is behind the camera.
pub(super) fn residuals(shared: &Shared, frame: &FrameObservations) -> (Vec<Vector2<f64>>, Vec<f64>) {
    let centres = frame.centres.iter().map(|c| {
        centre_rows(shared, &frame.pose, c.board_mm, c.at)
            .map_or(Vector2::repeat(f64::NAN), |[u, v]| Vector2::new(u.px, v.px))
    });
    let stripes = frame
        .stripes
        .iter()
        .map(|s| stripe_row(shared, &frame.pose, s.laser, s.at).map_or(f64::NAN, |row| row.px));
    (centres.collect(), stripes.collect())
}

/// How residuals scatter compared with their sigmas, and how far neighbours go together.
pub(super) fn scatter(shared: &Shared, frames: &[FrameObservations]) -> Scatter {
    let (mut centres, mut stripes) = (Vec::new(), Vec::new());
    let (mut stripe_runs, mut centre_runs, mut centre_fields) = (Vec::new(), Vec::new(), Vec::new());
    for frame in frames {
        let (c, s) = residuals(shared, frame);
        let c: Vec<_> = c.iter().zip(&frame.centres).map(|(r, seen)| r / seen.sigma_px).collect();
        let s: Vec<_> = s.iter().zip(&frame.stripes).map(|(r, seen)| r / seen.sigma_px).collect();
        centres.extend(c.iter().flat_map(|r| [r.x, r.y]));
        stripes.extend_from_slice(&s);
        for laser in 0..4 {
            let run = s.iter().zip(&frame.stripes).filter(|(_, seen)| seen.laser == laser);
            stripe_runs.push(run.map(|(r, _)| *r).collect::<Vec<_>>());
        }
        // Circles are in order of their rows: neighbours in the list are neighbours on the board.
        centre_fields.extend(fields(&c, frame));
        centre_runs.push(c.iter().map(|r| r.x).collect());
        centre_runs.push(c.iter().map(|r| r.y).collect());
    }
    let scale = |all: &[f64]| robust_sigma(all.iter().copied()).map_or(1.0, |sigma| sigma.max(1e-3));
    let (centres, stripes) = (scale(&centres), scale(&stripes));
    Scatter {
        centres,
        stripes,
        stripe_correlation: correlation(&stripe_runs, stripes)
            .max(correlation_of_groups(halves(&stripe_runs), stripes)),
        centre_correlation: correlation(&centre_runs, centres)
            .max(correlation_of_groups(centre_fields.iter().map(Vec::as_slice), centres)),
    }
}

/// Root mean square of all centres' residuals an axis, those that are 4.7 sigmas off left out.
pub(super) fn rms_of_centres(shared: &Shared, frames: &[FrameObservations]) -> Vector2<f64> {
    let spread = scatter(shared, frames).centres;
    let (mut sum, mut n) = (Vector2::zeros(), 0.0);
    for frame in frames {
        let (centres, _) = residuals(shared, frame);
        for (r, seen) in centres.iter().zip(&frame.centres) {
            if r.iter().all(|x| weight(x / (seen.sigma_px * spread), Loss::Tukey) > 0.0) {
                sum += r.component_mul(r);
                n += 1.0;
            }
        }
    }
    (sum / f64::max(n, 1.0)).map(f64::sqrt)
}

/// Fewest circles for a frame's own scatter.
const MIN_OWN: usize = 24;

/// Gives every frame's circles the sigma with which they scatter: frames differ in blur and light more than rims tell.
pub(super) fn own_sigmas(shared: &Shared, frames: &mut [FrameObservations]) {
    for frame in frames {
        let (centres, _) = residuals(shared, frame);
        let sizes =
            centres.iter().zip(&frame.centres).flat_map(|(r, seen)| [r.x, r.y].map(|x| x / seen.sigma_px));
        let Some(scale) = robust_sigma(sizes).map(|sigma| sigma.clamp(0.2, 20.0)) else { continue };
        if frame.centres.len() >= MIN_OWN {
            frame.centres.iter_mut().for_each(|c| c.sigma_px *= scale);
        }
    }
}

/// Lags beyond which correlation is taken as none.
const LAGS: usize = 24;

/// 1 + 2 x the sum of the autocorrelations up to where they vanish: variance of a mean over that of independent values.
fn correlation(runs: &[Vec<f64>], scale: f64) -> f64 {
    let limit = TUKEY * scale;
    let inside = |x: f64| x.abs() < limit;
    let mut factor = 1.0;
    let of_lag = |lag: usize| {
        let (mut sum, mut squares, mut n) = (0.0, 0.0, 0.0);
        for run in runs {
            for (a, b) in run.iter().zip(run.iter().skip(lag)).filter(|(a, b)| inside(**a) && inside(**b)) {
                sum += a * b;
                squares += 0.5 * (a * a + b * b);
                n += 1.0;
            }
        }
        if n < 50.0 { 0.0 } else { sum / squares }
    };
    for lag in 1..=LAGS {
        let r = of_lag(lag);
        if r < 0.05 {
            break;
        }
        factor += 2.0 * r;
    }
    factor
}

/// Fewest observations of a group.
const MIN_GROUP: usize = 4;

/// The same from the means of groups (half stripes, parts of a board): what a whole group has in common is longer than any
/// lag: texture, a slope of the light, blur that changes over the frame.
fn correlation_of_groups<'a>(groups: impl Iterator<Item = &'a [f64]>, scale: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for group in groups {
        let inside: Vec<f64> = group.iter().copied().filter(|x| x.abs() < TUKEY * scale).collect();
        if inside.len() >= MIN_GROUP {
            sum += (inside.iter().sum::<f64>() / scale).powi(2) / inside.len() as f64;
            count += 1.0;
        }
    }
    if count < 10.0 { 1.0 } else { f64::max(sum / count, 1.0) }
}

fn halves(runs: &[Vec<f64>]) -> impl Iterator<Item = &[f64]> {
    runs.iter().flat_map(|run| {
        let (a, b) = run.split_at(run.len() / 2);
        [a, b]
    })
}

/// Circles of a frame in fields of the board, about 3 x 3 circles each, u and v apart.
fn fields(residuals: &[Vector2<f64>], frame: &FrameObservations) -> Vec<Vec<f64>> {
    let mut by_field = std::collections::BTreeMap::<(i64, i64), [Vec<f64>; 2]>::new();
    let pitch = frame
        .centres
        .windows(2)
        .map(|pair| (pair[1].board_mm - pair[0].board_mm).norm())
        .fold(f64::INFINITY, f64::min);
    for (r, seen) in residuals.iter().zip(&frame.centres) {
        let field = (seen.board_mm / (3.0 * pitch)).map(|x| x.floor() as i64);
        let [u, v] = by_field.entry((field.x, field.y)).or_default();
        u.push(r.x);
        v.push(r.y);
    }
    by_field.into_values().flatten().collect()
}
