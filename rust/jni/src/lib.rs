//! boxline for a JVM: the native side of the Java class `dev.boxline.internal.Native`.
//!
//! [`natives`] holds every exported function; each one runs inside `guard`, so that no panic and no error gets past it
//! other than as a typed exception. Calibrations, heads, captured frames and stop signs live in `handles`; frames from
//! outside come in as direct buffers, results leave as bytes of `boxline.v1` messages.
//! `measure` joins calibration, network and stop sign; `session` is an open head with its stream; `steady` says whether it
//! is held still; `recording` reads a pair of frames from a folder; `preview` makes small pictures of frames, which `window` (Android) draws. `logging` is the log of both.
//! Unsafe code: the export of functions (`natives`), the copy out of a buffer (`buffer`), the descriptor that Java hands
//! over (`session`), the surface that it hands over (`window`).

mod buffer;
mod guard;
mod handles;
mod logging;
mod measure;
pub mod natives;
#[cfg_attr(not(any(target_os = "android", test)), allow(dead_code))] // only `window` draws
mod preview;
mod recording;
mod session;
mod steady;
#[cfg(target_os = "android")]
mod window;
