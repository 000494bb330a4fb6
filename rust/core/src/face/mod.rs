//! The plane of a face from its stripes ([`plane_fit`]), and how far each stripe stays on it ([`extent`]).

pub(crate) mod extent;
pub(crate) mod plane_fit;
pub(crate) mod raster;
