//! From a scene to pixels: [`prepare`] puts the scene before the camera, [`film`] casts rays onto linear light, square by square
//! where a square shows one flat face, [`sensor`] makes of it what the head's camera would deliver.

pub mod film;
pub mod laser;
pub mod lit;
mod patch;
pub mod prepare;
pub mod sensor;
pub mod shade;

pub use film::{Film, Window, expose_film, expose_film_around};
pub use prepare::{Options, Stage};
