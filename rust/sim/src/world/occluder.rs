//! Things that hide a part of a face: another box, a hand, a trolley's post, a hanging strap, a roll of stretch wrap, the box's own flap
//! that leans over it. They are drawn before a face that could be measured without them, until one hides what matters: a corner, a
//! stripe's end or a piece of a side. Such a face must be refused.

use super::flap::open_flap;
use super::stand::paint;
use super::{Body, Role, View};
use crate::head::Head;
use crate::material::{Appearance, carton};
use crate::pose::FacePose;
use crate::rng::Rng;
use crate::shape::Shape;
use crate::solid::Solid;
use crate::stock::Stock;
use crate::vec3::V3;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// What of a face cannot be seen.
#[derive(Clone, Debug, PartialEq)]
pub struct Hidden {
    /// Which share of each side; side k joins corners k and k + 1 of [`FacePose::corners`].
    pub of_side: [f64; 4],
    /// Corners, as [`FacePose::corners`] counts them.
    pub corners: Vec<usize>,
    /// Laser (0 to 3) and end, as [`crate::pose::Crossing::at`] counts it, of stripes whose end the camera does not see or the
    /// laser does not light.
    pub stripe_ends: Vec<[usize; 2]>,
    /// Nearest distance of what hides it to the face's plane, mm.
    pub in_front_mm: f64,
}

/// A side counts as hidden from this share on.
const HIDDEN_SIDE: f64 = 0.02;
/// A side alone makes a face unmeasurable from this share on: a strap's breadth of a small box.
const MUCH_OF_A_SIDE: f64 = 0.08;
/// More than this share of the face is never hidden: nobody would expect a result.
const MOST_OF_FACE: f64 = 0.6;
/// Distance of things from the camera and from the lasers' exits, mm.
const CLEAR_MM: f64 = 60.0;
const FARTHEST_MM: f64 = 600.0;
const TRIES: usize = 40;
/// Share of faces that a flap of the box itself hides: it lies so near to the face that it is the hardest to tell from it.
const FLAPS: f64 = 1.0 / 3.0;

impl Hidden {
    /// What solids before a face hide of it.
    #[must_use]
    pub fn by(bodies: &[Body], view: &View, pose: &FacePose, head: &Head) -> Self {
        let solids: Vec<Solid> = bodies.iter().map(|b| b.solid(view)).collect();
        let unseen =
            |p: Vector3<f64>| solids.iter().any(|s| s.hit((p / p.z).into(), p.z as f32 - 0.2).is_some());
        let dark = |p: Vector3<f64>, laser: usize| {
            let (from, to): (V3, V3) = (p.into(), (head.beams[laser].source_mm - p).into());
            solids.iter().any(|s| s.blocks(from, to))
        };
        let corners = pose.corners();
        let of_side = [0, 1, 2, 3].map(|k| {
            const STEPS: usize = 64;
            let (a, b) = (corners[k], corners[(k + 1) % 4]);
            let at = |i: usize| a + (b - a) * ((i as f64 + 0.5) / STEPS as f64);
            (0..STEPS).filter(|i| unseen(at(*i))).count() as f64 / STEPS as f64
        });
        let ends = (0..4).filter_map(|k| Some((k, pose.crossing(head, k, 0.0)?)));
        let stripe_ends = ends.flat_map(|(k, crossing)| {
            [0, 1].map(|end| (k, end, pose.point(crossing.at[end][0], crossing.at[end][1])))
        });
        Self {
            of_side,
            corners: (0..4).filter(|k| unseen(corners[*k])).collect(),
            stripe_ends: stripe_ends
                .filter(|(k, _, p)| unseen(*p) || dark(*p, *k))
                .map(|(k, end, _)| [k, end])
                .collect(),
            in_front_mm: gap_mm(bodies, view, pose),
        }
    }

    /// The sides of which a piece is hidden.
    pub fn sides(&self) -> impl Iterator<Item = usize> {
        (0..4).filter(|k| self.of_side[*k] >= HIDDEN_SIDE)
    }

    /// Whether a face must be refused for it.
    #[must_use]
    pub fn matters(&self) -> bool {
        let corner_or_end = !self.corners.is_empty() || !self.stripe_ends.is_empty();
        corner_or_end || self.of_side.iter().any(|share| *share >= MUCH_OF_A_SIDE)
    }
}

/// Distance of the nearest of some bodies to a face's plane, mm; negative behind it.
fn gap_mm(bodies: &[Body], view: &View, pose: &FacePose) -> f64 {
    let out = -(view.cam_from_world.transpose() * pose.cam_from_face.column(2));
    let face = view.world(pose.centre);
    let gap = |b: &Body| {
        let inner = b.half.add_scalar(-b.shape.radius_mm);
        let reach = (b.rotation.transpose() * out).abs().dot(&inner) + b.shape.radius_mm;
        out.dot(&(b.centre - face)) - reach
    };
    bodies.iter().map(gap).fold(f64::INFINITY, f64::min)
}

/// Kinds of things.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum OccluderKind {
    Carton,
    Hand,
    Post,
    Strap,
    Roll,
}

/// Draws a thing before the face of a view, and what it hides; `None` if none was found that hides what matters.
pub(super) fn occluder(
    rng: &mut Rng,
    target: &Body,
    view: &View,
    head: &Head,
    stock: &Stock,
) -> Option<(Vec<Body>, Hidden)> {
    let pose = &target.face(view.face, view);
    let bulge_mm = f64::from(target.shape.bulge_mm[view.face].max(0.0));
    let thing = (!rng.chance(FLAPS)).then(|| {
        rng.pick([
            OccluderKind::Carton,
            OccluderKind::Hand,
            OccluderKind::Post,
            OccluderKind::Strap,
            OccluderKind::Roll,
        ])
    });
    (0..TRIES).find_map(|_| {
        let bodies = if let Some(thing) = thing {
            let aim = aim(rng, pose, head);
            let touching = rng.chance(0.25);
            let gap = if touching { rng.range(0.0, 2.0) } else { FARTHEST_MM * rng.unit().powf(1.3) };
            before(rng, thing, view, pose, aim, gap + bulge_mm, stock)?
        } else {
            vec![open_flap(rng, target, view.face / 2, &[view.face], |_| true)?]
        };
        let eyes = head.beams.iter().map(|b| view.world(b.source_mm)).chain([view.camera_mm]);
        if eyes.into_iter().any(|eye| bodies.iter().any(|b| b.distance_mm(eye) < CLEAR_MM)) {
            return None;
        }
        let hidden = Hidden::by(&bodies, view, pose, head);
        let near = (-0.01..=FARTHEST_MM + 1.0).contains(&hidden.in_front_mm);
        (near && hidden.matters() && share_hidden(&bodies, view, pose) < MOST_OF_FACE)
            .then_some((bodies, hidden))
    })
}

/// A point of the face that is to be hidden, in the camera frame: about a corner, a stripe's end or any place of a side.
fn aim(rng: &mut Rng, pose: &FacePose, head: &Head) -> Vector3<f64> {
    let [a, b] = pose.half;
    let (right, down) = match rng.below(4) {
        0 => (rng.sign() * a, rng.sign() * b),
        1 if rng.chance(0.5) => (rng.sign() * a, rng.range(-1.0, 1.0) * b),
        1 => (rng.range(-1.0, 1.0) * a, rng.sign() * b),
        _ => match pose.crossing(head, rng.below(4), 0.0) {
            Some(crossing) => crossing.at[rng.below(2)].into(),
            None => (a, b),
        },
    };
    let about = 0.05 * a.min(b);
    pose.point(right + rng.normal() * about, down + rng.normal() * about)
}

fn share_hidden(bodies: &[Body], view: &View, pose: &FacePose) -> f64 {
    const N: usize = 12;
    let solids: Vec<Solid> = bodies.iter().map(|b| b.solid(view)).collect();
    let share = |i: usize| (i as f64 + 0.5) / N as f64 * 2.0 - 1.0;
    let hidden = (0..N * N).filter(|i| {
        let p = pose.point(share(i % N) * pose.half[0], share(i / N) * pose.half[1]);
        solids.iter().any(|s| s.hit((p / p.z).into(), p.z as f32).is_some())
    });
    hidden.count() as f64 / (N * N) as f64
}

/// A right-handed frame whose z axis is `long` and whose y axis is as near to `thick` as it can be.
fn frame(long: Vector3<f64>, thick: Vector3<f64>) -> Matrix3<f64> {
    let z = long.normalize();
    let x = thick.cross(&z).normalize();
    Matrix3::from_columns(&[x, z.cross(&x), z])
}

fn body(
    centre: Vector3<f64>,
    rotation: Matrix3<f64>,
    half: [f64; 3],
    radius_mm: f64,
    look: Appearance,
) -> Body {
    let half = Vector3::from(half);
    Body { centre, rotation, half, shape: Shape::rounded(radius_mm), look, role: Role::Occluder }
}

/// A round bar with round ends along z of `rotation`.
fn bar(centre: Vector3<f64>, rotation: Matrix3<f64>, radius_mm: f64, length: f64, look: Appearance) -> Body {
    body(centre, rotation, [radius_mm, radius_mm, length / 2.0], radius_mm, look)
}

/// The bodies of a thing that the camera sees before a point of the face, `gap_mm` in front of the face.
fn before(
    rng: &mut Rng,
    thing: OccluderKind,
    view: &View,
    pose: &FacePose,
    aim: Vector3<f64>,
    gap: f64,
    stock: &Stock,
) -> Option<Vec<Body>> {
    let world_from_cam = view.cam_from_world.transpose();
    let out = -(world_from_cam * pose.cam_from_face.column(2));
    let lying = out.z > 0.5; // the top of the target
    let at = view.world(aim);
    // In the plane of the face, from its middle to the point that is to be hidden.
    let away = {
        let d = at - view.world(pose.centre);
        (d - out * out.dot(&d)).normalize()
    };
    let up = if lying { away } else { Vector3::z() };
    let mut bodies = match thing {
        OccluderKind::Carton => {
            let size = Vector3::new(
                rng.log_range(120.0, 600.0),
                rng.log_range(100.0, 500.0),
                rng.log_range(80.0, 400.0),
            );
            let yaw = rng.range(-0.7, 0.7);
            let turned = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw).into_inner();
            // So that one of its edges, not its middle, comes to lie before the point.
            let aside =
                away.cross(&out) * rng.range(-0.4, 0.4) * size.x + away * rng.range(0.2, 0.5) * size.x;
            let bare = Appearance::bare(paint(rng, [128; 3]), 0.0);
            let one = body(at + aside, turned, (size / 2.0).into(), rng.range(0.5, 3.0), bare);
            vec![Body { role: Role::Carton, ..one }]
        }
        OccluderKind::Hand => hand(rng, at, away, out),
        OccluderKind::Post => {
            let colour = rng.pick([[150, 152, 154], [40, 78, 150], [214, 104, 28], [52, 54, 58]]);
            let look = Appearance::bare(paint(rng, colour), rng.range_f32(0.1, 0.3));
            let (radius, length) = (rng.range(11.0, 25.0), rng.range(900.0, 1900.0));
            let along = if lying { away.cross(&out) + away * (0.4 * rng.normal()) } else { up };
            let rotation = frame(along, out);
            vec![if rng.chance(0.6) {
                bar(at, rotation, radius, length, look)
            } else {
                body(at, rotation, [radius, radius, length / 2.0], 3.0, look)
            }]
        }
        OccluderKind::Strap => {
            let colour =
                rng.pick([[28, 28, 30], [230, 190, 40], [190, 170, 130], [200, 40, 36], [40, 70, 160]]);
            let look = Appearance::bare(paint(rng, colour), rng.range_f32(0.03, 0.15));
            let (half, length) = (rng.range(10.0, 26.0), rng.range(400.0, 2000.0));
            let swing = if lying { 0.4 } else { 0.08 };
            let long = up + away.cross(&out) * (rng.normal() * swing);
            let turn = Rotation3::new(long.normalize() * (rng.normal() * 0.4)).into_inner();
            // Its lower end hangs below the point by up to half its length.
            let centre = at + long.normalize() * (length * rng.range(0.0, 0.45));
            vec![body(centre, turn * frame(long, out), [half, 1.2, length / 2.0], 0.5, look)]
        }
        OccluderKind::Roll => roll(rng, at, away, out),
    };
    // A box on top lies there.
    let gap = if lying && thing == OccluderKind::Carton { gap.min(1.0) } else { gap };
    // Along the line of sight, so that it stays before its point, until its nearest part is where it should be.
    let towards = (view.camera_mm - at).normalize();
    let way = (gap - gap_mm(&bodies, view, pose)) / towards.dot(&out);
    let reach = (view.camera_mm - at).norm();
    if !(way.is_finite() && way < 0.7 * reach) {
        return None;
    }
    for body in &mut bodies {
        body.centre += towards * way;
    }
    if !lying && matches!(thing, OccluderKind::Carton | OccluderKind::Post) {
        stand_up(rng, &mut bodies, &(at + towards * way));
    }
    for body in bodies.iter_mut().filter(|b| b.role == Role::Carton) {
        body.look = carton(rng, &body.half, stock).look;
    }
    Some(bodies)
}

/// Boxes and posts reach above the point that they hide; they stand on the floor, or someone holds the box up there.
fn stand_up(rng: &mut Rng, bodies: &mut [Body], point: &Vector3<f64>) {
    for body in bodies {
        let top = point.z + rng.range(0.02, 0.5) * body.half.z.min(400.0);
        let held = body.role == Role::Carton && top > 900.0;
        let bottom = if held { top - 2.0 * body.half.z } else { 0.0 };
        let top = top.max(bottom + 60.0);
        body.half.z = (top - bottom) / 2.0;
        body.centre.z = (top + bottom) / 2.0;
    }
}

/// A hand with its thumb at the end of a forearm that comes from beyond the face.
fn hand(rng: &mut Rng, at: Vector3<f64>, away: Vector3<f64>, out: Vector3<f64>) -> Vec<Body> {
    let tone = rng.pick([[224, 178, 150], [196, 145, 120], [141, 96, 70], [92, 62, 46]]);
    let sleeve = rng.pick([tone, tone, [40, 52, 80], [62, 64, 68], [226, 120, 30], [180, 178, 172]]);
    let mut skin = |rgb| Appearance::bare(paint(rng, rgb), 0.04);
    let (skin, cloth) = (skin(tone), skin(sleeve));
    let size = rng.range(0.88, 1.12);
    let aside = Rotation3::new(out * rng.range(-0.9, 0.9));
    let lift = rng.range(0.1, 0.8f64);
    let arm = aside * away * lift.cos() + out * lift.sin();
    let palm = frame(arm, out);
    let across = palm.column(0) * rng.sign();
    let finger = frame(-arm + across * 0.9, out);
    vec![
        body(at, palm, [43.0 * size, 15.0 * size, 92.0 * size], 14.0 * size, skin.clone()),
        body(
            at + across * (48.0 * size) - arm * (12.0 * size),
            finger,
            [12.0 * size, 12.0 * size, 40.0 * size],
            11.5 * size,
            skin,
        ),
        bar(at + arm * (215.0 * size), palm, 41.0 * size, 330.0 * size, cloth),
    ]
}

/// A roll of stretch wrap on its tube. Six flat bars about one axis make a prism of twelve sides.
fn roll(rng: &mut Rng, at: Vector3<f64>, away: Vector3<f64>, out: Vector3<f64>) -> Vec<Body> {
    const BARS: usize = 6;
    let film = rng.pick([[214, 220, 224], [214, 220, 224], [34, 34, 37], [70, 120, 160]]);
    let look = Appearance::bare(paint(rng, film), rng.range_f32(0.25, 0.45));
    let tube = Appearance::bare(paint(rng, [150, 116, 80]), 0.03);
    let (radius, length) = (rng.range(45.0, 110.0), rng.range(250.0, 500.0));
    let axis = away * rng.normal() + away.cross(&out) * rng.normal() + out * (0.25 * rng.normal());
    let rotation = frame(axis, out);
    let turn = std::f64::consts::PI / BARS as f64;
    let half = [radius * (0.5 * turn).cos(), radius * (0.5 * turn).sin(), length / 2.0];
    let mut bodies: Vec<Body> = (0..BARS)
        .map(|i| {
            let about = Rotation3::from_axis_angle(&Vector3::z_axis(), i as f64 * turn).into_inner();
            body(at, rotation * about, half, 0.0, look.clone())
        })
        .collect();
    bodies.push(bar(at, rotation, 32.0, length + 110.0, tube));
    bodies
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hazard::{Hazard, Hazards};
    use crate::pose::{Refuse, px_of};
    use crate::render::{Options, Stage};
    use crate::truth::face_of;
    use crate::world::{Plan, compose};
    use crate::{Raster, head::SENSOR_PX};

    #[test]
    fn every_occluder_hides_what_its_truth_says_and_nothing_else_of_it() {
        const FOLD_MM: f64 = 5.0; // more than board is thick
        let stock = Stock { hazards: Hazards::none(), ..Stock::default() };
        let (mut corners, mut wrong, mut ends, mut sides, mut touching, mut flaps) = (0, 0, 0, 0, 0, 0);
        for seed in 0..60 {
            let head = Head::random(&mut Rng::new(seed, 1)).unwrap();
            let plan = Plan::Refused(Refuse::Hidden);
            let scene = compose(&mut Rng::new(seed, 2), &head, plan, &stock);
            let (view, hidden) = (&scene.views[0], scene.hidden.as_ref().unwrap());
            let pose = face_of(&scene, view).unwrap();
            assert!(hidden.matters() && (-0.01..=601.0).contains(&hidden.in_front_mm), "{hidden:?}");
            // Without the thing, the face could be measured.
            assert!(pose.crossings(&head, 1.9, 11.9).is_some());
            let raster = Raster::covering(SENSOR_PX, 256, 192);
            let options = Options { lasers: true, speckle: false, seed: 0 };
            let stage = Stage::new(&scene, view, &head, raster, &stock.photos, options);
            let seen = |p: Vector3<f64>| {
                let at = raster.from_px(px_of(&head, &p).unwrap()).map(|x| x.round() as usize);
                let hit = stage.cast((p / p.z).into(), at[0].min(255), at[1].min(191));
                hit.is_some_and(|(solid, _)| Some(solid) == stage.target())
            };
            for (k, corner) in pose.corners().into_iter().enumerate() {
                // At a flap's fold the corner is seen and the point beside it, under the flap, is not.
                let fold = |b: &Body| b.role == Role::Flap && b.distance_mm(view.world(corner)) < FOLD_MM;
                if scene.bodies.iter().any(fold) {
                    continue;
                }
                // A little inside of the sharp corner, past its rounding.
                let inside = corner + (pose.centre - corner) * 0.012;
                corners += usize::from(hidden.corners.contains(&k));
                wrong += usize::from(hidden.corners.contains(&k) == seen(inside));
            }
            ends += hidden.stripe_ends.len();
            sides += hidden.sides().count();
            touching += usize::from(hidden.in_front_mm < 3.0);
            flaps += scene.bodies.iter().filter(|b| b.role == Role::Flap).count();
            let whole = hidden.corners.is_empty() && hidden.stripe_ends.is_empty();
            assert!(!whole || hidden.of_side.iter().any(|s| *s >= MUCH_OF_A_SIDE));
        }
        // A thing's rim may pass between a corner and the point beside it.
        assert!(wrong <= 6, "{wrong} of 240");
        assert!(
            corners >= 15 && ends >= 30 && sides >= 60 && touching >= 4 && flaps >= 4,
            "{corners} {ends} {sides} {touching} {flaps}"
        );
    }

    #[test]
    fn an_open_flap_hides_nothing_of_a_face_that_is_to_be_measured() {
        let stock = Stock { hazards: Hazards::only(&[Hazard::OpenFlap]), ..Stock::default() };
        let mut flaps = 0;
        for seed in 0..300 {
            let head = Head::random(&mut Rng::new(seed, 1)).unwrap();
            let scene = compose(&mut Rng::new(seed, 2), &head, Plan::Box, &stock);
            let Some(flap) = scene.bodies.iter().find(|b| b.role == Role::Flap) else { continue };
            flaps += 1;
            for view in &scene.views {
                let pose = face_of(&scene, view).unwrap();
                let hidden = Hidden::by(std::slice::from_ref(flap), view, &pose, &head);
                assert!(!hidden.matters(), "seed {seed}: {hidden:?}");
            }
        }
        assert!(flaps >= 3, "{flaps}");
    }
}
