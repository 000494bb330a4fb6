//! Lines fitted to maps: how far a laser's line is off, and the key points D1-D8. Positions are pixels of the map; errors are
//! given in pixels of the network's 512 px input. The same definitions as `rust/edgenet/training/metrics.py`.

use super::lines::Map;
use nalgebra::{Matrix2, Vector2};

/// Input pixels per map pixel.
pub const INPUT_PX_PER_PX: f64 = 2.0;
/// Pixels of a laser's map from here on vote in its line.
const FITTED_FROM: f32 = 0.3;
/// Fewer pixels have no direction.
const LINE_PIXELS: usize = 12;
/// What lies so near to a true line may be taken for it; so near to the other line it may be either.
const NEAR_PX: f64 = 4.0;
const APART_PX: f64 = 3.0;
/// How far from a key point its two lines are looked at.
const EDGE_REACH_PX: f64 = 10.0;
const LASER_REACH_PX: f64 = 40.0;
const KEY_POINT_PIXELS: usize = 6;
/// Largest rms distance of a line's pixels: pixels spread evenly over what is near a true line have 2.3 and lie on it by chance.
const LINE_SPREAD_PX: f64 = 1.5;
/// Lines that meet at less than 20 degrees have no crossing worth the name.
const LEAST_SINE: f64 = 0.34;

type Point = Vector2<f64>;

/// A line with its weighted rms distance and its extent.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    centre: Point,
    direction: Point,
    rms_px: f64,
    /// Of the pixels it was fitted to, along `direction` from `centre`.
    extent: [f64; 2],
}

impl Line {
    fn normal(&self) -> Point {
        Point::new(-self.direction.y, self.direction.x)
    }

    fn ends(&self) -> [Point; 2] {
        self.extent.map(|t| self.centre + self.direction * t)
    }

    /// Through weighted points; `None` if there are fewer than `least`.
    fn through(points: &[(Point, f64)], least: usize) -> Option<Self> {
        if points.len() < least {
            return None;
        }
        let sum: f64 = points.iter().map(|(_, w)| w).sum();
        let centre = points.iter().map(|(p, w)| p * *w).sum::<Point>() / sum;
        let spread: Matrix2<f64> =
            points.iter().map(|(p, w)| (p - centre) * (p - centre).transpose() * *w).sum();
        let angle = 0.5 * (2.0 * spread.m12).atan2(spread.m11 - spread.m22);
        let direction = Point::new(angle.cos(), angle.sin());
        let line = Self { centre, direction, rms_px: 0.0, extent: [0.0; 2] };
        let squares: f64 = points.iter().map(|(p, w)| w * (p - centre).dot(&line.normal()).powi(2)).sum();
        let along = points.iter().map(|(p, _)| (p - centre).dot(&direction));
        let extent = along.fold([f64::MAX, f64::MIN], |[a, b], t| [a.min(t), b.max(t)]);
        Some(Self { rms_px: (squares / sum).sqrt(), extent, ..line })
    }

    /// The line of a laser's map, refitted without far pixels.
    pub fn of_map(map: &Map) -> Option<Self> {
        let all = pixels_from(map, FITTED_FROM);
        let mut line = Self::through(&all, LINE_PIXELS)?;
        for reach_px in [12.0, 4.0, 2.0, 2.0] {
            let (centre, normal) = (line.centre, line.normal());
            let near: Vec<(Point, f64)> =
                all.iter().filter(|(p, _)| (p - centre).dot(&normal).abs() < reach_px).copied().collect();
            line = Self::through(&near, LINE_PIXELS)?;
        }
        Some(line)
    }

    fn crossing(&self, other: &Self) -> Option<Point> {
        let sine = self.direction.perp(&other.direction);
        let t = (other.centre - self.centre).perp(&other.direction) / sine;
        (sine.abs() >= LEAST_SINE).then(|| self.centre + self.direction * t)
    }
}

fn pixels_from(map: &Map, least: f32) -> Vec<(Point, f64)> {
    let with_place = map.values.iter().enumerate().filter(|(_, v)| **v >= least);
    with_place
        .map(|(i, v)| (Point::new((i % map.width) as f64, (i / map.width) as f64), f64::from(*v)))
        .collect()
}

/// How far the predicted laser line is from the ends of the true one, the larger of both, in input px. `None`: there is no
/// true line long enough to have a direction; infinite: there is, but none was predicted.
pub fn line_error_px(predicted: &Map, truth: &Map) -> Option<f64> {
    let truth = Line::of_map(truth)?;
    let Some(found) = Line::of_map(predicted) else { return Some(f64::INFINITY) };
    let off = truth.ends().map(|end| (end - found.centre).dot(&found.normal()).abs());
    Some(INPUT_PX_PER_PX * off[0].max(off[1]))
}

/// Key points of one frame.
#[derive(Clone, Debug, Default)]
pub struct KeyPoints {
    /// Found minus true (x, y), input px.
    pub errors_px: Vec<[f64; 2]>,
    /// How many there are in truth.
    pub count: usize,
}

/// The key points that the paper's single map, thinned, gives. Which line is which comes from the truth, where it lies from the map.
/// A key point is where a laser's line meets an edge of the face; where the labels do not tell it (a corner near
/// by, something in front) it is left out.
pub fn key_points(single: &Map, lasers: &[Map; 4], face_edge: &Map, threshold: f32) -> KeyPoints {
    let drawn = pixels_from(single, threshold);
    let edge_pixels = pixels_from(face_edge, FITTED_FROM);
    let mut result = KeyPoints::default();
    for laser in lasers.iter().filter_map(Line::of_map) {
        for (end, inward) in laser.ends().into_iter().zip([1.0, -1.0]) {
            let near: Vec<_> =
                edge_pixels.iter().filter(|(p, _)| (p - end).norm() < EDGE_REACH_PX).copied().collect();
            let Some(edge) = Line::through(&near, KEY_POINT_PIXELS).filter(|e| e.rms_px <= 1.0) else {
                continue;
            };
            let Some(point) = laser.crossing(&edge).filter(|p| (p - end).norm() <= NEAR_PX) else { continue };
            result.count += 1;
            let (mut on_laser, mut on_edge) = (Vec::new(), Vec::new());
            for &(p, weight) in &drawn {
                let offset = p - point;
                let (to_laser, to_edge) =
                    (offset.dot(&laser.normal()).abs(), offset.dot(&edge.normal()).abs());
                let along = inward * offset.dot(&laser.direction);
                if to_laser < NEAR_PX && to_edge > APART_PX && along > 0.0 && along < LASER_REACH_PX {
                    on_laser.push((p, weight));
                }
                let along_edge = offset.dot(&edge.direction).abs();
                if to_edge < NEAR_PX && to_laser > APART_PX && along_edge < EDGE_REACH_PX {
                    on_edge.push((p, weight));
                }
            }
            let clear = |pixels: &[_]| {
                Line::through(pixels, KEY_POINT_PIXELS).filter(|line| line.rms_px <= LINE_SPREAD_PX)
            };
            let found = clear(&on_laser).zip(clear(&on_edge)).and_then(|(laser, edge)| laser.crossing(&edge));
            if let Some(found) = found {
                let error = (found - point) * INPUT_PX_PER_PX;
                result.errors_px.push([error.x, error.y]);
            }
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(segments: &[([f64; 2], [f64; 2])]) -> Map {
        let distance = |p: Point, a: Point, b: Point| {
            let t = ((p - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
            (p - a - (b - a) * t).norm()
        };
        let value = |i: usize| {
            let p = Point::new((i % 256) as f64, (i / 256) as f64);
            let least = segments.iter().map(|(a, b)| distance(p, Point::from(*a), Point::from(*b)));
            (-0.5 * (least.fold(f64::MAX, f64::min) / 0.8).powi(2)).exp() as f32
        };
        Map { width: 256, height: 192, values: (0..256 * 192).map(value).collect() }
    }

    #[test]
    fn the_error_of_a_line_is_in_input_pixels() {
        let truth = drawn(&[([40.0, 60.0], [200.0, 60.0])]);
        let error = line_error_px(&drawn(&[([40.0, 61.5], [200.0, 61.5])]), &truth);
        assert!((error.expect("a line") - 3.0).abs() < 0.05);
        let nothing = drawn(&[]);
        assert_eq!(line_error_px(&nothing, &truth), Some(f64::INFINITY));
        assert_eq!(line_error_px(&truth, &nothing), None);
    }

    #[test]
    fn key_points_are_where_laser_and_edge_meet() {
        let laser = [([60.0, 40.0], [60.0, 150.0])];
        let face = [([30.0, 40.0], [200.0, 40.0]), ([30.0, 150.0], [200.0, 150.0])];
        let lasers = [drawn(&laser), drawn(&[]), drawn(&[]), drawn(&[])];
        let moved =
            [([61.0, 40.0], [61.0, 150.0]), ([30.0, 41.5], [200.0, 41.5]), ([30.0, 151.5], [200.0, 151.5])];
        let found = key_points(&drawn(&moved).thinned(), &lasers, &drawn(&face), 0.4);
        assert_eq!(found.count, 2);
        assert_eq!(found.errors_px.len(), 2);
        for [x, y] in found.errors_px {
            // The ridge is one of whole pixels, here 0.5 px (1 input px) off.
            assert!((x - 2.0).abs() < 0.1 && (y - 3.0).abs() < 1.1, "{x} {y}");
        }
        let everywhere = Map { width: 256, height: 192, values: vec![0.7; 256 * 192] };
        assert!(key_points(&everywhere, &lasers, &drawn(&face), 0.4).errors_px.is_empty());
        assert!(key_points(&drawn(&[]), &lasers, &drawn(&face), 0.4).errors_px.is_empty());
    }
}
