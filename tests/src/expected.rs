//! `expected.json`: what the program makes of a recording today. Sizes must stay within a quarter of their sigmas: what moves them by less is no
//! change that a user could see.
//!
//! `REGENERATE=1 cargo test -p boxline-tests recorded` writes it anew; the difference is reviewed like code.

use boxline::{BoxMeasurement, BoxReport, Estimate, FaceOutcome, Outcome, Reject};
use boxline_proto::json::write_json;
use serde_json::{Map, Value, json};
use std::path::Path;

const FORMAT: &str = "boxline-expected/2";
/// What a value and its sigma may move by, in sigmas.
const TOLERANCE_SIGMAS: f64 = 0.25;
/// What other numbers, places of corners in mm, may move by: their depth is known less well than sides are.
const TOLERANCE_MM: f64 = 1.0;

/// The part of a box measurement that is kept.
#[must_use]
pub fn report_summary(report: &BoxReport) -> Value {
    let (name, sides, reason) = match &report.outcome {
        Outcome::Measured(sides) => ("measured", vec![sides_mm(sides)], None),
        Outcome::Ambiguous(both) => ("ambiguous", both.iter().map(sides_mm).collect(), None),
        Outcome::Rejected(reject) => ("rejected", Vec::new(), Some(Reject::reason(reject))),
    };
    let faces: Vec<Value> = report.faces.iter().map(face_summary).collect();
    json!({"outcome": name, "reason": reason, "boxes_mm": sides, "faces": faces})
}

/// The part of a face measurement that is kept.
#[must_use]
pub fn face_summary(face: &FaceOutcome) -> Value {
    match face {
        FaceOutcome::Measured(face) => json!({
            "outcome": "measured",
            "length_mm": estimate(face.length),
            "width_mm": estimate(face.width),
            "corners_cam_mm": face.corners.map(|c| [rounded(c.mm.x), rounded(c.mm.y), rounded(c.mm.z)]),
        }),
        FaceOutcome::Rejected(reject) => json!({"outcome": "rejected", "reason": reject.reason()}),
    }
}

fn sides_mm(sides: &BoxMeasurement) -> Value {
    json!([estimate(sides.length), estimate(sides.width), estimate(sides.height)])
}

fn estimate(estimate: Estimate) -> Value {
    json!({"value": rounded(estimate.value_mm), "sigma": rounded(estimate.sigma_mm)})
}

/// To a tenth of a micrometre: a regenerated file differs only where results do.
fn rounded(mm: f64) -> f64 {
    (mm * 1e4).round() / 1e4
}

/// Compares results with the folder's `expected.json`, or writes it if `REGENERATE` is set.
pub fn check_expected(folder: &Path, results: &Map<String, Value>) {
    let file = folder.join("expected.json");
    if std::env::var_os("REGENERATE").is_some() {
        let content = json!({"format": FORMAT, "results": results});
        write_json(&file, &content).unwrap_or_else(|e| panic!("{e}"));
        return;
    }
    let bytes = std::fs::read(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    let expected: Value =
        serde_json::from_slice(&bytes).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    assert_eq!(expected["format"], FORMAT, "{}", file.display());
    let mut differences = Vec::new();
    compare(&expected["results"], &json!(results), TOLERANCE_MM, "", &mut differences);
    assert!(
        differences.is_empty(),
        "{}:\n{}\nif that is better: REGENERATE=1 cargo test -p boxline-tests recorded",
        file.display(),
        differences.join("\n")
    );
}

/// Collects the places where two values differ: numbers by more than the tolerance, everything else at all.
fn compare(expected: &Value, found: &Value, tolerance: f64, path: &str, differences: &mut Vec<String>) {
    match (expected, found) {
        (Value::Number(e), Value::Number(f)) => {
            let (e, f) = (e.as_f64().unwrap_or(f64::NAN), f.as_f64().unwrap_or(f64::NAN));
            if (e - f).abs() > tolerance || e.is_nan() || f.is_nan() {
                differences.push(format!("{path}: {f}, expected {e}"));
            }
        }
        (Value::Array(e), Value::Array(f)) if e.len() == f.len() => {
            for (i, (e, f)) in e.iter().zip(f).enumerate() {
                compare(e, f, tolerance, &format!("{path}[{i}]"), differences);
            }
        }
        (Value::Object(e), Value::Object(f)) if e.keys().eq(f.keys()) => {
            let sigma = e.get("sigma").and_then(Value::as_f64);
            let tolerance = sigma.map_or(tolerance, |sigma| TOLERANCE_SIGMAS * sigma);
            for (key, e) in e {
                compare(e, &f[key], tolerance, &format!("{path}.{key}"), differences);
            }
        }
        _ if expected == found => {}
        _ => differences.push(format!("{path}: {found}, expected {expected}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_named_and_small_ones_forgiven() {
        let expected = json!({"a": [1.0, {"value": 2.0, "sigma": 0.2}], "c": "x", "d": null});
        let differ = |found: Value| {
            let mut differences = Vec::new();
            compare(&expected, &found, 1.0, "", &mut differences);
            differences
        };
        assert!(differ(json!({"a": [1.9, {"value": 1.96, "sigma": 0.24}], "c": "x", "d": null})).is_empty());
        assert_eq!(differ(json!({"a": [2.1, {"value": 2.06, "sigma": 0.26}], "c": "y", "d": null})).len(), 4);
        assert_eq!(differ(json!({"a": [1.0], "c": "x", "d": null})).len(), 1);
        let none = json!({"a": [1.0, {"value": null, "sigma": 0.2}], "c": "x", "d": null});
        assert_eq!(differ(none).len(), 1);
        assert_eq!(differ(json!({"c": "x", "d": null})).len(), 1);
    }
}
