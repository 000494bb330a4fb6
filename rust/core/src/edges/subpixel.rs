//! Sub-pixel edge points.
