//! Are the sigmas true? Thousands of drawn boxes, measured, against what they were: how often the 95 % interval holds the
//! truth, the mean of (error / sigma)^2, the share within 1 mm, by the size of the side; and how often each check speaks.

use super::truth::{Conditions, PointBox};
use crate::error::Error;
use crate::rng::Rng;
use boxline::points::{measure_box_of, measure_points};
use boxline::{BoxMeasurement, Calibration, Estimate, FaceMeasurement, Outcome, Settings, WarningKind};
use serde_json::{Value, json};
use std::fmt;

/// Bounds of the size classes, mm.
pub const CLASSES_MM: [f64; 6] = [100.0, 200.0, 400.0, 800.0, 1300.0, 1800.0];

/// Errors of one class of sides (or of the volumes).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tally {
    /// Values that were compared.
    pub count: usize,
    /// ... whose interval holds the truth.
    pub covered: usize,
    /// ... that are within 1 mm (sides only).
    pub within_1_mm: usize,
    /// ... that are off by more than 5 sigma although nothing was noticed.
    pub beyond_5_sigma: usize,
    sum_z2: f64,
    sum_error2: f64,
    sum_sigma2: f64,
    sum_z: f64,
    sum_error: f64,
}

impl Tally {
    fn add(&mut self, error: f64, sigma: f64, interval: [f64; 2], truth: f64, noticed: bool) {
        let z = error / sigma;
        self.count += 1;
        self.covered += usize::from((interval[0]..=interval[1]).contains(&truth));
        self.within_1_mm += usize::from(error.abs() <= 1.0);
        self.beyond_5_sigma += usize::from(z.abs() > 5.0 && !noticed);
        self.sum_z += z;
        self.sum_z2 += z * z;
        self.sum_error += error;
        self.sum_error2 += error * error;
        self.sum_sigma2 += sigma * sigma;
    }

    /// Adds a side; `noticed` if the measurement warned.
    pub fn side(&mut self, side: Estimate, truth_mm: f64, noticed: bool) {
        self.add(side.value_mm - truth_mm, side.sigma_mm, side.interval_95_mm(), truth_mm, noticed);
    }

    fn mean(&self, sum: f64) -> f64 {
        sum / self.count.max(1) as f64
    }

    /// Share of intervals that hold the truth, 0 to 1.
    #[must_use]
    pub fn coverage(&self) -> f64 {
        self.mean(self.covered as f64)
    }

    /// Mean of (error / sigma)^2.
    #[must_use]
    pub fn mean_z2(&self) -> f64 {
        self.mean(self.sum_z2)
    }

    /// Mean of error / sigma.
    #[must_use]
    pub fn mean_z(&self) -> f64 {
        self.mean(self.sum_z)
    }

    /// Root mean square error, mm for sides.
    #[must_use]
    pub fn rms_error(&self) -> f64 {
        self.mean(self.sum_error2).sqrt()
    }

    /// Mean error, mm for sides.
    #[must_use]
    pub fn mean_error(&self) -> f64 {
        self.mean(self.sum_error)
    }

    /// Share within 1 mm, 0 to 1.
    #[must_use]
    pub fn share_within_1_mm(&self) -> f64 {
        self.mean(self.within_1_mm as f64)
    }

    /// All of it as one object.
    #[must_use]
    pub fn json(&self) -> Value {
        json!({
            "count": self.count, "coverage_95": self.coverage(), "mean_z2": self.mean_z2(), "mean_z": self.mean_z(),
            "rms_error": self.rms_error(), "mean_error": self.mean_error(), "rms_sigma": self.mean(self.sum_sigma2).sqrt(),
            "within_1_mm": self.share_within_1_mm(), "beyond_5_sigma": self.beyond_5_sigma,
        })
    }
}

/// What a run found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Coverage {
    /// Boxes drawn.
    pub boxes: usize,
    /// Boxes without a result: no rectangle, or sides that disagree.
    pub refused: usize,
    /// Boxes with two candidates, of which the right one was taken.
    pub ambiguous: usize,
    /// Sides of boxes by [`CLASSES_MM`].
    pub classes: [Tally; 5],
    /// All sides of boxes.
    pub sides: Tally,
    /// Lengths and widths of single faces.
    pub face_sides: Tally,
    /// Volumes, relative to the truth in thousandths.
    pub volumes: Tally,
    /// Faces that were measured ...
    pub faces: usize,
    /// ... and for how many each of [`WarningKind::ALL`] was told (the last one, `sides_differ`, counts boxes).
    pub warned: [usize; WarningKind::ALL.len()],
    /// Faces whose moved laser was named, and named rightly.
    pub named: [usize; 2],
    /// Every side that is counted in [`Tally::beyond_5_sigma`].
    pub beyond: Vec<Beyond>,
}

/// A side of a box that is off by more than 5 sigma although nothing was noticed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beyond {
    /// Seed of the box.
    pub seed: u64,
    /// The true side, mm.
    pub truth_mm: f64,
    /// What was measured.
    pub side: Estimate,
    /// Radius of the box's edges, mm, and the farthest that one of them shows inside the sharp edge.
    pub radius_mm: f64,
    /// See `radius_mm`.
    pub most_inside_mm: f64,
}

impl Coverage {
    /// Draws and measures so many boxes; `progress` is called after each.
    ///
    /// # Errors
    /// If the calibration has no covariance.
    pub fn run(
        calibration: &Calibration,
        conditions: &Conditions,
        settings: &Settings,
        seed: u64,
        boxes: usize,
        mut progress: impl FnMut(),
    ) -> Result<Self, Error> {
        let mut found = Self { boxes, ..Self::default() };
        for index in 0..boxes {
            let seed = seed.wrapping_add(index as u64);
            let drawn = PointBox::random(&mut Rng::new(seed, 0xB0C5), calibration, conditions)?;
            found.measure(seed, &drawn, calibration, settings);
            progress();
        }
        Ok(found)
    }

    fn measure(&mut self, seed: u64, drawn: &PointBox, calibration: &Calibration, settings: &Settings) {
        let faces = [0, 1]
            .map(|i| measure_points(calibration, &drawn.faces[i].stripes, &drawn.faces[i].sides, settings));
        for face in faces.iter().flatten() {
            self.face(face, drawn);
        }
        let [Some(a), Some(b)] = &faces else {
            self.refused += 1;
            return;
        };
        let (outcome, warnings) = measure_box_of(a, b);
        self.warned[WarningKind::ALL.len() - 1] += warnings.len();
        let noticed = !(warnings.is_empty() && a.warnings.is_empty() && b.warnings.is_empty());
        let measured = match outcome {
            Outcome::Measured(measured) => measured,
            Outcome::Ambiguous(both) => {
                self.ambiguous += 1;
                both.into_iter()
                    .min_by(|x, y| off_mm(x, drawn).total_cmp(&off_mm(y, drawn)))
                    .unwrap_or(both[0])
            }
            Outcome::Rejected(_) => {
                self.refused += 1;
                return;
            }
        };
        for (side, truth_mm) in sides(&measured).into_iter().zip(drawn.size_mm) {
            let class = CLASSES_MM.iter().skip(1).position(|c| truth_mm <= *c).unwrap_or(4);
            self.classes[class].side(side, truth_mm, noticed);
            let before = self.sides.beyond_5_sigma;
            self.sides.side(side, truth_mm, noticed);
            if self.sides.beyond_5_sigma > before {
                let most_inside_mm = drawn.inside_mm.iter().flatten().copied().fold(f64::MIN, f64::max);
                let radius_mm = drawn.radius_mm;
                self.beyond.push(Beyond { seed, truth_mm, side, radius_mm, most_inside_mm });
            }
        }
        let truth_m3 = drawn.size_mm.iter().product::<f64>() * 1e-9;
        let volume = measured.volume;
        self.volumes.add(
            1e3 * (volume.value_m3 / truth_m3 - 1.0),
            1e3 * volume.sigma_m3 / truth_m3,
            volume.interval_95_m3(),
            truth_m3,
            noticed,
        );
    }

    fn face(&mut self, face: &FaceMeasurement, drawn: &PointBox) {
        self.faces += 1;
        for (kind, count) in WarningKind::ALL.iter().zip(&mut self.warned) {
            *count += usize::from(face.warnings.iter().any(|w| w.kind == *kind));
        }
        let named = face.warnings.iter().find(|w| w.kind == WarningKind::LaserMoved).and_then(|w| w.laser);
        if let Some(laser) = named {
            self.named[0] += 1;
            self.named[1] += usize::from(laser == drawn.tilted);
        }
        for side in [face.length, face.width] {
            let near = |t: &f64| (t - side.value_mm).abs();
            let truth_mm = drawn.size_mm.into_iter().min_by(|x, y| near(x).total_cmp(&near(y)));
            self.face_sides.side(side, truth_mm.unwrap_or(0.0), !face.warnings.is_empty());
        }
    }

    /// The run as a row of the table of checks in `rust/UNCERTAINTY.md`, as [`CHECKS_HEAD`] has it.
    #[must_use]
    pub fn checks_row(&self, name: &str) -> String {
        let share = |count: usize, of: usize| format!("{:.2} %", 100.0 * count as f64 / of.max(1) as f64);
        let [moved, flat, right_angled, opposite, .., differ] = self.warned;
        let [of_faces, of_boxes] = [self.faces, self.boxes];
        let named = format!("{}, rightly {}", self.named[0], self.named[1]);
        let cells = [moved, flat, right_angled, opposite].map(|count| share(count, of_faces));
        let [first, rest @ ..] = cells;
        let within = format!("{:.1} %", self.sides.coverage() * 100.0);
        let cells = [format!("{name} ({of_faces})"), first, named];
        let cells = cells.into_iter().chain(rest).chain([share(differ, of_boxes), within]);
        format!("| {} |", cells.collect::<Vec<_>>().join(" | "))
    }

    /// The run as one object.
    #[must_use]
    pub fn json(&self) -> Value {
        let classes: Vec<Value> = self
            .classes
            .iter()
            .zip(CLASSES_MM.windows(2))
            .map(|(tally, bounds)| json!({"from_mm": bounds[0], "to_mm": bounds[1], "sides": tally.json()}))
            .collect();
        let warned: serde_json::Map<_, _> =
            WarningKind::ALL.iter().zip(self.warned).map(|(k, n)| (k.name().to_owned(), json!(n))).collect();
        json!({
            "boxes": self.boxes, "refused": self.refused, "ambiguous": self.ambiguous, "classes": classes,
            "sides": self.sides.json(), "face_sides": self.face_sides.json(), "volumes_permille": self.volumes.json(),
            "faces": self.faces, "warned": warned,
            "laser_named": self.named[0], "laser_named_rightly": self.named[1],
            "beyond_5_sigma": self.beyond.iter().map(|b| json!({
                "seed": b.seed, "true_mm": b.truth_mm, "measured_mm": b.side.value_mm, "sigma_mm": b.side.sigma_mm,
                "radius_mm": b.radius_mm, "most_inside_mm": b.most_inside_mm,
            })).collect::<Vec<_>>(),
        })
    }
}

fn sides(measured: &BoxMeasurement) -> [Estimate; 3] {
    [measured.length, measured.width, measured.height]
}

fn off_mm(measured: &BoxMeasurement, drawn: &PointBox) -> f64 {
    sides(measured).iter().zip(drawn.size_mm).map(|(s, t)| (s.value_mm - t).abs()).sum()
}

/// The head of the table of checks.
pub const CHECKS_HEAD: &str = "| Faces | `laser_moved` | a laser named | `face_not_flat` | `not_right_angled` | `opposite_edges` | `sides_differ`, of boxes | sides in their interval |
|---|---|---|---|---|---|---|---|";

/// As in `rust/UNCERTAINTY.md`.
const TABLE_HEAD: &str = "| Sides, mm | Count | In the 95 % interval | Mean (error/sigma)² | Mean error/sigma | rms error, mm | rms sigma, mm | Within 1 mm | > 5 sigma |
|---|---|---|---|---|---|---|---|---|";

impl fmt::Display for Coverage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { boxes, refused, ambiguous, .. } = self;
        writeln!(f, "{boxes} boxes, {refused} refused, {ambiguous} ambiguous\n\n{TABLE_HEAD}")?;
        let mut line = |name: &str, t: &Tally, [unit, within]: [&str; 2], per_unit: f64| {
            writeln!(
                f,
                "| {name} | {} | {:.1} % | {:.2} | {:+.2} | {:.2}{unit} | {:.2}{unit} | {within} | {} |",
                t.count,
                t.coverage() * 100.0,
                t.mean_z2(),
                t.mean_z(),
                t.rms_error() * per_unit,
                t.mean(t.sum_sigma2).sqrt() * per_unit,
                t.beyond_5_sigma
            )
        };
        let mut sides = |name: &str, t: &Tally| {
            line(name, t, ["", &format!("{:.1} %", t.share_within_1_mm() * 100.0)], 1.0)
        };
        for (tally, bounds) in self.classes.iter().zip(CLASSES_MM.windows(2)) {
            sides(&format!("{}-{}", bounds[0], bounds[1]), tally)?;
        }
        sides("all", &self.sides)?;
        sides("of one face", &self.face_sides)?;
        line("volume", &self.volumes, [" %", "-"], 0.1)?; // from thousandths
        writeln!(f, "\ntold of {} faces (sides_differ: of boxes)", self.faces)?;
        for (kind, count) in WarningKind::ALL.iter().zip(self.warned) {
            let of = if *kind == WarningKind::SidesDiffer { self.boxes } else { self.faces };
            writeln!(f, "{:<18} {count:>6} {:>7.2} %", kind.name(), 100.0 * count as f64 / of.max(1) as f64)?;
        }
        write!(f, "a laser was named {} times, rightly {}", self.named[0], self.named[1])?;
        for b in &self.beyond {
            write!(
                f,
                "\nbeyond 5 sigma: seed {}, {:.1} mm measured as {:.2} ± {:.2}; edges of radius {:.2} mm show up to {:.2} mm inside",
                b.seed, b.truth_mm, b.side.value_mm, b.side.sigma_mm, b.radius_mm, b.most_inside_mm
            )?;
        }
        Ok(())
    }
}
