//! A cuboid as the ray caster sees it, its edges rounded, its faces bent, its corners pressed in as its [`Shape`] says:
//! everything in a scene, floor and walls included, is one.

use crate::shape::{Shape, Wave};
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

/// A face of the cuboid by the axis of its normal and which way that points.
#[inline]
#[must_use]
pub const fn face_of(axis: usize, upwards: bool) -> usize {
    if upwards { axis * 2 } else { axis * 2 + 1 }
}

/// The face that meets `face` along one of its edges; edges as its picture axes have them: 0 left, 1 right, 2 upper, 3 lower.
#[must_use]
pub fn face_beside(face: usize, side: usize) -> usize {
    let (right, down) = face_axes(face);
    let way = [-right, right, -down, down][side % 4];
    let axis = way.iamax();
    face_of(axis, way[axis] > 0.0)
}

/// A cuboid placed in the camera frame.
#[derive(Clone, Debug)]
pub struct Solid {
    /// local = rows (cam - centre)
    to_local: Rows,
    /// The camera's centre in the cuboid's frame.
    camera_local: V3,
    /// Half sizes of the sharp cuboid, mm.
    pub half: V3,
    /// Radius of the edges, mm.
    pub radius: f32,
    /// Outward bulge in the middle of each face, mm; 0 at its edges.
    bulge: [f32; FACES],
    waves: Option<Box<[Wave; FACES]>>,
    cuts: Vec<Cut>,
    /// No place stands out or back by more, mm; 0 if all faces are flat.
    bent_by: f32,
    /// So far inside its rim a face may end because its neighbours bend or are rounded, mm.
    rim: f32,
    /// Half sizes of the upright cuboid around all of it, mm.
    outer: V3,
    /// Centre in the camera frame, mm.
    pub centre: V3,
    /// Radius of the sphere around it, mm.
    pub bound: f32,
    /// Smallest depth of any of its points, mm; 0 if it reaches behind the camera.
    pub nearest: f32,
    /// Planes of the outer cuboid that the camera sees, by axis: signed half size, or not a number where the camera is between both.
    seen: V3,
}

/// A corner pressed in: near the vertex only what is inside a ball is left.
#[derive(Clone, Copy, Debug)]
struct Cut {
    /// Where the vertex would be.
    vertex: V3,
    reach: f32,
    centre: V3,
    radius: f32,
}

impl Cut {
    /// The ball meets the three edges at their reach; its middle lies on the corner's diagonal, this many reaches from each face.
    const DEPTH: f32 = 2.0;

    fn new(vertex: V3, reach: f32) -> Self {
        let inwards = |x: f32| x - (Self::DEPTH * reach).copysign(x);
        let to_edge = 2.0 * Self::DEPTH * Self::DEPTH + (Self::DEPTH - 1.0) * (Self::DEPTH - 1.0);
        let centre = v3(inwards(vertex.x), inwards(vertex.y), inwards(vertex.z));
        Self { vertex, reach, centre, radius: reach * to_edge.sqrt() }
    }

    /// Whether a point is near enough to the vertex for the ball to count.
    #[inline]
    fn holds(&self, p: V3) -> bool {
        let near = |vertex: f32, x: f32| (vertex - x) * vertex.signum() < self.reach;
        near(self.vertex.x, p.x) && near(self.vertex.y, p.y) && near(self.vertex.z, p.z)
    }
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
        shape: &Shape,
    ) -> Self {
        let rows = cam_from_local.transpose();
        let sign = |corner: usize, axis: usize| if corner >> axis & 1 == 1 { 1.0 } else { -1.0 };
        let nearest = (0..8)
            .map(|i| {
                (cam_from_local * half.component_mul(&Vector3::from_fn(|axis, _| sign(i, axis))) + centre).z
            })
            .fold(f64::INFINITY, f64::min);
        let mut solid = Self {
            to_local: Rows::new(&rows),
            camera_local: (rows * -centre).into(),
            half: half.into(),
            radius: shape.radius_mm.min(half.min()) as f32,
            bulge: shape.bulge_mm,
            waves: shape.waves.clone(),
            cuts: Vec::new(),
            bent_by: 0.0,
            rim: 0.0,
            outer: V3::default(),
            centre: centre.into(),
            bound: half.norm() as f32,
            nearest: nearest as f32,
            seen: V3::default(),
        };
        solid.take_bounds();
        solid.cuts = shape
            .crushed
            .iter()
            .map(|c| {
                let at = [0, 1, 2].map(|axis| solid.half[axis] * sign(c.corner, axis) as f32);
                let sharp = v3(at[0], at[1], at[2]);
                let bent = [0, 1, 2].map(|axis| {
                    at[axis] + solid.rise(face_of(axis, at[axis] > 0.0), sharp).0.copysign(at[axis])
                });
                Cut::new(v3(bent[0], bent[1], bent[2]), c.reach_mm)
            })
            .collect();
        solid.bound += solid.bent_by;
        solid.nearest = (solid.nearest.max(0.0) - solid.bent_by).max(0.0);
        solid
    }

    /// Sets what follows from bulges and waves.
    fn take_bounds(&mut self) {
        let bulge = self.bulge.iter().fold(0f32, |a, b| a.max(b.abs()));
        let wave = self.waves.iter().flat_map(|w| w.iter()).fold(0f32, |a, w| a.max(w.most_mm()));
        self.bent_by = bulge + wave;
        // Bulges are hardly anything so close to a face's rim.
        self.rim = self.radius + wave + 0.1 * bulge;
        self.outer = self.half + v3(1.0, 1.0, 1.0) * self.bent_by;
        let seen =
            |outer: f32, camera: f32| if camera.abs() > outer { outer.copysign(camera) } else { f32::NAN };
        let camera = self.camera_local;
        self.seen =
            v3(seen(self.outer.x, camera.x), seen(self.outer.y, camera.y), seen(self.outer.z, camera.z));
    }

    /// Drops roundings, dents, bulges and waves that are not seen where a pixel covers `pixel_mm`: they cost as much as large ones.
    pub fn simplify(&mut self, pixel_mm: f32) {
        if self.radius < 0.5 * pixel_mm {
            self.radius = 0.0;
            self.take_bounds();
        }
        self.cuts.retain(|c| c.reach > pixel_mm);
        if self.bent_by > 0.0 && self.bent_by < 0.35 * pixel_mm {
            (self.bulge, self.waves) = ([0.0; FACES], None);
            self.take_bounds();
        }
    }

    /// Whether faces have bulges or waves.
    #[inline]
    #[must_use]
    pub fn bent(&self) -> bool {
        self.bent_by > 0.0
    }

    /// Half sizes of the upright cuboid around the solid in its own frame, mm.
    #[must_use]
    pub const fn outer(&self) -> V3 {
        self.outer
    }

    /// A point of the sharp edge between two faces, where that edge really is.
    #[must_use]
    pub fn on_edge(&self, faces: [usize; 2], sharp: V3) -> V3 {
        if !self.bent() {
            return sharp;
        }
        faces.iter().fold(sharp, |p, face| p + V3::from(face_normal(*face)) * self.rise(*face, sharp).0)
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
        if self.bent() {
            return self.bent_hit(o, d, limit);
        }
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
        if self.radius > 0.0 {
            let inner = self.half - v3(self.radius, self.radius, self.radius);
            let a = local.abs();
            let outside =
                usize::from(a.x > inner.x) + usize::from(a.y > inner.y) + usize::from(a.z > inner.z);
            if outside > 1 {
                return self.walk(o, d, near, slab(o, d, self.half)?.1.min(limit));
            }
        }
        if !self.cuts.is_empty() && self.cuts.iter().any(|c| c.holds(local)) {
            return self.walk(o, d, near, slab(o, d, self.half)?.1.min(limit));
        }
        Some(Hit { depth: near, face: face_of(axis, d[axis] < 0.0), local, bent: None, rounded: false })
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
                let h = self.outer[other];
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
        if self.passed(&directions) {
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
            // A margin for distortion between the corners.
            least = least.max(0.98 / closest - 20.0);
        }
        Some(least)
    }

    /// How far a bent face stands out over the flat one at a point of the solid's frame, mm, and how that changes along the face.
    #[inline]
    fn rise(&self, face: usize, p: V3) -> (f32, V3) {
        let axis = face / 2;
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        let (s, t) = ((p[a] / self.half[a]).clamp(-1.0, 1.0), (p[b] / self.half[b]).clamp(-1.0, 1.0));
        let (ss, tt) = (1.0 - s * s, 1.0 - t * t);
        let bulge = self.bulge[face];
        let (mut height, mut by_s, mut by_t) =
            (bulge * ss * tt, -2.0 * bulge * s * tt, -2.0 * bulge * t * ss);
        if let Some(waves) = &self.waves {
            let (rise, slope) = waves[face].rise(s, t);
            height += rise;
            by_s += slope[0];
            by_t += slope[1];
        }
        let mut slope = [0.0; 3];
        slope[a] = by_s / self.half[a];
        slope[b] = by_t / self.half[b];
        (height, v3(slope[0], slope[1], slope[2]))
    }

    /// [`Solid::hit`] on a solid with bulges or waves: away from a face's rim the ray's meeting with its plane, shifted onto
    /// the bent face; near the rim, where the neighbours' bends decide, a walk.
    #[inline(never)]
    fn bent_hit(&self, o: V3, d: V3, limit: f32) -> Option<Hit> {
        let (near, far, axis) = slab(o, d, self.outer)?;
        if near <= 0.0 || near >= limit {
            return None;
        }
        let speed = d[axis].abs();
        let mut from = near;
        if speed > 0.15 {
            let face = face_of(axis, d[axis] < 0.0);
            let flat = (self.half[axis].copysign(-d[axis]) - o[axis]) / d[axis];
            let (mut depth, mut slope) = (flat, V3::default());
            // Slopes are a few hundredths, so that two or three steps suffice.
            for _ in 0..3 {
                let (rise, by) = self.rise(face, o + d * depth);
                let step = flat - rise / speed - depth;
                (depth, slope) = (depth + step, by);
                if step.abs() < 0.02 {
                    break;
                }
            }
            let local = o + d * depth;
            let over = self.half - local.abs();
            let (a, b) = (over[(axis + 1) % 3], over[(axis + 2) % 3]);
            if a > self.rim && b > self.rim && !self.cuts.iter().any(|c| c.holds(local)) {
                let bent = Some((V3::from(face_normal(face)) - slope).unit());
                return (depth < limit).then_some(Hit { depth, face, local, bent, rounded: false });
            }
            // Nothing of the solid stands out over that face.
            from = depth;
        }
        self.walk(o, d, from, far.min(limit))
    }

    /// Walks the ray from `near` to `far` onto rounded edges, bent faces and pressed-in corners by Newton's steps, which never
    /// pass beyond the surface of a convex body; these are convex but for waves of a few hundredths.
    #[cold]
    fn walk(&self, o: V3, d: V3, near: f32, far: f32) -> Option<Hit> {
        let slowest = 0.02 * d.norm();
        let enough = 0.004 * self.radius.max(1.0);
        let mut depth = near;
        for _ in 0..40 {
            if depth > far {
                return None;
            }
            let local = o + d * depth;
            let (gap, away, rounded) = self.gap_bent(local);
            if gap < enough {
                let most = away.abs();
                let axis =
                    if most.x >= most.y && most.x >= most.z { 0 } else { 1 + usize::from(most.z > most.y) };
                return Some(Hit {
                    depth,
                    face: face_of(axis, away[axis] >= 0.0),
                    local,
                    bent: Some(away.unit()),
                    rounded,
                });
            }
            // Along the surface, or away from it, the ray goes on by some gaps.
            depth += gap / (-away.dot(d)).max(slowest);
        }
        None
    }

    /// Distance of a point to the solid with all its bends, mm, never more than the true one; which way is away from it; whether
    /// an edge or a corner is nearest.
    fn gap_bent(&self, p: V3) -> (f32, V3, bool) {
        let way = |x: f32| 1f32.copysign(x);
        let mut outwards = [v3(way(p.x), 0.0, 0.0), v3(0.0, way(p.y), 0.0), v3(0.0, 0.0, way(p.z))];
        let mut over = p.abs() - self.half;
        if self.bent() {
            let mut rises = [0.0; 3];
            for axis in 0..3 {
                // Faces that are far off do not count.
                if over[axis] + self.radius + self.bent_by > 0.0 {
                    let (rise, slope) = self.rise(face_of(axis, p[axis] > 0.0), p);
                    rises[axis] = rise;
                    outwards[axis] = outwards[axis] - slope;
                }
            }
            over = over - v3(rises[0], rises[1], rises[2]);
        }
        let out = (over + v3(1.0, 1.0, 1.0) * self.radius).max(0.0);
        let length = out.norm();
        let (mut gap, mut away, mut rounded) = if length > 0.0 {
            let away = outwards[0] * out.x + outwards[1] * out.y + outwards[2] * out.z;
            let count = usize::from(out.x > 0.0) + usize::from(out.y > 0.0) + usize::from(out.z > 0.0);
            (length - self.radius, away * (1.0 / length), count > 1)
        } else {
            let axis =
                if over.x >= over.y && over.x >= over.z { 0 } else { 1 + usize::from(over.z > over.y) };
            (over[axis], outwards[axis], false)
        };
        for cut in self.cuts.iter().filter(|c| c.holds(p)) {
            let from = p - cut.centre;
            let distance = from.norm();
            if distance - cut.radius > gap {
                (gap, away, rounded) = (distance - cut.radius, from * (1.0 / distance), true);
            }
        }
        (gap, away, rounded)
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

    fn shaped(shape: &Shape) -> Solid {
        let (centre, half) = (Vector3::new(0.0, 0.0, 1000.0), Vector3::new(100.0, 100.0, 100.0));
        Solid::new(&Matrix3::identity(), centre, half, shape)
    }

    fn cube(radius: f64) -> Solid {
        shaped(&Shape::rounded(radius))
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
        let mut bulge_mm = [0.0; FACES];
        bulge_mm[5] = 3.0;
        let solid = shaped(&Shape { bulge_mm, ..Shape::default() });
        assert!((solid.hit(v3(0.0, 0.0, 1.0), 1e9).unwrap().depth - 897.0).abs() < 0.01);
        assert!((solid.hit(v3(99.99 / 900.0, 0.0, 1.0), 1e9).unwrap().depth - 900.0).abs() < 0.02);
    }

    /// Where the front face (towards the camera, at 900 mm) ends on the right at height `y`, mm: rays before it meet the solid.
    fn right_end(solid: &Solid, y: f32) -> f32 {
        let (mut low, mut high) = (50.0f32, 120.0f32);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if solid.hit(v3(middle / 900.0, y / 900.0, 1.0), 1e9).is_some() {
                low = middle
            } else {
                high = middle
            }
        }
        low
    }

    #[test]
    fn an_edge_waves_as_the_face_beside_it_does_and_bounds_hold_it() {
        let mut waves = Box::new([Wave::default(); FACES]);
        waves[0].bow_mm = 3.0;
        waves[0].along_mm = [[0.0; 2], [4.0, 0.0]];
        let solid = shaped(&Shape { waves: Some(waves.clone()), radius_mm: 0.5, ..Shape::default() });
        let mut least = f32::MAX;
        for y in [-90.0, -40.0, 0.0, 30.0, 70.0] {
            // Axes of face 0 are y and z; the front is at z = -1. The face recedes behind its edge, so the edge is the silhouette.
            let (rise, _) = waves[0].rise(y / 100.0, -1.0);
            let end = right_end(&solid, y);
            assert!((end - 100.0 - rise).abs() < 0.25, "{y}: {end}, {rise}");
            least = least.min(end);
        }
        assert!(least < 99.0);
        let out = v3(101.5 / 900.0, 0.0, 1.0);
        assert!(right_end(&solid, 0.0) > 100.5 && solid.hit(out, 1e9).is_none());
        // The square around that end is not passed over.
        let square = [(100.0, -1.0), (101.0, -1.0), (100.0, 1.0), (101.0, 1.0)]
            .map(|(x, y)| v3(x / 900.0, y / 900.0, 1.0));
        assert!(solid.least_depth(&square).is_some_and(|d| d < 900.0));
    }

    #[test]
    fn a_crushed_corner_is_missing_and_the_rest_of_the_face_is_not() {
        // The corner at +x, +y, towards the camera.
        let crushed = vec![crate::shape::Crushed { corner: 0b011, reach_mm: 20.0 }];
        let solid = shaped(&Shape { crushed, ..Shape::default() });
        let at = |x: f32, y: f32| solid.hit(v3(x / 900.0, y / 900.0, 1.0), 1e9);
        assert!(at(99.0, 99.0).is_none(), "the vertex is gone");
        assert!((right_end(&solid, 75.0) - 100.0).abs() < 0.01);
        assert!(right_end(&solid, 97.0) < 98.6);
        let dent = at(92.0, 92.0).unwrap();
        assert!(dent.rounded && dent.depth > 900.5 && dent.bent.unwrap().x > 0.3, "{dent:?}");
        let flat = at(70.0, 70.0).unwrap();
        assert!(flat.bent.is_none() && (flat.depth - 900.0).abs() < 1e-3);
    }

    #[test]
    fn what_is_smaller_than_a_pixel_is_dropped() {
        let waves = Some(Box::new([Wave { bow_mm: 0.1, ..Wave::default() }; FACES]));
        let mut solid = shaped(&Shape { waves, radius_mm: 1.0, ..Shape::default() });
        solid.simplify(0.3);
        assert!(solid.bent() && solid.radius > 0.0);
        solid.simplify(3.0);
        assert!(!solid.bent() && solid.radius == 0.0 && solid.outer() == solid.half);
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
            assert_eq!(face_normal(face_beside(face, 1)), right);
            assert_eq!(face_normal(face_beside(face, 2)), -down);
        }
    }
}
