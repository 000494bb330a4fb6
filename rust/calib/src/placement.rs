//! Which part of the board a frame shows, and which way round. The grid has no mark, and for camera and planes it does not matter; but a
//! bowed or stretched board is not the same all over, so each frame is put where its circles fit best.

use super::adjust::FrameObservations;
use super::board::Board;
use super::model::{POSE, centre_rows, point_on_board};
use super::patterns::{Patterns, Solved};
use boxline::frames::{Pose, Ray};
use boxline::units::Px;
use nalgebra::{DVector, Matrix2, Matrix3, SMatrix, SVector, Vector2};

/// Places of the next line of circles that are in view, and of which none is seen, where the board ends.
const LEAST_IN_VIEW: usize = 3;

/// A grid turned by quarters of a turn, then moved.
#[derive(Clone, Copy)]
struct Placement {
    quarters: usize,
    shift_mm: Vector2<f64>,
}

impl Placement {
    fn turn(self) -> Matrix2<f64> {
        let (s, c) = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)][self.quarters % 4];
        Matrix2::new(c, -s, s, c)
    }

    fn at(self, board_mm: Vector2<f64>) -> Vector2<f64> {
        self.turn() * board_mm + self.shift_mm
    }
}

impl Solved {
    /// Puts each frame's grid where the patterns of these values fit its circles best; `seen` has the circles where they were seen.
    pub fn place(&mut self, seen: &Self, patterns: &mut Patterns, values: &DVector<f64>) -> Option<()> {
        for i in 0..self.frames.len() {
            let placements = self.placements(&self.frames[i]).into_iter();
            let tried = placements.filter_map(|p| Some((self.rest(seen, patterns, values, i, p)?, p)));
            // Of several as good the first.
            let (_, placement) = tried.min_by(|a, b| a.0.total_cmp(&b.0))?;
            let frame = &mut self.frames[i];
            let turn = placement.turn().transpose();
            let mut turn3 = Matrix3::identity();
            turn3.fixed_view_mut::<2, 2>(0, 0).copy_from(&turn);
            let rotation = frame.pose.rotation * turn3;
            let shift = rotation * placement.shift_mm.push(0.0);
            frame.pose = Pose::new(rotation, frame.pose.translation_mm - shift);
            frame.centres.iter_mut().for_each(|c| c.board_mm = placement.at(c.board_mm));
            // What the board is longer along stays where it is.
            if let Some(signs) = &mut patterns.signs {
                signs[i] *= if placement.quarters % 2 == 1 { -1.0 } else { 1.0 };
            }
        }
        Some(())
    }

    /// Where a frame's grid may be: inside the board, and at its end where the next line of circles would be in view but is not there.
    fn placements(&self, frame: &FrameObservations) -> Vec<Placement> {
        let board = &self.board;
        let pitch = board.pitch_mm;
        let (low, high) = extent(frame.centres.iter().map(|c| c.board_mm));
        let ends = self.ends(frame, low, high);
        let half = board.centre_mm(0, 0).abs();
        let mut all = Vec::new();
        for quarters in 0..4 {
            let turned = Placement { quarters, shift_mm: Vector2::zeros() };
            let (low, high) = extent([turned.at(low), turned.at(high)].into_iter());
            // The four ends turn with the grid: right, bottom, left, top.
            let end = |side: usize| ends[(side + 4 - quarters) % 4];
            // Ways that the grid may go along an axis.
            let ways = |low: f64, high: f64, half: f64, at_low: bool, at_high: bool| -> Vec<f64> {
                let room = ((2.0 * half - (high - low)) / pitch).round() as i64;
                let all = (0..=room.max(-1)).map(|k| k as f64 * pitch - half - low);
                let first = |shift: &f64| (low + shift + half).abs() < 0.5 * pitch;
                let last = |shift: &f64| (high + shift - half).abs() < 0.5 * pitch;
                all.filter(|shift| (!at_low || first(shift)) && (!at_high || last(shift))).collect()
            };
            let (x, y) =
                (ways(low.x, high.x, half.x, end(2), end(0)), ways(low.y, high.y, half.y, end(3), end(1)));
            all.extend(
                x.iter().flat_map(|x| {
                    y.iter().map(move |y| Placement { quarters, shift_mm: Vector2::new(*x, *y) })
                }),
            );
        }
        if all.is_empty() {
            all.push(Placement { quarters: 0, shift_mm: Vector2::zeros() });
        }
        // As it is now comes first.
        all.sort_by(|a, b| {
            let moved = |p: &Placement| (p.quarters as f64) + p.shift_mm.norm();
            moved(a).total_cmp(&moved(b))
        });
        all
    }

    /// Whether the board ends behind the last circles along x, y, -x, -y.
    fn ends(&self, frame: &FrameObservations, low: Vector2<f64>, high: Vector2<f64>) -> [bool; 4] {
        let Board { pitch_mm, diameter_mm, .. } = self.board;
        let in_view = |at: Vector2<f64>| {
            let point = point_on_board(&frame.pose, at);
            let px = self.shared.camera.px_from_ray(&Ray::new(point.x / point.z, point.y / point.z));
            let margin = diameter_mm * self.shared.camera.fx / point.z;
            let inside = |px: Px| {
                let [width, height] = self.image_px.map(|n| n as f64);
                px.u > margin && px.v > margin && px.u < width - margin && px.v < height - margin
            };
            point.z > 1.0 && px.is_some_and(inside)
        };
        let steps = |from: f64, to: f64| {
            (0..=((to - from) / pitch_mm).round() as i64).map(move |k| from + k as f64 * pitch_mm)
        };
        let beyond = |at: &mut dyn Iterator<Item = Vector2<f64>>| {
            at.filter(|at| in_view(*at)).count() >= LEAST_IN_VIEW
        };
        [
            beyond(&mut steps(low.y, high.y).map(|y| Vector2::new(high.x + pitch_mm, y))),
            beyond(&mut steps(low.x, high.x).map(|x| Vector2::new(x, high.y + pitch_mm))),
            beyond(&mut steps(low.y, high.y).map(|y| Vector2::new(low.x - pitch_mm, y))),
            beyond(&mut steps(low.x, high.x).map(|x| Vector2::new(x, low.y - pitch_mm))),
        ]
    }

    /// Sum of squares, in sigmas, of a frame's circles with a placement, its pose free.
    fn rest(
        &self,
        seen: &Self,
        patterns: &Patterns,
        values: &DVector<f64>,
        frame: usize,
        placement: Placement,
    ) -> Option<f64> {
        let (mut own, mut right, mut sum) =
            (SMatrix::<f64, POSE, POSE>::zeros(), SVector::<f64, POSE>::zeros(), 0.0);
        for (c, at) in self.frames[frame].centres.iter().zip(seen.frames[frame].centres.iter().map(|c| c.at))
        {
            let rows = centre_rows(&self.shared, &self.frames[frame].pose, c.board_mm, at)?;
            let by = self.centre_by(patterns, frame, c.board_mm, placement.at(c.board_mm), &rows)?;
            let weight = (c.sigma_px * self.scatter.centres).powi(-2);
            for (row, by) in rows.iter().zip(&by) {
                let px = row.px + by.iter().map(|(i, by)| by * values[*i]).sum::<f64>();
                own.ger(weight, &row.by_pose, &row.by_pose, 1.0);
                right -= row.by_pose * (weight * px);
                sum += weight * px * px;
            }
        }
        Some(sum - right.dot(&own.cholesky()?.solve(&right)))
    }
}

fn extent(all: impl Iterator<Item = Vector2<f64>>) -> (Vector2<f64>, Vector2<f64>) {
    let none = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
    all.fold(none, |(low, high), at| (low.inf(&at), high.sup(&at)))
}
