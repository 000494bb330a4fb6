//! Every kind of material, how often it is drawn, and which kinds are held out for tests.
//!
//! | Table | Training | Held out |
//! |---|---|---|
//! | [`CARTONS`] | brown, kraft, white, black, red, blue, grey | testliner, honey, cream, orange, green, charcoal |
//! | [`INKS`] | black, blue, red | green, brown |
//! | [`PRINTS`] | blue, navy, red, green, black, white, yellow, grey | teal, violet, brown, lime, orange |
//! | [`EDGINGS`] | line, double line, band, two-tone band, zone, header bar, frame, panel, poster | triple line, three-tone band, hem, dashes, crossed lines, double frame, plain zone, corner field, large poster |
//! | [`MARKS`] | arrows | glass |
//! | [`LABELS`] | address, parcel | order, order on yellow |
//! | [`TAPES`] | brown, tan, clear | dark, white |
//! | [`STRAPS`] | black, white, yellow, red, blue | green, orange |
//! | [`WOODS`] | pale, oak, birch | weathered, stained |
//! | [`FLOORS`] | concrete, planks, coated | tiles, bricks |
//! | [`YARDS`] (outdoors) | asphalt | paving |
//! | [`WALLS`] | brick, plaster, paint | sheet, cladding |
//!
//! Common to both: shapes, light, lasers, sensor, painted metal and table tops, red lines and frames in print, film, hand holes,
//! occluders.

use super::edging::Edging;
use super::stamp::Art;
use crate::stock::{Kind, Split};

const fn training<T: Copy>(word: &'static str, weight: usize, what: T) -> Kind<T> {
    Kind { word, weight, split: Split::Training, what }
}

const fn held_out<T: Copy>(word: &'static str, weight: usize, what: T) -> Kind<T> {
    Kind { word, weight, split: Split::HeldOut, what }
}

/// The board of a carton.
#[derive(Clone, Copy, Debug)]
pub struct Base {
    /// sRGB.
    pub rgb: [u8; 3],
    /// Unbleached and uncoated: rougher, of more than one hue, matt.
    pub plain: bool,
}

const fn base(rgb: [u8; 3], plain: bool) -> Base {
    Base { rgb, plain }
}

/// Boards.
pub const CARTONS: [Kind<Base>; 13] = [
    training("brown", 8, base([167, 124, 82], true)),
    training("kraft", 4, base([186, 152, 110], true)),
    training("white", 3, base([214, 213, 207], false)),
    training("black", 1, base([44, 43, 46], false)),
    training("red", 1, base([165, 42, 36], false)),
    training("blue", 1, base([40, 80, 150], false)),
    training("grey", 1, base([130, 131, 130], false)),
    held_out("testliner", 8, base([146, 116, 88], true)),
    held_out("honey", 4, base([196, 148, 90], true)),
    held_out("cream", 3, base([226, 218, 194], false)),
    held_out("orange", 2, base([206, 94, 38], false)),
    held_out("green", 1, base([60, 110, 70], false)),
    held_out("charcoal", 1, base([58, 57, 55], false)),
];

/// Printing inks on light board, sRGB.
pub const INKS: [Kind<[u8; 3]>; 5] = [
    training("black ink", 2, [31, 29, 33]),
    training("blue ink", 1, [38, 52, 120]),
    training("red ink", 1, [140, 28, 30]),
    held_out("green ink", 1, [24, 84, 52]),
    held_out("brown ink", 1, [84, 50, 34]),
];

/// Inks of large printed areas, sRGB.
pub const PRINTS: [Kind<[u8; 3]>; 13] = [
    training("blue print", 2, [32, 78, 148]),
    training("navy print", 1, [28, 36, 66]),
    training("red print", 2, [176, 34, 36]),
    training("green print", 1, [36, 108, 62]),
    training("black print", 2, [34, 33, 36]),
    training("white print", 2, [228, 226, 218]),
    training("yellow print", 1, [226, 180, 44]),
    training("grey print", 1, [128, 130, 132]),
    held_out("teal print", 2, [22, 112, 118]),
    held_out("violet print", 1, [92, 52, 120]),
    held_out("brown print", 2, [88, 56, 38]),
    held_out("lime print", 1, [150, 184, 52]),
    held_out("orange print", 1, [222, 112, 36]),
];

/// Print along the edges.
pub const EDGINGS: [Kind<Edging>; 18] = [
    training("edge line", 3, Edging::Lines(1)),
    training("double line", 2, Edging::Lines(2)),
    training("edge band", 4, Edging::Band(1)),
    training("two-tone band", 2, Edging::Band(2)),
    training("printed zone", 3, Edging::Zone),
    training("header bar", 2, Edging::Header),
    training("printed frame", 4, Edging::Frame(1)),
    training("printed panel", 3, Edging::Panel),
    training("poster", 3, Edging::Poster),
    held_out("triple line", 2, Edging::Lines(3)),
    held_out("three-tone band", 2, Edging::Band(3)),
    held_out("hem", 2, Edging::Hem),
    held_out("dashes", 1, Edging::Dashes),
    held_out("crossed lines", 2, Edging::Crossed),
    held_out("double frame", 2, Edging::Frame(2)),
    held_out("plain zone", 2, Edging::Zone),
    held_out("corner field", 3, Edging::Field),
    held_out("large poster", 2, Edging::Poster),
];

/// Draws a mark in an ink, sRGB.
pub type Mark = fn([u8; 3]) -> Art;

/// Handling marks.
pub const MARKS: [Kind<Mark>; 2] = [training("arrows", 1, Art::Arrows), held_out("glass", 1, Art::Glass)];

/// A label's layout (of [`super::ink::label`]) and paper, sRGB.
pub const LABELS: [Kind<(u8, [u8; 3])>; 5] = [
    training("address label", 3, (0, [244, 243, 238])),
    training("grey address label", 1, (0, [236, 236, 232])),
    training("parcel label", 3, (1, [250, 248, 240])),
    held_out("order label", 2, (2, [244, 243, 238])),
    held_out("yellow order label", 1, (2, [240, 225, 160])),
];

/// Tapes: sRGB of the tint, and its cover.
pub const TAPES: [Kind<([u8; 3], f32)>; 5] = [
    training("brown tape", 1, ([150, 108, 62], 0.85)),
    training("tan tape", 1, ([170, 135, 90], 0.45)),
    training("clear tape", 1, ([205, 195, 175], 0.3)),
    held_out("dark tape", 1, ([128, 88, 48], 0.9)),
    held_out("white tape", 1, ([225, 224, 220], 0.9)),
];

/// Straps, sRGB.
pub const STRAPS: [Kind<[u8; 3]>; 7] = [
    training("black strap", 1, [24, 24, 26]),
    training("white strap", 1, [225, 224, 218]),
    training("yellow strap", 1, [230, 190, 40]),
    training("red strap", 1, [200, 40, 36]),
    training("blue strap", 1, [40, 70, 160]),
    held_out("green strap", 1, [40, 120, 60]),
    held_out("orange strap", 1, [228, 112, 34]),
];

/// Raw wood, sRGB.
pub const WOODS: [Kind<[u8; 3]>; 5] = [
    training("pale wood", 1, [205, 172, 128]),
    training("oak", 1, [178, 140, 98]),
    training("birch", 1, [215, 190, 150]),
    held_out("weathered wood", 2, [160, 150, 135]),
    held_out("stained wood", 1, [126, 90, 62]),
];

/// How a floor is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ground {
    /// Concrete or asphalt of one of these colours.
    Stone([[u8; 3]; 4]),
    /// Boards of wood.
    Planks,
    /// A painted coat.
    Coat,
    /// Square tiles.
    Tiles,
    /// Bricks or paving stones of one of these colours.
    Bricks([[u8; 3]; 2]),
}

/// Floors indoors.
pub const FLOORS: [Kind<Ground>; 5] = [
    training(
        "concrete floor",
        2,
        Ground::Stone([[140, 139, 136], [118, 120, 122], [160, 156, 148], [96, 110, 108]]),
    ),
    training("plank floor", 1, Ground::Planks),
    training("coated floor", 1, Ground::Coat),
    held_out("tile floor", 3, Ground::Tiles),
    held_out("brick floor", 1, Ground::Bricks([[138, 84, 66], [126, 104, 88]])),
];

/// Ground outdoors.
pub const YARDS: [Kind<Ground>; 2] = [
    training("asphalt", 1, Ground::Stone([[128, 126, 122], [92, 92, 94], [150, 146, 138], [110, 110, 110]])),
    held_out("paving", 1, Ground::Bricks([[142, 140, 134], [120, 112, 108]])),
];

/// How a wall is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wall {
    /// Bricks and mortar.
    Brick,
    /// Plaster or bare concrete.
    Plaster,
    /// Smooth paint.
    Paint,
    /// Corrugated sheet metal.
    Sheet,
    /// Boards of wood.
    Cladding,
}

/// Walls.
pub const WALLS: [Kind<Wall>; 5] = [
    training("brick wall", 1, Wall::Brick),
    training("plaster wall", 1, Wall::Plaster),
    training("painted wall", 2, Wall::Paint),
    held_out("sheet wall", 2, Wall::Sheet),
    held_out("cladding", 1, Wall::Cladding),
];

/// All words of a split.
#[must_use]
pub fn words(split: Split) -> Vec<&'static str> {
    fn of<T>(kinds: &[Kind<T>], split: Split) -> impl Iterator<Item = &'static str> {
        kinds.iter().filter(move |k| k.split == split).map(|k| k.word)
    }
    of(&CARTONS, split)
        .chain(of(&INKS, split))
        .chain(of(&PRINTS, split))
        .chain(of(&EDGINGS, split))
        .chain(of(&MARKS, split))
        .chain(of(&LABELS, split))
        .chain(of(&TAPES, split))
        .chain(of(&STRAPS, split))
        .chain(of(&WOODS, split))
        .chain(of(&FLOORS, split))
        .chain(of(&YARDS, split))
        .chain(of(&WALLS, split))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_table_has_kinds_of_both_splits_and_no_word_is_in_both() {
        fn both<T>(kinds: &[Kind<T>]) -> bool {
            [Split::Training, Split::HeldOut]
                .iter()
                .all(|s| kinds.iter().any(|k| k.split == *s && k.weight > 0))
        }
        assert!(both(&PRINTS) && both(&EDGINGS));
        assert!(both(&CARTONS) && both(&INKS) && both(&MARKS) && both(&LABELS) && both(&TAPES));
        assert!(both(&STRAPS) && both(&WOODS) && both(&FLOORS) && both(&YARDS) && both(&WALLS));
        let held = words(Split::HeldOut);
        assert!(words(Split::Training).iter().all(|w| !held.contains(w)));
    }
}
