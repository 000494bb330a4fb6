//! What a frame's materials are drawn from: the kinds of one split and, if there are any, its photographs.
//!
//! A network must be tested on materials that it has not been trained on, so whole kinds and whole photographs belong to one
//! split only; geometry and light are common to both. Which kinds these are is listed in [`crate::material::kinds`].

use crate::error::Error;
use crate::hazard::Hazards;
use crate::photos::Photos;
use crate::rng::Rng;
use std::path::Path;

/// Which materials may be drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Split {
    /// What a network may learn from.
    #[default]
    Training,
    /// What it has never seen.
    HeldOut,
}

impl Split {
    /// The word in the meta data.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Training => "training",
            Self::HeldOut => "held_out",
        }
    }

    /// The split of a photograph, by its file's name, so that adding photographs never moves another: one in six is held out.
    #[must_use]
    pub fn of_photo(name: &str) -> Self {
        // FNV-1a (Fowler, Noll, Vo): the standard library's hash may change with its version.
        let hash = name
            .bytes()
            .fold(0xCBF2_9CE4_8422_2325_u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x100_0000_01B3));
        if crate::rng::mix(hash).is_multiple_of(6) { Self::HeldOut } else { Self::Training }
    }
}

/// One kind of a material.
#[derive(Clone, Copy, Debug)]
pub struct Kind<T> {
    /// Its name in truth and meta data.
    pub word: &'static str,
    /// How often it is drawn, against the others of its table and split.
    pub weight: usize,
    /// The only split that draws it.
    pub split: Split,
    /// What it is.
    pub what: T,
}

/// The materials and hazards that may be drawn.
#[derive(Clone, Debug, Default)]
pub struct Stock {
    /// Only kinds of this split are drawn.
    pub split: Split,
    /// Only photographs of this split.
    pub photos: Photos,
    /// Only these hazards.
    pub hazards: Hazards,
}

impl Stock {
    /// The kinds of a split, without photographs.
    #[must_use]
    pub fn new(split: Split) -> Self {
        Self { split, ..Self::default() }
    }

    /// Adds those photographs of a folder that belong to the split.
    ///
    /// # Errors
    /// The folder cannot be read, or holds no photograph of the split.
    pub fn with_photos(split: Split, folder: &Path) -> Result<Self, Error> {
        let photos = Photos::from_folder(folder, |name| Split::of_photo(name) == split)?;
        if photos.all.is_empty() {
            let text = format!("no .jpg here that belongs to the {} split", split.word());
            return Err(Error::new(folder.display().to_string(), text));
        }
        Ok(Self { split, photos, ..Self::default() })
    }

    /// Draws one of a table's kinds of this split.
    ///
    /// # Panics
    /// The table has no kind of this split: a bug that a test finds.
    pub fn pick<'k, T>(&self, rng: &mut Rng, kinds: &'k [Kind<T>]) -> &'k Kind<T> {
        let own = || kinds.iter().filter(|k| k.split == self.split);
        let mut left = rng.below(own().map(|k| k.weight).sum());
        own()
            .find(|k| {
                let found = left < k.weight;
                left = left.saturating_sub(k.weight);
                found
            })
            .expect("each table has kinds of each split: tested in `material::kinds`")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn about_one_photograph_in_six_is_held_out_and_stays_so() {
        let held = (0..6000).filter(|i| Split::of_photo(&format!("photo-{i}.jpg")) == Split::HeldOut).count();
        assert!((900..1100).contains(&held), "{held}");
        // A name's split must never change: networks have been trained on it.
        assert_eq!(Split::of_photo("Bridge_by_Sander_Klootwijk.jpg"), Split::Training);
    }

    #[test]
    fn kinds_are_drawn_by_weight_and_only_of_the_own_split() {
        let kind = |word, weight, split| Kind { word, weight, split, what: () };
        let kinds =
            [kind("a", 3, Split::Training), kind("b", 5, Split::HeldOut), kind("c", 1, Split::Training)];
        let mut rng = Rng::new(1, 1);
        let stock = Stock::new(Split::Training);
        let words: Vec<_> = (0..4000).map(|_| stock.pick(&mut rng, &kinds).word).collect();
        let often = words.iter().filter(|w| **w == "a").count();
        assert!((2850..3150).contains(&often), "{often}");
        assert!(!words.contains(&"b"));
    }
}
