//! Around the stand: floor, walls, racks, clutter.

use super::stand::{paint, wood};
use super::{Body, Role};
use crate::material::carton::{Carton, carton};
use crate::material::kinds::{FLOORS, Ground, WALLS, Wall, YARDS};
use crate::material::{Appearance, Pattern, Surface, linear};
use crate::rng::Rng;
use crate::shape::Shape;
use crate::stock::{Kind, Stock};
use nalgebra::Vector3;

/// Half the extent of floor and far walls, mm.
const FAR_MM: f64 = 11_000.0;

fn floor_surface(rng: &mut Rng, outdoors: bool, stock: &Stock) -> (Surface, f32) {
    let Kind { word, what: ground, .. } =
        *if outdoors { stock.pick(rng, &YARDS) } else { stock.pick(rng, &FLOORS) };
    let stone = |rng: &mut Rng, rgb: [u8; 3]| Surface {
        kind: word,
        pattern: Pattern::Stone,
        base: linear(rgb) * rng.range_f32(0.7, 1.2),
        second: linear(rgb) * rng.range_f32(0.4, 0.8),
        strength: rng.range_f32(0.6, 1.6),
        offset: [rng.range_f32(0.0, 4000.0), rng.range_f32(0.0, 4000.0)],
    };
    let (surface, gloss) = match ground {
        Ground::Stone(colours) => {
            let rgb = rng.pick(colours);
            (stone(rng, rgb), rng.range_f32(0.01, 0.12))
        }
        Ground::Planks => {
            let pattern = Pattern::Planks { width_mm: rng.range_f32(90.0, 200.0) };
            (Surface { kind: word, pattern, ..wood(rng, stock) }, rng.range_f32(0.03, 0.2))
        }
        Ground::Tiles => {
            let side_mm = rng.pick([200.0, 300.0, 450.0, 600.0]);
            let rgb = rng.pick([[190, 186, 176], [130, 128, 126], [90, 84, 80], [170, 130, 110]]);
            (Surface { pattern: Pattern::Tiles { side_mm }, ..stone(rng, rgb) }, rng.range_f32(0.05, 0.3))
        }
        Ground::Bricks(colours) => {
            let rgb = rng.pick(colours);
            (Surface { pattern: Pattern::Brick, ..stone(rng, rgb) }, 0.02)
        }
        Ground::Coat => {
            let rgb = rng.pick([[70, 84, 100], [110, 112, 110], [60, 90, 75]]);
            (Surface { kind: word, ..paint(rng, rgb) }, rng.range_f32(0.05, 0.25))
        }
    };
    // Ground under the sky is never polished.
    (surface, if outdoors { 0.01 } else { gloss })
}

fn wall_surface(rng: &mut Rng, stock: &Stock) -> Surface {
    let offset = [rng.range_f32(0.0, 4000.0), rng.range_f32(0.0, 4000.0)];
    let flat = |kind, pattern, rgb: [u8; 3]| Surface {
        kind,
        pattern,
        base: linear(rgb),
        second: linear(rgb),
        strength: 1.0,
        offset,
    };
    if !stock.photos.all.is_empty() && rng.chance(0.25) {
        let index = rng.below(stock.photos.all.len());
        let pattern = Pattern::Photo { index, width_mm: rng.range_f32(800.0, 3500.0) };
        return flat("photograph", pattern, [128; 3]);
    }
    let Kind { word, what: wall, .. } = *stock.pick(rng, &WALLS);
    match wall {
        Wall::Brick => {
            let rgb = rng.pick([[140, 72, 54], [120, 62, 50], [170, 150, 125], [85, 60, 55]]);
            let second = linear([150, 146, 138]) * rng.range_f32(0.5, 1.0);
            Surface { second, ..flat(word, Pattern::Brick, rgb) }
        }
        Wall::Sheet => {
            let rgb = rng.pick([[150, 160, 168], [120, 130, 130], [190, 192, 190]]);
            flat(word, Pattern::Sheet { pitch_mm: rng.range_f32(70.0, 220.0) }, rgb)
        }
        Wall::Cladding => {
            let pattern = Pattern::Planks { width_mm: rng.range_f32(90.0, 160.0) };
            Surface { kind: word, pattern, ..wood(rng, stock) }
        }
        Wall::Plaster => {
            let rgb = rng.pick([[196, 192, 182], [165, 160, 150]]);
            Surface { second: linear(rgb) * 0.7, strength: 0.7, ..flat(word, Pattern::Stone, rgb) }
        }
        Wall::Paint => {
            let rgb = rng.pick([[222, 220, 212], [200, 206, 208], [226, 214, 188], [150, 160, 150]]);
            Surface { kind: word, offset, ..paint(rng, rgb) }
        }
    }
}

/// Floor, walls and ceiling; outdoors one wall at most. `faces` are those that will be looked at.
pub fn shell(rng: &mut Rng, outdoors: bool, faces: &[usize], reach: f64, stock: &Stock) -> Vec<Body> {
    let (surface, gloss) = floor_surface(rng, outdoors, stock);
    let wide = 2.0 * FAR_MM;
    let mut bodies = vec![Body::upright(
        Vector3::new(0.0, 0.0, -100.0),
        Vector3::new(wide * 2.0, wide * 2.0, 100.0),
        rng.range(-0.6, 0.6),
        Appearance::bare(surface, gloss),
        Role::Room,
    )];
    let mut wall = |rng: &mut Rng, at: Vector3<f64>, size: Vector3<f64>| {
        let look = Appearance::bare(wall_surface(rng, stock), rng.range_f32(0.01, 0.06));
        bodies.push(Body::upright(at, size, rng.normal() * 0.03, look, Role::Room));
    };
    let height = rng.range(3500.0, 7000.0);
    // A near wall behind the box, or beside it where no face is looked at.
    if rng.chance(0.6) {
        let y = reach + rng.log_range(30.0, 3000.0);
        wall(rng, Vector3::new(0.0, y + 100.0, 0.0), Vector3::new(wide, 200.0, height));
    }
    for (face, side) in [(0, 1.0), (1, -1.0)] {
        if !faces.contains(&face) && rng.chance(0.2) {
            let x = side * (reach + rng.log_range(200.0, 3000.0) + 100.0);
            wall(rng, Vector3::new(x, 0.0, 0.0), Vector3::new(200.0, wide, height));
        }
    }
    if !outdoors {
        for (x, y) in [(0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0)] {
            let far = FAR_MM * rng.range(0.5, 1.0);
            let size =
                if x == 0.0 { Vector3::new(wide, 200.0, height) } else { Vector3::new(200.0, wide, height) };
            wall(rng, Vector3::new(x * far, y * far, 0.0), size);
        }
        // Lamps may hang above it in the model: bodies of this size cast no shadows.
        let rgb = rng.pick([[205, 206, 202], [150, 152, 152], [92, 94, 98]]);
        let look = Appearance::bare(paint(rng, rgb), 0.02);
        let foot = Vector3::new(0.0, 0.0, height);
        bodies.push(Body::upright(foot, Vector3::new(wide, wide, 100.0), 0.0, look, Role::Room));
    }
    bodies
}

/// A carton of a size at a foot point.
fn box_at(rng: &mut Rng, foot: Vector3<f64>, size: Vector3<f64>, yaw: f64, stock: &Stock) -> Body {
    let Carton { look, shape, .. } = carton(rng, &(size / 2.0), stock);
    let shape = Shape { radius_mm: shape.radius_mm + rng.range(0.5, 3.0), ..shape };
    Body::upright(foot, size, yaw, look, Role::Carton).shaped(shape)
}

/// Loose boxes on the floor, and a rack with boxes behind.
pub fn clutter(rng: &mut Rng, reach: f64, outdoors: bool, stock: &Stock) -> Vec<Body> {
    let mut bodies = Vec::new();
    for _ in 0..rng.below(7) {
        let angle = rng.range(0.0, std::f64::consts::TAU);
        let far = reach + rng.range(150.0, 2600.0);
        let size = Vector3::new(
            rng.log_range(150.0, 800.0),
            rng.log_range(150.0, 700.0),
            rng.log_range(120.0, 600.0),
        );
        let foot = Vector3::new(angle.cos() * far, angle.sin() * far, 0.0);
        let yaw = rng.range(-0.8, 0.8);
        bodies.push(box_at(rng, foot, size, yaw, stock));
        if rng.chance(0.4) {
            let upper = size * rng.range(0.5, 0.95);
            let foot = foot + Vector3::z() * size.z;
            let turned = yaw + rng.normal() * 0.1;
            bodies.push(box_at(rng, foot, upper, turned, stock));
        }
    }
    if !outdoors && rng.chance(0.55) {
        rack(rng, reach, stock, &mut bodies);
    }
    bodies
}

/// A pallet rack: uprights, beams, boxes on them.
fn rack(rng: &mut Rng, reach: f64, stock: &Stock, bodies: &mut Vec<Body>) {
    let upright_rgb = rng.pick([[38, 78, 150], [60, 62, 66], [150, 152, 154]]);
    let upright = Appearance::bare(paint(rng, upright_rgb), 0.1);
    let beam_rgb = rng.pick([[214, 104, 28], [220, 170, 40], [190, 60, 40]]);
    let beam = Appearance::bare(paint(rng, beam_rgb), 0.15);
    let y = reach + rng.range(250.0, 2200.0);
    let x0 = rng.range(-3200.0, -1200.0);
    let bay = rng.range(1500.0, 2700.0);
    for i in 0..3 {
        for back in [0.0, 900.0] {
            let foot = Vector3::new(x0 + f64::from(i) * bay, y + back, 0.0);
            bodies.push(Body::upright(
                foot,
                Vector3::new(90.0, 70.0, 3600.0),
                0.0,
                upright.clone(),
                Role::Room,
            ));
        }
    }
    for level in [rng.range(250.0, 600.0), rng.range(1300.0, 1700.0)] {
        for i in 0..2 {
            let foot = Vector3::new(x0 + (f64::from(i) + 0.5) * bay, y, level);
            let size = Vector3::new(bay - 90.0, 50.0, 120.0);
            bodies.push(Body::upright(foot, size, 0.0, beam.clone(), Role::Room).rounded(2.0));
            let mut x = -bay / 2.0 + 120.0;
            while x < bay / 2.0 - 500.0 {
                let size =
                    Vector3::new(rng.range(250.0, 600.0), rng.range(300.0, 600.0), rng.range(200.0, 600.0));
                if rng.chance(0.6) {
                    let foot = foot + Vector3::new(x + size.x / 2.0, 400.0, 120.0);
                    let yaw = rng.normal() * 0.05;
                    bodies.push(box_at(rng, foot, size, yaw, stock));
                }
                x += size.x + rng.range(20.0, 250.0);
            }
        }
    }
}
