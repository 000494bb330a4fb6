//! The boxes b01 to b06 of `tests/data` rendered anew for heads with real lenses, measured with the calibration that rendered frames of
//! the board give, beside the same heads with the paper's lens and their true calibration. As the product does it, but every result is
//! told, however unsure. Prints a table of `rust/CALIBRATION.md`.
//!
//! `cargo run --release -p boxline-edgenet --example real_lens_boxes -- --heads 3`

use boxline::{BoxMeasurement, Calibration, CameraModel, Frame, Outcome, Settings, measure_box};
use boxline_calib::{Board, CalibrationSettings, find_board, solve_all, solve_camera};
use boxline_edgenet::{EdgeNet, Options};
use boxline_sim::board::{Faults, render_board};
use boxline_sim::recording::{Detail, Exposure, expose_full_frame, jpeg};
use boxline_sim::rng::Rng;
use boxline_sim::world::twin::{BOXES_MM, Finish, Order, ViewDirection, twin};
use boxline_sim::{Head, Split, Stock};
use clap::Parser;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// Measures b01 to b06 with real lenses
#[derive(Parser)]
struct Args {
    /// How many heads
    #[arg(long, default_value_t = 3)]
    heads: u64,
    /// Seed of the first; the next ones count on
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Frames of the board a head
    #[arg(long, default_value_t = 14)]
    frames: usize,
    /// What is wrong with board and head (focus=0.003,bow=2,stretch=0.001,light=0.8,tilt=0.3)
    #[arg(long, default_value = "", value_parser = Faults::parse)]
    faults: Faults,
}

const BOARD: Board = Board { columns: 12, rows: 11, pitch_mm: 100.0, diameter_mm: 50.0 };
const FRONT: usize = 3;
const RIGHT: usize = 0;
const MOST_DEG: f64 = 25.0;
/// Sides with a real lens are to be as good as with the paper's, mm.
const LIMIT_MM: f64 = 0.2;

fn main() -> Result<()> {
    let args = Args::parse();
    let stock = Stock::new(Split::HeldOut);
    let network = EdgeNet::embedded(&Options::default())?;
    println!(
        "| head | box, mm | paper's lens, true calibration | real lens, true calibration | real lens, estimated |"
    );
    println!("|---|---|---|---|---|");
    let (mut compared, mut within) = (0, 0);
    for seed in args.seed..args.seed + args.heads {
        let head = Head::real(&mut Rng::new(seed, 1))?;
        let camera = CameraModel { p1: 0.0, p2: 0.0, k3: 0.0, ..*head.calibration.camera() };
        let ideal = Head::of(head.calibration.serial(), camera, [0, 1, 2, 3].map(|i| head.plane(i)))?;
        let ideal = Head { beams: head.beams, ..ideal };
        let estimated = calibrate(&head, seed, &args, &stock)?;
        // Front (length x width) and right side (height x width) are looked at.
        for (n, [length, width, height]) in BOXES_MM.into_iter().enumerate() {
            let frames = |head: &Head| -> Result<Option<Vec<Frame>>> {
                let rng = &mut Rng::new(seed * 100 + n as u64, 3);
                let order = Order {
                    size_mm: [length, height, width].into(),
                    bulge_mm: 0.0,
                    finish: Finish::Matt,
                    column_mm: None,
                    views: [FRONT, RIGHT]
                        .map(|face| (face, ViewDirection::ByHand { most_deg: MOST_DEG }))
                        .to_vec(),
                };
                let Some(scene) = twin(rng, head, &order, &stock) else { return Ok(None) };
                let shot = |(i, view)| -> Result<Frame> {
                    let seed = seed * 1000 + 10 * n as u64 + i as u64;
                    let rgb = expose_full_frame(
                        head,
                        &scene,
                        view,
                        &Exposure::of(seed, Detail::Everywhere),
                        &stock,
                    );
                    Ok(Frame::from_jpeg(&jpeg(&rgb, seed)?)?)
                };
                scene.views.iter().enumerate().map(shot).collect::<Result<_>>().map(Some)
            };
            let mut truth = [length, width, height];
            truth.sort_by(|a, b| b.total_cmp(a));
            let (plain, real) = (frames(&ideal)?, frames(&head)?);
            let found = [
                errors(&network, plain.as_deref(), &ideal.calibration, &truth)?,
                errors(&network, real.as_deref(), &head.calibration, &truth)?,
                errors(&network, real.as_deref(), &estimated, &truth)?,
            ];
            if let [_, Some(with_true), Some(with_estimated)] = &found {
                for (a, b) in with_true.off_mm.iter().zip(&with_estimated.off_mm) {
                    compared += 1;
                    within += usize::from((a - b).abs() <= LIMIT_MM);
                }
            }
            let text = found.map(|errors| {
                errors.map_or("refused".to_owned(), |e| {
                    let [length, width, height] = e.off_mm;
                    format!("{length:+.2}, {width:+.2}, {height:+.2} at {:.3}", e.confidence)
                })
            });
            println!("| {seed} | b{:02} {truth:?} | {} |", n + 1, text.join(" | "));
        }
    }
    println!("\n{within} of {compared} sides are within {LIMIT_MM} mm of what the true calibration gives");
    Ok(())
}

/// Errors of length, width, height, mm, and the stated probability that all are within 5.
struct Errors {
    off_mm: [f64; 3],
    confidence: f64,
}

/// `None` if the box is refused.
fn errors(
    network: &EdgeNet,
    frames: Option<&[Frame]>,
    calibration: &Calibration,
    truth: &[f64; 3],
) -> Result<Option<Errors>> {
    let Some([a, b]) = frames else { return Ok(None) };
    let settings = Settings { network: Some(network), least_confidence: 0.0, ..Settings::default() };
    let report = measure_box(&[a, b], calibration, &settings)?;
    let near = |m: &BoxMeasurement| {
        let sides = [m.length, m.width, m.height];
        [0, 1, 2].map(|i| sides[i].value_mm - truth[i])
    };
    let off_mm = match &report.outcome {
        Outcome::Measured(m) => Some(near(m)),
        // b01 is not A x A x B, but two of its sides may look alike: the candidate that is nearer.
        Outcome::Ambiguous(both) => {
            let worst = |e: &[f64; 3]| e.iter().fold(0.0, |w: f64, x| w.max(x.abs()));
            both.iter().map(near).min_by(|a, b| worst(a).total_cmp(&worst(b)))
        }
        Outcome::Rejected(_) => None,
    };
    Ok(off_mm.map(|off_mm| Errors { off_mm, confidence: report.confidence.unwrap_or(0.0) }))
}

/// What `boxline calibrate` makes of frames of the board.
fn calibrate(head: &Head, seed: u64, args: &Args, stock: &Stock) -> Result<Calibration> {
    let mut frames = Vec::new();
    let rng = &mut Rng::new(seed, 2);
    render_board(head, args.frames, &args.faults, rng, stock, |name, bytes| {
        if name.ends_with(".jpg") {
            frames.extend(Frame::from_jpeg(&bytes).ok());
        }
        Ok(())
    })?;
    let (mut views, mut used) = (Vec::new(), Vec::new());
    for frame in frames {
        if let Ok(view) = find_board(&frame, &BOARD) {
            views.push(view);
            used.push(frame);
        }
    }
    let camera = solve_camera(views, &BOARD, CalibrationSettings::default()).map_err(|e| e.to_string())?;
    let stripes: Vec<_> = used.iter().enumerate().map(|(i, frame)| camera.find_stripes(i, frame)).collect();
    let solved = solve_all(camera, &stripes).map_err(|e| e.to_string())?;
    let planes = solved.lasers.map(|p| [p.per_mm.x, p.per_mm.y, p.per_mm.z, -1.0]);
    let size = boxline_sim::head::SENSOR_PX;
    let calibration = Calibration::new(head.calibration.serial(), size, solved.camera, planes)?;
    Ok(calibration.with_covariance(solved.covariance)?)
}
