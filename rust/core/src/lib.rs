//! boxline measures boxes from two pictures with four laser stripes.
//!
//! Data flows one way: frame, stripes, face plane, edges, rectangle, box; only [`pipeline`] knows all stages. A bad view
//! is a [`Reject`] with numbers; an [`Error`] is a broken input; a panic is a bug.
//! Conventions (frames, units, pixel origin): `rust/CONVENTIONS.md`.
#![forbid(unsafe_code)]

mod alternatives;
mod box_depth;
pub mod calib;
pub mod calibration;
pub mod camera;
pub mod confidence;
mod cuboid;
#[doc(hidden)]
pub mod diagnostics;
pub mod drift;
mod edges;
mod eigen;
pub mod error;
mod face;
mod face_lines;
pub mod feasibility;
pub mod frames;
pub mod image;
pub mod measurement;
pub mod network;
#[cfg(test)]
mod paper_head;
pub mod pipeline;
#[doc(hidden)]
pub mod points;
mod rectangle;
pub mod reject;
mod scene;
pub mod sides;
mod stripe;
pub mod trace;
pub mod units;
pub mod view;
pub mod warning;

pub use calibration::Calibration;
pub use camera::CameraModel;
pub use error::{Error, ErrorKind};
pub use feasibility::Hint;
pub use image::Frame;
pub use measurement::{
    BoxMeasurement, BoxReport, Candidate, DepthSeen, EdgeMethod, FaceMeasurement, FaceOutcome, Method,
    Outcome, Settings, SideLight, StageTimes, Straightness, SurfacePoint, Workers,
};
pub use network::{Channel, EdgeMap, EdgeMapNetwork, FaceMaps, Network};
pub use pipeline::{measure_box, measure_box_with_hints, measure_face, measure_face_with_hint};
pub use reject::Reject;
pub use units::{AngleEstimate, Estimate, LaserId, Px, Volume};
pub use warning::{Warning, WarningKind};
