//! `boxline drift` and `boxline feasibility` from outside, and the hint after a refusal. Drift is tried on the recorded boxes,
//! with their true calibration and with one whose laser 2 was turned in the file.
#![allow(clippy::unwrap_used)] // the helpers are tests too, which clippy sees only in the functions marked #[test]

mod program;

use nalgebra::Vector3;
use program::{boxline, data, json_of, stderr, stdout, text};
use serde_json::{Value, json};
use std::path::PathBuf;
use tempfile::TempDir;

const BOXES: [&str; 5] = ["b01", "b02", "b03", "b04", "b06"];

fn true_calibration() -> Value {
    let recording: Value =
        serde_json::from_slice(&std::fs::read(data("b01/recording.json")).unwrap()).unwrap();
    let file = data("b01").join(recording["calibration"].as_str().unwrap());
    serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap()
}

fn plane(calibration: &Value, laser: usize) -> Vector3<f64> {
    let plane = calibration["laser_planes"][laser].as_array().unwrap();
    let [a, b, c, d] = [0, 1, 2, 3].map(|i| plane[i].as_f64().unwrap());
    -Vector3::new(a, b, c) / d
}

/// The true calibration with laser 2 believed to be turned about its exit.
fn turned(folder: &TempDir, angle_rad: f64) -> PathBuf {
    let mut calibration = true_calibration();
    let p = plane(&calibration, 1);
    let normal = p.normalize();
    let exit = Vector3::new(1.0 / p.x, 0.0, 0.0);
    let forward = (Vector3::z() - normal * normal.z).normalize();
    let moved = normal + forward * angle_rad;
    let moved = moved / moved.dot(&exit);
    calibration["laser_planes"][1] = json!([moved.x, moved.y, moved.z, -1.0]);
    let path = folder.path().join("turned.json");
    std::fs::write(&path, calibration.to_string()).unwrap();
    path
}

/// A copy of b02 of this name, and the true calibration beside it.
fn copied(place: &TempDir, name: &str) -> (PathBuf, PathBuf) {
    let copy = place.path().join(name);
    std::fs::create_dir(&copy).unwrap();
    for entry in std::fs::read_dir(data("b02")).unwrap() {
        let file = entry.unwrap().path();
        std::fs::copy(&file, copy.join(file.file_name().unwrap())).unwrap();
    }
    let calibration = place.path().join("calibration.json");
    std::fs::write(&calibration, true_calibration().to_string()).unwrap();
    (copy, calibration)
}

fn drift(calibration: Option<&PathBuf>, more: &[&str]) -> std::process::Output {
    let folders = BOXES.map(data);
    // Of the six boxes the default is sure of three: too few faces for one laser's own tilt.
    let mut arguments = vec!["drift", "--least-confidence", "0.5"];
    arguments.extend(folders.iter().map(|f| text(f)));
    if let Some(path) = calibration {
        arguments.extend(["--calibration", text(path)]);
    }
    arguments.extend(more);
    boxline(&arguments)
}

#[test]
fn a_turned_laser_is_seen_and_put_back_but_only_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let believed = turned(&folder, 0.2e-3);
    let before = std::fs::read(&believed).unwrap();
    let proposed = folder.path().join("proposed.json");
    let output = drift(Some(&believed), &["--json", "-o", text(&proposed)]);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    let found = json_of(&output);
    assert_eq!(found["outcome"], "moved");
    assert_eq!(std::fs::read(&believed).unwrap(), before, "the input stays");
    let updated: Value = serde_json::from_slice(&std::fs::read(&proposed).unwrap()).unwrap();
    // At 1 m the believed plane is 0.2 mm off; the proposed one is what the other three and the boxes say.
    let truth = plane(&true_calibration(), 1);
    let off = |p: Vector3<f64>| p.normalize().angle(&truth.normalize());
    let believed: Value = serde_json::from_slice(&before).unwrap();
    let (was, is) = (off(plane(&believed, 1)), off(plane(&updated, 1)));
    assert!(is < 0.5 * was, "{was} rad before, {is} after");

    let overwrite = drift(Some(&proposed), &["-o", text(&proposed)]);
    assert_eq!(overwrite.status.code(), Some(2));
    assert!(stderr(&overwrite).contains("would overwrite an input"));
}

#[test]
fn a_known_length_must_be_a_side_of_the_first_box() {
    let output = drift(None, &["--length", "700"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("no measured side is within 3 % of 700 mm"), "{}", stderr(&output));
}

#[test]
fn one_box_is_too_little() {
    let output = boxline(&["drift", text(&data("b02"))]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("2 measured faces, 3 are needed"), "{}", stderr(&output));
    // No list of nothing.
    assert!(!stderr(&output).contains("left out"), "{}", stderr(&output));
}

/// A file beside the recordings, or within one, that is read is not written; what cannot be written is told before the work.
#[test]
fn inputs_stay_and_a_missing_folder_is_told_first() {
    let place = tempfile::tempdir().unwrap();
    let (copy, calibration) = copied(&place, "b02");
    let run = |output: &std::path::Path| {
        boxline(&[
            "drift",
            text(&data("b01")),
            text(&copy),
            "--calibration",
            text(&calibration),
            "-o",
            text(output),
        ])
    };
    for input in ["b02/a.jpg", "b02/b.jpg", "b02/recording.json", "calibration.json"] {
        let input = place.path().join(input);
        let before = std::fs::read(&input).unwrap();
        let output = run(&input);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains("would overwrite an input"), "{}", stderr(&output));
        assert_eq!(std::fs::read(&input).unwrap(), before);
    }
    let output = run(&place.path().join("nowhere/new.json"));
    assert!(stderr(&output).contains("nowhere: no such folder"), "{}", stderr(&output));
}

#[test]
fn a_recording_counts_once_however_often_it_is_named() {
    let place = tempfile::tempdir().unwrap();
    let (copy, calibration) = copied(&place, "again");
    // By its name, by another way to it, and as a copy of its files: two faces, not six.
    let other_way = data("b02").join("../b02");
    let folders = [text(&data("b02")).to_owned(), text(&other_way).to_owned(), text(&copy).to_owned()];
    let mut words = vec!["drift", "--json", "--calibration", text(&calibration)];
    words.extend(folders.iter().map(String::as_str));
    let output = boxline(&words);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    let error = &json_of(&output)["error"];
    let said = error["text"].as_str().unwrap();
    assert!(said.starts_with("2 measured faces, 3 are needed"), "{said}");
    for name in ["b02/a: the same frame as b02/a", "again/b: the same frame as b02/b"] {
        assert!(said.contains(name), "{said}");
    }
    assert_eq!(error["kind"], "usage");
}

#[test]
fn feasibility_tells_sizes_distances_and_sigmas() {
    let folder = tempfile::tempdir().unwrap();
    let calibration = folder.path().join("calibration.json");
    std::fs::write(&calibration, true_calibration().to_string()).unwrap();
    let picture = folder.path().join("sigma.svg");
    let output =
        boxline(&["feasibility", "--calibration", text(&calibration), "--json", "--picture", text(&picture)]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let found = json_of(&output);
    let faces = found["faces"].as_array().unwrap();
    assert!(faces.iter().any(|f| f["feasible"] == true) && faces.iter().any(|f| f["feasible"] == false));
    for reach in faces.iter().flat_map(|f| f["reaches"].as_array().unwrap()) {
        let sigma = reach["length_sigma"]["total_mm"].as_f64().unwrap();
        assert!(sigma > 0.3 && sigma < 10.0, "{reach}");
    }
    assert!(std::fs::read_to_string(&picture).unwrap().contains("1800 x 1080"));

    let one = boxline(&["feasibility", "--calibration", text(&calibration), "--face", "600x800"]);
    assert!(stdout(&one).contains("800 x 600"), "{}", stdout(&one));
    let bad = boxline(&["feasibility", "--calibration", text(&calibration), "--face", "600"]);
    assert_eq!(bad.status.code(), Some(2));
}

#[test]
fn a_cut_face_comes_with_a_way_to_move() {
    let folder = data("refuse");
    let recording: Value =
        serde_json::from_slice(&std::fs::read(folder.join("recording.json")).unwrap()).unwrap();
    let calibration = folder.join(recording["calibration"].as_str().unwrap());
    let face = |id: &str, json: bool| {
        let frame = folder.join(format!("{id}.jpg"));
        let mut arguments = vec!["face", text(&frame), "--calibration", text(&calibration)];
        if json {
            arguments.push("--json");
        }
        boxline(&arguments)
    };
    // r1: a stripe misses the face; r2: the face reaches the border; r3: no box.
    for (id, moves) in [("r1", &["closer", "aim", "roll"][..]), ("r2", &["farther", "aim"])] {
        let found = json_of(&face(id, true));
        let hint = &found["faces"][0]["hint"];
        let advised = hint["moves"].as_array().unwrap();
        assert!(advised.iter().any(|m| moves.contains(&m["move"].as_str().unwrap())), "{id}: {hint}");
        assert!(stdout(&face(id, false)).contains("How to move: "));
    }
    assert_eq!(json_of(&face("r3", true))["faces"][0]["hint"], Value::Null);
}
