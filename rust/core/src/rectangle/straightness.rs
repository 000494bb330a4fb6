//! How straight each side is. The edges of real boxes bow and wave by 1 to 4 mm and their corners are crushed: the rectangle that fits
//! best is then not the one that a carrier's tunnel reads, which encloses the face. Both are told, with how far the sides depart.

use super::refine::{FittedRectangle, Row, Source};
use crate::face::outline::outward_sign;
use crate::measurement::Straightness;
use crate::units::Estimate;
use nalgebra::{Matrix3, Vector3};

/// Pieces of a side, each with a place of its own: what is longer than a twelfth of the side is seen.
const PIECES: usize = 12;
/// Fewest points in a piece, fewest pieces for a bow.
const FEWEST: usize = 3;
const FEWEST_PIECES: usize = 5;

/// One side.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Side {
    pub told: Straightness,
    /// How far the outermost piece lies outwards of the fitted side, mm; 0 at least.
    pub outermost: Estimate,
}

/// The four sides of a fit, in the order of [`crate::face::outline::SIDES`]. What is not seen well enough is straight.
pub(super) fn of_sides(fit: &FittedRectangle) -> [Side; 4] {
    std::array::from_fn(|side| {
        let pieces = pieces(fit, side);
        if pieces.len() >= FEWEST_PIECES { of_pieces(&pieces).unwrap_or_default() } else { Side::default() }
    })
}

/// A piece of a side: where along it, -1 to 1, and how far outwards, mm.
#[derive(Clone, Copy, Debug)]
struct Piece {
    at: f64,
    outwards: Estimate,
}

fn pieces(fit: &FittedRectangle, side: usize) -> Vec<Piece> {
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
    rows.chunks(rows.len().div_ceil(PIECES).max(FEWEST)).filter(|p| p.len() >= FEWEST).map(of_piece).collect()
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
    Some(Side { told: Straightness { sagitta: Estimate::new(found[2], sigma), rms_mm }, outermost })
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
        assert!((bowed.told.sagitta.value_mm - 3.0).abs() < 1e-9 && bowed.told.sagitta.sigma_mm < 1e-6);
        assert!((0.9..1.2).contains(&bowed.told.rms_mm), "{:?}", bowed.told);
        assert!((bowed.outermost.value_mm - 1.16).abs() < 0.05, "{:?}", bowed.outermost);
        let waved = side(|at| 2.0 * (9.0 * at).sin());
        assert!(waved.told.sagitta.value_mm.abs() < 0.1 && waved.told.rms_mm > 1.0, "{:?}", waved.told);
    }

    #[test]
    fn what_is_noise_is_no_wave() {
        let straight = side(|at| if (at * 40.0) as i32 % 2 == 0 { 0.05 } else { -0.05 });
        assert_eq!(straight.told.rms_mm, 0.0);
    }
}
