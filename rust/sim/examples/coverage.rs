//! Are the sigmas true, and do the checks see what is wrong? Prints the tables of `rust/UNCERTAINTY.md`.
//!
//! `cargo run --release -p boxline-sim --example coverage -- --boxes 2000`, and the same with `--checks`

use boxline::{Calibration, Settings};
use boxline_proto::json::read_calibration;
use boxline_sim::points::Conditions;
use boxline_sim::points::coverage::{CHECKS_HEAD, Coverage};
use clap::Parser;
use indicatif::ProgressBar;
use std::path::PathBuf;

/// Measures drawn boxes and says how true the sigmas are
#[derive(Parser)]
struct Args {
    /// A calibration with its covariance
    #[arg(long, default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/calibration_set/estimated.json"))]
    calibration: PathBuf,
    /// How many boxes
    #[arg(long, default_value_t = 2000)]
    boxes: usize,
    /// Seed of the first box; the next ones count on
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Drift of every laser, 1 sigma: drawn so, and allowed for so
    #[arg(long, default_value_t = 0.05)]
    drift_mrad: f64,
    /// Tilt of one laser beside its drift, that nothing allows for
    #[arg(long, default_value_t = 0.0)]
    tilt_mrad: f64,
    /// Bulge of every face (a dent if negative)
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true)]
    bulge_mm: f64,
    /// Skew of every face
    #[arg(long, default_value_t = 0.0)]
    skew_mrad: f64,
    /// Print the table of checks instead: sound boxes, and 150 of each fault
    #[arg(long, conflicts_with_all = ["tilt_mrad", "bulge_mm", "skew_mrad", "json"])]
    checks: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args = Args::parse();
    let calibration = read_calibration(&args.calibration)?;
    let conditions = Conditions {
        drift_rad: args.drift_mrad * 1e-3,
        tilt_rad: args.tilt_mrad * 1e-3,
        bulge_mm: args.bulge_mm,
        skew_rad: args.skew_mrad * 1e-3,
    };
    let settings = Settings { drift_rad: conditions.drift_rad, ..Settings::default() };
    if args.checks {
        return checks(&args, &calibration, conditions, &settings);
    }
    let progress = ProgressBar::new(args.boxes as u64);
    let found =
        Coverage::run(&calibration, &conditions, &settings, args.seed, args.boxes, || progress.inc(1))?;
    progress.finish_and_clear();
    if args.json {
        println!("{}", found.json());
    } else {
        println!("{found}");
    }
    Ok(())
}

/// Boxes of each fault.
const FAULTY: usize = 150;

fn checks(
    args: &Args,
    calibration: &Calibration,
    sound: Conditions,
    settings: &Settings,
) -> Result<(), Box<dyn std::error::Error>> {
    println!("{CHECKS_HEAD}");
    for (name, conditions, boxes) in [
        ("sound", sound, args.boxes),
        ("one laser tilted by 0.2 mrad", Conditions { tilt_rad: 0.2e-3, ..sound }, FAULTY),
        ("by 0.5 mrad", Conditions { tilt_rad: 0.5e-3, ..sound }, FAULTY),
        ("bulge of 1 mm", Conditions { bulge_mm: 1.0, ..sound }, FAULTY),
        ("bulge of 3 mm", Conditions { bulge_mm: 3.0, ..sound }, FAULTY),
        ("dent of 3 mm", Conditions { bulge_mm: -3.0, ..sound }, FAULTY),
        ("skew of 2 mrad", Conditions { skew_rad: 2e-3, ..sound }, FAULTY),
        ("skew of 10 mrad", Conditions { skew_rad: 10e-3, ..sound }, FAULTY),
    ] {
        let found = Coverage::run(calibration, &conditions, settings, args.seed, boxes, || {})?;
        println!("{}", found.checks_row(name));
    }
    Ok(())
}
