//! What the maps of a recorded frame should be, drawn from its truth: lines as soft as the training labels, along the camera's
//! curves. Where something stands in front of the face is not known.

use super::scores::Labels;
use boxline::frames::Ray;
use boxline::network::{CHANNELS, Channel, FaceMaps};
use boxline::{Calibration, LaserId, Px};
use boxline_proto::json::TruthFace;

/// Size of the maps, and of a line across, px of the map (as in `rust/sim`'s labels).
const SIZE: [usize; 2] = [256, 192];
const SIGMA_PX: f64 = 0.8;
/// Pieces of a curve.
const PIECES: usize = 64;

/// The labels of a frame, if its truth has a face.
pub fn labels(truth: &TruthFace, calibration: &Calibration, frame_px: [usize; 2]) -> Option<Labels> {
    let corners = truth.corners_cam_mm?;
    let n = SIZE[0] * SIZE[1];
    let empty = FaceMaps::new(SIZE[0], SIZE[1], frame_px, vec![0.0; CHANNELS * n])?;
    let mut values = vec![0f32; CHANNELS * n];
    let to_map = |mm: [f64; 3]| -> Option<[f64; 2]> {
        let ray = (mm[2] > 0.0).then(|| Ray::new(mm[0] / mm[2], mm[1] / mm[2]))?;
        calibration.camera().px_from_ray(&ray).map(|px| empty.raster_from_px(px))
    };
    let between = |a: [f64; 3], b: [f64; 3]| -> Vec<[f64; 2]> {
        let at = |i: usize| [0, 1, 2].map(|k| a[k] + (b[k] - a[k]) * i as f64 / PIECES as f64);
        (0..=PIECES).filter_map(|i| to_map(at(i))).collect()
    };
    for id in LaserId::ALL {
        let Some(ends) = truth.key_points_px.get(&(id.index() as u8 + 1)) else { continue };
        let [a, b] = ends
            .map(|[u, v]| calibration.laser(id).intersect(&calibration.camera().ray_from_px(Px::new(u, v))));
        if let (Some(a), Some(b)) = (a, b) {
            draw(channel_mut(&mut values, Channel::Laser(id)), &between(a.mm.into(), b.mm.into()));
        }
    }
    let mut outline = Vec::new();
    for (i, corner) in corners.into_iter().enumerate() {
        let side = between(corner, corners[(i + 1) % 4]);
        draw(channel_mut(&mut values, Channel::FaceEdge), &side);
        outline.extend(side);
    }
    let mask = channel_mut(&mut values, Channel::FaceMask);
    for (i, value) in mask.iter_mut().enumerate() {
        let at = [(i % SIZE[0]) as f64, (i / SIZE[0]) as f64];
        *value = f32::from(u8::from(inside(&outline, at)));
    }
    let measurable = truth.refuse.is_none() && truth.key_points_px.len() == 4;
    let maps = FaceMaps::new(SIZE[0], SIZE[1], frame_px, values)?;
    Some(Labels { maps, contrast: None, measurable, face_only: true })
}

fn channel_mut(values: &mut [f32], channel: Channel) -> &mut [f32] {
    let n = SIZE[0] * SIZE[1];
    &mut values[channel.index() * n..][..n]
}

/// Draws a curve with a Gaussian across it.
fn draw(map: &mut [f32], curve: &[[f64; 2]]) {
    const REACH_PX: f64 = 4.0 * SIGMA_PX;
    for piece in curve.windows(2) {
        let (a, b) = (piece[0], piece[1]);
        let span = |k: usize| {
            let (low, high) = (a[k].min(b[k]) - REACH_PX, a[k].max(b[k]) + REACH_PX);
            (low.max(0.0).ceil() as usize)..=(high.min(SIZE[k] as f64 - 1.0).max(-1.0) + 1.0) as usize
        };
        for y in span(1).filter(|y| *y < SIZE[1]) {
            for x in span(0).filter(|x| *x < SIZE[0]) {
                let value = (-0.5 * (distance([x as f64, y as f64], a, b) / SIGMA_PX).powi(2)).exp() as f32;
                let cell = &mut map[y * SIZE[0] + x];
                *cell = cell.max(value);
            }
        }
    }
}

fn distance(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let along = [b[0] - a[0], b[1] - a[1]];
    let length = (along[0] * along[0] + along[1] * along[1]).max(1e-12);
    let t = (((p[0] - a[0]) * along[0] + (p[1] - a[1]) * along[1]) / length).clamp(0.0, 1.0);
    (p[0] - a[0] - t * along[0]).hypot(p[1] - a[1] - t * along[1])
}

/// Is the point inside the closed polygon (even-odd)?
fn inside(polygon: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let edges = polygon.iter().zip(polygon.iter().cycle().skip(1));
    let crosses = |(a, b): &(&[f64; 2], &[f64; 2])| {
        (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
    };
    edges.filter(crosses).count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_is_inside_itself_and_a_curve_is_drawn_where_it_runs() {
        let square = [[10.0, 10.0], [20.0, 10.0], [20.0, 20.0], [10.0, 20.0]];
        assert!(
            inside(&square, [15.0, 15.0]) && !inside(&square, [25.0, 15.0]) && !inside(&square, [15.0, 5.0])
        );
        let mut map = vec![0.0; SIZE[0] * SIZE[1]];
        draw(&mut map, &[[-20.0, 30.0], [50.0, 30.0]]);
        assert_eq!(map[30 * SIZE[0] + 40], 1.0);
        assert_eq!((map[30 * SIZE[0] + 60], map[40 * SIZE[0] + 40]), (0.0, 0.0));
        assert!((f64::from(map[31 * SIZE[0]]) - (-0.5f64 / 0.64).exp()).abs() < 1e-6);
        draw(&mut map, &[[-90.0, -30.0], [-50.0, -30.0]]); // outside: nothing happens
    }
}
