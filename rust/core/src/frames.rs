//! Frames of reference as types, so that a point in the camera frame cannot be taken for one on the face.
//!
//! ```compile_fail
//! use boxline::frames::{Cam, Face, Point};
//! let on_face: Point<Face> = Point::<Cam>::new(0.0, 0.0, 1.0); // another frame: does not compile
//! ```

use nalgebra::{Matrix3, Vector3};
use std::marker::PhantomData;

/// Camera frame: x right, y down, z forward, origin at the centre of projection, mm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cam;
/// Frame of a box face: origin at its centre, x along the length, y along the width, z away from the camera, mm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Face;

/// A position in mm in the frame `F`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point<F> {
    /// Coordinates in mm.
    pub mm: Vector3<f64>,
    frame: PhantomData<F>,
}

impl<F> Point<F> {
    /// A point from its coordinates in mm.
    #[must_use]
    pub fn new(x_mm: f64, y_mm: f64, z_mm: f64) -> Self {
        Self::from_vector(Vector3::new(x_mm, y_mm, z_mm))
    }

    /// A point from a vector of mm.
    #[must_use]
    pub fn from_vector(mm: Vector3<f64>) -> Self {
        Self { mm, frame: PhantomData }
    }

    /// Distance between two points of the same frame, mm.
    #[must_use]
    pub fn distance_mm(&self, other: &Self) -> f64 {
        (self.mm - other.mm).norm()
    }
}

/// An ideal (undistorted) ray through the camera's centre in inverse-depth form: (x, y, 1) in the frame `F`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray<F> {
    /// (x, y, 1).
    pub xy1: Vector3<f64>,
    frame: PhantomData<F>,
}

impl<F> Ray<F> {
    /// The ray through (x, y, 1).
    #[must_use]
    pub fn new(x: f64, y: f64) -> Self {
        Self { xy1: Vector3::new(x, y, 1.0), frame: PhantomData }
    }
}

/// A plane `p . X = 1` in the frame `F`; `p` is normal / distance in 1/mm. Then the inverse depth of a ray on it is
/// `p . (x, y, 1)`: everything that the lasers see is linear in `p`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane<F> {
    /// normal / distance, 1/mm.
    pub per_mm: Vector3<f64>,
    frame: PhantomData<F>,
}

impl<F> Plane<F> {
    /// The plane `p . X = 1`.
    #[must_use]
    pub fn new(per_mm: Vector3<f64>) -> Self {
        Self { per_mm, frame: PhantomData }
    }

    /// Inverse depth (1/mm) of a ray where it meets the plane; not positive if it never does.
    #[must_use]
    pub fn inverse_depth_per_mm(&self, ray: &Ray<F>) -> f64 {
        self.per_mm.dot(&ray.xy1)
    }

    /// Where the ray meets the plane, if it does so in front of the origin.
    #[must_use]
    pub fn intersect(&self, ray: &Ray<F>) -> Option<Point<F>> {
        let w = self.inverse_depth_per_mm(ray);
        (w > 1e-9).then(|| Point::from_vector(ray.xy1 / w))
    }

    /// Unit normal, pointing away from the origin, and the distance from it in mm.
    #[must_use]
    pub fn normal_and_distance_mm(&self) -> (Vector3<f64>, f64) {
        let norm = self.per_mm.norm();
        (self.per_mm / norm, 1.0 / norm)
    }
}

/// A rigid motion that takes points of `From` to `To`: `p_to = R p_from + t`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose<To, From> {
    /// Rotation matrix R.
    pub rotation: Matrix3<f64>,
    /// Translation t in mm.
    pub translation_mm: Vector3<f64>,
    frames: PhantomData<(To, From)>,
}

impl<To, From> Pose<To, From> {
    /// A pose from rotation and translation.
    #[must_use]
    pub fn new(rotation: Matrix3<f64>, translation_mm: Vector3<f64>) -> Self {
        Self { rotation, translation_mm, frames: PhantomData }
    }

    /// Takes a point from `From` to `To`.
    #[must_use]
    pub fn transform(&self, point: &Point<From>) -> Point<To> {
        Point::from_vector(self.rotation * point.mm + self.translation_mm)
    }

    /// The inverse motion.
    #[must_use]
    pub fn inverse(&self) -> Pose<From, To> {
        let r = self.rotation.transpose();
        Pose::new(r, -(r * self.translation_mm))
    }
}

impl<A, B, C> std::ops::Mul<Pose<B, C>> for Pose<A, B> {
    type Output = Pose<A, C>;

    fn mul(self, other: Pose<B, C>) -> Pose<A, C> {
        Pose::new(self.rotation * other.rotation, self.rotation * other.translation_mm + self.translation_mm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;
    use proptest::prelude::*;

    fn vectors() -> impl Strategy<Value = Vector3<f64>> {
        [-2000.0..2000.0, -2000.0..2000.0, -2000.0..2000.0]
            .prop_map(|[x, y, z]: [f64; 3]| Vector3::new(x, y, z))
    }

    fn poses<To: std::fmt::Debug, From: std::fmt::Debug>() -> impl Strategy<Value = Pose<To, From>> {
        ([-3.0..3.0, -3.0..3.0, -3.0..3.0], vectors()).prop_map(|([x, y, z], t): ([f64; 3], _)| {
            Pose::new(*Rotation3::new(Vector3::new(x, y, z)).matrix(), t)
        })
    }

    proptest! {
        #[test]
        fn a_pose_and_its_inverse_lead_back(cam_from_face in poses::<Cam, Face>(), p in vectors()) {
            let in_face = Point::<Face>::from_vector(p);
            let back = cam_from_face.inverse().transform(&cam_from_face.transform(&in_face));
            prop_assert!(back.distance_mm(&in_face) < 1e-9);
            let nothing = cam_from_face * cam_from_face.inverse();
            prop_assert!((nothing.rotation - Matrix3::identity()).norm() < 1e-12);
            prop_assert!(nothing.translation_mm.norm() < 1e-9);
        }

        #[test]
        fn poses_chain_as_their_names_read(
            cam_from_face in poses::<Cam, Face>(),
            face_from_cam in poses::<Face, Cam>(),
            p in vectors(),
        ) {
            let in_cam = Point::<Cam>::from_vector(p);
            let at_once = (cam_from_face * face_from_cam).transform(&in_cam);
            let in_steps = cam_from_face.transform(&face_from_cam.transform(&in_cam));
            prop_assert!(at_once.distance_mm(&in_steps) < 1e-9);
        }

        #[test]
        fn a_pose_keeps_distances(cam_from_face in poses::<Cam, Face>(), p in vectors(), q in vectors()) {
            let (p, q) = (Point::<Face>::from_vector(p), Point::<Face>::from_vector(q));
            let moved = cam_from_face.transform(&p).distance_mm(&cam_from_face.transform(&q));
            prop_assert!((moved - p.distance_mm(&q)).abs() < 1e-9);
        }

        #[test]
        fn a_ray_meets_a_plane_on_the_plane_and_on_the_ray(
            normal in vectors(),
            distance_mm in 100.0..5000.0f64,
            x in -0.6..0.6,
            y in -0.6..0.6,
        ) {
            prop_assume!(normal.norm() > 1.0);
            let plane = Plane::<Cam>::new(normal.normalize() / distance_mm);
            let ray = Ray::new(x, y);
            match plane.intersect(&ray) {
                Some(point) => {
                    prop_assert!(point.mm.z > 0.0);
                    prop_assert!((plane.per_mm.dot(&point.mm) - 1.0).abs() < 1e-9);
                    prop_assert!(point.mm.cross(&ray.xy1).norm() < 1e-9 * point.mm.norm());
                }
                None => prop_assert!(plane.inverse_depth_per_mm(&ray) <= 1e-9),
            }
            let (unit, distance) = plane.normal_and_distance_mm();
            prop_assert!((unit.norm() - 1.0).abs() < 1e-12 && (distance - distance_mm).abs() < 1e-9);
        }
    }

    #[test]
    fn a_ray_that_is_parallel_or_turned_away_meets_nothing() {
        let wall = Plane::<Cam>::new(Vector3::new(1e-3, 0.0, 0.0)); // x = 1000 mm
        assert_eq!(wall.intersect(&Ray::new(0.0, 0.3)), None);
        assert_eq!(wall.intersect(&Ray::new(-0.2, 0.3)), None);
        assert_eq!(wall.intersect(&Ray::new(0.5, 0.0)), Some(Point::new(1000.0, 0.0, 2000.0)));
    }
}
