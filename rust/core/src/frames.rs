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
