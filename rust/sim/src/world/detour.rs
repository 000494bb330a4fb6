//! Laser light that comes by way of another surface: a polished floor in which stripes are mirrored, and a bright surface that
//! sends a sheet on to the face as a faint, wide second stripe. Here is found where this would be seen; the light itself is
//! computed in [`crate::render`].

use super::{Body, Role, Scene, View};
use crate::head::Head;
use crate::rng::Rng;
use crate::solid::face_normal;
use nalgebra::Vector3;

/// A sheet of light that a surface sends on: the head's beams, mirrored in a face of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounce {
    /// Index of the body.
    pub body: usize,
    /// Its face.
    pub face: usize,
    /// Peak irradiance as a share of the direct light's at that distance.
    pub strength: f64,
    /// How much thicker the sheet is than the direct one.
    pub spread: f64,
}

/// Darker surfaces send on too little to be seen.
const BRIGHT: f32 = 0.2;
/// Directions of each fan that are tried.
const RAYS: i32 = 48;
/// A second stripe on the face at this many of them is one.
const ENOUGH: usize = 3;

/// The nearest body that a ray meets: its index, the face, the distance, mm. `way` is a unit vector.
fn cast(bodies: &[Body], from: Vector3<f64>, way: Vector3<f64>) -> Option<(usize, usize, f64)> {
    let mut best: Option<(usize, usize, f64)> = None;
    for (i, body) in bodies.iter().enumerate() {
        let o = body.rotation.transpose() * (from - body.centre);
        let d = body.rotation.transpose() * way;
        let (mut near, mut far, mut face) = (1e-3f64, best.map_or(f64::INFINITY, |b| b.2), None);
        for axis in 0..3 {
            let inverse = 1.0 / if d[axis].abs() < 1e-12 { 1e-12 } else { d[axis] };
            let (a, b) = ((-body.half[axis] - o[axis]) * inverse, (body.half[axis] - o[axis]) * inverse);
            if a.min(b) > near {
                near = a.min(b);
                face = Some(2 * axis + usize::from(d[axis] > 0.0));
            }
            far = far.min(a.max(b));
        }
        if let (Some(face), true) = (face, near < far) {
            best = Some((i, face, near));
        }
    }
    best
}

/// A surface by way of which a sheet reaches the face of a view; `None` if there is none.
pub(super) fn bounce(rng: &mut Rng, scene: &Scene, view: &View, head: &Head) -> Option<Bounce> {
    let target = scene.target?;
    let from_cam = view.cam_from_world.transpose();
    let mut met: Vec<(usize, usize, usize)> = Vec::new();
    for (beam, index) in scene.beams.iter().zip(0..).filter(|(b, _)| b.power > 0.0) {
        let side = head.plane(index).normalize().cross(&beam.forward);
        let source = view.world(beam.source_mm);
        for i in -RAYS / 2..=RAYS / 2 {
            let angle = f64::from(2 * i) / f64::from(RAYS) * beam.fan_half_rad;
            let way = from_cam * (beam.forward * angle.cos() + side * angle.sin());
            let Some((body, face, distance)) = cast(&scene.bodies, source, way) else { continue };
            let at = source + way * distance;
            let surface = &scene.bodies[body];
            if body == target || surface.look.surface.base.x < BRIGHT {
                continue;
            }
            let normal = surface.rotation * face_normal(face);
            let on = way - normal * (2.0 * normal.dot(&way));
            if !matches!(cast(&scene.bodies, at, on), Some((b, f, _)) if b == target && f == view.face) {
                continue;
            }
            match met.iter_mut().find(|m| (m.0, m.1) == (body, face)) {
                Some(m) => m.2 += 1,
                None => met.push((body, face, 1)),
            }
        }
    }
    let (strength, spread) = (rng.log_range(0.02, 0.1), rng.range(3.0, 8.0));
    let (body, face, count) = met.into_iter().max_by_key(|m| m.2)?;
    (count >= ENOUGH).then_some(Bounce { body, face, strength, spread })
}

/// Index of the floor.
pub(super) fn floor(bodies: &[Body]) -> Option<usize> {
    bodies.iter().position(|b| b.role == Role::Room && (b.centre.z + b.half.z).abs() < 1e-6)
}

/// Whether a view shows the mirror image of a stripe of its face in a polished floor.
pub(super) fn mirrored_in_view(scene: &Scene, view: &View, head: &Head, floor: usize) -> bool {
    let Some(target) = scene.target.map(|t| &scene.bodies[t]) else { return false };
    let pose = target.face(view.face, view);
    let clear = |from: Vector3<f64>, to: Vector3<f64>| {
        !scene.bodies.iter().enumerate().any(|(i, b)| i != floor && b.blocks(from, to))
    };
    (0..4).filter_map(|laser| pose.crossing(head, laser, 0.0)).any(|crossing| {
        let [a, b] = crossing.at;
        (1..8).any(|i| {
            let t = f64::from(i) / 8.0;
            let lit = view.world(pose.point(a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t));
            let image = Vector3::new(lit.x, lit.y, -lit.z);
            let way = image - view.camera_mm;
            // Where the line of sight to the image meets the floor.
            let at = view.camera_mm - way * (view.camera_mm.z / way.z);
            // A little before the face, which would be in its own way.
            let lit = lit + (at - lit) * 1e-3;
            let seen = crate::pose::px_of(head, &view.point(at));
            seen.is_some_and(|px| crate::pose::inside(px, 0.0)) && clear(view.camera_mm, at) && clear(at, lit)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Raster;
    use crate::hazard::{Hazard, Hazards};
    use crate::head::SENSOR_PX;
    use crate::render::{Film, Options, Stage, expose_film};
    use crate::stock::Stock;
    use crate::world::{Plan, compose};

    /// The first scene with a hazard, and its small frames: with it and without it, lasers on, then off.
    fn frames(hazard: Hazard) -> (Scene, [[Film; 2]; 2]) {
        let stock = Stock { hazards: Hazards::only(&[hazard]), ..Stock::default() };
        let (head, scene) = (0..400)
            .find_map(|seed| {
                let head = Head::random(&mut Rng::new(seed, 1)).unwrap();
                let scene = compose(&mut Rng::new(seed, 2), &head, Plan::Face, &stock);
                scene.hazards.contains(&hazard).then_some((head, scene))
            })
            .unwrap();
        let raster = Raster::covering(SENSOR_PX, 512, 384);
        let mut plain = scene.clone();
        plain.views[0].bounce = None;
        for body in &mut plain.bodies {
            body.look.mirror = 0.0;
        }
        let film = |scene: &Scene, lasers: bool| {
            let options = Options { lasers, speckle: false, seed: 0 };
            expose_film(&Stage::new(scene, &scene.views[0], &head, raster, &stock.photos, options))
        };
        let films = [&scene, &plain].map(|s| [film(s, true), film(s, false)]);
        (scene, films)
    }

    #[test]
    fn a_polished_floor_mirrors_what_stands_on_it_and_its_stripes() {
        let (scene, [[on, off], [plain_on, plain_off]]) = frames(Hazard::MirrorFloor);
        let floor = floor(&scene.bodies).unwrap();
        assert!(scene.bodies.iter().enumerate().all(|(i, b)| (b.look.mirror > 0.0) == (i == floor)));
        // Traces tell the pixels of stripes; the floor's are the same in both but for the images.
        let images: Vec<usize> = {
            let direct: Vec<u32> = plain_on.traces.iter().map(|t| t.pixel).collect();
            on.traces.iter().filter(|t| !direct.contains(&t.pixel)).map(|t| t.pixel as usize).collect()
        };
        assert!(images.len() > 10, "{} px of mirrored stripes", images.len());
        let red = |a: &Film, b: &Film, i: usize| a.light[i].x - b.light[i].x;
        let bright = images.iter().filter(|i| red(&on, &off, **i) > red(&plain_on, &plain_off, **i) + 0.01);
        assert!(2 * bright.count() > images.len());
        let changed = (0..off.light.len()).filter(|i| red(&off, &plain_off, *i).abs() > 1e-3).count();
        assert!(changed > images.len(), "the floor mirrors other things too: {changed} px");
        // The target does not stand behind the floor: nothing of it has changed.
        let ids = |f: &Film| f.ids.clone();
        assert_eq!(ids(&on), ids(&plain_on));
        let face = face_pixels(&scene, &on);
        assert!(face.len() > 500 && face.iter().all(|i| red(&on, &plain_on, *i) == 0.0));
    }

    /// Pixels well inside of the target's face in view.
    fn face_pixels(scene: &Scene, film: &Film) -> Vec<usize> {
        let mut count = std::collections::BTreeMap::new();
        for trace in &film.traces {
            *count.entry(film.ids[trace.pixel as usize]).or_insert(0) += 1;
        }
        assert_eq!(scene.target, Some(0));
        let (id, _) = count.into_iter().max_by_key(|c| c.1).unwrap();
        let inside = |i: &usize| {
            let w = film.width;
            *i > w
                && i + w + 1 < film.ids.len()
                && [1, w].iter().all(|d| film.ids[i - d] == id && film.ids[i + d] == id)
        };
        (0..film.ids.len()).filter(|i| film.ids[*i] == id).filter(inside).collect()
    }

    #[test]
    fn a_second_bounce_is_a_faint_red_light_on_the_face() {
        let (scene, [[with, _], [without, _]]) = frames(Hazard::SecondBounce);
        let bounce = scene.views[0].bounce.unwrap();
        assert!((0.02..=0.1).contains(&bounce.strength) && bounce.body != 0);
        let direct = without.traces.iter().map(|t| t.red).fold(0.0, f32::max);
        let mut lit = 0;
        for (a, b) in with.light.iter().zip(&without.light) {
            let more = *a - *b;
            assert!(more.x >= -1e-5 && more.x <= 0.5 * direct && more.y <= 0.1 * more.x + 1e-5);
            lit += usize::from(more.x > 1e-3);
        }
        assert!(lit > 10, "{lit} px");
        assert_eq!(with.traces.len(), without.traces.len(), "it is nothing to be found");
    }
}
