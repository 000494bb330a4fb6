//! A cuboid with rounded edges as the ray caster sees it: everything in a scene, floor and walls included, is one.

use crate::vec3::{Rows, V3, v3};
use nalgebra::{Matrix3, Vector3};

/// Faces by outward normal: 0 +x, 1 -x, 2 +y, 3 -y, 4 +z, 5 -z of the cuboid's own frame.
pub const FACES: usize = 6;

/// The outward normal of a face in the cuboid's frame.
#[must_use]
pub fn face_normal(face: usize) -> Vector3<f64> {
    let mut n = Vector3::zeros();
    n[face / 2] = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
    n
}

/// Right and down of a face as seen from outside, its picture axes, in the cuboid's frame (z of that frame is up).
#[must_use]
pub fn face_axes(face: usize) -> (Vector3<f64>, Vector3<f64>) {
    match face {
        0 => (Vector3::y(), -Vector3::z()),
        1 => (-Vector3::y(), -Vector3::z()),
        2 => (-Vector3::x(), -Vector3::z()),
        3 => (Vector3::x(), -Vector3::z()),
        4 => (Vector3::x(), -Vector3::y()),
        _ => (Vector3::x(), Vector3::y()),
    }
}

/// Picture coordinates (right, down) of a point on a face, mm from its middle.
#[inline]
#[must_use]
pub fn face_uv(face: usize, p: V3) -> (f32, f32) {
    match face {
        0 => (p.y, -p.z),
        1 => (-p.y, -p.z),
        2 => (-p.x, -p.z),
        3 => (p.x, -p.z),
        4 => (p.x, -p.y),
        _ => (p.x, p.y),
    }
}

/// A cuboid placed in the camera frame.
#[derive(Clone, Debug)]
pub struct Solid {
    /// local = rows (cam - centre)
    to_local: Rows,
    /// The camera's centre in the cuboid's frame.
    camera_local: V3,
    /// Half sizes, mm.
    pub half: V3,
    /// Radius of the edges, mm.
    pub radius: f32,
    /// Outward bulge in the middle of each face, mm; 0 at its edges.
    pub bulge: [f32; FACES],
    /// Centre in the camera frame, mm.
    pub centre: V3,
    /// Radius of the sphere around it, mm.
    pub bound: f32,
    /// Smallest depth of any of its points, mm; 0 if it reaches behind the camera.
    pub nearest: f32,
    /// Planes that the camera sees, by axis: signed half size, or not a number where the camera is between both.
    seen: V3,
}

/// Where a camera ray meets a solid.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// Depth along the ray (x, y, 1), mm.
    pub depth: f32,
    /// The face met, or the one nearest to the rounding met.
    pub face: usize,
    /// The point in the solid's frame, mm.
    pub local: V3,
    /// Normal in the solid's frame where it is not the face's own.
    pub bent: Option<V3>,
    /// On the rounding of an edge, not on a face.
    pub rounded: bool,
}

impl Solid {
    /// Places a cuboid. `cam_from_local` must be a rotation.
    #[must_use]
    pub fn new(
        cam_from_local: &Matrix3<f64>,
        centre: Vector3<f64>,
        half: Vector3<f64>,
        radius: f64,
        bulge: [f32; FACES],
    ) -> Self {
        let rows = cam_from_local.transpose();
        let nearest = (0..8)
            .map(|i| {
                let sign = |bit: usize| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
                (cam_from_local * half.component_mul(&Vector3::new(sign(0), sign(1), sign(2))) + centre).z
            })
            .fold(f64::INFINITY, f64::min);
        let most = bulge.iter().fold(0f32, |a, b| a.max(b.abs()));
        let camera = rows * -centre;
        let seen =
            Vector3::from_fn(
                |i, _| {
                    if camera[i].abs() > half[i] { half[i].copysign(camera[i]) } else { f64::NAN }
                },
            );
        Self {
            to_local: Rows::new(&rows),
            camera_local: camera.into(),
            seen: seen.into(),
            half: half.into(),
            radius: radius.min(half.min()) as f32,
            bulge,
            centre: centre.into(),
            bound: half.norm() as f32 + most,
            nearest: (nearest.max(0.0) as f32 - most).max(0.0),
        }
    }

    /// A direction of the camera frame in the solid's.
    #[inline]
    #[must_use]
    pub fn local_dir(&self, d: V3) -> V3 {
        self.to_local.apply(d)
    }

    /// A direction of the solid's frame in the camera's.
    #[inline]
    #[must_use]
    pub fn cam_dir(&self, d: V3) -> V3 {
        self.to_local.apply_transposed(d)
    }

    /// A point of the camera frame in the solid's.
    #[inline]
    #[must_use]
    pub fn local(&self, p: V3) -> V3 {
        self.to_local.apply(p - self.centre)
    }

    /// The first meeting of a camera ray (x, y, 1) with the solid, if nearer than `limit`.
    #[inline]
    #[must_use]
    pub fn hit(&self, ray: V3, limit: f32) -> Option<Hit> {
        let d = self.to_local.apply(ray);
        let o = self.camera_local;
        // The ray enters through the last of the planes that the camera sees; a NaN loses every comparison.
        let (mut near, mut axis) = (0.0, 3);
        let t = (self.seen.x - o.x) / d.x;
        if t > near {
            (near, axis) = (t, 0);
        }
        let t = (self.seen.y - o.y) / d.y;
        if t > near {
            (near, axis) = (t, 1);
        }
        let t = (self.seen.z - o.z) / d.z;
        if t > near {
            (near, axis) = (t, 2);
        }
        if near >= limit || axis == 3 {
            return None;
        }
        let local = o + d * near;
        let over = local.abs() - self.half;
        let inside = match axis {
            0 => over.y <= 0.0 && over.z <= 0.0,
            1 => over.x <= 0.0 && over.z <= 0.0,
            _ => over.x <= 0.0 && over.y <= 0.0,
        };
        if !inside {
            return None;
        }
        let face = axis * 2 + usize::from(d[axis] > 0.0);
        if self.radius > 0.0 {
            let inner = self.half - v3(self.radius, self.radius, self.radius);
            let a = local.abs();
            let outside =
                usize::from(a.x > inner.x) + usize::from(a.y > inner.y) + usize::from(a.z > inner.z);
            if outside > 1 {
                let (_, far, _) = slab(o, d, self.half)?;
                return self.rounded_hit(o, d, near, far.min(limit));
            }
        }
        if self.bulge[face] != 0.0 {
            return Some(self.bulged_hit(o, d, near, face));
        }
        Some(Hit { depth: near, face, local, bent: None, rounded: false })
    }

    /// 1 / depth at which four rays enter through the plane of an axis that the camera sees; `None` if it sees none.
    fn entries(&self, directions: &[V3; 4], axis: usize) -> Option<[f32; 4]> {
        let way = self.seen[axis] - self.camera_local[axis];
        (!way.is_nan()).then(|| directions.map(|d| d[axis] / way))
    }

    /// Whether all rays between four corner rays pass the cuboid: they leave through one plane before they enter through
    /// another. 1 / depth on a plane is linear in the ray, so that the corners speak for all.
    fn passed(&self, directions: &[V3; 4]) -> bool {
        let o = self.camera_local;
        (0..3).filter_map(|axis| Some((axis, self.entries(directions, axis)?))).any(|(axis, entries)| {
            (0..3).filter(|other| *other != axis).any(|other| {
                let h = self.half[other];
                // A camera between two planes leaves through either.
                [h, -h].into_iter().filter(|plane| *plane != self.seen[other]).any(|plane| {
                    let way = plane - o[other];
                    directions.iter().zip(&entries).all(|(d, entry)| *entry < d[other] / way)
                })
            })
        })
    }

    /// Whether the solid is nowhere before a plane on which four corner rays have these inverse depths, or not on their way.
    #[must_use]
    pub fn behind(&self, corners: &[V3; 4], inverse_depths: &[f32; 4]) -> bool {
        if self.bulge.iter().any(|b| *b != 0.0) {
            return self.least_depth(corners).is_none_or(|least| {
                let nearest = inverse_depths.iter().fold(f32::MAX, |a, b| a.min(*b));
                least * nearest >= 1.0
            });
        }
        let directions = corners.map(|c| self.to_local.apply(c));
        let hidden = (0..3)
            .filter_map(|axis| self.entries(&directions, axis))
            .any(|entries| entries.iter().zip(inverse_depths).all(|(entry, own)| entry <= own));
        hidden || self.passed(&directions)
    }

    /// A lower bound of the depth at which rays between four corner rays can meet the solid; `None` if they cannot.
    #[must_use]
    pub fn least_depth(&self, corners: &[V3; 4]) -> Option<f32> {
        let mut least = self.nearest;
        let directions = corners.map(|c| self.to_local.apply(c));
        if self.bulge.iter().all(|b| *b == 0.0) && self.passed(&directions) {
            return None;
        }
        for axis in 0..3 {
            let plane = self.seen[axis];
            if plane.is_nan() {
                continue;
            }
            // 1 / depth on a plane is linear in the ray, so that its extremes are at the corners.
            let way = plane - self.camera_local[axis];
            let closest = directions.iter().map(|d| d[axis] / way).fold(f32::MIN, f32::max);
            if closest <= 0.0 {
                return None; // the whole tile looks away from this plane, and so past the solid
            }
            // A margin for distortion between the corners and for bulges.
            least = least.max(0.98 / closest - 20.0);
        }
        Some(least)
    }

    /// Walks the ray through the rounding: the distance to the rounded cuboid never oversteps it.
    #[cold]
    fn rounded_hit(&self, o: V3, d: V3, near: f32, far: f32) -> Option<Hit> {
        let inverse_speed = 1.0 / d.norm();
        let inner = self.half - v3(self.radius, self.radius, self.radius);
        let mut depth = near;
        for _ in 0..40 {
            let p = o + d * depth;
            let gap = (p.abs() - inner).max(0.0).norm() - self.radius;
            if gap < 0.004 * self.radius {
                break;
            }
            depth += gap * inverse_speed;
            if depth > far {
                return None;
            }
        }
        let p = o + d * depth;
        let q = (p.abs() - inner).max(0.0);
        let normal = v3(q.x.copysign(p.x), q.y.copysign(p.y), q.z.copysign(p.z)).unit();
        let most = normal.abs();
        let axis = if most.x >= most.y && most.x >= most.z { 0 } else { 1 + usize::from(most.z > most.y) };
        Some(Hit {
            depth,
            face: axis * 2 + usize::from(normal[axis] < 0.0),
            local: p,
            bent: Some(normal),
            rounded: true,
        })
    }

    /// Shifts a hit along the ray onto the bulged face; two steps suffice for bulges of a few mm.
    #[cold]
    fn bulged_hit(&self, o: V3, d: V3, near: f32, face: usize) -> Hit {
        let axis = face / 2;
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        let rise = self.bulge[face];
        let mut depth = near;
        let mut slope = (0.0, 0.0);
        for _ in 0..3 {
            let p = o + d * depth;
            let (s, t) = (p[a] / self.half[a], p[b] / self.half[b]);
            let (ss, tt) = ((1.0 - s * s).max(0.0), (1.0 - t * t).max(0.0));
            let height = rise * ss * tt;
            slope = (-2.0 * rise * s * tt / self.half[a], -2.0 * rise * t * ss / self.half[b]);
            depth = near - height / d[axis].abs().max(0.05);
        }
        let side = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
        let mut n = [0.0; 3];
        n[axis] = side;
        n[a] = -slope.0;
        n[b] = -slope.1;
        Hit { depth, face, local: o + d * depth, bent: Some(v3(n[0], n[1], n[2]).unit()), rounded: false }
    }

    /// Whether the segment from `from` (camera frame) along `to_light`, whose length is the segment's, meets the solid.
    #[inline]
    #[must_use]
    pub fn blocks(&self, from: V3, to_light: V3) -> bool {
        let o = self.local(from);
        let d = self.to_local.apply(to_light);
        // A rounded edge seen at 45 degrees recedes by this much from the sharp one.
        let recess = 0.29 * self.radius;
        matches!(slab(o, d, self.half - v3(recess, recess, recess)), Some((near, far, _)) if near < far && far > 1e-4 && near < 0.9999)
    }

    /// How much of a lamp is seen past the solid: 1 all, 0 nothing. `width` is the lamp's half opening as a tangent.
    #[inline]
    #[must_use]
    pub fn lets_through(&self, from: V3, to_lamp: V3, width: f32) -> f32 {
        let o = self.local(from);
        let d = self.to_local.apply(to_lamp);
        let inverse = v3(1.0 / guard(d.x), 1.0 / guard(d.y), 1.0 / guard(d.z));
        // Without the rounding, or what lies beneath an edge would be black where it is seen.
        let inner = self.half - v3(self.radius, self.radius, self.radius);
        let k = inverse.abs().times(inner);
        let n = inverse.times(o);
        let near = (-n.x - k.x).max(-n.y - k.y).max(-n.z - k.z);
        let far = (k.x - n.x).min(k.y - n.y).min(k.z - n.z);
        if far <= 0.0 || near >= 1.0 {
            return 1.0;
        }
        // The ray's point half way through (or half way past) tells by how much it hits or misses.
        let middle = (0.5 * (near + far)).clamp(0.0, 1.0);
        let gap = self.gap_local(o + d * middle);
        let blur = (width * middle * d.norm()).max(0.5);
        let x = (0.5 + 0.5 * gap / blur).clamp(0.0, 1.0);
        x * x * (3.0 - 2.0 * x)
    }

    /// Distance of a point of the solid's own frame to it, mm; negative inside.
    #[inline]
    #[must_use]
    pub fn gap_local(&self, p: V3) -> f32 {
        let q = p.abs() - self.half;
        q.max(0.0).norm() + q.largest().min(0.0)
    }
}

#[inline]
fn guard(x: f32) -> f32 {
    if x.abs() < 1e-9 { 1e-9f32.copysign(x) } else { x }
}

/// Entry, exit and entry axis of a ray through a cuboid about the origin.
#[inline]
fn slab(o: V3, d: V3, half: V3) -> Option<(f32, f32, usize)> {
    let inverse = v3(1.0 / guard(d.x), 1.0 / guard(d.y), 1.0 / guard(d.z));
    let k = inverse.abs().times(half);
    let n = inverse.times(o);
    let (tx, ty, tz) = (-n.x - k.x, -n.y - k.y, -n.z - k.z);
    let far = (k.x - n.x).min(k.y - n.y).min(k.z - n.z);
    let (mut near, mut axis) = (tx, 0);
    if ty > near {
        (near, axis) = (ty, 1);
    }
    if tz > near {
        (near, axis) = (tz, 2);
    }
    (near <= far).then_some((near, far, axis))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube(radius: f64) -> Solid {
        Solid::new(
            &Matrix3::identity(),
            Vector3::new(0.0, 0.0, 1000.0),
            Vector3::new(100.0, 100.0, 100.0),
            radius,
            [0.0; FACES],
        )
    }

    #[test]
    fn a_flat_face_is_met_where_it_is() {
        let hit = cube(2.0).hit(v3(0.01, -0.02, 1.0), 1e9).unwrap();
        assert_eq!(hit.face, 5);
        assert!((hit.depth - 900.0).abs() < 1e-3);
        assert!(hit.bent.is_none());
    }

    #[test]
    fn a_rounded_edge_is_met_on_its_cylinder_and_lost_at_the_sharp_corner() {
        let solid = cube(4.0);
        let hit = solid.hit(v3(98.0 / 900.0, 0.0, 1.0), 1e9).unwrap();
        let p = hit.local;
        let off = ((p.x - 96.0).powi(2) + (p.z + 96.0).powi(2)).sqrt();
        assert!((off - 4.0).abs() < 0.05, "{off}");
        // The ray through the sharp corner passes the rounding, then meets nothing: silhouettes recede a little.
        assert!(solid.hit(v3(100.0 / 900.0 - 1e-5, 0.0, 1.0), 1e9).is_none());
    }

    #[test]
    fn squares_of_rays_that_pass_or_lie_behind_are_known() {
        let solid = cube(0.0);
        let square = |x: f32, y: f32| {
            [(0.0, 0.0), (0.01, 0.0), (0.0, 0.01), (0.01, 0.01)].map(|(a, b)| v3(x + a, y + b, 1.0))
        };
        // The front face reaches from -0.111 to 0.111.
        for (x, y, met) in [
            (0.0, 0.0, true),
            (0.105, 0.0, true),
            (0.112, 0.0, false),
            (0.0, -0.122, false),
            (0.09, 0.1, true),
        ] {
            assert_eq!(solid.least_depth(&square(x, y)).is_some(), met, "{x} {y}");
        }
        // The plane z = 890 is before the cube, z = 950 is not.
        assert!(solid.behind(&square(0.0, 0.0), &[1.0 / 890.0; 4]));
        assert!(!solid.behind(&square(0.0, 0.0), &[1.0 / 950.0; 4]));
        assert!(solid.behind(&square(0.2, 0.0), &[1.0 / 950.0; 4]));
    }

    #[test]
    fn a_bulge_is_nearer_in_the_middle_and_nothing_at_the_rim() {
        let mut solid = cube(0.0);
        solid.bulge[5] = 3.0;
        assert!((solid.hit(v3(0.0, 0.0, 1.0), 1e9).unwrap().depth - 897.0).abs() < 0.01);
        assert!((solid.hit(v3(99.99 / 900.0, 0.0, 1.0), 1e9).unwrap().depth - 900.0).abs() < 0.02);
    }

    #[test]
    fn shadows_are_full_behind_and_none_beside() {
        let solid = cube(0.0);
        let from = v3(0.0, 0.0, 1500.0);
        assert!(solid.blocks(from, v3(0.0, 0.0, -1000.0)));
        assert!(!solid.blocks(from, v3(0.0, 0.0, -300.0)));
        assert!(solid.lets_through(from, v3(0.0, 0.0, -1400.0), 0.05) < 0.01);
        assert!(solid.lets_through(v3(0.0, 300.0, 1500.0), v3(0.0, 0.0, -1400.0), 0.05) > 0.99);
    }

    #[test]
    fn picture_axes_agree_with_normals() {
        for face in 0..FACES {
            let (right, down) = face_axes(face);
            assert!((right.cross(&down) + face_normal(face)).norm() < 1e-12, "face {face}");
            let p = right * 3.0 + down * 5.0 + face_normal(face);
            assert_eq!(face_uv(face, p.into()), (3.0, 5.0));
        }
    }
}
