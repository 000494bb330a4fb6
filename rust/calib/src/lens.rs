//! Which terms the lens needs: the paper's two, and more where they lower the error on frames that were left out of the fit by more than
//! chance. A term that is not needed costs accuracy: what it takes from noise, boxes get.

use super::adjust::{Fixed, FrameObservations, Loss, Scatter, adjust, residuals, scatter};
use super::model::Shared;
use boxline::statistics::TUKEY;

/// Terms of the distortion beyond the paper's k1 and k2.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LensTerms {
    /// p1 and p2.
    pub decentred: bool,
    /// k3.
    pub k3: bool,
}

impl LensTerms {
    /// None.
    pub const PAPER: Self = Self { decentred: false, k3: false };
    /// All (Brown's model).
    pub const BROWN: Self = Self { decentred: true, k3: true };

    /// All terms by name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self { decentred: false, k3: false } => "k1, k2",
            Self { decentred: true, k3: false } => "k1, k2, p1, p2",
            Self { decentred: false, k3: true } => "k1, k2, k3",
            Self { decentred: true, k3: true } => "k1, k2, p1, p2, k3",
        }
    }

    fn with(self, other: Self) -> Self {
        Self { decentred: self.decentred || other.decentred, k3: self.k3 || other.k3 }
    }
}

/// Who says which terms there are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LensChoice {
    /// The frames.
    #[default]
    ByData,
    /// Always k1 and k2 alone.
    Paper,
    /// Always all.
    Brown,
}

impl LensChoice {
    /// The terms of the first solution.
    pub(super) const fn start(self) -> LensTerms {
        match self {
            Self::ByData | Self::Paper => LensTerms::PAPER,
            Self::Brown => LensTerms::BROWN,
        }
    }
}

/// A set of terms that was tried.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LensTrial {
    /// Which.
    pub terms: LensTerms,
    /// Root mean square of the circles' residuals an axis, px, on frames left out of the fit, those beyond 4.7 sigmas left out.
    pub left_out_rms_px: f64,
    /// By how much the logarithm of the left-out frames' likelihood, but for the frame that gains most, rises against that with the terms
    /// before; `None` of the first.
    pub gain: Option<f64>,
    /// Taken because what the terms before left had the shape of a lens, and with these no longer has.
    pub by_fit: bool,
}

/// Parts into which frames are divided; each is left out once.
const PARTS: usize = 6;
/// Odds of a hundred to one (the pseudo-Bayes factor of Geisser and Eddy, JASA 74, 1979). A term that is not needed has a negative gain: it
/// fits the noise of the frames that are fitted.
const LEAST_GAIN: f64 = 4.6;

/// What is left on one frame that was left out: minus the logarithm of its likelihood, but for a constant; sum of squares and count of
/// the residuals that count.
struct LeftOut {
    loss: f64,
    square_sum: f64,
    count: f64,
}

/// Adds terms as long as they help, and not only on one frame. The frames' circles have been adjusted with the paper's terms.
pub(super) fn choose(
    shared: &Shared,
    frames: &[FrameObservations],
    fixed: Fixed,
) -> (LensTerms, Vec<LensTrial>) {
    let spread = scatter(shared, frames);
    let of_terms = |terms: LensTerms| left_out(shared, frames, Fixed { lens: terms, ..fixed }, &spread);
    let mut terms = LensTerms::PAPER;
    let Some(mut errors) = of_terms(terms) else { return (terms, Vec::new()) };
    let mut trials = vec![LensTrial { terms, left_out_rms_px: rms_px(&errors), gain: None, by_fit: false }];
    loop {
        let more = [LensTerms { decentred: true, k3: false }, LensTerms { decentred: false, k3: true }];
        let wider = more.map(|added| terms.with(added)).into_iter().filter(|wider| *wider != terms);
        let tried = wider.filter_map(|wider| {
            let found = of_terms(wider)?;
            let gain = gain(&errors, &found);
            trials.push(LensTrial {
                terms: wider,
                left_out_rms_px: rms_px(&found),
                gain: Some(gain),
                by_fit: false,
            });
            Some((gain, wider, found))
        });
        match tried.filter(|(gain, ..)| *gain > LEAST_GAIN).max_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((_, wider, found)) => (terms, errors) = (wider, found),
            None => return (terms, trials),
        }
    }
}

/// All terms, taken because they fit.
pub(super) fn by_fit(shared: &Shared, frames: &[FrameObservations], fixed: Fixed) -> Option<LensTrial> {
    let errors = left_out(shared, frames, fixed, &scatter(shared, frames))?;
    Some(LensTrial { terms: fixed.lens, left_out_rms_px: rms_px(&errors), gain: None, by_fit: true })
}

/// Each frame's error with the camera that the others give, its own pose fitted; `None` if they give none.
fn left_out(
    shared: &Shared,
    frames: &[FrameObservations],
    fixed: Fixed,
    spread: &Scatter,
) -> Option<Vec<LeftOut>> {
    let mut found = Vec::with_capacity(frames.len());
    for part in 0..PARTS.min(frames.len()) {
        let frames_where = |left_out: bool| -> Vec<FrameObservations> {
            let wanted = |(i, _): &(usize, &FrameObservations)| (i % PARTS == part) == left_out;
            frames.iter().enumerate().filter(wanted).map(|(_, frame)| frame.clone()).collect()
        };
        let mut camera = shared.clone();
        adjust(&mut camera, &mut frames_where(false), spread, fixed, Loss::Tukey)?;
        let mut left = frames_where(true);
        adjust(&mut camera, &mut left, spread, Fixed { all: true, ..fixed }, Loss::Huber)?;
        found.extend(left.iter().map(|frame| error(&camera, frame, spread)));
    }
    Some(found)
}

fn error(shared: &Shared, frame: &FrameObservations, spread: &Scatter) -> LeftOut {
    let (centres, _) = residuals(shared, frame);
    let mut sum = LeftOut { loss: 0.0, square_sum: 0.0, count: 0.0 };
    for (residual, seen) in centres.iter().zip(&frame.centres) {
        for px in residual.iter() {
            let sigmas = px / (seen.sigma_px * spread.centres);
            sum.loss += super::adjust::cost(sigmas, Loss::Tukey) / spread.centre_correlation;
            if sigmas.abs() < TUKEY {
                sum.square_sum += px * px;
                sum.count += 1.0;
            }
        }
    }
    sum
}

fn rms_px(errors: &[LeftOut]) -> f64 {
    let (sum, count) = errors.iter().fold((0.0, 0.0), |(s, n), e| (s + e.square_sum, n + e.count));
    (sum / f64::max(count, 1.0)).sqrt()
}

/// The fall of all losses, but for the frame that gains most.
fn gain(before: &[LeftOut], after: &[LeftOut]) -> f64 {
    let falls = || before.iter().zip(after).map(|(b, a)| b.loss - a.loss);
    falls().sum::<f64>() - falls().fold(0.0, f64::max)
}
