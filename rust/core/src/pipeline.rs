//! The one place that knows all stages and runs them in order.

use crate::calibration::Calibration;
use crate::error::{Error, ErrorKind};
use crate::image::Frame;
use crate::measurement::{BoxReport, FaceOutcome, Settings, StageTimes};
use crate::reject::Reject;

/// Measures one face. `times` gets the nanoseconds of each stage appended.
///
/// # Errors
/// [`ErrorKind::CalibrationMismatch`] if the frame's size is not the calibration's.
pub fn measure_face(
    frame: &Frame,
    calibration: &Calibration,
    settings: &Settings,
    times: &mut StageTimes,
) -> Result<FaceOutcome, Error> {
    let _ = (settings, times);
    if frame.width_px() != calibration.width_px() as usize || frame.height_px() != calibration.height_px() as usize {
        return Err(Error::new(
            ErrorKind::CalibrationMismatch,
            format!(
                "the frame is {} x {} px, the calibration is for {} x {} px",
                frame.width_px(),
                frame.height_px(),
                calibration.width_px(),
                calibration.height_px()
            ),
        ));
    }
    Ok(FaceOutcome::Rejected(Reject::NoBox { best_share: 0.0, needed_share: 0.0 }))
}

/// Measures a box from two frames of adjacent faces.
///
/// # Errors
/// As [`measure_face`], for either frame.
pub fn measure_box(
    first: &Frame,
    second: &Frame,
    calibration: &Calibration,
    settings: &Settings,
    times: &mut StageTimes,
) -> Result<BoxReport, Error> {
    let a = measure_face(first, calibration, settings, times)?;
    let b = measure_face(second, calibration, settings, times)?;
    let outcome = match (&a, &b) {
        (FaceOutcome::Rejected(r), _) | (_, FaceOutcome::Rejected(r)) => crate::Outcome::Rejected(r.clone()),
        _ => crate::Outcome::Rejected(Reject::RectangleOpen { sides_found: 0 }),
    };
    Ok(BoxReport { outcome, faces: [a, b] })
}
