//! Why a measured face is wrong, from the truth: which of its sides was taken along which other line.

use boxline::{Calibration, FaceMeasurement, Px};
use boxline_proto::json::{TruthFace, corner_orders};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// What a wrong side was taken for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// A line on the face: print, tape, a strap, a label, a seam.
    Print,
    /// The edge of a box beside it.
    Neighbour,
    /// Something before the face hides a part of it.
    Occluder,
    /// The end of a laser's fan.
    FanEnd,
    /// The side's own rounded edge.
    Rounding,
    /// None of these is near.
    Other,
}

impl Cause {
    pub const ALL: [Self; 6] =
        [Self::Print, Self::Neighbour, Self::Occluder, Self::FanEnd, Self::Rounding, Self::Other];

    /// For people.
    pub const fn words(self) -> &'static str {
        match self {
            Self::Print => "line of print",
            Self::Neighbour => "neighbour's edge",
            Self::Occluder => "occluder",
            Self::FanEnd => "fan's end",
            Self::Rounding => "rounding",
            Self::Other => "other",
        }
    }
}

/// A measured side lies on a line if it is no farther from it than this: edges scatter by 1 to 2 px, soft ones by more.
const NEAR_MM: f64 = 3.0;
const NEAR_PX: f64 = 6.0;
/// A side that is off by less did not make a length wrong: both of its sides together have to give 3 mm.
const LEAST_MM: f64 = 1.5;
/// A rounded edge shows up to so many radii inside the sharp one, its silhouette and its shading together.
const ROUNDING_RADII: f64 = 2.0;

/// The cause, from the side that is farthest off in the faces that were measured together.
pub fn of_faces(faces: &[(&TruthFace, &FaceMeasurement)], calibration: &Calibration) -> Cause {
    let offsets = faces.iter().filter_map(|(truth, found)| {
        let offsets_mm = side_offsets_mm(truth.corners_cam_mm?, rays(found.corners_px, calibration))?;
        let (side, offset_mm) =
            offsets_mm.into_iter().enumerate().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
        Some((*truth, side, offset_mm))
    });
    match offsets.max_by(|a, b| a.2.abs().total_cmp(&b.2.abs())) {
        Some((truth, side, offset_mm)) => of_side(truth, side, offset_mm, calibration.camera().fx),
        None => Cause::Other,
    }
}

/// The cause of a side that is off by so much, outwards if positive.
fn of_side(truth: &TruthFace, side: usize, offset_mm: f64, focal_px: f64) -> Cause {
    if offset_mm.abs() < LEAST_MM {
        return Cause::Other;
    }
    let depth_mm = truth.corners_cam_mm.map_or(0.0, |c| 0.5 * (c[side][2] + c[(side + 1) % 4][2]));
    let near_mm = NEAR_MM.max(NEAR_PX * depth_mm / focal_px);
    let lines = truth.false_lines.iter().filter(|line| line.side == side);
    let apart = |line: &&boxline_proto::json::TruthLine| (line.offset_mm - offset_mm).abs();
    let nearest = lines.min_by(|a, b| apart(a).total_cmp(&apart(b)));
    // A line that is farther from the measured side than the true side explains nothing.
    if let Some(line) = nearest.filter(|line| apart(line) <= near_mm.min(offset_mm.abs())) {
        return match line.kind.as_str() {
            "neighbour" => Cause::Neighbour,
            "fan_end" => Cause::FanEnd,
            _ => Cause::Print,
        };
    }
    let radius_mm = truth.notes.edge_radius_mm.unwrap_or(0.0);
    if offset_mm.abs() <= ROUNDING_RADII * radius_mm { Cause::Rounding } else { Cause::Other }
}

fn rays(corners_px: [Px; 4], calibration: &Calibration) -> [Vector3<f64>; 4] {
    corners_px.map(|px| calibration.camera().ray_from_px(px).xy1)
}

/// How far each true side lies inside the measured one, in the plane of the true face, mm: what is off in the picture, without what is
/// off in depth. `None` if the true face is none.
fn side_offsets_mm(truth_mm: [[f64; 3]; 4], found: [Vector3<f64>; 4]) -> Option<[f64; 4]> {
    let truth = truth_mm.map(Vector3::from);
    let normal = (truth[1] - truth[0]).cross(&(truth[3] - truth[0])).try_normalize(1e-9)?;
    let on_plane = found.map(|ray| ray * (normal.dot(&truth[0]) / normal.dot(&ray)));
    // Corners may start anywhere and go round either way: the best of the eight ways counts.
    let ways = corner_orders().map(|order| order.map(|i| on_plane[i]));
    let squares = |way: &[Vector3<f64>; 4]| -> f64 {
        way.iter().zip(&truth).map(|(a, b)| (a - b).norm_squared()).sum()
    };
    let found = ways.min_by(|a, b| squares(a).total_cmp(&squares(b)))?;
    let middle = truth.iter().sum::<Vector3<f64>>() / 4.0;
    let mut offsets_mm = [0.0; 4];
    for (side, offset_mm) in offsets_mm.iter_mut().enumerate() {
        let next = (side + 1) % 4;
        let along = (truth[next] - truth[side]).try_normalize(1e-9)?;
        let beside = 0.5 * (truth[side] + truth[next]) - middle;
        let outward = (beside - along * along.dot(&beside)).try_normalize(1e-9)?;
        *offset_mm = 0.5 * (found[side] + found[next] - truth[side] - truth[next]).dot(&outward);
    }
    offsets_mm.iter().all(|mm| mm.is_finite()).then_some(offsets_mm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use boxline_proto::json::{TruthLine, TruthNotes};

    /// A face of 400 x 300 mm, tilted by 30 degrees, 1000 mm away.
    fn corner(x: f64, y: f64) -> [f64; 3] {
        let (sin, cos) = 30f64.to_radians().sin_cos();
        [x * cos, y, 1000.0 + x * sin]
    }

    const CORNERS: [(f64, f64); 4] = [(-200.0, -150.0), (200.0, -150.0), (200.0, 150.0), (-200.0, 150.0)];

    fn truth(lines: &[(usize, f64, &str)]) -> TruthFace {
        TruthFace {
            corners_cam_mm: Some(CORNERS.map(|(x, y)| corner(x, y))),
            false_lines: lines
                .iter()
                .map(|&(side, offset_mm, kind)| TruthLine { side, offset_mm, kind: kind.into() })
                .collect(),
            notes: TruthNotes { edge_radius_mm: Some(2.0), ..TruthNotes::default() },
            ..TruthFace::default()
        }
    }

    #[test]
    fn sides_are_compared_in_the_true_plane_whatever_the_order_of_corners() {
        // Side 1 (x = 200) is taken 12 mm too far out, side 2 (y = 150) 5 mm inside; the depth is off too, which must not count.
        let moved = [(-200.0, -150.0), (212.0, -150.0), (212.0, 145.0), (-200.0, 145.0)];
        let rays = moved.map(|(x, y)| Vector3::from(corner(x, y)) * 1.07);
        let true_corners = CORNERS.map(|(x, y)| corner(x, y));
        for (start, step) in [(0, 1), (2, 1), (1, 3), (3, 3)] {
            let order = [0, 1, 2, 3].map(|i| rays[(start + step * i) % 4]);
            let found = side_offsets_mm(true_corners, order).unwrap();
            for (found, right) in found.iter().zip([0.0, 12.0, -5.0, 0.0]) {
                assert!((found - right).abs() < 1e-9, "{found}, {right} is right");
            }
        }
        assert_eq!(side_offsets_mm([[0.0, 0.0, 1000.0]; 4], rays), None);
    }

    #[test]
    fn the_line_that_is_near_names_the_cause() {
        // 6 px at 1000 mm and 2000 px of focal length are 3 mm.
        let cause = |lines: &[(usize, f64, &str)], offset_mm| of_side(&truth(lines), 1, offset_mm, 2000.0);
        let lines =
            [(1, -14.0, "band"), (1, 300.0, "neighbour"), (1, -90.0, "fan_end"), (2, 40.0, "neighbour")];
        assert_eq!(cause(&lines, -12.5), Cause::Print);
        assert_eq!(cause(&lines, 302.0), Cause::Neighbour);
        assert_eq!(cause(&lines, -89.0), Cause::FanEnd);
        assert_eq!(cause(&lines, 40.0), Cause::Other, "that line is at another side");
        assert_eq!(cause(&lines, -3.9), Cause::Rounding, "within two radii");
        assert_eq!(cause(&lines, -20.0), Cause::Other);
        assert_eq!(
            cause(&[(1, -3.5, "band")], -1.6),
            Cause::Rounding,
            "nearer to the true side than to the line"
        );
        assert_eq!(cause(&[], 0.5), Cause::Other, "nothing is off");
        // Farther away a pixel is larger.
        assert_eq!(of_side(&truth(&lines), 1, -18.0, 1000.0), Cause::Print);
    }
}
