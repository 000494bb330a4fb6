//! The circles of a calibration as `boxline calibrate` sees them, for another solver on the same ones: `tests/opencv/five_terms.py`.
//!
//! `cargo run --release -p boxline-sim --example circles -- FOLDER > circles.json`

use boxline::Frame;
use boxline_calib::{Board, CalibrationSettings, find_board, solve_all, solve_camera};
use boxline_proto::json::{Role, read_board, read_recording};
use clap::Parser;
use serde_json::json;
use std::path::PathBuf;

/// Prints the circles and the camera of a recording of a board
#[derive(Parser)]
struct Args {
    /// A recording with board.json
    folder: PathBuf,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = Args::parse().folder;
    let file = read_board(&folder.join("board.json"))?;
    let board = Board {
        columns: file.columns,
        rows: file.rows,
        pitch_mm: file.pitch_mm,
        diameter_mm: file.diameter_mm,
    };
    let (mut views, mut frames) = (Vec::new(), Vec::new());
    for file in read_recording(&folder)?.frames.into_iter().filter(|f| f.role == Role::Board) {
        let frame = Frame::from_jpeg(&std::fs::read(&file.file)?)?;
        if let Ok(view) = find_board(&frame, &board) {
            views.push(view);
            frames.push(frame);
        }
    }
    let camera =
        solve_camera(views.clone(), &board, CalibrationSettings::default()).map_err(|e| e.to_string())?;
    let stripes: Vec<_> = frames.iter().enumerate().map(|(i, frame)| camera.find_stripes(i, frame)).collect();
    let solved = solve_all(camera, &stripes).map_err(|e| e.to_string())?;
    let frames = solved.frames.iter().map(|frame| {
        let pairs = || views[frame.view].circles.iter().zip(&frame.centres).filter(|(_, centre)| centre.used);
        let centre = |at: boxline::Px| [at.u, at.v];
        json!({
            "board_mm": pairs().map(|(c, _)| board.centre_mm(c.column, c.row)).map(|p| [p.x, p.y]).collect::<Vec<_>>(),
            "centres_px": pairs()
                .map(|(_, c)| [c.at.u + c.residual_px.x, c.at.v + c.residual_px.y])
                .collect::<Vec<_>>(),
            "ellipses_px": pairs().map(|(c, _)| centre(c.ellipse_centre)).collect::<Vec<_>>(),
        })
    });
    let c = &solved.camera;
    println!(
        "{}",
        json!({
            "lens": solved.lens.name(),
            "circles_rms_px": solved.centre_rms_px,
            "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy,
            "image_size": [views[0].width_px, views[0].height_px],
            "frames": frames.collect::<Vec<_>>(),
        })
    );
    Ok(())
}
