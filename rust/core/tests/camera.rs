//! Properties of the camera model over the whole sensor and over cameras unlike the paper's.

use boxline::frames::{Point, Ray};
use boxline::{CameraModel, Px};
use nalgebra::{Matrix2, Vector2};
use proptest::prelude::*;

fn cameras() -> impl Strategy<Value = CameraModel> {
    // The polynomial keeps a slope above 0.5 out to the corner of the sensor: beyond that no real lens goes.
    let matrix = (1800.0..3200.0, 0.98..1.02, -5.0..5.0, 1200.0..1400.0, 900.0..1100.0);
    let radial = (-0.15..0.15, -0.02..0.4);
    let paper = (matrix, radial).prop_map(|((fx, aspect, skew, cx, cy), (k1, k2))| CameraModel {
        fx,
        fy: fx * aspect,
        skew,
        cx,
        cy,
        k1,
        k2,
        ..CameraModel::PINHOLE
    });
    // Half of them are the paper's.
    (paper, any::<bool>(), -0.01..0.01, -0.01..0.01, -0.05..0.05).prop_map(|(camera, more, p1, p2, k3)| {
        if more { CameraModel { p1, p2, k3, ..camera } } else { camera }
    })
}

fn pixels() -> impl Strategy<Value = Px> {
    (-0.5..2591.5, -0.5..1943.5).prop_map(|(u, v)| Px::new(u, v))
}

proptest! {
    #[test]
    fn a_pixel_comes_back_from_its_ray(camera in cameras(), px in pixels()) {
        let back = camera.px_from_ray(&camera.ray_from_px(px)).expect("the sensor is in the camera's range");
        prop_assert!(back.distance_px(px) < 1e-9, "{back:?} for {px:?}");
    }

    #[test]
    fn a_pixel_comes_back_from_a_point_at_any_depth(camera in cameras(), px in pixels(), depth_mm in 1.0..5000.0) {
        let point = Point::from_vector(camera.ray_from_px(px).xy1 * depth_mm);
        let back = camera.px_from_point(&point).expect("in front of the camera");
        prop_assert!(back.distance_px(px) < 1e-9, "{back:?} for {px:?}");
    }

    #[test]
    fn the_jacobian_of_a_ray_is_that_of_finite_differences(camera in cameras(), px in pixels()) {
        let (ray, jacobian) = camera.ray_from_px_with_jacobian(px);
        prop_assert_eq!(ray, camera.ray_from_px(px));
        const STEP_PX: f64 = 1e-2;
        let column = |du: f64, dv: f64| {
            let ahead = camera.ray_from_px(Px::new(px.u + du, px.v + dv)).xy1;
            let behind = camera.ray_from_px(Px::new(px.u - du, px.v - dv)).xy1;
            (ahead - behind).xy() / (2.0 * STEP_PX)
        };
        let numeric = Matrix2::from_columns(&[column(STEP_PX, 0.0), column(0.0, STEP_PX)]);
        prop_assert!((jacobian - numeric).norm() < 1e-8 * jacobian.norm(), "{jacobian} for {numeric}");
    }

    #[test]
    fn the_jacobian_of_a_pixel_is_that_of_finite_differences(camera in cameras(), px in pixels()) {
        let ray = camera.ray_from_px(px);
        let (_, jacobian) = camera.px_from_ray_with_jacobian(&ray).expect("within the sensor");
        const STEP: f64 = 1e-5;
        let column = |dx: f64, dy: f64| {
            let at = |s: f64| {
                let p = camera.px_from_ray(&Ray::new(ray.xy1.x + s * dx, ray.xy1.y + s * dy)).expect("near the sensor");
                Vector2::new(p.u, p.v)
            };
            (at(STEP) - at(-STEP)) / (2.0 * STEP)
        };
        let numeric = Matrix2::from_columns(&[column(1.0, 0.0), column(0.0, 1.0)]);
        prop_assert!((jacobian - numeric).norm() < 1e-7 * jacobian.norm(), "{jacobian} for {numeric}");
    }

    /// Rays from anywhere: a pixel that leads back to the ray, or none; never a wrong one.
    #[test]
    fn a_ray_has_a_true_pixel_or_none(camera in cameras(), x in -50.0..50.0, y in -50.0..50.0) {
        let ray = Ray::new(x, y);
        if let Some(px) = camera.px_from_ray(&ray) {
            let back = camera.ray_from_px(px).xy1;
            prop_assert!((back - ray.xy1).norm() < 1e-11 * ray.xy1.norm(), "{back} for {x}, {y}");
        }
    }
}

#[test]
fn what_is_behind_the_camera_or_not_a_number_has_no_pixel() {
    let camera = CameraModel {
        fx: 2450.0,
        fy: 2450.0,
        skew: 0.0,
        cx: 1296.0,
        cy: 972.0,
        k1: -0.03,
        k2: 0.3,
        ..CameraModel::PINHOLE
    };
    for z_mm in [-1000.0, 0.0, f64::NAN] {
        assert_eq!(camera.px_from_point(&Point::new(1.0, 1.0, z_mm)), None);
    }
    for x in [f64::NAN, f64::INFINITY, 1e200] {
        assert_eq!(camera.px_from_ray(&Ray::new(x, 0.0)), None);
    }
}

#[test]
fn a_ray_beyond_the_fold_of_the_distortion_has_no_pixel() {
    // rho (1 - 0.3 rho^2) is at most 0.703: no pixel sees farther out.
    let camera = CameraModel {
        fx: 1000.0,
        fy: 1000.0,
        skew: 0.0,
        cx: 0.0,
        cy: 0.0,
        k1: -0.3,
        k2: 0.0,
        ..CameraModel::PINHOLE
    };
    assert!(camera.px_from_ray(&Ray::new(0.5, 0.4)).is_some());
    assert_eq!(camera.px_from_ray(&Ray::new(0.71, 0.0)), None);
}
