//! The head of the paper's Table 2, for tests.

use crate::calibration::Calibration;
use crate::camera::CameraModel;

/// The head whose image has `share` of its rows and columns: 1, or 0.25 where a test renders frames.
pub(crate) fn paper_head(share: f64) -> Calibration {
    let centre = |px: f64| (px + 0.5) * share - 0.5;
    let camera = CameraModel {
        fx: 2458.9172 * share,
        fy: 2453.81 * share,
        skew: 0.0,
        cx: centre(1239.5188),
        cy: centre(1032.559),
        k1: -0.03415937,
        k2: 0.321070446,
        ..CameraModel::PINHOLE
    };
    let lasers = [
        [0.0079291, -0.00817394, 0.00018065, -1.0],
        [0.01078476, -0.01121147, 0.00223845, -1.0],
        [0.01037354, 0.00959161, 0.00170705, -1.0],
        [0.00799885, 0.00730513, -0.00038506, -1.0],
    ];
    let size = [2592.0, 1944.0].map(|pixels| (pixels * share) as u32);
    Calibration::new("test", size, camera, lasers).expect("the paper's head")
}
