//! The page `rust/EXPERIMENTS.md`: Markdown tables of what was found, the paper's figures beside it.

use super::super::score::{BoxScore, PROMISE_MM};
use super::super::shots::Series;
use super::{BENT_MM, Box3, Experiments, FACE_MM, N, Shots};
use crate::args::EvaluateArgs;

/// Farther off the head is not meant to measure (physics.md: 0.35 to 2.5 m), mm.
const FARTHEST_MM: f64 = 2500.0;

/// The whole page; `picture` is the name of figure 22's file.
pub fn text(found: &Experiments, args: &EvaluateArgs, picture: &str) -> String {
    let shots = Shots::new(args.shots);
    let mut parts = vec![
        intro(args, &shots),
        poses(found, shots.pose),
        repeated(found, shots.repeated),
        boxes(found, shots.boxes),
        figure(picture),
        bent(found, shots.bent),
    ];
    parts.push(String::new());
    parts.join("\n")
}

/// The command that writes the page; folders as they were given.
fn command(args: &EvaluateArgs) -> String {
    let mut words = vec!["cargo run --release -- evaluate".to_owned()];
    words.extend(args.folders.iter().map(|f| f.display().to_string()));
    words.push("--experiments".into());
    words.extend(args.out.iter().map(|f| format!("--out {}", f.display())));
    words.push(format!("--shots {} --seed {}", args.shots, args.seed));
    words.extend(args.photos.iter().map(|f| format!("--photos {}", f.display())));
    words.join(" ")
}

fn intro(args: &EvaluateArgs, shots: &Shots) -> String {
    format!(
        "# The paper's experiments, repeated\n\n    {}\n\n\
         Written by that command; nothing here is edited by hand. Twins are boxes of the sizes below, rendered by `rust/sim` as full\n\
         frames of the paper's head (its Table 2) through the camera's JPEG: indoors, cartons of materials that training never shows,\n\
         without print along their edges, edges rounded by 0.5 to 4 mm. Between two shots the hand trembles (4 mm, 8 mrad), speckle and\n\
         noise are new; {} frames in all.\n\n\
         - *Fit* is what the program does by default (`--edges net --method fit`).\n\
         - *Key points* is the paper's chain (`--edges hough --method keypoints`): map of the network, Hough transform, clusters, D1 to D8.\n\
         - *Paper*: Peng, Zhang, Song, Chen, Zeng, Sensors 2019, 19, 3921. Of its tables no single values are repeated here; it promises\n\
         ±{PROMISE_MM:.1} mm for every side from 100 to 1800 mm, states an uncertainty of 0.52 to 4.0 mm over that range and 1.96 px for its key\n\
         points, and has errors of 2.0 to 7.6 mm on deformed boxes (section 4.4).\n\n\
         Errors are measured minus true, mm. *s* is the standard deviation of single shots; *n* says how many shots gave a result, the\n\
         others were refused. These are rendered pictures: what a real camera, laser or box adds is not in them.\n",
        command(args),
        shots.frames(),
    )
}

/// A Markdown table: the first column left, the others right.
fn markdown(header: &[&str], rows: &[Vec<String>]) -> String {
    let mut text = format!("| {} |\n|---|{}\n", header.join(" | "), "---:|".repeat(header.len() - 1));
    for row in rows {
        text += &format!("| {} |\n", row.join(" | "));
    }
    text
}

fn times(shots: u64) -> String {
    format!("{shots} {}", if shots == 1 { "shot" } else { "shots" })
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |v| format!("{v:.digits$}"))
}

fn signed(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |v| format!("{v:+.2}"))
}

fn poses(found: &Experiments, shots: u64) -> String {
    let mut rows = Vec::new();
    for (i, pose) in found.poses.iter().enumerate() {
        let [roll, tilt, axis] = pose.degrees;
        let mut row = vec![
            (i + 1).to_string(),
            format!("{roll:.0}, {tilt:.0} about {axis:.0}"),
            format!(
                "{:.0}{}",
                pose.distance_mm,
                if pose.distance_mm > FARTHEST_MM { ", too far" } else { "" }
            ),
        ];
        for [length, width] in &pose.sides {
            row.push(length.values.len().to_string());
            for side in [length, width] {
                row.extend([signed(side.error_mm()), number(side.scatter_mm(), 2)]);
            }
        }
        rows.push(row);
    }
    let header = [
        "Pose",
        "Roll, tilt, deg",
        "Distance, mm",
        "Fit: n",
        "ΔL",
        "s",
        "ΔW",
        "s",
        "Key points: n",
        "ΔL",
        "s",
        "ΔW",
        "s",
    ];
    format!(
        "## Table 3: a face of {:.0} x {:.0} mm in nine poses, {} each (the paper: 30)\n\n{}\n\
         Up to {FARTHEST_MM:.0} mm, as far as the head is meant to measure. {}\n\
         Farther off. {}",
        FACE_MM[0],
        FACE_MM[1],
        times(shots),
        markdown(&header, &rows),
        summary(found.poses.iter().filter(|p| p.distance_mm <= FARTHEST_MM).map(|p| &p.sides)),
        summary(found.poses.iter().filter(|p| p.distance_mm > FARTHEST_MM).map(|p| &p.sides))
    )
}

/// Root mean square and worst error of single shots, by way.
fn summary<'a, const SIDES: usize>(all: impl Iterator<Item = &'a [[Series; SIDES]; N]> + Clone) -> String {
    let of = |way: usize| {
        let errors = all
            .clone()
            .flat_map(move |sides| &sides[way])
            .flat_map(|series| series.values.iter().map(|e| e.value_mm - series.truth_mm));
        let (sum, worst, count) =
            errors.fold((0.0f64, 0.0f64, 0usize), |(s, w, n), e| (s + e * e, w.max(e.abs()), n + 1));
        if count == 0 {
            return "none measured".to_owned();
        }
        format!("rms {:.2} mm, worst {worst:.2} mm of {count} sides", (sum / count as f64).sqrt())
    };
    format!("Single shots: fit {}; key points {}; the paper promises ±{PROMISE_MM:.1} mm.\n", of(0), of(1))
}

fn name(sides: &[Series; 3]) -> String {
    sides.each_ref().map(|s| format!("{}", s.truth_mm)).join(" x ")
}

fn repeated(found: &Experiments, shots: u64) -> String {
    let mut rows = Vec::new();
    for cuboid in &found.repeated {
        for (i, what) in ["length", "width", "height"].into_iter().enumerate() {
            let truth_mm = cuboid.sides[0][i].truth_mm;
            let mut row = vec![format!("{what} {truth_mm}")];
            for side in cuboid.sides.iter().map(|way| &way[i]) {
                let mean = side.error_mm().map(|e| e + side.truth_mm);
                row.extend([
                    side.values.len().to_string(),
                    number(mean, 2),
                    signed(side.error_mm()),
                    number(side.scatter_mm(), 2),
                    number(side.class_a_mm(), 3),
                    number(side.stated_mm(), 2),
                ]);
            }
            rows.push(row);
        }
    }
    let header = [
        "Side, mm",
        "Fit: n",
        "mean",
        "Δ",
        "s",
        "u_A",
        "stated σ",
        "Key points: n",
        "mean",
        "Δ",
        "s",
        "u_A",
        "stated σ",
    ];
    format!(
        "## Table 4: three boxes, {} each (the paper: 15)\n\n{}\n\
         u_A = s / √n is the uncertainty of class A (eq. 22; GUM 4.2). It knows only what changes from shot to shot: rounding of edges,\n\
         calibration and drift do not, which is why the stated σ, which holds all of them, is larger.\n\n{}",
        times(shots),
        markdown(&header, &rows),
        summary(found.repeated.iter().map(|b| &b.sides))
    )
}

fn boxes(found: &Experiments, shots: u64) -> String {
    let header =
        ["Box, mm", "Fit: n", "ΔL", "ΔW", "ΔH", "ΔV, %", "Key points: n", "ΔL", "ΔW", "ΔH", "ΔV, %", "Paper"];
    let paper = || format!("±{PROMISE_MM:.1} mm");
    let of_twins = |cuboid: &Box3| {
        let mut row = vec![name(&cuboid.sides[0])];
        for sides in &cuboid.sides {
            row.push(format!("{} of {}", sides[0].values.len(), cuboid.shots));
            row.extend(sides.iter().map(|side| signed(side.error_mm())));
            row.push(volume_percent(sides.each_ref().map(|s| (s.truth_mm, s.error_mm()))));
        }
        row.push(paper());
        row
    };
    let of_recorded = |(name, ways): &(String, [BoxScore; N])| {
        let mut row = vec![format!("{name}: {}", ways[0].truth_mm.map(|s| format!("{s}")).join(" x "))];
        for score in ways {
            let errors = score.errors_mm();
            row.push(score.reason().unwrap_or("1 of 1").to_owned());
            row.extend([0, 1, 2].map(|i| signed(errors.map(|e| e[i]))));
            row.push(volume_percent([0, 1, 2].map(|i| (score.truth_mm[i], errors.map(|e| e[i])))));
        }
        row.push(paper());
        row
    };
    let mut text = format!("## Table 5: six boxes\n\nTwins, {} in one place:\n\n", times(shots));
    text += &markdown(&header, &found.boxes.iter().map(of_twins).collect::<Vec<_>>());
    text += &format!("\n{}\n", summary(found.boxes.iter().map(|b| &b.sides)));
    if !found.recorded.is_empty() {
        text += "Recordings of a renderer that was written apart from this code, with their true calibration:\n\n";
        text += &markdown(&header, &found.recorded.iter().map(of_recorded).collect::<Vec<_>>());
    }
    text
}

/// Relative error of the volume.
fn volume_percent(sides: [(f64, Option<f64>); 3]) -> String {
    let ratio: Option<f64> = sides.iter().map(|(truth, error)| Some((truth + (*error)?) / truth)).product();
    ratio.map_or_else(|| "-".to_owned(), |r| format!("{:+.3}", 100.0 * (r - 1.0)))
}

fn figure(picture: &str) -> String {
    format!(
        "## Figure 22: uncertainty against length\n\n![Standard deviation of sides against their length]({picture})\n\n\
         Every side of Tables 3 to 5; the paper's line joins the two ends of the range that its abstract states.\n"
    )
}

fn bent(found: &Experiments, shots: u64) -> String {
    let header = [
        "Bulge, mm",
        "Fit: n",
        "rms error",
        "worst",
        "stated σ",
        "warned",
        "Key points: n",
        "rms error",
        "worst",
        "Paper",
    ];
    let rows: Vec<Vec<String>> = found
        .bent
        .iter()
        .map(|(bulge, cuboid)| {
            let mut row = vec![format!("{bulge:+.0}")];
            for (way, sides) in cuboid.sides.iter().enumerate() {
                let mean = |of: &dyn Fn(&Series) -> Option<f64>| {
                    let all: Option<f64> = sides.iter().map(of).sum();
                    all.map(|sum| sum / sides.len() as f64)
                };
                let square = |s: &Series| {
                    let n = s.values.len();
                    (n > 0).then(|| {
                        s.values.iter().map(|e| (e.value_mm - s.truth_mm).powi(2)).sum::<f64>() / n as f64
                    })
                };
                let worst = sides.iter().filter_map(Series::worst_mm).reduce(f64::max);
                row.push(format!("{} of {}", sides[0].values.len(), cuboid.shots));
                row.extend([number(mean(&square).map(f64::sqrt), 2), number(worst, 2)]);
                if way == 0 {
                    row.push(number(mean(&Series::stated_mm), 2));
                    row.push(cuboid.warned[0].to_string());
                }
            }
            row.push(if *bulge == 0.0 { format!("±{PROMISE_MM:.1} mm") } else { "2.0 to 7.6 mm".into() });
            row
        })
        .collect();
    format!(
        "## Section 4.4: the box's surface\n\nA box of {} mm whose faces bulge outwards by so much in their middle (dents are negative) and not\n\
         at their edges, {} each of one box in one place; *warned*: shots with a warning.\n\n{}",
        BENT_MM.map(|s| format!("{s:.0}")).join(" x "),
        times(shots),
        markdown(&header, &rows)
    )
}
