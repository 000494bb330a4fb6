//! boxline measures boxes from two pictures with four laser stripes. This crate is pure: frames and a calibration in, a report out. It
//! reads no files (`boxline-proto` does), starts no threads, and runs no network itself (`boxline-edgenet` does).
//!
//! ```
//! use boxline::{Frame, Outcome, Settings, measure_box};
//! use boxline_proto::json::read_calibration;
//! use std::path::Path;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let data = Path::new("../../tests/data");
//! let calibration = read_calibration(&data.join("calibration_set/calibration.json"))?;
//! let a = Frame::from_jpeg(&std::fs::read(data.join("b02/a.jpg"))?)?; // two adjacent faces, all lasers on
//! let b = Frame::from_jpeg(&std::fs::read(data.join("b02/b.jpg"))?)?;
//!
//! // Right with this probability at least; without a network few results are as sure as the default, 0.98.
//! let settings = Settings { least_confidence: 0.9, ..Settings::default() };
//! let report = measure_box(&[&a, &b], &calibration, &settings)?;
//! match report.outcome {
//!     Outcome::Measured(size) => {
//!         println!("length {:.1} ± {:.1} mm", size.length.value_mm, size.length.sigma_mm);
//!         assert!((size.length.value_mm - 550.6).abs() < 2.0); // its true length
//!     }
//!     Outcome::Ambiguous(two) => panic!("one of two boxes: {two:?}"),
//!     Outcome::Rejected(reason) => panic!("not measured: {reason}"),
//! }
//! # Ok(())
//! # }
//! ```
//!
//! Without a network ([`Settings::network`]) nearly all boxes are refused by default, since few are sure enough; `examples/measure.rs` of
//! `boxline-edgenet` has one. `boxline-calib` makes a calibration from pictures of a board.
//!
//! Three things can come back. A result is an [`Outcome`]: lengths in mm, each an [`Estimate`] with one standard deviation. A view that
//! cannot be measured is a [`Reject`] with numbers, which is a result too. An [`Error`] is a broken input: bytes, a calibration, sizes that
//! do not fit. A panic is a bug.
//!
//! *The paper* that comments cite is T. Peng, Z. Zhang, Y. Song, F. Chen, D. Zeng: "Portable System for Box Volume Measurement Based on
//! Line-Structured Light Vision and Deep Learning", Sensors 2019, 19, 3921; `rust/PHYSICS.md` has its equations as they are used.
//!
//! Positions in pictures are [`Px`] on the raw sensor, (0, 0) the centre of the first pixel. Points, rays and planes in space carry their
//! frame of reference as a type ([`frames`]); `rust/CONVENTIONS.md` has all terms, units and frames. Data flows one way, from frame to
//! stripes, face plane, edges, rectangle and box; only [`pipeline`] knows all stages, and [`trace`] lets a caller look on.
#![forbid(unsafe_code)]

mod box_depth;
pub mod calibration;
pub mod camera;
pub mod confidence;
mod cuboid;
#[doc(hidden)]
pub mod diagnostics;
mod edges;
pub mod eigen;
pub mod error;
mod face;
pub mod face_geometry;
pub mod feasibility;
pub mod frames;
mod hypotheses;
pub mod image;
pub mod measurement;
pub mod network;
#[cfg(test)]
mod noise;
mod paper;
#[cfg(test)]
mod paper_head;
pub mod pipeline;
#[doc(hidden)]
pub mod points;
mod rectangle;
pub mod reject;
pub mod report;
mod scene;
pub mod sides;
pub mod statistics;
pub mod stripe;
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
    BoxMeasurement, Candidate, DepthEstimate, EdgeMethod, FaceMeasurement, FaceOutcome, Method, Outcome,
    Settings, SideLight, StageTimes, Straightness, SurfacePoint, Workers,
};
pub use network::{Channel, EdgeMap, EdgeMapNetwork, FaceMaps, Network};
pub use pipeline::{FollowedFace, LiveFace, Tracker, measure_box, measure_face};
pub use reject::Reject;
pub use report::{BoxReport, FaceReport};
pub use units::{AngleEstimate, Estimate, LaserId, Px, Volume};
pub use warning::{Warning, WarningKind};
