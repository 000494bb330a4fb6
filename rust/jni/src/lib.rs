//! boxline for a JVM: the native side of the Java class `dev.boxline.internal.Native`.
//!
//! [`natives`] holds every exported function; each one runs inside `guard`, so that no panic and no error gets past it
//! other than as a typed exception. Calibrations live in `handles`, frames come in as direct buffers, results leave as
//! bytes of `boxline.v1.BoxReport`. The only `unsafe` code is the export of the functions and the copy out of a buffer.

mod buffer;
mod guard;
mod handles;
pub mod natives;
