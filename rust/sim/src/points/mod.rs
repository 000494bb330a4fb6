//! Boxes as points without pictures: where four lasers meet a rounded box and where its edges appear, from rays and planes
//! in space, with the noise that physics allows. Thousands in seconds, to ask whether the sigmas of a measurement are true
//! ([`coverage`]). It shares the camera model with core, and nothing of its fits.

pub mod coverage;
mod face;
mod rounding;
mod truth;

pub use truth::{Conditions, PointBox, PointFace};
