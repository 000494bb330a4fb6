//! The JSON readers: the recordings of `tests/data` read whole, files survive being written, broken ones are explained.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::calibration::{CalibrationCovariance, PAPER_PARAMETERS, PARAMETERS};
use boxline::{Calibration, CameraModel, Error, ErrorKind, LaserId};
use boxline_proto::json::{
    Laser, Role, TruthLine, TruthNotes, calibration_json, parse_board, parse_calibration, parse_recording,
    parse_truth, read_board, read_calibration, read_recording, read_truth, recording_json, write_json,
};
use proptest::prelude::*;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data").join(name)
}

fn parsed(name: &str) -> Value {
    serde_json::from_slice(&std::fs::read(data(name)).unwrap()).unwrap()
}

fn calibration() -> Calibration {
    read_calibration(&data("calibration_set/calibration.json")).unwrap()
}

/// An empty folder of this test's own.
fn scratch(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::remove_dir_all(&folder).unwrap_or_default();
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

#[test]
fn every_recording_of_the_repository_reads_whole() {
    for name in ["b01", "b02", "b03", "b04", "b05", "b06", "refuse", "calibration_set"] {
        let recording = read_recording(&data(name)).unwrap();
        assert_eq!(recording.serial, "SIM-0001");
        assert!(recording.calibration_file.is_file(), "{}", recording.calibration_file.display());
        let truth = read_truth(&data(name)).unwrap().unwrap();
        for face in &truth.faces {
            let frame = recording.frames.iter().find(|f| f.id == face.frame).unwrap();
            assert!(frame.file.is_file() && frame.role == Role::Face && frame.laser == Laser::On);
        }
        assert_eq!(truth.must_refuse, name == "refuse");
        for face in truth.faces.iter().filter(|f| f.corners_px.is_some()) {
            let notes = &face.notes;
            assert!(
                notes.edge_radius_mm.is_some() && notes.distance_mm.is_some() && notes.neighbours.is_some()
            );
            // Written before hazards and ends were told; no face bulges.
            assert_eq!((notes.hazards.as_ref(), notes.bulge_mm), (None, Some(0.0)));
            assert!(face.stripe_ends.is_empty() && face.false_lines.is_empty() && face.hidden.is_none());
        }
        assert_eq!(truth.box_mm.is_some(), name.starts_with('b'));
        if name.starts_with('b') {
            assert!(
                truth.faces.iter().all(|f| f.key_points_px.len() == 4 && f.corners_px.is_some()),
                "{name}"
            );
        }
    }
    assert_eq!(read_truth(&data("..")).unwrap(), None);
    let board = read_board(&data("calibration_set/board.json")).unwrap();
    assert_eq!((board.columns, board.rows, board.pitch_mm, board.thickness_mm), (12, 11, 100.0, 5.0));
}

#[test]
fn a_truth_tells_what_is_hard_about_a_face() {
    let truth = json!({"faces": [{
        "frame": "a",
        "false_lines": [{"side": 2, "offset_mm": -14.5, "kind": "band", "new": 1}],
        "notes": {"hazards": ["strap", "film"], "neighbours": [], "distance_mm": 900.5, "angle_to_normal_deg": 31,
                  "edge_radius_mm": 2.5, "bulge_mm": {}},
    }]});
    let read = |truth: &Value| parse_truth(truth.to_string().as_bytes(), "truth.json");
    let face = read(&truth).unwrap().faces.remove(0);
    assert_eq!(face.false_lines, [TruthLine { side: 2, offset_mm: -14.5, kind: "band".into() }]);
    let notes = TruthNotes {
        hazards: Some(vec!["strap".into(), "film".into()]),
        neighbours: Some(Vec::new()),
        distance_mm: Some(900.5),
        angle_to_normal_deg: Some(31.0),
        edge_radius_mm: Some(2.5),
        bulge_mm: Some(0.0),
        wave_mm: None,
        click_px: None,
    };
    assert_eq!(face.notes, notes);
    let mut broken = truth.clone();
    broken["faces"][0]["false_lines"][0]["side"] = json!(4);
    let said = read(&broken).unwrap_err().to_string();
    assert_eq!(said, "truth.json: faces[0].false_lines[0].side: found 4, 0 to 3 are allowed");
    assert_eq!(read(&json!({"faces": [{"frame": "a"}]})).unwrap().faces[0].notes, TruthNotes::default());
}

#[test]
fn a_written_calibration_reads_the_same_to_the_last_bit() {
    let folder = scratch("calibration_round_trip");
    let path = folder.join("calibration.json");
    std::fs::write(&path, "old").unwrap();
    write_json(&path, &calibration_json(&calibration())).unwrap();
    assert_eq!(read_calibration(&path).unwrap(), calibration());
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1, "no temporary file stays behind");
}

#[test]
fn a_failed_write_says_where_and_leaves_nothing() {
    let folder = scratch("failed_write");
    let error = write_json(&folder.join("missing/x.json"), &json!({})).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Io);
    assert!(error.to_string().contains("missing/x.json"), "{error}");
    std::fs::create_dir_all(folder.join("taken.json/inside")).unwrap();
    write_json(&folder.join("taken.json"), &json!({})).unwrap_err();
    assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
}

#[test]
fn a_written_recording_reads_the_same() {
    let folder = scratch("recording_round_trip");
    let recording =
        parse_recording(&std::fs::read(data("b02/recording.json")).unwrap(), "b02", &folder).unwrap();
    write_json(&folder.join("recording.json"), &recording_json(&recording).unwrap()).unwrap();
    assert_eq!(read_recording(&folder).unwrap(), recording);
    let mut elsewhere = recording;
    elsewhere.frames[1].file = "/elsewhere/a.jpg".into();
    let text = recording_json(&elsewhere).unwrap_err().to_string();
    assert!(text.contains("frame \"a_off\"") && text.contains("/elsewhere/a.jpg"), "{text}");
}

/// Replaces the value at a JSON pointer; `None` takes the key away.
fn broken(file: &str, pointer: &str, value: Option<Value>) -> Vec<u8> {
    let mut whole: Value = serde_json::from_slice(&std::fs::read(data(file)).unwrap()).unwrap();
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    match (value, whole.pointer_mut(parent).unwrap()) {
        (Some(value), Value::Object(object)) => drop(object.insert(key.to_owned(), value)),
        (Some(value), parent) => parent[key.parse::<usize>().unwrap()] = value,
        (None, parent) => drop(parent.as_object_mut().unwrap().remove(key).unwrap()),
    }
    serde_json::to_vec(&whole).unwrap()
}

fn expect(result: Result<impl std::fmt::Debug, Error>, kind: ErrorKind, parts: &[&str]) {
    let error = result.unwrap_err();
    let text = error.to_string();
    assert_eq!(error.kind(), kind, "{text}");
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in {text:?}");
    }
    assert!(text.len() < 300, "{text}");
}

#[test]
fn a_lens_with_more_terms_brings_them_and_their_covariance() {
    let paper = calibration();
    let value = calibration_json(&paper);
    assert!(value["camera"].get("p1").is_none() && value["camera"].get("k3").is_none());
    let camera = CameraModel { p1: 0.0078, p2: -0.003, k3: 0.05, ..*paper.camera() };
    let planes = LaserId::ALL.map(|id| {
        let p = paper.laser(id).per_mm;
        [p.x, p.y, p.z, -1.0]
    });
    let size = [paper.width_px(), paper.height_px()];
    let variances = |known: usize| {
        let own = |i: usize| if i < known { 1e-8 * (i + 1) as f64 } else { 0.0 };
        CalibrationCovariance::from_fn(|i, j| if i == j { own(i) } else { 0.0 })
    };
    for (camera, known) in [(camera, PARAMETERS), (*paper.camera(), PAPER_PARAMETERS)] {
        let whole = Calibration::new("SIM-0001", size, camera, planes).unwrap();
        let whole = whole.with_covariance(variances(known)).unwrap();
        let value = calibration_json(&whole);
        assert_eq!(value["covariance"].as_array().unwrap().len(), known);
        assert_eq!(value["covariance"][0].as_array().unwrap().len(), known);
        assert_eq!(parse_calibration(value.to_string().as_bytes(), "head.json").unwrap(), whole);
        let mut short = value;
        short["covariance"].as_array_mut().unwrap().pop();
        let wrong = parse_calibration(short.to_string().as_bytes(), "head.json").unwrap_err();
        assert!(wrong.to_string().contains("head.json: covariance"), "{wrong}");
    }
}

#[test]
fn broken_calibrations_name_file_and_field() {
    let kind = ErrorKind::InvalidCalibration;
    let table: &[(&str, Option<Value>, &[&str])] = &[
        (
            "/format",
            Some(json!("boxline-calibration/2")),
            &["format", "/2", "\"boxline-calibration/1\" is needed"],
        ),
        ("/format", Some(json!("boxline-recording/1")), &["format", "boxline-recording/1"]),
        ("/format", None, &["missing field `format`"]),
        ("/serial", Some(json!(7)), &["serial: invalid type: integer `7`, expected a string"]),
        ("/serial", Some(json!("")), &["serial: invalid value: string \"\", expected a text"]),
        (
            "/image_size",
            Some(json!([2592])),
            &["image_size: invalid length 1, expected an array of length 2"],
        ),
        ("/image_size", Some(json!([2592, 1944, 3])), &["image_size: invalid length 3"]),
        (
            "/image_size",
            Some(json!([2592, -1])),
            &["image_size[1]: invalid value: integer `-1`, expected u32"],
        ),
        (
            "/image_size",
            Some(json!([2592, 4_294_967_297_u64])),
            &["image_size[1]: invalid value: integer `4294967297`"],
        ),
        ("/image_size", Some(json!([2592, 0])), &["image_size is 2592 x 0 px"]),
        ("/camera", None, &["missing field `camera`"]),
        ("/camera", Some(json!([1, 2])), &["camera: invalid type: sequence, expected an object"]),
        ("/camera/fx", None, &["camera: missing field `fx`"]),
        ("/camera/fx", Some(json!(null)), &["camera.fx: invalid type: null, expected f64"]),
        ("/camera/fx", Some(json!("NaN")), &["camera.fx: invalid type: string \"NaN\", expected f64"]),
        ("/camera/fx", Some(json!(0)), &["camera.fx is 0 px"]),
        ("/camera/k2", Some(json!({"a": 1})), &["camera.k2: invalid type: map, expected f64"]),
        (
            "/laser_planes",
            Some(json!([[1, 2, 3, 4]])),
            &["laser_planes: invalid length 1, expected an array of length 4"],
        ),
        (
            "/laser_planes/2",
            Some(json!([1, 2, 3])),
            &["laser_planes[2]: invalid length 3, expected an array of length 4"],
        ),
        (
            "/laser_planes/2/3",
            Some(json!(true)),
            &["laser_planes[2][3]: invalid type: boolean `true`, expected f64"],
        ),
        ("/laser_planes/2", Some(json!([0, 0, 0, 0])), &["laser_planes: plane 3"]),
        ("/serial", Some(json!(vec!["x"; 1000])), &["serial: invalid type: sequence"]),
        (
            "/camera/cx",
            Some(json!("x".repeat(100_000))),
            &["camera.cx: invalid type: string \"xxxx", "xxx...xxx"],
        ),
    ];
    for (pointer, value, parts) in table {
        let bytes = broken("calibration_set/calibration.json", pointer, value.clone());
        expect(parse_calibration(&bytes, "head.json"), kind, parts);
        expect(parse_calibration(&bytes, "head.json"), kind, &["head.json: "]);
    }
    let whole = std::fs::read_to_string(data("calibration_set/calibration.json")).unwrap();
    for (what, with, parts) in [
        ("2458.9172", "1e999", &["camera.fx: not JSON: number out of range"][..]),
        ("2458.9172", "NaN", &["camera.fx: not JSON: expected value"][..]),
        ("2458.9172", "-Infinity", &["camera.fx: not JSON: invalid number"][..]),
        ("2458.9172", "1,", &["camera", "line 9"][..]),
        ("{", "", &["not JSON", "line 2"][..]),
    ] {
        expect(parse_calibration(whole.replacen(what, with, 1).as_bytes(), "head.json"), kind, parts);
    }
    for bytes in [
        &b""[..],
        b" ",
        b"[]",
        b"null",
        b"7",
        b"\xff\xfe",
        &whole.as_bytes()[..whole.len() / 2],
        &[b'['; 100_000],
    ] {
        expect(parse_calibration(bytes, "head.json"), kind, &["head.json: "]);
    }
}

#[test]
fn a_byte_order_mark_is_nothing_and_utf16_is_named() {
    let whole = String::from_utf8(std::fs::read(data("calibration_set/calibration.json")).unwrap()).unwrap();
    let marked = format!("\u{feff}{whole}");
    assert_eq!(parse_calibration(marked.as_bytes(), "head.json").unwrap(), calibration());
    for mark in ["", "\u{feff}"] {
        for bytes in [u16::to_le_bytes as fn(u16) -> [u8; 2], u16::to_be_bytes] {
            let utf16: Vec<u8> = format!("{mark}{whole}").encode_utf16().flat_map(bytes).collect();
            let parts = ["head.json: ", "UTF-16, UTF-8 is needed"];
            expect(parse_calibration(&utf16, "head.json"), ErrorKind::InvalidCalibration, &parts);
        }
    }
}

#[test]
fn a_key_that_is_given_twice_is_refused() {
    let whole = String::from_utf8(std::fs::read(data("calibration_set/calibration.json")).unwrap()).unwrap();
    for (key, again) in [("serial", "\"serial\": \"X\", \"serial\""), ("fx", "\"fx\": 1, \"fx\"")] {
        let twice = whole.replacen(&format!("\"{key}\""), again, 1);
        let named = format!("the key {key:?} is given twice at line");
        let error = parse_calibration(twice.as_bytes(), "head.json");
        expect(error, ErrorKind::InvalidCalibration, &["head.json: ", &named]);
    }
    let recording = std::fs::read_to_string(data("b02/recording.json")).unwrap();
    let twice = recording.replacen("\"id\"", "\"id\": \"z\", \"id\"", 1);
    let error = parse_recording(twice.as_bytes(), "recording.json", Path::new("x"));
    expect(error, ErrorKind::InvalidFile, &["recording.json: ", "\"id\" is given twice"]);
}

#[test]
fn numbers_that_no_head_has_are_refused() {
    let one = |i: usize, variance: f64| {
        let mut rows = vec![vec![0.0; 18]; 18];
        rows[i][i] = variance;
        json!(rows)
    };
    let planes = parsed("calibration_set/calibration.json")["laser_planes"].clone();
    let cases = [
        ("/camera/skew", json!(100), "camera.skew is 100 px, -24.6 to 24.6 px"),
        ("/camera/cx", json!(99_999), "camera.cx is 99999 px, -1296 to 3888 px"),
        ("/camera/cy", json!(-99_999), "camera.cy is -99999 px, -972 to 2916 px"),
        ("/laser_planes", json!([planes[0], planes[0], planes[2], planes[3]]), "planes 1 and 2 are the same"),
        ("/laser_planes", json!([planes[0], planes[1], planes[3], planes[3]]), "planes 3 and 4 are the same"),
        ("/covariance", one(0, 1e6), "covariance[0][0] is 1e6, a sigma of 1000.0000: at most 245.8917"),
        ("/covariance", one(4, 1e6), "covariance[4][4]"),
        ("/covariance", one(17, 1e6), "covariance[17][17]"),
    ];
    for (pointer, value, part) in cases {
        let mut changed = parsed("calibration_set/calibration.json");
        changed["covariance"] = json!(null);
        *changed.pointer_mut(pointer).unwrap() = value.clone();
        let error = parse_calibration(changed.to_string().as_bytes(), "head.json");
        expect(error, ErrorKind::InvalidCalibration, &["head.json: ", part]);
    }
}

#[test]
fn a_lens_without_an_inverse_is_refused() {
    for (term, value) in [("p1", 5.0), ("p2", 1e200), ("k1", 1e308), ("k3", 1e5), ("k1", -3.0)] {
        let mut changed = parsed("calibration_set/calibration.json");
        changed["camera"][term] = json!(value);
        let error = parse_calibration(changed.to_string().as_bytes(), "head.json");
        let named = format!("camera.{term} is {value:?}");
        expect(error, ErrorKind::InvalidCalibration, &["head.json: ", &named, "no inverse at pixel"]);
    }
    // The strongest terms that rendered heads have.
    let mut changed = parsed("calibration_set/calibration.json");
    for (term, value) in [("p1", 0.01), ("p2", -0.01), ("k3", -0.2)] {
        changed["camera"][term] = json!(value);
    }
    assert!(parse_calibration(changed.to_string().as_bytes(), "head.json").is_ok());
}

#[test]
fn a_covariance_that_no_parameters_have_is_refused() {
    // Three parameters of which each two go against each other by `apart`: possible up to a half.
    let with = |apart: f64| {
        let entry = |i: usize, j: usize| match (i, j) {
            (i, j) if i == j && i < 3 => 1e-4,
            (0..3, 0..3) => -apart * 1e-4,
            _ => 0.0,
        };
        let row = |i: usize| (0..18).map(|j| entry(i, j)).collect::<Vec<f64>>();
        let rows: Vec<_> = (0..18).map(row).collect();
        let mut changed = parsed("calibration_set/calibration.json");
        changed["covariance"] = json!(rows);
        parse_calibration(changed.to_string().as_bytes(), "head.json")
    };
    for possible in [0.0, 0.4, 0.5, 0.5 + 1e-9] {
        assert!(with(possible).is_ok(), "{possible}");
    }
    expect(with(0.9), ErrorKind::InvalidCalibration, &["head.json: covariance: ", "eigenvalue of -8.00e-1"]);
}

#[test]
fn unknown_keys_are_ignored() {
    let bytes = broken("calibration_set/calibration.json", "/camera/skew", Some(json!(0.5)));
    let mut value: Value = serde_json::from_slice(&bytes).unwrap();
    value["later"] = json!({"version": 3});
    value["camera"]["k3"] = json!(null);
    assert!(parse_calibration(value.to_string().as_bytes(), "head.json").unwrap().camera().skew > 0.4);
}

#[test]
fn broken_recordings_name_file_and_field() {
    let table: &[(&str, Option<Value>, &[&str])] = &[
        (
            "/format",
            Some(json!("boxline-recording/9")),
            &["format", "/9", "\"boxline-recording/1\" is needed"],
        ),
        ("/device/serial", None, &["device: missing field `serial`"]),
        ("/calibration", Some(json!(null)), &["calibration: invalid type: null, expected a string"]),
        ("/calibration", Some(json!("/etc/calibration.json")), &["calibration: ", "is absolute"]),
        ("/calibration", Some(json!("a\0b")), &["calibration: ", "NUL"]),
        ("/frames", Some(json!({})), &["frames: invalid type: map, expected a sequence"]),
        (
            "/frames/1",
            Some(json!("a.jpg")),
            &["frames[1]: invalid type: string \"a.jpg\", expected an object"],
        ),
        ("/frames/1/file", None, &["frames[1]: missing field `file`"]),
        ("/frames/1/id", Some(json!("a")), &["frames[1].id: another frame has the same id"]),
        (
            "/frames/2/role",
            Some(json!("lid")),
            &["frames[2].role: unknown variant `lid`, expected `face` or `board`"],
        ),
        ("/frames/2/laser", Some(json!(true)), &["frames[2].laser: "]),
    ];
    for (pointer, value, parts) in table {
        let bytes = broken("b02/recording.json", pointer, value.clone());
        expect(parse_recording(&bytes, "x/recording.json", Path::new("x")), ErrorKind::InvalidFile, parts);
    }
    expect(read_recording(&data("nowhere")), ErrorKind::Io, &["nowhere/recording.json: no such file"]);
    expect(read_calibration(&data("b02")), ErrorKind::Io, &["b02: cannot read"]);
    expect(read_truth(&data("b02/a.jpg")), ErrorKind::Io, &["a.jpg/truth.json: cannot read"]);
}

#[test]
fn broken_truths_and_boards_name_file_and_field() {
    let truths: &[(&str, Option<Value>, &[&str])] = &[
        ("/box_mm", Some(json!([1, 2])), &["box_mm: invalid length 2, expected an array of length 3"]),
        ("/faces", None, &["missing field `faces`"]),
        ("/faces/0/frame", None, &["faces[0]: missing field `frame`"]),
        (
            "/faces/0/corners_px/3",
            Some(json!([1])),
            &["faces[0].corners_px[3]: invalid length 1, expected an array of length 2"],
        ),
        (
            "/faces/1/key_points_px",
            Some(json!({"stripe 5": []})),
            &["faces[1].key_points_px", "unknown variant `stripe 5`, expected one of `stripe 1`"],
        ),
        (
            "/faces/1/key_points_px",
            Some(json!({"stripe 2": [[1, 2]]})),
            &["faces[1].key_points_px: 1 points of stripe 2, two or none are needed"],
        ),
        ("/faces/1/ambient", Some(json!(7)), &["faces[1].ambient: invalid type: integer `7`"]),
        (
            "/faces/0/notes/hazards",
            Some(json!("film")),
            &["faces[0].notes.hazards: invalid type: string \"film\", expected a sequence"],
        ),
        (
            "/faces/0/notes/bulge_mm",
            Some(json!({"front": "2"})),
            &["faces[0].notes.bulge_mm: a number is needed"],
        ),
        ("/faces/0/stripe_ends", Some(json!([{"stripe": 5}])), &["stripe_ends[0].stripe: found 5, 1 to 4"]),
        (
            "/faces/0/stripe_ends",
            Some(json!([{"stripe": 1, "end": 0, "side": 3, "class": "seam"}])),
            &["faces[0].stripe_ends[0].class: unknown variant `seam`, expected one of `convex`, `farther`"],
        ),
        ("/faces/0/false_lines", Some(json!([{"side": 4}])), &["false_lines[0].side: found 4, 0 to 3"]),
        (
            "/faces/1/hidden",
            Some(json!({"stripe_ends": [[1, 0], [2]]})),
            &["faces[1].hidden.stripe_ends[1]: invalid length 1, expected a tuple of size 2"],
        ),
        (
            "/faces/1/off",
            Some(json!({"cam_from_on": {"rotation_mrad": [0, 0, 0]}})),
            &["faces[1].off.cam_from_on: missing field `translation_mm`"],
        ),
        (
            "/faces/1/notes/distance_mm",
            Some(json!("far")),
            &["faces[1].notes.distance_mm: invalid type: string \"far\""],
        ),
        (
            "/faces/1/notes/neighbours",
            Some(json!([7])),
            &["faces[1].notes.neighbours[0]: invalid type: integer `7`"],
        ),
    ];
    for (pointer, value, parts) in truths {
        let bytes = broken("b02/truth.json", pointer, value.clone());
        expect(parse_truth(&bytes, "truth.json"), ErrorKind::InvalidFile, parts);
    }
    let boards: &[(&str, Option<Value>, &[&str])] = &[
        ("/kind", Some(json!("checkerboard")), &["kind: unknown variant `checkerboard`, expected `circles`"]),
        ("/columns", Some(json!(12.5)), &["columns: invalid type: floating point `12.5`, expected u64"]),
        ("/rows", Some(json!(1_000_000)), &["rows: found 1000000, 2 to 1000 are allowed"]),
        ("/rows", Some(json!(1000)), &["rows: 12000 circles with columns, at most 10000 are allowed"]),
        (
            "/pitch_mm",
            Some(json!(-100)),
            &["pitch_mm: invalid value: floating point `-100.0`, expected a positive number"],
        ),
        ("/pitch_mm", Some(json!(0.1)), &["pitch_mm: found 0.1, 1 to 1000 mm are allowed"]), // in metres
        ("/diameter_mm", Some(json!(0.05)), &["diameter_mm: found 0.05, 1 to 1000 mm are allowed"]),
        ("/diameter_mm", Some(json!(100)), &["diameter_mm: found 100, less than pitch_mm (100) is needed"]),
        ("/thickness_mm", None, &["missing field `thickness_mm`"]),
    ];
    for (pointer, value, parts) in boards {
        let bytes = broken("calibration_set/board.json", pointer, value.clone());
        expect(parse_board(&bytes, "board.json"), ErrorKind::InvalidFile, parts);
    }
}

#[test]
fn a_file_over_the_limit_is_refused() {
    let path = scratch("large").join("calibration.json");
    // A sparse file: no disk space is taken.
    std::fs::File::create(&path).unwrap().set_len(65 * 1024 * 1024).unwrap();
    expect(
        read_calibration(&path),
        ErrorKind::InvalidFile,
        &["calibration.json: larger than 67108864 bytes"],
    );
}

/// JSON that looks like the real thing more often than random bytes do.
fn json_like() -> impl Strategy<Value = Value> {
    let key = prop::sample::select(vec![
        "format",
        "serial",
        "image_size",
        "camera",
        "fx",
        "laser_planes",
        "device",
        "calibration",
        "frames",
        "id",
        "file",
        "role",
        "faces",
        "frame",
        "corners_px",
        "key_points_px",
        "stripe 1",
        "box_mm",
        "columns",
        "pitch_mm",
    ]);
    let leaf = prop_oneof![
        Just(json!(null)),
        Just(json!("boxline-calibration/1")),
        Just(json!("boxline-recording/1")),
        Just(json!("boxline-board/1")),
        any::<bool>().prop_map(|x| json!(x)),
        any::<f64>().prop_map(|x| json!(x)),
        any::<i64>().prop_map(|x| json!(x)),
        ".{0,8}".prop_map(|x| json!(x)),
    ];
    leaf.prop_recursive(5, 64, 6, move |inner| {
        prop_oneof![
            prop::collection::vec(inner.clone(), 0..5).prop_map(Value::Array),
            prop::collection::vec((key.clone(), inner), 0..8)
                .prop_map(|entries| entries.into_iter().map(|(k, v)| (k.to_owned(), v)).collect::<Value>()),
        ]
    })
}

fn read_as_everything(bytes: &[u8]) {
    // Only that they return is tested.
    drop(parse_calibration(bytes, "x"));
    drop(parse_recording(bytes, "x", Path::new("x")));
    drop(parse_truth(bytes, "x"));
    drop(parse_board(bytes, "x"));
}

proptest! {
    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        read_as_everything(&bytes);
    }

    #[test]
    fn random_json_never_panics(value in json_like()) {
        read_as_everything(value.to_string().as_bytes());
    }

    #[test]
    fn a_flipped_byte_never_panics(
        file in prop::sample::select(vec![
            "calibration_set/calibration.json", "calibration_set/board.json", "b02/recording.json", "b02/truth.json",
        ]),
        at in any::<prop::sample::Index>(),
        byte in any::<u8>(),
    ) {
        let mut bytes = std::fs::read(data(file)).unwrap();
        let at = at.index(bytes.len());
        bytes[at] = byte;
        read_as_everything(&bytes);
    }
}
