//! Results as JSON: the object that `boxline measure --json` and `boxline face --json` print.
//!
//! The shape never changes: every key is there, an absent value is `null`, an absent list is `[]`. A number that is not
//! finite cannot be written in JSON and becomes `null` too.

use boxline::feasibility::Move;
use boxline::measurement::FaceMeasurement;
use boxline::{
    BoxMeasurement, BoxReport, Candidate, Estimate, FaceOutcome, FaceReport, Hint, Outcome, Px, Reject,
    SideLight, Straightness, SurfacePoint, Volume, Warning,
};
use serde_json::{Map, Value, json};

/// A box measurement. `hints` say how to move for each refused frame; `frame_ids` name the frames.
///
/// ```json
/// {"outcome": "measured" | "ambiguous" | "rejected",
///  "length_mm": {"value": 0, "sigma": 0, "interval_95": [low, high]}, "width_mm": {..}, "height_mm": {..}, "volume_m3": {..},
///  "candidates": [{"length_mm": {..}, "width_mm": {..}, "height_mm": {..}, "volume_m3": {..}}, ...],
///  "reject": {"reason": "no_box", "best_share": 0, ..., "text": "for people"},
///  "faces": [{"frame": "a", "outcome": "measured" | "rejected", "length_mm": {..}, "width_mm": {..},
///             "corners_px": [[u, v], "4 of them"], "key_points_px": {"1": [[u, v], [u, v]], "2": ..},
///             "plane": {"normal": [x, y, z], "distance_mm": 0}, "rms_px": 0,
///             "corner_angles_rad": [{"value": 0, "sigma": 0}, "4 of them, or null"], "warnings": [..], "reject": {..},
///             "surface_mm": [[along_length, along_width, height, sigma], "one a piece of a stripe"], "confidence": 0.97,
///             "straightness_mm": [{"sagitta": 0, "sigma": 0, "rms": 0}, "4 of them: corner 0-1, 1-2, 2-3, 3-0"],
///             "light": ["confirmed" | "dark" | "open" | "contradicted", "4 of them, or null"],
///             "enclosing_mm": {"length": {..}, "width": {..}},
///             "hint": {"text": "go 20 cm closer", "moves": [{"move": "closer", "by_mm": 200}]}}],
///  "enclosing_mm": {"length": {..}, "width": {..}, "height": {..}, "volume_m3": {..}},
///  "settled": {"depth_mm": {..}, "log_odds": 0, "stripes": 0},
///  "confidence": 0.93, "third_face_helps": false,
///  "likeliest": [{"length_mm": {..}, "width_mm": {..}, "height_mm": {..}, "volume_m3": {..}, "confidence": 0.5}, "two at most"],
///  "warnings": [{"kind": "sides_differ", "difference_mm": 0, .., "text": "for people"}]}
/// ```
/// The sides are there if the outcome is `measured`, the two candidates if it is `ambiguous`; `settled` if stripes on neighbouring
/// faces told an A x A x B box from A x B x B. `confidence` is the probability that the result is right, `null` on the paper's map;
/// `likeliest` the likeliest boxes of a refused one; `third_face_helps` that two frames leave open what a third may settle. The plane's unit normal points away from the camera (frame: camera). `surface_mm`
/// is how far the surface lies from the plane, towards the camera, at a position from the face's middle. The hint is `null` if the view
/// was not refused or moving does not help. `light` is what the stripes' light says of each side ([`boxline::SideLight`]).
/// `enclosing_mm` is the smallest rectangle of the face's direction, or box of the box's, that
/// encloses it, edges that bow (`sagitta`, positive outwards) and wave included.
#[must_use]
pub fn report_json(report: &BoxReport, frame_ids: &[&str]) -> Value {
    let (name, sides, candidates, reject) = match &report.outcome {
        Outcome::Measured(sides) => ("measured", Some(sides), Vec::new(), None),
        Outcome::Ambiguous(both) => ("ambiguous", None, both.iter().map(candidate).collect(), None),
        Outcome::Rejected(reject) => ("rejected", None, Vec::new(), Some(reject)),
    };
    let faces = report.faces.iter().zip(frame_ids).enumerate();
    let faces: Vec<_> = faces.map(|(i, (face, id))| face_entry(face, report.hint(i), id)).collect();
    json!({
        "outcome": name,
        "length_mm": sides.map(|s| estimate(s.length)),
        "width_mm": sides.map(|s| estimate(s.width)),
        "height_mm": sides.map(|s| estimate(s.height)),
        "volume_m3": sides.map(volume),
        "enclosing_mm": report.enclosing().map(|s| json!({
            "length": estimate(s.length), "width": estimate(s.width), "height": estimate(s.height), "volume_m3": volume(&s),
        })),
        "candidates": candidates,
        "reject": reject.map(reject_entry),
        "faces": faces,
        "settled": report.settled.map(|seen| json!({
            "depth_mm": estimate(seen.depth), "log_odds": seen.log_odds, "stripes": seen.stripes,
        })),
        "confidence": report.confidence,
        "likeliest": report.likeliest.iter().map(likely).collect::<Vec<_>>(),
        "third_face_helps": report.third_face_helps(),
        "warnings": report.warnings.iter().map(warning_entry).collect::<Vec<_>>(),
    })
}

/// One face: the same object as [`report_json`] with one entry in `faces`, whose sides are `length_mm` and `width_mm`.
#[must_use]
pub fn face_json(report: &FaceReport, frame_id: &str) -> Value {
    let entry = face_entry(&report.outcome, report.hint.as_ref(), frame_id);
    json!({
        "outcome": entry["outcome"],
        "length_mm": entry["length_mm"],
        "width_mm": entry["width_mm"],
        "height_mm": null,
        "volume_m3": null,
        "enclosing_mm": null,
        "candidates": [],
        "reject": entry["reject"],
        "faces": [entry],
        "settled": null,
        "confidence": entry["confidence"],
        "likeliest": [],
        "third_face_helps": false,
        "warnings": [],
    })
}

fn hint_entry(hint: &Hint) -> Value {
    let entry = |one: &Move| {
        let mut entry = Map::new();
        entry.insert("move".to_owned(), json!(one.name()));
        entry.extend(one.numbers().into_iter().map(|(name, value)| (name.to_owned(), json!(value))));
        Value::Object(entry)
    };
    json!({"text": hint.to_string(), "moves": hint.moves.iter().map(entry).collect::<Vec<_>>()})
}

fn face_entry(face: &FaceOutcome, hint: Option<&Hint>, frame_id: &str) -> Value {
    let (name, face, reject) = match face {
        FaceOutcome::Measured(face) => ("measured", Some(face.as_ref()), None),
        FaceOutcome::Rejected(reject) => ("rejected", None, Some(reject)),
    };
    json!({
        "frame": frame_id,
        "outcome": name,
        "length_mm": face.map(|f| estimate(f.length)),
        "width_mm": face.map(|f| estimate(f.width)),
        "corners_px": face.map(|f| f.corners_px.map(px)),
        "key_points_px": face.map(key_points),
        "plane": face.map(plane),
        "rms_px": face.map(|f| f.rms_px),
        "corner_angles_rad": face.and_then(|f| f.corner_angles).map(|a| {
            a.map(|a| json!({"value": a.value_rad, "sigma": a.sigma_rad}))
        }),
        "warnings": face.map_or_else(Vec::new, |f| f.warnings.iter().map(warning_entry).collect()),
        "reject": reject.map(reject_entry),
        "surface_mm": face.map_or_else(Vec::new, |f| f.surface.iter().map(surface_point).collect()),
        "straightness_mm": face.map_or_else(Vec::new, |f| f.straightness.iter().map(straightness_entry).collect()),
        "light": face.and_then(|f| f.light).map(|light| light.map(SideLight::name)),
        "enclosing_mm": face.map(|f| json!({"length": estimate(f.enclosing[0]), "width": estimate(f.enclosing[1])})),
        "hint": hint.map(hint_entry),
        "confidence": face.and_then(|f| f.confidence),
    })
}

fn straightness_entry(side: &Straightness) -> Value {
    json!({"sagitta": side.sagitta.value_mm, "sigma": side.sagitta.sigma_mm, "rms": side.rms_mm})
}

fn surface_point(point: &SurfacePoint) -> [f64; 4] {
    let [x, y] = point.at_mm;
    [x, y, point.height.value_mm, point.height.sigma_mm]
}

fn candidate(sides: &BoxMeasurement) -> Value {
    json!({
        "length_mm": estimate(sides.length),
        "width_mm": estimate(sides.width),
        "height_mm": estimate(sides.height),
        "volume_m3": volume(sides),
    })
}

fn likely(likeliest: &Candidate) -> Value {
    let mut entry = candidate(&likeliest.sides);
    entry["confidence"] = json!(likeliest.confidence);
    entry
}

fn reject_entry(reject: &Reject) -> Value {
    with_numbers(("reason", reject.reason()), &reject.numbers(), &reject.to_string())
}

fn warning_entry(warning: &Warning) -> Value {
    with_numbers(("kind", warning.kind.name()), &warning.numbers(), &warning.to_string())
}

fn with_numbers((key, name): (&str, &str), numbers: &[(&str, f64)], text: &str) -> Value {
    let mut entry = Map::new();
    entry.insert(key.to_owned(), json!(name));
    entry.extend(numbers.iter().map(|&(name, value)| (name.to_owned(), json!(value))));
    entry.insert("text".to_owned(), json!(text));
    Value::Object(entry)
}

fn key_points(face: &FaceMeasurement) -> Value {
    let stripes = face.key_points_px.iter().enumerate();
    stripes.map(|(i, points)| ((i + 1).to_string(), json!(points.map(px)))).collect::<Map<_, _>>().into()
}

fn plane(face: &FaceMeasurement) -> Value {
    let (normal, distance_mm) = face.plane.normal_and_distance_mm();
    json!({"normal": [normal.x, normal.y, normal.z], "distance_mm": distance_mm})
}

fn estimate(estimate: Estimate) -> Value {
    json!({"value": estimate.value_mm, "sigma": estimate.sigma_mm, "interval_95": estimate.interval_95_mm()})
}

fn volume(sides: &BoxMeasurement) -> Value {
    let Volume { value_m3, sigma_m3 } = sides.volume;
    json!({"value": value_m3, "sigma": sigma_m3, "interval_95": sides.volume.interval_95_m3()})
}

fn px(px: Px) -> [f64; 2] {
    [px.u, px.v]
}
