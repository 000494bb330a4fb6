//! How straight each side is. The edges of real boxes bow and wave by 1 to 4 mm and their corners are crushed: the rectangle that fits
//! best is then not the one that a carrier's tunnel reads, which encloses the face. Both are told, with how far the sides depart.

use super::refine::FittedRectangle;
use crate::face::model::{Row, Source};
use crate::face::outline::outward_sign;
use crate::measurement::Straightness;
use crate::units::Estimate;
use crate::warning::{Warning, WarningKind};
use nalgebra::{Matrix3, Vector3};

/// Pieces of a side, each with a place of its own: what is longer than a twelfth of the side is seen. Fewest pieces for a bow.
const PIECES: usize = 12;
const LEAST_PIECES: usize = 5;

/// What a bow's square over its variance may be on a straight side: one sound face in a thousand has a side with more. Student's
/// distribution, two-sided, 1 in 4,000, with 2, 3 ... 9 degrees of freedom: those of 5 ([`LEAST_PIECES`]), 6 ... 12 pieces.
const LIMITS: [f64; PIECES - LEAST_PIECES + 1] = [3998.2, 424.5, 151.6, 85.3, 59.4, 46.4, 38.9, 34.0];

/// What is told of a side's straightness.
#[derive(Clone, Copy, Debug)]
struct StraightnessSettings {
    /// Fewest points in a piece: of three a scatter is known. More leaves a short side without enough pieces.
    least_points: usize,
    /// A smaller bow is not worth a word: sides are meant to be good to this, mm. More keeps silent on bows that matter.
    worth_mm: f64,
    /// Least sigma of a bow, mm: pieces that agree by chance do not make one certain. More misses small bows of a smooth side.
    least_sigma_mm: f64,
}

impl StraightnessSettings {
    const DEFAULT: Self = Self { least_points: 3, worth_mm: 1.0, least_sigma_mm: 0.01 };
}

impl Default for StraightnessSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// One side.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Side {
    pub reported: Straightness,
    /// Of how many pieces it was told.
    pieces: usize,
    /// How far the outermost piece lies outwards of the fitted side, mm; 0 at least.
    pub outermost: Estimate,
}

/// The four sides of a fit, in the order of [`crate::face::outline::SIDES`]. What is not seen well enough is straight.
pub(super) fn of_sides(fit: &FittedRectangle) -> [Side; 4] {
    let settings = StraightnessSettings::default();
    std::array::from_fn(|side| {
        let pieces = pieces(fit, side, settings.least_points);
        if pieces.len() >= LEAST_PIECES { of_pieces(&pieces).unwrap_or_default() } else { Side::default() }
    })
}

/// The bow of the side that bows most, if it is one beyond waves and noise.
pub(super) fn bowed(sides: &[Side; 4]) -> Option<Warning> {
    let settings = StraightnessSettings::default();
    let bowed = sides.iter().filter_map(|side| side.bowed(settings.least_sigma_mm));
    let most = bowed.max_by(|p, q| p.found.abs().total_cmp(&q.found.abs()));
    most.filter(|bow| bow.found.abs() > settings.worth_mm)
}

impl Side {
    fn bowed(&self, least_sigma_mm: f64) -> Option<Warning> {
        let limit = *LIMITS.get(self.pieces.checked_sub(LEAST_PIECES)?)?;
        let Estimate { value_mm, sigma_mm } = self.reported.sagitta;
        let sigma = sigma_mm.max(least_sigma_mm);
        let chi_square = (value_mm / sigma).powi(2);
        let bow =
            Warning { kind: WarningKind::SideBowed, laser: None, found: value_mm, sigma, chi_square, limit };
        (chi_square > limit).then_some(bow)
    }
}

/// A piece of a side: where along it, -1 to 1, and how far outwards, mm.
#[derive(Clone, Copy, Debug)]
struct Piece {
    at: f64,
    outwards: Estimate,
}

fn pieces(fit: &FittedRectangle, side: usize, least_points: usize) -> Vec<Piece> {
    let mut rows: Vec<&Row> =
        fit.rows.iter().filter(|r| r.source == Source::Edge(side) && r.robust > 0.0).collect();
    rows.sort_by(|p, q| p.along_mm.total_cmp(&q.along_mm));
    let (Some(first), Some(last)) = (rows.first(), rows.last()) else { return Vec::new() };
    let (from, length) = (first.along_mm, (last.along_mm - first.along_mm).max(1e-9));
    let of_piece = |rows: &[&Row]| {
        let n = rows.len() as f64;
        let out: Vec<f64> = rows.iter().map(|r| outward_sign(side) * r.px * r.mm_per_px).collect();
        let mean = out.iter().sum::<f64>() / n;
        let scatter = out.iter().map(|o| (o - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let along = rows.iter().map(|r| r.along_mm).sum::<f64>() / n;
        // Neighbours share print and shadow: a piece is about one observation.
        let outwards = Estimate::new(mean, scatter.max(0.0).sqrt());
        Piece { at: 2.0 * (along - from) / length - 1.0, outwards }
    };
    rows.chunks(rows.len().div_ceil(PIECES).max(least_points))
        .filter(|p| p.len() >= least_points)
        .map(of_piece)
        .collect()
}

fn of_pieces(pieces: &[Piece]) -> Option<Side> {
    let count = pieces.len() as f64;
    // A line and a bow: 1 in the middle, 0 at both ends.
    let shape = |p: &Piece| Vector3::new(1.0, p.at, 1.0 - p.at * p.at);
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for piece in pieces {
        normal += shape(piece) * shape(piece).transpose();
        right += shape(piece) * piece.outwards.value_mm;
    }
    let inverse = normal.try_inverse()?;
    let found = inverse * right;
    let left: f64 = pieces.iter().map(|p| (p.outwards.value_mm - found.dot(&shape(p))).powi(2)).sum();
    let sigma = (left / (count - 3.0) * inverse[(2, 2)]).max(0.0).sqrt();
    let mean_square = |of: &dyn Fn(&Piece) -> f64| pieces.iter().map(|p| of(p).powi(2)).sum::<f64>() / count;
    let noise = mean_square(&|p| p.outwards.sigma_mm);
    let rms_mm = (mean_square(&|p| p.outwards.value_mm) - noise).max(0.0).sqrt();
    let outermost = pieces.iter().map(|p| p.outwards).max_by(|p, q| p.value_mm.total_cmp(&q.value_mm))?;
    let outermost = if outermost.value_mm > 0.0 { outermost } else { Estimate::new(0.0, outermost.sigma_mm) };
    let reported = Straightness { sagitta: Estimate::new(found[2], sigma), rms_mm };
    Some(Side { reported, pieces: pieces.len(), outermost })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn side(outwards_mm: impl Fn(f64) -> f64) -> Side {
        let piece = |k: u32| {
            let at = (f64::from(k) - 5.5) / 5.5;
            Piece { at, outwards: Estimate::new(outwards_mm(at), 0.1) }
        };
        of_pieces(&(0..12).map(piece).collect::<Vec<_>>()).expect("twelve pieces")
    }

    #[test]
    fn a_bow_has_its_sagitta_and_a_wave_none() {
        let bowed = side(|at| 3.0 * (0.394 - at * at)); // as a fit leaves it: its mean is about 0
        assert!(
            (bowed.reported.sagitta.value_mm - 3.0).abs() < 1e-9 && bowed.reported.sagitta.sigma_mm < 1e-6
        );
        assert!((0.9..1.2).contains(&bowed.reported.rms_mm), "{:?}", bowed.reported);
        assert!((bowed.outermost.value_mm - 1.16).abs() < 0.05, "{:?}", bowed.outermost);
        let waved = side(|at| 2.0 * (9.0 * at).sin());
        assert!(
            waved.reported.sagitta.value_mm.abs() < 0.1 && waved.reported.rms_mm > 1.0,
            "{:?}",
            waved.reported
        );
    }

    #[test]
    fn the_largest_bow_is_told_and_neither_waves_nor_noise_nor_what_is_too_small() {
        let bow = |sagitta_mm: f64| side(move |at| sagitta_mm * (0.394 - at * at) + 0.1 * (40.0 * at).sin());
        let reported = bowed(&[bow(-1.4), bow(2.5), bow(0.9), Side::default()]).expect("a bow of 2.5 mm");
        assert!((reported.found - 2.5).abs() < 0.1 && reported.chi_square > reported.limit, "{reported:?}");
        let reported = bowed(&[bow(-1.4), bow(0.9), bow(0.0), Side::default()]).expect("a bow of 1.4 mm");
        assert!((reported.found + 1.4).abs() < 0.1, "{reported:?}");
        assert_eq!(bowed(&[bow(0.9), bow(0.0), side(|at| 4.0 * (9.0 * at).sin()), Side::default()]), None);
    }

    /// One sound face in a thousand, however few its pieces.
    #[test]
    fn noise_is_taken_for_a_bow_as_often_as_meant() {
        const FACES: u32 = 4000;
        let mut state = 1u64;
        let mut noise_mm = || {
            // The sum of twelve numbers of a linear congruential generator (Knuth's constants), less its mean: normal enough.
            let mut unit = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1u64 << 53) as f64
            };
            20.0 * ((0..12).map(|_| unit()).sum::<f64>() - 6.0)
        };
        for count in LEAST_PIECES..=PIECES {
            let mut face = || {
                [(); 4].map(|()| {
                    let at = |k: usize| 2.0 * k as f64 / (count - 1) as f64 - 1.0;
                    let piece = |k| Piece { at: at(k), outwards: Estimate::new(noise_mm(), 0.1) };
                    of_pieces(&(0..count).map(piece).collect::<Vec<_>>()).unwrap_or_default()
                })
            };
            let reported = (0..FACES).filter(|_| bowed(&face()).is_some()).count();
            // 4 are meant; Poisson's 99.9 % is 0 to 12.
            assert!(reported <= 12, "{reported} of {FACES} faces of {count} pieces");
        }
    }

    #[test]
    fn what_is_noise_is_no_wave() {
        let straight = side(|at| if (at * 40.0) as i32 % 2 == 0 { 0.05 } else { -0.05 });
        assert_eq!(straight.reported.rms_mm, 0.0);
    }
}
