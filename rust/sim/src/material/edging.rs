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
    /// A picture, or an area in one ink, that ends beside three or all four edges.
    Poster,
    /// An area in one ink that ends beside two edges that meet.
    Field,
}

/// From an edge to print along it, mm: so close that it may be taken for the edge.
pub const CLOSE_MM: [f64; 2] = [3.0, 25.0];
/// The same for print that keeps away from edges.
pub const APART_MM: [f64; 2] = [25.0, 120.0];

/// A face's sides: left, right, upper, lower.
type Side = usize;

/// One printing plate: the same numbers for every face that gets it.
struct Plate {
    edging: Edging,
    kind: &'static str,
    side: Side,
    /// Both this side and the opposite one.
    both: bool,
    /// From the face's edge to the print, mm.
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
    /// What a poster shows, if not an ink.
    photo: Option<usize>,
}

impl Plate {
    fn new(rng: &mut Rng, inset_mm: [f64; 2], stock: &Stock) -> Self {
        let kind = stock.pick(rng, &EDGINGS);
        let photos = stock.photos.all.len();
        Self {
            edging: kind.what,
            kind: kind.word,
            side: rng.below(4),
            both: rng.chance(0.35),
            inset: rng.log_range(inset_mm[0], inset_mm[1]) as f32,
            line: rng.log_range(0.8, 8.0) as f32,
            band: rng.log_range(8.0, 90.0) as f32,
            share: rng.range_f32(0.2, 0.55),
            gap: rng.log_range(3.0, 40.0) as f32,
            inks: [*stock.pick(rng, &PRINTS), *stock.pick(rng, &PRINTS)],
            cover: rng.range_f32(0.8, 1.0),
            photo: (rng.chance(0.7) && photos > 0).then(|| rng.below(photos)),
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
                        let from = inset + i as f32 * (line + gap.min(12.0));
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
                    strip(side, inset, inset + line, 0.0, 0);
                }
            }
            Edging::Dashes => {
                let (across, along) = if self.side < 2 { (0, 1) } else { (1, 0) };
                let pitch = 6.0 * line + 2.0 * gap;
                let count = (2.0 * half[along] / pitch).clamp(1.0, 40.0) as usize;
                let way = if self.side.is_multiple_of(2) { -1.0 } else { 1.0 };
                for i in 0..count {
                    let (mut centre, mut size) = ([0.0; 2], [0.0; 2]);
                    centre[across] = (half[across] - inset - 0.5 * line) * way;
                    centre[along] = (i as f32 + 0.5 - 0.5 * count as f32) * pitch;
                    (size[across], size[along]) = (0.5 * line, 0.5 * (pitch - gap));
                    put(centre, size, self.art(0));
                }
            }
            Edging::Frame(count) => {
                for i in 0..count {
                    let at = inset + i as f32 * (line + gap.min(12.0));
                    put([0.0; 2], half.map(|h| h - at), Art::Outline(self.inks[0].what, line));
                }
            }
            Edging::Panel => {
                put([0.0; 2], half.map(|h| h - inset), self.art(0));
            }
            Edging::Poster | Edging::Field => {
                // A poster ends early on one side or none, a field on the two that meet opposite its corner.
                let early = match self.edging {
                    Edging::Field => vec![self.side ^ 1, ((self.side + 2) % 4) ^ 1],
                    _ if self.both => Vec::new(),
                    _ => vec![self.side ^ 1],
                };
                let mut margins = [inset; 4];
                for side in early {
                    margins[side] = 2.0 * half[side / 2] * self.share;
                }
                let along = |axis: usize| {
                    let (low, high) = (margins[2 * axis], margins[2 * axis + 1]);
                    (0.5 * (low - high), half[axis] - 0.5 * (low + high))
                };
                let ((u, a), (v, b)) = (along(0), along(1));
                let photo = self.photo.filter(|_| self.edging == Edging::Poster).map(Art::Photo);
                put([u, v], [a, b], photo.unwrap_or_else(|| self.art(0)));
            }
        }
    }
}

/// Prints along the edges of a carton, this far inside them, alike all around or otherwise on every face. `half_of` gives a
/// face's half sizes.
pub fn edging(
    rng: &mut Rng,
    half: &Vector3<f64>,
    half_of: fn(usize, &Vector3<f64>) -> [f32; 2],
    inset_mm: [f64; 2],
    stock: &Stock,
    decals: &mut Vec<Decal>,
) {
    let around = rng.chance(0.5);
    let count = 1 + usize::from(rng.chance(0.25));
    for _ in 0..count {
        let mut plate = Plate::new(rng, inset_mm, stock);
        for face in 0..5 {
            if !around {
                plate = Plate::new(rng, inset_mm, stock);
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
    fn print_stays_on_its_face_and_ends_where_it_is_told_to() {
        let half = Vector3::new(250.0, 150.0, 60.0);
        let of = |face: usize, half: &Vector3<f64>| crate::world::face_half(half, face).map(|h| h as f32);
        for split in [Split::Training, Split::HeldOut] {
            for seed in 0..300 {
                let mut decals = Vec::new();
                edging(&mut Rng::new(seed, 2), &half, of, CLOSE_MM, &Stock::new(split), &mut decals);
                let mut close = false;
                for d in &decals {
                    let room = of(d.face, &half);
                    for ((h, c), s) in room.iter().zip(d.centre).zip(d.half) {
                        assert!(s > 0.0 && c.abs() + s <= h + 1e-3, "{d:?}");
                        close |= (2.99..25.01).contains(&(h - c.abs() - s));
                    }
                }
                // A zone goes up to the edge and ends far inside.
                close |= decals.iter().any(|d| d.kind.ends_with("zone"));
                assert!(decals.is_empty() || close, "{decals:?}");
            }
        }
    }

    #[test]
    fn a_field_keeps_to_a_corner_and_a_poster_to_three_edges() {
        let print = |edging: Edging| {
            let mut plate = Plate::new(&mut Rng::new(4, 4), CLOSE_MM, &Stock::default());
            (plate.edging, plate.side, plate.both, plate.inset, plate.share) = (edging, 0, false, 10.0, 0.4);
            let mut decals = Vec::new();
            plate.print(3, [200.0, 100.0], &mut decals);
            let Decal { centre: [u, v], half: [a, b], .. } = decals[0];
            [200.0 + u - a, 200.0 - u - a, 100.0 + v - b, 100.0 - v - b]
        };
        let near = |found: [f32; 4], margins: [f32; 4]| {
            found.iter().zip(margins).for_each(|(a, b)| assert!((a - b).abs() < 1e-3, "{found:?}"));
        };
        near(print(Edging::Poster), [10.0, 160.0, 10.0, 10.0]);
        near(print(Edging::Field), [10.0, 160.0, 10.0, 80.0]);
    }
}
