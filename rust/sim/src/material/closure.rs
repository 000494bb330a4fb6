//! How a carton is closed: the slits between its flaps, tape along and over its edges, straps. Each is a block in the carton's
//! own frame that shows wherever it touches the surface, so that what runs over an edge goes on behind it.

use super::kinds::{STRAPS, TAPES};
use super::{Art, Decal};
use crate::rng::Rng;
use crate::solid::{FACES, face_uv};
use crate::stock::{Kind, Stock};
use crate::vec3::{V3, v3};
use nalgebra::Vector3;

const SEAM: &str = "seam";

/// A carton's half sizes, mm, and its axes by what the flaps do.
struct Frame {
    half: [f32; 3],
    /// The axis that the flaps close.
    flap: usize,
    /// The axis along which the long flaps meet.
    along: usize,
    /// The remaining one.
    across: usize,
}

/// From and to along the three axes of the carton, mm.
type Block = [[f32; 2]; 3];

impl Frame {
    fn new(rng: &mut Rng, half: &Vector3<f64>) -> Self {
        let half = [half.x as f32, half.y as f32, half.z as f32];
        // Most boxes stand on their flaps; one that lies shows them at a side.
        let flap = if rng.chance(0.65) { 2 } else { rng.below(2) };
        let (a, b) = ((flap + 1) % 3, (flap + 2) % 3);
        // The long flaps are those of the long sides, nearly always.
        let swap = (half[a] < half[b]) != rng.chance(0.15);
        let (along, across) = if swap { (b, a) } else { (a, b) };
        Self { half, flap, along, across }
    }

    /// The whole carton.
    fn all(&self) -> Block {
        self.half.map(|h| [-h, h])
    }

    /// The whole carton, but for ranges along some of its axes.
    fn block<const N: usize>(&self, parts: [(usize, [f32; 2]); N]) -> Block {
        let mut block = self.all();
        for (axis, range) in parts {
            block[axis] = range;
        }
        block
    }

    /// From `deep` below the surface on one side of an axis up to it.
    fn rim(&self, axis: usize, side: f32, deep: f32) -> [f32; 2] {
        let (low, high) = (self.half[axis] - deep, self.half[axis]);
        if side > 0.0 { [low, high] } else { [-high, -low] }
    }

    /// Puts `art` wherever the block touches one of `faces`.
    fn put(
        &self,
        block: &Block,
        faces: &[usize],
        kind: &'static str,
        art: &Art,
        gloss: Option<f32>,
        decals: &mut Vec<Decal>,
    ) {
        for &face in faces {
            let axis = face / 2;
            let touches = if face.is_multiple_of(2) {
                block[axis][1] >= self.half[axis]
            } else {
                block[axis][0] <= -self.half[axis]
            };
            if !touches {
                continue;
            }
            let end = |i: usize| {
                let [x, y, z] = block.map(|range| range[i]);
                face_uv(face, v3(x, y, z))
            };
            let ((u0, v0), (u1, v1)) = (end(0), end(1));
            decals.push(Decal {
                kind,
                face,
                centre: [0.5 * (u0 + u1), 0.5 * (v0 + v1)],
                turn_rad: 0.0,
                half: [0.5 * (u1 - u0).abs(), 0.5 * (v1 - v0).abs()],
                art: art.clone(),
                gloss,
            });
        }
    }
}

const EVERY: [usize; FACES] = [0, 1, 2, 3, 4, 5];

/// About a middle.
fn about(middle: f32, half: f32) -> [f32; 2] {
    [middle - half, middle + half]
}

/// The flaps with their slits, the joint at a corner, and tape.
pub fn close(rng: &mut Rng, half: &Vector3<f64>, board: V3, stock: &Stock, decals: &mut Vec<Decal>) {
    let frame = Frame::new(rng, half);
    let taped = rng.chance(0.75);
    slits(rng, &frame, board, taped, decals);
    if taped {
        tape(rng, &frame, stock, decals);
    }
}

/// Dark slits: between the long flaps, beside them at both ends, under their ends as the sides show them.
fn slits(rng: &mut Rng, frame: &Frame, board: V3, taped: bool, decals: &mut Vec<Decal>) {
    let Frame { half, flap, along, across } = *frame;
    let dark = board * 0.25;
    let srgb = [dark.x, dark.y, dark.z].map(|c| (c.max(0.0).powf(1.0 / 2.2) * 255.0).min(255.0) as u8);
    let mut slit = |block: &Block, cover: f32, axis: usize| {
        frame.put(block, &[2 * axis, 2 * axis + 1], SEAM, &Art::Print(SEAM, srgb, cover), None, decals);
    };
    // Half a gap: tape holds the flaps together, without it they spring apart.
    let gap = if taped { rng.range_f32(0.4, 1.6) } else { rng.log_range(0.5, 5.0) as f32 };
    let gap = gap.min(0.04 * half[across]);
    slit(&frame.block([(across, about(rng.range_f32(-1.0, 1.0), gap))]), 1.0, flap);
    if rng.chance(0.5) {
        // Short flaps show as a faint step beneath the long ones.
        let at = (half[along] - half[across]).max(0.3 * half[along]);
        for side in [-1.0, 1.0] {
            slit(&frame.block([(along, about(side * at, 0.7))]), 0.2, flap);
        }
    }
    if rng.chance(0.5) {
        // The long flaps end a little before the fold of the short ones, and lie on them by the board's thickness.
        let (back, thick) = (rng.range_f32(0.5, 6.0), rng.range_f32(3.0, 7.0));
        let fine = rng.range_f32(0.3, 1.0);
        for side in [-1.0, 1.0] {
            let cover = rng.range_f32(0.4, 1.0);
            slit(&frame.block([(along, about(side * (half[along] - back), fine))]), cover, flap);
            slit(&frame.block([(flap, about(side * (half[flap] - thick), fine))]), cover, along);
        }
    }
    if rng.chance(0.35) {
        let at = half[along] - 35f32.min(0.4 * half[along]);
        slit(&frame.block([(along, about(-at, 0.6))]), 1.0, across);
    }
}

/// Tape over the seam, hanging over onto the short sides; across it at both ends too, as an H; or around somewhere.
fn tape(rng: &mut Rng, frame: &Frame, stock: &Stock, decals: &mut Vec<Decal>) {
    let Frame { half, flap, along, across } = *frame;
    let Kind { word, what: (rgb, cover), .. } = *stock.pick(rng, &TAPES);
    let art = Art::Tape(rgb, cover);
    let gloss = Some(rng.range_f32(0.25, 0.6));
    let wide = rng.range_f32(22.0, 38.0).min(0.45 * half[across]);
    let ends = rng.chance(0.25);
    for side in [-1.0, 1.0] {
        let hang = rng.range_f32(40.0, 70.0).min(half[flap]);
        let shift = rng.normal() as f32 * 1.5;
        let seam = frame.block([(across, about(shift, wide)), (flap, frame.rim(flap, side, hang))]);
        frame.put(&seam, &EVERY, word, &art, gloss, decals);
        for end in [-1.0, 1.0] {
            if ends {
                let over = wide * rng.range_f32(0.7, 1.3);
                let parts = [(along, frame.rim(along, end, over)), (flap, frame.rim(flap, side, over))];
                frame.put(&frame.block(parts), &EVERY, word, &art, gloss, decals);
            }
        }
    }
    if rng.chance(0.12) {
        let axis = rng.below(3);
        let at = rng.range_f32(-0.8, 0.8) * half[axis];
        let around = frame.block([(axis, about(at, wide.min(0.2 * half[axis])))]);
        let faces: Vec<usize> = (0..FACES).filter(|f| f / 2 != axis).collect();
        frame.put(&around, &faces, word, &art, gloss, decals);
    }
}

/// One or two straps around the box, over the top and two sides.
pub fn straps(rng: &mut Rng, half: &Vector3<f64>, stock: &Stock, decals: &mut Vec<Decal>) {
    let Kind { word, what: rgb, .. } = *stock.pick(rng, &STRAPS);
    let frame = Frame::new(rng, half);
    let wide = rng.range_f32(4.0, 9.0);
    let axis = rng.below(2);
    let reach = frame.half[axis];
    let count = 1 + rng.below(2);
    for i in 0..count {
        let share =
            if count == 1 { rng.range_f32(-0.3, 0.3) } else { [-0.5, 0.5][i % 2] + rng.range_f32(-0.1, 0.1) };
        let around = frame.block([(axis, about(share * reach, wide))]);
        let faces: Vec<usize> = (0..FACES).filter(|f| f / 2 != axis).collect();
        frame.put(&around, &faces, word, &Art::Fill(rgb), Some(0.3), decals);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::linear;

    #[test]
    fn tape_over_an_edge_goes_on_at_the_same_place_behind_it() {
        let mut decals = Vec::new();
        let frame = Frame { half: [200.0, 150.0, 100.0], flap: 2, along: 0, across: 1 };
        let block = frame.block([(1, about(20.0, 25.0)), (2, frame.rim(2, 1.0, 60.0))]);
        frame.put(&block, &EVERY, "tape", &Art::Tape([0; 3], 1.0), None, &mut decals);
        let faces: Vec<_> = decals.iter().map(|d| d.face).collect();
        assert_eq!(faces, [0, 1, 4]);
        // On the right side (right is +y, down is -z) the strip is 60 mm long from the upper edge.
        assert_eq!((decals[0].centre, decals[0].half), ([20.0, -70.0], [25.0, 30.0]));
        assert_eq!((decals[1].centre, decals[1].half), ([-20.0, -70.0], [25.0, 30.0]));
        // On the top right is +x and down is -y.
        assert_eq!((decals[2].centre, decals[2].half), ([0.0, -20.0], [200.0, 25.0]));
    }

    #[test]
    fn flaps_meet_in_the_middle_of_two_opposite_faces_of_each_kind() {
        let mut seen = [false; 3];
        for seed in 0..60 {
            let mut rng = Rng::new(seed, 1);
            let mut decals = Vec::new();
            close(
                &mut rng,
                &Vector3::new(200.0, 150.0, 100.0),
                linear([150; 3]),
                &Stock::default(),
                &mut decals,
            );
            let axis = decals[0].face / 2;
            assert_eq!(decals[1].face / 2, axis);
            assert!(decals[0].centre.iter().all(|c| c.abs() <= 1.0), "{:?}", decals[0]);
            seen[axis] = true;
        }
        assert_eq!(seen, [true; 3]);
    }
}
