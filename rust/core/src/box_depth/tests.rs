//! Drawn boxes, ray by ray, with what may follow them: the depth must be told rightly or not at all.

use super::settle;
use crate::calibration::Calibration;
use crate::frames::{Plane, Point};
use crate::image::Frame;
use crate::measurement::{BoxMeasurement, DepthEstimate, FaceMeasurement};
use crate::paper_head::paper_head;
use crate::units::{Estimate, LaserId, Px, Volume};
use nalgebra::{Matrix3, Rotation3, Vector3};

/// What lies behind the box.
#[derive(Clone, Copy, PartialEq)]
enum Behind {
    /// A wall far away.
    Nothing,
    /// The floor that it stands on with its far end, as bright as the box.
    Floor,
    /// An equal box, flush, 4 mm of dark between them.
    EqualBox,
}

/// A box whose face is looked at: length x width, `depth_mm` behind it.
#[derive(Clone, Copy)]
struct Scene {
    length_mm: f64,
    width_mm: f64,
    depth_mm: f64,
    /// How far the head looks from beside, and from which side, rad.
    tilt_rad: f64,
    azimuth_rad: f64,
    distance_mm: f64,
    behind: Behind,
}

impl Scene {
    /// Columns: along the length, along the width, into the box.
    fn axes(&self) -> Matrix3<f64> {
        let axis = Vector3::new(self.azimuth_rad.cos(), self.azimuth_rad.sin(), 0.0);
        let roll = Rotation3::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_4);
        (Rotation3::new(axis * self.tilt_rad) * roll).into_inner()
    }

    /// The middle of the face: where the grid is at its distance.
    fn centre(&self) -> Vector3<f64> {
        Vector3::new(0.02 * self.distance_mm, -0.02 * self.distance_mm, self.distance_mm)
    }

    /// Where a ray ends and how bright it is there.
    fn hit(&self, ray: &Vector3<f64>) -> (Vector3<f64>, f64) {
        let turn = self.axes().transpose();
        let (from, way) = (-turn * self.centre(), turn * ray);
        let half = [self.length_mm / 2.0, self.width_mm / 2.0];
        // The nearest point of a cuboid between two depths, and the axis of the side that is hit.
        let cuboid = |low: f64, high: f64| {
            let (mut near, mut far, mut side) = (0.0, f64::INFINITY, 0);
            for (k, bounds) in [[-half[0], half[0]], [-half[1], half[1]], [low, high]].iter().enumerate() {
                let at = bounds.map(|b| (b - from[k]) / way[k]);
                let (a, b) = (at[0].min(at[1]), at[0].max(at[1]));
                if a > near {
                    (near, side) = (a, k);
                }
                far = f64::min(far, b);
            }
            (near < far).then(|| (ray * near, [70.0, 85.0, 100.0][side]))
        };
        let mut hit = cuboid(0.0, self.depth_mm);
        if self.behind == Behind::EqualBox {
            hit = hit.or_else(|| cuboid(self.depth_mm + 4.0, 2.0 * self.depth_mm + 4.0));
        }
        let beyond_mm = if self.behind == Behind::Floor { self.depth_mm } else { 4000.0 };
        hit.unwrap_or_else(|| (ray * ((beyond_mm - from.z) / way.z), 85.0))
    }

    fn frame(&self, calibration: &Calibration) -> Frame {
        let [width, height] = [calibration.width_px() as usize, calibration.height_px() as usize];
        let mut state = 1u32;
        let mut noise = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 16) / 65536.0 * 8.0 - 4.0
        };
        let mut rgb = Vec::with_capacity(width * height * 3);
        for i in 0..width * height {
            let px = Px::new((i % width) as f64, (i / width) as f64);
            let (at, brightness) = self.hit(&calibration.camera().ray_from_px(px).xy1);
            let mut red = 0.0;
            for laser in calibration.lasers() {
                let off_mm = (laser.per_mm.dot(&at) - 1.0) / laser.per_mm.norm();
                let off_px = off_mm * calibration.camera().fx / at.z;
                red += brightness * (-0.5 * (off_px / 2.0).powi(2)).exp();
            }
            let grey = brightness + noise();
            rgb.extend([grey + red, grey + 0.1 * red, grey + noise()].map(|v| v.clamp(0.0, 255.0) as u8));
        }
        Frame::from_rgb(width, height, rgb).expect("the size fits")
    }

    /// The face as it would be measured without error.
    fn face(&self, calibration: &Calibration) -> FaceMeasurement {
        let axes = self.axes();
        let point = |x: f64, y: f64| self.centre() + axes * Vector3::new(x, y, 0.0);
        let (a, b) = (self.length_mm / 2.0, self.width_mm / 2.0);
        let corners = [point(-a, -b), point(a, -b), point(a, b), point(-a, b)];
        let px = |x: Vector3<f64>| {
            calibration.camera().px_from_point(&Point::from_vector(x)).expect("before the camera")
        };
        let key_points_px = LaserId::ALL.map(|id| {
            let p = calibration.laser(id).per_mm;
            let crossings = (0..4).filter_map(|k| {
                let (from, to) = (corners[k], corners[(k + 1) % 4]);
                let t = (1.0 - p.dot(&from)) / p.dot(&(to - from));
                (0.0..=1.0).contains(&t).then(|| px(from + (to - from) * t))
            });
            let ends: Vec<Px> = crossings.collect();
            [ends[0], ends[1]]
        });
        let normal: Vector3<f64> = axes.column(2).into();
        FaceMeasurement {
            plane: Plane::new(normal / normal.dot(&self.centre())),
            corners_px: corners.map(px),
            corners: corners.map(Point::from_vector),
            key_points_px,
            ..FaceMeasurement::made_up(self.length_mm, self.width_mm)
        }
    }

    /// The candidate that is told by this view and one a little farther round, 0: as deep as wide, 1: as deep as long.
    fn found_depth(&self) -> Option<(usize, DepthEstimate)> {
        self.found_depth_with(&Scene { azimuth_rad: self.azimuth_rad + 0.4, ..*self })
    }

    /// The same by this view and another.
    fn found_depth_with(&self, second: &Self) -> Option<(usize, DepthEstimate)> {
        let calibration = paper_head(0.5);
        let frames = [self.frame(&calibration), second.frame(&calibration)];
        let faces = [self.face(&calibration), second.face(&calibration)];
        let side = |mm: f64| Estimate::new(mm, 0.5);
        let candidate = |length, width, height| BoxMeasurement {
            length: side(length),
            width: side(width),
            height: side(height),
            volume: Volume { value_m3: length * width * height * 1e-9, sigma_m3: 1e-5 },
        };
        let (a, b) = (self.length_mm, self.width_mm);
        let candidates = [candidate(a, b, b), candidate(a, a, b)];
        settle(&calibration, [&frames[0], &frames[1]], [&faces[0], &faces[1]], &candidates)
    }
}

const SCENE: Scene = Scene {
    length_mm: 300.0,
    width_mm: 220.0,
    depth_mm: 220.0,
    tilt_rad: 0.65,
    azimuth_rad: 0.6,
    distance_mm: 760.0,
    behind: Behind::Nothing,
};

#[test]
fn the_depth_tells_which_side_is_shared() {
    for behind in [Behind::Nothing, Behind::Floor] {
        for azimuth_rad in [0.6, 2.2, 3.8] {
            for (depth_mm, right) in [(220.0, 0), (300.0, 1)] {
                let (found, seen) = Scene { depth_mm, azimuth_rad, behind, ..SCENE }
                    .found_depth()
                    .expect("both sides are in view");
                assert_eq!(found, right, "{depth_mm} mm deep, seen from {azimuth_rad}: {seen:?}");
                assert!((seen.depth.value_mm - depth_mm).abs() < 3.0 * seen.depth.sigma_mm, "{seen:?}");
                assert!(seen.stripes >= 2 && seen.log_odds > 9.0, "{seen:?}");
            }
        }
    }
}

#[test]
fn nothing_is_told_where_nothing_is_seen() {
    assert_eq!(Scene { tilt_rad: 0.05, ..SCENE }.found_depth(), None, "looks straight at the face");
    assert_eq!(Scene { width_mm: 292.0, depth_mm: 292.0, ..SCENE }.found_depth(), None, "nearly a cube");
}

#[test]
fn equal_boxes_in_a_row_are_not_taken_for_one() {
    // Two boxes 300 x 150 x 150 look as deep as one of 300 x 300 x 150; three stripes of the first still end at the seam.
    let row =
        Scene { width_mm: 150.0, depth_mm: 150.0, distance_mm: 600.0, behind: Behind::EqualBox, ..SCENE };
    assert!(row.found_depth().is_none_or(|(found, _)| found == 0), "{:?}", row.found_depth());
    // The same for a row whose end is not at the other depth.
    let row = Scene { behind: Behind::EqualBox, ..SCENE };
    assert!(row.found_depth().is_none_or(|(found, _)| found == 0), "{:?}", row.found_depth());
}

/// Stripes of one frame may all end at one thing that is not the far end of the box, a box that stands on it: the other frame, which sees no
/// neighbouring face, cannot say so.
#[test]
fn one_frame_does_not_tell_the_depth() {
    for depth_mm in [220.0, 300.0] {
        let (oblique, straight) = (Scene { depth_mm, ..SCENE }, Scene { depth_mm, tilt_rad: 0.05, ..SCENE });
        for (first, second) in [(oblique, straight), (straight, oblique)] {
            assert_eq!(first.found_depth_with(&second), None, "{depth_mm} mm deep");
        }
    }
}
