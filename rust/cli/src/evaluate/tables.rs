//! The evaluation as tables for people and as one JSON object for programs.

use super::score::{
    BoxScore, Distances, FaceScore, RecordingScore, Statistics, Verdict, method_name, together,
};
use boxline::confidence::RIGHT_MM;
use boxline::{FaceOutcome, Method, Outcome};
use comfy_table::{CellAlignment, LineStyle, Table, TableStyle};
use serde_json::{Value, json};

/// All tables, with what went wrong at the end, where it is seen.
pub fn text(scores: &[RecordingScore], methods: &[Method]) -> String {
    let mut parts = Vec::new();
    if scores.iter().any(|s| s.cuboid.is_some()) {
        parts.push(("Boxes: mm and m³ (columns as in Table 5 of the paper)", box_table(scores)));
    }
    if scores.iter().flat_map(|s| &s.faces).any(|f| f.truth_mm.is_some() && f.refusal_due.is_none()) {
        parts.push(("Faces: errors in mm; corners and key points in px, rms / worst", face_table(scores)));
    }
    if scores.iter().flat_map(|s| &s.faces).any(|f| f.refusal_due.is_some()) {
        parts.push(("Frames that must be refused", refusal_table(scores)));
    }
    parts.push((
        "Errors in mm; mean with its sign; error/σ is 1 if the standard deviations are honest",
        summary_table(scores, methods),
    ));
    parts.push(("Time in ms", time_table(scores, methods)));
    let mut text = String::new();
    for (title, table) in parts {
        text.push_str(&format!("{title}\n{}\n\n", table.trim_fmt()));
    }
    let wrong: Vec<String> = scores.iter().flat_map(RecordingScore::wrong).collect();
    if wrong.is_empty() {
        text.push_str(&format!(
            "Nothing wrong: all within {RIGHT_MM:.0} mm, and within 3 mm or 4 σ, nothing measured that was to be refused.\n"
        ));
    } else {
        text.push_str(&format!("!!! {} WRONG !!!\n", wrong.len()));
        for line in wrong {
            text.push_str(&format!("!!! {line}\n"));
        }
    }
    let missed: Vec<String> = scores.iter().flat_map(RecordingScore::missed).collect();
    if !missed.is_empty() {
        text.push_str(&format!("{} missed\n{}\n", missed.len(), missed.join("\n")));
    }
    text
}

pub fn table(header: &[&str], left_columns: usize) -> Table {
    let mut table = Table::new();
    let rule = LineStyle::new('─', '─', '─', '─');
    table.load_style(TableStyle::new().header_separator(rule)).set_header(header.to_vec());
    for (index, column) in table.column_iter_mut().enumerate() {
        let right = index >= left_columns;
        column.set_cell_alignment(if right { CellAlignment::Right } else { CellAlignment::Left });
    }
    table
}

fn box_table(scores: &[RecordingScore]) -> Table {
    let header =
        ["box", "method", "L", "W", "H", "V", "L'", "W'", "H'", "V'", "|ΔL|", "|ΔW|", "|ΔH|", "ΔV %", ""];
    let mut table = table(&header, 2);
    for score in scores {
        let Some(cuboid) = &score.cuboid else { continue };
        let truth = cuboid.truth_mm;
        let true_m3 = volume_m3(truth);
        let mut row = vec![score.name.clone(), method_name(score.method).to_owned()];
        row.extend(truth.map(|side| format!("{side:.1}")));
        row.push(format!("{true_m3:.6}"));
        match cuboid.measurement().zip(cuboid.errors_mm()) {
            Some((m, errors)) => {
                row.extend([m.length, m.width, m.height].map(|side| format!("{:.2}", side.value_mm)));
                row.push(format!("{:.6}", m.volume.value_m3));
                row.extend(errors.map(|error| format!("{:.2}", error.abs())));
                row.push(format!("{:.3}", 100.0 * (m.volume.value_m3 - true_m3).abs() / true_m3));
                row.push(match (cuboid.verdict(), &cuboid.outcome) {
                    (Verdict::Right, Outcome::Ambiguous(_)) => "one of two candidates".into(),
                    (Verdict::Right, _) => String::new(),
                    (verdict, _) => verdict.text(),
                });
            }
            None => {
                row.extend(std::iter::repeat_n("-".to_owned(), 8));
                row.push(format!("{} {}", cuboid.verdict().text(), cuboid.reason().unwrap_or_default()));
            }
        }
        table.add_row(row);
    }
    last_left(&mut table);
    table
}

fn face_table(scores: &[RecordingScore]) -> Table {
    let header = [
        "frame",
        "method",
        "L",
        "W",
        "L'",
        "W'",
        "ΔL",
        "ΔW",
        "σL",
        "σW",
        "corners",
        "key points",
        "residuals",
        "",
    ];
    let mut table = table(&header, 2);
    for (score, face) in faces(scores).filter(|(_, face)| face.refusal_due.is_none()) {
        let Some(truth) = face.truth_mm else { continue };
        let mut row = vec![format!("{}/{}", score.name, face.frame), method_name(score.method).to_owned()];
        row.extend(truth.map(|side| format!("{side:.1}")));
        match (&face.outcome, face.errors_mm()) {
            (FaceOutcome::Measured(m), Some(errors)) => {
                row.extend([m.length, m.width].map(|side| format!("{:.2}", side.value_mm)));
                row.extend(errors.map(|error| format!("{error:+.2}")));
                row.extend([m.length, m.width].map(|side| format!("{:.2}", side.sigma_mm)));
                row.extend([face.corners, face.key_points].map(distances));
                row.push(format!("{:.2}", m.rms_px));
                let verdict = face.verdict();
                row.push(if verdict == Verdict::Right { String::new() } else { verdict.text() });
            }
            _ => {
                row.extend(std::iter::repeat_n("-".to_owned(), 9));
                row.push(format!("{} {}", face.verdict().text(), found(face)));
            }
        }
        table.add_row(row);
    }
    last_left(&mut table);
    table
}

fn refusal_table(scores: &[RecordingScore]) -> Table {
    let mut table = table(&["frame", "method", "due", "found", ""], 5);
    for (score, face) in faces(scores) {
        let Some(due) = &face.refusal_due else { continue };
        table.add_row([
            format!("{}/{}", score.name, face.frame),
            method_name(score.method).to_owned(),
            due.clone().unwrap_or_else(|| "any".to_owned()),
            found(face),
            face.verdict().text(),
        ]);
    }
    table
}

fn summary_table(scores: &[RecordingScore], methods: &[Method]) -> Table {
    let header = [
        "method",
        "of",
        "measured",
        "sides",
        "mean",
        "mean abs",
        "rms",
        "worst",
        "within 5",
        "error/σ",
        "corners",
        "key points",
    ];
    let mut table = table(&header, 2);
    for &method in methods {
        for part in summaries(scores, method) {
            let s = &part.statistics;
            if part.due == 0 {
                continue;
            }
            let mut row = vec![
                method_name(method).to_owned(),
                part.of.to_owned(),
                format!("{} of {}", part.measured, part.due),
                s.count().to_string(),
            ];
            if s.count() == 0 {
                row.extend(std::iter::repeat_n("-".to_owned(), 6));
            } else {
                row.extend([
                    format!("{:+.2}", s.mean_mm()),
                    format!("{:.2}", s.mean_absolute_mm()),
                    format!("{:.2}", s.rms_mm()),
                    format!("{:.2}", s.worst_mm()),
                    format!("{} of {}", s.within_promise(), s.count()),
                    format!("{:.1}", s.error_in_sigmas()),
                ]);
            }
            row.extend([part.corners, part.key_points].map(distances));
            table.add_row(row);
        }
    }
    table
}

fn time_table(scores: &[RecordingScore], methods: &[Method]) -> Table {
    let mut table = table(&["method", "stage", "mean a frame", "worst recording, a frame"], 2);
    for &method in methods {
        let of_method = || scores.iter().filter(move |s| s.method == method);
        let mut stages: Vec<&str> = Vec::new();
        for (stage, _) in of_method().flat_map(|s| &s.stages) {
            if !stages.contains(&stage.as_str()) {
                stages.push(stage);
            }
        }
        let frames: usize = of_method().map(|s| s.faces.len()).sum();
        for stage in stages {
            let nanos =
                |s: &RecordingScore| s.stages.iter().find(|(name, _)| name == stage).map_or(0, |t| t.1);
            let mean = ms(of_method().map(nanos).sum()) / frames as f64;
            let worst = of_method().map(|s| ms(nanos(s)) / s.faces.len() as f64).fold(0.0, f64::max);
            table.add_row([method_name(method), stage, &format!("{mean:.1}"), &format!("{worst:.1}")]);
        }
        let pairs: Vec<f64> = of_method().filter(|s| s.cuboid.is_some()).map(total_ms).collect();
        if !pairs.is_empty() {
            let mean = pairs.iter().sum::<f64>() / pairs.len() as f64;
            let worst = pairs.iter().copied().fold(0.0, f64::max);
            let cells = [method_name(method).to_owned(), "a whole pair".to_owned()];
            table.add_row(cells.into_iter().chain([mean, worst].map(|ms| format!("{ms:.1}"))));
        }
    }
    table
}

/// Everything as one object. Errors are measured minus true, in mm; `verdict` is "right" or says what is not.
pub fn json(scores: &[RecordingScore]) -> Value {
    let recordings: Vec<Value> = scores
        .iter()
        .map(|score| {
            json!({
                "recording": score.name,
                "method": method_name(score.method),
                "box": score.cuboid.as_ref().map(box_json),
                "faces": score.faces.iter().map(face_json).collect::<Vec<_>>(),
                "times_ms": score.stages.iter().map(|(name, nanos)| (name.clone(), json!(ms(*nanos))))
                    .collect::<serde_json::Map<_, _>>(),
            })
        })
        .collect();
    let mut summary = Vec::new();
    for method in [Method::Fit, Method::Keypoints] {
        for part in summaries(scores, method).into_iter().filter(|part| part.due > 0) {
            let s = &part.statistics;
            summary.push(json!({
                "method": method_name(method), "of": part.of, "measured": part.measured, "due": part.due,
                "sides": s.count(), "mean_mm": s.mean_mm(), "mean_absolute_mm": s.mean_absolute_mm(),
                "rms_mm": s.rms_mm(), "worst_mm": s.worst_mm(), "within_5_mm": s.within_promise(),
                "error_in_sigmas": s.error_in_sigmas(),
                "corners_px": part.corners.map(distances_json), "key_points_px": part.key_points.map(distances_json),
            }));
        }
    }
    let wrong: Vec<String> = scores.iter().flat_map(RecordingScore::wrong).collect();
    let missed: Vec<String> = scores.iter().flat_map(RecordingScore::missed).collect();
    json!({"recordings": recordings, "summary": summary, "wrong": wrong, "missed": missed})
}

fn box_json(cuboid: &BoxScore) -> Value {
    let true_m3 = volume_m3(cuboid.truth_mm);
    let m = cuboid.measurement();
    json!({
        "outcome": match cuboid.outcome {
            Outcome::Measured(_) => "measured",
            Outcome::Ambiguous(_) => "ambiguous",
            Outcome::Rejected(_) => "rejected",
        },
        "reason": cuboid.reason(),
        "verdict": cuboid.verdict().text(),
        "true_mm": cuboid.truth_mm,
        "measured_mm": m.map(|m| [m.length, m.width, m.height].map(|side| side.value_mm)),
        "sigma_mm": m.map(|m| [m.length, m.width, m.height].map(|side| side.sigma_mm)),
        "error_mm": cuboid.errors_mm(),
        "volume_error_percent": m.map(|m| 100.0 * (m.volume.value_m3 - true_m3) / true_m3),
    })
}

fn face_json(face: &FaceScore) -> Value {
    let sides = face.sides();
    let (outcome, rms_px) = match &face.outcome {
        FaceOutcome::Measured(m) => ("measured", Some(m.rms_px)),
        FaceOutcome::Rejected(_) => ("rejected", None),
    };
    json!({
        "frame": face.frame,
        "outcome": outcome,
        "reason": face.reason(),
        "refusal_due": face.refusal_due.as_ref().map(|due| due.as_deref().unwrap_or("any")),
        "verdict": face.verdict().text(),
        "true_mm": face.truth_mm,
        "measured_mm": sides.map(|s| s.map(|side| side.value_mm)),
        "sigma_mm": sides.map(|s| s.map(|side| side.sigma_mm)),
        "error_mm": face.errors_mm(),
        "corners_px": face.corners.map(distances_json),
        "key_points_px": face.key_points.map(distances_json),
        "residuals_rms_px": rms_px,
    })
}

/// The errors of all boxes, or of all faces, with one method.
struct Summary {
    of: &'static str,
    /// How many were measured, of those for which a measurement was due.
    measured: usize,
    due: usize,
    statistics: Statistics,
    corners: Option<Distances>,
    key_points: Option<Distances>,
}

fn summaries(scores: &[RecordingScore], method: Method) -> [Summary; 2] {
    let of_method = || scores.iter().filter(move |s| s.method == method);
    let mut boxes = Summary {
        of: "boxes",
        measured: 0,
        due: 0,
        statistics: Statistics::default(),
        corners: None,
        key_points: None,
    };
    for cuboid in of_method().filter_map(|s| s.cuboid.as_ref()) {
        boxes.due += 1;
        // Two candidates are an answer, but which one is right was not measured: they stay out of the errors.
        if let (Outcome::Measured(m), Some(errors)) = (&cuboid.outcome, cuboid.errors_mm()) {
            boxes.measured += 1;
            for (error, side) in errors.into_iter().zip([m.length, m.width, m.height]) {
                boxes.statistics.add(error, side.sigma_mm);
            }
        }
    }
    let due = || of_method().flat_map(|s| &s.faces).filter(|f| f.refusal_due.is_none());
    let mut faces = Summary {
        of: "faces",
        measured: 0,
        due: due().count(),
        statistics: Statistics::default(),
        corners: together(due().filter_map(|f| f.corners)),
        key_points: together(due().filter_map(|f| f.key_points)),
    };
    for (sides, errors) in due().filter_map(|f| f.sides().zip(f.errors_mm())) {
        faces.measured += 1;
        for (side, error) in sides.into_iter().zip(errors) {
            faces.statistics.add(error, side.sigma_mm);
        }
    }
    [boxes, faces]
}

fn faces(scores: &[RecordingScore]) -> impl Iterator<Item = (&RecordingScore, &FaceScore)> {
    scores.iter().flat_map(|score| score.faces.iter().map(move |face| (score, face)))
}

fn found(face: &FaceScore) -> String {
    match &face.outcome {
        FaceOutcome::Measured(m) => {
            let sides = format!("measured {:.1} x {:.1} mm", m.length.value_mm, m.width.value_mm);
            // In the table of faces only what was clicked comes here.
            if face.other_line.is_none() {
                return sides;
            }
            format!("{sides}, corners {} px", distances(face.corners))
        }
        FaceOutcome::Rejected(reject) => reject.reason().to_owned(),
    }
}

fn last_left(table: &mut Table) {
    if let Some(column) = table.column_iter_mut().last() {
        column.set_cell_alignment(CellAlignment::Left);
    }
}

fn distances(distances: Option<Distances>) -> String {
    distances.map_or_else(|| "-".to_owned(), |d| format!("{:.2} / {:.2}", d.rms_px, d.worst_px))
}

fn distances_json(distances: Distances) -> Value {
    json!({"rms": distances.rms_px, "worst": distances.worst_px})
}

fn volume_m3(sides_mm: [f64; 3]) -> f64 {
    sides_mm.iter().product::<f64>() * 1e-9
}

fn total_ms(score: &RecordingScore) -> f64 {
    ms(score.stages.iter().map(|(_, nanos)| nanos).sum())
}

fn ms(nanos: u64) -> f64 {
    nanos as f64 * 1e-6
}
