//! A pair of frames from a recording's folder.

use crate::guard::Failure;
use crate::session::{Captured, check_serial};
use boxline::{Calibration, Error, ErrorKind};
use boxline_proto::json::{Laser, RecordedFrame, Role, read_calibration, read_recording};
use std::path::Path;

/// The calibration and the first two frames that show a face with the lasers on, each with its twin (`a_off` of `a`) if there is one.
pub(crate) fn read_pair(folder: &Path) -> Result<(Calibration, [Captured; 2]), Failure> {
    let recording = read_recording(folder)?;
    let calibration = read_calibration(&recording.calibration_file)?;
    check_serial(&recording.serial, &calibration)?;
    let lit = recording.frames.iter().filter(|frame| frame.role == Role::Face && frame.laser == Laser::On);
    let read = |frame: &RecordedFrame| {
        std::fs::read(&frame.file).map_err(|e| {
            Error::new(ErrorKind::Io, format!("{}: cannot read: {e}", frame.file.display())).with_source(e)
        })
    };
    let mut pair = Vec::new();
    for frame in lit.take(2) {
        let left_out = |e: &Error| log::warn!("not used: {e}");
        let off = recording.twin_of(frame).and_then(|off| read(off).inspect_err(left_out).ok());
        pair.push(Captured { jpeg: read(frame)?, off, serial: recording.serial.clone() });
    }
    let pair: Result<[Captured; 2], _> = pair.try_into();
    pair.map(|pair| (calibration, pair)).map_err(|found| {
        let text = format!("{}: {} lit frames of faces, two are needed", folder.display(), found.len());
        Error::new(ErrorKind::InvalidFile, text).into()
    })
}
