//! The pixels of a face: where each lies on it, and its light apart by where it comes from. The light of the room is what lies
//! beside the stripes, carried on beneath them; the rest is the lasers'. Paint changes the one and keeps the other.

use super::like;
use super::paint::{Paint, Patch};
use super::picture::Light;
use crate::Error;
use boxline::frames::Plane;
use boxline::{Calibration, Frame, LaserId, Px};
use nalgebra::{Matrix2, Vector2, Vector3};

/// Profiles across stripes are taken this far out, px.
const REACH_PX: usize = 48;
/// A stripe ends where its mean profile falls below this share of its peak, and a little beyond.
const STRIPE_END: f32 = 0.03;
const STRIPE_MARGIN_PX: f32 = 3.0;
/// Fainter stripes have no profile (linear light); they are narrow.
const FAINTEST: f32 = 0.004;
const FAINT_HALF_WIDTH_PX: f32 = 6.0;
/// The rounded edge is no place to learn the board's light from, mm.
const EDGE_MM: f32 = 2.0;
/// What one sees of a rounded edge ends about this far inside of the sharp one (0.3 of a radius of 2 mm): paint ends there too.
const SEEN_EDGE_MM: f32 = 0.6;
/// Luminance albedo of plain board: what paint is darker or brighter than.
const BOARD_ALBEDO: f32 = 0.35;
/// Paint does not come closer to white than this: exposure is set so that the scene does not clip.
const BRIGHTEST: f32 = 0.8;
/// However dark the paint, the stripe stays visible; and however bright, it is one stripe.
const LASER_SHARE: [f32; 2] = [0.5, 2.0];

/// Light of a pixel, linear R, G, B.
type Rgb = [f32; 3];

/// A face in its frame.
pub struct FacePixels {
    left: usize,
    top: usize,
    width: usize,
    half_mm: [f32; 2],
    /// Along the length and the width, from the face's middle; far off where the ray misses the plane.
    at_mm: Vec<[f32; 2]>,
    /// The room's light.
    ambient: Vec<Rgb>,
    /// The board's, in the middle of what the face shows.
    board: Rgb,
}

impl FacePixels {
    pub fn new(
        frame: &Frame,
        calibration: &Calibration,
        corners_cam_mm: &[[f64; 3]; 4],
        corners_px: &[[f64; 2]; 4],
    ) -> Self {
        let span = |axis: usize, extent: usize| {
            let low = corners_px.iter().map(|px| px[axis]).fold(f64::INFINITY, f64::min);
            let high = corners_px.iter().map(|px| px[axis]).fold(0.0, f64::max);
            let end = ((high + 3.0).max(0.0) as usize).min(extent);
            ((low - 2.0).max(0.0) as usize).min(end)..end
        };
        let (columns, rows) = (span(0, frame.width_px()), span(1, frame.height_px()));
        let corners = corners_cam_mm.map(Vector3::from);
        let middle = corners.iter().sum::<Vector3<f64>>() / 4.0;
        let along = corners[1] - corners[0] + corners[2] - corners[3];
        let across = corners[3] - corners[0] + corners[2] - corners[1];
        let half_mm = [along.norm() / 4.0, across.norm() / 4.0];
        let axes = [along.normalize(), across.normalize()];
        let normal = axes[0].cross(&axes[1]);
        let plane = Plane::new(normal / normal.dot(&middle));
        let camera = calibration.camera();

        let mut at_mm = Vec::with_capacity(columns.len() * rows.len());
        let mut from_stripes_px = Vec::with_capacity(at_mm.capacity());
        let differences = LaserId::ALL.map(|id| plane.per_mm - calibration.laser(id).per_mm);
        for row in rows.clone() {
            for column in columns.clone() {
                let (ray, by_px): (_, Matrix2<f64>) =
                    camera.ray_from_px_with_jacobian(Px::new(column as f64, row as f64));
                let on_face = plane
                    .intersect(&ray)
                    .map_or([1e6; 2], |p| axes.map(|axis| axis.dot(&(p.mm - middle)) as f32));
                at_mm.push(on_face);
                from_stripes_px.push(differences.map(|d| {
                    let slope = by_px.transpose() * Vector2::new(d.x, d.y);
                    (d.dot(&ray.xy1) / slope.norm()).abs() as f32
                }));
            }
        }
        let light = Light::get();
        let mut ambient: Vec<Rgb> = Vec::with_capacity(at_mm.len());
        for row in rows.clone() {
            let line = &frame.rgb()[row * frame.width_px() * 3..];
            let line = &line[columns.start * 3..columns.end * 3];
            ambient.extend(line.chunks_exact(3).map(|px| [px[0], px[1], px[2]].map(|c| light.linear(c))));
        }
        let half_mm = half_mm.map(|h| h as f32);
        let inside = |at: [f32; 2]| (0..2).all(|i| at[i].abs() < half_mm[i] - EDGE_MM);
        let half_widths_px = half_widths_px(&ambient, &at_mm, &from_stripes_px, inside);
        let known: Vec<f32> = at_mm
            .iter()
            .zip(&from_stripes_px)
            .map(|(at, d)| f32::from(inside(*at) && d.iter().zip(half_widths_px).all(|(d, h)| *d > h)))
            .collect();
        let board = median(&ambient, &known);
        fill(&mut ambient, known, columns.len(), rows.len());
        Self { left: columns.start, top: rows.start, width: columns.len(), half_mm, at_mm, ambient, board }
    }

    /// The frame with paint on the face.
    pub fn painted(&self, frame: &Frame, paint: &Paint) -> Result<Frame, Error> {
        let light = Light::get();
        let half = self.half_mm.map(|h| h - SEEN_EDGE_MM);
        let ink = Ink::new(paint.ink().albedo(), self.board);
        let patches = paint.patches(half);
        let mut rgb = frame.rgb().to_vec();
        for (i, &at) in self.at_mm.iter().enumerate() {
            let mm_per_px = self.mm_per_px(i);
            let share = patches.iter().map(|patch: &Patch| patch.share(at, mm_per_px)).fold(0.0, f32::max);
            if share <= 0.0 {
                continue;
            }
            let (row, column) = (self.top + i / self.width, self.left + i % self.width);
            let start = (row * frame.width_px() + column) * 3;
            let px = &mut rgb[start..start + 3];
            let ambient = self.ambient[i];
            let bright = luminance(ambient);
            let seen = [px[0], px[1], px[2]].map(|level| light.linear(level));
            // A clipped pixel does not tell how much laser there is: enough to stay clipped.
            let clipped = ((seen[0] - 0.85) / 0.13).clamp(0.0, 1.0);
            let laser_share = ink.laser_share + clipped * (1.0 - ink.laser_share).max(0.0);
            for c in 0..3 {
                let laser = seen[c] - ambient[c];
                let painted = ink.of_luminance[c] * bright + laser * laser_share;
                px[c] = light.level(seen[c] * (1.0 - share) + painted * share);
            }
        }
        like(frame, rgb)
    }

    /// How many mm of the face's length and width go to one px of the picture, across lines of equal length and width.
    fn mm_per_px(&self, i: usize) -> [f32; 2] {
        let (column, row) = (i % self.width, i / self.width);
        // The last column and the last row look back.
        let beside = if column + 1 < self.width { i + 1 } else { i - column.min(1) };
        let below = if row + 1 < self.at_mm.len() / self.width {
            i + self.width
        } else {
            i - row.min(1) * self.width
        };
        let (here, beside, below) = (self.at_mm[i], self.at_mm[beside], self.at_mm[below]);
        [0, 1].map(|c| (beside[c] - here[c]).hypot(below[c] - here[c]))
    }
}

/// Paint as it shows on this board under this light.
struct Ink {
    /// Its light for a luminance of 1 of the board.
    of_luminance: Rgb,
    laser_share: f32,
}

impl Ink {
    fn new(albedo: Rgb, board: Rgb) -> Self {
        let bright = luminance(board).max(1e-4);
        let brightest = albedo.iter().copied().fold(0.0, f32::max) / BOARD_ALBEDO * bright;
        let scale = (BRIGHTEST / brightest).min(1.0) / BOARD_ALBEDO;
        let of_luminance = albedo.map(|a| a * scale);
        let red = of_luminance[0] * bright / board[0].max(1e-4);
        Self { of_luminance, laser_share: red.clamp(LASER_SHARE[0], LASER_SHARE[1]) }
    }
}

/// ITU-R BT.709.
fn luminance([r, g, b]: Rgb) -> f32 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

/// How far the light of each stripe reaches to either side on this face, px.
fn half_widths_px(
    light: &[Rgb],
    at_mm: &[[f32; 2]],
    from_stripes_px: &[[f32; 4]],
    inside: impl Fn([f32; 2]) -> bool,
) -> [f32; 4] {
    let mut sums = [[(0.0f64, 0u32); REACH_PX]; 4];
    for ((light, at), distances) in light.iter().zip(at_mm).zip(from_stripes_px) {
        let mut near = (0..4).filter(|k| distances[*k] < REACH_PX as f32);
        if let (Some(k), None) = (near.next(), near.next())
            && inside(*at)
        {
            let (sum, count) = &mut sums[k][distances[k] as usize];
            *sum += f64::from(light[0]);
            *count += 1;
        }
    }
    sums.map(|bins| {
        let means: Vec<f32> =
            bins.iter().filter(|b| b.1 > 0).map(|(sum, count)| (sum / f64::from(*count)) as f32).collect();
        let ground = means.iter().copied().fold(f32::INFINITY, f32::min);
        let peak = means.iter().copied().fold(0.0, f32::max) - ground;
        if means.len() < REACH_PX || peak < FAINTEST {
            return FAINT_HALF_WIDTH_PX;
        }
        let end = means.iter().position(|m| m - ground < STRIPE_END * peak).unwrap_or(REACH_PX);
        end as f32 + STRIPE_MARGIN_PX
    })
}

/// Median of the known pixels, each channel for itself.
fn median(light: &[Rgb], known: &[f32]) -> Rgb {
    [0, 1, 2].map(|c| {
        let mut values: Vec<f32> =
            light.iter().zip(known).filter(|(_, known)| **known > 0.0).map(|(l, _)| l[c]).collect();
        if values.is_empty() {
            return BOARD_ALBEDO;
        }
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f32::total_cmp).1
    })
}

/// Carries known pixels on into unknown ones: averages of known pixels at half, a quarter... of the resolution, as coarse as it takes.
fn fill(light: &mut [Rgb], known: Vec<f32>, width: usize, height: usize) {
    if (width <= 1 && height <= 1) || known.iter().all(|k| *k > 0.0) {
        return;
    }
    let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
    let mut coarse = vec![[0.0; 3]; half_width * half_height];
    let mut weights = vec![0.0; coarse.len()];
    for (i, (light, known)) in light.iter().zip(&known).enumerate() {
        let at = i / width / 2 * half_width + i % width / 2;
        for c in 0..3 {
            coarse[at][c] += light[c] * known;
        }
        weights[at] += known;
    }
    for (light, weight) in coarse.iter_mut().zip(&mut weights) {
        if *weight > 0.0 {
            *light = light.map(|x| x / *weight);
            *weight = 1.0;
        }
    }
    fill(&mut coarse, weights, half_width, half_height);
    for (i, light) in light.iter_mut().enumerate().filter(|(i, _)| known[*i] <= 0.0) {
        *light = between(&coarse, [half_width, half_height], [i % width, i / width]);
    }
}

/// A pixel of the finer raster from the coarser one of half its resolution, bilinear.
fn between(coarse: &[Rgb], [width, height]: [usize; 2], [x, y]: [usize; 2]) -> Rgb {
    let split = |x: usize, n: usize| {
        let at = ((x as f32 + 0.5) / 2.0 - 0.5).clamp(0.0, (n - 1) as f32);
        let low = at as usize;
        (low, (low + 1).min(n - 1), at - low as f32)
    };
    let ((x0, x1, tx), (y0, y1, ty)) = (split(x, width), split(y, height));
    [0, 1, 2].map(|c| {
        let row = |y: usize| coarse[y * width + x0][c] * (1.0 - tx) + coarse[y * width + x1][c] * tx;
        row(y0) * (1.0 - ty) + row(y1) * ty
    })
}
