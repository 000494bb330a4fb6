//! Draws up the look of one carton: board, print, how it is closed, labels. Sizes in mm.

use super::closure::{self, Frame};
use super::edging::{APART_MM, CLOSE_MM, edging};
use super::ink::{code, word};
use super::kinds::{Base, CARTONS, INKS, LABELS, MARKS};
use super::lines::false_lines;
use super::{Appearance, Art, Decal, Pattern, Surface, Wrap, linear};
use crate::hazard::{Hazard, Hazards};
use crate::rng::Rng;
use crate::shape::{self, Shape};
use crate::stock::{Kind, Stock};
use crate::vec3::V3;
use nalgebra::Vector3;
use std::collections::BTreeSet;

/// A look and the word for its base in the truth file.
#[derive(Clone, Debug)]
pub struct Carton {
    /// What it looks like.
    pub look: Appearance,
    /// A word of [`CARTONS`].
    pub base: &'static str,
    /// Waves, crushed corners, and by how much film rounds the edges; bulges are not drawn here.
    pub shape: Shape,
    /// The axis that its flaps close.
    pub flap_axis: usize,
    /// Hazards that were drawn. An open flap has still to find its place: [`crate::world::flap`].
    pub hazards: BTreeSet<Hazard>,
}

/// Those that a carton draws.
const HAZARDS: [Hazard; 11] = [
    Hazard::EdgeTape,
    Hazard::HTape,
    Hazard::Strap,
    Hazard::BentLabel,
    Hazard::Film,
    Hazard::FlapSeam,
    Hazard::OpenFlap,
    Hazard::CrushedCorner,
    Hazard::HandHole,
    Hazard::WavyEdge,
    Hazard::EdgePrint,
];

/// Half sizes of a face along its picture axes, mm.
fn half_of(face: usize, half: &Vector3<f64>) -> [f32; 2] {
    let [x, y, z] = [half.x as f32, half.y as f32, half.z as f32];
    match face {
        0 | 1 => [y, z],
        2 | 3 => [x, z],
        _ => [x, y],
    }
}

/// A carton of these half sizes; everything is drawn from `rng`.
pub fn carton(rng: &mut Rng, half: &Vector3<f64>, stock: &Stock) -> Carton {
    drawn(rng, half, stock, &stock.hazards, 0.25)
}

/// A carton without hazards and without print along its edges.
pub fn plain_edged(rng: &mut Rng, half: &Vector3<f64>, stock: &Stock) -> Carton {
    drawn(rng, half, stock, &Hazards::none(), 0.0)
}

/// Board of one colour, as several boxes of one delivery have it: red, black, white or brown, never printed.
#[derive(Clone, Copy, Debug)]
pub struct Plain {
    kind: &'static str,
    colour: V3,
    gloss: f32,
}

/// The boards of [`CARTONS`] that are red, black, white or brown, or nearly so.
const PLAIN: [&str; 8] = ["brown", "testliner", "white", "cream", "black", "charcoal", "red", "orange"];

impl Plain {
    /// One of the stock's, each colour as often.
    pub fn pick(rng: &mut Rng, stock: &Stock) -> Self {
        let own: Vec<_> =
            CARTONS.iter().filter(|k| k.split == stock.split && PLAIN.contains(&k.word)).collect();
        let kind = own[rng.below(own.len())];
        let colour = linear(kind.what.rgb) * rng.range_f32(0.85, 1.15);
        let gloss = if kind.what.plain { rng.range_f32(0.01, 0.05) } else { rng.pick([0.03, 0.06, 0.2]) };
        Self { kind: kind.word, colour, gloss }
    }

    /// Its look, bare; boxes of one delivery differ by a per cent.
    pub fn look(&self, rng: &mut Rng) -> Appearance {
        let surface = Surface {
            kind: self.kind,
            pattern: Pattern::Board { flute_mm: 0.0 },
            base: self.colour * rng.range_f32(0.99, 1.01),
            second: self.colour * 0.9,
            strength: rng.range_f32(0.3, 0.8),
            offset: [rng.range_f32(0.0, 500.0), rng.range_f32(0.0, 500.0)],
        };
        Appearance::bare(surface, self.gloss)
    }

    /// A carton made of it: nothing is printed, glued or wrapped on, its shape stays.
    pub fn dress(&self, rng: &mut Rng, carton: Carton) -> Carton {
        let mut hazards = carton.hazards;
        hazards.retain(|h| matches!(h, Hazard::OpenFlap | Hazard::CrushedCorner | Hazard::WavyEdge));
        let shape = Shape { radius_mm: 0.0, ..carton.shape };
        Carton { look: self.look(rng), base: self.kind, shape, hazards, ..carton }
    }
}

/// Each hazard is drawn, and draws, from a generator of its own, so that switching it off leaves all else as it was. `printed`
/// is the share of cartons with print along their edges, well inside them.
fn drawn(rng: &mut Rng, half: &Vector3<f64>, stock: &Stock, hazards: &Hazards, printed: f64) -> Carton {
    let mut own = rng.child();
    let mut found: BTreeSet<Hazard> = HAZARDS.into_iter().filter(|h| hazards.draw(&mut own, *h)).collect();
    let frame = Frame::new(&mut rng.child(), half);
    let kind = stock.pick(rng, &CARTONS);
    let Base { rgb, plain } = kind.what;
    let tint = [0; 3].map(|_| rng.normal() as f32 * 0.03);
    let tone = rng.range_f32(0.85, 1.18);
    let mut main = linear(rgb) * tone;
    main.x *= 1.0 + tint[0];
    main.y *= 1.0 + tint[1];
    main.z *= 1.0 + tint[2];
    let flute_mm = if rng.chance(0.6) { rng.range_f32(4.0, 8.5) } else { 0.0 };
    let surface = Surface {
        kind: kind.word,
        pattern: if plain || rng.chance(0.8) { Pattern::Board { flute_mm } } else { Pattern::Paint },
        base: main,
        second: if plain { linear([205, 172, 125]) } else { main * 0.8 },
        strength: if plain { rng.range_f32(0.7, 1.6) } else { rng.range_f32(0.3, 0.9) },
        offset: [rng.range_f32(0.0, 500.0), rng.range_f32(0.0, 500.0)],
    };
    let gloss = if plain { rng.range_f32(0.01, 0.05) } else { rng.pick([0.03, 0.06, 0.2, 0.35]) };
    let mut decals = Vec::new();
    let mut own = rng.child();
    if own.chance(printed) {
        edging(&mut own, half, half_of, APART_MM, stock, &mut decals);
    }
    let mut own = rng.child();
    if found.contains(&Hazard::EdgePrint) {
        edging(&mut own, half, half_of, CLOSE_MM, stock, &mut decals);
    }
    let mut ink = *stock.pick(rng, &INKS);
    // Ink that would not show on its board is printed in white.
    let apart: i32 = rgb.iter().zip(ink.what).map(|(b, i)| (i32::from(*b) - i32::from(i)).abs()).sum();
    if apart < 110 {
        ink.what = [225, 222, 214];
    }
    let brand = word(rng);
    for face in 0..5 {
        print(rng, face, half_of(face, half), &ink, &brand, stock, &mut decals);
    }
    let mut own = rng.child();
    if found.contains(&Hazard::HandHole) && !closure::hand_holes(&mut own, &frame, &mut decals) {
        found.remove(&Hazard::HandHole);
    }
    closure::close(&mut rng.child(), &frame, main, stock, &found, &mut decals);
    let mut own = rng.child();
    if found.contains(&Hazard::EdgeTape) {
        closure::edge_tape(&mut own, &frame, stock, &mut decals);
    }
    for face in 0..5 {
        labels(rng, face, half_of(face, half), stock, &mut decals);
    }
    let mut own = rng.child();
    if found.contains(&Hazard::BentLabel) {
        closure::bent_label(&mut own, &frame, stock, &mut decals);
    }
    let mut own = rng.child();
    if found.contains(&Hazard::Strap) {
        closure::straps(&mut own, &frame, stock, &mut decals);
    }
    let mut shape = Shape::default();
    let mut own = rng.child();
    let wrap = found.contains(&Hazard::Film).then(|| Wrap::new(&mut own, half));
    // Film that is pulled tight takes the edges with it.
    shape.radius_mm = wrap.map_or(0.0, |w| f64::from(w.soft_mm).min(0.02 * half.min()));
    let mut own = rng.child();
    if found.contains(&Hazard::WavyEdge) {
        shape.waves = Some(shape::waves(&mut own, half));
    }
    let mut own = rng.child();
    if found.contains(&Hazard::CrushedCorner) {
        shape.crushed = shape::crushed(&mut own, half);
    }
    let lines = false_lines(&decals, |face| half_of(face, half));
    Carton {
        look: Appearance { decals, lines, wrap, ..Appearance::bare(surface, gloss) },
        base: kind.word,
        shape,
        flap_axis: frame.flap,
        hazards: found,
    }
}

fn print(
    rng: &mut Rng,
    face: usize,
    half: [f32; 2],
    ink: &Kind<[u8; 3]>,
    brand: &str,
    stock: &Stock,
    decals: &mut Vec<Decal>,
) {
    let [a, b] = half;
    let Kind { word: inked, what: ink, .. } = *ink;
    let mut put = |kind: &'static str, centre: [f32; 2], half: [f32; 2], turn_rad: f32, art: Art| {
        decals.push(Decal { kind, face, centre, turn_rad, half, art, gloss: None });
    };
    if !stock.photos.all.is_empty() && rng.chance(0.2) {
        let w = a * rng.range_f32(0.25, 1.0);
        let h = b * rng.range_f32(0.25, 1.0);
        let centre = [rng.range_f32(-1.0, 1.0) * (a - w), rng.range_f32(-1.0, 1.0) * (b - h)];
        put("photograph", centre, [w, h], 0.0, Art::Photo(rng.below(stock.photos.all.len())));
    }
    if rng.chance(0.07) {
        // A printed frame, well inside the edges.
        let inset = (rng.range_f32(0.1, 0.3) * a.min(b)).max(CLOSE_MM[1] as f32).min(0.6 * a.min(b));
        let line = rng.range_f32(1.5, 8.0).min(0.05 * a.min(b));
        put(inked, [0.0, 0.0], [a - inset, b - inset], 0.0, Art::Outline(ink, line));
    }
    if rng.chance(0.08) {
        let red = [178, 30, 34];
        for _ in 0..1 + rng.below(3) {
            let line = rng.range_f32(0.6, 5.0).min(0.04 * a.min(b));
            if rng.chance(0.5) {
                put("red line", [rng.range_f32(-0.9, 0.9) * a, 0.0], [line, b], 0.0, Art::Fill(red));
            } else {
                put("red line", [0.0, rng.range_f32(-0.9, 0.9) * b], [a, line], 0.0, Art::Fill(red));
            }
        }
    }
    if rng.chance(if face == 4 { 0.25 } else { 0.6 }) {
        let bold = rng.range_f32(0.45, 0.85);
        let aspect = Decal::text_aspect(brand, bold) * rng.range_f32(0.8, 1.3);
        let mut w = a * rng.range_f32(0.35, 0.8);
        let h = (w * aspect).min(b * 0.6);
        w = w.min(h / aspect);
        let centre = [rng.range_f32(-0.8, 0.8) * (a - w), rng.range_f32(-0.8, 0.6) * (b - h)];
        put(inked, centre, [w, h], rng.range_f32(-0.008, 0.008), Art::Text(brand.to_owned(), ink, bold));
    }
    if rng.chance(0.4) {
        for row in 0..1 + rng.below(3) {
            let text = format!("{} {}", word(rng), code(rng, 5));
            let aspect = Decal::text_aspect(&text, 0.4);
            let w = (0.3 * a).min(110.0);
            let at = [-0.9 * a + w, 0.9 * b - (row as f32 * 2.0 + 1.0) * w * aspect * 1.5];
            put(inked, at, [w, w * aspect], 0.0, Art::Text(text, ink, 0.4));
        }
    }
    if face != 4 && rng.chance(0.5) {
        let h = (0.22 * b).min(55.0);
        let mark = stock.pick(rng, &MARKS);
        let art = (mark.what)(ink);
        put(mark.word, [rng.range_f32(0.5, 0.85) * (a - h), 0.8 * (b - h)], [h * 0.85, h], 0.0, art);
    }
}

fn labels(rng: &mut Rng, face: usize, half: [f32; 2], stock: &Stock, decals: &mut Vec<Decal>) {
    let [a, b] = half;
    let count = if rng.chance(0.45) { 1 + usize::from(rng.chance(0.25)) } else { 0 };
    for _ in 0..count {
        let w = rng.range_f32(35.0, 80.0).min(0.42 * a);
        let h = (w * rng.range_f32(0.6, 1.4)).min(0.42 * b);
        let centre = [rng.range_f32(-0.9, 0.9) * (a - w), rng.range_f32(-0.9, 0.9) * (b - h)];
        let quarter = if rng.chance(0.12) { std::f32::consts::FRAC_PI_2 } else { 0.0 };
        let half = if quarter > 0.0 { [w.min(h), w.min(h)] } else { [w, h] };
        let seed = (u64::from(rng.bits()) << 32) | u64::from(rng.bits());
        let kind = stock.pick(rng, &LABELS);
        let (layout, paper) = kind.what;
        decals.push(Decal {
            kind: kind.word,
            face,
            centre,
            turn_rad: quarter + rng.normal() as f32 * 0.02,
            half,
            art: Art::Label(seed, layout, paper),
            gloss: Some(rng.range_f32(0.05, 0.3)),
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stock::Split;

    fn half() -> Vector3<f64> {
        Vector3::new(250.0, 180.0, 140.0)
    }

    fn drawn_with(seed: u64, hazards: Hazards) -> Carton {
        carton(&mut Rng::new(seed, 1), &half(), &Stock { hazards, ..Stock::new(Split::HeldOut) })
    }

    #[test]
    fn each_hazard_is_drawn_in_its_share_and_not_when_it_is_off() {
        let count = 400;
        let mut seen = [0; HAZARDS.len()];
        for seed in 0..count {
            for (n, hazard) in seen.iter_mut().zip(HAZARDS) {
                *n += usize::from(drawn_with(seed, Hazards::only(&[hazard])).hazards.contains(&hazard));
            }
            assert!(drawn_with(seed, Hazards::none()).hazards.is_empty());
        }
        for (n, hazard) in seen.into_iter().zip(HAZARDS) {
            let share = n as f64 / count as f64;
            assert!((share - hazard.share()).abs() < 0.1, "{hazard}: {share}");
        }
    }

    #[test]
    fn switching_one_off_takes_its_own_and_leaves_the_rest() {
        let places =
            |c: &Carton| c.look.decals.iter().map(|d| (d.kind, d.face, d.centre, d.half)).collect::<Vec<_>>();
        let mut fewer = 0;
        for seed in 0..60 {
            let all = drawn_with(seed, Hazards::default());
            let less = drawn_with(seed, Hazards::default().without(Hazard::Strap));
            let (all_places, less_places) = (places(&all), places(&less));
            assert!(less_places.iter().all(|p| all_places.contains(p)));
            assert_eq!(all.shape, less.shape);
            assert!(all_places.iter().all(|p| p.0.ends_with("strap") || less_places.contains(p)));
            fewer += usize::from(less_places.len() < all_places.len());
            let plain = drawn_with(seed, Hazards::none());
            assert!(plain.look.wrap.is_none() && plain.shape == Shape::default());
        }
        assert!(fewer > 2, "{fewer}");
    }
}
