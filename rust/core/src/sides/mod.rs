//! Where a face ends: its picture in its own plane, as the network of sides sees it ([`face_view`]; what that says is in [`crate::view`]).

pub mod face_view;

pub use face_view::ViewAxes;
