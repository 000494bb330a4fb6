//! What stands in the way of measuring a face from where the head is.

use crate::calibration::Calibration;
use crate::face_geometry::view::FacePose;
use crate::units::{LaserId, Px};
use nalgebra::Vector3;

/// Key points keep this share of a side between them and the corner, and corners this share of the image's width between
/// them and the border: held in a hand, the head is aimed by some percent of what it sees.
pub(super) const MARGIN: f64 = 0.02;
/// Why a face cannot be measured from where the head is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Obstacle {
    /// This stripe does not cross two opposite sides.
    StripeMisses(LaserId),
    /// Lasers of one pair cross different pairs of sides: the head is not rolled along the box's edges.
    NotRolled,
    /// A corner lies outside the image.
    OutsideImage,
}

/// Everything that stands in the way; empty if the face can be measured. `margin`: share of a side, and of the image's
/// width, that must be left.
pub(crate) fn obstacles(calibration: &Calibration, pose: &FacePose, margin: f64) -> Vec<Obstacle> {
    let mut found = Vec::new();
    let mut along = [None; 4];
    for id in LaserId::ALL {
        match pose.crossing(calibration, id) {
            Some(crossing) if crossing.margin >= margin => along[id.index()] = Some(crossing.along_length),
            _ => found.push(Obstacle::StripeMisses(id)),
        }
    }
    let pairs = [[along[0], along[1]], [along[2], along[3]]];
    let mixed = pairs.iter().any(|pair| matches!(pair, [Some(a), Some(b)] if a != b));
    let same = pairs[0].iter().flatten().any(|a| pairs[1].iter().flatten().any(|b| a == b));
    if mixed || same {
        found.push(Obstacle::NotRolled);
    }
    let inside = |at: [f64; 2]| {
        let px = calibration.camera().px_from_point(&pose.point(at));
        px.is_some_and(|px| in_image(calibration, px, margin))
    };
    if !pose.corners().into_iter().all(inside) {
        found.push(Obstacle::OutsideImage);
    }
    found
}

fn in_image(calibration: &Calibration, px: Px, margin: f64) -> bool {
    let (width, height) = (f64::from(calibration.width_px()), f64::from(calibration.height_px()));
    let left = margin * width - 0.5;
    px.u >= left && px.v >= left && px.u <= width - 1.0 - left && px.v <= height - 1.0 - left
}

/// The ray (z = 1) of the middle of the four crossings on a plane straight ahead.
pub(crate) fn grid_middle(calibration: &Calibration, distance_mm: f64) -> Option<Vector3<f64>> {
    let mut sum = Vector3::zeros();
    for (i, j) in [(0, 2), (0, 3), (1, 2), (1, 3)] {
        let lines =
            [i, j].map(|k: usize| calibration.lasers()[k].per_mm - Vector3::new(0.0, 0.0, 1.0 / distance_mm));
        let crossing = lines[0].cross(&lines[1]);
        if crossing.z.abs() < 1e-15 {
            return None;
        }
        sum += crossing / crossing.z;
    }
    Some(sum / 4.0)
}
