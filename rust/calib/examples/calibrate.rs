//! Camera and laser planes from pictures of the circle board: `cargo run --release -p boxline-calib --example calibrate -- [FOLDER]`.

use boxline::Frame;
use boxline_calib::{Board, CalibrationSettings, find_board, solve_all, solve_camera};
use boxline_proto::json::{Role, read_board, read_recording};
use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "tests/data/board".to_owned()));
    let file = read_board(&folder.join("board.json"))?;
    let board = Board {
        columns: file.columns,
        rows: file.rows,
        pitch_mm: file.pitch_mm,
        diameter_mm: file.diameter_mm,
    };
    let recording = read_recording(&folder)?;
    let files = recording.frames.iter().filter(|frame| frame.role == Role::Board).map(|frame| &frame.file);
    let frames: Vec<Frame> = files
        .map(|file| Ok(Frame::from_jpeg(&std::fs::read(file)?)?))
        .collect::<Result<_, Box<dyn Error>>>()?;

    // A frame that does not show enough of the board is refused with its reason, and left out here.
    let (frames, views): (Vec<&Frame>, Vec<_>) =
        frames.iter().filter_map(|frame| Some((frame, find_board(frame, &board).ok()?))).unzip();
    let camera =
        solve_camera(views, &board, CalibrationSettings::default()).map_err(|refusal| refusal.to_string())?;
    let stripes: Vec<_> = frames.iter().enumerate().map(|(i, frame)| camera.find_stripes(i, frame)).collect();
    let solution = solve_all(camera, &stripes).map_err(|refusal| refusal.to_string())?;

    println!("{:.1?}", solution.camera);
    for (number, laser) in (1..).zip(solution.lasers) {
        let (normal, distance_mm) = laser.normal_and_distance_mm();
        println!("laser {number}: {distance_mm:.3} mm from the camera, normal {:.5?}", normal.as_slice());
    }
    let (circles, stripes) = (solution.centre_rms_px, solution.stripe_rms_px);
    println!("circles to {circles:.3?} px rms, stripes to {stripes:.3?} px");
    Ok(())
}
