//! Boxes to order, where [`mod@super::compose`] draws them: a given size in given views, to repeat an experiment. Indoors,
//! cartons without print along their edges, nothing touching them. Materials, stands, rooms and light are drawn all the same.

use super::compose::{clear_sight, expose, stands_free};
use super::light::lighting;
use super::{Body, Role, Scene, View, compose, face_half, room, stand};
use crate::head::Head;
use crate::material::carton::plain_edged;
use crate::pose::{FacePose, place_face};
use crate::rng::Rng;
use crate::shape::Shape;
use crate::solid::FACES;
use crate::stock::Stock;
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::collections::BTreeSet;

/// One box and how it is looked at.
#[derive(Clone, Debug)]
pub struct Order {
    /// Sizes along x (the front's width), y (away from the viewer) and z (up), mm.
    pub size_mm: Vector3<f64>,
    /// Outward bulge in the middle of every face, mm; a dent if negative.
    pub bulge_mm: f32,
    /// One view each: which face (numbers as in [`crate::solid`]), and how it is turned before the head.
    pub views: Vec<(usize, Matrix3<f64>)>,
}

/// Draws until everything fits; give up after so many.
const ATTEMPTS: usize = 200;
/// A hand holds the head this still between two shots, 1 sigma.
const TREMBLE_MM: f64 = 4.0;
const TREMBLE_RAD: f64 = 0.008;
/// As in [`place_face`].
const MARGIN_PX: f64 = 12.0;
const MARGIN_MM: f64 = 2.0;

/// A face before the head: rolled, then tilted about an axis in the image (0 is its horizontal), degrees.
#[must_use]
pub fn turned(roll_deg: f64, tilt_deg: f64, axis_deg: f64) -> Matrix3<f64> {
    let axis = Vector3::new(axis_deg.to_radians().cos(), axis_deg.to_radians().sin(), 0.0);
    let roll = Rotation3::from_axis_angle(&Vector3::z_axis(), roll_deg.to_radians());
    (Rotation3::new(axis * tilt_deg.to_radians()) * roll).into_inner()
}

/// The scene of an order; `None` if such a box cannot be measured in such views.
pub fn twin(rng: &mut Rng, head: &Head, order: &Order, stock: &Stock) -> Option<Scene> {
    (0..ATTEMPTS).find_map(|_| attempt(&mut rng.child(), head, order, stock))
}

fn attempt(rng: &mut Rng, head: &Head, order: &Order, stock: &Stock) -> Option<Scene> {
    let half = order.size_mm / 2.0;
    let stand = stand::stand(rng, &order.size_mm, stock, false);
    let centre = Vector3::new(0.0, 0.0, stand.top_mm + half.z);
    let mut views = Vec::with_capacity(order.views.len());
    for &(face, cam_from_face) in &order.views {
        let size = face_half(&half, face).map(|h| 2.0 * h);
        let pose = place_face(rng, head, size, cam_from_face)?;
        let view = View::of_face(&pose, face, centre, &half);
        stands_free(head, &view, &pose, &stand.bodies).then_some(())?;
        views.push(view);
    }
    let carton = plain_edged(rng, &half, stock);
    let target = Body {
        centre,
        rotation: Matrix3::identity(),
        half,
        shape: Shape {
            radius_mm: rng.log_range(0.5, 4.0).min(0.02 * half.min()),
            bulge_mm: [order.bulge_mm; FACES],
            ..Shape::default()
        },
        look: carton.look,
        role: Role::Target,
    };
    let distance_mm = views.iter().map(|v| (v.camera_mm - centre).norm()).fold(f64::INFINITY, f64::min);
    let light = lighting(rng, centre, distance_mm);
    if light.ambient == "sun" {
        return None;
    }
    let faces: Vec<usize> = order.views.iter().map(|v| v.0).collect();
    let reach =
        stand.bodies.iter().fold(half.xy().norm(), |r, b| r.max((b.centre.xy() + b.half.xy()).norm()));
    let mut bodies = vec![target];
    bodies.extend(stand.bodies);
    let fixed = bodies.len();
    bodies.extend(room::shell(rng, false, &faces, half.y + 700.0, stock));
    bodies.extend(room::clutter(rng, reach, false, stock));
    let words = compose::Words { base: carton.base, stand: stand.word, neighbours: Vec::new() };
    let mut scene = Scene {
        bodies,
        target: Some(0),
        light,
        views,
        beams: head.beams,
        refuse: None,
        hidden: None,
        words,
        hazards: BTreeSet::new(),
    };
    clear_sight(&mut scene, head, fixed);
    expose(rng, &mut scene);
    Some(scene)
}

/// The same scene for the next shot of a hand that means to hold still.
pub fn trembled(rng: &mut Rng, head: &Head, scene: &Scene) -> Scene {
    let mut next = scene.clone();
    let Some(target) = scene.target.and_then(|t| scene.bodies.get(t)) else { return next };
    for view in &mut next.views {
        let pose = target.face(view.face, view);
        let moved = (0..30).find_map(|_| {
            let turn = Rotation3::new(Vector3::from_fn(|_, _| TREMBLE_RAD * rng.normal()));
            let shift = Vector3::from_fn(|_, _| TREMBLE_MM * rng.normal());
            let moved = FacePose {
                cam_from_face: turn * pose.cam_from_face,
                centre: pose.centre + shift,
                half: pose.half,
            };
            moved.crossings(head, MARGIN_MM, MARGIN_PX).map(|_| moved)
        });
        if let Some(moved) = moved {
            let exposure = view.exposure;
            *view = View { exposure, ..View::of_face(&moved, view.face, target.centre, &target.half) };
        }
    }
    next
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stock::Split;

    #[test]
    fn a_twin_has_the_size_and_the_views_that_were_ordered_and_trembles_a_little() {
        let head = Head::nominal().unwrap();
        let stock = Stock::new(Split::HeldOut);
        let tilted = turned(45.0, 20.0, 30.0);
        let order = Order {
            size_mm: Vector3::new(800.0, 500.0, 600.0),
            bulge_mm: 3.0,
            views: vec![(3, tilted), (4, turned(-45.0, 0.0, 0.0))],
        };
        let mut rng = Rng::new(1, 0);
        let scene = twin(&mut rng, &head, &order, &stock).unwrap();
        let target = &scene.bodies[0];
        let first = target.face(3, &scene.views[0]);
        assert_eq!(first.size_mm(), [800.0, 600.0]);
        assert_eq!(target.face(4, &scene.views[1]).size_mm(), [800.0, 500.0]);
        assert!((first.cam_from_face - tilted).norm() < 1e-9);
        assert!(scene.views.iter().all(|v| target.face(v.face, v).crossings(&head, 1.9, 11.9).is_some()));
        assert_eq!(target.shape.bulge_mm, [3.0; FACES]);

        let next = trembled(&mut rng, &head, &scene);
        let moved = (target.face(3, &next.views[0]).centre - first.centre).norm();
        assert!((0.1..40.0).contains(&moved), "{moved} mm");
        // 10 mm is the narrowest that the paper names and no four stripes fit on it.
        let narrow = Order { size_mm: Vector3::new(800.0, 500.0, 10.0), views: vec![(3, tilted)], ..order };
        assert!(twin(&mut rng, &head, &narrow, &stock).is_none());
    }
}
