//! Straight lines near a side and parallel to it that can be taken for it: the truth from which the cause of a wrong side is named.

use crate::ends::{outward, side_of, stripe_on_face};
use crate::head::Head;
use crate::pose::FacePose;
use crate::solid::FACES;
use crate::world::{Role, Scene, View};
use nalgebra::{Rotation3, Vector3};

/// A line parallel to a side of the face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FalseLine {
    /// Side k joins corners k and k + 1.
    pub side: usize,
    /// Its distance from the side along the face, as the camera sees it, mm; outwards is positive.
    pub offset_mm: f64,
    /// What it is: `neighbour`, `fan_end`, or the word of what is printed, glued or strapped on.
    pub kind: &'static str,
}

/// A neighbour's face is near the target's plane within this, mm.
const STEP_MM: f64 = 60.0;
/// It begins within this of the side, mm.
const TOUCH_MM: f64 = 10.0;
/// What lies nearer to the side than this is the side itself, mm.
const LEAST_MM: f64 = 5.0;
/// Cosine of the angle up to which two planes, or two lines, count as parallel: 3 degrees.
const PARALLEL: f64 = 0.9986;
/// A fan's end counts up to this share of the face's size from the side.
const FAN_SHARE: f64 = 0.1;

/// All of them on the face that is looked at, by side and offset. Empty without a target.
#[must_use]
pub fn false_lines(head: &Head, scene: &Scene, view: &View) -> Vec<FalseLine> {
    let Some(target) = scene.target else { return Vec::new() };
    let face = scene.bodies[target].face(view.face, view);
    let mut lines: Vec<FalseLine> = (0..4)
        .filter(|laser| scene.beams[*laser].power > 0.0)
        .flat_map(|laser| fan_ends(head, &face, laser).into_iter().flatten())
        .collect();
    lines.extend(scene.bodies[target].look.lines.iter().filter(|line| line.face == view.face).map(|line| {
        FalseLine {
            // Their sides are counted left, right, upper, lower.
            side: side_of(&face, line.side / 2, line.side % 2 == 1),
            offset_mm: -f64::from(line.offset_mm),
            kind: line.kind,
        }
    }));
    for body in scene.bodies.iter().filter(|b| matches!(b.role, Role::Carton | Role::Stand)) {
        for other in 0..FACES {
            let other = body.face(other, view);
            lines.extend((0..4).filter_map(|side| far_edge(&face, side, &other)));
        }
    }
    lines.sort_by(|a, b| a.side.cmp(&b.side).then(a.offset_mm.total_cmp(&b.offset_mm)));
    lines
}

/// The far edge of a neighbour's face that goes on beyond a side, nearly in the target's plane.
fn far_edge(face: &FacePose, side: usize, other: &FacePose) -> Option<FalseLine> {
    let into = Vector3::from(face.cam_from_face.column(2));
    if into.dot(&other.cam_from_face.column(2)) < PARALLEL {
        return None;
    }
    let (ends, out) = ([face.corners()[side], face.corners()[(side + 1) % 4]], outward(face, side));
    let length = (ends[1] - ends[0]).norm();
    let along = (ends[1] - ends[0]) / length;
    let corners = other.corners();
    if corners.iter().any(|c| into.dot(&(c - face.centre)).abs() > STEP_MM || c.z < 1.0) {
        return None;
    }
    // What the camera sees of it, drawn on the face's plane: along the side, across it.
    let mut seen = corners.map(|c| {
        let p = c * (into.dot(&face.centre) / into.dot(&c)) - ends[0];
        [p.dot(&along), p.dot(&out)]
    });
    seen.sort_by(|a, b| a[1].total_cmp(&b[1]));
    let [near, _, third, far] = seen;
    let common = third[0].max(far[0]).min(length) - third[0].min(far[0]).max(0.0);
    let (run, rise) = ((far[0] - third[0]).abs(), far[1] - third[1]);
    let straight = run >= PARALLEL * run.hypot(rise);
    let offset_mm = 0.5 * (third[1] + far[1]);
    let meant = near[1] <= TOUCH_MM && offset_mm > LEAST_MM && straight && common >= 0.5 * length;
    meant.then_some(FalseLine { side, offset_mm, kind: "neighbour" })
}

/// Where the two ends of a laser's fan fall on the face's plane, if that is near the side which the stripe crosses.
fn fan_ends(head: &Head, face: &FacePose, laser: usize) -> [Option<FalseLine>; 2] {
    let beam = &head.beams[laser];
    let Some(ends) = stripe_on_face(head, face, laser) else { return [None; 2] };
    let into = Vector3::from(face.cam_from_face.column(2));
    let axis = nalgebra::Unit::new_normalize(head.plane(laser));
    let places = [-1.0, 1.0].map(|way| {
        let ray = Rotation3::from_axis_angle(&axis, way * beam.fan_half_rad) * beam.forward;
        let reach = into.dot(&(face.centre - beam.source_mm)) / into.dot(&ray);
        (reach > 0.0).then(|| beam.source_mm + ray * reach)
    });
    let middle = {
        let [a, b] = ends.map(|([right, down], _)| face.point(right, down));
        (a + b) / 2.0
    };
    ends.map(|([right, down], side)| {
        let (end, out) = (face.point(right, down), outward(face, side));
        // The fan's end on this half of the stripe.
        let place = places.iter().flatten().find(|p| (*p - middle).dot(&(end - middle)) > 0.0)?;
        let offset_mm = (place - end).dot(&out);
        let size = 2.0 * (end - face.centre).dot(&out);
        (offset_mm.abs() <= FAN_SHARE * size).then_some(FalseLine { side, offset_mm, kind: "fan_end" })
    })
}
