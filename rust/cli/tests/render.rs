//! `boxline render` from outside: what it writes can be measured, and nothing is half written or overwritten.
#![cfg(feature = "render")]
#![allow(clippy::unwrap_used)] // the helpers are tests too, which clippy sees only in the functions marked #[test]

mod program;

use program::{boxline, text};
use serde_json::Value;
use std::path::Path;

fn names_in(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

fn read_json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn a_rendered_box_is_measured_as_its_truth_says() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("rendered");
    let run = boxline(&["render", "--out", text(&out), "--seed", "3", "--head", "nominal", "--json"]);
    assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
    let said: Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!(said["outcome"], "rendered");
    assert_eq!(said["recordings"][0], text(&out.join("003")));
    assert_eq!(names_in(&out), ["003"], "something was left behind");
    let files = ["a.jpg", "b.jpg", "calibration.json", "recording.json", "truth.json"];
    assert_eq!(names_in(&out.join("003")), files);
    let truth = read_json(&out.join("003/truth.json"));
    assert!(!truth["faces"][0]["notes"]["materials"].as_array().unwrap().is_empty());

    // Whatever the view allows: a measurement near the truth, or a refusal, but never an error.
    let run = boxline(&["measure", text(&out.join("003")), "--json"]);
    let result: Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_ne!(result["outcome"], "error", "{result}");
    if result["outcome"] == "measured" {
        for (i, side) in ["length_mm", "width_mm", "height_mm"].iter().enumerate() {
            let (found, true_mm) =
                (result[side]["value"].as_f64().unwrap(), truth["box_mm"][i].as_f64().unwrap());
            assert!((found - true_mm).abs() < 0.02 * true_mm, "{side}: {found}, truth {true_mm}");
        }
    }

    // A second run overwrites nothing.
    let before = std::fs::metadata(out.join("003/a.jpg")).unwrap().modified().unwrap();
    let run = boxline(&["render", "--out", text(&out), "--seed", "2", "--count", "2"]);
    assert_eq!(run.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&run.stderr).contains("003"));
    assert_eq!(names_in(&out), ["003"]);
    assert_eq!(std::fs::metadata(out.join("003/a.jpg")).unwrap().modified().unwrap(), before);
}

#[test]
fn frames_to_be_refused_say_why() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["render", "--kind", "refuse", "--frames", "1", "--off", "--held-out", "--out"];
    let run = boxline(&[&arguments[..], &[text(folder.path())]].concat());
    assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
    let truth = read_json(&folder.path().join("001/truth.json"));
    assert_eq!(truth["must_refuse"], true);
    assert!(truth["faces"][0]["refuse"].is_string());
    // The hand has moved before the unlit picture, by a hundredth of a degree at the very least.
    let motion = &truth["faces"][0]["off"]["cam_from_on"];
    let turned_mrad = motion["rotation_mrad"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap());
    assert!(turned_mrad.map(f64::abs).sum::<f64>() > 0.17, "{motion}");
    let frames = read_json(&folder.path().join("001/recording.json"))["frames"].clone();
    assert_eq!(frames[0]["laser"], "on");
    assert_eq!(frames[1]["laser"], "off");
    let alone = boxline(&["render", "--still", "--out", text(&folder.path().join("still"))]);
    assert_eq!(alone.status.code(), Some(2), "--still is about the frames of --off");
}

#[test]
fn a_stream_holds_frames_and_nothing_else() {
    let run = boxline(&["render", "--stream", "--seed", "9", "--count", "2"]);
    assert_eq!(run.status.code(), Some(0));
    let bytes = run.stdout;
    assert!(
        bytes.starts_with(br#"{"format":"boxline-stream/1","w":512,"h":384,"lw":256,"lh":192,"channels":9}"#)
    );
    let mut at = 128;
    for seed in [9u64, 10] {
        assert_eq!(bytes[at..at + 8], seed.to_le_bytes());
        let length = u32::from_le_bytes(bytes[at + 8..at + 12].try_into().unwrap()) as usize;
        let meta: Value = serde_json::from_slice(&bytes[at + 12..at + 12 + length]).unwrap();
        assert_eq!(meta["split"], "training");
        assert!(meta["materials"].as_array().unwrap().len() > 3);
        at += 12 + length + 512 * 384 * 3 + 256 * 192 * 9;
    }
    assert_eq!(at, bytes.len());
    let held = boxline(&["render", "--stream", "--seed", "9", "--count", "1", "--held-out"]).stdout;
    assert_ne!(held[..], bytes[..held.len()]);
}

#[test]
fn speed_is_one_line() {
    let run = boxline(&["render", "--stream", "--time", "--count", "2", "--json"]);
    let said: Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!(said["frames"], 2);
    assert!(said["per_second"].as_f64().unwrap() > 0.0);
}

#[test]
fn senseless_command_lines_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let empty = folder.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    let missing = folder.path().join("missing");
    let out = folder.path().join("out");
    for (arguments, word) in [
        (vec!["render"], "--out"),
        (vec!["render", "--time", "--out", text(&out)], "--time"),
        (vec!["render", "--stream", "--json"], "--json"),
        (vec!["render", "--stream", "--out", text(&out)], "--stream"),
        (vec!["render", "--out", text(&out), "--count", "0"], "--count"),
        (vec!["render", "--out", text(&out), "--kind", "face", "--frames", "0"], "--frames"),
        (vec!["render", "--out", text(&out), "--seed", "18446744073709551615"], "--seed"),
        (vec!["render", "--out", text(&out), "--photos", text(&missing)], "missing"),
        (vec!["render", "--out", text(&out), "--photos", text(&empty)], "empty"),
    ] {
        let run = boxline(&arguments);
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        assert_eq!(run.status.code(), Some(2), "{arguments:?}: {said}");
        let silent = run.stdout.is_empty() || arguments.contains(&"--json");
        assert!(said.contains(word) && silent, "{arguments:?}: {said}");
        assert!(!out.exists(), "{arguments:?}");
    }
}

#[test]
fn simulated_boxes_are_judged_without_a_folder() {
    let folder = tempfile::tempdir().unwrap();
    let (in_memory, from_folder) = (folder.path().join("memory.csv"), folder.path().join("folder.csv"));
    let made = ["--seed", "3", "--hazards", "film,edge_print"];
    let scored = |sources: &[&str], rows: &Path| {
        let arguments = [&["evaluate", "--json", "--csv", text(rows)], sources].concat();
        let run = boxline(&arguments);
        assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
        let found: Value = serde_json::from_slice(&run.stdout).unwrap();
        assert_eq!(found["parts"][0]["count"], 1);
        let rows = std::fs::read_to_string(rows).unwrap();
        let first = rows.lines().nth(2).unwrap().to_owned();
        // Without name, seed and time.
        (found, first.splitn(3, ',').nth(2).unwrap().rsplit_once(',').unwrap().0.to_owned())
    };
    let (found, row) = scored(&[&["--simulate", "1"], &made[..]].concat(), &in_memory);
    assert_eq!(found["parts"][0]["made"]["hazards"], "film,edge_print");
    assert_eq!(found["parts"][0]["seeds"], serde_json::json!([3, 3]));
    let out = folder.path().join("rendered");
    let run = boxline(&[&["render", "--held-out", "--out", text(&out)], &made[..]].concat());
    assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
    assert_eq!(scored(&[text(&out)], &from_folder).1, row);

    for wrong in [
        vec!["evaluate", "--simulate", "1", "folder"],
        vec!["evaluate", "--experiments"],
        vec!["evaluate", "--experiments", "--out", "page.html"],
        vec!["evaluate", "--simulate", "0"],
    ] {
        assert_eq!(boxline(&wrong).status.code(), Some(2), "{wrong:?}");
    }
}
