//! Stripes: where the four lasers light a common plane (`grid_search`, adding up along `curve`s), sub-pixel centres along them (`centres`,
//! [`peak`]) in the colours that show them best (`colour_projection`).

pub(crate) mod centres;
pub(crate) mod colour_projection;
mod curve;
pub(crate) mod grid_search;
pub mod peak;
pub(crate) mod stripe_line;
