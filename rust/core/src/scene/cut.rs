//! Whether a side of a face lies outside the picture, so that what was taken for it is a line on the face: a band of print, a seam, a tape.
//! The networks see the face go on to the picture's border, and so does the stripes' light in its plane. A flush neighbour is lit up to the
//! border too, but no part of the face; print that ends the face for one network does not for the other.

use super::lit::LitLines;
use crate::calibration::Calibration;
use crate::face::extent::FaceStripes;
use crate::face::outline::{InitialRectangle, SIDES, outward_sign, span_mm};
use crate::network::FaceMaps;
use crate::view::SideOdds;

/// Logarithm of the odds that a side is cut off: a constant, and the weights of the logarithm of the probability that the network of sides
/// gives it to be outside the picture, of what the light says, and of the logarithm of the odds that the map of faces gives what is beyond.
/// Of twenty faces one is taken to be cut, at one side (an assumption). Fitted to 2,180 right sides of the learning and choosing seeds and to
/// 56 lines within cut faces of the learning seeds; left out in tenths, 1.2 % of the right ones and all of the others are cut off with a
/// probability of 0.01 or more (`training/weights_cut.py`).
const CUT: [f64; 4] = [6.04, 1.49, 0.071, 0.80];
const LEAST_NOT_IN_VIEW: f64 = 1e-5;
const LEAST_MASK: f64 = 1e-3;

/// A face along an outline, and what tells whether it is whole. `wide` are the stripes followed as far as they go.
pub(crate) struct Seen<'a> {
    pub calibration: &'a Calibration,
    pub wide: &'a FaceStripes,
    pub outline: &'a InitialRectangle,
    pub odds: &'a SideOdds,
    pub maps: &'a FaceMaps,
    pub lit: &'a LitLines,
}

impl Seen<'_> {
    /// Probabilities that both sides across either axis of the outline's raster are in the picture.
    pub fn chance_that_whole(&self) -> [f64; 2] {
        [0, 2].map(|low| (1.0 - self.cut(low)) * (1.0 - self.cut(low + 1)))
    }

    /// Probability that a side is outside the picture.
    fn cut(&self, side: usize) -> f64 {
        let Self { calibration, outline, .. } = *self;
        let raster = &outline.raster.on(&self.wide.fit.plane);
        let offset_mm = outline.offsets_mm[side];
        let (from_mm, to_mm) = span_mm(&outline.offsets_mm, side);
        let middle = |out_mm: f64| {
            let offset_mm = offset_mm + outward_sign(side) * out_mm;
            raster.pixel(calibration, SIDES[side].0.at(offset_mm, 0.5 * (from_mm + to_mm)))
        };
        let mask = middle(0.0).zip(middle(outline.mm_per_px)).map_or(0.0, |(at, beyond)| {
            let px = at.distance_px(beyond).max(f64::MIN_POSITIVE);
            self.maps.face_beyond(at, [(beyond.u - at.u) / px, (beyond.v - at.v) / px])
        });
        let light = self.lit.at(calibration, raster, side, offset_mm);
        cut(self.odds.not_in_view(side), light.to_border, f64::from(mask))
    }
}

/// Probability that a side is outside the picture.
fn cut(not_in_view: f64, to_border: f64, mask: f64) -> f64 {
    let [constant, by_network, by_light, by_mask] = CUT;
    let network = (not_in_view.max(0.0) + LEAST_NOT_IN_VIEW).ln();
    let mask = ((mask + LEAST_MASK) / (1.0 - mask + LEAST_MASK)).ln();
    let logit = constant + by_network * network + by_light * to_border + by_mask * mask;
    1.0 / (1.0 + (-logit).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_looks_like_a_side_is_none_if_face_and_light_go_on_to_the_border() {
        let right = cut(1e-5, -20.0, 0.0);
        assert!(right < 1e-4, "{right}");
        // A flush neighbour that reaches the border: the networks see the seam as well as any side.
        let neighbour = cut(1e-4, 20.0, 0.01);
        assert!(neighbour < 0.005, "{neighbour}");
        // A band of print that looks like a side: the network gives the border 2 %.
        let [dark, lit] = [-20.0, 20.0].map(|to_border| cut(0.02, to_border, 0.1));
        assert!(lit > 0.1 && dark < 0.5 * lit, "{dark} {lit}");
    }
}
