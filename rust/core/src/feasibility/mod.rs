//! What a head can measure, and how well: from its calibration alone, before any picture. A face can be measured if stripes
//! 1 and 2 cross one pair of its sides, 3 and 4 the other, and all of it lies in the image (PHYSICS.md, "What can be
//! measured"). The same check says of a refused view how to move ([`hint`]).

pub mod hint;
mod obstacle;
mod sigma;

pub use hint::{Hint, Move};
pub use obstacle::Obstacle;
pub use sigma::SideSigmas;

use crate::calibration::Calibration;
use crate::face_geometry::view::FacePose;
use crate::frames::{Cam, Point};
use crate::reject::Reject;
use crate::units::Px;
use nalgebra::Vector3;
use obstacle::{MARGIN, grid_middle, obstacles};

/// Nearest and farthest distance that is tried, mm: the stripes are blurred before and faint beyond.
pub(crate) const DISTANCES_MM: (f64, f64) = (250.0, 3000.0);
/// The head is made for faces up to this distance, mm: the largest of 1800 x 900 mm fills the picture from 2.45 m on (PHYSICS.md). What
/// is known in pixels grows with distance, lines that the network cannot tell from an edge above all: UNCERTAINTY.md.
const FARTHEST_MM: f64 = 2500.0;

/// The refusal of a face that is farther away than the head is made for although from there, along the same line of sight, it could be
/// measured whole; a face too large for that is none. The corners go round the face.
#[must_use]
pub fn too_far(calibration: &Calibration, corners: [Point<Cam>; 4]) -> Option<Reject> {
    let pose = FacePose::from_corners(corners.map(|corner| corner.mm))?;
    let distance_mm = pose.middle.norm();
    let nearer = FacePose { middle: pose.middle * (FARTHEST_MM / distance_mm), ..pose };
    (distance_mm > FARTHEST_MM && obstacles(calibration, &nearer, 0.0).is_empty())
        .then_some(Reject::TooFar { distance_mm, limit_mm: FARTHEST_MM })
}

/// From one distance that is listed to the next. More lists fewer, and the nearest and farthest are known less exactly.
const LISTED_STEP: f64 = 1.03;

/// One distance from which a face can be measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorkingRange {
    /// Distance of the face's middle along the line of sight, mm.
    pub distance_mm: f64,
    /// Standard deviation of the length to expect there.
    pub length: SideSigmas,
    /// ... of the width.
    pub width: SideSigmas,
}

/// The distances from which a face of this size can be measured by a head that looks straight at it, rolled so that the
/// stripes run along its sides; nearest first, 3 % apart. Empty if there is none.
#[must_use]
pub fn working_ranges(calibration: &Calibration, length_mm: f64, width_mm: f64) -> Vec<WorkingRange> {
    let mut found = Vec::new();
    let mut distance_mm = DISTANCES_MM.0;
    while distance_mm <= DISTANCES_MM.1 {
        let pose = best_view(calibration, [length_mm, width_mm], distance_mm);
        if let Some(pose) = pose.filter(|pose| obstacles(calibration, pose, MARGIN).is_empty())
            && let Some([length, width]) = sigma::side_sigmas(calibration, &pose)
        {
            found.push(WorkingRange { distance_mm, length, width });
        }
        distance_mm *= LISTED_STEP;
    }
    found
}

/// The face straight ahead at this distance, rolled along the stripes, its middle where the picture and the grid leave most
/// room: between the picture's middle and the grid's.
fn best_view(calibration: &Calibration, size_mm: [f64; 2], distance_mm: f64) -> Option<FacePose> {
    let grid = grid_middle(calibration, distance_mm)?;
    let (width, height) = (f64::from(calibration.width_px()), f64::from(calibration.height_px()));
    let centre = calibration.camera().ray_from_px(Px::new(0.5 * (width - 1.0), 0.5 * (height - 1.0))).xy1;
    let room = |pose: &FacePose| obstacles(calibration, pose, MARGIN).len();
    let mut best: Option<(usize, FacePose)> = None;
    for share in [1.0, 0.75, 0.5, 0.25, 0.0] {
        for quarter in [0.0, 1.0] {
            let middle = (grid * share + centre * (1.0 - share)) * distance_mm;
            let angle = stripe_angle_rad(calibration, distance_mm)? + quarter * std::f64::consts::FRAC_PI_2;
            let along = Vector3::new(angle.cos(), angle.sin(), 0.0);
            let Some(pose) = FacePose::new(along, Vector3::z(), middle, size_mm) else { continue };
            let count = room(&pose);
            if best.as_ref().is_none_or(|(least, _)| count < *least) {
                best = Some((count, pose));
            }
        }
    }
    best.map(|(_, pose)| pose)
}

/// Direction along which stripes 1 and 2 run on a plane straight ahead; that of 3 and 4, less a right angle, counts alike.
fn stripe_angle_rad(calibration: &Calibration, distance_mm: f64) -> Option<f64> {
    // Twice the angle twice: directions without sign, right angles folded together.
    let (mut s, mut c) = (0.0, 0.0);
    for plane in calibration.lasers() {
        let line = plane.per_mm - Vector3::new(0.0, 0.0, 1.0 / distance_mm);
        let angle = line.x.atan2(-line.y);
        s += (4.0 * angle).sin();
        c += (4.0 * angle).cos();
    }
    (s.hypot(c) > 1e-6).then(|| 0.25 * s.atan2(c))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::face_geometry::simulation::{drawn_face, head};
    use crate::noise::Noise;

    /// PHYSICS.md: 100 mm boxes at about 0.35 m, 1800 mm at about 2.45 m, (length + width) <= 1.1 z, aspect up to 5.5 : 1.
    #[test]
    fn the_papers_head_reaches_what_physics_says() {
        let calibration = head();
        let range = |length: f64, width: f64| {
            let all = working_ranges(&calibration, length, width);
            all.first().zip(all.last()).map(|(near, far)| (near.distance_mm, far.distance_mm))
        };
        let (near, far) = range(1800.0, 900.0).expect("the largest box");
        assert!((2100.0..2600.0).contains(&near), "{near}");
        // The shorter side must exceed about 0.17 z: 900 mm do at any distance.
        assert!(far > 2800.0, "{far}");
        let (near, far) = range(100.0, 100.0).expect("the smallest box");
        assert!(near < 350.0 && (350.0..620.0).contains(&far), "{near} {far}");
        assert!(range(10.0, 10.0).is_none());
        assert!(range(40.0, 40.0).is_none());
        assert!(range(1000.0, 100.0).is_none(), "10 : 1");
        for (length, width) in [(300.0, 200.0), (600.0, 400.0), (1200.0, 800.0)] {
            let (near, _) = range(length, width).expect("an ordinary box");
            let filled = (length + width) / near;
            assert!((0.95..1.35).contains(&filled), "{length} x {width}: nearest at {near}, {filled} z");
        }
    }

    #[test]
    fn a_face_is_too_far_if_it_could_be_measured_from_nearer() {
        let calibration = head();
        let too_far_at = |size: [f64; 2], distance_mm: f64| {
            let pose = best_view(&calibration, size, distance_mm).expect("in front");
            too_far(&calibration, pose.corners().map(|corner| pose.point(corner)))
        };
        assert_eq!(too_far_at([800.0, 600.0], 2450.0), None);
        let found = too_far_at([800.0, 600.0], 3300.0);
        assert!(
            matches!(found, Some(Reject::TooFar { distance_mm, limit_mm })
                if (distance_mm - 3300.0).abs() < 100.0 && limit_mm == FARTHEST_MM),
            "{found:?}"
        );
        // The paper's largest sides on one face do not fit the picture from 2.5 m.
        assert_eq!(too_far_at([1800.0, 1800.0], 3400.0), None);
    }

    #[test]
    fn each_obstacle_is_named() {
        let calibration = head();
        let pose = best_view(&calibration, [600.0, 400.0], 1000.0).expect("in front");
        assert!(obstacles(&calibration, &pose, 0.0).is_empty());
        let mut near = pose;
        near.middle *= 0.5;
        assert!(obstacles(&calibration, &near, 0.0).contains(&Obstacle::OutsideImage));
        let small = FacePose { half_mm: [60.0, 60.0], ..pose };
        let misses = obstacles(&calibration, &small, 0.0);
        assert!(misses.iter().any(|o| matches!(o, Obstacle::StripeMisses(_))), "{misses:?}");
    }

    /// Faces that the simulation of `face_geometry` takes for measurable by its own words are so here.
    #[test]
    fn it_agrees_with_the_views_of_the_simulation() {
        let calibration = head();
        let mut noise = Noise::new(31);
        for _ in 0..200 {
            let pose = drawn_face(&calibration, &mut noise);
            assert!(obstacles(&calibration, &pose, 0.0).is_empty(), "{pose:?}");
        }
    }
}
