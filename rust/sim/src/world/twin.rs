//! Boxes to order, where [`mod@super::compose`] draws them: a given size in given views, to repeat an experiment. Indoors,
//! cartons without print along their edges, nothing touching them. Materials, stands, rooms and light are drawn all the same.

use super::compose::{clear_sight, expose, stands_free};
use super::light::lighting;
use super::stand::{Stand, paint, stand};
use super::{Body, Role, Scene, View, compose, face_half, room};
use crate::head::Head;
use crate::material::Appearance;
use crate::material::carton::{Carton, plain_edged};
use crate::pose::{FacePose, place_by_hand, random_orientation};
use crate::rng::Rng;
use crate::shape::Shape;
use crate::solid::FACES;
use crate::stock::Stock;
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::collections::BTreeSet;

/// The paper's boxes (Tables 4 and 5), from the smallest to the largest: length, width, height, mm; those of the recordings b01 to b06.
pub const BOXES_MM: [[f64; 3]; 6] = [
    [143.4, 120.5, 100.0],
    [550.6, 350.5, 300.0],
    [800.0, 600.0, 500.0],
    [1200.0, 900.0, 700.0],
    [1500.0, 690.7, 570.5],
    [1800.0, 900.0, 400.0],
];

/// What the faces of a box are like.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Finish {
    /// Print, labels and gloss as they are drawn.
    #[default]
    AsDrawn,
    /// Bare board.
    Matt,
    /// Board with print, labels or tape on every face that is looked at.
    Printed,
    /// Bare board under varnish.
    Glossy,
}

/// How a face is looked at.
#[derive(Clone, Copy, Debug)]
pub enum ViewDirection {
    /// In this pose.
    At(FacePose),
    /// As a courier would, up to so many degrees from straight on.
    ByHand {
        /// Largest tilt, degrees.
        most_deg: f64,
    },
}

/// One box and how it is looked at.
#[derive(Clone, Debug)]
pub struct Order {
    /// Sizes along x (the front's width), y (away from the viewer) and z (up), mm.
    pub size_mm: Vector3<f64>,
    /// Outward bulge in the middle of every face, mm; a dent if negative.
    pub bulge_mm: f32,
    /// What its faces are like.
    pub finish: Finish,
    /// On a column of this height that is narrower than the box, so that it can be seen from below; without it on a stand that is
    /// drawn. mm.
    pub column_mm: Option<f64>,
    /// One view each: which face (numbers as in [`crate::solid`]), and how it is looked at.
    pub views: Vec<(usize, ViewDirection)>,
}

/// Draws until everything fits; give up after so many.
const ATTEMPTS: usize = 200;
/// Draws of one view, and of a print that is on all faces.
const PLACES: usize = 30;
const PRINTS: usize = 60;
/// How much narrower than the box a column is, on each side, mm.
const COLUMN_INSET_MM: f64 = 40.0;
/// Reflectance of bare board and of varnish.
const MATT: f32 = 0.02;
const VARNISH: f32 = 0.35;
/// A hand holds the head this still between two shots, 1 sigma.
const TREMBLE_MM: f64 = 4.0;
const TREMBLE_RAD: f64 = 0.008;
/// As in [`place_face`].
const MARGIN_PX: f64 = 12.0;
const MARGIN_MM: f64 = 2.0;

/// The scene of an order; `None` if such a box cannot be measured in such views.
pub fn twin(rng: &mut Rng, head: &Head, order: &Order, stock: &Stock) -> Option<Scene> {
    (0..ATTEMPTS).find_map(|_| attempt(&mut rng.child(), head, order, stock))
}

fn attempt(rng: &mut Rng, head: &Head, order: &Order, stock: &Stock) -> Option<Scene> {
    let half = order.size_mm / 2.0;
    let stand = match order.column_mm {
        Some(height_mm) => column(rng, &order.size_mm, height_mm),
        None => stand(rng, &order.size_mm, stock, false),
    };
    let centre = Vector3::new(0.0, 0.0, stand.top_mm + half.z);
    let mut views = Vec::with_capacity(order.views.len());
    for &(face, aim) in &order.views {
        let free = |pose: FacePose| {
            let view = View::of_face(&pose, face, centre, &half);
            stands_free(head, &view, &pose, &stand.bodies).then_some(view)
        };
        views.push(match aim {
            ViewDirection::At(pose) => free(pose)?,
            ViewDirection::ByHand { most_deg } => (0..PLACES).find_map(|_| {
                let cam_from_face = random_orientation(rng, face != 4, most_deg);
                let size = face_half(&half, face).map(|h| 2.0 * h);
                place_by_hand(rng, head, size, cam_from_face).and_then(free)
            })?,
        });
    }
    let faces: BTreeSet<usize> = order.views.iter().map(|v| v.0).collect();
    // Of its own: everything else is the same whatever the finish.
    let carton = carton(&mut rng.child(), &half, order.finish, &faces, stock);
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
    let faces: Vec<usize> = faces.into_iter().collect();
    let reach =
        stand.bodies.iter().fold(half.xy().norm(), |r, b| r.max((b.centre.xy() + b.half.xy()).norm()));
    let mut bodies = vec![target];
    bodies.extend(stand.bodies);
    let fixed = bodies.len();
    bodies.extend(room::shell(rng, false, &faces, half.y + 700.0, stock));
    bodies.extend(room::clutter(rng, reach, false, stock));
    let words = compose::TruthWords { base: carton.base, stand: stand.word, neighbours: Vec::new() };
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

/// A painted column below a box.
fn column(rng: &mut Rng, size_mm: &Vector3<f64>, height_mm: f64) -> Stand {
    let narrower = Vector3::new(2.0 * COLUMN_INSET_MM, 2.0 * COLUMN_INSET_MM, 0.0);
    let size = Vector3::new(size_mm.x, size_mm.y, height_mm) - narrower;
    let look = Appearance::bare(paint(rng, [120, 122, 124]), 0.05);
    let body = Body::upright(Vector3::zeros(), size, 0.0, look, Role::Stand);
    Stand { bodies: vec![body], top_mm: height_mm, word: "column" }
}

/// A carton without print along its edges, in a finish; `faces` are looked at.
fn carton(
    rng: &mut Rng,
    half: &Vector3<f64>,
    finish: Finish,
    faces: &BTreeSet<usize>,
    stock: &Stock,
) -> Carton {
    let mut carton = plain_edged(rng, half, stock);
    match finish {
        Finish::AsDrawn => {}
        Finish::Matt | Finish::Glossy => {
            carton.look.decals.clear();
            carton.look.gloss = if finish == Finish::Matt { MATT } else { VARNISH };
        }
        Finish::Printed => {
            // The same board, printed until it shows on all faces.
            for _ in 0..PRINTS {
                if faces.iter().all(|face| carton.look.decals.iter().any(|d| d.face == *face)) {
                    break;
                }
                carton.look.decals = plain_edged(rng, half, stock).look.decals;
            }
        }
    }
    carton
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
    use crate::pose::place_seen_from;
    use crate::stock::Split;

    fn order(views: Vec<(usize, ViewDirection)>) -> Order {
        let size_mm = Vector3::new(800.0, 500.0, 600.0);
        Order { size_mm, bulge_mm: 3.0, finish: Finish::AsDrawn, column_mm: None, views }
    }

    #[test]
    fn a_twin_has_the_size_and_the_views_that_were_ordered_and_trembles_a_little() {
        let head = Head::nominal().unwrap();
        let stock = Stock::new(Split::HeldOut);
        let tilted = place_seen_from(&head, [800.0, 600.0], [20.0, 10.0], 45.0).unwrap();
        let by_hand = ViewDirection::ByHand { most_deg: 25.0 };
        let mut rng = Rng::new(1, 0);
        let scene = twin(&mut rng, &head, &order(vec![(3, ViewDirection::At(tilted)), (0, by_hand)]), &stock)
            .unwrap();
        let target = &scene.bodies[0];
        let first = target.face(3, &scene.views[0]);
        assert_eq!(first.size_mm(), [800.0, 600.0]);
        assert_eq!(target.face(0, &scene.views[1]).size_mm(), [600.0, 500.0]);
        assert!((first.cam_from_face - tilted.cam_from_face).norm() < 1e-9);
        assert!(scene.views.iter().all(|v| target.face(v.face, v).crossings(&head, 1.9, 11.9).is_some()));
        assert_eq!(target.shape.bulge_mm, [3.0; FACES]);

        let next = trembled(&mut rng, &head, &scene);
        let moved = (target.face(3, &next.views[0]).centre - first.centre).norm();
        assert!((0.1..40.0).contains(&moved), "{moved} mm");
        // 10 mm is the narrowest that the paper names and no four stripes fit on it.
        let narrow = Order { size_mm: Vector3::new(800.0, 500.0, 10.0), ..order(vec![(3, by_hand)]) };
        assert!(twin(&mut rng, &head, &narrow, &stock).is_none());
    }

    #[test]
    fn on_a_column_a_face_is_seen_from_sixty_degrees_below() {
        let head = Head::nominal().unwrap();
        let below = place_seen_from(&head, [800.0, 600.0], [0.0, -60.0], 45.0).unwrap();
        let raised = Order { column_mm: Some(1000.0), ..order(vec![(3, ViewDirection::At(below))]) };
        let scene = twin(&mut Rng::new(2, 0), &head, &raised, &Stock::new(Split::HeldOut)).unwrap();
        assert!(scene.views[0].camera_mm.z < 700.0, "{}", scene.views[0].camera_mm.z);
        assert_eq!(scene.words.stand, "column");
    }

    #[test]
    fn a_finish_changes_the_faces_and_nothing_else() {
        let head = Head::nominal().unwrap();
        let stock = Stock::new(Split::HeldOut);
        let views = vec![
            (3, ViewDirection::ByHand { most_deg: 20.0 }),
            (0, ViewDirection::ByHand { most_deg: 20.0 }),
        ];
        let of = |finish| {
            let order = Order { finish, ..order(views.clone()) };
            twin(&mut Rng::new(3, 0), &head, &order, &stock).unwrap()
        };
        let [matt, printed, glossy] = [Finish::Matt, Finish::Printed, Finish::Glossy].map(of);
        let look = |scene: &Scene| scene.bodies[0].look.clone();
        assert!(look(&matt).decals.is_empty() && look(&glossy).decals.is_empty());
        assert!(look(&glossy).gloss > 5.0 * look(&matt).gloss);
        for face in [0, 3] {
            assert!(look(&printed).decals.iter().any(|d| d.face == face), "face {face}");
        }
        for other in [&printed, &glossy] {
            assert_eq!(look(other).surface.base, look(&matt).surface.base);
            assert_eq!(other.views[1].camera_mm, matt.views[1].camera_mm);
            assert_eq!(other.light.lamps.len(), matt.light.lamps.len());
            assert_eq!(other.bodies.len(), matt.bodies.len());
        }
    }
}
