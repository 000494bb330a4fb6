//! `boxline evaluate --simulate N`: rendered boxes (two full frames each, in memory) of materials that training never shows,
//! measured as recordings are; errors by the size of the side.

use super::score::{BoxScore, Verdict, method_name};
use super::shots::{shot, stock};
use super::tables::table;
use crate::Finished;
use crate::args::EvaluateArgs;
use boxline::{FaceOutcome, Method, Outcome, Settings, StageTimes, measure_box};
use boxline_edgenet::AnyNet;
use boxline_sim::points::coverage::{CLASSES_MM, Tally};
use boxline_sim::truth::face_of;
use boxline_sim::world::{Plan, compose};
use boxline_sim::{Head, Rng, Split};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Two faces have the same two lengths if these differ by less than this share: nobody can tell which side they share.
const ALIKE: f64 = 0.01;

/// What one method made of all boxes.
#[derive(Default)]
struct Found {
    classes: [Tally; 5],
    sides: Tally,
    measured: usize,
    /// Two candidates: where no frame tells which side is shared, and where one could.
    ambiguous: [usize; 2],
    refused: BTreeMap<&'static str, usize>,
    /// Seeds of boxes with a side off by more than the paper's promise.
    wrong: Vec<(u64, f64)>,
}

/// Runs `boxline evaluate --simulate`.
pub fn evaluate(args: &EvaluateArgs, boxes: u64) -> anyhow::Result<Finished> {
    let edges = args.edges.flatten().unwrap_or_default();
    let network = args.network.load(edges)?;
    let network = network.as_ref();
    let stock = stock(Split::HeldOut, args.photos.as_deref())?;
    let methods = args.method.methods();
    let mut found: Vec<(Method, Found)> = methods.iter().map(|m| (*m, Found::default())).collect();
    // Drawn on standard error, and only on a terminal.
    let progress = ProgressBar::new(boxes)
        .with_style(ProgressStyle::with_template("{bar:30} {pos}/{len} {elapsed} of {duration}")?);
    for seed in (args.seed..=u64::MAX).take(usize::try_from(boxes)?) {
        // As `boxline render --seed` draws them: the same seed is the same box.
        let head = Head::random(&mut Rng::new(seed, 1))?;
        let scene = compose(&mut Rng::new(seed, 2), &head, Plan::Box, &stock);
        let [view_a, view_b] = &scene.views[..] else { continue };
        let frame =
            |n: usize, view| shot(&head, &scene, view, boxline_sim::rng::mix(seed) ^ n as u64, &stock);
        let frames = [frame(0, view_a)?, frame(1, view_b)?];
        let faces = [view_a, view_b].map(|view| face_of(&scene, view).map(|face| face.size_mm()));
        let two_are_right =
            matches!(faces, [Some(a), Some(b)] if a.iter().zip(b).all(|(a, b)| (a - b).abs() < ALIKE * a));
        let mut truth_mm = scene.target.map_or([0.0; 3], |t| (scene.bodies[t].half * 2.0).into());
        truth_mm.sort_by(|a: &f64, b| b.total_cmp(a));
        for (method, found) in &mut found {
            let settings = Settings {
                method: *method,
                edges: edges.into(),
                network: network.and_then(AnyNet::network),
                edge_map: network.and_then(AnyNet::edge_map),
                ..Settings::default()
            };
            let report =
                measure_box(&frames[0], &frames[1], &head.calibration, &settings, &mut StageTimes::new())?;
            let noticed = !report.warnings.is_empty()
                || report
                    .faces
                    .iter()
                    .any(|f| matches!(f, FaceOutcome::Measured(f) if !f.warnings.is_empty()));
            found.add(seed, &BoxScore { truth_mm, outcome: report.outcome, two_are_right }, noticed);
        }
        progress.inc(1);
    }
    progress.finish_and_clear();
    let stdout = if args.json { json_of(args, boxes, &found).to_string() } else { text(boxes, &found) };
    Ok(Finished { stdout, exit_code: 0 })
}

impl Found {
    fn add(&mut self, seed: u64, score: &BoxScore, noticed: bool) {
        match &score.outcome {
            Outcome::Measured(m) => {
                self.measured += 1;
                for (side, truth_mm) in [m.length, m.width, m.height].into_iter().zip(score.truth_mm) {
                    let class = CLASSES_MM.iter().skip(1).position(|c| truth_mm <= *c).unwrap_or(4);
                    self.classes[class].side(side, truth_mm, noticed);
                    self.sides.side(side, truth_mm, noticed);
                }
                if let Verdict::TooFarOff(error_mm) = score.verdict() {
                    self.wrong.push((seed, error_mm));
                }
            }
            Outcome::Ambiguous(_) => self.ambiguous[usize::from(!score.two_are_right)] += 1,
            Outcome::Rejected(reject) => *self.refused.entry(reject.reason()).or_default() += 1,
        }
    }
}

fn text(boxes: u64, found: &[(Method, Found)]) -> String {
    let mut parts =
        vec![format!("{boxes} rendered boxes of materials that training never shows, two full frames each")];
    for (method, found) in found {
        let mut table = table(
            &[
                "sides, mm",
                "count",
                "rms error",
                "mean",
                "within 1 mm",
                "in 95 %",
                "(error/σ)²",
                "> 5 σ, unwarned",
            ],
            1,
        );
        let mut row = |name: String, t: &Tally| {
            if t.count == 0 {
                return;
            }
            table.add_row([
                name,
                t.count.to_string(),
                format!("{:.2} mm", t.rms_error()),
                format!("{:+.2} mm", t.mean_error()),
                format!("{:.1} %", 100.0 * t.share_within_1_mm()),
                format!("{:.1} %", 100.0 * t.coverage()),
                format!("{:.2}", t.mean_z2()),
                t.beyond_5_sigma.to_string(),
            ]);
        };
        for (tally, bounds) in found.classes.iter().zip(CLASSES_MM.windows(2)) {
            row(format!("{}-{}", bounds[0], bounds[1]), tally);
        }
        row("all".into(), &found.sides);
        let [alike, undecided] = found.ambiguous;
        let refused: Vec<String> = found.refused.iter().map(|(reason, n)| format!("{reason} {n}")).collect();
        let wrong: Vec<String> =
            found.wrong.iter().map(|(seed, mm)| format!("seed {seed}: {mm:.1} mm")).collect();
        let listed = |list: Vec<String>| if list.is_empty() { "none".to_owned() } else { list.join(", ") };
        parts.push(format!(
            "{}: {} measured; two candidates: {alike} rightly, {undecided} undecided; refused: {}; off by more than 5 mm: {}\n{}",
            method_name(*method),
            found.measured,
            listed(refused),
            listed(wrong),
            table.trim_fmt()
        ));
    }
    parts.join("\n\n")
}

fn json_of(args: &EvaluateArgs, boxes: u64, found: &[(Method, Found)]) -> Value {
    let methods: Vec<Value> = found
        .iter()
        .map(|(method, found)| {
            let classes: Vec<Value> = found
                .classes
                .iter()
                .zip(CLASSES_MM.windows(2))
                .map(|(tally, bounds)| json!({"from_mm": bounds[0], "to_mm": bounds[1], "sides": tally.json()}))
                .collect();
            let wrong: Vec<Value> =
                found.wrong.iter().map(|(seed, mm)| json!({"seed": seed, "error_mm": mm})).collect();
            json!({
                "method": method_name(*method), "measured": found.measured, "classes": classes,
                "sides": found.sides.json(), "refused": found.refused, "wrong": wrong,
                "ambiguous": {"rightly": found.ambiguous[0], "undecided": found.ambiguous[1]},
            })
        })
        .collect();
    json!({"simulated": "rendered", "boxes": boxes, "seed": args.seed, "methods": methods})
}
