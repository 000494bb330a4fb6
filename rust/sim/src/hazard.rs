//! What makes a face hard to measure, one kind at a time: each can be switched off, each has a share of the scenes in which it
//! is drawn, and each that was drawn stands in `truth.json` and in the meta data of training frames.
//!
//! The shares are assumptions; the table in `rust/ACCURACY.md` states them, and results are told apart by hazard. The one that
//! decides most is how often the target's face goes on in a neighbour's: **44 % of the scenes** (a test counts them: 38 to 50)
//! have a flush neighbour on a side that borders a face that is looked at, one in five of those a box below. It is more than the
//! share below, since boxes of one colour nearly always have a neighbour. 35 % of the boxes have no neighbour of either kind.

use crate::rng::Rng;
use std::fmt;

/// A kind of hazard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Hazard {
    /// A box flush with the target within 3 mm, on a side that is not looked at, with a gap of 0 to 3 mm: its face goes on in the
    /// target's plane. Also a box below that is as wide as the target.
    FlushNeighbour,
    /// A box against the target that stands out or back by 4 to 60 mm.
    SteppedNeighbour,
    /// Target and neighbours in one plain colour: red, black, white or brown.
    OneColour,
    /// Tape folded over an edge, 20 to 30 mm of it on the face.
    EdgeTape,
    /// Tape across both ends of the flaps' seam, as an H.
    HTape,
    /// Plastic straps, 12 to 16 mm wide, on and beside edges.
    Strap,
    /// A label bent over an edge.
    BentLabel,
    /// Stretch film: streaks of gloss, a veil, soft edges.
    Film,
    /// The seam of a flap close to an edge.
    FlapSeam,
    /// A flap that stands open.
    OpenFlap,
    /// Corners pressed in, 5 to 30 mm of radius.
    CrushedCorner,
    /// Hand holes.
    HandHole,
    /// Edges that bow and wave by 1 to 4 mm.
    WavyEdge,
    /// Print 3 to 25 mm inside an edge: bands, frames, fields, posters that end there.
    EdgePrint,
    /// A laser's fan ends within 5 % past the face, which can be measured; or on the face, and then the stripe is missing.
    FanEnd,
    /// One laser at a third of its power.
    WeakLaser,
    /// A glossy floor that mirrors stripes: listed where an image of one is in view.
    MirrorFloor,
    /// Laser light that comes back from a wall, the floor or a neighbour: a faint second stripe.
    SecondBounce,
    /// A pose of 40 to 65 degrees off the normal.
    Oblique,
}

impl Hazard {
    /// All of them.
    pub const ALL: [Self; 19] = [
        Self::FlushNeighbour,
        Self::SteppedNeighbour,
        Self::OneColour,
        Self::EdgeTape,
        Self::HTape,
        Self::Strap,
        Self::BentLabel,
        Self::Film,
        Self::FlapSeam,
        Self::OpenFlap,
        Self::CrushedCorner,
        Self::HandHole,
        Self::WavyEdge,
        Self::EdgePrint,
        Self::FanEnd,
        Self::WeakLaser,
        Self::MirrorFloor,
        Self::SecondBounce,
        Self::Oblique,
    ];

    /// Its name in files and on the command line.
    #[must_use]
    pub const fn word(self) -> &'static str {
        self.traits().0
    }

    /// Share of the scenes in which it is drawn. What does not fit the scene (a fan's end on a small box) is left out, so that
    /// fewer have it.
    #[must_use]
    pub const fn share(self) -> f64 {
        self.traits().1
    }

    const fn traits(self) -> (&'static str, f64) {
        match self {
            Self::FlushNeighbour => ("flush_neighbour", 0.35),
            Self::SteppedNeighbour => ("stepped_neighbour", 0.25),
            Self::OneColour => ("one_colour", 0.12),
            Self::EdgeTape => ("edge_tape", 0.2),
            Self::HTape => ("h_tape", 0.2),
            Self::Strap => ("strap", 0.15),
            Self::BentLabel => ("bent_label", 0.1),
            Self::Film => ("film", 0.06),
            Self::FlapSeam => ("flap_seam", 0.3),
            Self::OpenFlap => ("open_flap", 0.04),
            Self::CrushedCorner => ("crushed_corner", 0.2),
            Self::HandHole => ("hand_hole", 0.08),
            Self::WavyEdge => ("wavy_edge", 0.4),
            Self::EdgePrint => ("edge_print", 0.4),
            Self::FanEnd => ("fan_end", 0.04),
            Self::WeakLaser => ("weak_laser", 0.08),
            Self::MirrorFloor => ("mirror_floor", 0.2),
            Self::SecondBounce => ("second_bounce", 0.1),
            Self::Oblique => ("oblique", 0.15),
        }
    }
}

impl fmt::Display for Hazard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// Which hazards may be drawn; all of them by default.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hazards {
    on: [bool; Hazard::ALL.len()],
}

impl Default for Hazards {
    fn default() -> Self {
        Self { on: [true; Hazard::ALL.len()] }
    }
}

impl Hazards {
    /// None of them.
    #[must_use]
    pub const fn none() -> Self {
        Self { on: [false; Hazard::ALL.len()] }
    }

    /// These and no others.
    #[must_use]
    pub fn only(hazards: &[Hazard]) -> Self {
        Self { on: Hazard::ALL.map(|h| hazards.contains(&h)) }
    }

    /// All but this one.
    #[must_use]
    pub fn without(self, hazard: Hazard) -> Self {
        Self { on: std::array::from_fn(|i| self.on[i] && Hazard::ALL[i] != hazard) }
    }

    /// `all`, `none`, or names with commas between them.
    ///
    /// # Errors
    /// The name that is none.
    pub fn parse(text: &str) -> Result<Self, String> {
        match text {
            "all" => Ok(Self::default()),
            "none" => Ok(Self::none()),
            list => {
                let found = list.split(',').map(|name| {
                    Hazard::ALL.into_iter().find(|h| h.word() == name.trim()).ok_or_else(|| {
                        let known: Vec<&str> = Hazard::ALL.iter().map(|h| h.word()).collect();
                        format!("{name:?} is no hazard; known are {}, or all, or none", known.join(", "))
                    })
                });
                Ok(Self::only(&found.collect::<Result<Vec<_>, _>>()?))
            }
        }
    }

    /// Whether a hazard may be drawn.
    #[must_use]
    pub fn has(&self, hazard: Hazard) -> bool {
        self.on[hazard as usize]
    }

    /// Draws whether a scene has a hazard. The draw is made whether it is switched on or not, so that switching one off
    /// leaves all else as it was.
    pub fn draw(&self, rng: &mut Rng, hazard: Hazard) -> bool {
        rng.chance(hazard.share()) && self.has(hazard)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back_and_unknown_ones_are_named() {
        for (i, hazard) in Hazard::ALL.into_iter().enumerate() {
            assert_eq!(hazard as usize, i, "`has` looks up by number");
            assert_eq!(Hazards::parse(hazard.word()), Ok(Hazards::only(&[hazard])));
        }
        let two = Hazards::parse("film, strap").unwrap();
        assert!(two.has(Hazard::Film) && two.has(Hazard::Strap) && !two.has(Hazard::OneColour));
        assert_eq!(Hazards::parse("all"), Ok(Hazards::default()));
        assert!(Hazards::parse("film,fog").unwrap_err().starts_with("\"fog\" is no hazard"));
    }

    #[test]
    fn one_that_is_switched_off_leaves_the_other_draws_as_they_were() {
        let draws = |hazards: Hazards| {
            let mut rng = Rng::new(5, 5);
            (0..200).map(|i| hazards.draw(&mut rng, Hazard::ALL[i % 19])).collect::<Vec<_>>()
        };
        let (all, less) = (draws(Hazards::default()), draws(Hazards::default().without(Hazard::WavyEdge)));
        for (i, (all, less)) in all.into_iter().zip(less).enumerate() {
            assert_eq!(less, all && Hazard::ALL[i % 19] != Hazard::WavyEdge);
        }
    }
}
