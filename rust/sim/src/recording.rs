//! Writes recordings in the standard format: frames, `recording.json`, `truth.json`, `calibration.json`.

use crate::board::{Faults, render_board};
use crate::error::Error;
use crate::head::{Head, HeadKind, SENSOR_PX};
use crate::pose::{Refuse, px_of};
use crate::raster::Raster;
use crate::render::sensor::{Optics, Sensor};
use crate::render::{Options, Stage, Window, expose_film, expose_film_around};
use crate::rng::Rng;
use crate::stock::Stock;
use crate::tremor::Motion;
use crate::truth::{Shot, face_of, truth};
use crate::world::{Plan, Scene, View, compose};
use boxline::Px;
use jpeg_encoder::{ChromaSubsamplingMethod, ColorType, Encoder, SamplingFactor};
use serde_json::{Value, json};
use std::path::Path;

/// What a recording folder is to hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Two adjacent faces of one box.
    Box,
    /// Three adjacent faces of one box.
    Three,
    /// Two faces of a box A x A x B of which both frames show A x B ([`Plan::Twins`]).
    Twins,
    /// This many single faces of different boxes.
    Faces(usize),
    /// This many frames that must be refused.
    Refuse(usize),
    /// This many faces that something hides in part, which must be refused too.
    Occluded(usize),
    /// This many frames of the circle board.
    Board(usize),
}

/// How the head is held from the lit picture to the unlit one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeadHold {
    /// By a hand, which moves.
    Hand,
    /// On a stand, which does not.
    Still,
}

/// How finely frames are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// Each pixel by itself.
    Everywhere,
    /// Only the face and what borders it; the rest as coarsely as the networks see it. For those that learn from faces.
    AroundFace,
}

/// How a frame is taken.
#[derive(Clone, Copy, Debug)]
pub struct Exposure {
    /// Whether the lasers are on.
    pub lasers: bool,
    /// Lens, motion, noise and speckle follow from it.
    pub seed: u64,
    /// Which optics.
    pub optics: Optics,
    /// How finely it is drawn.
    pub detail: Detail,
    /// Of a sensor that is tilted ([`Raster::keystone_per_px`]).
    pub keystone_per_px: [f64; 2],
}

impl Exposure {
    /// With the lasers on, optics as one finds them, a sensor that faces its lens.
    #[must_use]
    pub const fn of(seed: u64, detail: Detail) -> Self {
        Self { lasers: true, seed, optics: Optics::AsFound, detail, keystone_per_px: [0.0; 2] }
    }
}

/// What to write.
#[derive(Clone, Copy, Debug)]
pub struct Recipe {
    /// Everything follows from it.
    pub seed: u64,
    /// Which frames.
    pub kind: Kind,
    /// Adds the frames with the lasers off, held so.
    pub off: Option<HeadHold>,
    /// Which head.
    pub head: HeadKind,
    /// What is wrong with a board and the head that sees it.
    pub faults: Faults,
    /// How finely.
    pub detail: Detail,
}

impl Recipe {
    /// A random head, nothing wrong with it, no frames with the lasers off, everything drawn finely.
    #[must_use]
    pub fn new(seed: u64, kind: Kind) -> Self {
        let (head, faults) = (HeadKind::default(), Faults::default());
        Self { seed, kind, off: None, head, faults, detail: Detail::Everywhere }
    }
}

/// What is drawn finely around a face, sensor px: as far as stripes and edges beside it tell where it ends.
const AROUND_FACE_PX: f64 = 160.0;

/// A frame as the head delivers it: 2592 x 1944, RGB bytes.
#[must_use]
pub fn full_frame(
    head: &Head,
    scene: &Scene,
    view: &View,
    lasers: bool,
    seed: u64,
    stock: &Stock,
) -> Vec<u8> {
    let exposure = Exposure { lasers, ..Exposure::of(seed, Detail::Everywhere) };
    expose_full_frame(head, scene, view, &exposure, stock)
}

/// The same, taken otherwise.
#[must_use]
pub fn expose_full_frame(
    head: &Head,
    scene: &Scene,
    view: &View,
    exposure: &Exposure,
    stock: &Stock,
) -> Vec<u8> {
    let Exposure { lasers, seed, optics, detail, keystone_per_px } = *exposure;
    // What belongs to the view (lens, motion, balance) is the same with lasers off; noise and speckle are not.
    let mut of_view = Rng::new(seed, 0x5E45);
    let sensor = Sensor::random(&mut of_view, scene.light.noise).with_optics(optics);
    let mut of_frame = Rng::new(seed, 0xF0A0 + u64::from(lasers));
    let options = Options { lasers, speckle: true, seed: u64::from(of_frame.bits()) };
    let stage = Stage::new(
        scene,
        view,
        head,
        Raster::full(SENSOR_PX).tilted(keystone_per_px),
        &stock.photos,
        options,
    );
    let film = match detail {
        Detail::Everywhere => expose_film(&stage),
        Detail::AroundFace => expose_film_around(&stage, around_face(head, scene, view)),
    };
    sensor.develop(&film, 1.0, &mut of_frame)
}

/// Columns and rows around a view's face; all if there is none or a corner is behind the camera.
fn around_face(head: &Head, scene: &Scene, view: &View) -> Window {
    let corners = face_of(scene, view).map(|pose| pose.corners().map(|corner| px_of(head, &corner)));
    let corners: Option<Vec<Px>> = corners.and_then(|corners| corners.into_iter().collect());
    let span = |place: fn(&Px) -> f64, end: u32| {
        let Some(corners) = &corners else { return [0, end as usize] };
        let (low, high) =
            corners.iter().map(place).fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(x), h.max(x)));
        // Casts saturate: what is to the left of the frame begins at 0.
        [(low - AROUND_FACE_PX) as usize, ((high + AROUND_FACE_PX) as usize).min(end as usize)]
    };
    [span(|px| px.u, SENSOR_PX[0]), span(|px| px.v, SENSOR_PX[1])]
}

/// Encodes a full frame as JPEG with the quality that its seed says (85 to 95).
///
/// # Errors
/// The encoder refuses (a wrong size: a bug here).
pub fn jpeg(rgb: &[u8], seed: u64) -> Result<Vec<u8>, Error> {
    let mut rng = Rng::new(seed, 0x73E6);
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, 85 + rng.below(11) as u8);
    encoder.set_sampling_factor(if rng.chance(0.7) { SamplingFactor::F_2_2 } else { SamplingFactor::F_1_1 });
    // The encoder's default takes each block's first pixel, which shifts red stripes by half a pixel, as no camera does.
    encoder.set_chroma_subsampling_method(ChromaSubsamplingMethod::Average);
    let [w, h] = SENSOR_PX.map(|n| n as u16);
    encoder.encode(rgb, w, h, ColorType::Rgb).map_err(|e| Error::new("jpeg", e))?;
    Ok(bytes)
}

/// Renders and writes a recording into a folder, which is made if it is not there.
///
/// # Errors
/// A file cannot be written.
pub fn write_recording(folder: &Path, recipe: &Recipe, stock: &Stock) -> Result<(), Error> {
    std::fs::create_dir_all(folder).map_err(|e| Error::file(folder, e))?;
    render_recording(recipe, stock, |name, bytes| {
        let path = folder.join(name);
        std::fs::write(&path, bytes).map_err(|e| Error::file(&path, e))
    })
}

/// Renders a recording and hands over its files one by one, by name, as [`write_recording`] writes them.
///
/// # Errors
/// Whatever `put` says, or the head refuses.
pub fn render_recording(
    recipe: &Recipe,
    stock: &Stock,
    mut put: impl FnMut(&str, Vec<u8>) -> Result<(), Error>,
) -> Result<(), Error> {
    let Recipe { seed, kind, off, head, faults, detail } = *recipe;
    let head = Head::of_kind(head, &mut Rng::new(seed, 1))?;
    let mut rng = Rng::new(seed, 2);
    if let Kind::Board(n) = kind {
        return render_board(&head, n, &faults, &mut rng, stock, put);
    }
    let mut scenes = Vec::new();
    match kind {
        Kind::Board(_) => {}
        Kind::Box => scenes.push(compose(&mut rng, &head, Plan::Box, stock)),
        Kind::Three => scenes.push(compose(&mut rng, &head, Plan::Three, stock)),
        Kind::Twins => scenes.push(compose(&mut rng, &head, Plan::Twins, stock)),
        Kind::Faces(n) => {
            scenes.extend((0..n).map(|_| compose(&mut rng.child(), &head, Plan::Face, stock)));
        }
        Kind::Occluded(n) => {
            let plan = Plan::Refused(Refuse::Hidden);
            scenes.extend((0..n).map(|_| compose(&mut rng.child(), &head, plan, stock)));
        }
        Kind::Refuse(n) => {
            const REASONS: [Refuse; 4] =
                [Refuse::StripeMissing, Refuse::CutByBorder, Refuse::NoBox, Refuse::LaserDead];
            let first = rng.below(4);
            scenes.extend(
                (0..n).map(|i| {
                    compose(&mut rng.child(), &head, Plan::Refused(REASONS[(first + i) % 4]), stock)
                }),
            );
        }
    }
    let prefix = match kind {
        Kind::Box | Kind::Three | Kind::Twins | Kind::Board(_) => "",
        Kind::Faces(_) => "f",
        Kind::Refuse(_) => "r",
        Kind::Occluded(_) => "o",
    };
    let mut frames: Vec<Value> = Vec::new();
    let mut truths = Vec::new();
    let views = scenes.iter().flat_map(|s| s.views.iter().map(move |v| (s, v)));
    for (n, (scene, view)) in views.enumerate() {
        let id = match kind {
            Kind::Box | Kind::Three | Kind::Twins => ["a", "b", "c"][n % 3].to_owned(),
            _ => format!("{prefix}{:02}", n + 1),
        };
        let frame_seed = crate::rng::mix(seed) ^ n as u64;
        let motion = off.map(|hold| match hold {
            HeadHold::Hand => Motion::of_hand(&mut Rng::new(frame_seed, 0x7E30)),
            HeadHold::Still => Motion::still(),
        });
        let mut shots = vec![(id.clone(), "on", *view)];
        shots.extend(motion.map(|m| (format!("{id}_off"), "off", m.moved(view))));
        for (name, laser, view) in shots {
            let exposure = Exposure { lasers: laser == "on", ..Exposure::of(frame_seed, detail) };
            let rgb = expose_full_frame(&head, scene, &view, &exposure, stock);
            put(&format!("{name}.jpg"), jpeg(&rgb, frame_seed)?)?;
            frames.push(json!({"id": name, "file": format!("{name}.jpg"), "role": "face", "laser": laser}));
        }
        truths.push(Shot { scene, view, id, off: motion });
    }
    let recording = json!({
        "format": "boxline-recording/1",
        "device": {"serial": head.calibration.serial()},
        "calibration": "calibration.json",
        "frames": frames,
    });
    let mut put_json = |name: &str, value: &Value| {
        put(name, serde_json::to_vec_pretty(value).map_err(|e| Error::new(name, e))?)
    };
    put_json("recording.json", &recording)?;
    put_json("calibration.json", &head.calibration_json())?;
    let whole_box = matches!(kind, Kind::Box | Kind::Three | Kind::Twins);
    put_json("truth.json", &truth(&head, &truths, whole_box, stock))
}
