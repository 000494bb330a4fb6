//! What a laser may do between calibrations: turn by two angles about its exit and be shifted, three numbers for the
//! three of its plane. In these, not in 1/mm, priors and results make sense.

use crate::calibration::{Calibration, laser_exit};
use crate::frames::{Cam, Plane};
use crate::units::LaserId;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// Motions of all four lasers: tilt (rad), twist (rad), shift (mm) of laser 1, then of the others.
pub type Motions = SVector<f64, 12>;
/// A covariance or information of all motions.
pub type MotionMatrix = SMatrix<f64, 12, 12>;

/// Derivative of a plane `p . X = 1` by tilt, twist and shift of its laser, in columns; 1/mm per rad or mm.
///
/// The exit is where the plane meets the camera's x axis, `f` the forward direction within the plane. Tilt turns the
/// normal towards `f` (the stripe moves across itself), twist turns it about `f` (the stripe turns in the picture), shift
/// moves the exit along the normal.
pub fn plane_by_motion(plane: &Plane<Cam>) -> Option<Matrix3<f64>> {
    let (normal, distance_mm) = plane.normal_and_distance_mm();
    let forward = (Vector3::z() - normal * normal.z).try_normalize(1e-9)?;
    let aside = normal.cross(&forward);
    let exit = laser_exit(plane);
    // p = m / (m . exit + shift): turned, the plane still holds its exit.
    let turned = |by: Vector3<f64>| by / distance_mm - normal * (by.dot(&exit) / distance_mm.powi(2));
    Some(Matrix3::from_columns(&[turned(forward), turned(aside), -normal / distance_mm.powi(2)]))
}

/// All four derivatives.
pub fn all_planes_by_motion(calibration: &Calibration) -> Option<[Matrix3<f64>; 4]> {
    let [l1, l2, l3, l4] = LaserId::ALL.map(|id| plane_by_motion(calibration.laser(id)));
    Some([l1?, l2?, l3?, l4?])
}

/// The planes moved, to first order.
pub fn moved(planes: &[Plane<Cam>; 4], by_motion: &[Matrix3<f64>; 4], motions: &Motions) -> [Plane<Cam>; 4] {
    std::array::from_fn(|k| {
        Plane::new(planes[k].per_mm + by_motion[k] * motions.fixed_rows::<3>(3 * k).into_owned())
    })
}

/// Motions that would change the planes by these vectors, 1/mm.
pub fn motions_of(by_motion: &[Matrix3<f64>; 4], changes: &[Vector3<f64>; 4]) -> Option<Motions> {
    let mut motions = Motions::zeros();
    for (k, (b, change)) in by_motion.iter().zip(changes).enumerate() {
        motions.fixed_rows_mut::<3>(3 * k).copy_from(&b.lu().solve(change)?);
    }
    Some(motions)
}

/// `by_motion` of all lasers as one block-diagonal matrix.
pub fn blocks(by_motion: &[Matrix3<f64>; 4]) -> MotionMatrix {
    let mut all = MotionMatrix::zeros();
    for (k, b) in by_motion.iter().enumerate() {
        all.fixed_view_mut::<3, 3>(3 * k, 3 * k).copy_from(b);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::super::simulation::head;
    use super::*;

    #[test]
    fn tilt_is_what_a_turned_laser_does_and_keeps_its_exit() {
        let calibration = head();
        for id in LaserId::ALL {
            let plane = calibration.laser(id);
            let by_motion = plane_by_motion(plane).expect("a plane");
            let angle = 1e-5;
            let turned = calibration.with_turned_laser(id, angle).laser(id).per_mm;
            let linear = plane.per_mm + by_motion * Vector3::new(angle, 0.0, 0.0);
            assert!((turned - linear).norm() < 1e-9 * plane.per_mm.norm());
            let exit = Vector3::new(1.0 / plane.per_mm.x, 0.0, 0.0);
            for column in 0..2 {
                assert!(by_motion.column(column).dot(&exit).abs() < 1e-12, "a turn about the exit");
            }
            let shifted = Plane::<Cam>::new(plane.per_mm + by_motion * Vector3::new(0.0, 0.0, 1e-3));
            let wider = shifted.normal_and_distance_mm().1 - plane.normal_and_distance_mm().1;
            assert!((wider - 1e-3).abs() < 1e-6, "{wider}");
        }
    }

    #[test]
    fn motions_and_changes_are_each_others_inverse() {
        let calibration = head();
        let by_motion = all_planes_by_motion(&calibration).expect("planes");
        let motions = Motions::from_fn(|i, _| 1e-4 * (i as f64 - 4.0));
        let changes = std::array::from_fn(|k| {
            moved(calibration.lasers(), &by_motion, &motions)[k].per_mm - calibration.lasers()[k].per_mm
        });
        let back = motions_of(&by_motion, &changes).expect("regular");
        assert!((back - motions).norm() < 1e-9);
    }
}
