//! Exact truth of a frame, in the words of the recordings' format.

use crate::ends::{StripeEnd, side_of, stripe_ends};
use crate::head::Head;
use crate::pose::{Along, FacePose, px_of};
use crate::rivals::{FalseLine, false_lines};
use crate::stock::Stock;
use crate::tremor::Motion;
use crate::world::{Scene, View};
use serde_json::{Map, Value, json};

/// Names of the faces, by index.
const FACE_WORDS: [&str; 6] = ["right", "left", "back", "front", "top", "bottom"];

fn round(x: f64, digits: i32) -> f64 {
    let scale = 10f64.powi(digits);
    (x * scale).round() / scale
}

fn mm(p: nalgebra::Vector3<f64>) -> [f64; 3] {
    [round(p.x, 5), round(p.y, 5), round(p.z, 5)]
}

fn px(head: &Head, p: &nalgebra::Vector3<f64>) -> Value {
    px_of(head, p).map_or(Value::Null, |px| json!([round(px.u, 4), round(px.v, 4)]))
}

/// The face that a view looks at, if the scene has a target.
#[must_use]
pub fn face_of(scene: &Scene, view: &View) -> Option<FacePose> {
    scene.target.map(|t| scene.bodies[t].face(view.face, view))
}

/// A frame whose truth is to be told.
#[derive(Clone, Debug)]
pub struct Shot<'a> {
    /// What there is.
    pub scene: &'a Scene,
    /// Where the head was.
    pub view: &'a View,
    /// The frame's name.
    pub id: String,
    /// How the head had moved when the unlit picture was taken, if one was.
    pub off: Option<Motion>,
}

/// The entry of one frame in `faces`.
#[must_use]
pub fn face_truth(head: &Head, shot: &Shot<'_>, stock: &Stock) -> Value {
    let Shot { scene, view, id, off } = shot;
    let mut entry = Map::new();
    entry.insert("frame".into(), json!(id));
    entry.insert("ambient".into(), json!(scene.light.ambient));
    let hazards: Vec<&str> = scene.hazards.iter().map(|h| h.word()).collect();
    if let Some(reason) = scene.refuse {
        entry.insert("refuse".into(), json!(reason.word()));
    }
    if let Some(Motion { rotation_rad, translation_mm }) = off {
        let mrad = [0, 1, 2].map(|i| round(rotation_rad[i] * 1e3, 6));
        let motion = json!({"rotation_mrad": mrad, "translation_mm": mm(*translation_mm)});
        entry.insert("off".into(), json!({"cam_from_on": motion}));
    }
    let (Some(face), Some(target)) = (face_of(scene, view), scene.target.map(|t| &scene.bodies[t])) else {
        entry.insert("notes".into(), json!({"materials": scene.materials(stock)}));
        return Value::Object(entry);
    };
    let shining = scene.head(head);
    entry.insert("size_mm".into(), json!(face.size_mm().map(|s| round(s, 4))));
    entry.insert("corners_cam_mm".into(), json!(face.corners().map(mm)));
    entry.insert("corners_px".into(), json!(face.corners().map(|c| px(head, &c))));
    let (mut points_px, mut points_mm, mut along) = (Map::new(), Map::new(), Map::new());
    for laser in 0..4 {
        let name = format!("stripe {}", laser + 1);
        let lit = scene.beams[laser].power > 0.0;
        let Some(crossing) = face.crossing(&shining, laser, 0.0).filter(|_| lit) else { continue };
        let points = crossing.at.map(|[right, down]| face.point(right, down));
        points_px.insert(name.clone(), json!(points.map(|p| px(head, &p))));
        points_mm.insert(name.clone(), json!(points.map(mm)));
        let right_is_length = face.half[0] >= face.half[1];
        let is_length = (crossing.along == Along::Right) == right_is_length;
        along.insert(name, json!(if is_length { "length" } else { "width" }));
    }
    if let Some(hidden) = &scene.hidden {
        let ends: Vec<[usize; 2]> = hidden.stripe_ends.iter().map(|[laser, end]| [laser + 1, *end]).collect();
        let what = json!({
            "sides": hidden.sides().collect::<Vec<_>>(),
            "corners": hidden.corners,
            "stripe_ends": ends,
            "in_front_mm": round(hidden.in_front_mm, 2),
        });
        entry.insert("hidden".into(), what);
    }
    entry.insert("key_points_px".into(), Value::Object(points_px));
    entry.insert("key_points_cam_mm".into(), Value::Object(points_mm));
    entry.insert("runs_along".into(), Value::Object(along));
    let ends = stripe_ends(&shining, scene, view, &stock.photos);
    entry.insert("stripe_ends".into(), ends.iter().map(|end| end_truth(head, end)).collect());
    entry.insert("false_lines".into(), false_lines(&shining, scene, view).iter().map(line_truth).collect());
    let mut waves = [0.0; 4];
    for side in 0..4 {
        // The body counts them left, right, upper, lower.
        let wave = f64::from(target.edge_wave_mm(view.face, side));
        waves[side_of(&face, side / 2, side % 2 == 1)] = round(wave, 3);
    }
    entry.insert(
        "notes".into(),
        json!({
            "base": scene.words.base,
            "stand": scene.words.stand,
            "neighbours": scene.words.neighbours,
            "hazards": hazards,
            "edge_radius_mm": round(target.shape.radius_mm, 3),
            "bulge_mm": round(f64::from(target.shape.bulge_mm[view.face]), 3),
            "wave_mm": waves,
            "gloss": round(f64::from(target.look.gloss), 3),
            "laser_to_ambient_at_1m": round(scene.light.laser_to_ambient, 3),
            "distance_mm": round(face.centre.norm(), 2),
            "angle_to_normal_deg": round(face.angle_to_normal_rad().to_degrees(), 2),
            "face": FACE_WORDS[view.face],
            "materials": scene.materials(stock),
        }),
    );
    Value::Object(entry)
}

fn end_truth(head: &Head, end: &StripeEnd) -> Value {
    json!({
        "stripe": end.laser + 1,
        "end": end.end,
        "side": end.side,
        "class": end.class.word(),
        "at_px": px(head, &end.at_mm),
        "at_mm": mm(end.at_mm),
        "beyond_mm": end.beyond_mm.map(|b| round(b, 3)),
        "light_beyond": end.light_beyond,
    })
}

fn line_truth(line: &FalseLine) -> Value {
    json!({"side": line.side, "offset_mm": round(line.offset_mm, 3), "kind": line.kind})
}

/// The whole `truth.json`.
#[must_use]
pub fn truth(head: &Head, shots: &[Shot<'_>], whole_box: bool, stock: &Stock) -> Value {
    let faces: Vec<Value> = shots.iter().map(|shot| face_truth(head, shot, stock)).collect();
    let sizes = shots.first().filter(|_| whole_box).and_then(|Shot { scene, .. }| {
        let target = &scene.bodies[scene.target?];
        let mut sides: Vec<f64> = (target.half * 2.0).iter().map(|s| round(*s, 4)).collect();
        sides.sort_by(|a, b| b.total_cmp(a));
        Some(sides)
    });
    let mut all = json!({"box_mm": sizes, "faces": faces});
    if shots.iter().any(|shot| shot.scene.refuse.is_some()) {
        all["must_refuse"] = json!(true);
    }
    all
}
