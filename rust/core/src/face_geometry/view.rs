//! What a head sees of a face somewhere before it: corners, where the stripes cross its sides, and the lines that follow.
//! PHYSICS.md, "What can be measured". The lasers' fans are taken as wider than the picture.

use super::{FaceLines, Line, LinePoint, STRIPE_SYSTEMATIC_PX, side_systematic_px};
use crate::calibration::Calibration;
use crate::face::model::FaceState;
use crate::frames::{Cam, Point};
use crate::units::{LaserId, Px};
use nalgebra::{Matrix3, Vector3};

/// A rectangle somewhere before the head.
#[derive(Clone, Copy, Debug)]
pub struct FacePose {
    /// Columns: along the length, along the width, away from the camera.
    pub axes: Matrix3<f64>,
    /// The middle in the camera frame, mm.
    pub middle: Vector3<f64>,
    /// Half of length and width, mm.
    pub half_mm: [f64; 2],
}

/// The pair of sides that a stripe crosses, on the face: x along the length, y along the width, mm from the middle.
#[derive(Clone, Copy, Debug)]
pub struct Crossing {
    /// It runs along the length (crosses sides 1 and 3), or along the width.
    pub along_length: bool,
    /// Where it crosses them, low side first.
    pub at: [[f64; 2]; 2],
    /// Distance of the nearer crossing from its side's end, as a share of the side; negative beyond the corner.
    pub margin: f64,
}

/// Residuals that a line's points are expected to have, px: one point in 4 px counts, as neighbours go together
/// (PHYSICS.md, "From stripes and edges to sides").
#[derive(Clone, Copy, Debug)]
pub struct PointSigmas {
    /// Of a stripe.
    pub stripe_px: f64,
    /// Of a side.
    pub edge_px: f64,
    /// With what does not average out along a line.
    pub systematic: bool,
}

/// Speckle and blur as PHYSICS.md has them.
pub const USUAL: PointSigmas = PointSigmas { stripe_px: 0.3, edge_px: 0.5, systematic: true };
const PX_PER_POINT: f64 = 4.0;

impl FacePose {
    /// A face from the direction of its length, its normal (either sign) and middle. `None` if seen edge on.
    pub fn new(
        along_length: Vector3<f64>,
        normal: Vector3<f64>,
        middle: Vector3<f64>,
        size_mm: [f64; 2],
    ) -> Option<Self> {
        let normal = normal.try_normalize(1e-9)?;
        let normal = if normal.dot(&middle) < 0.0 { -normal } else { normal };
        let length = (along_length - normal * normal.dot(&along_length)).try_normalize(1e-9)?;
        let axes = Matrix3::from_columns(&[length, normal.cross(&length), normal]);
        let seen = normal.dot(&middle) > 1e-6 * middle.norm() && middle.z > 0.0;
        seen.then_some(Self { axes, middle, half_mm: size_mm.map(|s| 0.5 * s) })
    }

    /// A face from its corners in the camera frame, going round.
    pub fn from_corners(corners: [Vector3<f64>; 4]) -> Option<Self> {
        let [c0, c1, c2, c3] = corners;
        let middle = corners.iter().sum::<Vector3<f64>>() / 4.0;
        let (one, other) = (c1 - c0, c3 - c0);
        let normal = one.cross(&other);
        let size = |a: Vector3<f64>, b: Vector3<f64>| 0.5 * (a.norm() + b.norm());
        let (first, second) = (size(one, c2 - c3), size(other, c2 - c1));
        let finite = first.is_finite() && second.is_finite();
        if !finite {
            return None;
        }
        if first >= second {
            Self::new(one, normal, middle, [first, second])
        } else {
            Self::new(other, normal, middle, [second, first])
        }
    }

    /// A point of the face, mm along length and width from the middle, in the camera frame.
    pub fn point(&self, [x, y]: [f64; 2]) -> Point<Cam> {
        Point::from_vector(self.middle + self.axes.column(0) * x + self.axes.column(1) * y)
    }

    /// The corners going round; corner 0 to 1 along the length.
    pub fn corners(&self) -> [[f64; 2]; 4] {
        let [x, y] = self.half_mm;
        [[-x, -y], [x, -y], [x, y], [-x, y]]
    }

    /// The face as unknowns of the fit.
    pub fn state(&self) -> FaceState {
        let [a, b] = [0, 1].map(|axis| self.axes.column(axis).dot(&self.middle));
        let [x, y] = self.half_mm;
        FaceState {
            axes: self.axes,
            per_mm: 1.0 / self.axes.column(2).dot(&self.middle),
            offsets_mm: [a - x, a + x, b - y, b + y],
            shape_rad: [0.0; 3],
        }
    }

    /// Where the plane of a laser crosses opposite sides, or the lines they lie on: the pair with the larger margin.
    pub fn crossing(&self, calibration: &Calibration, id: LaserId) -> Option<Crossing> {
        let p = calibration.laser(id).per_mm;
        let by = [p.dot(&self.axes.column(0)), p.dot(&self.axes.column(1))];
        let rest = 1.0 - p.dot(&self.middle);
        // On the line by[0] x + by[1] y = rest: at x = +-half along the length, or at y = +-half along the width.
        let candidate = |along: usize| {
            let across = 1 - along;
            let at = [-1.0, 1.0].map(|side| {
                let mut at = [0.0; 2];
                at[along] = side * self.half_mm[along];
                at[across] = (rest - by[along] * at[along]) / by[across];
                at
            });
            let farthest = at.iter().map(|a| a[across].abs()).fold(0.0, f64::max);
            let margin = 0.5 * (1.0 - farthest / self.half_mm[across]);
            margin.is_finite().then_some(Crossing { along_length: along == 0, at, margin })
        };
        let (length, width) = (candidate(0), candidate(1));
        [length, width].into_iter().flatten().max_by(|a, b| a.margin.total_cmp(&b.margin))
    }

    /// The 16 numbers that the head would see, without noise, with the sigmas to expect. `None` where a line is not seen.
    pub fn lines(&self, calibration: &Calibration, sigmas: &PointSigmas) -> Option<FaceLines> {
        let corners = self.corners();
        let systematic = if sigmas.systematic { 1.0 } else { 0.0 };
        let side_systematic = side_systematic_px(calibration, self.middle.z) * systematic;
        let stripe = |id: LaserId| {
            let [a, b] = self.crossing(calibration, id)?.at;
            self.line(calibration, a, b, sigmas.stripe_px, STRIPE_SYSTEMATIC_PX * systematic)
        };
        let side = |i: usize| {
            self.line(calibration, corners[i], corners[(i + 1) % 4], sigmas.edge_px, side_systematic)
        };
        let [l1, l2, l3, l4] = LaserId::ALL;
        Some(FaceLines {
            stripes: [stripe(l1)?, stripe(l2)?, stripe(l3)?, stripe(l4)?],
            sides: [side(3)?, side(1)?, side(0)?, side(2)?],
        })
    }

    fn line(
        &self,
        calibration: &Calibration,
        a: [f64; 2],
        b: [f64; 2],
        point_sigma_px: f64,
        systematic_px: f64,
    ) -> Option<Line> {
        let px = |at: [f64; 2]| calibration.camera().px_from_point(&self.point(at));
        let points = (px(a)?.distance_px(px(b)?) / PX_PER_POINT).max(2.0);
        let sigma_px = (2.0 * point_sigma_px.powi(2) / points).sqrt().hypot(systematic_px);
        // Even spread from end to end has a standard deviation of 1 / sqrt(12).
        let place = |t: f64| -> Option<LinePoint> {
            let at: Px = px([a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t])?;
            Some(LinePoint { at, sigma_px })
        };
        let reach = 1.0 / 12f64.sqrt();
        Some([place(0.5 - reach)?, place(0.5 + reach)?])
    }
}
