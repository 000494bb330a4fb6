//! The page `rust/EXPERIMENTS.md`: Markdown tables of what was found, the paper's figures beside it.

use super::super::score::BoxScore;
use super::plan::{BOX_MM, Experiment, FACE_MM, MOST_DEG, PLACES, Table};
use super::series::{Series, Tally};
use super::{ExperimentResults, shots_of};
use crate::args::EvaluateArgs;
use boxline::confidence::RIGHT_MM;
use boxline::measurement::LEAST_CONFIDENCE;

/// A line of a table and what each way made of it.
type Line = (Experiment, Vec<Tally>);

/// The whole page; `picture` is the name of figure 22's file.
pub fn text(found: &ExperimentResults, args: &EvaluateArgs, picture: &str) -> String {
    let times = |table: Table| {
        let (shots, papers) = (shots_of(table, args.shots), table.papers_shots());
        let shots = format!("{shots} {}", if shots == 1 { "shot" } else { "shots" });
        if shots_of(table, args.shots) == papers { shots } else { format!("{shots} (the paper: {papers})") }
    };
    let parts = [
        intro(found, args),
        format!(
            "## Table 3: a face of {:.0} x {:.0} mm in nine poses, {} each\n\n\
             Where the head is, seen from the face's middle: straight before it, or 30° or 60° to a side of its normal; rolled by 45°;\n\
             as near as all four stripes and corners are in the frame with room for a trembling hand.\n",
            FACE_MM[0],
            FACE_MM[1],
            times(Table::Poses)
        ),
        by_side(found, Table::Poses, "Pose", false),
        format!("## Table 4: three boxes in one place, {} each\n", times(Table::Repeated)),
        by_side(found, Table::Repeated, "Box, mm", false),
        format!("## Table 5: six boxes, {} each, from {PLACES} places\n", times(Table::Boxes)),
        by_side(found, Table::Boxes, "Box, mm", true),
        recorded(found),
        figure(picture),
        format!(
            "## Section 4.4: optics and surfaces\n\n\
             One box of {} mm in the same {PLACES} places, {} each. The paper names three optical qualities and three surfaces;\n\
             which they were is not known here, so these are assumed: *sharp* (0.55 px of blur, 0.6 of the noise), *usual* (0.75 px), *blurred*\n\
             (2 px, moved by 2 px, 1.6 times the noise); *matt* (bare board), *printed* (print, labels, tape), *glossy* (varnish).\n",
            BOX_MM.map(|s| format!("{s:.0}")).join(" x "),
            times(Table::Optics)
        ),
        by_box(found, Table::Optics, "Optics, surface"),
        format!(
            "Faces that bulge outwards by so much in their middle (dents are negative) and not at their edges, {} each; the paper has\n\
             errors of 2.0 to 7.6 mm on deformed boxes.\n",
            times(Table::Bulges)
        ),
        by_box(found, Table::Bulges, "Bulge"),
    ];
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("\n")
}

/// The command that writes the page; folders as they were given.
fn command(args: &EvaluateArgs) -> String {
    let mut words = vec!["cargo run --release -- evaluate".to_owned()];
    words.extend(args.folders.iter().map(|f| f.display().to_string()));
    words.push("--experiments".into());
    words.extend(args.out.iter().map(|f| format!("--out {}", f.display())));
    words.extend(args.network.model.iter().map(|f| format!("--model {}", f.display())));
    words.extend(args.ihed.iter().map(|f| format!("--ihed {}", f.display())));
    words.extend(args.shots.iter().map(|n| format!("--shots {n}")));
    words.push(format!("--seed {}", args.seed));
    let limit = args.network.least_confidence;
    words.extend((limit != LEAST_CONFIDENCE).then(|| format!("--least-confidence {limit}")));
    words.extend(args.photos.iter().map(|f| format!("--photos {}", f.display())));
    words.join(" ")
}

fn intro(found: &ExperimentResults, args: &EvaluateArgs) -> String {
    let ihed = if args.ihed.is_some() {
        "is the paper's chain on the single map of its own network (`--edges hough --model ihed.onnx --method keypoints`): the \
         face's sides are lines\n  of that map too. Which stripe is which laser, and where its middle is, is found in the picture in all three."
    } else {
        "(the chain on the single map of its own network) is left out: no network was given with `--ihed`."
    };
    format!(
        "# The paper's experiments, repeated\n\n    {}\n\n\
         Written by that command; nothing here is edited by hand. Twins are boxes of the sizes below, rendered by `rust/sim` as full\n\
         frames of the paper's head (its Table 2) through the camera's JPEG: indoors, cartons of materials that training never shows,\n\
         without print along their edges, free of neighbours, edges rounded by 0.5 to 4 mm. Boxes are seen as a courier sees them: up to\n\
         {MOST_DEG:.0}° from straight on, as near as they fit or a quarter farther. For each shot the hand trembles (4 mm, 8 mrad), speckle and noise\n\
         are new; {} shots in all.\n\n\
         - *Fit* is what the program does by default (`--edges net --method fit`).\n\
         - *Key points* is the paper's chain (`--edges hough --method keypoints`) on the map of our network: Hough transform, clusters, D1 to D8.\n\
         - *Paper's system* {ihed}\n\
         - *Paper*: T. Peng, Z. Zhang, Y. Song, F. Chen, D. Zeng: \"Portable System for Box Volume Measurement Based on Line-Structured Light Vision and\n\
         \u{20} Deep Learning\", Sensors 2019, 19, 3921, doi:10.3390/s19183921. Of its tables no single values are repeated here; it promises\n\
         \u{20} ±{RIGHT_MM:.1} mm for every side from 100 to 1800 mm and states an uncertainty of 0.52 to 4.0 mm over that range.\n\n\
         *n*: measured of all shots, the others were refused; *wrong*: a side is off by more than {RIGHT_MM:.0} mm. Δ: mean of measured minus true, mm;\n\
         *s*: standard deviation of single shots; *max*: largest error. These are rendered pictures: what a real camera, laser or box adds is\n\
         not in them.\n",
        command(args),
        found.lines.iter().filter_map(|(_, tallies)| Some(tallies.first()?.shots)).sum::<usize>(),
    )
}

/// A Markdown table: the first column left, the others right.
fn markdown(header: &[String], rows: &[Vec<String>]) -> String {
    let mut text = format!("| {} |\n|---|{}\n", header.join(" | "), "---:|".repeat(header.len() - 1));
    for row in rows {
        text += &format!("| {} |\n", row.join(" | "));
    }
    text
}

fn number(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |v| format!("{v:.2}"))
}

fn signed(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |v| format!("{v:+.2}"))
}

fn distance(what: &Experiment) -> String {
    let [least, most] = what.distance_mm.map(|mm| format!("{:.2}", mm / 1000.0));
    if least == most { least } else { format!("{least} to {most}") }
}

/// How many shots gave a result.
fn count(tally: &Tally) -> String {
    let wrong = if tally.wrong > 0 { format!(", {} wrong", tally.wrong) } else { String::new() };
    format!("{} of {}{wrong}", tally.measured(), tally.shots)
}

fn header(found: &ExperimentResults, first: &[&str], of_a_way: &[&str]) -> Vec<String> {
    let mut header: Vec<String> = first.iter().map(|word| (*word).to_owned()).collect();
    for (_, name) in &found.ways {
        header.extend(
            of_a_way
                .iter()
                .enumerate()
                .map(|(i, word)| if i == 0 { format!("{name}: {word}") } else { (*word).to_owned() }),
        );
    }
    header
}

/// A row a side, and one for the volume if it is wanted.
fn by_side(found: &ExperimentResults, table: Table, first: &str, with_volume: bool) -> String {
    let mut rows = Vec::new();
    for (what, tallies) in found.of(table) {
        let names: &[&str] = if what.sides_mm.len() == 2 { &["L", "W"] } else { &["L", "W", "H"] };
        let mut row = |i: usize, side: &str, series: &dyn Fn(&Tally) -> Series| {
            let mut row =
                if i == 0 { vec![what.name.clone(), distance(what)] } else { vec![String::new(); 2] };
            row.push(side.to_owned());
            for tally in tallies {
                let series = series(tally);
                row.push(if i == 0 { count(tally) } else { String::new() });
                row.extend([
                    signed(series.error_mm()),
                    number(series.scatter_mm()),
                    number(series.worst_mm()),
                ]);
            }
            rows.push(row);
        };
        for (i, side) in names.iter().enumerate() {
            row(i, side, &|tally| tally.sides[i].clone());
        }
        if with_volume {
            row(names.len(), "V, %", &Tally::volume_percent);
        }
    }
    let header = header(found, &[first, "Distance, m", "Side"], &["n", "Δ", "s", "max"]);
    markdown(&header, &rows) + &summary(found, table)
}

/// A row a box, all its sides together.
fn by_box(found: &ExperimentResults, table: Table, first: &str) -> String {
    let rows: Vec<Vec<String>> = found
        .of(table)
        .map(|(what, tallies)| {
            let mut row = vec![what.name.clone()];
            for tally in tallies {
                let (rms, worst, _) = spread(tally.errors_mm());
                let stated: Vec<f64> = tally.sides.iter().filter_map(Series::stated_mm).collect();
                let mean = (!stated.is_empty()).then(|| stated.iter().sum::<f64>() / stated.len() as f64);
                row.extend([
                    count(tally),
                    number(rms),
                    number(worst),
                    number(mean),
                    tally.warned.to_string(),
                ]);
            }
            row
        })
        .collect();
    let header = header(found, &[first], &["n", "rms", "max", "stated σ", "warned"]);
    markdown(&header, &rows) + &summary(found, table)
}

/// Root mean square, largest and number of errors.
fn spread(errors_mm: impl Iterator<Item = f64>) -> (Option<f64>, Option<f64>, usize) {
    let (sum, worst, n) =
        errors_mm.fold((0.0f64, 0.0f64, 0), |(s, w, n), e| (s + e * e, w.max(e.abs()), n + 1));
    let some = |value: f64| (n > 0).then_some(value);
    (some((sum / f64::from(n)).sqrt()), some(worst), n as usize)
}

/// All shots of a table, by way.
fn summary(found: &ExperimentResults, table: Table) -> String {
    let mut text = String::from("\nSingle shots of this table:\n");
    for (i, (_, name)) in found.ways.iter().enumerate() {
        let lines: Vec<&Line> = found.of(table).collect();
        let tallies = || lines.iter().map(|(_, tallies)| &tallies[i]);
        let (rms, worst, sides) = spread(tallies().flat_map(Tally::errors_mm));
        let sum = |of: fn(&Tally) -> usize| tallies().map(of).sum::<usize>();
        let mut refused = std::collections::BTreeMap::<&str, usize>::new();
        for (reason, n) in tallies().flat_map(|t| &t.refused) {
            *refused.entry(reason).or_default() += n;
        }
        let refused: Vec<String> = refused.into_iter().map(|(reason, n)| format!("{reason} {n}")).collect();
        let refused = if refused.is_empty() { "none".to_owned() } else { refused.join(", ") };
        text += &format!(
            "- {name}: {} of {} measured, {} wrong; rms {} mm, max {} mm of {sides} sides; refused: {refused}\n",
            sum(Tally::measured),
            sum(|t| t.shots),
            sum(|t| t.wrong),
            number(rms),
            number(worst),
        );
    }
    text
}

/// The recordings, if there are any.
fn recorded(found: &ExperimentResults) -> String {
    if found.recorded.is_empty() {
        return String::new();
    }
    let row = |(name, scores): &(String, Vec<BoxScore>)| {
        let true_mm =
            scores.first().map_or(String::new(), |s| s.truth_mm.map(|mm| mm.to_string()).join(" x "));
        let mut row = vec![format!("{name}: {true_mm}")];
        for score in scores {
            let errors = score.errors_mm();
            row.push(score.reason().unwrap_or("1 of 1").to_owned());
            row.extend([0, 1, 2].map(|i| signed(errors.map(|e| e[i]))));
        }
        row
    };
    let rows: Vec<Vec<String>> = found.recorded.iter().map(row).collect();
    let header = header(found, &["Box, mm"], &["n", "ΔL", "ΔW", "ΔH"]);
    format!(
        "Recordings of a renderer that was written apart from this code, with their true calibration:\n\n{}",
        markdown(&header, &rows)
    )
}

fn figure(picture: &str) -> String {
    format!(
        "## Figure 22: uncertainty against length\n\n![Standard deviation of sides against their length]({picture})\n\n\
         Every side of Tables 3 to 5; the paper's line joins the two ends of the range that its abstract states.\n"
    )
}
