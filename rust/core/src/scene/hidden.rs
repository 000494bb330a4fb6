//! Whether something in front of a face hides a piece of it: what the network of sides says of each side, and what the lasers show in
//! front of it ([`super::in_front`]), as one probability a side. A face is refused for it, or less sure.

use super::in_front::{InFront, SideLine};
use crate::calibration::Calibration;
use crate::face::extent::FaceStripes;
use crate::face::outline::{InitialRectangle, SIDES, span_mm};
use crate::image::Frame;
use crate::reject::Reject;
use crate::view::SideOdds;

/// How likely it is that something hides a side, and what follows.
#[derive(Clone, Copy, Debug)]
struct HiddenSettings {
    /// A face is refused from this probability of a hidden side on, as the network of sides gives it: 0.6 % of 1,602 sound faces of the
    /// learning and choosing seeds are. More: fewer are refused by name, and what passes is less sure.
    least_probability: f64,
    /// Odds that something hides a piece of a face which is looked at, an assumption (one in twenty), over those of the network's training
    /// (30 hidden ones to 66 whole ones): what is less than `least_probability` makes the face less sure by them. More: all faces are less sure.
    prior_odds: f64,
    /// How much oftener both stripes of a side jump to an object at its line where something hides a piece of the face than where nothing
    /// does: at 4 of 320 hidden faces and none of 756 sound ones of the learning and choosing seeds, half a face added to each. More: such
    /// objects alone refuse a face.
    in_front_odds: f64,
    /// A face of which a side is taken to be where such an object's edge is comes out wrong if it is one, and a wrong result counts as much
    /// as a hundred refusals: it is refused from this probability on. More: more of them are measured wrong.
    at_objects_edge: f64,
    /// A face that is measured though something hides a piece of it is wrong so often: 2 of 12 that passed of 100 of the choosing seeds, in
    /// an interval of 95 % at most this. More: all faces are less sure.
    wrong: f64,
}

impl HiddenSettings {
    const DEFAULT: Self = Self {
        least_probability: 0.75,
        prior_odds: (0.05 / 0.95) / (0.30 / 0.66),
        in_front_odds: (4.5 / 321.0) / (0.5 / 757.0),
        at_objects_edge: 0.01,
        wrong: 0.5,
    };
}

impl Default for HiddenSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What may hide a piece of the sides of an outline, in the order of [`SIDES`].
pub(crate) struct HiddenSides {
    probabilities: [f64; 4],
    objects: [Option<InFront>; 4],
    settings: HiddenSettings,
}

impl HiddenSides {
    /// `wide` are the stripes followed as far as they go.
    pub fn of(
        frame: &Frame,
        calibration: &Calibration,
        wide: &FaceStripes,
        outline: &InitialRectangle,
        odds: &SideOdds,
    ) -> Self {
        let settings = HiddenSettings::DEFAULT;
        let raster = &outline.raster.on(&wide.fit.plane);
        let (half_width_px, mm_per_px) = (wide.half_width_px, outline.mm_per_px);
        let objects = [0, 1, 2, 3].map(|side| {
            let offset_mm = outline.offsets_mm[side];
            SideLine { frame, calibration, raster, half_width_px, mm_per_px, side, offset_mm }.in_front()
        });
        let probabilities = [0, 1, 2, 3].map(|side| {
            let probability = odds.hidden(side).min(1.0 - 1e-6);
            let in_front = if objects[side].is_some() { settings.in_front_odds } else { 1.0 };
            let odds = probability / (1.0 - probability) * in_front;
            odds / (1.0 + odds)
        });
        Self { probabilities, objects, settings }
    }

    /// Probability that nothing hides a piece of the face, or that it does no harm.
    pub fn chance_that_free(&self) -> f64 {
        let HiddenSettings { least_probability, prior_odds, wrong, .. } = self.settings;
        let probability = self.probabilities.into_iter().fold(0.0, f64::max).min(least_probability);
        let odds = probability / (1.0 - probability) * prior_odds;
        1.0 - wrong * odds / (1.0 + odds)
    }

    /// The refusal of a face of which something in front hides a piece.
    pub fn refusal(&self, calibration: &Calibration, outline: &InitialRectangle) -> Option<Reject> {
        let Self { probabilities, objects, settings } = self;
        let least = |object: Option<InFront>| {
            if object.is_some() { settings.at_objects_edge } else { settings.least_probability }
        };
        let limit = objects.map(least);
        let over = |side: &usize| probabilities[*side] / limit[*side];
        let hidden = || (0..4usize).filter(|side| over(side) >= 1.0);
        let side = hidden().max_by(|i, j| over(i).total_cmp(&over(j)))?;
        let (from, to) = span_mm(&outline.offsets_mm, side);
        let middle = SIDES[side].0.at(outline.offsets_mm[side], 0.5 * (from + to));
        let at = objects[side].map(|object| object.at);
        Some(Reject::FaceHidden {
            sides_hidden: hidden().count() as u8,
            at: at.or_else(|| outline.raster.pixel(calibration, middle))?,
            probability: probabilities[side],
            limit: limit[side],
            in_front_mm: objects[side].map(|object| object.height_mm),
        })
    }
}
