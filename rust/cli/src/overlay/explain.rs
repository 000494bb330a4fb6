//! `boxline measure --explain`: one picture a stage and frame, of what each stage found, and one of the box. What the stages found comes from
//! the library ([`Trace`]); nothing is computed again.

use super::canvas::{Canvas, Color, DARK};
use super::{BAD, EDGE_POINT, GOOD, Headline, LASERS, MARGIN, Panel, View, WARNING, WHITE, draw, mix};
use anyhow::Context;
use boxline::trace::{LaserResponse, Stage, Trace, TracedLine, TracedOutline, TracedPlane, TracedStripe};
use boxline::{BoxReport, Channel, FaceMaps, FaceMeasurement, FaceOutcome, Frame, LaserId, Px};
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::thumbnail;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Width of the pictures, px: so that one has some 50 kB.
const PICTURE_WIDTH: u32 = 720;
const QUALITY: u8 = 60;
/// Height of the text above each: a title and two lines.
const HEADER: u32 = 92;
const TITLE: f32 = 30.0;
const TEXT: f32 = 19.0;
/// Colours of the two ridge maps: of stripes 1 and 2, of 3 and 4.
const PAIRS: [Color; 2] = [[0, 229, 255], [255, 92, 255]];
/// From where a ridge is drawn, and where it has its full colour, sigmas.
const RIDGE_SIGMAS: [f32; 2] = [2.0, 3.0];

/// What the stages found in each frame. Frames are told apart by their address.
pub struct Stages<'a> {
    frames: &'a [&'a Frame],
    found: Mutex<Vec<StageFindings>>,
}

#[derive(Default)]
struct StageFindings {
    maps: Option<FaceMaps>,
    /// Sigmas of both pairs at each px of the small picture, rows top to bottom.
    response: Option<[Vec<f32>; 2]>,
    planes: Vec<TracedPlane>,
    /// One for each plane on which stripes were followed.
    tries: Vec<PlaneFindings>,
}

struct PlaneFindings {
    stripes: [TracedStripe; 4],
    outlines: Option<(Vec<TracedLine>, Vec<TracedOutline>)>,
}

impl<'a> Stages<'a> {
    /// Of these frames, before they are measured.
    pub fn new(frames: &'a [&'a Frame]) -> Self {
        Self { frames, found: Mutex::new(frames.iter().map(|_| StageFindings::default()).collect()) }
    }
}

impl Trace for Stages<'_> {
    fn found(&self, frame: &Frame, stage: &Stage<'_>) {
        let mut found = self.found.lock().unwrap_or_else(PoisonError::into_inner);
        let index = self.frames.iter().position(|known| std::ptr::eq(*known, frame));
        let Some(found) = index.and_then(|index| found.get_mut(index)) else { return };
        match *stage {
            Stage::Network(maps) => found.maps = Some(maps.clone()),
            Stage::Planes { response, planes } => {
                // A second search that finds nothing leaves what the first one found.
                if found.response.is_some() && planes.is_empty() {
                    return;
                }
                let small = Small::of(frame);
                found.response = Some([0, 1].map(|pair| small.map(|at| mean_response(response, pair, at))));
                found.planes = planes.to_vec();
                found.tries.clear();
            }
            Stage::Stripes(stripes) => {
                found.tries.push(PlaneFindings { stripes: stripes.clone(), outlines: None });
            }
            Stage::Outlines { lines, outlines } => {
                if let Some(last) = found.tries.last_mut() {
                    last.outlines = Some((lines.to_vec(), outlines.to_vec()));
                }
            }
            _ => {}
        }
    }
}

/// Of four pixels that one px of the picture covers.
fn mean_response(response: LaserResponse<'_>, pair: usize, at: Px) -> f32 {
    let around = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)];
    around.map(|(u, v)| response.sigmas(pair, Px::new(at.u + u, at.v + v))).iter().sum::<f32>() / 4.0
}

/// A frame made small enough for a picture.
struct Small {
    width: u32,
    height: u32,
    scale: f64,
}

impl Small {
    fn of(frame: &Frame) -> Self {
        let scale = f64::from(PICTURE_WIDTH) / frame.width_px() as f64;
        Self {
            width: PICTURE_WIDTH,
            height: ((frame.height_px() as f64 * scale).round() as u32).max(1),
            scale,
        }
    }

    /// A value for each px, rows top to bottom, from the frame's px at its middle.
    fn map(&self, value: impl Fn(Px) -> f32) -> Vec<f32> {
        let px = |x: u32| (f64::from(x) + 0.5) / self.scale - 0.5;
        (0..self.height)
            .flat_map(|y| (0..self.width).map(move |x| (x, y)))
            .map(|(x, y)| value(Px::new(px(x), px(y))))
            .collect()
    }
}

/// A picture of one stage: two lines of text over the frame.
struct Sheet {
    canvas: Canvas,
    panel: Panel,
}

impl Sheet {
    fn new(frame: &Frame, brightness: f32, title: &str, text: &str) -> anyhow::Result<Self> {
        let (width, height) = (u32::try_from(frame.width_px())?, u32::try_from(frame.height_px())?);
        let pixels =
            RgbImage::from_raw(width, height, frame.rgb().to_vec()).context("a frame without pixels")?;
        let small = Small::of(frame);
        let mut canvas = Canvas::new(small.width, small.height + HEADER)?;
        canvas.paste(&thumbnail(&pixels, small.width, small.height), 0, HEADER, brightness);
        canvas.text_from(title, TITLE, [MARGIN, 22.0], WHITE);
        for (row, line) in canvas.wrap(text, TEXT, small.width as f32 - 2.0 * MARGIN).iter().enumerate() {
            canvas.text_from(line, TEXT, [MARGIN, 50.0 + 24.0 * row as f32], WHITE);
        }
        let panel = Panel {
            left: 0.0,
            top: HEADER as f32,
            width: small.width as f32,
            height: small.height as f32,
            scale: small.scale,
            marks: 0.7,
        };
        Ok(Self { canvas, panel })
    }

    fn points(&mut self, points: &[Px], radius: f32, color: Color) {
        points.iter().for_each(|point| self.canvas.disc(self.panel.at(*point), radius, color));
    }

    fn line(&mut self, [from, to]: [Px; 2], width: f32, color: Color) {
        self.canvas.line(self.panel.at(from), self.panel.at(to), width, color);
    }

    /// Adds light of a colour, as much as `share` says of each px (0 to 1).
    fn light(&mut self, color: Color, share: &[f32]) {
        self.canvas.light([0, HEADER], self.panel.width as usize, color, share);
    }
}

/// Writes the pictures into a folder that appears whole or not at all: `a-1-frame.jpg` and so on for the first frame, up to the stage
/// that refused it, and `box.jpg`. Says how many.
pub fn write(folder: &Path, stages: Stages, report: &BoxReport, names: &[&str]) -> anyhow::Result<usize> {
    let failed = || format!("{}: cannot write the pictures", folder.display());
    let parent = match folder.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let unfinished = tempfile::Builder::new().prefix(".boxline-").tempdir_in(parent).with_context(failed)?;
    let mut count = 0;
    let mut save = |name: String, picture: &RgbImage| -> anyhow::Result<()> {
        let mut file = std::io::BufWriter::new(
            std::fs::File::create(unfinished.path().join(name)).with_context(failed)?,
        );
        JpegEncoder::new_with_quality(&mut file, QUALITY).encode_image(picture).with_context(failed)?;
        std::io::Write::flush(&mut file).with_context(failed)?;
        count += 1;
        Ok(())
    };
    let found = stages.found.into_inner().unwrap_or_else(PoisonError::into_inner);
    let frames = stages.frames.iter().zip(names).zip(&report.faces);
    let mut views = Vec::new();
    for ((letter, found), ((frame, name), face)) in ('a'..).zip(&found).zip(frames) {
        for (stage, picture) in pictures(frame, name, found, face)? {
            save(format!("{letter}-{stage}.jpg"), &picture)?;
        }
        let view = View { name, frame, face, truth: None };
        save(format!("{letter}-8-face.jpg"), &narrowed(&draw(&[view], &Headline::of_face(face))?))?;
        views.push(View { name, frame, face, truth: None });
    }
    save("box.jpg".into(), &narrowed(&draw(&views, &Headline::of_box(&report.outcome))?))?;
    super::make_folder_readable(unfinished.path()).with_context(failed)?;
    std::fs::rename(unfinished.path(), folder).with_context(failed)?;
    let _moved = unfinished.keep();
    Ok(count)
}

fn narrowed(picture: &RgbImage) -> RgbImage {
    let height = picture.height() * PICTURE_WIDTH / picture.width().max(1);
    thumbnail(picture, PICTURE_WIDTH, height.max(1))
}

/// The pictures of one frame's stages, but for the last.
fn pictures(
    frame: &Frame,
    name: &str,
    found: &StageFindings,
    outcome: &FaceOutcome,
) -> anyhow::Result<Vec<(&'static str, RgbImage)>> {
    let size = format!("{name}: {} x {} px", frame.width_px(), frame.height_px());
    let mut pictures = Vec::new();
    let mut add = |stage, sheet: Sheet| pictures.push((stage, sheet.canvas.into_image()));
    add("1-frame", Sheet::new(frame, 1.0, "1  The frame", &size)?);
    if let Some(maps) = &found.maps {
        add("2-network", network(frame, maps)?);
    }
    if let Some(response) = &found.response {
        let text = "In units of the noise beside it. Blue: along stripes 1 and 2; pink: along 3 and 4.";
        let mut sheet = Sheet::new(frame, 0.2, "3  Where red light makes a ridge", text)?;
        let [from, full] = RIDGE_SIGMAS;
        for (sigmas, color) in response.iter().zip(PAIRS) {
            let share: Vec<f32> = sigmas.iter().map(|s| (s - from) / (full - from)).collect();
            sheet.light(color, &share);
        }
        add("3-laser-light", sheet);
        add("4-planes", planes(frame, &found.planes)?);
    }
    let Some(tried) = shown(&found.tries, outcome) else { return Ok(pictures) };
    add("5-stripes", stripes(frame, &tried.stripes)?);
    if let Some((lines, outlines)) = &tried.outlines {
        add("6-outlines", self::outlines(frame, lines, outlines)?);
    }
    if let FaceOutcome::Measured(face) = outcome {
        add("7-edges", edges(frame, face)?);
    }
    Ok(pictures)
}

/// The plane that was measured was the last to be tried; of those that all refused, the one that got farthest.
fn shown<'a>(tries: &'a [PlaneFindings], outcome: &FaceOutcome) -> Option<&'a PlaneFindings> {
    match outcome {
        FaceOutcome::Measured(_) => tries.last(),
        FaceOutcome::Rejected(_) => tries.iter().find(|tried| tried.outlines.is_some()).or(tries.first()),
    }
}

fn network(frame: &Frame, maps: &FaceMaps) -> anyhow::Result<Sheet> {
    let [width, height] = maps.size();
    let text = format!(
        "{width} x {height} places. Each stripe in its colour, the face green, its edges white, other edges orange."
    );
    let mut sheet = Sheet::new(frame, 0.3, "2  What the network sees", &text)?;
    let small = Small::of(frame);
    let mut light = |channel, color, most: f32| {
        sheet.light(color, &small.map(|at| most * maps.at(channel, at)));
    };
    light(Channel::FaceMask, GOOD, 0.25);
    light(Channel::OtherEdge, WARNING, 0.7);
    light(Channel::FaceEdge, WHITE, 1.0);
    LaserId::ALL.into_iter().zip(LASERS).for_each(|(id, color)| light(Channel::Laser(id), color, 1.0));
    Ok(sheet)
}

fn planes(frame: &Frame, planes: &[TracedPlane]) -> anyhow::Result<Sheet> {
    let text = match planes {
        [] => "None.".to_owned(),
        [best, rest @ ..] => format!(
            "The best of {} found: evidence of {} sigmas along its four segments. They lie where one plane in space has them.",
            1 + rest.len(),
            best.strength.map(|strength| format!("{strength:.1}")).join(", ")
        ),
    };
    let mut sheet = Sheet::new(frame, 0.5, "4  Planes that carry a grid of four stripes", &text)?;
    for grid in planes.iter().skip(1) {
        grid.segments_px.iter().for_each(|segment| sheet.line(*segment, 2.0, [190, 190, 190]));
    }
    if let Some(best) = planes.first() {
        for (laser, (segment, color)) in best.segments_px.iter().zip(LASERS).enumerate() {
            sheet.line(*segment, 7.0, DARK);
            sheet.line(*segment, 4.0, color);
            let at = mix(sheet.panel.at(segment[0]), sheet.panel.at(segment[1]), 0.35);
            sheet.canvas.disc(at, 13.0, DARK);
            sheet.canvas.text_centered(&format!("{}", laser + 1), 22.0, at, 0.0, color);
        }
    }
    Ok(sheet)
}

fn stripes(frame: &Frame, stripes: &[TracedStripe; 4]) -> anyhow::Result<Sheet> {
    let centres: usize = stripes.iter().map(|stripe| stripe.on_plane_px.len()).sum();
    let text = format!(
        "{centres} centres lie on the plane (coloured), others do not (red). Rings: where a stripe leaves the plane."
    );
    let mut sheet = Sheet::new(frame, 0.5, "5  Stripes, followed to where they leave the plane", &text)?;
    for (stripe, color) in stripes.iter().zip(LASERS) {
        sheet.points(&stripe.beyond_px, 1.5, BAD);
        sheet.points(&stripe.on_plane_px, 2.6, DARK);
        sheet.points(&stripe.on_plane_px, 1.5, color);
        sheet.points(&stripe.ends_px, 8.0, WHITE);
        sheet.points(&stripe.ends_px, 5.0, DARK);
    }
    Ok(sheet)
}

fn outlines(frame: &Frame, lines: &[TracedLine], outlines: &[TracedOutline]) -> anyhow::Result<Sheet> {
    let likeliest_text = outlines.first().map_or_else(String::new, |likeliest| {
        format!(", the white one right with a probability of {:.3}", likeliest.probability)
    });
    let text = format!(
        "{} lines that may be a side (blue). Likely outlines: {}{likeliest_text}.",
        lines.len(),
        outlines.len()
    );
    let mut sheet = Sheet::new(frame, 0.5, "6  Lines that may be sides", &text)?;
    let around = |corners: &[Px; 4]| [0, 1, 2, 3].map(|k| [corners[k], corners[(k + 1) % 4]]);
    for outline in outlines.iter().skip(1) {
        around(&outline.corners_px).into_iter().for_each(|side| sheet.line(side, 2.0, WARNING));
    }
    if let Some(likeliest) = outlines.first() {
        around(&likeliest.corners_px).into_iter().for_each(|side| sheet.line(side, 5.0, WHITE));
    }
    lines.iter().for_each(|line| sheet.line(line.ends_px, 1.0 + line.share as f32, EDGE_POINT));
    Ok(sheet)
}

fn edges(frame: &Frame, face: &FaceMeasurement) -> anyhow::Result<Sheet> {
    let count: usize = face.edge_points_px.iter().map(Vec::len).sum();
    let text = format!(
        "{count} points where brightness changes most. One rectangle in space fits them and the stripes to {:.2} px rms.",
        face.rms_px
    );
    let mut sheet = Sheet::new(frame, 0.6, "7  Edge points of the four sides", &text)?;
    for points in &face.edge_points_px {
        sheet.points(points, 2.6, DARK);
        sheet.points(points, 1.6, EDGE_POINT);
    }
    Ok(sheet)
}
