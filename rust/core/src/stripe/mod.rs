//! Stripes: where the four lasers light a common plane ([`grid_search`], adding up along
//! [`curve`]s), sub-pixel centres along them ([`trace`],
//! [`peak`]) in the colours that show them best ([`tint`]).

mod curve;
pub(crate) mod grid_search;
pub mod peak;
pub(crate) mod tint;
pub(crate) mod trace;
