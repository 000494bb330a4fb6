//! The same scene through another camera: mirrored, upside down, on its side, with other laser numbers. Pixels, camera and
//! laser planes change together, the box does not. What the code takes for granted about directions fails here.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::{
    Calibration, CameraModel, Estimate, FaceOutcome, Frame, LaserId, Reject, Settings, measure_face,
};
use boxline_tests::{Recorded, shipped};

/// A side may move by this many of its own sigmas. Most move by less than 0.1 mm; where two edges compete for a side, a tie
/// may fall the other way.
const LIMIT_SIGMAS: f64 = 3.0;

/// New pixel (x, y) shows old pixel `from(x, y)`.
fn moved(frame: &Frame, width: usize, height: usize, from: impl Fn(usize, usize) -> (usize, usize)) -> Frame {
    let mut rgb = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        for x in 0..width {
            let (u, v) = from(x, y);
            let i = (v * frame.width_px() + u) * 3;
            rgb.extend_from_slice(&frame.rgb()[i..i + 3]);
        }
    }
    Frame::from_rgb(width, height, rgb).unwrap()
}

fn planes(calibration: &Calibration, sign_x: f64, sign_y: f64) -> [[f64; 4]; 4] {
    LaserId::ALL.map(|id| {
        let p = calibration.laser(id).per_mm;
        [sign_x * p.x, sign_y * p.y, p.z, -1.0]
    })
}

/// The scene mirrored left to right, top to bottom, or both (the camera upside down).
fn flipped(frame: &Frame, calibration: &Calibration, x: bool, y: bool) -> (Frame, Calibration) {
    let (w, h) = (frame.width_px(), frame.height_px());
    let image = moved(frame, w, h, |u, v| (if x { w - 1 - u } else { u }, if y { h - 1 - v } else { v }));
    let c = *calibration.camera();
    let camera = CameraModel {
        cx: if x { w as f64 - 1.0 - c.cx } else { c.cx },
        cy: if y { h as f64 - 1.0 - c.cy } else { c.cy },
        skew: if x != y { -c.skew } else { c.skew },
        p1: if y { -c.p1 } else { c.p1 },
        p2: if x { -c.p2 } else { c.p2 },
        ..c
    };
    let sign = |flip: bool| if flip { -1.0 } else { 1.0 };
    let planes = planes(calibration, sign(x), sign(y));
    (image, Calibration::new("flipped", [w as u32, h as u32], camera, planes).unwrap())
}

/// Rows and columns exchanged: a portrait sensor.
fn transposed(frame: &Frame, calibration: &Calibration) -> (Frame, Calibration) {
    let (w, h) = (frame.width_px(), frame.height_px());
    let image = moved(frame, h, w, |u, v| (v, u));
    let c = *calibration.camera();
    assert_eq!(c.skew, 0.0);
    let camera = CameraModel { fx: c.fy, fy: c.fx, cx: c.cy, cy: c.cx, p1: c.p2, p2: c.p1, ..c };
    let planes = LaserId::ALL.map(|id| {
        let p = calibration.laser(id).per_mm;
        [p.y, p.x, p.z, -1.0]
    });
    (image, Calibration::new("transposed", [h as u32, w as u32], camera, planes).unwrap())
}

/// The pairs exchanged: 3, 4, 1, 2.
fn renumbered(frame: &Frame, calibration: &Calibration) -> (Frame, Calibration) {
    let [p1, p2, p3, p4] = planes(calibration, 1.0, 1.0);
    let size = [calibration.width_px(), calibration.height_px()];
    let calibration = Calibration::new("renumbered", size, *calibration.camera(), [p3, p4, p1, p2]).unwrap();
    (frame.clone(), calibration)
}

fn sides(frame: &Frame, calibration: &Calibration) -> Result<[Estimate; 2], Reject> {
    let any_confidence = Settings { least_confidence: 0.0, ..shipped() };
    match measure_face(frame, calibration, &any_confidence).unwrap().outcome {
        FaceOutcome::Measured(face) => Ok([face.length, face.width]),
        FaceOutcome::Rejected(reject) => Err(reject),
    }
}

fn check(name: &str) {
    let recorded = Recorded::read(name);
    let mut wrong = Vec::new();
    for id in ["a", "b"] {
        let (frame, calibration) = (recorded.frame(id), &recorded.calibration);
        let straight = sides(&frame, calibration).unwrap();
        for (way, (image, other)) in [
            ("left to right", flipped(&frame, calibration, true, false)),
            ("top to bottom", flipped(&frame, calibration, false, true)),
            ("upside down", flipped(&frame, calibration, true, true)),
            ("transposed", transposed(&frame, calibration)),
            ("renumbered", renumbered(&frame, calibration)),
        ] {
            let what = format!("{name} {id}, {way}");
            let found = match sides(&image, &other) {
                Ok(found) => found,
                // The network has never seen a portrait picture: it may see no face there.
                Err(Reject::OutlineUnsure { .. }) if way == "transposed" => continue,
                Err(reject) => panic!("{what}: {reject}"),
            };
            for (f, s) in found.into_iter().zip(straight) {
                let (found, straight) = (f.value_mm, s.value_mm);
                if (found - straight).abs() > LIMIT_SIGMAS * s.sigma_mm {
                    wrong.push(format!("{what}: {found:.2} mm, as recorded {straight:.2} mm"));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn mirrored_b02() {
    check("b02");
}

#[test]
fn mirrored_b03() {
    check("b03");
}

#[test]
fn mirrored_b06() {
    check("b06");
}
