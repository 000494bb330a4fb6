//! What ails the beams of a scene: one laser at a third of its power, a fan that ends at the face.

use crate::head::{Beam, Head};
use crate::pose::{FULLY_LIT, FacePose};
use crate::rng::Rng;
use nalgebra::Vector3;

/// Where a fan is to end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FanEnd {
    /// On the face: that stripe does not cross it, and the frame must be refused.
    OnFace,
    /// Just past it, by up to 5 % of the stripe: the face can be measured, but nothing is lit beyond that end.
    Beyond,
}

/// How far past the stripe's end the fan's may be, as a share of the stripe.
const MOST_BEYOND: f64 = 0.05;
/// A fan is never narrower than this, half of it, rad.
const NARROWEST_RAD: f64 = 0.07;

/// Leaves one laser a third of its power.
pub(super) fn weaken(rng: &mut Rng, beams: &mut [Beam; 4]) {
    beams[rng.below(4)].power /= 3.0;
}

/// Narrows one fan so that it ends at one of the faces that are looked at; all `poses` keep their four stripes if it is to end
/// beyond. `None` if no fan can.
pub(super) fn end_fan(
    rng: &mut Rng,
    head: &Head,
    beams: &[Beam; 4],
    poses: &[FacePose],
    wanted: FanEnd,
) -> Option<[Beam; 4]> {
    let first = rng.below(4);
    (0..4).map(|i| (first + i) % 4).find_map(|laser| {
        let beam = &beams[laser];
        // Of the stripes' ends on all faces the one that is farthest from the fan's middle, with the stripe's other end.
        let mut widest: Option<(f64, [Vector3<f64>; 2])> = None;
        for pose in poses {
            let crossing = pose.crossing(head, laser, 0.0)?;
            let [a, b] = crossing.at.map(|[right, down]| pose.point(right, down) - beam.source_mm);
            for (far, near) in [(a, b), (b, a)] {
                let angle = far.angle(&beam.forward);
                if widest.is_none_or(|w| angle > w.0) {
                    widest = Some((angle, [far, near]));
                }
            }
        }
        let (angle, [far, near]) = widest?;
        let half_at = |share: f64| (far + (far - near) * share).angle(&beam.forward);
        let half_rad = match wanted {
            FanEnd::OnFace => half_at(-rng.range(0.08, 0.35)),
            FanEnd::Beyond => rng.range((angle / FULLY_LIT) * 1.001, half_at(MOST_BEYOND)),
        };
        let right = match wanted {
            // The other end is lit.
            FanEnd::OnFace => near.angle(&beam.forward) < 0.9 * half_rad,
            FanEnd::Beyond => (angle / FULLY_LIT..half_at(MOST_BEYOND)).contains(&half_rad),
        };
        let mut narrowed = *beams;
        narrowed[laser].fan_half_rad = half_rad;
        (right && (NARROWEST_RAD..beam.fan_half_rad).contains(&half_rad)).then_some(narrowed)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hazard::{Hazard, Hazards};
    use crate::pose::Refuse;
    use crate::stock::Stock;
    use crate::truth::{Shot, face_of, face_truth};
    use crate::world::{Plan, Scene, compose};

    fn scenes(hazard: Hazard, plan: Plan) -> impl Iterator<Item = (Head, Scene)> {
        let stock = Stock { hazards: Hazards::only(&[hazard]), ..Stock::default() };
        (0..400).filter_map(move |seed| {
            let head = Head::random(&mut Rng::new(seed, 1)).unwrap();
            let scene = compose(&mut Rng::new(seed, 2), &head, plan, &stock);
            scene.hazards.contains(&hazard).then_some((head, scene))
        })
    }

    #[test]
    fn a_weak_laser_has_a_third_of_its_power_and_the_others_all_of_it() {
        let mut count = 0;
        for (head, scene) in scenes(Hazard::WeakLaser, Plan::Face) {
            let shares = [0, 1, 2, 3].map(|i| scene.beams[i].power / head.beams[i].power);
            assert_eq!(shares.iter().filter(|s| (**s - 1.0 / 3.0).abs() < 1e-12).count(), 1, "{shares:?}");
            assert_eq!(shares.iter().filter(|s| **s == 1.0).count(), 3, "{shares:?}");
            count += 1;
        }
        assert!((14..=60).contains(&count), "{count} of 400");
    }

    #[test]
    fn a_fan_that_ends_beyond_leaves_four_stripes_and_one_on_the_face_three() {
        for (plan, stripes, least) in [(Plan::Box, 4, 4), (Plan::Refused(Refuse::StripeMissing), 3, 20)] {
            let mut count = 0;
            for (head, scene) in scenes(Hazard::FanEnd, plan) {
                let narrowed = (0..4).filter(|i| scene.beams[*i].fan_half_rad < head.beams[*i].fan_half_rad);
                assert_eq!(narrowed.count(), 1);
                for view in &scene.views {
                    let face = face_of(&scene, view).unwrap();
                    assert!(face.crossings(&head, 1.9, 11.9).is_some());
                    let crossed = (0..4).filter(|i| face.crossing(&scene.head(&head), *i, 0.0).is_some());
                    assert_eq!(crossed.count(), stripes);
                    let shot = Shot { scene: &scene, view, id: "a".into(), off: None };
                    let truth = face_truth(&head, &shot, &Stock::default());
                    assert_eq!(truth["key_points_px"].as_object().unwrap().len(), stripes);
                }
                count += 1;
            }
            assert!(count >= least, "{plan:?}: {count} of 400");
        }
    }

    #[test]
    fn oblique_faces_are_seen_at_40_to_65_degrees_and_can_be_measured() {
        let (mut scenes_met, mut steepest) = (0, 0.0f64);
        for (head, scene) in scenes(Hazard::Oblique, Plan::Box) {
            let faces = scene.views.iter().map(|v| face_of(&scene, v).unwrap());
            let angles: Vec<f64> = faces
                .inspect(|face| assert!(face.crossings(&head, 1.9, 11.9).is_some()))
                .map(|face| face.angle_to_normal_rad().to_degrees())
                .collect();
            assert!(angles.iter().any(|a| (40.0..=65.0).contains(a)), "{angles:?}");
            steepest = angles.into_iter().fold(steepest, f64::max);
            scenes_met += 1;
        }
        assert!(scenes_met >= 10 && steepest > 50.0, "{scenes_met} scenes, {steepest} degrees");
    }
}
