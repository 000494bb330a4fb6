//! Print that runs along a face's edges: lines, bands, frames, zones. Whoever looks for the straight borders of a face finds
//! these too, and they are none: labels leave them out.

use super::kinds::{EDGINGS, PRINTS};
use super::{Art, Decal};
use crate::rng::Rng;
use crate::stock::{Kind, Stock};
use nalgebra::Vector3;

/// A way to print along the edges.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edging {
    /// So many fine lines side by side, from edge to edge.
    Lines(usize),
    /// A broad band from edge to edge, of this many colours side by side.
    Band(usize),
    /// A large part of the face up to its edge.
    Zone,
    /// A bar that ends before the face does.
    Header,
    /// So many rectangles inside each other.
    Frame(usize),
    /// All but a margin.
    Panel,
    /// Bands along two sides that meet.
    Hem,
    /// A broken line.
    Dashes,
    /// Lines from edge to edge along all four sides.
    Crossed,
}

/// A face's sides: left, right, upper, lower.
type Side = usize;

/// One printing plate: the same numbers for every face that gets it.
struct Plate {
    edging: Edging,
    kind: &'static str,
    side: Side,
    /// Both this side and the opposite one.
    both: bool,
    /// From the face's edge to the print, mm; 0 is up to the edge.
    inset: f32,
    /// Thickness of a line, mm.
    line: f32,
    /// Width of a band, mm.
    band: f32,
    /// Share of the face that a zone takes.
    share: f32,
    /// Between lines, and before the ends of what ends early, mm.
    gap: f32,
    inks: [Kind<[u8; 3]>; 2],
    /// How much of the board the ink hides.
    cover: f32,
}

impl Plate {
    fn new(rng: &mut Rng, stock: &Stock) -> Self {
        let kind = stock.pick(rng, &EDGINGS);
        Self {
            edging: kind.what,
            kind: kind.word,
            side: rng.below(4),
            both: rng.chance(0.35),
            inset: if rng.chance(0.25) { 0.0 } else { rng.log_range(10.0, 120.0) as f32 },
            line: rng.log_range(0.8, 8.0) as f32,
            band: rng.log_range(8.0, 90.0) as f32,
            share: rng.range_f32(0.2, 0.55),
            gap: rng.log_range(3.0, 40.0) as f32,
            inks: [*stock.pick(rng, &PRINTS), *stock.pick(rng, &PRINTS)],
            cover: rng.range_f32(0.8, 1.0),
        }
    }

    /// An area in one of the inks.
    fn art(&self, ink: usize) -> Art {
        let Kind { word, what: rgb, .. } = self.inks[ink];
        Art::Print(word, rgb, self.cover)
    }

    fn print(&self, face: usize, half: [f32; 2], decals: &mut Vec<Decal>) {
        let least = half[0].min(half[1]);
        // On a small face everything moves closer to the edges.
        let inset = self.inset.min(0.45 * least);
        let gap = self.gap.min(0.2 * least);
        let line = self.line.min(0.06 * least);
        let band = self.band.min(0.5 * least);
        let mut put = |centre: [f32; 2], half: [f32; 2], art: Art| {
            decals.push(Decal { kind: self.kind, face, centre, turn_rad: 0.0, half, art, gloss: None });
        };
        // From `from` to `to` mm inside a side, leaving `ends` mm at both ends.
        let mut strip = |side: Side, from: f32, to: f32, ends: f32, ink: usize| {
            let (across, along) = if side < 2 { (0, 1) } else { (1, 0) };
            let (mut centre, mut size) = ([0.0; 2], [0.0; 2]);
            centre[across] =
                (half[across] - 0.5 * (from + to)) * if side.is_multiple_of(2) { -1.0 } else { 1.0 };
            size[across] = 0.5 * (to - from);
            size[along] = half[along] - ends;
            put(centre, size, self.art(ink));
        };
        let sides = [self.side, self.side ^ 1];
        let sides = if self.both { &sides[..] } else { &sides[..1] };
        match self.edging {
            Edging::Lines(count) => {
                for side in sides {
                    for i in 0..count {
                        let from = inset.max(gap) + i as f32 * (line + gap.min(12.0));
                        strip(*side, from, from + line, 0.0, 0);
                    }
                }
            }
            Edging::Band(colours) => {
                let each = band / colours as f32;
                for side in sides {
                    for i in 0..colours {
                        let from = inset + i as f32 * each;
                        strip(*side, from, from + each, 0.0, i % 2);
                    }
                }
            }
            Edging::Zone => {
                let across = if self.side < 2 { half[0] } else { half[1] };
                let to = 2.0 * across * self.share;
                strip(self.side, 0.0, to, 0.0, 0);
                if self.both {
                    strip(self.side, to + gap, to + gap + line, 0.0, 1);
                }
            }
            Edging::Header => {
                for side in sides {
                    strip(*side, inset, inset + band, inset.max(gap), 0);
                }
            }
            Edging::Hem => {
                strip(self.side, inset, inset + band, 0.0, 0);
                strip((self.side + 2) % 4, inset, inset + band, 0.0, 0);
            }
            Edging::Crossed => {
                for side in 0..4 {
                    strip(side, inset.max(gap), inset.max(gap) + line, 0.0, 0);
                }
            }
            Edging::Dashes => {
                let (across, along) = if self.side < 2 { (0, 1) } else { (1, 0) };
                let pitch = 6.0 * line + 2.0 * gap;
                let count = (2.0 * half[along] / pitch).clamp(1.0, 40.0) as usize;
                let way = if self.side.is_multiple_of(2) { -1.0 } else { 1.0 };
                for i in 0..count {
                    let (mut centre, mut size) = ([0.0; 2], [0.0; 2]);
                    centre[across] = (half[across] - inset.max(gap) - 0.5 * line) * way;
                    centre[along] = (i as f32 + 0.5 - 0.5 * count as f32) * pitch;
                    (size[across], size[along]) = (0.5 * line, 0.5 * (pitch - gap));
                    put(centre, size, self.art(0));
                }
            }
            Edging::Frame(count) => {
                for i in 0..count {
                    let at = inset.max(gap) + i as f32 * (line + gap.min(12.0));
                    put([0.0; 2], half.map(|h| h - at), Art::Outline(self.inks[0].what, line));
                }
            }
            Edging::Panel => {
                let margin = inset.max(gap);
                put([0.0; 2], half.map(|h| h - margin), self.art(0));
            }
        }
    }
}

/// Prints along the edges of some cartons, alike all around or otherwise on every face. `half_of` gives a face's half sizes.
pub fn edging(
    rng: &mut Rng,
    half: &Vector3<f64>,
    half_of: fn(usize, &Vector3<f64>) -> [f32; 2],
    stock: &Stock,
    decals: &mut Vec<Decal>,
) {
    if !rng.chance(0.5) {
        return;
    }
    let around = rng.chance(0.5);
    let count = 1 + usize::from(rng.chance(0.25));
    for _ in 0..count {
        let mut plate = Plate::new(rng, stock);
        for face in 0..5 {
            if !around {
                plate = Plate::new(rng, stock);
            }
            if around || rng.chance(0.75) {
                plate.print(face, half_of(face, half), decals);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stock::Split;

    #[test]
    fn print_stays_on_its_face_and_often_comes_near_its_edge() {
        let half = Vector3::new(250.0, 150.0, 60.0);
        let of = |face: usize, half: &Vector3<f64>| crate::world::face_half(half, face).map(|h| h as f32);
        let (mut near, mut boxes) = (0, 0);
        for split in [Split::Training, Split::HeldOut] {
            for seed in 0..300 {
                let mut decals = Vec::new();
                edging(&mut Rng::new(seed, 2), &half, of, &Stock::new(split), &mut decals);
                boxes += usize::from(!decals.is_empty());
                for d in &decals {
                    let room = of(d.face, &half);
                    for ((h, c), s) in room.iter().zip(d.centre).zip(d.half) {
                        assert!(s > 0.0 && c.abs() + s <= h + 1e-3, "{d:?}");
                    }
                    near += usize::from((0..2).any(|i| room[i] - d.centre[i].abs() - d.half[i] < 30.0));
                }
            }
        }
        assert!((250..350).contains(&boxes), "{boxes} of 600");
        assert!(near > 500, "{near}");
    }
}
