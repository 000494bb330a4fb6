//! A flap that stands open: a thin plate hinged at an edge of the face that the flaps close. What is beneath it is taken to be
//! closed by the other flaps, so that the box keeps its six faces.

use super::{Body, Role};
use crate::material::Appearance;
use crate::rng::Rng;
use crate::shape::Shape;
use crate::solid::{face_beside, face_normal, face_of};
use nalgebra::Matrix3;

/// Angles between a closed flap and this one, degrees: 90 stands up, 180 hangs back.
const OPEN_DEG: (f64, f64) = (20.0, 160.0);
/// Places that are tried.
const ATTEMPTS: usize = 12;

/// An open flap of a box whose flaps close the faces of `axis`; `None` if none that was tried `fits`. Edges of the faces that are
/// looked at are tried first.
pub fn open_flap(
    rng: &mut Rng,
    owner: &Body,
    axis: usize,
    looked_at: &[usize],
    fits: impl Fn(&Body) -> bool,
) -> Option<Body> {
    for attempt in 0..ATTEMPTS {
        // A box stands on its lower flaps.
        let closed = face_of(axis, axis == 2 || rng.chance(0.5));
        let beside = face_beside(closed, rng.below(4));
        let open_rad = rng.range(OPEN_DEG.0, OPEN_DEG.1).to_radians();
        let (thick_mm, share) = (rng.range(3.0, 6.0), rng.range(0.85, 1.0));
        let inset_mm = rng.range(1.0, 5.0);
        let seen = looked_at.contains(&closed) || looked_at.contains(&beside);
        if attempt < ATTEMPTS / 2 && !seen || beside == 5 {
            continue;
        }
        let (up, out) = (face_normal(closed), face_normal(beside));
        // From lying over the closed face, turned about the edge.
        let (sin, cos) = open_rad.sin_cos();
        let (along, outer) = (up * sin - out * cos, up * cos + out * sin);
        let (deep, wide) = (owner.half[beside / 2], owner.half[3 - axis - beside / 2]);
        let long = share * deep.min(wide);
        let half = nalgebra::Vector3::new(wide - inset_mm.min(0.1 * wide), 0.5 * long, 0.5 * thick_mm);
        let edge = up * owner.half[axis] + out * deep;
        // Board gives way where it folds: the edge stays where the face ends.
        let middle = edge + along * (0.5 * long) + outer * (0.5 * thick_mm);
        let turned = Matrix3::from_columns(&[along.cross(&outer), along, outer]);
        let flap = Body {
            centre: owner.centre + owner.rotation * middle,
            rotation: owner.rotation * turned,
            half,
            shape: Shape::rounded(0.2 * thick_mm),
            look: Appearance::bare(owner.look.surface, owner.look.gloss),
            role: Role::Flap,
        };
        if fits(&flap) {
            return Some(flap);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::linear;
    use crate::material::{Pattern, Surface};
    use nalgebra::Vector3;

    #[test]
    fn a_flap_starts_at_its_edge_and_ends_away_from_the_box() {
        let base = linear([150, 120, 80]);
        let surface = Surface {
            kind: "brown",
            pattern: Pattern::Paint,
            base,
            second: base,
            strength: 1.0,
            offset: [0.0; 2],
        };
        let size = Vector3::new(600.0, 400.0, 300.0);
        let owner = Body::upright(Vector3::zeros(), size, 0.3, Appearance::bare(surface, 0.02), Role::Target);
        let mut beside_front = 0;
        for seed in 0..60 {
            let flap = open_flap(&mut Rng::new(seed, 1), &owner, 2, &[3], |_| true).unwrap();
            assert!((flap.rotation.determinant() - 1.0).abs() < 1e-9);
            let end = |way: f64| {
                let at = flap.centre + flap.rotation * Vector3::new(0.0, way * flap.half.y, -flap.half.z);
                owner.rotation.transpose() * (at - owner.centre)
            };
            let (hinge, free) = (end(-1.0), end(1.0));
            // The hinge lies on the upper rim; the free end stands over the top or hangs beside the box, never in it.
            assert!((hinge.z - 150.0).abs() < 1e-6);
            assert!((hinge.x.abs() - 300.0).abs().min((hinge.y.abs() - 200.0).abs()) < 1e-6);
            assert!(free.z > 150.0 + 0.3 * flap.half.y, "{free}");
            assert!(flap.half.z < 3.1 && flap.half.y <= 150.1);
            beside_front += usize::from((hinge.y + 200.0).abs() < 1e-6);
        }
        assert!(beside_front > 40, "{beside_front}");
        assert!(open_flap(&mut Rng::new(1, 1), &owner, 2, &[3], |_| false).is_none());
    }
}
