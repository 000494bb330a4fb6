//! Centre of gravity against Steger's ridge point on recorded frames, judged by the scene's true geometry.
//!
//! `cargo run --release -p boxline --example stripe_estimators -- tests/data/b01 tests/data/b02 ...`
//!
//! The true face (corners in `truth.json`) and the calibration's laser planes tell where each stripe is to a small part of
//! a pixel. Per frame and estimator: the share of places where a centre was found, the robust scatter of the centres
//! (1.48 x median deviation), the mean distance of a whole stripe from its true place (root mean square over the four
//! stripes; this is what tilts the face's plane), and the share of centres more than 2 px off.

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

fn main() -> Result<(), Failure> {
    println!(
        "recording frame rows |  centre of gravity: found scatter stripe wrong  |  Steger: found scatter stripe wrong"
    );
    for folder in std::env::args().skip(1) {
        let folder = Path::new(&folder);
        let recording = read_recording(folder)?;
        let calibration = read_calibration(&recording.calibration_file)?;
        let truth = read_truth(folder)?.ok_or("no truth.json")?;
        for face in &truth.faces {
            let Some(file) = recording.frames.iter().find(|f| f.id == face.frame).map(|f| &f.file) else {
                continue;
            };
            let Some(plane) = true_plane(face) else { continue };
            let frame = Frame::from_jpeg(&std::fs::read(file)?)?;
            for rows in ROWS {
                let name = folder.file_name().unwrap_or_default().to_string_lossy();
                print!("{name:9} {:5} {rows:4}", face.frame);
                for estimator in [Estimator::CentreOfGravity, Estimator::Steger] {
                    let mut stripes = Vec::with_capacity(4);
                    for laser in LaserId::ALL {
                        if let Some(ends) = face.key_points_px.get(&laser.number()) {
                            let ends = shortened(ends.map(|[u, v]| Px::new(u, v)));
                            stripes.push(stripe_residuals(
                                &frame,
                                &calibration,
                                &plane,
                                laser,
                                ends,
                                rows,
                                estimator,
                            ));
                        }
                    }
                    print!("  | {}", Score::of(&stripes));
                }
                println!();
            }
        }
    }
    Ok(())
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

struct Score {
    found: f64,
    scatter_px: f64,
    stripe_px: f64,
    wrong: f64,
}

impl Score {
    fn of(stripes: &[Vec<Option<f64>>]) -> Self {
        let places: usize = stripes.iter().map(Vec::len).sum();
        let mut deviations = Vec::new();
        let (mut offsets, mut wrong) = (0.0, 0);
        for stripe in stripes {
            let found: Vec<f64> = stripe.iter().flatten().copied().collect();
            let middle = median(found.clone());
            let near: Vec<f64> = found.iter().copied().filter(|r| (r - middle).abs() < WRONG_PX).collect();
            offsets += (near.iter().sum::<f64>() / near.len().max(1) as f64).powi(2);
            wrong += found.iter().filter(|r| r.abs() > WRONG_PX).count();
            deviations.extend(found.iter().map(|r| (r - middle).abs()));
        }
        let found = deviations.len();
        Self {
            found: found as f64 / places.max(1) as f64,
            scatter_px: 1.4826 * median(deviations),
            stripe_px: (offsets / stripes.len().max(1) as f64).sqrt(),
            wrong: wrong as f64 / found.max(1) as f64,
        }
    }
}

impl std::fmt::Display for Score {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { found, scatter_px, stripe_px, wrong } = self;
        write!(f, "{:3.0} %  {scatter_px:.3}  {stripe_px:.3}  {:4.1} %", 100.0 * found, 100.0 * wrong)
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
