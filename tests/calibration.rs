//! Calibration from recorded board frames against the head's true calibration: eight frames that are kept here, and all 28
//! of the set beside this repository where it is.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::{Calibration, Frame, LaserId};
use boxline_calib::{
    Board, BoardStripe, CalibrationReject, CalibrationSettings, CalibrationSolution, find_board, solve_all,
    solve_camera,
};
use boxline_proto::json::{read_board, read_calibration, read_recording};
use boxline_tests::shared;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

fn truth() -> Calibration {
    read_calibration(&root().join("tests/data/calibration_set/calibration.json")).unwrap()
}

fn calibrate(folder: &Path, board: &Board) -> Result<CalibrationSolution, CalibrationReject> {
    let recording = read_recording(folder).unwrap();
    let load = |i: usize| Frame::from_jpeg(&std::fs::read(&recording.frames[i].file).unwrap()).unwrap();
    let all = 0..recording.frames.len();
    let views = all.clone().map(|i| find_board(&load(i), board).unwrap()).collect();
    let camera = solve_camera(views, board, CalibrationSettings::default())?;
    let stripes: Vec<Vec<BoardStripe>> = all.map(|i| camera.find_stripes(i, &load(i))).collect();
    solve_all(camera, &stripes)
}

/// Largest distance of a laser's plane from the true one over the places where it was seen, mm, up to `farthest_mm`.
fn plane_error_mm(solution: &CalibrationSolution, id: LaserId, farthest_mm: f64) -> f64 {
    let (found, true_plane) = (solution.lasers[id.index()].per_mm, truth().laser(id).per_mm);
    let seen =
        solution.frames.iter().flat_map(|f| &f.stripes).filter(|s| s.laser == id && s.depth_mm < farthest_mm);
    seen.map(|s| {
        let at = solution.camera.ray_from_px(s.at).xy1 * s.depth_mm;
        ((true_plane.dot(&at) - 1.0) / true_plane.norm() - (found.dot(&at) - 1.0) / found.norm()).abs()
    })
    .fold(0.0, f64::max)
}

/// The limits of the first version's plan: 0.1 px, 0.5 px, 0.05 mm at 1 m, 0.25 mm at 2.4 m, 3 sigmas.
fn check(solution: &CalibrationSolution) {
    let (found, truth) = (&solution.camera, truth());
    let t = truth.camera();
    assert!(solution.centre_rms_px.iter().all(|rms| *rms <= 0.1), "{:?}", solution.centre_rms_px);
    let errors = [
        found.fx - t.fx,
        found.fy - t.fy,
        found.cx - t.cx,
        found.cy - t.cy,
        found.k1 - t.k1,
        found.k2 - t.k2,
    ];
    for (i, error) in errors.into_iter().enumerate() {
        let sigma = solution.covariance[(i, i)].sqrt();
        assert!(i > 3 || error.abs() < 0.5, "parameter {i} is off by {error} px");
        assert!(error.abs() < 3.0 * sigma, "parameter {i} is off by {error}, sigma {sigma}");
    }
    for id in LaserId::ALL {
        let (near, far) = (plane_error_mm(solution, id, 1000.0), plane_error_mm(solution, id, 2400.0));
        assert!(near < 0.05 && far < 0.25, "laser {id} is off by {near} mm at 1 m and {far} mm at 2.4 m");
    }
}

fn board(folder: &Path) -> Board {
    let file = read_board(&folder.join("board.json")).unwrap();
    Board { columns: file.columns, rows: file.rows, pitch_mm: file.pitch_mm, diameter_mm: file.diameter_mm }
}

#[test]
fn eight_recorded_frames_give_the_head_that_made_them() {
    let folder = root().join("tests/data/board");
    let solution = calibrate(&folder, &board(&folder)).unwrap();
    assert_eq!(solution.frames.len(), 8);
    check(&solution);
}

#[test]
fn the_whole_set_gives_the_head_that_made_it() {
    let Some(folder) = shared("recordings/calibration_set") else { return };
    let solution = calibrate(&folder, &board(&folder)).unwrap();
    assert_eq!(solution.frames.len(), 28);
    check(&solution);
    // 3255 circles are at least 12 px inside the frames.
    assert!(solution.frames.iter().map(|f| f.centres.len()).sum::<usize>() > 3100);
}

#[test]
fn a_board_file_with_another_pitch_is_refused() {
    let folder = root().join("tests/data/board");
    let wrong = Board { pitch_mm: 110.0, ..board(&folder) };
    assert!(matches!(calibrate(&folder, &wrong), Err(CalibrationReject::OtherRatio { .. })));
}

/// Do solves of different frames of one set scatter as their sigmas say? Each disjoint pick of 9 of the 28 frames is a draw;
/// what frames share (the camera, the board, the renderer) is in all of them. For reading, not a limit: few draws.
#[test]
#[ignore = "for reading: cargo test --release -p boxline-tests --test calibration -- --ignored --nocapture"]
fn how_subsets_scatter_in_their_own_sigmas() {
    let Some(folder) = shared("recordings/calibration_set") else { return };
    let board = board(&folder);
    let recording = read_recording(&folder).unwrap();
    let load = |i: usize| Frame::from_jpeg(&std::fs::read(&recording.frames[i].file).unwrap()).unwrap();
    let views: Vec<_> = (0..recording.frames.len()).map(|i| find_board(&load(i), &board).unwrap()).collect();
    let truth = truth();
    let t = truth.camera();
    let (mut squares, mut sums, mut draws) = ([0.0; 6], [0.0; 6], 0.0);
    // Steps that share no factor with 28 walk through all frames in different orders.
    for step in [1, 3, 5, 9, 11, 13] {
        for part in 0..3 {
            let pick: Vec<usize> = (0..9).map(|k| (part * 9 + k) * step % views.len()).collect();
            let chosen = pick.iter().map(|i| views[*i].clone()).collect();
            let camera = solve_camera(chosen, &board, CalibrationSettings::default());
            let solved = camera.map_err(CalibrationReject::from).and_then(|camera| {
                let stripes: Vec<Vec<BoardStripe>> =
                    pick.iter().enumerate().map(|(k, i)| camera.find_stripes(k, &load(*i))).collect();
                solve_all(camera, &stripes)
            });
            let Ok(s) = solved else {
                println!("step {step} part {part}: {}", solved.err().unwrap());
                continue;
            };
            let c = &s.camera;
            let off = [c.fx - t.fx, c.fy - t.fy, c.cx - t.cx, c.cy - t.cy, c.k1 - t.k1, c.k2 - t.k2];
            let in_sigmas: [f64; 6] = std::array::from_fn(|i| off[i] / s.covariance[(i, i)].sqrt());
            let together = s.covariance[(0, 1)] / (s.covariance[(0, 0)] * s.covariance[(1, 1)]).sqrt();
            println!(
                "step {step} part {part}: {in_sigmas:+.1?} sigmas, fx {:+.3} px, fx and fy go together by {together:.2}, scatter {:.2?} correlation {:.2?}",
                off[0], s.scatter, s.correlation
            );
            for i in 0..6 {
                squares[i] += in_sigmas[i] * in_sigmas[i];
                sums[i] += in_sigmas[i];
            }
            draws += 1.0;
        }
    }
    println!(
        "rms in sigmas {:.2?}, mean {:+.2?}, {draws} draws",
        squares.map(|s| (s / draws).sqrt()),
        sums.map(|s| s / draws)
    );
}

/// Time of finding the board, for comparison with `tests/opencv/circle_grid_referee.py`: processor time,
/// best of five.
#[test]
#[ignore = "for reading: cargo test --release -p boxline-tests --test calibration -- --ignored --nocapture"]
fn how_long_finding_the_board_takes() {
    let Some(folder) = shared("recordings/calibration_set") else { return };
    // Linux: nanoseconds that this thread has run.
    let ran_ms = || {
        let stat = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
        stat.split(' ').next().unwrap().parse::<f64>().unwrap() * 1e-6
    };
    let board = board(&folder);
    let mut sum_ms = 0.0;
    let recording = read_recording(&folder).unwrap();
    for recorded in &recording.frames {
        let frame = Frame::from_jpeg(&std::fs::read(&recorded.file).unwrap()).unwrap();
        let best_ms = (0..5)
            .map(|_| {
                let start = ran_ms();
                find_board(&frame, &board).unwrap();
                ran_ms() - start
            })
            .fold(f64::INFINITY, f64::min);
        println!("{}: {best_ms:.0} ms", recorded.id);
        sum_ms += best_ms;
    }
    println!("{:.0} ms in all, {:.0} ms a frame", sum_ms, sum_ms / recording.frames.len() as f64);
}
