//! `boxline evaluate --experiments`: the paper's experiments (section 4: Tables 3 to 5, figure 22, deformed boxes) repeated on
//! rendered twins and on recordings, the product's way beside the paper's chain. Writes one page ([`page`]) and its picture
//! ([`figure`]). Everything follows from the seed.

mod figure;
mod page;

use super::score::BoxScore;
use super::shots::{Series, shot, stock};
use super::{Recorded, recordings_in};
use crate::Finished;
use crate::args::EvaluateArgs;
use crate::input::Usage;
use anyhow::Context;
use boxline::{
    EdgeMethod, Estimate, FaceOutcome, Frame, Method, Network, Outcome, Settings, StageTimes, measure_box,
    measure_face,
};
use boxline_proto::json::read_calibration;
use boxline_sim::rng::mix;
use boxline_sim::world::Scene;
use boxline_sim::world::twin::{Order, trembled, turned, twin};
use boxline_sim::{Head, Rng, Split, Stock};
use indicatif::{ProgressBar, ProgressStyle};
use nalgebra::Vector3;
use serde_json::{Value, json};
use std::path::Path;

/// The product's way, and the paper's: its edge map, Hough transform, clusters, eight key points.
const WAYS: [(Method, EdgeMethod); 2] =
    [(Method::Fit, EdgeMethod::Net), (Method::Keypoints, EdgeMethod::Hough)];
/// Number of [`WAYS`].
const N: usize = WAYS.len();

/// Table 3: a face of 800 x 600 mm. The paper's poses are not known in numbers; these are roll, tilt and the tilt's axis, degrees.
const FACE_MM: [f64; 2] = [800.0, 600.0];
const POSES_DEG: [[f64; 3]; 9] = [
    [45.0, 0.0, 0.0],
    [45.0, 15.0, 0.0],
    [45.0, 15.0, 90.0],
    [45.0, 30.0, 0.0],
    [45.0, 30.0, 90.0],
    [-45.0, 15.0, 45.0],
    [-45.0, 15.0, 135.0],
    [-45.0, 30.0, 45.0],
    [-38.0, 20.0, 180.0],
];
/// Tables 4 and 5: six boxes from the smallest to the largest, those of the recordings b01 to b06; three of them in Table 4.
const BOXES_MM: [[f64; 3]; 6] = [
    [143.4, 120.5, 100.0],
    [550.6, 350.5, 300.0],
    [800.0, 600.0, 500.0],
    [1200.0, 900.0, 700.0],
    [1500.0, 690.7, 570.5],
    [1800.0, 900.0, 400.0],
];
const OF_TABLE_4: [usize; 3] = [0, 2, 5];
/// Section 4.4: a box whose faces bulge (or dent) by so much, mm.
const BENT_MM: [f64; 3] = [600.0, 400.0, 300.0];
const BULGES_MM: [f32; 6] = [0.0, 2.0, 4.0, 8.0, -2.0, -4.0];
/// Farthest from looking straight at a face of a box, degrees.
const MOST_DEG: f64 = 25.0;

/// A pose of the face in Table 3.
struct Pose {
    degrees: [f64; 3],
    distance_mm: f64,
    shots: u64,
    /// Length and width, by way.
    sides: [[Series; 2]; N],
}

/// A box, measured several times in one place.
struct Box3 {
    shots: u64,
    /// Length, width, height, by way.
    sides: [[Series; 3]; N],
    /// Shots with a warning, by way.
    warned: [usize; N],
}

/// All that was found.
struct Experiments {
    poses: Vec<Pose>,
    repeated: Vec<Box3>,
    boxes: Vec<Box3>,
    recorded: Vec<(String, [BoxScore; N])>,
    bent: Vec<(f32, Box3)>,
}

/// What does not change from shot to shot.
struct Bench<'a> {
    head: Head,
    stock: Stock,
    network: &'a dyn Network,
    progress: ProgressBar,
    seed: u64,
}

/// Runs `boxline evaluate --experiments`.
pub fn evaluate(args: &EvaluateArgs, out: &Path) -> anyhow::Result<Finished> {
    if out.extension().is_none_or(|e| e != "md") {
        return Err(Usage(format!("{}: the page is an .md", out.display())).into());
    }
    let network = args.network.load_anyway()?;
    let shots = Shots::new(args.shots);
    // Drawn on standard error, and only on a terminal.
    let progress = ProgressBar::new(shots.frames())
        .with_style(ProgressStyle::with_template("{bar:30} {pos}/{len} {elapsed} of {duration} {msg}")?);
    let bench = Bench {
        head: Head::nominal()?,
        stock: stock(Split::HeldOut, args.photos.as_deref())?,
        network: &network,
        progress,
        seed: args.seed,
    };
    let mut recorded = Vec::new();
    for folder in &args.folders {
        recorded.extend(bench.recorded(folder)?);
    }
    let found = bench.run(&shots, recorded)?;
    bench.progress.finish_and_clear();
    let svg = out.with_extension("svg");
    let name = svg.file_name().unwrap_or_default().to_string_lossy().into_owned();
    write(&svg, &figure::draw(&found).map_err(anyhow::Error::msg)?)?;
    write(out, &page::text(&found, args, &name))?;
    let stdout = if args.json {
        found.json(args).to_string()
    } else {
        format!("{}\n{}", out.display(), svg.display())
    };
    Ok(Finished { stdout, exit_code: 0 })
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    std::fs::write(path, text).with_context(|| format!("{}: cannot write", path.display()))
}

/// How often each thing is shot.
struct Shots {
    pose: u64,
    repeated: u64,
    boxes: u64,
    bent: u64,
}

impl Shots {
    /// The paper has 30 for each pose and 15 for each box of Table 4.
    fn new(of_a_pose: u64) -> Self {
        Self {
            pose: of_a_pose,
            repeated: of_a_pose.div_ceil(2),
            boxes: of_a_pose.div_ceil(10),
            bent: of_a_pose.div_ceil(10),
        }
    }

    fn frames(&self) -> u64 {
        let of = |things: usize, shots: u64| 2 * things as u64 * shots;
        POSES_DEG.len() as u64 * self.pose
            + of(OF_TABLE_4.len(), self.repeated)
            + of(BOXES_MM.len(), self.boxes)
            + of(BULGES_MM.len(), self.bent)
    }
}

impl Bench<'_> {
    fn run(&self, shots: &Shots, recorded: Vec<(String, [BoxScore; N])>) -> anyhow::Result<Experiments> {
        let poses = self.poses(&POSES_DEG, shots.pose)?;
        let mut repeated = Vec::new();
        for index in OF_TABLE_4 {
            self.progress.set_message(format!("Table 4, {:.0} mm", BOXES_MM[index][0]));
            repeated.push(self.cuboid(40 + index as u64, BOXES_MM[index], 0.0, shots.repeated)?);
        }
        let mut boxes = Vec::new();
        for (index, size_mm) in BOXES_MM.into_iter().enumerate() {
            self.progress.set_message(format!("Table 5, {:.0} mm", size_mm[0]));
            boxes.push(self.cuboid(50 + index as u64, size_mm, 0.0, shots.boxes)?);
        }
        let mut bent = Vec::new();
        for bulge_mm in BULGES_MM {
            self.progress.set_message(format!("bulge {bulge_mm} mm"));
            // One box in one place: nothing else changes.
            bent.push((bulge_mm, self.cuboid(60, BENT_MM, bulge_mm, shots.bent)?));
        }
        Ok(Experiments { poses, repeated, boxes, recorded, bent })
    }

    fn settings(&self, (method, edges): (Method, EdgeMethod)) -> Settings<'_> {
        Settings { method, edges, network: Some(self.network), ..Settings::default() }
    }

    /// One box, looked at from all poses.
    fn poses(&self, poses_deg: &[[f64; 3]], shots: u64) -> anyhow::Result<Vec<Pose>> {
        let mut rng = Rng::new(self.seed, 0x7AB3);
        let order = Order {
            size_mm: Vector3::new(FACE_MM[0], 500.0, FACE_MM[1]),
            bulge_mm: 0.0,
            views: poses_deg.iter().map(|[roll, tilt, axis]| (3, turned(*roll, *tilt, *axis))).collect(),
        };
        let scene = self.twin(&mut rng, &order)?;
        let mut poses = Vec::new();
        for (index, degrees) in poses_deg.iter().enumerate() {
            self.progress.set_message(format!("Table 3, pose {}", index + 1));
            let mut sides = [(); N].map(|()| FACE_MM.map(Series::new));
            for n in 0..shots {
                let shaken = trembled(&mut rng, &self.head, &scene);
                let frame = self.frame(&shaken, index, 0x7AB3_0000 + n)?;
                for (way, series) in WAYS.iter().zip(&mut sides) {
                    let outcome = measure_face(
                        &frame,
                        &self.head.calibration,
                        &self.settings(*way),
                        &mut StageTimes::new(),
                    )?;
                    if let FaceOutcome::Measured(face) = outcome {
                        add(series, [face.length, face.width]);
                    }
                }
            }
            let distance_mm = boxline_sim::truth::face_of(&scene, &scene.views[index])
                .map_or(f64::NAN, |face| face.centre.norm());
            poses.push(Pose { degrees: *degrees, distance_mm, shots, sides });
        }
        Ok(poses)
    }

    /// A box in one place, both faces shot again and again: its front is length x width, its right side height x width.
    fn cuboid(&self, purpose: u64, size_mm: [f64; 3], bulge_mm: f32, shots: u64) -> anyhow::Result<Box3> {
        let mut rng = Rng::new(self.seed, 0x7AB4_0000 + purpose);
        let mut turned = || boxline_sim::pose::random_orientation(&mut rng, true, MOST_DEG);
        let views = vec![(3, turned()), (0, turned())];
        let [length, width, height] = size_mm;
        let order = Order { size_mm: Vector3::new(length, height, width), bulge_mm, views };
        let scene = self.twin(&mut rng, &order)?;
        let mut found = Box3 { shots, sides: [(); N].map(|()| size_mm.map(Series::new)), warned: [0; N] };
        for n in 0..shots {
            let shaken = trembled(&mut rng, &self.head, &scene);
            let seed = (purpose << 32) + 2 * n;
            let frames = [self.frame(&shaken, 0, seed)?, self.frame(&shaken, 1, seed + 1)?];
            for (i, way) in WAYS.into_iter().enumerate() {
                let report = measure_box(
                    &frames[0],
                    &frames[1],
                    &self.head.calibration,
                    &self.settings(way),
                    &mut StageTimes::new(),
                )?;
                if let Outcome::Measured(m) = report.outcome {
                    add(&mut found.sides[i], [m.length, m.width, m.height]);
                    let of_faces = report
                        .faces
                        .iter()
                        .any(|face| matches!(face, FaceOutcome::Measured(face) if !face.warnings.is_empty()));
                    found.warned[i] += usize::from(of_faces || !report.warnings.is_empty());
                }
            }
        }
        Ok(found)
    }

    fn twin(&self, rng: &mut Rng, order: &Order) -> anyhow::Result<Scene> {
        twin(rng, &self.head, order, &self.stock).with_context(|| {
            format!("no place for the twin of {:?} mm with this seed", order.size_mm.as_slice())
        })
    }

    fn frame(&self, scene: &Scene, view: usize, number: u64) -> anyhow::Result<Frame> {
        let frame = shot(&self.head, scene, &scene.views[view], mix(self.seed ^ mix(number)), &self.stock);
        self.progress.inc(1);
        frame
    }

    /// Recordings of boxes, measured in each way.
    fn recorded(&self, folder: &Path) -> anyhow::Result<Vec<(String, [BoxScore; N])>> {
        let mut found = Vec::new();
        for (recording, truth) in recordings_in(folder)? {
            let calibration = read_calibration(&recording.calibration_file)?;
            let recorded = Recorded::read(&recording, &truth)?;
            self.progress.set_message(recorded.name.clone());
            let mut boxes = Vec::with_capacity(N);
            for way in WAYS {
                boxes.extend(recorded.judge(&calibration, &self.settings(way), way.0)?.cuboid);
            }
            if let Ok(boxes) = boxes.try_into() {
                found.push((recorded.name.clone(), boxes));
            }
        }
        Ok(found)
    }
}

fn add<const SIDES: usize>(series: &mut [Series; SIDES], values: [Estimate; SIDES]) {
    for (series, value) in series.iter_mut().zip(values) {
        series.values.push(value);
    }
}

impl Experiments {
    fn json(&self, args: &EvaluateArgs) -> Value {
        fn ways<const SIDES: usize>(sides: &[[Series; SIDES]; N]) -> Value {
            let of = |series: &[Series; SIDES]| series.iter().map(Series::json).collect::<Vec<_>>();
            json!({"fit": of(&sides[0]), "keypoints": of(&sides[1])})
        }
        let cuboid = |b: &Box3| json!({"shots": b.shots, "sides": ways(&b.sides), "warned": b.warned});
        json!({
            "seed": args.seed,
            "table_3": self.poses.iter().map(|p| json!({"roll_tilt_axis_deg": p.degrees, "distance_mm": p.distance_mm,
                "shots": p.shots, "sides": ways(&p.sides)})).collect::<Vec<_>>(),
            "table_4": self.repeated.iter().map(cuboid).collect::<Vec<_>>(),
            "table_5": self.boxes.iter().map(cuboid).collect::<Vec<_>>(),
            "recorded": self.recorded.iter().map(|(name, ways)| json!({"name": name,
                "fit_error_mm": ways[0].errors_mm(), "keypoints_error_mm": ways[1].errors_mm()})).collect::<Vec<_>>(),
            "bent": self.bent.iter().map(|(bulge, b)| json!({"bulge_mm": bulge, "box": cuboid(b)})).collect::<Vec<_>>(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use boxline_edgenet::{EdgeNet, Options};
    use clap::Parser;

    #[test]
    fn a_small_run_measures_what_it_rendered_and_says_so_on_the_page() {
        let network = EdgeNet::embedded(&Options::default()).unwrap();
        let bench = Bench {
            head: Head::nominal().unwrap(),
            stock: stock(Split::HeldOut, None).unwrap(),
            network: &network,
            progress: ProgressBar::hidden(),
            seed: 1,
        };
        let poses = bench.poses(&POSES_DEG[..1], 2).unwrap();
        let bent = bench.cuboid(60, BENT_MM, 0.0, 1).unwrap();
        let measured: usize = poses[0].sides[0][0].values.len() + bent.sides[0][0].values.len();
        assert!(measured > 0, "nothing measured of three");
        for series in poses[0].sides[0].iter().chain(&bent.sides[0]) {
            assert!(series.worst_mm().is_none_or(|worst| worst < 5.0), "{series:?}");
        }
        let again = bench.poses(&POSES_DEG[..1], 2).unwrap();
        let values = |p: &Pose| p.sides.each_ref().map(|way| way.each_ref().map(|s| s.values.clone()));
        assert_eq!(values(&again[0]), values(&poses[0]), "the same seed, another result");

        let found = Experiments {
            poses,
            repeated: Vec::new(),
            boxes: Vec::new(),
            recorded: Vec::new(),
            bent: vec![(0.0, bent)],
        };
        let words = ["boxline", "evaluate", "--experiments", "--out", "rust/EXPERIMENTS.md", "--shots", "2"];
        let crate::args::Command::Evaluate(args) = crate::args::Args::parse_from(words).command else {
            panic!()
        };
        let page = page::text(&found, &args, "EXPERIMENTS.svg");
        for expected in ["## Table 3", "--shots 2 --seed 1", "EXPERIMENTS.svg", "600 x 400 x 300"] {
            assert!(page.contains(expected), "{expected} is missing in\n{page}");
        }
        assert!(figure::draw(&found).unwrap().contains("<svg"));
    }
}
