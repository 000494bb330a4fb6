//! Where each stripe ends on the target's face and what its light meets beyond: the truth for whatever looks at stripes' ends.
//!
//! Everything is cast: rays of the laser from its source to the first surface, then rays of the camera, whether that place is
//! seen. Distances are measured in the section across the side: outwards along the face's plane, and up from it to the head.

use crate::head::{Head, SENSOR_PX};
use crate::photos::Photos;
use crate::pose::{FacePose, inside, px_of};
use crate::raster::Raster;
use crate::render::{Options, Stage};
use crate::solid::{Hit, Solid};
use crate::vec3::V3;
use crate::world::{Scene, View};
use boxline::Px;
use nalgebra::Vector3;

/// What lies beyond a stripe's end, as the picture shows it.
/// Tried in this order: border, occluded, dark, flush, convex and concave, nearer, farther. "Seen" means lit by the laser first of all
/// surfaces, first of all before the camera, bright enough, and a piece of at least 3 px.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EndClass {
    /// The next surface seen meets the plane at the side, within 5 mm, at a slope, and leaves the line by 3 px away from the head: the next
    /// face of the box.
    Convex,
    /// The next surface seen begins 3 mm up at most, or lower, or there is none.
    Farther,
    /// The next surface seen begins more than 3 mm up.
    Nearer,
    /// A surface within 3 mm of the plane begins within 5 mm of the side and stays so for 10 mm: a flush neighbour.
    Flush,
    /// As [`Self::Convex`], but towards the head: floor, wall, a neighbour that stands out.
    Concave,
    /// The laser is dead, its fan ends before, or the stripe's middle stands out by less than 1.5 sigmas of one pixel's noise (sensor or
    /// encoding, whichever is more).
    Dark,
    /// The end, or the place 6 px beyond it, is outside the picture.
    Border,
    /// Something hides the end, or the face just inside it, from the camera or the laser.
    Occluded,
}

impl EndClass {
    /// The word in the truth file.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Convex => "convex",
            Self::Farther => "farther",
            Self::Nearer => "nearer",
            Self::Flush => "flush",
            Self::Concave => "concave",
            Self::Dark => "dark",
            Self::Border => "border",
            Self::Occluded => "occluded",
        }
    }
}

/// One end of a stripe on the face.
#[derive(Clone, Copy, Debug)]
pub struct StripeEnd {
    /// 0 to 3.
    pub laser: usize,
    /// 0 or 1: in the order of the key points.
    pub end: usize,
    /// The side that it lies on: side k joins corners k and k + 1.
    pub side: usize,
    /// What lies beyond.
    pub class: EndClass,
    /// Where the laser's plane meets the sharp edge, camera frame, mm.
    pub at_mm: Vector3<f64>,
    /// How high above the face's plane the next surface begins on which the stripe is seen, mm; `None` if there is none.
    pub beyond_mm: Option<f64>,
    /// The stripe is seen 6 to 18 px beyond the end, and nowhere there more than 2 px off its line in the face's plane.
    pub light_beyond: bool,
}

/// A surface within this of the face's plane is flush with it, mm.
pub(crate) const FLUSH_MM: f64 = 3.0;
/// A gap up to this does not part two surfaces, mm.
pub(crate) const GAP_MM: f64 = 5.0;
/// How far a surface must be followed before it is called flush, mm.
const FLUSH_RUN_MM: f64 = 10.0;
/// A surface that bends must begin this near to the side, mm.
const BEND_NEAR_MM: f64 = 50.0;
/// Its slope against the face's plane.
const BEND_SLOPE: f64 = 0.25;
/// Pieces shorter than this, and bends that leave the line by less, are not seen.
const SEEN_PX: f64 = 3.0;
/// Where light on the plane beyond the end is looked for.
const BEYOND_PX: [f64; 2] = [6.0, 18.0];
/// How far from the stripe's line it may be there.
const LINE_PX: f64 = 2.0;
/// A stripe whose middle stands out by less than this many sigmas of one pixel is dark.
const DARK_SIGMAS: f32 = 1.5;
/// How far inside the edge the end is looked at, beyond the rounding: edges are not straight to some mm.
const INSIDE_MM: f64 = 6.0;
/// What hides the end itself is this far before it: neighbours whose edges wave stand a little over the side, mm.
const BEFORE_MM: f64 = 8.0;
/// Light is followed this far beyond the side, mm.
const REACH_MM: f64 = 3000.0;

/// Straight rays from one place: the scene as a laser, or the camera, finds it.
struct Light {
    source: Vector3<f64>,
    solids: Vec<Solid>,
}

impl Light {
    fn new(scene: &Scene, view: &View, source: Vector3<f64>) -> Self {
        // A solid is cast from the origin of its frame: here the source takes the camera's place.
        let there = View { camera_mm: view.world(source), ..*view };
        Self { source, solids: scene.bodies.iter().map(|b| b.solid(&there)).collect() }
    }

    /// Whether a body other than `own` is in the way to a point by [`BEFORE_MM`] or more.
    fn blocked(&self, own: usize, to: Vector3<f64>) -> bool {
        let way = to - self.source;
        let (ray, limit) = (V3::from(way), (1.0 - BEFORE_MM / way.norm()) as f32);
        self.solids.iter().enumerate().any(|(body, solid)| body != own && solid.hit(ray, limit).is_some())
    }

    /// The first surface on the ray through a point: body, face, place.
    fn cast(&self, through: Vector3<f64>) -> Option<(usize, usize, Vector3<f64>)> {
        let way = through - self.source;
        let (ray, mut limit, mut met) = (V3::from(way), f32::INFINITY, None);
        for (body, solid) in self.solids.iter().enumerate() {
            if let Some(hit) = solid.hit(ray, limit) {
                limit = hit.depth;
                met = Some((body, hit.face));
            }
        }
        met.map(|(body, face)| (body, face, self.source + way * f64::from(limit)))
    }
}

/// A place on a surface as the camera sees it.
struct VisiblePoint {
    px: Px,
    ray: V3,
    solid: usize,
    hit: Hit,
}

/// The scene before the camera.
struct SceneView<'a> {
    head: &'a Head,
    stage: Stage<'a>,
    /// The same as light from the camera would find it.
    sight: Light,
}

impl SceneView<'_> {
    /// A point on a body, if it is in the picture and nothing is before it.
    fn sees(&self, body: usize, at: Vector3<f64>) -> Option<VisiblePoint> {
        let px = px_of(self.head, &at).filter(|px| at.z > 1.0 && inside(*px, 0.0))?;
        let raster = &self.stage.raster;
        let [column, row] = raster.from_px(px).map(|x| x.round().max(0.0) as usize);
        let ray = V3::from(at / at.z);
        let (solid, hit) = self.stage.cast(ray, column.min(raster.width - 1), row.min(raster.height - 1))?;
        // Small roundings are left out in the stage: some mm of slack.
        let near = (f64::from(hit.depth) - at.z).abs() < 1.0 + 0.003 * at.z;
        (self.stage.body[solid] == body && near).then_some(VisiblePoint { px, ray, solid, hit })
    }

    fn stands_out(&self, laser: usize, seen: &VisiblePoint) -> bool {
        self.stage.contrast(laser, seen.solid, &seen.hit, seen.ray) >= DARK_SIGMAS
    }
}

/// The section across a side at a stripe's end, and the stripe's line in the picture.
struct Section {
    at: Vector3<f64>,
    /// Along the stripe, outwards.
    along: Vector3<f64>,
    /// Across the side, outwards.
    out: Vector3<f64>,
    /// Off the face, towards the head.
    up: Vector3<f64>,
    px: Px,
    along_px: [f64; 2],
}

impl Section {
    /// Pixels along and across the stripe's line.
    fn in_line(&self, px: Px) -> [f64; 2] {
        let (u, v) = (px.u - self.px.u, px.v - self.px.v);
        let [a, b] = self.along_px;
        [u * a + v * b, v * a - u * b]
    }

    /// The point of the face's plane on the stripe this far across the side.
    fn on_plane(&self, out_mm: f64) -> Vector3<f64> {
        self.at + self.along * (out_mm / self.along.dot(&self.out))
    }
}

/// A place beyond the side where the stripe is seen.
struct Sample {
    out_mm: f64,
    up_mm: f64,
    along_px: f64,
    off_px: f64,
    seen: VisiblePoint,
}

/// Neighbouring samples on one face of one body.
struct Piece {
    body: usize,
    face: usize,
    samples: Vec<Sample>,
}

impl Piece {
    fn first(&self) -> &Sample {
        &self.samples[0]
    }

    fn last(&self) -> &Sample {
        &self.samples[self.samples.len() - 1]
    }

    /// In the face's plane, beginning next to the side.
    fn is_flush(&self) -> bool {
        let (first, last) = (self.first(), self.last());
        let until = first.out_mm + FLUSH_RUN_MM;
        first.out_mm <= GAP_MM
            && last.out_mm >= until
            && self.samples.iter().take_while(|s| s.out_mm <= until).all(|s| s.up_mm.abs() <= FLUSH_MM)
    }

    /// At a slope to the face's plane, which it meets at the side.
    fn bends(&self) -> bool {
        let (a, b) = (self.first(), self.last());
        let (out, up) = (b.out_mm - a.out_mm, b.up_mm - a.up_mm);
        let past_side = (a.out_mm * up - a.up_mm * out).abs() / out.hypot(up).max(1e-9);
        up.abs() > BEND_SLOPE * out.abs() && past_side <= GAP_MM && a.out_mm.hypot(a.up_mm) <= BEND_NEAR_MM
    }

    fn length_px(&self) -> f64 {
        let (a, b) = (self.first().seen.px, self.last().seen.px);
        (a.u - b.u).hypot(a.v - b.v)
    }

    /// Where its brightness is judged: some pixels from its beginning.
    fn probe(&self) -> &VisiblePoint {
        let start = self.first().seen.px;
        let far = |s: &&Sample| (s.seen.px.u - start.u).hypot(s.seen.px.v - start.v) > 4.0;
        &self.samples.iter().find(far).unwrap_or_else(|| self.last()).seen
    }
}

/// The two ends of a stripe on the face, mm right and down, each with its side; `None` if the laser's plane passes the face.
#[must_use]
pub fn stripe_on_face(head: &Head, face: &FacePose, laser: usize) -> Option<[([f64; 2], usize); 2]> {
    let p = head.plane(laser);
    let normal = [p.dot(&face.cam_from_face.column(0)), p.dot(&face.cam_from_face.column(1))];
    let offset = 1.0 - p.dot(&face.centre);
    let square = normal[0] * normal[0] + normal[1] * normal[1];
    let base = normal.map(|n| n * offset / square);
    let mut way = [-normal[1], normal[0]].map(|d| d / square.sqrt());
    // Clipped by the two pairs of sides, as a ray by a slab.
    let mut ends = [(f64::NEG_INFINITY, 0), (f64::INFINITY, 0)];
    for axis in 0..2 {
        let limits = [-face.half[axis], face.half[axis]].map(|h| (h - base[axis]) / way[axis]);
        let [enter, leave] = [limits[0].min(limits[1]), limits[0].max(limits[1])];
        if enter > ends[0].0 {
            ends[0] = (enter, axis);
        }
        if leave < ends[1].0 {
            ends[1] = (leave, axis);
        }
    }
    // In the order of the key points: from left to right, or downwards if it crosses the upper and the lower side.
    let downwards = ends[0].1 == 1 && ends[1].1 == 1;
    if way[usize::from(downwards)] < 0.0 {
        ends = [(-ends[1].0, ends[1].1), (-ends[0].0, ends[0].1)];
        way = way.map(|d| -d);
    }
    (ends[0].0 < ends[1].0).then(|| {
        [0, 1].map(|end| {
            let (t, axis) = ends[end];
            let beyond = (way[axis] > 0.0) == (end == 1);
            let mut at = [base[0] + way[0] * t, base[1] + way[1] * t];
            at[axis] = if beyond { face.half[axis] } else { -face.half[axis] };
            (at, side_of(face, axis, beyond))
        })
    })
}

/// The number of a side: at the low or high end of the face's right (0) or down (1) axis.
pub(crate) fn side_of(face: &FacePose, axis: usize, high: bool) -> usize {
    let round = match (axis, high) {
        (1, false) => 0,
        (0, true) => 1,
        (1, true) => 2,
        _ => 3,
    };
    // Corner 0 is where a length edge begins.
    if face.half[0] >= face.half[1] { round } else { (round + 3) % 4 }
}

/// Out of a side, across it along the face's plane.
pub(crate) fn outward(face: &FacePose, side: usize) -> Vector3<f64> {
    let corners = face.corners();
    ((corners[side] + corners[(side + 1) % 4]) / 2.0 - face.centre).normalize()
}

/// All ends of stripes on a face of the target that is looked at. Empty without a target.
#[must_use]
pub fn stripe_ends(head: &Head, scene: &Scene, view: &View, photos: &Photos) -> Vec<StripeEnd> {
    let Some(target) = scene.target else { return Vec::new() };
    let face = scene.bodies[target].face(view.face, view);
    // A quarter of the sensor's resolution: what it is needed for is brightness next to a stripe.
    let raster = Raster::covering(SENSOR_PX, SENSOR_PX[0] as usize / 4, SENSOR_PX[1] as usize / 4);
    let stage = Stage::new(scene, view, head, raster, photos, Options::default());
    let eye = SceneView { head, stage, sight: Light::new(scene, view, Vector3::zeros()) };
    let mut found = Vec::new();
    for laser in 0..4 {
        let Some(ends) = stripe_on_face(head, &face, laser) else { continue };
        let light = Light::new(scene, view, head.beams[laser].source_mm);
        let points = ends.map(|([right, down], _)| face.point(right, down));
        for end in 0..2 {
            let (at_mm, side) = (points[end], ends[end].1);
            let along = (at_mm - points[1 - end]).normalize();
            let mut result = StripeEnd {
                laser,
                end,
                side,
                class: EndClass::Border,
                at_mm,
                beyond_mm: None,
                light_beyond: false,
            };
            let pixels = [at_mm, at_mm - along].map(|p| px_of(head, &p));
            if let [Some(px), Some(before)] = pixels {
                let way = [px.u - before.u, px.v - before.v];
                let along_px = way.map(|d| d / way[0].hypot(way[1]));
                let (out, up) = (outward(&face, side), -Vector3::from(face.cam_from_face.column(2)));
                let section = Section { at: at_mm, along, out, up, px, along_px };
                let reach = (at_mm - points[1 - end]).dot(&out);
                (result.class, result.beyond_mm, result.light_beyond) =
                    judge(&eye, &light, scene, view, laser, &section, reach);
            }
            found.push(result);
        }
    }
    found
}

/// Class, height of the next surface, and whether light goes on in the plane. `reach` is the stripe's length across the side, mm.
fn judge(
    eye: &SceneView<'_>,
    light: &Light,
    scene: &Scene,
    view: &View,
    laser: usize,
    section: &Section,
    reach: f64,
) -> (EndClass, Option<f64>, bool) {
    let Px { u, v } = section.px;
    let first = Px::new(u + section.along_px[0] * BEYOND_PX[0], v + section.along_px[1] * BEYOND_PX[0]);
    if !inside(section.px, 0.0) || !inside(first, 0.0) {
        return (EndClass::Border, None, false);
    }
    let target = scene.target.expect("a face is looked at");
    let radius = scene.bodies[target].shape.radius_mm;
    let before = section.on_plane(-(radius + INSIDE_MM).min(0.25 * reach));
    let shown = light.cast(before).filter(|(body, ..)| *body == target);
    let shown = shown.and_then(|(body, _, at)| eye.sees(body, at));
    let hidden = [light, &eye.sight].into_iter().any(|from| from.blocked(target, section.at));
    let Some(seen) = shown.filter(|_| !hidden) else {
        let dead = scene.beams[laser].power <= 0.0;
        return (if dead { EndClass::Dark } else { EndClass::Occluded }, None, false);
    };
    if !eye.stands_out(laser, &seen) {
        return (EndClass::Dark, None, false);
    }
    let mut pieces = beyond(eye, light, (target, view.face), section);
    pieces.retain(|p| p.length_px() >= SEEN_PX && eye.stands_out(laser, p.probe()));
    let mut near = pieces
        .iter()
        .flat_map(|p| &p.samples)
        .filter(|s| (BEYOND_PX[0]..=BEYOND_PX[1]).contains(&s.along_px))
        .peekable();
    let light_beyond = near.peek().is_some() && near.all(|s| s.off_px.abs() <= LINE_PX);
    if let Some(flush) = pieces.iter().find(|p| p.is_flush()) {
        let settled = flush.samples.iter().find(|s| s.out_mm >= flush.first().out_mm + FLUSH_RUN_MM);
        return (EndClass::Flush, settled.map(|s| s.up_mm), light_beyond);
    }
    for piece in &pieces {
        let begins = piece.first().up_mm;
        let class = if piece.bends() {
            if piece.samples.iter().all(|s| s.off_px.abs() < SEEN_PX) {
                continue; // too short a wall to be told from the line
            }
            if piece.last().up_mm > begins { EndClass::Concave } else { EndClass::Convex }
        } else if begins > FLUSH_MM {
            EndClass::Nearer
        } else {
            EndClass::Farther
        };
        return (class, Some(begins), light_beyond);
    }
    (EndClass::Farther, None, light_beyond)
}

/// What the laser lights beyond the side and the camera sees, in the order of the laser's rays. `own` is the face itself, which may
/// reach a little beyond its sharp edge.
fn beyond(eye: &SceneView<'_>, light: &Light, own: (usize, usize), section: &Section) -> Vec<Piece> {
    let mut pieces: Vec<Piece> = Vec::new();
    let (mut out_mm, mut unbroken) = (0.05, false);
    while out_mm < REACH_MM {
        let met = light.cast(section.on_plane(out_mm));
        out_mm += (0.03 * out_mm).max(0.25);
        if met.is_some_and(|(body, face, _)| (body, face) == own) {
            continue;
        }
        let shown = met.and_then(|(body, face, at)| Some((body, face, at, eye.sees(body, at)?)));
        let Some((body, face, at, seen)) = shown else {
            unbroken = false;
            continue;
        };
        let off = at - section.at;
        let [along_px, off_px] = section.in_line(seen.px);
        let sample =
            Sample { out_mm: off.dot(&section.out), up_mm: off.dot(&section.up), along_px, off_px, seen };
        match pieces.last_mut().filter(|p| unbroken && (p.body, p.face) == (body, face)) {
            Some(piece) => piece.samples.push(sample),
            None => pieces.push(Piece { body, face, samples: vec![sample] }),
        }
        unbroken = true;
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::Appearance;
    use crate::pose::grid_centre;
    use crate::pose::turned;
    use crate::rivals::false_lines;
    use crate::rng::Rng;
    use crate::stock::Stock;
    use crate::world::stand::paint;
    use crate::world::{Body, Role, compose};

    const SIZE: Vector3<f64> = Vector3::new(500.0, 400.0, 350.0);
    const TOP: usize = 0;
    const RIGHT: usize = 1;
    const BOTTOM: usize = 2;
    const LEFT: usize = 3;

    fn body(foot: [f64; 3], size: [f64; 3], role: Role) -> Body {
        let look = Appearance::bare(paint(&mut Rng::new(1, 1), [170, 140, 100]), 0.02);
        Body::upright(foot.into(), size.into(), 0.0, look, role)
    }

    /// A box on a floor and before a wall, seen from above its front; on its left a neighbour, `step` behind the front.
    fn scene(step: f64, gap: f64) -> (Head, Scene) {
        let head = Head::nominal().unwrap();
        let mut scene = compose::empty(&mut Rng::new(3, 3), &head, &Stock::default());
        let target = body([0.0; 3], SIZE.into(), Role::Target).rounded(1.0);
        let cam_from_face = turned(45.0, 0.0, 0.0) * turned(0.0, 25.0, 0.0);
        let normal: Vector3<f64> = cam_from_face.column(2).into();
        let centre = grid_centre(&head, normal, normal.z * 900.0).unwrap();
        let face = FacePose { cam_from_face, centre, half: [250.0, 175.0] };
        scene.views = vec![View::of_face(&face, 3, target.centre, &target.half)];
        scene.bodies = vec![
            target,
            body([-250.0 - gap - 150.0, step, 0.0], [300.0, 400.0, 350.0], Role::Carton).rounded(1.0),
            body([0.0, 0.0, -100.0], [20_000.0, 20_000.0, 100.0], Role::Room),
            body([0.0, 200.0 + 30.0 + 100.0, 0.0], [20_000.0, 200.0, 4000.0], Role::Room),
        ];
        (scene.target, scene.refuse) = (Some(0), None);
        (head, scene)
    }

    fn ends(head: &Head, scene: &Scene) -> Vec<StripeEnd> {
        let found = stripe_ends(head, scene, &scene.views[0], &Photos::default());
        assert_eq!(found.len(), 8);
        found
    }

    fn on(ends: &[StripeEnd], side: usize) -> [StripeEnd; 2] {
        let found: Vec<StripeEnd> = ends.iter().filter(|e| e.side == side).copied().collect();
        found.try_into().expect("two stripes leave the face by each side")
    }

    #[test]
    fn each_side_of_a_box_that_stands_by_others_has_its_class() {
        let (head, mut scene) = scene(0.5, 1.0);
        let band = |face, side, offset_mm| crate::material::FalseLine { face, side, offset_mm, kind: "band" };
        scene.bodies[0].look.lines = vec![band(3, 1, 12.0), band(4, 1, 9.0)];
        let ends = ends(&head, &scene);
        for end in on(&ends, LEFT) {
            assert!(end.class == EndClass::Flush && end.light_beyond, "{end:?}");
            assert!((end.beyond_mm.unwrap() + 0.5).abs() < 0.05, "{end:?}");
        }
        for end in on(&ends, RIGHT) {
            // Light passes to the wall, or to the floor before it.
            assert!(end.class == EndClass::Farther && !end.light_beyond, "{end:?}");
            assert!((-430.1..-20.0).contains(&end.beyond_mm.unwrap()), "{end:?}");
        }
        for end in on(&ends, TOP) {
            assert!(end.class == EndClass::Convex && !end.light_beyond, "{end:?}");
            assert!(end.beyond_mm.unwrap().abs() < 2.0, "{end:?}");
        }
        for end in on(&ends, BOTTOM) {
            assert!(end.class == EndClass::Concave && !end.light_beyond, "{end:?}");
            assert!(end.beyond_mm.unwrap().abs() < 2.0, "{end:?}");
        }
        let lines = false_lines(&head, &scene, &scene.views[0]);
        let [print, line] = lines.as_slice() else { panic!("{lines:?}") };
        assert!((print.side, print.offset_mm, print.kind) == (RIGHT, -12.0, "band"), "{print:?}");
        // The neighbour's far edge is 301 mm away; as it lies 0.5 mm behind, the camera sees it a little nearer.
        assert!(
            (line.side, line.kind) == (LEFT, "neighbour") && (line.offset_mm - 300.7).abs() < 0.1,
            "{line:?}"
        );
    }

    #[test]
    fn a_step_or_a_gap_is_no_flush_neighbour() {
        let left = |step, gap| {
            let (head, scene) = scene(step, gap);
            on(&ends(&head, &scene), LEFT)
        };
        for end in left(20.0, 1.0) {
            assert!(end.class == EndClass::Farther && (end.beyond_mm.unwrap() + 20.0).abs() < 1.0, "{end:?}");
        }
        for end in left(-30.0, 1.0) {
            // Its side is lit and seen from where the head is.
            assert!(end.class == EndClass::Concave && !end.light_beyond, "{end:?}");
        }
        for end in left(0.0, 40.0) {
            assert!(end.class != EndClass::Flush && !end.light_beyond, "{end:?}");
        }
    }

    #[test]
    fn ends_that_cannot_be_seen_say_why() {
        let (head, mut scene) = scene(0.5, 1.0);
        let free = ends(&head, &scene);
        let hidden = on(&free, RIGHT)[0];
        let view = scene.views[0];
        // A plate before one end, half way to the camera's side of it.
        let mut plate = body([0.0; 3], [30.0, 4.0, 30.0], Role::Occluder);
        plate.centre = view.world(hidden.at_mm * 0.97);
        scene.bodies.push(plate);
        scene.beams[3 - hidden.laser].power = 0.0;
        for (end, before) in ends(&head, &scene).iter().zip(&free) {
            let expected = match end.laser {
                laser if laser == 3 - hidden.laser => EndClass::Dark,
                laser if (laser, end.end) == (hidden.laser, hidden.end) => EndClass::Occluded,
                _ => before.class,
            };
            assert_eq!(end.class, expected, "{end:?}");
        }
        // Black as nothing is: the stripe is not seen on it, so that it is no light beyond.
        scene.bodies.pop();
        scene.bodies[1].look.surface.base = V3::default();
        scene.bodies[1].look.gloss = 0.0;
        let lost = on(&ends(&head, &scene), LEFT)[0];
        assert!(!lost.light_beyond && lost.class != EndClass::Flush, "{lost:?}");
        // So near that the face does not fit the picture.
        let motion = crate::tremor::Motion {
            rotation_rad: Vector3::zeros(),
            translation_mm: Vector3::new(0.0, 0.0, -500.0),
        };
        scene.views[0] = motion.moved(&view);
        assert!(ends(&head, &scene).iter().any(|e| e.class == EndClass::Border));
    }

    #[test]
    fn ends_are_the_key_points() {
        let mut rng = Rng::new(12, 0);
        let mut met = 0;
        for _ in 0..40 {
            let head = Head::random(&mut rng).unwrap();
            let turn = crate::pose::random_orientation(&mut rng, false, 40.0);
            let size = [rng.range(200.0, 900.0), rng.range(200.0, 900.0)];
            let Some(face) = crate::pose::place_face(&mut rng, &head, size, turn) else { continue };
            for laser in 0..4 {
                let at = face.crossing(&head, laser, 0.0).unwrap().at;
                let ends = stripe_on_face(&head, &face, laser).unwrap();
                for (([right, down], side), key) in ends.into_iter().zip(at) {
                    assert!((right - key[0]).hypot(down - key[1]) < 1e-8, "{ends:?} {at:?}");
                    // It lies on the side that is named.
                    let (a, b) = (face.corners()[side], face.corners()[(side + 1) % 4]);
                    let p = face.point(right, down);
                    assert!(((p - a).norm() + (p - b).norm() - (a - b).norm()).abs() < 1e-6);
                    met += 1;
                }
            }
        }
        assert!(met > 80, "{met}");
    }
}
