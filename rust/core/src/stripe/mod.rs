//! Stripes: where the four lasers light a common plane ([`grid_search`]), sub-pixel centres along them ([`trace`],
//! [`peak`]).

pub(crate) mod grid_search;
pub mod peak;
pub(crate) mod trace;
