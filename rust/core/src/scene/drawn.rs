//! Pictures of a face under four stripes, for tests.

use crate::calibration::Calibration;
use crate::edges::linear_light;
use crate::face::raster::{OnPlane, PlaneRaster};
use crate::frames::{Cam, Plane};
use crate::image::Frame;
use crate::paper_head::paper_head;
use crate::units::Px;
use nalgebra::Vector3;

pub(crate) const DISTANCE_MM: f64 = 900.0;
/// Linear red of unpainted board, and what a stripe's middle adds to it as a share of it; of 255.
const BOARD: f64 = 26.0;
const STRIPE: f64 = 3.0;
/// Standard deviation of a stripe across it, px.
const STRIPE_PX: f64 = 2.8;

/// The face, square to the camera.
pub(crate) fn face() -> (Calibration, PlaneRaster) {
    let calibration = paper_head(1.0);
    let plane = Plane::new(Vector3::z() / DISTANCE_MM);
    let raster = PlaneRaster::along(&plane, Vector3::z() * DISTANCE_MM, &Vector3::new(1.0, 1.0, 0.0));
    (calibration, raster.expect("a direction along the plane"))
}

/// What a pixel sees: the surface that the lasers light, if there is one, and how bright its paint is.
pub(crate) struct Surface {
    pub on: Option<Plane<Cam>>,
    pub paint: f64,
}

/// A picture of [`face`]; each pixel is told where it sees the face's plane.
pub(crate) fn drawn(seen: impl Fn(OnPlane) -> Surface) -> Frame {
    let (calibration, raster) = face();
    drawn_on(&calibration, &raster, seen)
}

/// The same of a face on another plane.
pub(crate) fn drawn_on(
    calibration: &Calibration,
    raster: &PlaneRaster,
    seen: impl Fn(OnPlane) -> Surface,
) -> Frame {
    let [width, height] = [calibration.width_px() as usize, calibration.height_px() as usize];
    let mut rgb = vec![0u8; 3 * width * height];
    let level =
        |linear: f64| linear_light().partition_point(|light| f64::from(*light) < linear).min(255) as u8;
    for (n, pixel) in rgb.chunks_exact_mut(3).enumerate() {
        let (u, v) = (n % width, n / width);
        let (ray, jacobian) = calibration.camera().ray_from_px_with_jacobian(Px::new(u as f64, v as f64));
        let Some(on_face) = raster.of_ray(&ray) else { continue };
        let Surface { on, paint } = seen(on_face);
        let mut laser_light = 0.0;
        for laser in calibration.lasers().iter().filter(|_| on.is_some()) {
            let line = on.map_or_else(Vector3::zeros, |on| on.per_mm) - laser.per_mm;
            let off_px = line.dot(&ray.xy1) / (jacobian.transpose() * line.xy()).norm();
            laser_light += (-0.5 * (off_px / STRIPE_PX).powi(2)).exp();
        }
        // Some noise, so that nothing divides by none.
        let noise = (n * 7919 % 13) as f64 / 13.0 - 0.5;
        let board = paint * BOARD * (1.0 + 0.08 * noise);
        pixel.copy_from_slice(&[level(board * (1.0 + STRIPE * laser_light)), level(board), level(board)]);
    }
    Frame::from_rgb(width, height, rgb).expect("the sensor's size")
}
