//! How far a line is from a true side: for the programs that learn from lines.

use boxline::Px;
use boxline_proto::json::TruthFace;

/// The true face in a frame.
pub struct TrueFace {
    pub corners_px: [[f64; 2]; 4],
    pub mm_per_px: f64,
    /// Of the box's edges.
    pub radius_mm: f64,
}

impl TrueFace {
    /// `None` if no face is in view.
    pub fn of(face: &TruthFace) -> Option<Self> {
        let (corners_px, [length_mm, width_mm]) = (face.corners_px?, face.size_mm?);
        let doubled: f64 = (0..4)
            .map(|i| {
                let ([u, v], [x, y]) = (corners_px[i], corners_px[(i + 1) % 4]);
                u * y - v * x
            })
            .sum();
        let mm_per_px = (length_mm * width_mm / (0.5 * doubled.abs())).sqrt();
        Some(Self { corners_px, mm_per_px, radius_mm: face.notes.edge_radius_mm.unwrap_or(0.0) })
    }

    /// How far a line with this middle, seen from the face's inside in this direction, is from the true side that looks the same way,
    /// px outwards.
    pub fn off_px(&self, middle: Px, [o, p]: [f64; 2]) -> Option<f64> {
        let centre = [0, 1].map(|i| self.corners_px.iter().map(|c| c[i]).sum::<f64>() / 4.0);
        let sides = (0..4).map(|i| {
            let ([u, v], [x, y]) = (self.corners_px[i], self.corners_px[(i + 1) % 4]);
            let length = (x - u).hypot(y - v);
            let normal = [(y - v) / length, (u - x) / length];
            let outside = (0.5 * (u + x) - centre[0]) * normal[0] + (0.5 * (v + y) - centre[1]) * normal[1];
            let normal = normal.map(|n| n * outside.signum());
            let facing = normal[0] * o + normal[1] * p;
            (facing, (normal[0] * (middle.u - u) + normal[1] * (middle.v - v)) / facing)
        });
        let (facing, off_px) = sides.max_by(|a, b| a.0.total_cmp(&b.0))?;
        (facing > 0.5).then_some(off_px)
    }
}
