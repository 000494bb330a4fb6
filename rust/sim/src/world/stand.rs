//! What boxes stand on: pallet, table, shelf, other boxes. Each builder returns bodies whose top is at a known height.

use super::{Body, Role};
use crate::material::carton::{Carton, carton};
use crate::material::kinds::WOODS;
use crate::material::{Appearance, Pattern, Surface, linear};
use crate::rng::Rng;
use crate::shape::Shape;
use crate::stock::{Kind, Stock};
use nalgebra::Vector3;

/// Bodies, the height of their top, and the word for the truth file.
pub struct Stand {
    /// Bodies below the target.
    pub bodies: Vec<Body>,
    /// Where the target's underside is, mm.
    pub top_mm: f64,
    /// floor, pallet, table, shelf or stack.
    pub word: &'static str,
}

/// Raw wood in one of several tones.
pub fn wood(rng: &mut Rng, stock: &Stock) -> Surface {
    let Kind { word, what: rgb, .. } = *stock.pick(rng, &WOODS);
    Surface {
        kind: word,
        pattern: Pattern::Wood,
        base: linear(rgb) * rng.range_f32(0.85, 1.15),
        second: linear(rgb) * rng.range_f32(0.45, 0.65),
        strength: rng.range_f32(0.6, 1.4),
        offset: [rng.range_f32(0.0, 900.0), rng.range_f32(0.0, 900.0)],
    }
}

/// Coat of paint in a colour (sRGB).
pub fn paint(rng: &mut Rng, rgb: [u8; 3]) -> Surface {
    Surface {
        kind: "paint",
        pattern: Pattern::Paint,
        base: linear(rgb) * rng.range_f32(0.8, 1.2),
        second: linear(rgb),
        strength: rng.range_f32(0.5, 1.5),
        offset: [rng.range_f32(0.0, 900.0), rng.range_f32(0.0, 900.0)],
    }
}

/// A stand for a target of this size, about x = y = 0. If `flush`, a box below may be as wide as the target.
pub fn stand(rng: &mut Rng, size: &Vector3<f64>, stock: &Stock, flush: bool) -> Stand {
    let longest = size.x.max(size.y);
    let choice = rng.unit();
    if longest < 450.0 {
        match choice {
            c if c < 0.5 => table(rng, size, stock),
            c if c < 0.65 => stack(rng, size, stock, flush),
            c if c < 0.8 => pallet(rng, size, stock),
            c if c < 0.9 => shelf(rng, size, stock),
            _ => floor(),
        }
    } else if size.z > 900.0 {
        if choice < 0.5 { floor() } else { pallet(rng, size, stock) }
    } else {
        match choice {
            c if c < 0.35 => floor(),
            c if c < 0.75 => pallet(rng, size, stock),
            _ => stack(rng, size, stock, flush),
        }
    }
}

const fn floor() -> Stand {
    Stand { bodies: Vec::new(), top_mm: 0.0, word: "floor" }
}

fn table(rng: &mut Rng, size: &Vector3<f64>, stock: &Stock) -> Stand {
    let top_mm = rng.range(650.0, 950.0);
    let wide = (size.x + rng.range(200.0, 1200.0)).max(800.0);
    let deep = (size.y + rng.range(100.0, 700.0)).max(500.0);
    let surface = match rng.below(4) {
        0 => paint(rng, [225, 225, 222]),
        1 => paint(rng, [120, 122, 124]),
        _ => wood(rng, stock),
    };
    let gloss = rng.range_f32(0.02, 0.25);
    // Near the table's front edge, or flush with it.
    let back =
        if rng.chance(0.3) { 0.5 * (deep - size.y) + rng.normal() * 3.0 } else { 0.4 * (deep - size.y) };
    let at = Vector3::new(rng.range(-0.3, 0.3) * (wide - size.x), back, 0.0);
    let plate = Vector3::new(wide, deep, 30.0);
    let look = Appearance::bare(surface, gloss);
    let mut bodies =
        vec![Body::upright(at + Vector3::z() * (top_mm - 30.0), plate, 0.0, look, Role::Stand).rounded(2.0)];
    let leg = Appearance::bare(paint(rng, [60, 62, 66]), 0.1);
    for (sx, sy) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let foot = at + Vector3::new(sx * (wide / 2.0 - 60.0), sy * (deep / 2.0 - 60.0), 0.0);
        let size = Vector3::new(45.0, 45.0, top_mm - 30.0);
        bodies.push(Body::upright(foot, size, 0.0, leg.clone(), Role::Stand));
    }
    Stand { bodies, top_mm, word: "table" }
}

fn pallet(rng: &mut Rng, size: &Vector3<f64>, stock: &Stock) -> Stand {
    let wide = 1200f64.max(size.x - rng.range(-150.0, 60.0));
    let deep = 800f64.max(size.y - rng.range(-150.0, 60.0));
    let slack = Vector3::new(0.5 * (wide - size.x).max(0.0), 0.5 * (deep - size.y).max(0.0), 0.0);
    // Often flush with the pallet's edge, within some mm: then the planks' edges are parallel to the face's and next to them.
    let mut place = |slack: f64| {
        if rng.chance(0.5) { rng.sign() * slack + rng.normal() * 3.0 } else { rng.range(-1.0, 1.0) * slack }
    };
    let at = Vector3::new(place(slack.x), place(slack.y), 0.0);
    let main = wood(rng, stock);
    let mut bodies = Vec::new();
    let mut plank = |rng: &mut Rng, foot: Vector3<f64>, size: Vector3<f64>, yaw: f64| {
        let mut surface = main;
        surface.offset = [rng.range_f32(0.0, 900.0), rng.range_f32(0.0, 900.0)];
        surface.base = surface.base * rng.range_f32(0.85, 1.12);
        let look = Appearance::bare(surface, 0.02);
        bodies.push(Body::upright(at + foot, size, yaw, look, Role::Stand).rounded(1.5));
    };
    let z = Vector3::z();
    let rows = [-1.0, 0.0, 1.0];
    for r in rows {
        let y = r * (deep / 2.0 - 50.0);
        plank(rng, Vector3::y() * y, Vector3::new(wide, 100.0, 22.0), 0.0);
        for c in rows {
            let foot = Vector3::new(c * (wide / 2.0 - 72.0), y, 22.0);
            plank(rng, foot, Vector3::new(145.0, 100.0, 78.0), 0.0);
        }
        let foot = Vector3::x() * (r * (wide / 2.0 - 72.0)) + z * 100.0;
        // Turned by a quarter, so that the grain runs along the plank.
        plank(rng, foot, Vector3::new(deep, 145.0, 22.0), std::f64::consts::FRAC_PI_2);
    }
    let count = 5 + 2 * rng.below(2);
    for i in 0..count {
        let y = (i as f64 / (count - 1) as f64 - 0.5) * (deep - 120.0);
        let size = Vector3::new(wide, rng.range(100.0, 120.0), 22.0);
        plank(rng, Vector3::y() * y + z * 122.0, size, 0.0);
    }
    Stand { bodies, top_mm: 144.0, word: "pallet" }
}

fn shelf(rng: &mut Rng, size: &Vector3<f64>, stock: &Stock) -> Stand {
    let top_mm = rng.range(400.0, 1200.0);
    let wide = rng.range(900.0, 1800.0).max(size.x + 100.0);
    let deep = size.y + rng.range(10.0, 150.0);
    // The box stands near the front edge, so that the head can see its faces.
    let at = Vector3::new(rng.range(-0.3, 0.3) * (wide - size.x), 0.5 * (deep - size.y) - 5.0, 0.0);
    let surface = if rng.chance(0.5) { wood(rng, stock) } else { paint(rng, [150, 155, 160]) };
    let mut bodies = vec![Body::upright(
        at + Vector3::z() * (top_mm - 20.0),
        Vector3::new(wide, deep, 20.0),
        0.0,
        Appearance::bare(surface, 0.04),
        Role::Stand,
    )];
    let rgb = rng.pick([[212, 105, 30], [40, 80, 150], [140, 140, 142]]);
    let bar = Appearance::bare(paint(rng, rgb), 0.15);
    let foot = at + Vector3::new(0.0, -deep / 2.0 - 20.0, top_mm - 95.0);
    bodies.push(Body::upright(foot, Vector3::new(wide, 40.0, 90.0), 0.0, bar, Role::Stand).rounded(2.0));
    Stand { bodies, top_mm, word: "shelf" }
}

fn stack(rng: &mut Rng, size: &Vector3<f64>, stock: &Stock, flush: bool) -> Stand {
    let mut bodies = Vec::new();
    let mut top_mm = 0.0;
    let levels = if size.z < 350.0 { 1 + rng.below(2) } else { 1 };
    for _ in 0..levels {
        // Either the same footprint (edges flush within 3 mm) or a wider box, by more than 4 mm on either side.
        let flush = rng.chance(0.5) && flush;
        let grow = |rng: &mut Rng| if flush { rng.range(-2.0, 2.0) } else { rng.range(12.0, 250.0) };
        let lower = Vector3::new(size.x + grow(rng), size.y + grow(rng), rng.range(200.0, 500.0));
        let Carton { look, shape, .. } = carton(rng, &(lower / 2.0), stock);
        let shape = Shape { radius_mm: shape.radius_mm + 1.5, ..shape };
        let foot = Vector3::new(rng.range(-1.5, 1.5), rng.range(-1.5, 1.5), top_mm);
        let yaw = if flush { 0.5 / lower.x.max(lower.y) } else { 0.01 } * rng.range(-1.0, 1.0);
        bodies.push(Body::upright(foot, lower, yaw, look, Role::Carton).shaped(shape));
        top_mm += lower.z;
    }
    Stand { bodies, top_mm, word: "stack" }
}
