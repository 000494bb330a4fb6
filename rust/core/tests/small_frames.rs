//! Frames that show nothing, on sensors of any size: a refusal or, at worst, a measurement with finite numbers; no panic.

use boxline::frames::Plane;
use boxline::{
    Calibration, CameraModel, EdgeMethod, ErrorKind, FaceOutcome, Frame, LaserId, Method, Px, Settings,
    measure_box, measure_face,
};
use nalgebra::Vector3;
use proptest::prelude::*;

const LASERS: [[f64; 3]; 4] = [
    [0.0079291, -0.00817394, 0.00018065],
    [0.01078476, -0.01121147, 0.00223845],
    [0.01037354, 0.00959161, 0.00170705],
    [0.00799885, 0.00730513, -0.00038506],
];

/// The paper's head on a sensor of another size: same view, other pixels.
fn head(width: usize, height: usize) -> Calibration {
    let (sx, sy) = (width as f64 / 2592.0, height as f64 / 1944.0);
    let camera = CameraModel {
        fx: 2458.9172 * sx,
        fy: 2453.81 * sy,
        skew: 0.0,
        cx: (1239.5188 + 0.5) * sx - 0.5,
        cy: (1032.559 + 0.5) * sy - 0.5,
        k1: -0.03415937,
        k2: 0.321070446,
        ..CameraModel::PINHOLE
    };
    let planes = LASERS.map(|[a, b, c]| [a, b, c, -1.0]);
    Calibration::new("test", [width as u32, height as u32], camera, planes).expect("a valid head")
}

fn all_settings() -> [Settings<'static>; 4] {
    let settings = |method, edges| Settings { method, edges, ..Settings::default() };
    [
        settings(Method::Fit, EdgeMethod::Gradient),
        settings(Method::Fit, EdgeMethod::Hough),
        settings(Method::Keypoints, EdgeMethod::Gradient),
        settings(Method::Keypoints, EdgeMethod::Hough),
    ]
}

/// Measures in every way; what is measured must be finite.
fn check(frame: &Frame, calibration: &Calibration) -> Result<(), TestCaseError> {
    for settings in all_settings() {
        match measure_face(frame, calibration, &settings).map(|report| report.outcome) {
            Ok(FaceOutcome::Measured(face)) => {
                for side in [face.length, face.width] {
                    prop_assert!(side.value_mm.is_finite() && side.value_mm > 0.0, "{side:?}");
                    prop_assert!(side.sigma_mm.is_finite() && side.sigma_mm > 0.0, "{side:?}");
                }
            }
            Ok(FaceOutcome::Rejected(reject)) => {
                prop_assert!(reject.numbers().iter().all(|(_, x)| x.is_finite()), "{reject:?}");
            }
            Err(e) => prop_assert!(false, "{e}"),
        }
    }
    Ok(())
}

fn noise(width: usize, height: usize, seed: u32) -> Vec<u8> {
    let mut random = fastrand::Rng::with_seed(seed.into());
    (0..width * height * 3).map(|_| random.u8(..)).collect()
}

/// Paints what the four lasers light on a plane, without end: a wall.
fn paint_wall(
    rgb: &mut [u8],
    calibration: &Calibration,
    plane: &Plane<boxline::frames::Cam>,
    half_width_px: f64,
) {
    let width = calibration.width_px() as usize;
    for (i, pixel) in rgb.chunks_exact_mut(3).enumerate() {
        let px = Px::new((i % width) as f64, (i / width) as f64);
        let (ray, jacobian) = calibration.camera().ray_from_px_with_jacobian(px);
        for id in LaserId::ALL {
            let line = plane.per_mm - calibration.laser(id).per_mm;
            let distance_px = line.dot(&ray.xy1) / (jacobian.transpose() * line.xy()).norm();
            let light = 200.0 * (-0.5 * (2.0 * distance_px / half_width_px).powi(2)).exp();
            pixel[0] = (f64::from(pixel[0]) + light).min(255.0) as u8;
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn noise_of_any_size_is_judged(width in 64..240usize, height in 64..240usize, seed: u32) {
        let frame = Frame::from_rgb(width, height, noise(width, height, seed)).expect("the size fits");
        check(&frame, &head(width, height))?;
    }

    #[test]
    fn a_wall_with_noise_is_judged(
        width in 64..480usize, height in 64..360usize, seed: u32, tilt in (-0.8..0.8, -0.8..0.8), depth_mm in 250.0..3500.0,
        half_width_px in 2.0..12.0, quiet in 1..200u8
    ) {
        let calibration = head(width, height);
        let mut rgb = noise(width, height, seed);
        rgb.iter_mut().for_each(|x| *x /= quiet);
        let plane = Plane::new(Vector3::new(tilt.0, tilt.1, 1.0) / depth_mm);
        paint_wall(&mut rgb, &calibration, &plane, half_width_px);
        let frame = Frame::from_rgb(width, height, rgb).expect("the size fits");
        check(&frame, &calibration)?;
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]
    #[test]
    fn random_pixels_at_160_x_120_are_refused(rgb in prop::collection::vec(any::<u8>(), 160 * 120 * 3)) {
        let frame = Frame::from_rgb(160, 120, rgb).expect("the size fits");
        let outcome = measure_face(&frame, &head(160, 120), &Settings::default()).map(|report| report.outcome);
        prop_assert!(matches!(outcome, Ok(FaceOutcome::Rejected(_))), "{outcome:?}");
    }
}

#[test]
fn plain_frames_are_refused() {
    for (width, height) in [(64, 64), (160, 120), (65, 321), (648, 486)] {
        for grey in [0, 128, 255] {
            let frame =
                Frame::from_rgb(width, height, vec![grey; width * height * 3]).expect("the size fits");
            let outcome =
                measure_face(&frame, &head(width, height), &Settings::default()).map(|report| report.outcome);
            assert!(
                matches!(outcome, Ok(FaceOutcome::Rejected(_))),
                "{width} x {height}, {grey}: {outcome:?}"
            );
        }
    }
}

#[test]
fn a_frame_of_another_size_is_an_error_that_names_both() {
    let calibration = head(640, 480);
    let right = Frame::from_rgb(640, 480, vec![0; 640 * 480 * 3]).expect("the size fits");
    for (width, height) in [(1, 1), (3, 2), (64, 64), (480, 640)] {
        let wrong = Frame::from_rgb(width, height, vec![0; width * height * 3]).expect("the size fits");
        for (a, b) in [(&wrong, &right), (&right, &wrong)] {
            let error = measure_box(&[a, b], &calibration, &Settings::default()).expect_err("sizes differ");
            assert_eq!(error.kind(), ErrorKind::CalibrationMismatch);
            let text = error.to_string();
            assert!(text.contains(&format!("{width} x {height}")) && text.contains("640 x 480"), "{text}");
        }
    }
}

#[test]
fn pixels_that_do_not_fit_the_size_are_an_error() {
    for (width, height, bytes) in [(0, 1, 0), (1, 0, 0), (2, 2, 11), (2, 2, 13), (20_000, 1, 60_000)] {
        let error = Frame::from_rgb(width, height, vec![0; bytes]).expect_err("the size does not fit");
        assert_eq!(error.kind(), ErrorKind::InvalidFrame);
    }
}

/// Any bytes give a frame or an error.
#[test]
fn broken_jpegs_are_errors() {
    for bytes in [&b""[..], b"\xff", b"\xff\xd8", b"\xff\xd8\xff\xd9", b"not a jpeg", &[0xff; 4096]] {
        let error = Frame::from_jpeg(bytes).expect_err("no JPEG");
        assert_eq!(error.kind(), ErrorKind::InvalidFrame);
    }
}

/// Numbers of any size, most of them ordinary.
fn numbers() -> impl Strategy<Value = f64> {
    let special = vec![0.0, 1.0, -1.0, 1e-300, 1e300, f64::NAN, f64::INFINITY];
    prop_oneof![8 => -0.02..0.02f64, 1 => prop::sample::select(special), 1 => any::<f64>()]
}

/// The head's laser planes with one or two numbers replaced.
fn strange_planes() -> impl Strategy<Value = [[f64; 3]; 4]> {
    prop::collection::vec((0..4usize, 0..3usize, numbers()), 1..3).prop_map(|changes| {
        let mut planes = LASERS;
        for (plane, number, value) in changes {
            planes[plane][number] = value;
        }
        planes
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    /// Whatever a calibration file holds: an error that names it, or a head with which frames can be judged.
    #[test]
    fn a_strange_calibration_is_an_error_or_does_no_harm(
        planes in strange_planes(),
        focal in prop_oneof![Just(60.0), 1.0..600.0f64, prop::sample::select(vec![f64::NAN, 0.0, -60.0])],
        distortion in [prop_oneof![-0.5..0.5f64, -1e9..1e9], prop_oneof![-0.5..0.5f64, -1e9..1e9]],
        centre in prop_oneof![-100.0..200.0f64, -1e9..1e9],
        seed: u32
    ) {
        let camera = CameraModel {
            fx: focal,
            fy: focal,
            skew: 0.0,
            cx: centre,
            cy: 32.0,
            k1: distortion[0],
            k2: distortion[1],
            ..CameraModel::PINHOLE
        };
        let planes = planes.map(|[a, b, c]| [a, b, c, -1.0]);
        if let Ok(calibration) = Calibration::new("strange", [96, 64], camera, planes) {
            let frame = Frame::from_rgb(96, 64, noise(96, 64, seed)).expect("the size fits");
            check(&frame, &calibration)?;
        }
    }
}

/// Laser planes whose pairs cross in space but whose stripes are parallel in the image.
#[test]
fn pairs_that_only_cross_in_depth_do_no_harm() {
    let camera = CameraModel {
        fx: 90.0,
        fy: 90.0,
        skew: 0.0,
        cx: 48.0,
        cy: 32.0,
        k1: 0.0,
        k2: 0.0,
        ..CameraModel::PINHOLE
    };
    let planes =
        [[0.01, 0.0, 0.0, -1.0], [0.012, 0.0, 0.0, -1.0], [0.01, 0.0, 0.02, -1.0], [0.008, 0.0, 0.02, -1.0]];
    if let Ok(calibration) = Calibration::new("flat", [96, 64], camera, planes) {
        let frame = Frame::from_rgb(96, 64, noise(96, 64, 1)).expect("the size fits");
        check(&frame, &calibration).expect("judged");
    }
}
