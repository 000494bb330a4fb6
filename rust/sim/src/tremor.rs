//! How a hand moves the head between the lit picture and the unlit one, which is taken a frame later.
//!
//! Two movements add up, each the same about all axes. Physiological tremor: the hand's peak lies between 6 and 12 Hz (Lakie et
//! al., J. Physiol. 593, 2015, 4411); its amplitude is mostly 0.01 g (peak) at 7 Hz, 0.0015 to 0.035 g among 97 people (Wade, Gresty
//! and Findley, Arch. Neurol. 39, 1982, 358), so 0.05 mm. Slow sway is the larger part. No published rate was found for a head like
//! this one: its rate is an assumption, derived from the 1 degree of hand movement that image stabilisers are built for (Sachs, Nasiri
//! and Goehl, Image Stabilization Technology Overview, InvenSense). Parallax of the scene follows from the moved view.

use crate::rng::Rng;
use crate::world::View;
use nalgebra::{Rotation3, Vector3};
use std::f64::consts::{PI, SQRT_2, TAU};

/// From the lit picture to the unlit one: a frame at 15 frames a second, s.
pub const APART_S: f64 = 1.0 / 15.0;

/// Band of the tremor, Hz.
const TREMOR_HZ: [f64; 2] = [6.0, 12.0];
/// Peak of the tremor, mm: 0.01 g at 7 Hz.
const TREMOR_PEAK_MM: f64 = 0.01 * 9_806.65 / (TAU * 7.0 * TAU * 7.0);
/// From the wrist, about which the hand trembles, to the camera, mm.
const WRIST_MM: f64 = 100.0;
/// Sway from end to end, and its period: 1 degree in 1.5 s.
const SWAY_RAD: f64 = PI / 180.0;
const SWAY_S: f64 = 1.5;
/// From the shoulder, about which the arm sways, to the camera, mm.
const SHOULDER_MM: f64 = 600.0;

/// Standard deviations of the movement about, and along, each axis of the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sigmas {
    /// Rotation, rad.
    pub rotation_rad: f64,
    /// Translation, mm.
    pub translation_mm: f64,
}

/// Standard deviations of the movement within a time: 1.84 mrad and 1.04 mm in [`APART_S`].
#[must_use]
pub fn sigmas(apart_s: f64) -> Sigmas {
    // A sine of amplitude a / 2 and period T has the root mean square rate pi a / (T sqrt 2); in a fifteenth of a second it hardly changes.
    let sway_rad = PI * SWAY_RAD / (SWAY_S * SQRT_2) * apart_s;
    // The difference of two values of a process with an even spectrum in a band: 2 sigma^2 (1 - mean of cos).
    let [low, high] = TREMOR_HZ.map(|hz| TAU * hz * apart_s);
    let cosine = (high.sin() - low.sin()) / (high - low);
    let tremor_mm = TREMOR_PEAK_MM / SQRT_2 * (2.0 * (1.0 - cosine)).sqrt();
    Sigmas {
        rotation_rad: sway_rad.hypot(tremor_mm / WRIST_MM),
        translation_mm: (sway_rad * SHOULDER_MM).hypot(tremor_mm),
    }
}

/// A movement of the head: the transform from the camera frame of the lit picture to that of the unlit one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Rotation vector, rad.
    pub rotation_rad: Vector3<f64>,
    /// Translation, mm.
    pub translation_mm: Vector3<f64>,
}

impl Motion {
    /// No movement.
    #[must_use]
    pub fn still() -> Self {
        Self { rotation_rad: Vector3::zeros(), translation_mm: Vector3::zeros() }
    }

    /// The movement of a hand that means to hold still, within [`APART_S`].
    pub fn of_hand(rng: &mut Rng) -> Self {
        let sigmas = sigmas(APART_S);
        let mut draw = |sigma: f64| Vector3::from_fn(|_, _| sigma * rng.normal());
        Self { rotation_rad: draw(sigmas.rotation_rad), translation_mm: draw(sigmas.translation_mm) }
    }

    /// The view after the movement.
    #[must_use]
    pub fn moved(&self, view: &View) -> View {
        let turn = Rotation3::new(self.rotation_rad);
        let cam_from_world = turn * view.cam_from_world;
        // p_off = R p_on + t is zero at the new camera: p_on = -R' t.
        View { cam_from_world, camera_mm: view.world(-(turn.inverse() * self.translation_mm)), ..*view }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Head;
    use crate::pose::{FacePose, grid_centre, px_of};

    #[test]
    fn draws_scatter_as_the_sigmas_say() {
        let stated = sigmas(APART_S);
        assert!((stated.rotation_rad * 1e3 - 1.84).abs() < 0.01, "{stated:?}");
        assert!((stated.translation_mm - 1.036).abs() < 0.01, "{stated:?}");
        // Tremor goes to and fro, sway goes on: in a tenth of the time the first is more of it.
        assert!(sigmas(0.1 * APART_S).rotation_rad > 0.1 * stated.rotation_rad);
        let mut rng = Rng::new(8, 0);
        let n = 4000;
        let draws: Vec<Motion> = (0..n).map(|_| Motion::of_hand(&mut rng)).collect();
        for axis in 0..3 {
            let spread = |of: &dyn Fn(&Motion) -> f64, sigma: f64| {
                let mean = draws.iter().map(of).sum::<f64>() / f64::from(n);
                let square = draws.iter().map(|m| of(m).powi(2)).sum::<f64>() / f64::from(n);
                assert!(mean.abs() < 0.06 * sigma, "mean {mean}");
                assert!((square.sqrt() / sigma - 1.0).abs() < 0.05, "{} against {sigma}", square.sqrt());
            };
            spread(&|m| m.rotation_rad[axis], stated.rotation_rad);
            spread(&|m| m.translation_mm[axis], stated.translation_mm);
        }
    }

    /// Registration is designed for 3 to 19 px at the corners of a face.
    #[test]
    fn corners_of_a_face_move_by_some_pixels() {
        let head = Head::nominal().unwrap();
        let mut rng = Rng::new(9, 0);
        let mut all = Vec::new();
        for (depth, half) in [(400.0, [110.0, 80.0]), (1000.0, [300.0, 200.0]), (2000.0, [600.0, 400.0])] {
            let centre = grid_centre(&head, Vector3::z(), depth).unwrap();
            let face = FacePose { cam_from_face: crate::pose::turned(45.0, 10.0, 0.0), centre, half };
            for _ in 0..300 {
                let motion = Motion::of_hand(&mut rng);
                let turn = Rotation3::new(motion.rotation_rad);
                for corner in face.corners() {
                    let (on, off) =
                        (px_of(&head, &corner), px_of(&head, &(turn * corner + motion.translation_mm)));
                    let (on, off) = (on.unwrap(), off.unwrap());
                    all.push((on.u - off.u).hypot(on.v - off.v));
                }
            }
        }
        all.sort_by(f64::total_cmp);
        let share = |s: f64| all[(s * all.len() as f64) as usize];
        assert!((5.0..9.0).contains(&share(0.5)), "median {} px", share(0.5));
        assert!(share(0.05) > 1.0 && share(0.95) < 19.0, "{} to {} px", share(0.05), share(0.95));
    }

    #[test]
    fn the_moved_view_sees_points_where_the_transform_puts_them() {
        let view = View {
            cam_from_world: crate::pose::turned(40.0, 25.0, 70.0),
            camera_mm: Vector3::new(100.0, -900.0, 700.0),
            face: 3,
            exposure: 0.8,
            bounce: None,
        };
        let motion = Motion {
            rotation_rad: Vector3::new(0.02, -0.01, 0.03),
            translation_mm: Vector3::new(3.0, -2.0, 5.0),
        };
        let world = Vector3::new(20.0, 35.0, 300.0);
        let expected = Rotation3::new(motion.rotation_rad) * view.point(world) + motion.translation_mm;
        let moved = motion.moved(&view);
        assert!((moved.point(world) - expected).norm() < 1e-9);
        assert_eq!((moved.face, moved.exposure), (3, 0.8));
        let still = Motion::still().moved(&view);
        assert_eq!((still.cam_from_world, still.camera_mm), (view.cam_from_world, view.camera_mm));
    }
}
