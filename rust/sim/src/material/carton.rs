//! Draws up the look of one carton: board, print, how it is closed, labels. Sizes in mm.

use super::edging::edging;
use super::ink::{code, word};
use super::kinds::{Base, CARTONS, INKS, LABELS, MARKS};
use super::{Art, Decal, Look, Pattern, Surface, closure, linear};
use crate::hazard::Hazard;
use crate::rng::Rng;
use crate::stock::{Kind, Stock};
use crate::vec3::V3;
use nalgebra::Vector3;
use std::collections::BTreeSet;

/// A look and the word for its base in the truth file.
#[derive(Clone, Debug)]
pub struct Carton {
    /// What it looks like.
    pub look: Look,
    /// A word of [`CARTONS`].
    pub base: &'static str,
    /// Hazards that were drawn.
    pub hazards: BTreeSet<Hazard>,
}

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
    drawn(rng, half, stock, true)
}

/// A carton without print along its edges.
pub fn plain_edged(rng: &mut Rng, half: &Vector3<f64>, stock: &Stock) -> Carton {
    drawn(rng, half, stock, false)
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

    /// A carton of it, bare; boxes of one delivery differ by a per cent.
    pub fn carton(&self, rng: &mut Rng) -> Carton {
        let surface = Surface {
            kind: self.kind,
            pattern: Pattern::Board { flute_mm: 0.0 },
            base: self.colour * rng.range_f32(0.99, 1.01),
            second: self.colour * 0.9,
            strength: rng.range_f32(0.3, 0.8),
            offset: [rng.range_f32(0.0, 500.0), rng.range_f32(0.0, 500.0)],
        };
        Carton { look: Look::bare(surface, self.gloss), base: self.kind, hazards: BTreeSet::new() }
    }
}

fn drawn(rng: &mut Rng, half: &Vector3<f64>, stock: &Stock, edged: bool) -> Carton {
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
    if edged {
        edging(rng, half, half_of, stock, &mut decals);
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
    closure::close(rng, half, main, stock, &mut decals);
    for face in 0..5 {
        labels(rng, face, half_of(face, half), stock, &mut decals);
    }
    if rng.chance(0.16) {
        closure::straps(rng, half, stock, &mut decals);
    }
    Carton { look: Look { decals, ..Look::bare(surface, gloss) }, base: kind.word, hazards: BTreeSet::new() }
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
        // A printed frame: the false edge that a detector must not take for the real one.
        let inset = rng.range_f32(0.03, 0.15) * a.min(b);
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
