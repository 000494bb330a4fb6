//! Ways to find a stripe's centre on recorded frames, judged by the scene's true geometry. Prints what is judged in
//! `rust/decisions/0003-stripe-centre.md`.
//!
//! `cargo run --release -p boxline --example stripe_estimators -- tests/data/b0*`
//!
//! The true face (corners in `truth.json`) and the calibration's laser planes tell where each stripe is to a small part of
//! a pixel. By recording, and by the stripe's brightness over all recordings: median, root mean square and 95 % point of the
//! centres' distances from the truth across the stripe, the share of places with a centre, and how far whole stripes lie from
//! their true places (root mean square; this is what tilts the face's plane).

use boxline::diagnostics::{Estimator, stripe_residuals};
use boxline::frames::Plane;
use boxline::{Frame, LaserId, Px};
use boxline_proto::json::{TruthFace, read_calibration, read_recording, read_truth};
use nalgebra::Vector3;
use std::path::Path;

type Failure = Box<dyn std::error::Error>;

/// Rows in one profile: as few as a bright stripe takes, and as many as a faint one.
const ROWS: [usize; 2] = [4, 32];
/// Part of the stripe at each end where the edge is rounded.
const ROUNDED_SHARE: f64 = 0.04;
/// A centre farther off than this is another thing, px.
const WRONG_PX: f64 = 2.0;
const WAYS: [(&str, Estimator); 3] = [
    ("centre of gravity", Estimator::CentreOfGravity),
    ("Gaussian", Estimator::Gaussian),
    ("Steger", Estimator::Steger),
];
/// Classes of the stripe's height over its background, grey levels of laser response: the brightest ones are saturated.
const BRIGHTNESS: [(f64, &str); 4] =
    [(15.0, "below 15"), (40.0, "15 to 40"), (100.0, "40 to 100"), (f64::INFINITY, "above 100")];

/// Centres found by one way.
#[derive(Clone, Default)]
struct Score {
    places: usize,
    distances_px: Vec<f64>,
    /// Mean of each whole stripe, without what is another thing.
    stripes_px: Vec<f64>,
}

fn main() -> Result<(), Failure> {
    for rows in ROWS {
        let mut by_brightness = vec![[(); WAYS.len()].map(|()| Score::default()); BRIGHTNESS.len()];
        println!("\n{rows} rows in a profile:\n");
        header("Recording");
        for folder in std::env::args().skip(1) {
            let folder = Path::new(&folder);
            let scores = recording(folder, rows, &mut by_brightness)?;
            row(&folder.file_name().unwrap_or_default().to_string_lossy(), &scores, true);
        }
        println!();
        header("Grey levels");
        for ((_, name), scores) in BRIGHTNESS.iter().zip(&by_brightness) {
            row(name, scores, false);
        }
    }
    Ok(())
}

fn header(first: &str) {
    let names = WAYS.map(|(name, _)| format!("{name}: median | rms | 95 % | found | stripe"));
    println!("| {first} | {} |", names.join(" | "));
    println!("|---|{}", "---:|".repeat(5 * WAYS.len()));
}

fn row(name: &str, scores: &[Score; WAYS.len()], whole: bool) {
    let cells: Vec<String> = scores.iter().map(|s| s.cells(whole)).collect();
    println!("| {name} | {} |", cells.join(" | "));
}

/// All frames of a recording.
fn recording(
    folder: &Path,
    rows: usize,
    by_brightness: &mut [[Score; WAYS.len()]],
) -> Result<[Score; WAYS.len()], Failure> {
    let recording = read_recording(folder)?;
    let calibration = read_calibration(&recording.calibration_file)?;
    let truth = read_truth(folder)?.ok_or("no truth.json")?;
    let mut scores = [(); WAYS.len()].map(|()| Score::default());
    for face in &truth.faces {
        let Some(file) = recording.frames.iter().find(|f| f.id == face.frame).map(|f| &f.file) else {
            continue;
        };
        let Some(plane) = true_plane(face) else { continue };
        let frame = Frame::from_jpeg(&std::fs::read(file)?)?;
        for laser in LaserId::ALL {
            let Some(ends) = face.key_points_px.get(&laser.number()) else { continue };
            let ends = shortened(ends.map(|[u, v]| Px::new(u, v)));
            let centres = WAYS.map(|(_, estimator)| {
                stripe_residuals(&frame, &calibration, &plane, laser, ends, rows, estimator)
            });
            for (way, found) in centres.iter().enumerate() {
                scores[way].places += found.len();
                let near: Vec<f64> =
                    found.iter().flatten().map(|c| c.residual_px).filter(|r| r.abs() < WRONG_PX).collect();
                scores[way].stripes_px.push(near.iter().sum::<f64>() / near.len().max(1) as f64);
                for (i, centre) in found.iter().enumerate() {
                    // The class of a place is the same for all: the first way's height there, whose estimate all share.
                    let height = centres.iter().find_map(|c| Some(c.get(i)?.as_ref()?.amplitude));
                    let class = height.and_then(|h| BRIGHTNESS.iter().position(|(limit, _)| h < *limit));
                    if let Some(class) = class {
                        by_brightness[class][way].places += 1;
                    }
                    if let Some(centre) = centre {
                        scores[way].distances_px.push(centre.residual_px.abs());
                        if let Some(class) = class {
                            by_brightness[class][way].distances_px.push(centre.residual_px.abs());
                        }
                    }
                }
            }
        }
    }
    Ok(scores)
}

impl Score {
    fn cells(&self, whole: bool) -> String {
        let mut sorted = self.distances_px.clone();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| sorted.get((share * (sorted.len() as f64 - 1.0)).max(0.0) as usize).copied();
        let rms = |all: &[f64]| (all.iter().map(|r| r * r).sum::<f64>() / all.len().max(1) as f64).sqrt();
        let found = 100.0 * sorted.len() as f64 / self.places.max(1) as f64;
        format!(
            "{:.3} | {:.3} | {:.3} | {found:.0} % | {}",
            at(0.5).unwrap_or(f64::NAN),
            rms(&sorted),
            at(0.95).unwrap_or(f64::NAN),
            if whole { format!("{:.3}", rms(&self.stripes_px)) } else { "-".into() },
        )
    }
}

/// The face's plane from three of its corners.
fn true_plane(face: &TruthFace) -> Option<Plane<boxline::frames::Cam>> {
    let [a, b, c, _] = face.corners_cam_mm?.map(Vector3::from);
    let normal = (b - a).cross(&(c - a));
    Some(Plane::new(normal / normal.dot(&a)))
}

fn shortened([p, q]: [Px; 2]) -> [Px; 2] {
    let at = |t: f64| Px::new(p.u + (q.u - p.u) * t, p.v + (q.v - p.v) * t);
    [at(ROUNDED_SHARE), at(1.0 - ROUNDED_SHARE)]
}
