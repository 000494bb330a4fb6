//! The curvature map below a frame: the face seen straight on, its length to the right, with how far the surface lies from the
//! fitted plane along each stripe. Red is towards the camera, blue away from it.

use super::canvas::{Canvas, Color};
use super::{GAP, MARGIN, WHITE};
use boxline::FaceMeasurement;

/// Height of a map with its line of text, px.
pub const HEIGHT: u32 = 260;
const TEXT: f32 = 30.0;
const NEAR: Color = [255, 90, 80];
const FAR: Color = [80, 140, 255];
/// Full colour is never less than this, mm: noise alone should look flat.
const LEAST_FULL_MM: f64 = 1.0;

/// Draws the map of a face into a strip of [`HEIGHT`]; nothing where no surface is known.
pub fn draw(canvas: &mut Canvas, face: &FaceMeasurement, [left, top]: [f32; 2], width: f32) {
    let heights = || face.surface.iter().map(|p| p.height.value_mm).filter(|h| h.is_finite());
    let (low, high) = heights().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), h| (a.min(h), b.max(h)));
    if low > high {
        return;
    }
    let text = format!("Off its plane: {low:+.1} to {high:+.1} mm (red: nearer)");
    canvas.text_from(&text, TEXT, [left + MARGIN, top + 0.8 * TEXT], WHITE);
    let full_mm = low.abs().max(high).max(LEAST_FULL_MM);
    let (length, width_mm) = (face.length.value_mm as f32, face.width.value_mm as f32);
    let top = top + 1.6 * TEXT;
    let room = [width - 2.0 * MARGIN, HEIGHT as f32 - 1.6 * TEXT - GAP as f32];
    let px_per_mm = (room[0] / length.max(1.0)).min(room[1] / width_mm.max(1.0));
    let half = [0.5 * length * px_per_mm, 0.5 * width_mm * px_per_mm];
    let middle = [left + 0.5 * width, top + 0.5 * room[1]];
    let at = |x: f32, y: f32| [middle[0] + x, middle[1] + y];
    let corners =
        [at(-half[0], -half[1]), at(half[0], -half[1]), at(half[0], half[1]), at(-half[0], half[1])];
    for side in 0..4 {
        canvas.line(corners[side], corners[(side + 1) % 4], 2.0, WHITE);
    }
    for point in &face.surface {
        let [x, y] = point.at_mm.map(|mm| mm as f32 * px_per_mm);
        canvas.disc(at(x, y), 7.0, color((point.height.value_mm / full_mm) as f32));
    }
}

/// White for 0, full colour for -1 and 1.
fn color(share: f32) -> Color {
    let full = if share > 0.0 { NEAR } else { FAR };
    let share = share.abs().min(1.0);
    [0, 1, 2].map(|i| (255.0 + (f32::from(full[i]) - 255.0) * share) as u8)
}
