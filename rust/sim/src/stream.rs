//! Labelled small frames without end, for training: the format `boxline-stream/1` that `rust/edgenet/training` reads.
//!
//! First a line of JSON padded to 128 bytes, then per frame: seed (u64), length of the meta data (u32, both little-endian),
//! meta data (JSON), RGB bytes, label bytes.

use crate::error::Error;
use crate::head::{Head, SENSOR_PX};
use crate::labels::{CHANNELS, labels};
use crate::pose::Refuse;
use crate::raster::Raster;
use crate::render::sensor::Sensor;
use crate::render::{Film, Options, Stage, expose_film};
use crate::rng::Rng;
use crate::stock::Stock;
use crate::truth::face_of;
use crate::world::{Plan, Scene, View, compose};
use boxline::image::small::SMALL;
use serde_json::json;
use std::io::Write;

/// Size of the frames, px.
pub const FRAME_PX: [usize; 2] = SMALL;

/// One labelled frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Everything follows from it.
    pub seed: u64,
    /// What there is to know beside the pixels, JSON.
    pub meta: String,
    /// Pixels, three bytes each.
    pub rgb: Vec<u8>,
    /// Labels, one channel after the other at half size.
    pub labels: Vec<u8>,
}

/// A small frame and what it was developed from.
pub(crate) struct SmallFrame<'a> {
    pub stage: Stage<'a>,
    pub film: Film,
    /// Pixels, three bytes each.
    pub rgb: Vec<u8>,
}

/// Renders a view of a scene with the lasers on.
pub(crate) fn small_frame<'a>(
    scene: &Scene,
    view: &View,
    head: &Head,
    stock: &'a Stock,
    rng: &mut Rng,
) -> SmallFrame<'a> {
    let raster = Raster::covering(SENSOR_PX, FRAME_PX[0], FRAME_PX[1]);
    let options = Options { lasers: true, speckle: true, seed: u64::from(rng.bits()) };
    let stage = Stage::new(scene, view, head, raster, &stock.photos, options);
    let film = expose_film(&stage);
    let rgb = Sensor::random(rng, scene.light.noise).develop(&film, raster.scale() as f32, rng);
    SmallFrame { stage, film, rgb }
}

/// Renders the frame of a seed with materials of the stock's split.
///
/// # Errors
/// None in practice: core would have to refuse fifty heads in a row.
pub fn sample(seed: u64, stock: &Stock) -> Result<Sample, Error> {
    let head = Head::random(&mut Rng::new(seed, 11))?;
    let mut rng = Rng::new(seed, 12);
    let plan = match rng.unit() {
        x if x < 0.72 => Plan::Face,
        x if x < 0.80 => Plan::Refused(Refuse::Hidden),
        x if x < 0.86 => Plan::Refused(Refuse::StripeMissing),
        x if x < 0.92 => Plan::Refused(Refuse::CutByBorder),
        x if x < 0.96 => Plan::Refused(Refuse::NoBox),
        _ => Plan::Refused(Refuse::LaserDead),
    };
    let mut scene = compose(&mut rng, &head, plan, stock);
    // Training needs faint stripes too, down to those that nobody sees.
    if rng.chance(0.35) {
        scene.light.laser_to_ambient *= rng.log_range(0.08, 1.0);
    }
    let view = scene.views[0];
    let SmallFrame { stage, film, rgb } = small_frame(&scene, &view, &head, stock, &mut rng);
    let pose = face_of(&scene, &view);
    let labels = labels(&stage, &film, &head, pose.as_ref().map(|p| (p, view.face)));
    let contrast = labels.contrast.map(|c| (f64::from(c) * 10.0).round() / 10.0);
    let meta = json!({
        "contrast": contrast,
        "measurable": scene.refuse.is_none() && contrast.iter().all(|c| *c > 0.0),
        "refuse": scene.refuse.map(Refuse::word),
        "ambient": scene.light.ambient,
        "hazards": scene.hazards.iter().map(|h| h.word()).collect::<Vec<_>>(),
        "base": scene.words.base,
        "stand": scene.words.stand,
        "size_mm": pose.map(|p| p.size_mm()),
        "split": stock.split.word(),
        "materials": scene.materials(stock),
        "distance_mm": pose.map(|p| p.centre.norm().round()),
    });
    Ok(Sample { seed, meta: meta.to_string(), rgb, labels: labels.bytes })
}

/// The header of a stream, 128 bytes.
#[must_use]
pub fn header() -> String {
    let [w, h] = FRAME_PX;
    padded(&format!(
        r#"{{"format":"boxline-stream/1","w":{w},"h":{h},"lw":{},"lh":{},"channels":{}}}"#,
        w / 2,
        h / 2,
        CHANNELS.len()
    ))
}

/// A header of 128 bytes.
pub(crate) fn padded(text: &str) -> String {
    format!("{text:<127}\n")
}

/// Writes header and frames of the seeds `first ..` until `count` are written (without end if `None`) or the reader
/// goes away, which is no error.
///
/// # Errors
/// Writing fails for another reason.
pub fn write_stream(
    out: &mut impl Write,
    first: u64,
    count: Option<u64>,
    stock: &Stock,
) -> Result<(), Error> {
    write_frames(out, &header(), first, count, |seed| {
        let sample = sample(seed, stock)?;
        Ok((sample.meta, vec![sample.rgb, sample.labels]))
    })
}

/// The same for any kind of frame: meta data and bytes of a seed.
pub(crate) fn write_frames(
    out: &mut impl Write,
    header: &str,
    first: u64,
    count: Option<u64>,
    frame: impl Fn(u64) -> Result<(String, Vec<Vec<u8>>), Error>,
) -> Result<(), Error> {
    let wrote = |result: std::io::Result<()>| match result {
        Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(false),
        Err(e) => Err(Error::new("stream", e)),
        Ok(()) => Ok(true),
    };
    let mut going = wrote(out.write_all(header.as_bytes()))?;
    let mut seed = first;
    while going && count.is_none_or(|n| seed - first < n) {
        let (meta, parts) = frame(seed)?;
        let mut put = || {
            out.write_all(&seed.to_le_bytes())?;
            out.write_all(&(meta.len() as u32).to_le_bytes())?;
            out.write_all(meta.as_bytes())?;
            parts.iter().try_for_each(|bytes| out.write_all(bytes))
        };
        going = wrote(put())?;
        seed += 1;
    }
    Ok(())
}
