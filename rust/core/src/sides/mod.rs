//! Where a face ends: its picture in its own plane ([`face_view`]) and what a network that sees it says of the four sides ([`odds`]).

pub mod face_view;
pub mod odds;

pub use face_view::{FaceView, ViewAxes};
pub use odds::SideOdds;
