//! Results and the other messages: the JSON object that scripts rely on, and protobuf there and back.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

#[path = "support/samples.rs"]
mod samples;

use boxline::calibration::{CalibrationCovariance, PAPER_PARAMETERS, PARAMETERS};
use boxline::feasibility::Move;
use boxline::measurement::FaceMeasurement;
use boxline::{
    BoxReport, ErrorKind, Estimate, FaceOutcome, FaceReport, Hint, LaserId, Outcome, Px, Reject, WarningKind,
};
use boxline_proto::json::{face_json, parse_calibration, parse_recording, report_json};
use boxline_proto::message::{
    DecodedReport, decode_calibration, decode_recording, decode_report, encode_calibration, encode_recording,
    encode_report, v1,
};
use proptest::prelude::*;
use prost::Message;
use samples::{face, report, sides, warning};
use serde_json::{Value, json};
use std::path::Path;

/// One face of a report as a report of its own.
fn alone(report: &BoxReport, face: usize) -> FaceReport {
    FaceReport { outcome: report.faces[face].clone(), hint: report.hint(face).cloned(), times: Vec::new() }
}

fn hidden(in_front_mm: Option<f64>) -> Reject {
    Reject::FaceHidden {
        sides_hidden: 1,
        at: Px::new(900.5, 20.0),
        probability: 0.9,
        limit: 0.5,
        in_front_mm,
    }
}

fn every_reject() -> Vec<Reject> {
    let laser = LaserId::new(3).unwrap();
    vec![
        Reject::NoBox { best_share: 0.25, needed_share: 0.75 },
        Reject::StripeNotFound { laser, seen_share: 0.1, needed_share: 0.4 },
        Reject::StripeMissing { laser, stripes_on_face: 3 },
        Reject::FaceCutByBorder { sides_cut: 2, at: Px::new(10.25, -0.5) },
        Reject::FaceNotPlanar { rms_px: 3.0, limit_px: 2.0 },
        Reject::RectangleOpen { sides_found: 3 },
        Reject::OutlineUnsure { support: 0.3, needed_support: 0.4, overlap: 0.7, needed_overlap: 0.8 },
        hidden(None),
        hidden(Some(160.0)),
        Reject::TooFar { distance_mm: 3300.0, limit_mm: 2500.0 },
        Reject::NotARectangle { rms_px: 3.0, limit_px: 2.0 },
        Reject::SidesDisagree {
            first: Estimate::new(1.0, 0.1),
            second: Estimate::new(2.0, 0.2),
            limit_mm: 0.5,
        },
    ]
}

/// Value and sigma as the object has them, with the interval of 95 %.
fn estimate(value: f64, sigma: f64) -> Value {
    json!({"value": value, "sigma": sigma, "interval_95": [value - 1.96 * sigma, value + 1.96 * sigma]})
}

#[test]
fn a_measured_box_as_json() {
    let warning_entries = WarningKind::ALL.map(warning_entry);
    let between = warning_entry(WarningKind::SidesDiffer);
    let straightness = [0.5, -0.25, 0.0, 1.0].map(|mm| json!({"sagitta": mm, "sigma": 0.125, "rms": 0.75}));
    let corner_angles = [1.57, 1.58, 1.56, 1.572].map(|value| json!({"value": value, "sigma": 1e-3}));
    let entry = json!({
        "frame": "a", "outcome": "measured",
        "length_mm": estimate(550.5, 0.25), "width_mm": estimate(300.0, 0.1),
        "corners_px": [[1.0, 2.0], [3.0, 4.5], [-5.0, 6.0], [7.0, 0.1]],
        "key_points_px": {
            "1": [[0.0, 10.0], [0.0, 20.0 / 3.0]], "2": [[1.0, 10.0], [1.0, 20.0 / 3.0]],
            "3": [[2.0, 10.0], [2.0, 20.0 / 3.0]], "4": [[3.0, 10.0], [3.0, 20.0 / 3.0]],
        },
        "plane": {"normal": [0.0, 0.0, 1.0], "distance_mm": 1000.0}, "rms_px": 0.4, "reject": null,
        "corner_angles_rad": corner_angles,
        "warnings": warning_entries, "surface_mm": [[-20.0, 30.5, 1.25, 0.125]],
        "straightness_mm": straightness, "light": ["confirmed", "dark", "open", "contradicted"],
        "enclosing_mm": {"length": estimate(551.5, 0.5), "width": estimate(300.5, 0.25)},
        "hint": null, "confidence": 0.9375,
    });
    let reject = json!({"reason": "rectangle_open", "sides_found": 3.0,
                        "text": "only 3 of 4 sides of the face were found"});
    let rejected = json!({
        "frame": "b", "outcome": "rejected", "length_mm": null, "width_mm": null, "corners_px": null,
        "key_points_px": null, "plane": null, "rms_px": null, "reject": reject,
        "corner_angles_rad": null, "warnings": [], "surface_mm": [],
        "straightness_mm": [], "light": null, "enclosing_mm": null,
        "hint": {"text": "roll the head by 11 degrees clockwise, go 20 cm closer", "moves": [
            {"move": "roll", "clockwise_rad": 0.2}, {"move": "closer", "by_mm": 200.0}]},
        "confidence": null,
    });
    let measured = report(Outcome::Measured(sides(300.0)));
    // What the face needs beyond its sides.
    let around = [(551.5, 0.5), (350.5, 0.2), (300.5, 0.25)];
    let relative2: f64 = around.iter().map(|(mm, sigma): &(f64, f64)| (sigma / mm).powi(2)).sum();
    let around_m3 = around.iter().map(|(mm, _)| mm * 1e-3).product::<f64>() * relative2.sqrt();
    let expected = json!({
        "outcome": "measured",
        "length_mm": estimate(550.5, 0.25), "width_mm": estimate(350.5, 0.2),
        "height_mm": estimate(300.0, 0.1), "volume_m3": estimate(0.0579, 0.0001),
        "enclosing_mm": {
            "length": estimate(551.5, 0.5), "width": estimate(350.5, 0.2), "height": estimate(300.5, 0.25),
            "volume_m3": estimate(around.iter().map(|(mm, _)| mm * 1e-3).product(), around_m3),
        },
        "candidates": [], "reject": null, "faces": [entry, rejected],
        "warnings": [between],
        "settled": {"depth_mm": estimate(300.5, 2.0), "log_odds": 14.5, "stripes": 3},
        "confidence": 0.75, "likeliest": [], "third_face_helps": false,
    });
    assert_eq!(report_json(&measured, &["a", "b"]), expected);
    assert!(
        report_json(&measured, &["a", "b"]).to_string().starts_with("{\"outcome\":"),
        "people read it from the top"
    );

    let expected = json!({
        "outcome": "measured",
        "length_mm": estimate(550.5, 0.25), "width_mm": estimate(300.0, 0.1),
        "height_mm": null, "volume_m3": null, "enclosing_mm": null, "candidates": [], "reject": null, "faces": [entry], "warnings": [],
        "settled": null, "confidence": 0.9375, "likeliest": [], "third_face_helps": false,
    });
    assert_eq!(face_json(&alone(&measured, 0), "a"), expected);
    let expected = json!({
        "outcome": "rejected", "length_mm": null, "width_mm": null, "height_mm": null, "volume_m3": null,
        "enclosing_mm": null, "candidates": [], "reject": reject, "faces": [rejected], "warnings": [],
        "settled": null, "confidence": null, "likeliest": [], "third_face_helps": false,
    });
    assert_eq!(face_json(&alone(&measured, 1), "b"), expected);
}

fn warning_entry(kind: WarningKind) -> Value {
    let warning = warning(kind);
    let [found, sigma] = kind.number_names();
    let mut entry = json!({
        "kind": kind.name(), found: -0.5, sigma: 0.125, "chi_square": 16.0, "limit": 10.83, "text": warning.to_string(),
    });
    if warning.laser.is_some() {
        entry["laser"] = json!(2.0);
    }
    entry
}

#[test]
fn ambiguous_and_rejected_boxes_as_json() {
    let both = report_json(&report(Outcome::Ambiguous([sides(300.0), sides(350.5)])), &["a", "b"]);
    assert_eq!(
        (&both["outcome"], &both["length_mm"], &both["reject"]),
        (&json!("ambiguous"), &Value::Null, &Value::Null)
    );
    assert_eq!(both["candidates"][1]["height_mm"], estimate(350.5, 0.1));
    assert_eq!(both["candidates"].as_array().unwrap().len(), 2);
    for reject in every_reject() {
        let object = report_json(&report(Outcome::Rejected(reject.clone())), &["a", "b"]);
        assert_eq!(object["reject"]["reason"], reject.reason());
        assert_eq!(object["reject"]["text"], reject.to_string());
        assert_eq!(object["confidence"], Value::Null);
        assert_eq!(object["likeliest"][0]["height_mm"], estimate(310.0, 0.1));
        assert_eq!(object["likeliest"][0]["confidence"], 0.5);
        let settled_by_a_third =
            ["outline_unsure", "face_hidden", "sides_disagree"].contains(&reject.reason());
        assert_eq!(object["third_face_helps"], settled_by_a_third, "{reject}");
        for (name, value) in reject.numbers() {
            assert_eq!(object["reject"][name], value);
        }
    }
}

#[test]
fn a_number_that_is_not_finite_is_null() {
    let face = FaceMeasurement { rms_px: f64::NAN, ..face() };
    let outcome = FaceOutcome::Measured(Box::new(face));
    let object = face_json(&FaceReport { outcome, hint: None, times: Vec::new() }, "a");
    assert_eq!(object["faces"][0]["rms_px"], Value::Null);
}

#[test]
fn reports_there_and_back() {
    let mut outcomes =
        vec![Outcome::Measured(sides(300.0)), Outcome::Ambiguous([sides(300.0), sides(350.5)])];
    outcomes.extend(every_reject().into_iter().map(Outcome::Rejected));
    for outcome in outcomes {
        let report = report(outcome);
        let bytes = encode_report(&report, &["a", "b"]);
        let frame_ids = vec!["a".to_owned(), "b".to_owned()];
        assert_eq!(decode_report(&bytes).unwrap(), DecodedReport { report, frame_ids });
    }
}

#[test]
fn every_move_there_and_back() {
    let moves = vec![
        Move::Closer(Some(120.5)),
        Move::Closer(None),
        Move::Farther(Some(80.0)),
        Move::Farther(None),
        Move::RollClockwise(-0.5),
        Move::Aim { right_rad: 0.25, down_rad: -0.125 },
        Move::LookStraighter(0.75),
    ];
    let mut report = report(Outcome::Measured(sides(300.0)));
    report.hints = vec![Some(Hint { moves }), None];
    let bytes = encode_report(&report, &["a", "b"]);
    assert_eq!(decode_report(&bytes).unwrap().report.hints, report.hints);
}

#[test]
fn calibrations_and_recordings_there_and_back() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data");
    let json = std::fs::read(data.join("calibration_set/calibration.json")).unwrap();
    let calibration = parse_calibration(&json, "x").unwrap();
    assert_eq!(decode_calibration(&encode_calibration(&calibration)).unwrap(), calibration);
    let mut more: serde_json::Value = serde_json::from_slice(&json).unwrap();
    for (term, value) in [("p1", 0.0078), ("p2", -0.003), ("k3", 0.05)] {
        more["camera"][term] = value.into();
    }
    let more = parse_calibration(more.to_string().as_bytes(), "x").unwrap();
    assert_eq!(decode_calibration(&encode_calibration(&more)).unwrap(), more);
    for (calibration, size) in [(&calibration, PAPER_PARAMETERS), (&more, PARAMETERS)] {
        // Every number is another one; those of the planes are as small as theirs.
        let covariance = CalibrationCovariance::from_fn(|i, j| {
            let (low, high) = (i.min(j), i.max(j));
            let own = |i: usize| if (6..PAPER_PARAMETERS).contains(&i) { 1e-6 } else { 1e-3 };
            let part = if i == j { 1.0 } else { 0.01 / (1 + low + 7 * high) as f64 };
            if high < size { own(i) * own(j) * part } else { 0.0 }
        });
        let known = calibration.clone().with_covariance(covariance).unwrap();
        let bytes = encode_calibration(&known);
        assert_eq!(decode_calibration(&bytes).unwrap(), known);
        assert!(bytes.len() < 2500, "{} bytes for the head's store", bytes.len());
        // As a program reads it that does not know the field, and as one reads a store from before it.
        let mut message = v1::Calibration::decode(&bytes[..]).unwrap();
        assert_eq!(message.covariance.len(), size * (size + 1) / 2);
        message.covariance.clear();
        let unknown = decode_calibration(&message.encode_to_vec()).unwrap();
        assert_eq!((unknown.covariance(), unknown.camera()), (None, known.camera()));
        for (broken, needed) in
            [(vec![1.0; 170], "covariance: found 170"), (vec![f64::NAN; 171], "covariance[0][0]")]
        {
            message.covariance = broken;
            let error = decode_calibration(&message.encode_to_vec()).unwrap_err().to_string();
            assert!(error.contains(needed), "{error}");
        }
    }
    let json = std::fs::read(data.join("b02/recording.json")).unwrap();
    let recording = parse_recording(&json, "x", Path::new("x")).unwrap();
    assert_eq!(decode_recording(&encode_recording(&recording).unwrap(), Path::new("x")).unwrap(), recording);
}

#[test]
fn three_faces_go_round_as_well() {
    let mut report = report(Outcome::Measured(sides(300.0)));
    report.faces.push(FaceOutcome::Measured(Box::new(face())));
    report.hints.push(None);
    let decoded = decode_report(&encode_report(&report, &["a", "b", "c"])).unwrap();
    assert_eq!(decoded.report, report);
    assert_eq!(decoded.frame_ids, ["a", "b", "c"]);
    assert_eq!(report_json(&report, &["a", "b", "c"])["faces"][2]["frame"], "c");
}

#[test]
fn broken_messages_name_the_field() {
    let whole = || {
        let bytes = encode_report(&report(Outcome::Measured(sides(1.0))), &["a", "b"]);
        v1::BoxReport::decode(&bytes[..]).unwrap()
    };
    type Breaking = fn(&mut v1::BoxReport);
    let table: [(Breaking, &str); 16] = [
        (|m| m.outcome = 0, "outcome: missing"),
        (|m| m.outcome = 9, "outcome: 9 is not known"),
        (|m| m.sides = None, "sides: missing"),
        (|m| m.outcome = v1::Outcome::Ambiguous.into(), "candidates: found 0, 2 are needed"),
        (|m| m.sides.as_mut().unwrap().height = None, "height: missing"),
        (
            |m| m.sides.as_mut().unwrap().volume.as_mut().unwrap().value_m3 = f64::INFINITY,
            "volume: found inf",
        ),
        (|m| drop(m.faces.pop()), "faces: found 1, 2 or 3 are needed"),
        (|m| m.faces[0].corners.truncate(3), "faces[0]: corners: found 3, 4 are needed"),
        (|m| m.faces[0].corners[2].px = None, "faces[0]: corners: missing"),
        (|m| m.faces[0].rms_px = f64::NAN, "faces[0]: rms_px: found NaN"),
        (|m| m.faces[1].reject.as_mut().unwrap().reason = "mood".into(), "faces[1]: reject.reason: \"mood\""),
        (
            |m| m.faces[1].reject.as_mut().unwrap().numbers[0].value = 0.5,
            "faces[1]: reject.sides_found: found 0.5",
        ),
        (
            |m| {
                let reject = hidden(Some(f64::NAN));
                let numbers = reject.numbers().into_iter();
                let numbers = numbers.map(|(name, value)| v1::Number { name: name.into(), value }).collect();
                let reason = reject.reason().into();
                m.faces[1].reject = Some(v1::Reject { reason, numbers, text: String::new() });
            },
            "faces[1]: in_front_mm: found NaN",
        ),
        (|m| m.faces[1].hint.as_mut().unwrap().moves.clear(), "faces[1]: hint.moves: at least one is needed"),
        (
            |m| m.faces[1].hint.as_mut().unwrap().moves[0].kind = "jump".into(),
            "faces[1]: hint.move: \"jump\" is not known",
        ),
        (
            |m| m.faces[1].hint.as_mut().unwrap().moves[1].numbers[0].value = f64::NAN,
            "faces[1]: hint.by_mm: found NaN",
        ),
    ];
    for (breaking, part) in table {
        let mut message = whole();
        breaking(&mut message);
        let error = decode_report(&message.encode_to_vec()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidFile);
        assert!(error.to_string().contains(part), "{part:?} is not in {error:?}");
    }
    let error = decode_calibration(&v1::Calibration::default().encode_to_vec()).unwrap_err();
    assert_eq!(
        (error.kind(), error.to_string()),
        (ErrorKind::InvalidCalibration, "camera: missing".to_owned())
    );
    assert!(decode_report(b"\xff\xff\xff").unwrap_err().to_string().contains("boxline.v1.BoxReport"));
}

fn decode_as_everything(bytes: &[u8]) {
    // Only that they return is tested.
    drop(decode_report(bytes));
    drop(decode_calibration(bytes));
    drop(decode_recording(bytes, Path::new("x")));
}

proptest! {
    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        decode_as_everything(&bytes);
    }

    #[test]
    fn a_flipped_byte_never_panics(at in any::<prop::sample::Index>(), byte in any::<u8>()) {
        let mut bytes = encode_report(&report(Outcome::Measured(sides(300.0))), &["a", "b"]);
        let at = at.index(bytes.len());
        bytes[at] = byte;
        decode_as_everything(&bytes);
    }
}
