//! What estimates a head: one-step calibration of camera and lasers from frames of a circle board (paper, section 3.3), and [`drift`], which
//! sees from ordinary boxes whether a laser has moved since. `rust/CALIBRATION.md` describes both; `examples/calibrate.rs` uses the first.
//!
//! [`find_board`] for every frame (frames are independent: run them in parallel), [`solve_camera`] over all of them,
//! [`CameraSolution::find_stripes`] for every frame again, [`solve_all`]. Then [`uncertainty`] says what it is good for
//! and [`next_frame`] what to add. A set that fixes no calibration is a [`CalibrationReject`]. While frames are being taken,
//! [`Session`] says which are worth it.
#![forbid(unsafe_code)]

mod adjust;
mod blobs;
mod board;
mod coverage;
mod detect;
pub mod drift;
mod fields;
mod grid;
mod judge;
mod lens;
mod misfit;
mod misfit_kind;
mod model;
mod next_frame;
mod nuisance;
pub mod opencv;
mod patterns;
mod placement;
mod planes;
mod reject;
mod rim;
mod session;
#[cfg(test)]
mod simulation;
mod solve;
mod stripes;
pub mod uncertainty;
mod zhang;

// Tests have core's noise, head and faces, which name modules of core as their own crate's.
#[cfg(test)]
use boxline::{calibration, camera, face_geometry, units};
#[cfg(test)]
#[path = "../../core/src/face_geometry/simulation.rs"]
mod face_simulation;
#[cfg(test)]
#[path = "../../core/src/noise.rs"]
mod noise;
#[cfg(test)]
#[path = "../../core/src/paper_head.rs"]
mod paper_head;

pub use board::{Board, BoardView, Circle, OnBoard};
pub use coverage::{Corner, empty_corners};
pub use detect::{MIN_CIRCLES, find_board};
pub use judge::tilt_deg;
pub use lens::{LensChoice, LensTerms, LensTrial};
pub use misfit_kind::{Misfit, MisfitKind};
pub use next_frame::{Advice, next_frame};
pub use reject::{CalibrationReject, FrameReject};
pub use session::{BoardPlace, ENOUGH_FRAMES, Missing, Session, Side, Verdict};
pub use solve::{
    CalibrationSettings, CalibrationSolution, CameraAlone, CameraRefusal, CameraSolution, CentreResidual,
    FrameResult, MIN_FRAMES, StripeResidual, solve_all, solve_camera,
};
pub use stripes::BoardStripe;
