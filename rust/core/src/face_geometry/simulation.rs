//! Faces that a head could measure, drawn at random, with noisy lines: for the tests here, of `feasibility` and of boxline-calib's `drift`.

use crate::calibration::Calibration;
use crate::face_geometry::view::{FacePose, USUAL};
use crate::face_geometry::{FaceLines, FaceState};
use crate::noise::Noise;
use crate::paper_head::paper_head;
use crate::units::{LaserId, Px};
use nalgebra::{Rotation3, Vector3};

/// The paper's head.
pub(crate) fn head() -> Calibration {
    paper_head(1.0)
}

/// A face of 150 to 1800 mm as a courier would hold the head: rolled by 45 degrees to 10, tilted by up to 40, near enough to
/// fill much of the picture. Whether it can be measured is not asked.
pub(crate) fn drawn_pose(noise: &mut Noise) -> FacePose {
    let length = 150.0 * 12f64.powf(noise.uniform());
    let width = length * noise.between(0.45, 1.0);
    let distance = ((length + width) / noise.between(0.7, 1.1)).clamp(350.0, 2500.0);
    let quarter = (noise.uniform() * 4.0).floor();
    let roll = (45.0 + 90.0 * quarter + noise.between(-10.0, 10.0)).to_radians();
    let (tilt, towards) = (noise.between(0.0, 40.0).to_radians(), noise.between(0.0, std::f64::consts::TAU));
    let axis = nalgebra::Unit::new_normalize(Vector3::new(towards.cos(), towards.sin(), 0.0));
    let turn = Rotation3::from_axis_angle(&axis, tilt);
    let middle = Vector3::new(noise.between(-0.06, 0.06), noise.between(-0.06, 0.06) - 0.02, 1.0) * distance;
    let along = turn * Vector3::new(roll.cos(), roll.sin(), 0.0);
    FacePose::new(along, turn * Vector3::z(), middle, [length, width]).expect("it faces the head")
}

/// A face that can be measured: stripes 1 and 2 cross one pair of sides, 3 and 4 the other, all corners in the image.
pub(crate) fn drawn_face(calibration: &Calibration, noise: &mut Noise) -> FacePose {
    loop {
        let pose = drawn_pose(noise);
        let crossings: Vec<_> =
            LaserId::ALL.iter().filter_map(|id| pose.crossing(calibration, *id)).collect();
        let inside = |at: [f64; 2]| {
            calibration
                .camera()
                .px_from_point(&pose.point(at))
                .is_some_and(|p| p.u > 0.0 && p.v > 0.0 && p.u < 2591.0 && p.v < 1943.0)
        };
        if crossings.len() == 4
            && crossings.iter().all(|c| c.margin > 0.02)
            && crossings[0].along_length == crossings[1].along_length
            && crossings[2].along_length == crossings[3].along_length
            && crossings[0].along_length != crossings[2].along_length
            && pose.corners().into_iter().all(inside)
        {
            return pose;
        }
    }
}

/// A face and its lines, seen by `calibration` with so many sigmas of noise.
pub(crate) fn some_face(calibration: &Calibration, noise: &mut Noise, sigmas: f64) -> (FaceState, FaceLines) {
    let pose = drawn_face(calibration, noise);
    let mut lines = pose.lines(calibration, &USUAL).expect("all lines are in view");
    for [a, b] in lines.stripes.iter_mut().chain(&mut lines.sides) {
        let (du, dv) = (b.at.u - a.at.u, b.at.v - a.at.v);
        let length = du.hypot(dv);
        for p in [a, b] {
            let off = sigmas * p.sigma_px * noise.normal();
            p.at = Px::new(p.at.u - dv / length * off, p.at.v + du / length * off);
        }
    }
    (pose.state(), lines)
}
