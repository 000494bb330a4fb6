//! Two-dimensional coordinates on a face's plane in mm, and the way to the sensor and back.

use crate::calibration::Calibration;
use crate::frames::{Cam, Plane, Point, Ray};
use crate::units::Px;
use nalgebra::{Vector2, Vector3};

/// A position on the plane: `a` along the first axis, `b` along the second, mm.
pub(crate) type OnPlane = Vector2<f64>;

/// A right-angled raster on a plane. Axis a is roughly the direction of stripes 1 and 2, b that of 3 and 4.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlaneRaster {
    pub plane: Plane<Cam>,
    pub(super) origin: Vector3<f64>,
    pub(super) axis_a: Vector3<f64>,
    pub(super) axis_b: Vector3<f64>,
}

impl PlaneRaster {
    /// A raster with its origin where the pixel `at` sees the plane and axis a towards the pixel `towards`.
    pub fn new(calibration: &Calibration, plane: &Plane<Cam>, at: Px, towards: Px) -> Option<Self> {
        let origin = plane.intersect(&calibration.camera().ray_from_px(at))?.mm;
        let second = plane.intersect(&calibration.camera().ray_from_px(towards))?.mm;
        let (normal, _) = plane.normal_and_distance_mm();
        let axis_a = (second - origin).try_normalize(1e-9)?;
        Some(Self { plane: *plane, origin, axis_a, axis_b: normal.cross(&axis_a) })
    }

    /// A raster with its origin at a point of the plane and axis a along a direction, both in the camera frame.
    pub fn along(plane: &Plane<Cam>, origin: Vector3<f64>, direction: &Vector3<f64>) -> Option<Self> {
        let (normal, _) = plane.normal_and_distance_mm();
        let axis_a = (direction - normal * normal.dot(direction)).try_normalize(1e-9)?;
        Some(Self { plane: *plane, origin, axis_a, axis_b: normal.cross(&axis_a) })
    }

    /// The same raster turned by `angle_rad` about its origin.
    pub fn turned(&self, angle_rad: f64) -> Self {
        let (s, c) = angle_rad.sin_cos();
        Self { axis_a: self.axis_a * c + self.axis_b * s, axis_b: self.axis_b * c - self.axis_a * s, ..*self }
    }

    /// The raster on a plane a little different: same pixel at the origin, same direction.
    pub fn on(&self, plane: &Plane<Cam>) -> Self {
        let (normal, _) = plane.normal_and_distance_mm();
        let along = self.origin * (1.0 / plane.per_mm.dot(&self.origin));
        let axis_a = (self.axis_a - normal * normal.dot(&self.axis_a)).normalize();
        Self { plane: *plane, origin: along, axis_a, axis_b: normal.cross(&axis_a) }
    }

    /// Where a pixel sees the plane.
    pub fn on_plane(&self, calibration: &Calibration, px: Px) -> Option<OnPlane> {
        self.of_ray(&calibration.camera().ray_from_px(px))
    }

    /// Where a ray meets the plane.
    pub fn of_ray(&self, ray: &Ray<Cam>) -> Option<OnPlane> {
        Some(self.of_cam(&self.plane.intersect(ray)?))
    }

    /// Coordinates of a point of the plane.
    pub fn of_cam(&self, point: &Point<Cam>) -> OnPlane {
        let p = point.mm - self.origin;
        OnPlane::new(p.dot(&self.axis_a), p.dot(&self.axis_b))
    }

    /// The point in the camera frame.
    pub fn cam_point(&self, at: OnPlane) -> Point<Cam> {
        Point::from_vector(self.origin + self.axis_a * at.x + self.axis_b * at.y)
    }

    /// The pixel of a point of the plane.
    pub fn pixel(&self, calibration: &Calibration, at: OnPlane) -> Option<Px> {
        calibration.camera().px_from_point(&self.cam_point(at))
    }

    /// Size of a pixel on the plane around `at`, mm (geometric mean of both directions).
    pub fn mm_per_px(&self, calibration: &Calibration, at: OnPlane) -> Option<f64> {
        let p = self.pixel(calibration, at)?;
        let q = self.pixel(calibration, at + OnPlane::new(1.0, 0.0))?;
        let r = self.pixel(calibration, at + OnPlane::new(0.0, 1.0))?;
        let area = ((q.u - p.u) * (r.v - p.v) - (q.v - p.v) * (r.u - p.u)).abs();
        (area > 1e-9).then(|| 1.0 / area.sqrt())
    }
}
