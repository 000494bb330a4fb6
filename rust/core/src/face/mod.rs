//! The plane of a face from its stripes ([`plane_fit`]), how far each stripe stays on it ([`extent`]), coordinates on it
//! ([`raster`]), its four sides ([`outline`]), and the model of all that is seen of it ([`model`]).

pub(crate) mod end_outline;
pub(crate) mod extent;
#[cfg(test)]
mod faint_tests;
pub(crate) mod map_outline;
pub(crate) mod model;
pub(crate) mod outline;
pub(crate) mod plane_fit;
pub(crate) mod raster;
