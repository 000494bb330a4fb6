//! The head on the cable: a camera of USB video class with four lasers and a calibration store, described in `uvc/PROTOCOL.md`.
//! Gives bytes, time stamps and laser states; knows no camera model.
//!
//! - [`descriptor`], [`probe`], [`mode`], [`payload`], [`bulk`], [`assembly`]: the protocol, pure functions of bytes.
//! - [`head`], [`store`]: the head's own controls.
//! - [`Device`], [`Stream`]: an open head over libusb; all unsafe code is in `sys`.
//! - [`emulator`]: a head made of software.

pub mod assembly;
pub mod bulk;
pub mod descriptor;
mod device;
pub mod emulator;
mod error;
pub mod head;
pub mod mode;
pub mod payload;
pub mod probe;
pub mod store;
mod stream;
mod sys;

pub use assembly::{Assembler, Counters, Frame};
pub use device::{Device, Identity, ListedCamera, Selector, devices};
pub use error::{Error, ErrorKind};
pub use stream::{NegotiatedMode, Stream, StreamSettings};
