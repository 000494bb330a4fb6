//! Calibration from recorded board frames against the head's true calibration: eight frames that are kept here, and all 28
//! of the set beside this repository where it is.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::calib::{
    Board, BoardStripe, CalibrationReject, CalibrationSettings, CalibrationSolution, find_board, solve_all,
    solve_camera,
};
use boxline::{Calibration, Frame, LaserId};
use boxline_proto::json::{read_board, read_calibration, read_recording};
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
    read_board(&folder.join("board.json")).unwrap().into()
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
    let folder = root().join("../shared/recordings/calibration_set");
    if !folder.join("recording.json").is_file() {
        println!("SKIPPED: {} is not there", folder.display());
        return;
    }
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
