//! Exact truth of a frame, in the words of the recordings' format.

use crate::head::Head;
use crate::pose::{Along, FacePose, px_of};
use crate::stock::Stock;
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

/// The entry of one frame in `faces`.
#[must_use]
pub fn face_truth(head: &Head, scene: &Scene, view: &View, id: &str) -> Value {
    let mut entry = Map::new();
    entry.insert("frame".into(), json!(id));
    entry.insert("ambient".into(), json!(scene.light.ambient));
    let hazards: Vec<&str> = scene.hazards.iter().map(|h| h.word()).collect();
    if let Some(reason) = scene.refuse {
        entry.insert("refuse".into(), json!(reason.word()));
    }
    let (Some(face), Some(target)) = (face_of(scene, view), scene.target.map(|t| &scene.bodies[t])) else {
        entry.insert("notes".into(), json!({}));
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
        let told = json!({
            "sides": hidden.sides().collect::<Vec<_>>(),
            "corners": hidden.corners,
            "stripe_ends": ends,
            "in_front_mm": round(hidden.in_front_mm, 2),
        });
        entry.insert("hidden".into(), told);
    }
    entry.insert("key_points_px".into(), Value::Object(points_px));
    entry.insert("key_points_cam_mm".into(), Value::Object(points_mm));
    entry.insert("runs_along".into(), Value::Object(along));
    entry.insert(
        "notes".into(),
        json!({
            "base": scene.words.base,
            "stand": scene.words.stand,
            "neighbours": scene.words.neighbours,
            "hazards": hazards,
            "edge_radius_mm": round(target.radius_mm, 3),
            "bulge_mm": round(f64::from(target.bulge_mm[view.face]), 3),
            "gloss": round(f64::from(target.look.gloss), 3),
            "laser_to_ambient_at_1m": round(scene.light.laser_to_ambient, 3),
            "distance_mm": round(face.centre.norm(), 2),
            "angle_to_normal_deg": round(face.angle_to_normal_rad().to_degrees(), 2),
            "face": FACE_WORDS[view.face],
        }),
    );
    Value::Object(entry)
}

/// The whole `truth.json`.
#[must_use]
pub fn truth(head: &Head, scenes: &[(&Scene, &View, String)], whole_box: bool, stock: &Stock) -> Value {
    let face = |(scene, view, id): &(&Scene, &View, String)| {
        let mut truth = face_truth(head, scene, view, id);
        truth["notes"]["materials"] = json!(scene.materials(stock));
        truth
    };
    let faces: Vec<Value> = scenes.iter().map(face).collect();
    let sizes = scenes.first().filter(|_| whole_box).and_then(|(scene, ..)| {
        let target = &scene.bodies[scene.target?];
        let mut sides: Vec<f64> = (target.half * 2.0).iter().map(|s| round(*s, 4)).collect();
        sides.sort_by(|a, b| b.total_cmp(a));
        Some(sides)
    });
    let mut all = json!({"box_mm": sizes, "faces": faces});
    if scenes.iter().any(|(scene, ..)| scene.refuse.is_some()) {
        all["must_refuse"] = json!(true);
    }
    all
}
