//! The whole calibration on drawn frames of other heads: focal length, distortion and planes off by some per cent, uneven
//! light, blur, boards partly outside. The drawing shares the camera model with the library (`tests/opencv` does not) but
//! nothing of its detection.

use boxline::frames::{Cam, Pose};
use boxline::{CameraModel, Frame, LaserId, Px};
use boxline_calib::{
    Board, BoardView, CalibrationReject, CalibrationSettings, CalibrationSolution, FrameReject, OnBoard,
    empty_corners, find_board, solve_all, solve_camera,
};
use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};

const WIDTH: usize = 1296;
const HEIGHT: usize = 972;
const BOARD: Board = Board { columns: 12, rows: 11, pitch_mm: 100.0, diameter_mm: 50.0 };

/// The same frames on every machine.
struct Random(fastrand::Rng);

impl Random {
    fn new(seed: u64) -> Self {
        Self(fastrand::Rng::with_seed(seed))
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.f64()
    }
}

/// All four lasers on.
const ALL_ON: [bool; 4] = [true; 4];

struct Head {
    camera: CameraModel,
    planes: [Vector3<f64>; 4],
}

impl Head {
    /// Half the pixels of the paper's head, everything off by up to 3 %.
    fn new(random: &mut Random) -> Self {
        let mut off = |value: f64| value * random.between(0.97, 1.03);
        let f = off(1229.0);
        Self {
            camera: CameraModel {
                fx: f,
                fy: f * 0.998,
                skew: 0.0,
                cx: off(619.5),
                cy: off(515.8),
                k1: off(-0.034),
                k2: off(0.32),
                ..CameraModel::PINHOLE
            },
            planes: [
                Vector3::new(off(0.0079), off(-0.0082), 0.0002),
                Vector3::new(off(0.0108), off(-0.0112), off(0.0022)),
                Vector3::new(off(0.0104), off(0.0096), off(0.0017)),
                Vector3::new(off(0.0080), off(0.0073), -0.0004),
            ],
        }
    }

    fn draw(&self, pose: &Pose<Cam, OnBoard>, on: [bool; 4], blur_px: f64, random: &mut Random) -> Frame {
        let m = Matrix3::from_columns(&[
            pose.rotation.column(0).into(),
            pose.rotation.column(1).into(),
            pose.translation_mm,
        ]);
        let to_board = m.try_inverse().expect("in front");
        let normal: Vector3<f64> = pose.rotation.column(2).into();
        let q = normal / normal.dot(&pose.translation_mm);
        let slope = Vector2::new(random.between(-0.3, 0.3), random.between(-0.3, 0.3));
        let mut rgb = vec![0u8; WIDTH * HEIGHT * 3];
        for (i, pixel) in rgb.chunks_exact_mut(3).enumerate() {
            let at = Px::new((i % WIDTH) as f64, (i / WIDTH) as f64);
            let (ray, jacobian) = self.camera.ray_from_px_with_jacobian(at);
            let p = to_board * ray.xy1;
            let on_board = p.xy() / p.z;
            // px per mm from the determinant; distance from a rim in px decides how much of the pixel is white.
            let px_per_mm = {
                let step = self.camera.ray_from_px(Px::new(at.u + 1.0, at.v)).xy1;
                let n = to_board * step;
                1.0 / (n.xy() / n.z - on_board).norm()
            };
            let inside = on_board.x.abs() < 650.0 && on_board.y.abs() < 600.0;
            let reflectance = if inside {
                let rim_px = BOARD.from_rim_mm(on_board) * px_per_mm;
                let circle = on_board.x.abs() < 580.0 && on_board.y.abs() < 530.0;
                let white = if circle { 1.0 / (1.0 + (-rim_px / (0.45 * blur_px)).exp()) } else { 1.0 };
                0.04 + 0.7 * white
            } else {
                0.15 + 0.1 * (((on_board.x / 90.0).floor() + (on_board.y / 140.0).floor()).rem_euclid(2.0))
            };
            let light = 1.0 + slope.x * (at.u / WIDTH as f64 - 0.5) + slope.y * (at.v / HEIGHT as f64 - 0.5);
            let mut laser = 0.0;
            for (plane, _) in self.planes.iter().zip(on).filter(|(_, on)| *on) {
                let line = q - plane;
                let distance_px = line.dot(&ray.xy1) / (jacobian.transpose() * line.xy()).norm();
                laser += (-0.5 * (distance_px / 1.8).powi(2)).exp();
            }
            let grey = 0.55 * light * reflectance;
            let encode = |x: f64| 255.0 * x.clamp(0.0, 1.0).powf(1.0 / 2.2) + random_noise(i, at);
            let red = grey + 0.5 * reflectance * laser;
            pixel[0] = encode(red).round() as u8;
            pixel[1] = encode(grey + 0.02 * reflectance * laser).round() as u8;
            pixel[2] = encode(grey + 0.01 * reflectance * laser).round() as u8;
        }
        Frame::from_rgb(WIDTH, HEIGHT, rgb).expect("the size fits")
    }
}

/// A hash of the place: one grey level of noise that needs no state.
fn random_noise(i: usize, at: Px) -> f64 {
    let h = (i as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (at.u.to_bits() >> 13);
    ((h ^ (h >> 31)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 40) as f64 / (1u64 << 24) as f64 * 2.0 - 1.0
}

/// Tilted up to 40 degrees, from 0.8 to 2 m, near ones partly outside.
fn poses(random: &mut Random, count: usize) -> Vec<Pose<Cam, OnBoard>> {
    let face_us = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    (0..count)
        .map(|i| {
            let tilt = random.between(0.1, 0.7);
            let about = random.between(0.0, std::f64::consts::TAU);
            let axis = nalgebra::Unit::new_normalize(Vector3::new(about.cos(), about.sin(), 0.0));
            let roll = Rotation3::from_axis_angle(&Vector3::z_axis(), random.between(-0.6, 0.6));
            let turn = Rotation3::from_axis_angle(&axis, tilt) * roll * face_us;
            let depth = 800.0 + 1200.0 * i as f64 / count as f64;
            Pose::new(
                turn.into_inner(),
                Vector3::new(random.between(-120.0, 120.0), random.between(-90.0, 90.0), depth),
            )
        })
        .collect()
}

fn calibrate(frames: &[Frame], board: &Board) -> Result<CalibrationSolution, CalibrationReject> {
    let found: Vec<_> = frames.iter().map(|f| (f, find_board(f, board))).collect();
    let (frames, views): (Vec<&Frame>, Vec<_>) =
        found.into_iter().filter_map(|(f, view)| Some((f, view.ok()?))).unzip();
    let camera = solve_camera(views, board, CalibrationSettings::default())?;
    let stripes: Vec<_> = frames.iter().enumerate().map(|(i, f)| camera.find_stripes(i, f)).collect();
    solve_all(camera, &stripes)
}

fn drawn(seed: u64, blur_px: f64) -> (Head, Vec<Frame>) {
    let mut random = Random::new(seed);
    let head = Head::new(&mut random);
    let poses = poses(&mut random, 8);
    let frames = poses.iter().map(|pose| head.draw(pose, ALL_ON, blur_px, &mut random)).collect();
    (head, frames)
}

#[test]
fn other_heads_are_calibrated_without_a_start() {
    for (seed, blur_px) in [(11, 1.0), (12, 1.0), (13, 2.5)] {
        let (head, frames) = drawn(seed, blur_px);
        let solution = calibrate(&frames, &BOARD).unwrap_or_else(|e| panic!("seed {seed}: {e}"));
        let (found, true_camera) = (&solution.camera, &head.camera);
        for (i, (name, off)) in [
            ("fx", found.fx - true_camera.fx),
            ("fy", found.fy - true_camera.fy),
            ("cx", found.cx - true_camera.cx),
            ("cy", found.cy - true_camera.cy),
        ]
        .into_iter()
        .enumerate()
        {
            let sigma = solution.covariance[(i, i)].sqrt();
            assert!(off.abs() < 0.5, "seed {seed}: {name} is off by {off} px");
            // The drawing's one grey level of even noise and its rounding are not normal: 5 sigmas.
            assert!(off.abs() < 5.0 * sigma, "seed {seed}: {name} is off by {off} px, sigma {sigma}");
        }
        for id in LaserId::ALL {
            let (p, t) = (solution.lasers[id.index()].per_mm, head.planes[id.index()]);
            let stripes = solution.frames.iter().flat_map(|f| &f.stripes).filter(|s| s.laser == id);
            for s in stripes.filter(|s| s.used) {
                let at = solution.camera.ray_from_px(s.at).xy1 * s.depth_mm;
                let off_mm = ((t.dot(&at) - 1.0) / t.norm() - (p.dot(&at) - 1.0) / p.norm()).abs();
                let limit_mm = 0.1 * (s.depth_mm / 1000.0).powi(2).max(1.0);
                assert!(
                    off_mm < limit_mm,
                    "seed {seed}: laser {id} is off by {off_mm} mm at {} mm",
                    s.depth_mm
                );
            }
        }
        // Near frames reach at least one.
        assert!(empty_corners(&solution).len() < 4, "seed {seed}: {:?}", empty_corners(&solution));
        assert!(
            solution.centre_rms_px.iter().all(|rms| *rms < 0.1),
            "seed {seed}: {:?}",
            solution.centre_rms_px
        );
    }
}

/// The eight recorded frames.
fn recorded_views() -> Vec<BoardView> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/board");
    let view = |name: &str| {
        let bytes = std::fs::read(folder.join(format!("{name}.jpg"))).expect("a recorded frame");
        find_board(&Frame::from_jpeg(&bytes).expect("a JPEG"), &BOARD).expect("a board")
    };
    ["c01", "c03", "c05", "c09", "c13", "c19", "c21", "c25"].map(view).into()
}

#[test]
fn any_seven_of_eight_sound_frames_calibrate_and_none_is_left_out() {
    let all = recorded_views();
    for missing in 0..all.len() {
        let mut views = all.clone();
        views.remove(missing);
        let camera = solve_camera(views, &BOARD, CalibrationSettings::default())
            .unwrap_or_else(|e| panic!("without {missing}: {e}"));
        for view in 0..all.len() - 1 {
            assert_eq!(camera.reject(view), None, "without {missing}: view {view}");
        }
    }
}

/// A frame whose circles are where no camera sees them is left out, and the others give the camera that they give without it.
#[test]
fn a_frame_that_does_not_fit_is_left_out() {
    let sound = recorded_views();
    let solve = |views| {
        let camera =
            solve_camera(views, &BOARD, CalibrationSettings::default()).unwrap_or_else(|e| panic!("{e}"));
        let rejects: Vec<_> = (0..8).filter_map(|view| Some((view, camera.reject(view)?.clone()))).collect();
        (camera.alone().unwrap_or_else(|e| panic!("{e}")).camera, rejects)
    };
    for odd in [0, 4, 7] {
        let mut views = sound.clone();
        // Columns bent by up to 8 px: a board that somebody leans on.
        for circle in &mut views[odd].circles {
            let shift = 8.0 * (f64::from(circle.column) / 11.0 - 0.5).powi(2) * 4.0;
            circle.ellipse_centre.v += shift;
            circle.rim.iter_mut().for_each(|px| px.v += shift);
        }
        let (camera, rejects) = solve(views);
        assert!(
            matches!(rejects[..], [(view, FrameReject::Outlier { .. })] if view == odd),
            "{odd}: {rejects:?}"
        );
        let mut rest = sound.clone();
        rest.remove(odd);
        let (expected, _) = solve(rest);
        assert!((camera.fx - expected.fx).abs() < 0.01, "{odd}: {} and {}", camera.fx, expected.fx);
    }
}

#[test]
fn copies_are_counted_out_before_anything_is_asked_of_them() {
    let all = recorded_views();
    for (different, copies) in [(1, 7), (5, 3)] {
        let mut views = all[..different].to_vec();
        views.extend(std::iter::repeat_n(all[0].clone(), copies));
        let refusal = solve_camera(views, &BOARD, CalibrationSettings::default()).expect_err("too few");
        assert_eq!(refusal.reject, CalibrationReject::TooFewFrames { usable: different, needed: 6 });
        let copied = |reject: &&Option<FrameReject>| matches!(reject, Some(FrameReject::Copy { of: 0, .. }));
        assert_eq!(refusal.rejects.iter().filter(copied).count(), copies, "{:?}", refusal.rejects);
    }
}

#[test]
fn a_set_that_fixes_nothing_says_what_is_missing() {
    let (head, frames) = drawn(21, 1.0);
    assert!(matches!(
        calibrate(&frames[..5], &BOARD),
        Err(CalibrationReject::TooFewFrames { usable: 5, needed: 6 })
    ));
    let wrong = Board { columns: 9, rows: 8, ..BOARD };
    assert!(matches!(calibrate(&frames, &wrong), Err(CalibrationReject::MoreCirclesThanBoard { .. })));
    let wrong = Board { pitch_mm: 110.0, ..BOARD };
    assert!(matches!(calibrate(&frames, &wrong), Err(CalibrationReject::OtherRatio { .. })));
    let face_us = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI).into_inner();
    let mut random = Random::new(5);
    let flat: Vec<Frame> = (0..6)
        .map(|i| Pose::new(face_us, Vector3::new(0.0, 0.0, 1000.0 + 150.0 * f64::from(i))))
        .map(|pose| head.draw(&pose, ALL_ON, 1.0, &mut random))
        .collect();
    assert!(matches!(calibrate(&flat, &BOARD), Err(CalibrationReject::NoTilt { .. })));
    // Tilted enough for the camera, but all at 1.9 m: a plane through nearly parallel stripes turns about them.
    let far: Vec<Frame> = (0..6)
        .map(|i| {
            let axis = nalgebra::Unit::new_normalize(Vector3::new(
                (1.1 * f64::from(i)).cos(),
                (1.1 * f64::from(i)).sin(),
                0.0,
            ));
            let turn = Rotation3::from_axis_angle(&axis, 14f64.to_radians()).into_inner() * face_us;
            Pose::new(turn, Vector3::new(0.0, 0.0, 1900.0))
        })
        .map(|pose| head.draw(&pose, ALL_ON, 1.0, &mut random))
        .collect();
    assert!(matches!(calibrate(&far, &BOARD), Err(CalibrationReject::OneDistance { .. })));
}

fn planes_are_right(head: &Head, solution: &CalibrationSolution) {
    for id in LaserId::ALL {
        let (p, t) = (solution.lasers[id.index()].per_mm, head.planes[id.index()]);
        let off = (p - t).norm() / t.norm();
        assert!(off < 1e-3, "laser {id}: {p} for {t}");
    }
}

#[test]
fn a_laser_that_some_frames_lack_is_solved_from_the_others() {
    // Laser 3 in five of eight frames, laser 1 in six, once both are missing.
    let mut random = Random::new(31);
    let head = Head::new(&mut random);
    let poses = poses(&mut random, 8);
    let on = |i: usize| [i != 2 && i != 5, true, ![0, 3, 5].contains(&i), true];
    let frames: Vec<Frame> =
        poses.iter().enumerate().map(|(i, pose)| head.draw(pose, on(i), 1.0, &mut random)).collect();
    let solution = calibrate(&frames, &BOARD).unwrap_or_else(|e| panic!("{e}"));
    planes_are_right(&head, &solution);
    let frames_of = |laser: LaserId| {
        solution.frames.iter().filter(|f| f.stripes.iter().any(|s| s.laser == laser)).count()
    };
    assert_eq!(LaserId::ALL.map(frames_of), [6, 8, 5, 8]);
}

#[test]
fn a_dead_laser_is_named() {
    for seed in 31..36 {
        dead_lasers_are_named(seed);
    }
}

fn dead_lasers_are_named(seed: u64) {
    let (_, frames) = drawn(seed, 1.0);
    let views = frames.iter().filter_map(|f| find_board(f, &BOARD).ok()).collect();
    let camera =
        solve_camera(views, &BOARD, CalibrationSettings::default()).unwrap_or_else(|e| panic!("{e}"));
    let all: Vec<_> = frames.iter().enumerate().map(|(i, f)| camera.find_stripes(i, f)).collect();
    assert!(all.iter().all(|stripes| stripes.len() == 4), "the drawing shows all stripes in all frames");
    // The stripes without those of lasers that are off in a frame. Right of its pair is 1, and 4.
    let without = |off: &dyn Fn(usize, LaserId) -> bool| {
        let mut stripes = all.clone();
        for (frame, stripes) in stripes.iter_mut().enumerate() {
            let whole = stripes.clone();
            stripes.retain(|s| {
                let right = whole.iter().all(|o| o.down != s.down || o.across <= s.across);
                let laser = match (s.down, right) {
                    (true, true) => LaserId::ALL[0],
                    (true, false) => LaserId::ALL[1],
                    (false, false) => LaserId::ALL[2],
                    (false, true) => LaserId::ALL[3],
                };
                !off(frame, laser)
            });
        }
        solve_all(camera.clone(), &stripes).map(|_| ())
    };
    assert_eq!(without(&|_, _| false), Ok(()));
    for dead in LaserId::ALL {
        // In no frame, in one, in four.
        for frames in [0, 1, 4] {
            let found = without(&|i, laser| laser == dead && i >= frames);
            assert_eq!(
                found,
                Err(CalibrationReject::LaserSeenTooRarely { laser: dead, frames, needed: 5 }),
                "seed {seed}: laser {dead} in {frames} frames"
            );
        }
    }
    // One of either pair: no whole pair to compare with, so the pair is named.
    let found = without(&|_, laser| laser == LaserId::ALL[1] || laser == LaserId::ALL[2]);
    let pair = [LaserId::ALL[0], LaserId::ALL[1]];
    assert_eq!(found, Err(CalibrationReject::PairSeenTooRarely { pair, frames: 0, needed: 5 }));
}

#[test]
fn boards_tilted_beyond_45_degrees_are_used() {
    let face_us = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let mut random = Random::new(41);
    let head = Head::new(&mut random);
    let frames: Vec<Frame> = (0..8)
        .map(|i| {
            let about = f64::from(i) * std::f64::consts::FRAC_PI_4 + 0.2;
            let axis = nalgebra::Unit::new_normalize(Vector3::new(about.cos(), about.sin(), 0.0));
            let tilt = if i % 2 == 0 { 48f64 } else { 20.0 };
            let turn = Rotation3::from_axis_angle(&axis, tilt.to_radians()) * face_us;
            Pose::new(turn.into_inner(), Vector3::new(0.0, 0.0, 1100.0 + 120.0 * f64::from(i)))
        })
        .map(|pose| head.draw(&pose, ALL_ON, 1.0, &mut random))
        .collect();
    let solution = calibrate(&frames, &BOARD).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(solution.frames.len(), 8, "all frames take part");
    planes_are_right(&head, &solution);
    assert!((solution.camera.fx - head.camera.fx).abs() < 0.5, "{:?}", solution.camera);
}

#[test]
fn corners_that_no_circle_reached_are_told() {
    // From 1.75 m on the board covers less than half of the picture and reaches no corner.
    let face_us = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let mut random = Random::new(51);
    let head = Head::new(&mut random);
    let far: Vec<Frame> = (0..6)
        .map(|i| {
            let axis = if i % 2 == 0 { Vector3::x_axis() } else { Vector3::y_axis() };
            let turn = Rotation3::from_axis_angle(&axis, if i < 3 { 0.4 } else { -0.4 }) * face_us;
            Pose::new(turn.into_inner(), Vector3::new(0.0, 0.0, 1750.0 + 100.0 * f64::from(i)))
        })
        .map(|pose| head.draw(&pose, ALL_ON, 1.0, &mut random))
        .collect();
    let far = calibrate(&far, &BOARD).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(empty_corners(&far).len(), 4);
}

#[test]
fn frames_without_a_board_are_refused() {
    let grey = Frame::from_rgb(WIDTH, HEIGHT, vec![90; WIDTH * HEIGHT * 3]).expect("the size fits");
    assert!(matches!(find_board(&grey, &BOARD), Err(FrameReject::NoBoard { blobs: 0, in_grid: 0 })));
    for (w, h) in [(1, 1), (2, 3), (31, 17), (64, 64)] {
        let tiny = Frame::from_rgb(w, h, (0..w * h * 3).map(|i| (i * 37 % 251) as u8).collect())
            .expect("the size fits");
        assert!(find_board(&tiny, &BOARD).is_err());
    }
}
