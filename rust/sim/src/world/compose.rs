//! Draws a whole scene: box, stand, views that can (or must not) be measured, surroundings, light.

use super::beams::{FanEnd, end_fan, weaken};
use super::detour::{bounce, floor, mirrored_in_view};
use super::light::lighting;
use super::neighbours::{self, neighbours, step_mm};
use super::occluder::{Hidden, occluder};
use super::{Body, Lighting, Role, View, axes, face_half, flap, room, stand};
use crate::hazard::{Hazard, Hazards};
use crate::head::{Beam, Head};
use crate::material::carton::{Carton, Plain, carton};
use crate::material::{Appearance, Art, Pattern};
use crate::pose::{FacePose, Refuse, place_face, place_unmeasurable, random_orientation, tilted_orientation};
use crate::rng::Rng;
use crate::shape::Shape;
use crate::solid::FACES;
use crate::stock::Stock;
use nalgebra::Vector3;
use std::collections::BTreeSet;

/// What is wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plan {
    /// Two adjacent faces of one box.
    Box,
    /// Three adjacent faces of one box.
    Three,
    /// Two adjacent faces of a box A x A x B that both show A x B, each seen obliquely: what they share is told by the depth.
    Twins,
    /// One face.
    Face,
    /// One frame that must be refused.
    Refused(Refuse),
}

/// A scene with its views.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Everything solid.
    pub bodies: Vec<Body>,
    /// Which body is measured.
    pub target: Option<usize>,
    /// Light.
    pub light: Lighting,
    /// One view a frame.
    pub views: Vec<View>,
    /// The head's beams as they shine here: one may be dead (power 0), weak, or narrower than it should be.
    pub beams: [Beam; 4],
    /// Why every view must be refused, if so.
    pub refuse: Option<Refuse>,
    /// What an occluder hides of the only view's face, if there is one.
    pub hidden: Option<Hidden>,
    /// For the truth file: base, stand, neighbours.
    pub words: TruthWords,
    /// Hazards that were drawn and found their place.
    pub hazards: BTreeSet<Hazard>,
}

/// Words of the truth file's notes.
#[derive(Clone, Debug, Default)]
pub struct TruthWords {
    /// Base of the target.
    pub base: &'static str,
    /// Stand of the target.
    pub stand: &'static str,
    /// Neighbours that touch it.
    pub neighbours: Vec<&'static str>,
}

impl Scene {
    /// The head with its beams as they shine here.
    #[must_use]
    pub fn head(&self, head: &Head) -> Head {
        Head { calibration: head.calibration.clone(), beams: self.beams }
    }

    /// Words of all materials in the scene, seen or not, and names of its photographs; sorted.
    #[must_use]
    pub fn materials<'s>(&'s self, stock: &'s Stock) -> BTreeSet<&'s str> {
        let photo = |index: &usize| stock.photos.all.get(*index).map(|p| p.name.as_str());
        let mut words = BTreeSet::new();
        for Appearance { surface, decals, .. } in self.bodies.iter().map(|b| &b.look) {
            words.insert(surface.kind);
            if let Pattern::Photo { index, .. } = &surface.pattern {
                words.extend(photo(index));
            }
            for decal in decals {
                words.insert(decal.kind);
                match &decal.art {
                    Art::Photo(index) => words.extend(photo(index)),
                    Art::Print(ink, ..) => words.extend([*ink]),
                    _ => {}
                }
            }
        }
        words
    }
}

/// How far off the normal the line of sight to an oblique face is, degrees.
const OBLIQUE_DEG: std::ops::RangeInclusive<f64> = 40.0..=65.0;
/// Of the faces that cannot be measured because a stripe is missing, so many miss it because its fan ends on them.
const FAN_ENDS_SHARE: f64 = 0.3;

/// Height range of the head above the floor, mm: from a hand at the ground to one held overhead.
const HEAD_HEIGHT_MM: (f64, f64) = (70.0, 2700.0);

/// Hazards of a scene that do not lie in its cartons, before it is known which of them find their place.
struct SceneHazards {
    oblique: bool,
    weak_laser: bool,
    fan_end: Option<FanEnd>,
    one_colour: bool,
    /// Which kinds of neighbours.
    touching: Vec<Hazard>,
    polished_floor: bool,
    second_bounce: bool,
}

impl SceneHazards {
    fn new(rng: &mut Rng, plan: Plan, hazards: &Hazards) -> Self {
        let mut draw = |hazard| hazards.draw(rng, hazard);
        let oblique = draw(Hazard::Oblique) && matches!(plan, Plan::Box | Plan::Three | Plan::Face);
        let weak_laser = draw(Hazard::WeakLaser);
        let one_colour = draw(Hazard::OneColour);
        let (polished_floor, second_bounce) = (draw(Hazard::MirrorFloor), draw(Hazard::SecondBounce));
        let mut touching: Vec<Hazard> =
            [Hazard::FlushNeighbour, Hazard::SteppedNeighbour].into_iter().filter(|h| draw(*h)).collect();
        let other = if rng.chance(0.5) { Hazard::FlushNeighbour } else { Hazard::SteppedNeighbour };
        if one_colour && touching.is_empty() && hazards.has(other) {
            touching.push(other); // one colour matters where something of that colour goes on
        }
        let fan_end = match plan {
            Plan::Refused(Refuse::StripeMissing) => {
                (rng.chance(FAN_ENDS_SHARE) && hazards.has(Hazard::FanEnd)).then_some(FanEnd::OnFace)
            }
            Plan::Refused(_) => None,
            _ => hazards.draw(rng, Hazard::FanEnd).then_some(FanEnd::Beyond),
        };
        Self { oblique, weak_laser, fan_end, one_colour, touching, polished_floor, second_bounce }
    }
}

/// Draws a scene for a plan. Sizes, stands and poses are drawn until they fit each other; a draw nearly always does.
pub fn compose(rng: &mut Rng, head: &Head, plan: Plan, stock: &Stock) -> Scene {
    if plan == Plan::Refused(Refuse::NoBox) {
        return empty(rng, head, stock);
    }
    loop {
        if let Some(scene) = attempt(&mut rng.child(), head, plan, stock) {
            return scene;
        }
    }
}

fn attempt(rng: &mut Rng, head: &Head, plan: Plan, stock: &Stock) -> Option<Scene> {
    let drawn = SceneHazards::new(&mut rng.child(), plan, &stock.hazards);
    // A face whose stripe the laser cuts short, or of which something hides a part, stands where it could be measured.
    let spoilt_later = drawn.fan_end == Some(FanEnd::OnFace) || plan == Plan::Refused(Refuse::Hidden);
    let placing = if spoilt_later { Plan::Face } else { plan };
    let mut hazards = BTreeSet::new();
    let mut size = box_size(rng);
    let faces = pick_faces(rng, plan);
    if let (Plan::Twins, [first, second]) = (plan, faces.as_slice()) {
        // As deep behind one face as behind the other.
        size[second / 2] = size[first / 2];
    }
    let half = size / 2.0;
    let mut stand = stand::stand(rng, &size, stock, stock.hazards.has(Hazard::FlushNeighbour));
    let centre = Vector3::new(0.0, 0.0, stand.top_mm + half.z);
    let mut views = Vec::new();
    for &face in &faces {
        let (mut slanted, mut usual) = (rng.child(), rng.child());
        let look =
            |rng: &mut Rng, oblique| view(rng, head, placing, face, centre, &half, &stand.bodies, oblique);
        let found = if drawn.oblique { look(&mut slanted, true) } else { None };
        if found.is_some() {
            hazards.insert(Hazard::Oblique);
        }
        views.push(match found {
            Some(view) => view,
            None => look(&mut usual, false)?,
        });
    }
    let mut dressed = carton(rng, &half, stock);
    let mut plain_rng = rng.child();
    let plain = drawn.one_colour.then(|| Plain::pick(&mut plain_rng, stock));
    if let Some(plain) = &plain {
        hazards.insert(Hazard::OneColour);
        dressed = plain.dress(&mut plain_rng, dressed);
        for body in stand.bodies.iter_mut().filter(|b| b.role == Role::Carton) {
            body.look = plain.look(&mut plain_rng);
        }
    }
    let target = Body {
        centre,
        rotation: nalgebra::Matrix3::identity(),
        half,
        shape: Shape {
            radius_mm: rng.log_range(0.5, 4.0).min(0.02 * half.min()) + dressed.shape.radius_mm,
            bulge_mm: bulges(rng, &half),
            ..dressed.shape
        },
        look: dressed.look,
        role: Role::Target,
    };
    let distances = views.iter().map(|v| (v.camera_mm - centre).norm());
    let light = lighting(rng, centre, distances.fold(f64::INFINITY, f64::min));
    let outdoors = light.ambient == "sun";
    let reach =
        stand.bodies.iter().fold(half.xy().norm(), |r, b| r.max((b.centre.xy() + b.half.xy()).norm()));
    let mut words = TruthWords { base: dressed.base, stand: stand.word, neighbours: Vec::new() };
    let below = stand.bodies.last().filter(|b| b.role == Role::Carton);
    let flush = |b: &&Body| faces.iter().any(|f| *f != 4 && step_mm(&target, b, *f).abs() <= 3.0);
    if below.filter(flush).is_some() {
        hazards.insert(Hazard::FlushNeighbour);
        words.neighbours.push("below");
    }
    let free = |b: &Body| views.iter().all(|v| !in_the_way(head, v, &target.face(v.face, v), b));
    let against = neighbours::Target { size, base_mm: stand.top_mm, faces: &faces };
    let found = neighbours(&mut rng.child(), &against, &drawn.touching, free, |rng, half| match &plain {
        Some(plain) => (plain.look(rng), Shape::default()),
        None => {
            let Carton { look, shape, .. } = carton(rng, half, stock);
            (look, shape)
        }
    });
    let mut own = rng.child();
    let flap = if dressed.hazards.remove(&Hazard::OpenFlap) {
        let near = || found.iter().map(|n| &n.body).chain(&stand.bodies);
        // One that leans over a face which is looked at hides a side of it: such faces are among the hidden ones.
        let hides = |flap: &Body| {
            let by = |v: &View| Hidden::by(std::slice::from_ref(flap), v, &target.face(v.face, v), head);
            views.iter().any(|v| by(v).matters())
        };
        let fits = |flap: &Body| free(flap) && !hides(flap) && !near().any(|b| flap.touches(b));
        flap::open_flap(&mut own, &target, dressed.flap_axis, &faces, fits)
    } else {
        None
    };
    hazards.extend(dressed.hazards);
    let mut bodies = vec![target];
    bodies.extend(stand.bodies);
    if let Some(flap) = flap {
        hazards.insert(Hazard::OpenFlap);
        bodies.push(flap);
    }
    for neighbour in found {
        hazards.insert(neighbour.hazard);
        words.neighbours.push(neighbour.word);
        bodies.push(neighbour.body);
    }
    let fixed = bodies.len();
    let shell = room::shell(rng, outdoors, &faces, half.y + 700.0, stock);
    bodies.extend(shell);
    bodies.extend(room::clutter(rng, reach, outdoors, stock));
    let mut scene = Scene {
        bodies,
        target: Some(0),
        light,
        views,
        beams: head.beams,
        refuse: None,
        hidden: None,
        words,
        hazards,
    };
    if let Plan::Refused(reason) = plan {
        scene.refuse = Some(reason);
    }
    beams(&mut rng.child(), &mut scene, head, &drawn)?;
    clear_sight(&mut scene, head, fixed);
    if plan == Plan::Refused(Refuse::Hidden) {
        hide(&mut rng.child(), &mut scene, head, stock)?;
    }
    detours(&mut rng.child(), &mut scene, head, &drawn);
    expose(rng, &mut scene);
    Some(scene)
}

/// Puts something before the face of the only view.
fn hide(rng: &mut Rng, scene: &mut Scene, head: &Head, stock: &Stock) -> Option<()> {
    let (target, view) = (&scene.bodies[scene.target?], scene.views.first()?);
    let (bodies, hidden) = occluder(rng, target, view, head, stock)?;
    scene.bodies.extend(bodies);
    scene.hidden = Some(hidden);
    Some(())
}

/// Light that comes by way of other surfaces, where it would be seen.
fn detours(rng: &mut Rng, scene: &mut Scene, head: &Head, drawn: &SceneHazards) {
    let ground = floor(&scene.bodies).filter(|_| drawn.polished_floor && scene.light.ambient != "sun");
    if let Some(ground) = ground
        && scene.views.iter().any(|v| mirrored_in_view(scene, v, head, ground))
    {
        scene.bodies[ground].look.mirror = rng.range_f32(0.05, 0.12);
        scene.hazards.insert(Hazard::MirrorFloor);
    }
    if drawn.second_bounce {
        let found: Vec<_> = scene.views.iter().map(|v| bounce(rng, scene, v, head)).collect();
        for (view, bounce) in scene.views.iter_mut().zip(found) {
            view.bounce = bounce;
            if bounce.is_some() {
                scene.hazards.insert(Hazard::SecondBounce);
            }
        }
    }
}

/// What ails the beams; `None` if a fan that must end on the face cannot.
fn beams(rng: &mut Rng, scene: &mut Scene, head: &Head, drawn: &SceneHazards) -> Option<()> {
    if scene.refuse == Some(Refuse::LaserDead) {
        scene.beams[rng.below(4)].power = 0.0;
    } else if drawn.weak_laser {
        weaken(rng, &mut scene.beams);
        scene.hazards.insert(Hazard::WeakLaser);
    }
    if let Some(wanted) = drawn.fan_end {
        let target = &scene.bodies[scene.target?];
        let poses: Vec<FacePose> = scene.views.iter().map(|v| target.face(v.face, v)).collect();
        match end_fan(rng, head, &scene.beams, &poses, wanted) {
            Some(beams) => {
                scene.beams = beams;
                scene.hazards.insert(Hazard::FanEnd);
            }
            None if wanted == FanEnd::OnFace => return None,
            None => {}
        }
    }
    Some(())
}

fn box_size(rng: &mut Rng) -> Vector3<f64> {
    let longest = rng.log_range(105.0, 1800.0);
    let middle = (longest * rng.range(0.45, 1.0)).max(100.0);
    let shortest = (middle * rng.range(0.35, 1.0)).max(100.0);
    // To a tenth of a millimetre, as the truth file gives it.
    let round = |x: f64| (x * 10.0).round() / 10.0;
    let (a, b, c) = (round(longest), round(middle), round(shortest));
    let orders = [(a, b, c), (b, a, c), (a, c, b), (c, a, b), (b, c, a), (c, b, a)];
    // Boxes mostly lie: the shortest side is up more often than the longest.
    let lying = if rng.chance(0.55) { rng.below(2) } else { rng.below(6) };
    let (x, y, z) = orders[lying];
    Vector3::new(x, y, z)
}

fn pick_faces(rng: &mut Rng, plan: Plan) -> Vec<usize> {
    if plan == Plan::Three {
        let side = rng.pick([0, 1]);
        return rng.pick([[3, side, 4], [side, 3, 4], [3, 4, side], [4, side, 3]]).to_vec();
    }
    let mut pair = rng.pick([[3, 0], [3, 1], [3, 4], [0, 4], [1, 4], [3, 4]]);
    if rng.chance(0.5) {
        pair.swap(0, 1);
    }
    if matches!(plan, Plan::Box | Plan::Twins) { pair.to_vec() } else { vec![pair[0]] }
}

fn bulges(rng: &mut Rng, half: &Vector3<f64>) -> [f32; FACES] {
    if !rng.chance(0.3) {
        return [0.0; FACES];
    }
    let most = 0.004 * half.max();
    [0; FACES].map(|_| (rng.normal() * most).clamp(-2.5 * most, 2.5 * most) as f32)
}

#[allow(clippy::too_many_arguments)] // a draw on one side, what it must fit on the other
fn view(
    rng: &mut Rng,
    head: &Head,
    plan: Plan,
    face: usize,
    centre: Vector3<f64>,
    half: &Vector3<f64>,
    stand: &[Body],
    oblique: bool,
) -> Option<View> {
    let size = face_half(half, face).map(|h| 2.0 * h);
    // Slanted poses seldom fit; each that does not costs a millisecond.
    for _ in 0..if oblique { 5 } else { 14 } {
        let cam_from_face = if oblique {
            let tilt_deg = rng.range(*OBLIQUE_DEG.start(), *OBLIQUE_DEG.end());
            tilted_orientation(rng, face != 4, tilt_deg)
        } else {
            random_orientation(rng, face != 4, if plan == Plan::Twins { 50.0 } else { 40.0 })
        };
        if plan == Plan::Twins && cam_from_face[(2, 2)] > f64::to_radians(20.0).cos() {
            continue; // looks too straight at the face to see others
        }
        let pose = match plan {
            Plan::Refused(reason) => place_unmeasurable(rng, head, size, cam_from_face, reason),
            _ => place_face(rng, head, size, cam_from_face),
        };
        let Some(pose) = pose else { continue };
        if oblique && !OBLIQUE_DEG.contains(&pose.angle_to_normal_rad().to_degrees()) {
            continue;
        }
        let view = View::of_face(&pose, face, centre, half);
        if stands_free(head, &view, &pose, stand) {
            return Some(view);
        }
    }
    None
}

/// Whether the head hangs free above the floor and sees the face past the stand.
pub(super) fn stands_free(head: &Head, view: &View, pose: &FacePose, stand: &[Body]) -> bool {
    let z = view.camera_mm.z;
    if !(HEAD_HEIGHT_MM.0..=HEAD_HEIGHT_MM.1).contains(&z) {
        return false;
    }
    !stand.iter().any(|b| in_the_way(head, view, pose, b))
}

/// Whether a body hides part of the face from the camera or from a laser, or is where the head is.
fn in_the_way(head: &Head, view: &View, pose: &FacePose, body: &Body) -> bool {
    let mut eyes = vec![view.camera_mm];
    eyes.extend(head.beams.iter().map(|b| view.world(b.source_mm)));
    if eyes.iter().any(|e| body.distance_mm(*e) < 40.0) {
        return true;
    }
    let n = 8;
    for i in 0..=n {
        for j in 0..=n {
            let share = |k: i32| (f64::from(k) / f64::from(n) - 0.5) * 1.99;
            // A little in front of the face: what it stands on touches it.
            let point = pose.point(share(i) * pose.half[0], share(j) * pose.half[1])
                - pose.cam_from_face.column(2) * (0.004 * pose.centre.norm());
            if eyes.iter().any(|e| body.blocks(*e, view.world(point))) {
                return true;
            }
        }
    }
    false
}

/// Takes away whatever hides a face that is looked at; the first `fixed` bodies stay.
pub(super) fn clear_sight(scene: &mut Scene, head: &Head, fixed: usize) {
    let Some(target) = scene.target.and_then(|t| scene.bodies.get(t)).cloned() else { return };
    let views = &scene.views;
    let hides = |b: &Body| views.iter().any(|v| in_the_way(head, v, &target.face(v.face, v), b));
    // What lies about does not touch the target or what stands against it.
    let cartons: Vec<Body> = scene.bodies[..fixed]
        .iter()
        .filter(|b| matches!(b.role, Role::Target | Role::Carton))
        .cloned()
        .collect();
    let overlaps = |b: &Body| b.role == Role::Carton && cartons.iter().any(|c| c.apart_mm(b) < 5.0);
    let mut index = 0;
    scene.bodies.retain(|b| {
        index += 1;
        index <= fixed || !(hides(b) || overlaps(b))
    });
}

/// Sets each view's exposure from the light on the face it shows, half way as an automatic would.
pub(super) fn expose(rng: &mut Rng, scene: &mut Scene) {
    let Some(target) = scene.target.and_then(|t| scene.bodies.get(t)) else { return };
    for view in &mut scene.views {
        let normal = -axes(view.face).column(2);
        let light = scene.light.free_irradiance(target.centre + normal * 100.0, normal).max(0.15);
        view.exposure = rng.range(0.75, 1.1) / light.powf(0.9);
    }
}

/// A scene without a target: the head looks at the floor, a wall or distant clutter.
pub fn empty(rng: &mut Rng, head: &Head, stock: &Stock) -> Scene {
    let light = lighting(rng, Vector3::new(0.0, 0.0, 500.0), 1000.0);
    let outdoors = light.ambient == "sun";
    let mut bodies = room::shell(rng, outdoors, &[], 800.0, stock);
    bodies.extend(room::clutter(rng, 2200.0, outdoors, stock));
    let camera_mm =
        Vector3::new(rng.range(-300.0, 300.0), rng.range(-1200.0, -200.0), rng.range(500.0, 1700.0));
    let roll = rng.sign() * rng.range(35.0, 55.0);
    let (yaw, pitch) = (rng.range(-0.6, 0.6), rng.range(-1.4, 0.1));
    let forward = Vector3::new(yaw.sin() * pitch.cos(), yaw.cos() * pitch.cos(), pitch.sin());
    let right = forward.cross(&Vector3::z()).normalize();
    let upright = nalgebra::Matrix3::from_columns(&[right, forward.cross(&right), forward]);
    let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), roll.to_radians());
    let cam_from_world = turn.into_inner() * upright.transpose();
    let exposure = rng.range(0.7, 1.1) / light.free_irradiance(Vector3::zeros(), Vector3::z()).max(0.2);
    bodies.retain(|b| b.distance_mm(camera_mm) > 150.0);
    let view = View { cam_from_world, camera_mm, face: 0, exposure, bounce: None };
    Scene {
        bodies,
        target: None,
        light,
        views: vec![view],
        beams: head.beams,
        refuse: Some(Refuse::NoBox),
        hidden: None,
        words: TruthWords { base: "none", stand: "none", neighbours: Vec::new() },
        hazards: BTreeSet::new(),
    }
}
