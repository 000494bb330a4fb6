//! How a carton is closed: the slits between its flaps, tape along and over its edges, straps, labels bent over edges. Each is
//! a block in the carton's own frame that shows wherever it touches the surface, so that what runs over an edge goes on behind it.

use super::kinds::{LABELS, STRAPS, TAPES};
use super::{Art, Decal};
use crate::hazard::Hazard;
use crate::rng::Rng;
use crate::solid::{FACES, face_axes, face_normal, face_of, face_uv};
use crate::stock::{Kind, Stock};
use crate::vec3::{V3, v3};
use nalgebra::Vector3;
use std::collections::BTreeSet;

const SEAM: &str = "seam";

/// A carton's half sizes, mm, and its axes by what the flaps do.
pub struct Frame {
    half: [f32; 3],
    /// The axis that the flaps close.
    pub flap: usize,
    /// The axis along which the long flaps meet.
    along: usize,
    /// The remaining one.
    across: usize,
}

/// From and to along the three axes of the carton, mm.
type Block = [[f32; 2]; 3];

impl Frame {
    /// Draws which way the flaps lie.
    pub fn new(rng: &mut Rng, half: &Vector3<f64>) -> Self {
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

/// The flaps with their slits, the joint at a corner, and tape; of the hazards those drawn.
pub fn close(
    rng: &mut Rng,
    frame: &Frame,
    board: V3,
    stock: &Stock,
    drawn: &BTreeSet<Hazard>,
    decals: &mut Vec<Decal>,
) {
    let h_tape = drawn.contains(&Hazard::HTape);
    let taped = rng.chance(0.75) || h_tape;
    slits(&mut rng.child(), frame, board, taped, drawn.contains(&Hazard::FlapSeam), decals);
    if taped {
        tape(&mut rng.child(), frame, stock, h_tape, decals);
    }
}

/// Dark slits: between the long flaps, beneath them; if `near_edges` also beside the flaps' ends, and the joint of the sides.
fn slits(rng: &mut Rng, frame: &Frame, board: V3, taped: bool, near_edges: bool, decals: &mut Vec<Decal>) {
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
    if !near_edges {
        return;
    }
    let joint = rng.chance(0.4);
    if !joint || rng.chance(0.5) {
        // The long flaps end a little before the fold of the short ones, and lie on them by the board's thickness.
        let (back, thick) = (rng.range_f32(0.5, 6.0), rng.range_f32(3.0, 7.0));
        let fine = rng.range_f32(0.3, 1.0);
        for side in [-1.0, 1.0] {
            let cover = rng.range_f32(0.4, 1.0);
            slit(&frame.block([(along, about(side * (half[along] - back), fine))]), cover, flap);
            slit(&frame.block([(flap, about(side * (half[flap] - thick), fine))]), cover, along);
        }
    }
    if joint {
        let at = half[along] - 35f32.min(0.4 * half[along]);
        slit(&frame.block([(along, about(-at, 0.6))]), 1.0, across);
    }
}

/// Tape over the seam, hanging over onto the short sides; across both ends too, as an H, if wanted; or around somewhere.
fn tape(rng: &mut Rng, frame: &Frame, stock: &Stock, ends: bool, decals: &mut Vec<Decal>) {
    let Frame { half, flap, along, across } = *frame;
    let Kind { word, what: (rgb, cover), .. } = *stock.pick(rng, &TAPES);
    let art = Art::Tape(rgb, cover);
    let gloss = Some(rng.range_f32(0.25, 0.6));
    let wide = rng.range_f32(22.0, 38.0).min(0.45 * half[across]);
    for side in [-1.0, 1.0] {
        let hang = rng.range_f32(40.0, 70.0).min(half[flap]);
        let shift = rng.normal() as f32 * 1.5;
        let seam = frame.block([(across, about(shift, wide)), (flap, frame.rim(flap, side, hang))]);
        frame.put(&seam, &EVERY, word, &art, gloss, decals);
        for end in [-1.0, 1.0] {
            let over = wide * rng.range_f32(0.7, 1.3);
            if ends {
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

/// Two faces that meet at an edge, never an edge of the underside: their axes, which side of each, the edge's own axis.
struct Edge {
    axes: [usize; 2],
    sides: [f32; 2],
    along: usize,
}

impl Edge {
    fn new(rng: &mut Rng) -> Self {
        let along = rng.below(3);
        let axes = [(along + 1) % 3, (along + 2) % 3];
        let sides = axes.map(|axis| if axis == 2 { 1.0 } else { rng.sign() as f32 });
        Self { axes, sides, along }
    }

    fn faces(&self) -> [usize; 2] {
        [0, 1].map(|i| face_of(self.axes[i], self.sides[i] > 0.0))
    }
}

/// Tape folded over one to three edges: 20 to 30 mm of it on one face, the rest round the edge.
pub fn edge_tape(rng: &mut Rng, frame: &Frame, stock: &Stock, decals: &mut Vec<Decal>) {
    let Kind { word, what: (rgb, cover), .. } = *stock.pick(rng, &TAPES);
    let art = Art::Tape(rgb, cover);
    let gloss = Some(rng.range_f32(0.2, 0.5));
    let wide = rng.pick([48.0, 50.0, 60.0]);
    for _ in 0..1 + rng.below(3) {
        let edge = Edge::new(rng);
        let first = rng.range_f32(20.0, 30.0);
        let parts = if rng.chance(0.5) { [first, wide - first] } else { [wide - first, first] };
        let rim = |i: usize| {
            let axis = edge.axes[i];
            // On a small box less of it finds room.
            (axis, frame.rim(axis, edge.sides[i], parts[i].min(0.8 * frame.half[axis])))
        };
        let reach = frame.half[edge.along];
        let ends = [0, 1].map(|_| if rng.chance(0.5) { 0.0 } else { rng.range_f32(0.0, 0.2) * reach });
        let strip = frame.block([(edge.along, [ends[0] - reach, reach - ends[1]]), rim(0), rim(1)]);
        frame.put(&strip, &edge.faces(), word, &art, gloss, decals);
    }
}

/// One to three straps around the box, 12 to 16 mm wide, most of them 0 to 25 mm beside an edge.
pub fn straps(rng: &mut Rng, frame: &Frame, stock: &Stock, decals: &mut Vec<Decal>) {
    let Kind { word, what: rgb, .. } = *stock.pick(rng, &STRAPS);
    let wide = rng.range_f32(6.0, 8.0);
    let gloss = Some(rng.range_f32(0.15, 0.4));
    for _ in 0..1 + rng.below(3) {
        // Over the top and two sides; now and then a belt.
        let axis = if rng.chance(0.8) { rng.below(2) } else { 2 };
        let reach = frame.half[axis] - wide;
        let at = if rng.chance(0.7) {
            rng.sign() as f32 * (reach - rng.range_f32(0.0, 25.0))
        } else {
            rng.range_f32(-0.6, 0.6) * reach
        };
        let around = frame.block([(axis, about(at, wide))]);
        let faces: Vec<usize> = (0..FACES).filter(|f| f / 2 != axis).collect();
        frame.put(&around, &faces, word, &Art::Fill(rgb), gloss, decals);
    }
}

/// A label stuck over an edge: what does not find room on one face goes on on the next.
pub fn bent_label(rng: &mut Rng, frame: &Frame, stock: &Stock, decals: &mut Vec<Decal>) {
    let Kind { word, what: (layout, paper), .. } = *stock.pick(rng, &LABELS);
    let edge = Edge::new(rng);
    let [first, second] = edge.faces();
    let (up, out) = (V3::from(face_normal(first)), V3::from(face_normal(second)));
    let mut along = [0.0; 3];
    along[edge.along] = 1.0;
    let along = v3(along[0], along[1], along[2]);
    // Upright on the first face, or on its side.
    let (right, down) = face_axes(first);
    let right: V3 = if rng.chance(0.3) { down.into() } else { right.into() };
    let most = 0.8 * frame.half[edge.along].min(frame.half[edge.axes[0]]).min(frame.half[edge.axes[1]]);
    let wide = rng.range_f32(35.0, 80.0).min(most);
    let high = (wide * rng.range_f32(0.6, 1.4)).min(most);
    let sizes = [wide, high];
    let (over_edge, along_edge) = if right.dot(out).abs() > 0.5 { (wide, high) } else { (high, wide) };
    // How far its middle lies beyond the edge as the first face sees it.
    let beyond = rng.range_f32(-0.7, 0.7) * over_edge;
    let place = along * (rng.range_f32(-0.9, 0.9) * (frame.half[edge.along] - along_edge));
    let (tall, broad) = (frame.half[edge.axes[0]], frame.half[edge.axes[1]]);
    // Round the edge the way outwards becomes the way down.
    let folded = |d: V3| d + (out + up) * -d.dot(out);
    let art = Art::Label((u64::from(rng.bits()) << 32) | u64::from(rng.bits()), layout, paper);
    let gloss = Some(rng.range_f32(0.05, 0.3));
    let askew = rng.normal() as f32 * 0.01;
    let pieces = [
        (first, up * tall + out * (broad + beyond) + place, right),
        (second, out * broad + up * (tall - beyond) + place, folded(right)),
    ];
    for (face, middle, right) in pieces {
        let ((u, v), (across, sinking)) = (face_uv(face, middle), face_uv(face, right));
        let turn_rad = sinking.atan2(across) + askew;
        decals.push(Decal {
            kind: word,
            face,
            centre: [u, v],
            turn_rad,
            half: sizes,
            art: art.clone(),
            gloss,
        });
    }
}

/// A slot to put a hand through, in the upper part of two opposite sides; `false` if no pair of sides is large enough.
pub fn hand_holes(rng: &mut Rng, frame: &Frame, decals: &mut Vec<Decal>) -> bool {
    let half = [rng.range_f32(37.5, 45.0), rng.range_f32(12.5, 15.0)];
    let (down, first) = (rng.range_f32(0.25, 0.6), rng.below(2));
    let high = frame.half[2];
    let Some(axis) = [first, 1 - first].into_iter().find(|axis| frame.half[1 - axis] > 90.0 && high > 60.0)
    else {
        return false;
    };
    for face in [2 * axis, 2 * axis + 1] {
        let centre = [0.0, -down * high];
        decals.push(Decal {
            kind: "hand hole",
            face,
            centre,
            turn_rad: 0.0,
            half,
            art: Art::Hole,
            gloss: Some(0.0),
        });
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::linear;
    use crate::material::lines::{FalseLine, false_lines};

    #[test]
    fn tape_over_an_edge_goes_on_at_the_same_place_behind_it() {
        let mut decals = Vec::new();
        let frame = frame([200.0, 150.0, 100.0]);
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
            let frame = Frame::new(&mut rng, &Vector3::new(200.0, 150.0, 100.0));
            let board = linear([150; 3]);
            close(&mut rng, &frame, board, &Stock::default(), &BTreeSet::new(), &mut decals);
            let axis = decals[0].face / 2;
            assert_eq!((decals[1].face / 2, axis), (axis, frame.flap));
            assert!(decals[0].centre.iter().all(|c| c.abs() <= 1.0), "{:?}", decals[0]);
            seen[axis] = true;
        }
        assert_eq!(seen, [true; 3]);
    }

    fn frame(half: [f32; 3]) -> Frame {
        Frame { half, flap: 2, along: 0, across: 1 }
    }

    /// The lines along edges that decals draw on a carton of these half sizes.
    fn lines(half: [f32; 3], decals: &[Decal]) -> Vec<FalseLine> {
        let half = Vector3::from(half.map(f64::from));
        false_lines(decals, |face| crate::world::face_half(&half, face).map(|h| h as f32))
    }

    #[test]
    fn tape_on_an_edge_ends_20_to_30_mm_inside_one_of_its_faces() {
        let half = [300.0, 200.0, 150.0];
        for seed in 0..40 {
            let mut decals = Vec::new();
            edge_tape(&mut Rng::new(seed, 1), &frame(half), &Stock::default(), &mut decals);
            assert!(decals.len() >= 2 && decals.iter().all(|d| d.face != 5));
            for pair in decals.chunks(2) {
                let inside: Vec<f32> = lines(half, pair).iter().map(|l| l.offset_mm).collect();
                assert!(
                    inside.len() == 2 && inside.iter().any(|mm| (20.0..=30.0).contains(mm)),
                    "{inside:?}"
                );
            }
        }
    }

    #[test]
    fn straps_are_12_to_16_mm_wide_and_often_close_to_an_edge() {
        let half = [300.0, 200.0, 150.0];
        let (mut close, mut all) = (0, 0);
        for seed in 0..60 {
            let mut decals = Vec::new();
            straps(&mut Rng::new(seed, 1), &frame(half), &Stock::default(), &mut decals);
            for strap in decals.chunks(4) {
                assert!(strap.iter().all(|d| (6.0..=8.0).contains(&d.half[0].min(d.half[1]))));
                all += 1;
                close += usize::from(lines(half, strap).iter().any(|l| l.offset_mm < 41.1));
            }
        }
        assert!(close * 10 > all * 6 && close < all, "{close} of {all}");
    }

    #[test]
    fn a_label_over_an_edge_goes_on_where_it_left_the_face() {
        let half = [300.0, 200.0, 150.0];
        for seed in 0..200 {
            let mut decals = Vec::new();
            bent_label(&mut Rng::new(seed, 1), &frame(half), &Stock::default(), &mut decals);
            // Where a point of the edge lies on the label, seen from either face.
            let Decal { face: first, .. } = decals[0];
            let Decal { face: second, .. } = decals[1];
            let mut at = [0.0; 3];
            for face in [first, second] {
                at[face / 2] = half[face / 2] * if face.is_multiple_of(2) { 1.0 } else { -1.0 };
            }
            for along in [-40.0, 25.0] {
                at[3 - first / 2 - second / 2] = along;
                let [a, b] = [&decals[0], &decals[1]].map(|d| {
                    let (u, v) = face_uv(d.face, v3(at[0], at[1], at[2]));
                    let (du, dv) = (u - d.centre[0], v - d.centre[1]);
                    let (sin, cos) = d.turn_rad.sin_cos();
                    [du * cos + dv * sin, dv * cos - du * sin]
                });
                assert!((a[0] - b[0]).abs() < 0.01 && (a[1] - b[1]).abs() < 0.01, "seed {seed}: {a:?} {b:?}");
            }
        }
    }

    #[test]
    fn flap_seams_and_h_tape_come_only_where_they_are_drawn() {
        let half = [300.0, 200.0, 150.0];
        let count = |drawn: &[Hazard], kind: &dyn Fn(&FalseLine) -> bool| {
            let mut decals = Vec::new();
            for seed in 0..10 {
                let drawn = drawn.iter().copied().collect();
                let board = linear([150; 3]);
                close(&mut Rng::new(seed, 1), &frame(half), board, &Stock::default(), &drawn, &mut decals);
            }
            lines(half, &decals).iter().filter(|l| kind(l)).count()
        };
        let seam = |l: &FalseLine| l.kind == SEAM && l.offset_mm < 36.0;
        // Tape across an end runs along a short edge of the top.
        let tape = |l: &FalseLine| l.kind.ends_with("tape") && l.face == 4 && l.side < 2;
        assert_eq!((count(&[], &seam), count(&[], &tape)), (0, 0));
        assert!(count(&[Hazard::FlapSeam], &seam) > 10 && count(&[Hazard::HTape], &tape) > 10);
    }

    #[test]
    fn hand_holes_are_where_they_find_room() {
        let holes = |half: [f32; 3]| {
            let mut decals = Vec::new();
            assert_eq!(hand_holes(&mut Rng::new(1, 1), &frame(half), &mut decals), !decals.is_empty());
            decals.len()
        };
        assert_eq!((holes([200.0, 150.0, 100.0]), holes([60.0, 60.0, 100.0])), (2, 0));
    }
}
