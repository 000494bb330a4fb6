//! Renders frames of boxes under the head's four lasers, with exact truth beside the pixels.
//!
//! One direction: [`rng`] → [`head`] (a calibration and its beams) → [`pose`] (where the head may stand) → [`stock`] (materials
//! of the training or the held-out split) → [`world`] (boxes, stands, rooms, light) → [`render`] (film, then sensor) → [`truth`]
//! (with [`mod@ends`] of stripes and [`rivals`] of sides) and [`labels`] → [`recording`] (with [`tremor`] between a lit picture and
//! its unlit twin) and [`stream`]. [`perturb`] changes finished frames in ways that leave the sizes as they are.
//! [`points`] draws boxes without pictures, to ask whether sigmas are true.
//! Everything follows from a seed: the same seed gives the same bytes. Positions are mm; the raster is core's
//! (pixel centres at integers). Nothing here is part of the measuring program's results.
#![forbid(unsafe_code)]

pub mod board;
pub mod ends;
pub mod error;
pub mod hazard;
pub mod head;
pub mod labels;
pub mod material;
pub mod perturb;
pub mod photos;
pub mod points;
pub mod pose;
pub mod raster;
pub mod recording;
pub mod render;
pub mod rivals;
pub mod rng;
pub mod shape;
pub mod solid;
pub mod stock;
pub mod stream;
pub mod tremor;
pub mod truth;
pub mod vec3;
pub mod views;
pub mod world;

pub use error::Error;
pub use hazard::{Hazard, Hazards};
pub use head::{Head, HeadKind};
pub use photos::Photos;
pub use raster::Raster;
pub use rng::Rng;
pub use shape::Shape;
pub use stock::{Split, Stock};
