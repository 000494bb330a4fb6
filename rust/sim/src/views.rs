//! Faces in their own plane with the true places of their sides, for training the network of sides: the format `boxline-views/1`.
//!
//! First a line of JSON padded to 128 bytes, then per face: seed (u64), length of the meta data (u32, both little-endian), meta data
//! (JSON), the view's values as bytes of 1/255 ([`boxline::view::FaceView`]).

use crate::error::Error;
use crate::head::Head;
use crate::pose::{FacePose, Refuse, inside, px_of};
use crate::rng::Rng;
use crate::stock::Stock;
use crate::stream::{FRAME_PX, padded, small_frame, write_frames};
use crate::truth::face_of;
use crate::world::{Hidden, Plan, compose};
use boxline::frames::{Plane, Point};
use boxline::image::small::SmallPicture;
use boxline::sides::ViewAxes;
use boxline::view::{BINS, VIEW};
use serde_json::json;
use std::io::Write;

/// One face.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ViewSample {
    /// Everything follows from it.
    pub seed: u64,
    /// What there is to know beside the pixels, JSON.
    pub meta: String,
    /// As [`VIEW`].
    pub values: Vec<u8>,
}

/// Shares of faces that are whole, and that something in front hides in part; the rest are cut by the border. More are hidden than in
/// warehouses, since what hides a face is the hardest to learn.
const WHOLE: f64 = 0.66;
const HIDDEN: f64 = 0.3;
/// The measured direction of a face is off by so much, degrees: mostly, and now and then.
const TURN_DEG: [f64; 2] = [0.4, 2.0];
const OFTEN_TURNED_MORE: f64 = 0.15;
/// The measured plane is off by so much: share of the distance, and tilt in rad.
const PLANE_OFF: f64 = 1e-3;
/// A side of which less than this share is in the picture is not in it.
const SEEN_SHARE: f64 = 0.3;

/// The face of a seed with materials of the stock's split.
///
/// # Errors
/// None in practice: core would have to refuse fifty heads in a row.
pub fn view_sample(seed: u64, stock: &Stock) -> Result<ViewSample, Error> {
    let head = Head::random(&mut Rng::new(seed, 21))?;
    let mut rng = Rng::new(seed, 22);
    loop {
        let plan = match rng.unit() {
            x if x < WHOLE => Plan::Face,
            x if x < WHOLE + HIDDEN => Plan::Refused(Refuse::Hidden),
            _ => Plan::Refused(Refuse::CutByBorder),
        };
        let mut scene = compose(&mut rng, &head, plan, stock);
        if rng.chance(0.2) {
            scene.light.laser_to_ambient *= rng.log_range(0.15, 1.0);
        }
        let view = scene.views[0];
        let Some(pose) = face_of(&scene, &view) else { continue };
        let Some(axes) = measured_axes(&head, &pose, &mut rng) else { continue };
        let rgb = small_frame(&scene, &view, &head, stock, &mut rng).rgb;
        let planes: Vec<f32> =
            (0..3).flat_map(|c| rgb.chunks_exact(3).map(move |px| f32::from(px[c]) / 255.0)).collect();
        let picture = SmallPicture { size: FRAME_PX, rgb: &planes };
        let values = axes.view(&picture, &head.calibration).values;
        let (bins, hidden) = sides(&head, &pose, &axes, scene.hidden.as_ref());
        let meta = json!({
            "bins": bins,
            "hidden": hidden,
            "in_front_mm": scene.hidden.as_ref().map(|h| h.in_front_mm.round()),
            "refuse": scene.refuse.map(Refuse::word),
            "hazards": scene.hazards.iter().map(|h| h.word()).collect::<Vec<_>>(),
            "neighbours": scene.words.neighbours,
            "size_mm": pose.size_mm(),
            "distance_mm": pose.centre.norm().round(),
            "angle_deg": pose.angle_to_normal_rad().to_degrees().round(),
        });
        let values = values.iter().map(|v| (v * 255.0 + 0.5) as u8).collect();
        return Ok(ViewSample { seed, meta: meta.to_string(), values });
    }
}

/// Axes as a measurement would have them. `None` if the stripes do not cross in front of the camera.
fn measured_axes(head: &Head, pose: &FacePose, rng: &mut Rng) -> Option<ViewAxes> {
    let normal = pose.cam_from_face.column(2).into_owned();
    let (right, down) = (pose.cam_from_face.column(0), pose.cam_from_face.column(1));
    let turn_deg = rng.normal() * TURN_DEG[usize::from(rng.chance(OFTEN_TURNED_MORE))];
    let normal = (normal + (right * rng.normal() + down * rng.normal()) * PLANE_OFF).normalize();
    let distance_mm = normal.dot(&pose.centre) * (1.0 + PLANE_OFF * rng.normal());
    let plane = Plane::new(normal / distance_mm);
    // Stripes 1 and 2 run along axis a.
    let p = head.plane(0);
    let run = p.cross(&normal).normalize();
    let (along, across) =
        if run.dot(&right).abs() > run.dot(&down).abs() { (right, down) } else { (down, right) };
    let along = along * run.dot(&along).signum();
    let (s, c) = turn_deg.to_radians().sin_cos();
    ViewAxes::along(&head.calibration, &plane, &(along * c + across * s))
}

/// The bin of each side, if it is in the picture, and whether something hides a piece of it.
fn sides(
    head: &Head,
    pose: &FacePose,
    axes: &ViewAxes,
    hidden: Option<&Hidden>,
) -> ([Option<f64>; 4], [bool; 4]) {
    let (mut bins, mut covered) = ([None; 4], [false; 4]);
    let corners = pose.corners();
    let centre = axes.on_plane_mm(&Point::from_vector(pose.centre));
    for k in 0..4 {
        let (from, to) = (corners[k], corners[(k + 1) % 4]);
        let [p, q] = [from, to].map(|corner| axes.on_plane_mm(&Point::from_vector(corner)));
        let along = usize::from((q[0] - p[0]).abs() < (q[1] - p[1]).abs());
        let across = 1 - along;
        let middle = 0.5 * (p[across] + q[across]);
        let side = 2 * across + usize::from(middle > centre[across]);
        const STEPS: usize = 20;
        let seen = (0..STEPS).filter(|i| {
            let at = from + (to - from) * ((*i as f64 + 0.5) / STEPS as f64);
            px_of(head, &at).is_some_and(|px| inside(px, 0.0))
        });
        let bin = axes.bin(side, middle);
        let in_view = seen.count() as f64 >= SEEN_SHARE * STEPS as f64 && bin < BINS as f64;
        bins[side] = in_view.then_some((bin * 100.0).round() / 100.0);
        covered[side] = hidden.is_some_and(|h| h.sides().any(|hidden| hidden == k));
    }
    (bins, covered)
}

/// Writes header and faces of the seeds `first ..`, as [`crate::stream::write_stream`].
///
/// # Errors
/// Writing fails because of something else than a reader that went away.
pub fn write_views(out: &mut impl Write, first: u64, count: Option<u64>, stock: &Stock) -> Result<(), Error> {
    let [channels, rows, columns] = VIEW;
    let header = padded(&format!(
        r#"{{"format":"boxline-views/1","w":{columns},"h":{rows},"channels":{channels},"bins":{BINS}}}"#
    ));
    write_frames(out, &header, first, count, |seed| {
        let sample = view_sample(seed, stock)?;
        Ok((sample.meta, vec![sample.values]))
    })
}
