//! The picture that shows what was found: the frames side by side with stripes, edges, corners, key points and sizes, below each how
//! flat the face is ([`surface`]), and the result in type that a phone screen can show. Takes results only; measures nothing.

mod canvas;
pub mod explain;
mod surface;

use crate::text;
use anyhow::Context;
use boxline::{BoxMeasurement, Estimate, FaceMeasurement, FaceOutcome, Frame, Outcome, Px, Reject};
use canvas::{Canvas, Color, DARK};
use image::RgbImage;
use std::path::Path;

/// Width of the picture in px: about that of a phone held upright, so that nothing becomes unreadable by scaling down.
const WIDTH: u32 = 1600;
const GAP: u32 = 8;
const MARGIN: f32 = 24.0;
/// The photograph is drawn a little darker than it is, for contrast with the marks; a refused one much darker.
const BRIGHTNESS: f32 = 0.85;
const BRIGHTNESS_REFUSED: f32 = 0.55;

/// Colours of lasers 1 to 4: far from each other, from red laser light and from cardboard.
const LASERS: [Color; 4] = [[0, 229, 255], [255, 235, 59], [255, 92, 255], [118, 255, 3]];
const WHITE: Color = [255, 255, 255];
const GOOD: Color = [125, 255, 150];
const WARNING: Color = [255, 200, 60];
const BAD: Color = [255, 120, 100];
const EDGE_POINT: Color = [64, 140, 255];
const TRUTH: Color = [255, 80, 40];

/// One frame with what was found in it.
pub struct View<'a> {
    /// The frame's name, written in its corner.
    pub name: &'a str,
    /// Its pixels.
    pub frame: &'a Frame,
    /// What was found.
    pub face: &'a FaceOutcome,
    /// The true corners, if they are known and to be shown.
    pub truth: Option<[Px; 4]>,
}

/// The result above the frames: one line in large type and a few smaller ones.
pub struct Headline {
    large: String,
    small: Vec<String>,
    color: Color,
}

impl Headline {
    /// The headline of a pair of frames.
    pub fn of_box(outcome: &Outcome) -> Self {
        let sides = |m: &BoxMeasurement| {
            format!("{:.1} × {:.1} × {:.1} mm", m.length.value_mm, m.width.value_mm, m.height.value_mm)
        };
        match outcome {
            Outcome::Measured(m) => Self {
                large: sides(m),
                small: vec![format!(
                    "±{:.2}  ±{:.2}  ±{:.2} mm (1σ),  volume {}",
                    m.length.sigma_mm,
                    m.width.sigma_mm,
                    m.height.sigma_mm,
                    text::volume(m.volume)
                )],
                color: GOOD,
            },
            Outcome::Ambiguous([first, second]) => Self {
                large: "Two boxes are possible".into(),
                small: vec![format!("1:  {}", sides(first)), format!("2:  {}", sides(second))],
                color: WARNING,
            },
            Outcome::Rejected(reject) => Self::of_reject(reject),
        }
    }

    /// The headline of a single frame.
    pub fn of_face(face: &FaceOutcome) -> Self {
        match face {
            FaceOutcome::Measured(m) => Self {
                large: format!("{:.1} × {:.1} mm", m.length.value_mm, m.width.value_mm),
                small: vec![format!(
                    "±{:.2}  ±{:.2} mm (1σ),  residuals {:.2} px rms",
                    m.length.sigma_mm, m.width.sigma_mm, m.rms_px
                )],
                color: GOOD,
            },
            FaceOutcome::Rejected(reject) => Self::of_reject(reject),
        }
    }

    /// The same of a result that is wrong, with a line that says so.
    pub fn wrong(mut self, line: String) -> Self {
        self.small.push(line);
        Self { color: BAD, ..self }
    }

    fn of_reject(reject: &Reject) -> Self {
        Self { large: "Not measured".into(), small: vec![reject.to_string()], color: BAD }
    }
}

/// Draws the frames (one or two) side by side under their headline.
pub fn draw(views: &[View<'_>], headline: &Headline) -> anyhow::Result<RgbImage> {
    let count = u32::try_from(views.len())?.max(1);
    let panel_width = (WIDTH - GAP * (count - 1)) / count;
    let mut panels = Vec::new();
    for view in views {
        let (width, height) = (u32::try_from(view.frame.width_px())?, u32::try_from(view.frame.height_px())?);
        let pixels =
            RgbImage::from_raw(width, height, view.frame.rgb().to_vec()).context("a frame without pixels")?;
        let scale = f64::from(panel_width) / f64::from(width);
        let panel_height = ((f64::from(height) * scale).round() as u32).max(1);
        panels.push((image::imageops::thumbnail(&pixels, panel_width, panel_height), scale));
    }
    let panels_height = panels.iter().map(|(picture, _)| picture.height()).max().unwrap_or(0);

    let mut canvas = Canvas::new(WIDTH, 1)?; // only to lay out the text
    let text_width = WIDTH as f32 - 2.0 * MARGIN;
    let small: Vec<String> =
        headline.small.iter().flat_map(|text| canvas.wrap(text, 42.0, text_width)).collect();
    let header_height = 116 + 52 * u32::try_from(small.len())?;
    let has_map = |view: &View| matches!(view.face, FaceOutcome::Measured(face) if !face.surface.is_empty());
    let maps_height = if views.iter().any(has_map) { surface::HEIGHT } else { 0 };
    canvas = Canvas::new(WIDTH, header_height + panels_height + maps_height)?;
    canvas.text_from(&headline.large, 92.0, [MARGIN, 60.0], headline.color);
    for (row, line) in small.iter().enumerate() {
        canvas.text_from(line, 42.0, [MARGIN, 130.0 + 52.0 * row as f32], WHITE);
    }

    for (index, (view, (picture, scale))) in views.iter().zip(&panels).enumerate() {
        let left = u32::try_from(index)? * (panel_width + GAP);
        let panel = Panel {
            left: left as f32,
            top: header_height as f32,
            width: picture.width() as f32,
            height: picture.height() as f32,
            scale: *scale,
            // One frame alone is drawn twice as large: its marks grow too, but less.
            marks: if count == 1 { 1.35 } else { 1.0 },
        };
        match view.face {
            FaceOutcome::Measured(face) => {
                canvas.paste(picture, left, header_height, BRIGHTNESS);
                panel.draw_face(&mut canvas, face);
                surface::draw(&mut canvas, face, [panel.left, panel.top + panels_height as f32], panel.width);
            }
            FaceOutcome::Rejected(reject) => {
                canvas.paste(picture, left, header_height, BRIGHTNESS_REFUSED);
                if let Reject::FaceCutByBorder { at, .. } = reject {
                    panel.draw_place(&mut canvas, *at);
                }
                // One frame alone has it in the headline.
                if count > 1 {
                    panel.draw_reject(&mut canvas, reject);
                }
            }
        }
        if let Some(corners) = view.truth {
            panel.draw_truth(&mut canvas, corners);
        }
        canvas.text_from(view.name, 36.0, [panel.left + 16.0, panel.top + 30.0], WHITE);
    }
    Ok(canvas.into_image())
}

/// Writes a picture so that it appears whole or not at all. The name's ending tells the format.
pub fn write(picture: &RgbImage, path: &Path) -> anyhow::Result<()> {
    let format = format_of(path)?;
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let failed = || format!("{}: cannot write the overlay", path.display());
    let mut file = tempfile::Builder::new().prefix(".boxline-").tempfile_in(folder).with_context(failed)?;
    picture.write_to(&mut std::io::BufWriter::new(file.as_file_mut()), format).with_context(failed)?;
    make_readable(file.as_file()).with_context(failed)?;
    file.persist(path).map_err(|e| e.error).with_context(failed)?;
    Ok(())
}

/// The format of an overlay's file, from its name.
pub fn format_of(path: &Path) -> anyhow::Result<image::ImageFormat> {
    match image::ImageFormat::from_path(path) {
        Ok(format @ (image::ImageFormat::Png | image::ImageFormat::Jpeg)) => Ok(format),
        _ => anyhow::bail!("{}: an overlay's name ends with .png or .jpg", path.display()),
    }
}

/// A temporary file is private; a picture that the user asked for is not.
#[cfg(unix)]
fn make_readable(file: &std::fs::File) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    file.set_permissions(std::fs::Permissions::from_mode(0o644))
}

/// The same of a folder.
#[cfg(unix)]
fn make_folder_readable(folder: &Path) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(folder, std::fs::Permissions::from_mode(0o755))
}

#[cfg(not(unix))]
fn make_folder_readable(_: &Path) -> std::io::Result<()> {
    Ok(())
}

#[cfg(not(unix))]
fn make_readable(_: &std::fs::File) -> std::io::Result<()> {
    Ok(())
}

/// Where a frame lies in the picture, and how much smaller it is.
struct Panel {
    left: f32,
    top: f32,
    width: f32,
    height: f32,
    scale: f64,
    marks: f32,
}

impl Panel {
    /// Sensor px to picture px, both with centres at integers.
    fn at(&self, px: Px) -> [f32; 2] {
        let small = |value: f64| ((value + 0.5) * self.scale - 0.5) as f32;
        [self.left + small(px.u), self.top + small(px.v)]
    }

    /// Moves a place into the panel, so that a label of this half size stays in it.
    fn inside(&self, [x, y]: [f32; 2], half_width: f32, half_height: f32) -> [f32; 2] {
        let keep = |value: f32, low: f32, size: f32, half: f32| {
            value.clamp(low + half.min(size / 2.0), low + size - half.min(size / 2.0))
        };
        [keep(x, self.left, self.width, half_width), keep(y, self.top, self.height, half_height)]
    }

    fn draw_face(&self, canvas: &mut Canvas, face: &FaceMeasurement) {
        let marks = self.marks;
        let corners = face.corners_px.map(|corner| self.at(corner));
        let middle = average(&corners);

        for (width, color) in [(7.0, DARK), (3.0, WHITE)] {
            for side in 0..4 {
                canvas.line(corners[side], corners[(side + 1) % 4], width * marks, color);
            }
        }
        for point in face.edge_points_px.iter().flatten() {
            canvas.disc(self.at(*point), 2.0 * marks, EDGE_POINT);
        }
        for (radius, halo) in [(3.4, true), (1.9, false)] {
            for (points, color) in face.stripe_points_px.iter().zip(LASERS) {
                for point in points {
                    canvas.disc(self.at(*point), radius * marks, if halo { DARK } else { color });
                }
            }
        }
        for corner in corners {
            canvas.disc(corner, 9.0 * marks, DARK);
            canvas.disc(corner, 6.0 * marks, WHITE);
        }
        let stripes = face.key_points_px.map(|ends| ends.map(|end| self.at(end)));
        for (laser, (ends, color)) in stripes.into_iter().zip(LASERS).enumerate() {
            for (index, end) in ends.into_iter().enumerate() {
                canvas.disc(end, 9.5 * marks, DARK);
                canvas.disc(end, 7.0 * marks, WHITE);
                canvas.disc(end, 4.5 * marks, color);
                let other = ends[1 - index];
                let outward = unit([end[0] - other[0], end[1] - other[1]]);
                let label = [end[0] + outward[0] * 26.0 * marks, end[1] + outward[1] * 26.0 * marks];
                let label = self.inside(label, 20.0 * marks, 14.0 * marks);
                canvas.text_centered(&format!("D{}", 2 * laser + index + 1), 25.0 * marks, label, 0.0, color);
            }
            let badge = badge_place(laser, &stripes);
            canvas.disc(badge, 17.0 * marks, DARK);
            canvas.disc(badge, 14.0 * marks, color);
            canvas.text_centered(&(laser + 1).to_string(), 27.0 * marks, badge, 0.0, WHITE);
        }
        self.draw_length(canvas, face.length, [[corners[0], corners[1]], [corners[3], corners[2]]], middle);
        self.draw_length(canvas, face.width, [[corners[1], corners[2]], [corners[0], corners[3]]], middle);
    }

    /// The true outline, above all that was found.
    fn draw_truth(&self, canvas: &mut Canvas, corners: [Px; 4]) {
        let corners = corners.map(|corner| self.at(corner));
        for (width, color) in [(5.0, DARK), (2.5, TRUTH)] {
            for side in 0..4 {
                canvas.line(corners[side], corners[(side + 1) % 4], width * self.marks, color);
            }
        }
    }

    /// Writes a length along one of two opposite sides: outside the face, near the middle of the side, and where the
    /// picture's border leaves room for it.
    fn draw_length(
        &self,
        canvas: &mut Canvas,
        length: Estimate,
        sides: [[[f32; 2]; 2]; 2],
        face_middle: [f32; 2],
    ) {
        let size = 36.0 * self.marks;
        let text = format!("{:.1} ±{:.2} mm", length.value_mm, length.sigma_mm);
        let half_width = canvas.text_width(&text, size) / 2.0;
        let mut best = (f32::INFINITY, face_middle, 0.0);
        for (share, [from, to]) in
            [0.5, 0.4, 0.6, 0.3, 0.7].into_iter().flat_map(|t| sides.map(|side| (t, side)))
        {
            let along = unit([to[0] - from[0], to[1] - from[1]]);
            // Left to right, so that it never stands on its head.
            let along = if along[0] < 0.0 { [-along[0], -along[1]] } else { along };
            let beside = mix(from, to, share);
            let mut outward = [-along[1], along[0]];
            if outward[0] * (beside[0] - face_middle[0]) + outward[1] * (beside[1] - face_middle[1]) < 0.0 {
                outward = [-outward[0], -outward[1]];
            }
            let wanted = [0, 1].map(|axis| beside[axis] + outward[axis] * 58.0 * self.marks);
            // The text is turned with the side: its upright extent is a mix of its width and its height.
            let reach_x = half_width * along[0].abs() + size / 2.0 * along[1].abs();
            let reach_y = half_width * along[1].abs() + size / 2.0 * along[0].abs();
            let at = self.inside(wanted, reach_x, reach_y);
            let moved = (at[0] - wanted[0]).hypot(at[1] - wanted[1]);
            if moved < best.0 {
                best = (moved, at, along[1].atan2(along[0]));
            }
        }
        let (_, at, angle_rad) = best;
        canvas.text_centered(&text, size, at, angle_rad, WHITE);
    }

    fn draw_reject(&self, canvas: &mut Canvas, reject: &Reject) {
        let size = 36.0 * self.marks;
        let lines = canvas.wrap(&reject.to_string(), size, self.width - 2.0 * MARGIN);
        let step = size * 1.25;
        let height = step * lines.len() as f32 + 20.0;
        let bottom = self.top + self.height;
        canvas.shade([self.left, bottom - height], [self.left + self.width, bottom], DARK, 0.7);
        for (row, line) in lines.iter().enumerate() {
            let y = bottom - height + 10.0 + step * (row as f32 + 0.5);
            canvas.text_from(line, size, [self.left + MARGIN, y], BAD);
        }
    }

    /// Marks the place that a refusal speaks of.
    fn draw_place(&self, canvas: &mut Canvas, place: Px) {
        let place = self.inside(self.at(place), 14.0, 14.0);
        canvas.disc(place, 16.0 * self.marks, DARK);
        canvas.disc(place, 12.0 * self.marks, BAD);
    }
}

/// Where the laser's number sits on its stripe: as far as can be from its ends and from the other stripes.
fn badge_place(laser: usize, stripes: &[[[f32; 2]; 2]; 4]) -> [f32; 2] {
    let [from, to] = stripes[laser];
    let room = |place: [f32; 2]| {
        let others = stripes.iter().enumerate().filter(|&(other, _)| other != laser);
        let crossing =
            others.map(|(_, [a, b])| distance_to_line(place, *a, *b)).fold(f32::INFINITY, f32::min);
        // The ends carry small marks only: half the distance is as good.
        [from, to]
            .map(|end| 2.0 * (place[0] - end[0]).hypot(place[1] - end[1]))
            .into_iter()
            .fold(crossing, f32::min)
    };
    let places = (1..20).map(|step| mix(from, to, step as f32 / 20.0));
    places.max_by(|a, b| room(*a).total_cmp(&room(*b))).unwrap_or(from)
}

fn distance_to_line(place: [f32; 2], a: [f32; 2], b: [f32; 2]) -> f32 {
    let along = unit([b[0] - a[0], b[1] - a[1]]);
    ((place[0] - a[0]) * along[1] - (place[1] - a[1]) * along[0]).abs()
}

fn average(points: &[[f32; 2]; 4]) -> [f32; 2] {
    [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f32>() / 4.0)
}

fn mix(from: [f32; 2], to: [f32; 2], share: f32) -> [f32; 2] {
    [0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * share)
}

fn unit([x, y]: [f32; 2]) -> [f32; 2] {
    let length = x.hypot(y).max(1e-6);
    [x / length, y / length]
}

#[cfg(test)]
mod tests {
    use super::*;
    use boxline::SurfacePoint;
    use boxline::frames::{Plane, Point};
    use boxline::units::Volume;
    use nalgebra::Vector3;

    fn data(name: &str) -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data").join(name)
    }

    /// A face as it would be measured if every number were the truth.
    fn true_face(recording: &str, frame: &str) -> FaceMeasurement {
        let truth = boxline_proto::json::read_truth(&data(recording)).unwrap().unwrap();
        let face = truth.faces.into_iter().find(|face| face.frame == frame).unwrap();
        let [length, width] = face.size_mm.unwrap();
        let px = |[u, v]: [f64; 2]| Px::new(u, v);
        let between = |a: Px, b: Px, t: f64| Px::new(a.u + (b.u - a.u) * t, a.v + (b.v - a.v) * t);
        let along =
            |a: Px, b: Px, n: usize| (0..n).map(|i| between(a, b, (i as f64 + 0.5) / n as f64)).collect();
        let corners_px = face.corners_px.unwrap().map(px);
        let key_points_px = [1, 2, 3, 4].map(|laser| face.key_points_px[&laser].map(px));
        FaceMeasurement {
            length: Estimate::new(length, 0.12),
            width: Estimate::new(width, 0.09),
            plane: Plane::new(Vector3::new(0.0, 0.0, 0.001)),
            corners_px,
            corners: face.corners_cam_mm.unwrap().map(|[x, y, z]| Point::new(x, y, z)),
            key_points_px,
            rms_px: 0.31,
            stripe_points_px: key_points_px.map(|[a, b]| along(a, b, 60)),
            edge_points_px: [0, 1, 2, 3].map(|side| along(corners_px[side], corners_px[(side + 1) % 4], 40)),
            uncertainty: Default::default(),
            corner_angles: None,
            warnings: Vec::new(),
            surface: Vec::new(),
            straightness: Default::default(),
            light: None,
            enclosing: [Estimate::default(); 2],
            confidence: None,
        }
    }

    fn frame(name: &str) -> Frame {
        Frame::from_jpeg(&std::fs::read(data(name)).unwrap()).unwrap()
    }

    #[test]
    fn shows_marks_where_the_face_is() {
        let faces = ["a", "b"].map(|id| FaceOutcome::Measured(Box::new(true_face("b02", id))));
        let frames = [frame("b02/a.jpg"), frame("b02/b.jpg")];
        let views =
            [0, 1].map(|i| View { name: ["a", "b"][i], frame: &frames[i], face: &faces[i], truth: None });
        let side = |value| Estimate::new(value, 0.1);
        let measured = BoxMeasurement {
            length: side(550.6),
            width: side(350.5),
            height: side(300.0),
            volume: Volume { value_m3: 0.05790, sigma_m3: 0.00003 },
        };
        let headline = Headline::of_box(&Outcome::Measured(measured));
        let picture = draw(&views, &headline).unwrap();
        assert_eq!(picture.width(), WIDTH);
        // A corner is marked white where the truth has it, in the left and in the right frame.
        let scale = 796.0 / 2592.0;
        let header = f64::from(picture.height()) - (1944.0_f64 * scale).round();
        for (face, left) in faces.iter().zip([0.0, 804.0]) {
            let FaceOutcome::Measured(face) = face else { unreachable!() };
            for corner in face.corners_px {
                let (x, y) = ((corner.u + 0.5) * scale - 0.5 + left, (corner.v + 0.5) * scale - 0.5 + header);
                assert_eq!(picture.get_pixel(x.round() as u32, y.round() as u32).0, WHITE);
            }
        }
    }

    /// A bulge is red in the middle of the map, a dent blue.
    #[test]
    fn a_map_shows_where_the_face_bulges() {
        let frame = frame("b02/a.jpg");
        let colored = |height_mm: f64| {
            let mut face = true_face("b02", "a");
            let point = |at_mm, mm| SurfacePoint { at_mm, height: Estimate::new(mm, 0.1) };
            face.surface = vec![point([0.0, 0.0], height_mm), point([200.0, 100.0], 0.0)];
            let face = FaceOutcome::Measured(Box::new(face));
            let without = |picture: &RgbImage| picture.height() - surface::HEIGHT;
            let picture = draw(
                &[View { name: "a", frame: &frame, face: &face, truth: None }],
                &Headline::of_face(&face),
            )
            .unwrap();
            let map = picture.enumerate_pixels().filter(|(_, y, _)| *y >= without(&picture));
            let strong = |p: &[u8; 3], most: usize| p[most] > 200 && p[2 - most] < 120;
            let found = |most: usize| map.clone().filter(|(_, _, p)| strong(&p.0, most)).count();
            (found(0), found(2))
        };
        let (bulge, dent) = (colored(3.0), colored(-3.0));
        assert!(bulge.0 > 50 && bulge.1 == 0, "{bulge:?}");
        assert!(dent.1 > 50 && dent.0 == 0, "{dent:?}");
    }

    #[test]
    fn refusals_say_why() {
        let reject = Reject::FaceCutByBorder { sides_cut: 2, at: Px::new(2591.0, 1200.0) };
        let (face, frame) = (FaceOutcome::Rejected(reject), frame("refuse/r2.jpg"));
        let view = || View { name: "r2", frame: &frame, face: &face, truth: None };
        let headline = Headline::of_face(&face);
        assert!(headline.small[0].contains("border"), "{:?}", headline.small);
        let alone = draw(&[view()], &headline).unwrap();
        let both = draw(&[view(), view()], &headline).unwrap();
        assert_eq!((alone.width(), both.width()), (WIDTH, WIDTH));
        let is_bad = |picture: &RgbImage| picture.pixels().filter(|pixel| pixel.0 == BAD).count();
        assert!(is_bad(&alone) > 1000 && is_bad(&both) > 1000);
    }

    #[test]
    fn a_wrong_result_shows_the_truth() {
        let (face, frame) = (true_face("b02", "a"), frame("b02/a.jpg"));
        let truth = Some(face.corners_px.map(|px| Px::new(px.u + 40.0, px.v)));
        let face = FaceOutcome::Measured(Box::new(face));
        let red = |truth| {
            let headline = Headline::of_face(&face).wrong("true: 550.6 mm".into());
            let picture = draw(&[View { name: "a", frame: &frame, face: &face, truth }], &headline).unwrap();
            picture.pixels().filter(|pixel| pixel.0 == TRUTH).count()
        };
        assert!(red(truth) > 1000 && red(None) == 0);
    }

    #[test]
    fn strange_numbers_do_not_stop_it() {
        let mut face = true_face("b02", "a");
        face.corners_px[0] = Px::new(f64::NAN, f64::INFINITY);
        face.key_points_px[1] = [Px::new(-1e12, 1e12), Px::new(1e300, f64::NAN)];
        face.stripe_points_px[0].push(Px::new(-5000.0, 9e9));
        face.length = Estimate::new(f64::NAN, f64::INFINITY);
        let (face, frame) = (FaceOutcome::Measured(Box::new(face)), frame("b02/a.jpg"));
        draw(&[View { name: "a", frame: &frame, face: &face, truth: None }], &Headline::of_face(&face))
            .unwrap();
    }
}
