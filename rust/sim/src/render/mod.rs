//! From a scene to pixels: [`prepare`] puts the scene before the camera, [`film`] casts rays onto linear light,
//! [`sensor`] makes of it what the head's camera would deliver.

pub mod film;
pub mod laser;
pub mod lit;
pub mod prepare;
pub mod sensor;
pub mod shade;

pub use film::{Film, expose_film};
pub use prepare::{Options, Stage};
