//! Does the model fit the frames, or is only the residual small? What a lens, a board or a mount does that the model has not is no
//! noise: neighbours share it. Each pattern here is a few unknowns added to the adjustment, which is solved with them (Gauss-Newton).
//! Noise and its correlation are estimated from what is then left, so that the pattern does not hide in them, and the unknowns are
//! tested against their covariance (Wald 1943). Of the patterns that are significant Schwarz's criterion names one, then those that
//! explain more beside it.

use super::adjust::{Information, rms_of_centres};
use super::misfit_kind::{Misfit, MisfitKind};
use super::model::Shared;
use super::nuisance::{Averaged, averaged};
use super::patterns::{Patterns, Solved, bow};
use boxline::calibration::CalibrationCovariance;
use nalgebra::DVector;

/// Quantile of the normal distribution that one set in a thousand exceeds.
const ONE_IN_A_THOUSAND: f64 = 3.09;
/// A pattern must explain this share of the residuals' squares: below, they rise by less than 3 % for it, and covariance takes that in.
const LEAST_EXPLAINED: f64 = 0.05;
/// Steps of Gauss and Newton. Patterns are linear to some 0.1 % of themselves; the second step is for the noise, which is known after
/// the first, the third for what the weights then change.
const STEPS: usize = 3;

/// What does not fit, and the solution with it.
pub(super) struct Found {
    /// The one that explains most first.
    pub misfits: Vec<Misfit>,
    /// Camera and planes solved with these patterns and with what could be wrong without being named.
    pub shared: Shared,
    /// Of these.
    pub covariance: CalibrationCovariance,
    /// Of the skew, px, where it is an unknown.
    pub skew_sigma_px: Option<f64>,
    /// What the frames tell about these, and what is known of the lens's terms before.
    pub information: Information,
}

/// The patterns in the residuals, and camera and planes with them. `None` if the frames do not fix these. One that is named because it can
/// take the place of others, which then leave nothing for it, is not: boards that differ can be much else. A lens stays, since a camera has no terms
/// for what a tilted sensor does.
pub(super) fn misfits(solved: &Solved) -> Option<Found> {
    let mut without = Vec::new();
    loop {
        let (misfits, known) = named(solved, &without);
        let found = averaged(solved, known.left, &known.patterns, &known.values)?;
        let mine = |kind: &MisfitKind| {
            *kind != MisfitKind::Lens && misfits.iter().any(|misfit: &Misfit| misfit.kind == *kind)
        };
        match found.absent.iter().copied().find(mine) {
            Some(kind) => without.push(kind),
            None => {
                let Averaged { shared, covariance, skew_sigma_px, information, .. } = found;
                return Some(Found { misfits, shared, covariance, skew_sigma_px, information });
            }
        }
    }
}

/// The patterns in the residuals but for some kinds, and the solution with them. A lens ends the search: its unknowns can take the place of
/// much else.
fn named(solved: &Solved, without: &[MisfitKind]) -> (Vec<Misfit>, Wider) {
    let single_px = solved.single_px();
    let mut misfits = Vec::new();
    let mut known = Wider::none(solved);
    let all = known.square_px;
    while let Some(wider) = known.best_wider(solved, all, without) {
        let Some(kind) = wider.patterns.last() else { break };
        misfits.push(Misfit {
            kind,
            size: wider.size().unwrap_or((known.square_px - wider.square_px).max(0.0).sqrt()),
            rms_px: all.sqrt(),
            single_px,
            chi_square: wider.chi_square,
            limit: wider.limit(),
        });
        if kind == MisfitKind::Lens {
            break;
        }
        known = wider;
    }
    (misfits, known)
}

/// Wilson and Hilferty's quantile of chi-square.
fn one_in_a_thousand(degrees: f64) -> f64 {
    let part = 2.0 / (9.0 * degrees);
    degrees * (1.0 - part + ONE_IN_A_THOUSAND * part.sqrt()).powi(3)
}

/// A set solved with patterns among its unknowns.
struct Wider {
    patterns: Patterns,
    values: DVector<f64>,
    /// Solved with observations from which the patterns are taken.
    left: Solved,
    /// Mean square of the circles' residuals an axis, px^2.
    square_px: f64,
    /// Of the last pattern's unknowns, the others free.
    chi_square: f64,
    variances: DVector<f64>,
    /// Combinations of the last pattern's unknowns that the frames tell.
    unknowns: usize,
}

fn square_px(solved: &Solved) -> f64 {
    0.5 * rms_of_centres(&solved.shared, &solved.frames).norm_squared()
}

impl Wider {
    fn none(solved: &Solved) -> Self {
        Self {
            patterns: Patterns { kinds: Vec::new(), frames: solved.frames.len(), signs: None, fields: None },
            values: DVector::zeros(0),
            left: solved.clone(),
            square_px: square_px(solved),
            chi_square: 0.0,
            variances: DVector::zeros(0),
            unknowns: 0,
        }
    }

    /// With the pattern that is worth most of those that are significant and explain enough of the mean square `all`.
    fn best_wider(&self, solved: &Solved, all: f64, without: &[MisfitKind]) -> Option<Self> {
        let more = MisfitKind::ALL
            .into_iter()
            .filter(|kind| !self.patterns.kinds.contains(kind) && !without.contains(kind));
        let tried: Vec<Self> = more.filter_map(|kind| self.wider(solved, kind)).collect();
        // How many residuals count as independent, by the pattern that leaves least.
        let least = tried.iter().min_by(|a, b| a.square_px.total_cmp(&b.square_px))?;
        let circles: usize = solved.frames.iter().map(|frame| frame.centres.len()).sum();
        let independent = 2.0 * circles as f64 / least.left.scatter.centre_correlation;
        let explains = |wider: &Self| {
            // Frames whose own unknowns differ by less than noise does do not differ.
            let seen = wider.size().is_none_or(|size| size > 0.0);
            seen && wider.chi_square >= wider.limit()
                && self.square_px - wider.square_px >= LEAST_EXPLAINED * all
        };
        // Schwarz's criterion; choosing the frames' signs costs what 2 ln of their number does.
        let worth = |wider: &Self| {
            let unknowns = wider.unknowns as f64 * independent.ln() + wider.price_of_signs();
            -independent * wider.square_px.ln() - unknowns
        };
        tried.into_iter().filter(explains).max_by(|a, b| worth(a).total_cmp(&worth(b)))
    }

    /// What one sound set in a thousand exceeds, at most: each choice of signs is a trial (Bonferroni).
    fn limit(&self) -> f64 {
        one_in_a_thousand(self.unknowns.max(1) as f64) + self.price_of_signs()
    }

    /// Twice the logarithm of how many ways there are to choose the frames' signs.
    fn price_of_signs(&self) -> f64 {
        let free = self.patterns.last().map_or(0, |kind| self.patterns.free_signs(kind));
        2.0 * std::f64::consts::LN_2 * free as f64
    }

    /// Solves with one more pattern. `None` if the observations do not allow it.
    fn wider(&self, solved: &Solved, kind: MisfitKind) -> Option<Self> {
        let mut patterns = self.patterns.with(kind);
        if kind == MisfitKind::BoardStretched {
            patterns.signs = Some(self.left.signs(&self.patterns)?);
        }
        let mut values = self.values.clone().resize_vertically(patterns.all_columns(), 0.0);
        let usual = patterns.usual();
        let mut left = self.left.clone();
        for _ in 0..STEPS {
            values = left.reduced(&patterns, 0)?.total(&values, &usual)?;
            if kind == MisfitKind::BoardBowed {
                left.place(solved, &mut patterns, &values)?;
            }
            left = solved.without(&left, &patterns, &values)?;
        }
        let asked = patterns.kinds.len() - 1;
        let reduced = left.reduced(&patterns, asked)?;
        let own = values.rows(self.values.len(), patterns.columns(kind)).into_owned();
        let (chi_square, unknowns, variances) = reduced.chi_square(&own);
        Some(Self { patterns, values, square_px: square_px(&left), left, chi_square, variances, unknowns })
    }

    /// The size of the last pattern from its unknowns; of a lens it is told by the residuals.
    fn size(&self) -> Option<f64> {
        let kind = self.patterns.last()?;
        let values =
            self.values.rows(self.values.len() - self.patterns.columns(kind), self.patterns.columns(kind));
        // Variance of what each frame has for itself, beyond what noise gives it.
        let spread = |first: usize, step: usize| {
            let own = || (first..values.len()).step_by(step);
            let n = own().count() as f64;
            let mean = own().map(|i| values[i]).sum::<f64>() / n;
            let squares = own().map(|i| (values[i] - mean).powi(2)).sum::<f64>() / (n - 1.0);
            (squares - own().map(|i| self.variances[i]).sum::<f64>() / n).max(0.0)
        };
        match kind {
            MisfitKind::Lens => None,
            MisfitKind::BoardBowed => {
                let all = self.left.frames.iter().flat_map(|f| f.centres.iter().map(|c| c.board_mm));
                let height = |at| bow(at).into_iter().zip(values.iter()).map(|(h, v)| h * v).sum::<f64>();
                let (low, high) = all.map(height).fold((0.0f64, 0.0f64), |(l, h), x| (l.min(x), h.max(x)));
                Some(high - low)
            }
            MisfitKind::BoardStretched => Some(2.0 * values[0].hypot(values[1])),
            MisfitKind::FocusChanges => Some(spread(0, 1).sqrt()),
            MisfitKind::Shifted | MisfitKind::BoardsDiffer => Some((spread(0, 2) + spread(1, 2)).sqrt()),
        }
    }
}
