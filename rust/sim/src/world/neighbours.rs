//! Boxes against the target, on sides that are not looked at: flush with each face that is looked at and that they border, or
//! stepped. Where one is flush, its face goes on in the target's plane, and only a seam tells where the target ends.

use super::stand::paint;
use super::{Body, Role};
use crate::hazard::Hazard;
use crate::material::Appearance;
use crate::rng::Rng;
use crate::shape::Shape;
use nalgebra::Vector3;

/// A box against the target.
pub(super) struct Neighbour {
    pub body: Body,
    /// Where it stands, as the truth file says it.
    pub word: &'static str,
    /// [`Hazard::FlushNeighbour`] or [`Hazard::SteppedNeighbour`].
    pub hazard: Hazard,
}

/// What the target leaves to its neighbours.
pub(super) struct Target<'a> {
    pub size: Vector3<f64>,
    /// Height of its underside, mm.
    pub base_mm: f64,
    /// The faces that are looked at.
    pub faces: &'a [usize],
}

/// Where a neighbour may stand, by the target's face that it touches.
const SIDES: [(usize, &str); 5] = [(0, "right"), (1, "left"), (2, "behind"), (3, "in_front"), (4, "on_top")];

/// Flush: within this of the target's plane, mm. What a turn of the box adds is left for it.
const FLUSH_MM: f64 = 2.5;
/// Largest shift of a box's ends by its turn, mm.
const TURN_MM: f64 = 0.5;
const STEP_MM: (f64, f64) = (4.5, 59.5);
/// Besides the first, each further side has another neighbour of the kind with this probability.
const MORE: f64 = 0.25;

/// Draws neighbours: at least one flush, at least one stepped, as far as they are wanted and one `fits`.
pub(super) fn neighbours(
    rng: &mut Rng,
    target: &Target<'_>,
    wanted: &[Hazard],
    fits: impl Fn(&Body) -> bool,
    mut dress: impl FnMut(&mut Rng, &Vector3<f64>) -> (Appearance, Shape),
) -> Vec<Neighbour> {
    let borders = |side: usize| target.faces.iter().any(|f| f / 2 != side / 2);
    let mut free: Vec<_> =
        SIDES.into_iter().filter(|(s, _)| !target.faces.contains(s) && borders(*s)).collect();
    for i in (1..free.len()).rev() {
        free.swap(i, rng.below(i + 1));
    }
    let mut found: Vec<Neighbour> = Vec::new();
    for &hazard in wanted {
        let mut count = 0;
        free.retain(|&(side, word)| {
            if count > 0 && !rng.chance(MORE) {
                return true;
            }
            let clear = |b: &Body| fits(b) && found.iter().all(|n| n.body.apart_mm(b) > -1.0);
            let Some(mut body) = (0..6).map(|_| place(rng, target, side, hazard)).find(clear) else {
                return true;
            };
            count += 1;
            let (look, shape) = dress(rng, &body.half);
            body.look = look;
            body.shape = Shape { radius_mm: body.shape.radius_mm + shape.radius_mm, ..shape };
            found.push(Neighbour { body, word, hazard });
            false
        });
    }
    found
}

/// A bare box against a side of the target.
fn place(rng: &mut Rng, target: &Target<'_>, side: usize, hazard: Hazard) -> Body {
    let Target { size, base_mm, faces } = *target;
    // Cartons of one delivery: equal in all, or in some of their sizes, so that edges go on in one line.
    let same = if rng.chance(0.3) { 1.0 } else { 0.4 };
    let mut other = size.map(|length| if rng.chance(same) { length } else { length * rng.range(0.45, 1.3) });
    if side == 4 {
        other.z = other.z.min(600.0);
    }
    let mut shift = (0.5 * (size - other).abs()).map(|slack| slack * rng.range(-1.0, 1.0));
    for face in faces.iter().filter(|f| *f / 2 != side / 2) {
        let step = match hazard {
            Hazard::FlushNeighbour => rng.range(-FLUSH_MM, FLUSH_MM),
            _ => rng.sign() * rng.log_range(STEP_MM.0, STEP_MM.1),
        };
        let axis = face / 2;
        if axis == 2 {
            other.z = size.z + step; // both stand on the same ground
        } else {
            shift[axis] = outward(*face) * (0.5 * (size[axis] - other[axis]) + step);
        }
    }
    let gap = if side == 4 { rng.range(0.0, 1.0) } else { rng.range(TURN_MM, 3.0 - TURN_MM) };
    let foot = if side == 4 {
        Vector3::new(shift.x, shift.y, base_mm + size.z + gap)
    } else {
        let axis = side / 2;
        shift[axis] = outward(side) * (0.5 * (size[axis] + other[axis]) + gap);
        Vector3::new(shift.x, shift.y, base_mm)
    };
    let yaw = rng.range(-1.0, 1.0) * TURN_MM / other.x.max(other.y);
    let bare = Appearance::bare(paint(rng, [128; 3]), 0.0);
    Body::upright(foot, other, yaw, bare, Role::Carton).rounded(rng.range(0.5, 3.0))
}

/// The sign of a face's outward normal along its axis.
fn outward(face: usize) -> f64 {
    if face.is_multiple_of(2) { 1.0 } else { -1.0 }
}

/// How far a body's face stands out of the plane of the target's face of the same number, mm; both are upright.
pub(super) fn step_mm(target: &Body, other: &Body, face: usize) -> f64 {
    let reach = |b: &Body| outward(face) * b.centre[face / 2] + b.half[face / 2];
    reach(other) - reach(target)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hazard::Hazards;
    use crate::head::Head;
    use crate::stock::{Split, Stock};
    use crate::world::{Plan, Scene, compose};

    fn scenes(hazards: Hazards, count: u64) -> Vec<Scene> {
        let stock = Stock { hazards, ..Stock::new(Split::Training) };
        let draw = |seed| {
            let head = Head::random(&mut Rng::new(seed, 1)).unwrap();
            let plan = if seed % 2 == 0 { Plan::Box } else { Plan::Face };
            compose(&mut Rng::new(seed, 2), &head, plan, &stock)
        };
        (0..count).map(draw).collect()
    }

    /// Steps of the cartons that touch the target, out of each looked-at face that they border.
    fn steps_mm(scene: &Scene) -> Vec<f64> {
        let target = &scene.bodies[0];
        let faces: Vec<usize> = scene.views.iter().map(|v| v.face).collect();
        let near = |b: &&Body| {
            let above = b.centre.z > target.centre.z - target.half.z;
            b.role == Role::Carton && above && b.apart_mm(target) < 3.5
        };
        let mut steps = Vec::new();
        for body in scene.bodies[1..].iter().filter(near) {
            let apart = (body.centre - target.centre).abs() - body.half - target.half;
            let borders = faces.iter().filter(|f| **f / 2 != apart.imax());
            steps.extend(borders.map(|f| step_mm(target, body, *f)));
        }
        steps
    }

    #[test]
    fn the_share_of_scenes_with_a_flush_neighbour_is_what_the_list_of_hazards_says() {
        let all = scenes(Hazards::default(), 300);
        let flush = all.iter().filter(|s| s.hazards.contains(&Hazard::FlushNeighbour)).count();
        assert!((114..=150).contains(&flush), "{flush} of 300");
        for scene in &all {
            let flush = scene.hazards.contains(&Hazard::FlushNeighbour);
            let below = scene.words.neighbours.contains(&"below");
            assert_eq!(flush, below || steps_mm(scene).iter().any(|s| s.abs() <= 3.0));
        }
    }

    #[test]
    fn stepped_neighbours_stand_out_or_back_by_4_to_60_mm_and_without_the_hazards_there_are_none() {
        let mut both = [0, 0];
        for scene in scenes(Hazards::only(&[Hazard::SteppedNeighbour]), 120) {
            let steps = steps_mm(&scene);
            assert_eq!(steps.is_empty(), !scene.hazards.contains(&Hazard::SteppedNeighbour));
            for step in steps {
                assert!((3.9..=60.1).contains(&step.abs()), "{step} mm");
                both[usize::from(step > 0.0)] += 1;
            }
        }
        assert!(both.iter().all(|n| *n > 5), "{both:?}");
        let none = scenes(Hazards::none(), 40);
        assert!(none.iter().all(|s| s.hazards.is_empty() && s.words.neighbours.is_empty()));
    }

    #[test]
    fn boxes_of_one_colour_have_no_print_and_a_neighbour_of_their_colour() {
        let hazards = [Hazard::OneColour, Hazard::FlushNeighbour];
        let found: Vec<Scene> = scenes(Hazards::only(&hazards), 120)
            .into_iter()
            .filter(|s| s.hazards.contains(&Hazard::OneColour))
            .collect();
        assert!(found.len() > 5, "{}", found.len());
        let touched = found.iter().filter(|s| s.hazards.contains(&Hazard::FlushNeighbour)).count();
        assert!(2 * touched > found.len(), "{touched} of {}", found.len());
        for scene in found {
            let target = &scene.bodies[0].look;
            assert!(target.decals.is_empty());
            let alike = |b: &&Body| {
                let (a, b) = (b.look.surface.base, target.surface.base);
                (a - b).abs().largest() < 0.03 * b.largest()
            };
            assert!(scene.bodies[1..].iter().filter(alike).count() >= scene.words.neighbours.len());
        }
    }
}
