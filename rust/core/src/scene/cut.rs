//! Whether a side of a face lies outside the picture, so that what was taken for it is a line on the face: a band of print, a seam, a tape.
//! The networks see the face go on to the picture's border, and so does the stripes' light in its plane. A flush neighbour is lit up to the
//! border too, but no part of the face; print that ends the face for one network does not for the other.

use super::lit::LitLines;
use crate::calibration::Calibration;
use crate::face::extent::FaceStripes;
use crate::face::outline::{InitialRectangle, SIDES, outward_sign, span_mm};
use crate::network::FaceMaps;
use crate::reject::Reject;
use crate::units::Px;
use crate::view::SideOdds;

/// Logarithm of the odds that a side is cut off: a constant, and a weight for each of three clues.
/// Of twenty faces one is taken to be cut, at one side (an assumption). Fitted to 6,178 right sides of the learning and choosing seeds and to
/// 57 lines within cut faces of the learning seeds; left out in tenths, 1.5 % of the right ones and all of the others are cut off with a
/// probability of 0.01 or more (`training/weights_cut.py`). A weight that is larger than fitted lets its clue decide against the others.
#[derive(Clone, Copy, Debug)]
struct CutWeights {
    /// More refuses more faces that are whole, less measures more that are cut.
    constant: f64,
    /// Weight of ln(p + `least_not_in_view`); p is the probability that the side is outside the picture, by the network of sides. More lets a
    /// small p decide against the other clues, and cut faces be measured.
    by_network: f64,
    /// Added to p, so that p = 0 is no certainty. More lets the network say less against a cut. There is no record of how it was chosen.
    least_not_in_view: f64,
    /// Weight of the logarithm of the likelihood ratio that the stripes' light goes on in the face's plane to the border. More lets light on a
    /// flush neighbour refuse whole faces.
    by_light: f64,
    /// Weight of the logarithm of the odds of m, the share of the way to the border that the network's map gives to the face. More lets an error
    /// of the map refuse whole faces.
    by_mask: f64,
    /// Added to m and to 1 - m, so that neither 0 nor 1 is a certainty. More lets a sure map say less. There is no record of how it was chosen.
    least_mask: f64,
}

impl CutWeights {
    const DEFAULT: Self = Self {
        constant: 4.17,
        by_network: 1.10,
        least_not_in_view: 1e-5,
        by_light: 0.052,
        by_mask: 0.73,
        least_mask: 1e-3,
    };
}

impl Default for CutWeights {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// A face along an outline, and what tells whether it is whole. `wide` are the stripes followed as far as they go.
pub(crate) struct CutClues<'a> {
    pub calibration: &'a Calibration,
    pub wide: &'a FaceStripes,
    pub outline: &'a InitialRectangle,
    pub odds: &'a SideOdds,
    pub maps: &'a FaceMaps,
    pub lit: &'a LitLines,
}

/// Which sides of an outline may be outside the picture, in the order of [`SIDES`].
pub(crate) struct CutSides {
    probabilities: [f64; 4],
    /// Where the picture ends beyond each.
    border: [Option<Px>; 4],
}

impl CutSides {
    pub fn of(clues: &CutClues<'_>) -> Self {
        let sides = [0, 1, 2, 3].map(|side| clues.side(side));
        Self { probabilities: sides.map(|(probability, _)| probability), border: sides.map(|(_, at)| at) }
    }

    /// Probabilities that both sides across either axis of the outline's raster are in the picture.
    pub fn chance_that_whole(&self) -> [f64; 2] {
        [0, 2].map(|low| (1.0 - self.probabilities[low]) * (1.0 - self.probabilities[low + 1]))
    }

    /// Why a face that is not sure is not, if the picture cuts it.
    pub fn refusal(&self) -> Option<Reject> {
        // More likely than not.
        let cut = || (0..4usize).filter(|side| self.probabilities[*side] >= 0.5);
        let likeliest = cut().max_by(|i, j| self.probabilities[*i].total_cmp(&self.probabilities[*j]))?;
        Some(Reject::FaceCutByBorder { sides_cut: cut().count() as u8, at: self.border[likeliest]? })
    }
}

impl CutClues<'_> {
    /// Probability that a side is outside the picture, and where the picture ends beyond its middle.
    fn side(&self, side: usize) -> (f64, Option<Px>) {
        let Self { calibration, outline, .. } = *self;
        let raster = &outline.raster.on(&self.wide.fit.plane);
        let offset_mm = outline.offsets_mm[side];
        let (from_mm, to_mm) = span_mm(&outline.offsets_mm, side);
        let middle = |out_mm: f64| {
            let offset_mm = offset_mm + outward_sign(side) * out_mm;
            raster.pixel(calibration, SIDES[side].0.at(offset_mm, 0.5 * (from_mm + to_mm)))
        };
        let line = middle(0.0).zip(middle(outline.mm_per_px)).map(|(at, beyond)| {
            let px = at.distance_px(beyond).max(f64::MIN_POSITIVE);
            (at, [(beyond.u - at.u) / px, (beyond.v - at.v) / px])
        });
        let mask = line.map_or(0.0, |(at, outwards)| self.maps.face_beyond(at, outwards));
        let light = self.lit.at(calibration, raster, side, offset_mm);
        let size = [calibration.width_px(), calibration.height_px()];
        (
            CutWeights::DEFAULT.cut(self.odds.not_in_view(side), light.to_border, f64::from(mask)),
            line.map(|(at, outwards)| border(at, outwards, size)),
        )
    }
}

/// Where a line leaves the picture; a place outside stays where it is.
fn border(at: Px, outwards: [f64; 2], size: [u32; 2]) -> Px {
    let room = |place: f64, by: f64, size: u32| {
        let edge = if by > 0.0 { f64::from(size) - 1.0 } else { 0.0 };
        if by == 0.0 { f64::INFINITY } else { ((edge - place) / by).max(0.0) }
    };
    let px = room(at.u, outwards[0], size[0]).min(room(at.v, outwards[1], size[1]));
    Px::new(at.u + px * outwards[0], at.v + px * outwards[1])
}

impl CutWeights {
    /// Probability that a side is outside the picture.
    fn cut(&self, not_in_view: f64, to_border: f64, mask: f64) -> f64 {
        let network = (not_in_view.max(0.0) + self.least_not_in_view).ln();
        let mask = ((mask + self.least_mask) / (1.0 - mask + self.least_mask)).ln();
        let logit =
            self.constant + self.by_network * network + self.by_light * to_border + self.by_mask * mask;
        1.0 / (1.0 + (-logit).exp())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_looks_like_a_side_is_none_if_face_and_light_go_on_to_the_border() {
        let cut = |not_in_view, to_border, mask| CutWeights::default().cut(not_in_view, to_border, mask);
        let right = cut(1e-5, -20.0, 0.0);
        assert!(right < 1e-4, "{right}");
        // A flush neighbour that reaches the border: the networks see the seam as well as any side.
        let neighbour = cut(1e-4, 20.0, 0.01);
        assert!(neighbour < 0.005, "{neighbour}");
        // A band of print that looks like a side: the network gives the border 2 %.
        let [dark, lit] = [-20.0, 20.0].map(|to_border| cut(0.02, to_border, 0.1));
        assert!(lit > 0.1 && dark < 0.5 * lit, "{dark} {lit}");
    }

    #[test]
    fn a_cut_side_is_named_with_the_place_where_the_picture_ends() {
        let at = border(Px::new(1000.0, 400.0), [0.6, -0.8], [2592, 1944]);
        assert_eq!(at, Px::new(1300.0, 0.0));
        let mut sides =
            CutSides { probabilities: [0.01, 0.7, 0.0, 0.9], border: [None, None, None, Some(at)] };
        assert_eq!(sides.refusal(), Some(Reject::FaceCutByBorder { sides_cut: 2, at }));
        sides.probabilities = [0.01, 0.3, 0.0, 0.2];
        assert_eq!(sides.refusal(), None, "less likely than not");
    }
}
