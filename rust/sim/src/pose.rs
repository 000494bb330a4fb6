//! Where the head may stand so that a face can be measured, computed exactly: each stripe must cross two opposite edges
//! of the face inside the image and inside its fan, and the face must fit the image.

use crate::head::{Head, SENSOR_PX};
use crate::rng::Rng;
use boxline::Px;
use boxline::frames::Point;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// A fan's light is whole up to this share of its opening.
pub(crate) const FULLY_LIT: f64 = 0.97;

/// A rectangle in the camera frame: one sharp face of a box.
#[derive(Clone, Copy, Debug)]
pub struct FacePose {
    /// Columns: right, down (as pictures on the face run), and into the box.
    pub cam_from_face: Matrix3<f64>,
    /// The face's middle, mm.
    pub centre: Vector3<f64>,
    /// Half sizes along right and down, mm.
    pub half: [f64; 2],
}

/// Along which picture axis of the face a stripe runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Along {
    /// It crosses the left and the right edge.
    Right,
    /// It crosses the upper and the lower edge.
    Down,
}

/// One stripe on a face: the two points where the laser's plane meets the sharp edges, face mm (right, down).
#[derive(Clone, Copy, Debug)]
pub struct Crossing {
    /// Direction of the stripe.
    pub along: Along,
    /// The two key points on the face, mm.
    pub at: [[f64; 2]; 2],
}

/// Why a frame cannot be measured; the words of the truth file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refuse {
    /// A stripe does not cross two opposite edges.
    StripeMissing,
    /// A key point or corner lies outside the image.
    CutByBorder,
    /// There is no box.
    NoBox,
    /// One laser does not shine.
    LaserDead,
    /// Something hides a corner, a stripe's end or a piece of a side.
    Hidden,
}

impl Refuse {
    /// The word in the truth file.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::StripeMissing => "stripe_missing",
            Self::CutByBorder => "face_cut_by_border",
            Self::NoBox => "no_box",
            Self::LaserDead => "laser_dead",
            Self::Hidden => "face_hidden",
        }
    }
}

impl FacePose {
    /// A point of the face (mm right and down of its middle) in the camera frame.
    #[must_use]
    pub fn point(&self, right: f64, down: f64) -> Vector3<f64> {
        self.centre + self.cam_from_face.column(0) * right + self.cam_from_face.column(1) * down
    }

    /// The four sharp corners in the camera frame, in the order of the truth file: 0-1 and 3-2 along the length.
    #[must_use]
    pub fn corners(&self) -> [Vector3<f64>; 4] {
        let [a, b] = self.half;
        if a >= b {
            [self.point(-a, -b), self.point(a, -b), self.point(a, b), self.point(-a, b)]
        } else {
            [self.point(a, -b), self.point(a, b), self.point(-a, b), self.point(-a, -b)]
        }
    }

    /// Length and width, the longer first, mm.
    #[must_use]
    pub fn size_mm(&self) -> [f64; 2] {
        let (a, b) = (self.half[0] * 2.0, self.half[1] * 2.0);
        [a.max(b), a.min(b)]
    }

    /// Angle between the line of sight to the middle and the face's normal, rad.
    #[must_use]
    pub fn angle_to_normal_rad(&self) -> f64 {
        (self.cam_from_face.column(2).dot(&self.centre) / self.centre.norm()).clamp(-1.0, 1.0).acos()
    }

    /// Where the plane of laser `index` crosses opposite edges; `None` if it does not, or outside its fan.
    /// `margin_mm` keeps the key points away from the corners.
    #[must_use]
    pub fn crossing(&self, head: &Head, index: usize, margin_mm: f64) -> Option<Crossing> {
        let p = head.plane(index);
        let a = p.dot(&self.cam_from_face.column(0));
        let b = p.dot(&self.cam_from_face.column(1));
        let c = 1.0 - p.dot(&self.centre);
        let [ha, hb] = self.half;
        let fits = |ends: [f64; 2], limit: f64| {
            ends.iter().all(|e| e.is_finite() && e.abs() <= limit - margin_mm).then_some(ends)
        };
        let down = fits([(c + a * ha) / b, (c - a * ha) / b], hb);
        let right = fits([(c + b * hb) / a, (c - b * hb) / a], ha);
        let crossing = match (down, right) {
            (Some([first, second]), _) => Crossing { along: Along::Right, at: [[-ha, first], [ha, second]] },
            (None, Some([first, second])) => {
                Crossing { along: Along::Down, at: [[first, -hb], [second, hb]] }
            }
            (None, None) => return None,
        };
        let beam = &head.beams[index];
        let in_fan = crossing.at.iter().all(|[right, down]| {
            let to = self.point(*right, *down) - beam.source_mm;
            to.angle(&beam.forward) < beam.fan_half_rad * FULLY_LIT
        });
        in_fan.then_some(crossing)
    }

    /// The pixel of a face point, if it is in front of the camera and within the image by `margin_px`.
    #[must_use]
    pub fn px_inside(&self, head: &Head, at: [f64; 2], margin_px: f64) -> Option<Px> {
        let px = px_of(head, &self.point(at[0], at[1]))?;
        inside(px, margin_px).then_some(px)
    }

    /// All four crossings, if the face can be measured: pairs run along different sides, corners and key points inside.
    #[must_use]
    pub fn crossings(&self, head: &Head, margin_mm: f64, margin_px: f64) -> Option<[Crossing; 4]> {
        let [ha, hb] = self.half;
        for corner in [[-ha, -hb], [ha, -hb], [ha, hb], [-ha, hb]] {
            self.px_inside(head, corner, margin_px)?;
        }
        let all = [
            self.crossing(head, 0, margin_mm)?,
            self.crossing(head, 1, margin_mm)?,
            self.crossing(head, 2, margin_mm)?,
            self.crossing(head, 3, margin_mm)?,
        ];
        let pairs =
            all[0].along == all[1].along && all[2].along == all[3].along && all[0].along != all[2].along;
        let seen = all.iter().flat_map(|c| c.at).all(|at| self.px_inside(head, at, margin_px).is_some());
        (pairs && seen).then_some(all)
    }
}

/// The pixel of a point of the camera frame.
#[must_use]
pub fn px_of(head: &Head, point: &Vector3<f64>) -> Option<Px> {
    head.calibration.camera().px_from_point(&Point::from_vector(*point))
}

/// Whether a pixel position is inside the image by a margin.
#[must_use]
pub fn inside(px: Px, margin_px: f64) -> bool {
    let [w, h] = SENSOR_PX.map(f64::from);
    px.u >= margin_px - 0.5
        && px.v >= margin_px - 0.5
        && px.u <= w - 0.5 - margin_px
        && px.v <= h - 0.5 - margin_px
}

/// A random orientation of a face before the head: rolled by about 45 degrees either way, tilted up to `most_deg`.
pub fn random_orientation(rng: &mut Rng, upright: bool, most_deg: f64) -> Matrix3<f64> {
    let tilt_deg = most_deg * rng.unit().powf(0.8);
    tilted_orientation(rng, upright, tilt_deg)
}

/// The same, tilted by `tilt_deg` in any direction.
pub fn tilted_orientation(rng: &mut Rng, upright: bool, tilt_deg: f64) -> Matrix3<f64> {
    // A person holds the head within half a turn of upright; over a lying face every quarter turn is alike.
    let quarter = if upright { usize::from(rng.chance(0.08)) * 2 } else { rng.below(4) };
    let roll = rng.sign() * (45.0 + rng.normal() * 5.0).clamp(30.0, 60.0) + 90.0 * quarter as f64;
    let azimuth = rng.range(0.0, std::f64::consts::TAU);
    let axis = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0);
    let tilted = Rotation3::new(axis * tilt_deg.to_radians());
    (tilted * Rotation3::from_axis_angle(&Vector3::z_axis(), roll.to_radians())).into_inner()
}

/// A face before the head: rolled, then tilted about an axis in the image (0 is its horizontal), degrees.
#[cfg(test)]
pub(crate) fn turned(roll_deg: f64, tilt_deg: f64, axis_deg: f64) -> Matrix3<f64> {
    let axis = Vector3::new(axis_deg.to_radians().cos(), axis_deg.to_radians().sin(), 0.0);
    let roll = Rotation3::from_axis_angle(&Vector3::z_axis(), roll_deg.to_radians());
    (Rotation3::new(axis * tilt_deg.to_radians()) * roll).into_inner()
}

/// The middle of the 2 x 2 grid on a plane `n . X = offset`.
#[must_use]
pub fn grid_centre(head: &Head, normal: Vector3<f64>, offset_mm: f64) -> Option<Vector3<f64>> {
    let mut sum = Vector3::zeros();
    for (i, j) in [(0, 2), (0, 3), (1, 2), (1, 3)] {
        let (p, q) = (head.plane(i), head.plane(j));
        let m = Matrix3::from_rows(&[p.transpose(), q.transpose(), normal.transpose()]);
        sum += m.try_inverse()? * Vector3::new(1.0, 1.0, offset_mm);
    }
    Some(sum / 4.0)
}

/// How much room a hand that trembles needs: corners and key points keep this clear of the image's border ...
const ROOM_PX: f64 = 60.0;
/// ... and key points of the corners (share of the face's shorter half, and at least), mm.
const ROOM_SHARE: f64 = 0.02;
const ROOM_MM: f64 = 6.0;
/// Where on the face the head is aimed, shares of its half sizes: tried from the middle outwards.
const AIM_STEPS: i32 = 6;
const AIM_STEP: f64 = 0.1;

/// The nearest depth at which `pose_at` a depth and an aim can be measured with room for a trembling hand, and the aim nearest to the
/// face's middle that does.
fn nearest(
    head: &Head,
    half: [f64; 2],
    pose_at: impl Fn(f64, [f64; 2]) -> Option<FacePose>,
) -> Option<(f64, [f64; 2], FacePose)> {
    let steps = -AIM_STEPS..=AIM_STEPS;
    let mut aims: Vec<[i32; 2]> = steps.clone().flat_map(|i| steps.clone().map(move |j| [i, j])).collect();
    aims.sort_by_key(|[i, j]| i * i + j * j);
    let mut depth = 0.75 * half[0].max(half[1]).max(150.0);
    while depth < 3400.0 {
        for aim in &aims {
            let aim = aim.map(|step| f64::from(step) * AIM_STEP);
            if let Some(face) = pose_at(depth, aim).filter(|face| has_room(face, head)) {
                return Some((depth, aim, face));
            }
        }
        depth *= 1.015;
    }
    None
}

fn has_room(face: &FacePose, head: &Head) -> bool {
    let margin_mm = (ROOM_SHARE * face.half[0].min(face.half[1])).max(ROOM_MM);
    face.crossings(head, margin_mm, ROOM_PX).is_some()
}

/// A face whose middle is seen from a direction: so many degrees to the right of its normal and above it. The head is rolled by
/// `roll_deg` and stands as near as the face allows. `None` if it cannot be measured from there.
#[must_use]
pub fn place_seen_from(
    head: &Head,
    size_mm: [f64; 2],
    [right_deg, up_deg]: [f64; 2],
    roll_deg: f64,
) -> Option<FacePose> {
    let half = size_mm.map(|s| s / 2.0);
    let ((right_sin, right_cos), (up_sin, up_cos)) =
        (right_deg.to_radians().sin_cos(), up_deg.to_radians().sin_cos());
    let towards_head = Vector3::new(right_sin * up_cos, -up_sin, -right_cos * up_cos);
    let roll = Rotation3::from_axis_angle(&Vector3::z_axis(), roll_deg.to_radians());
    let pose_at = |distance_mm: f64, aim: [f64; 2]| {
        let head_in_face = towards_head * distance_mm;
        let aimed_at = Vector3::new(aim[0] * half[0], aim[1] * half[1], 0.0);
        let forward = (aimed_at - head_in_face).normalize();
        let right = Vector3::new(forward.z, 0.0, -forward.x).try_normalize(1e-9)?;
        let upright = Matrix3::from_columns(&[right, forward.cross(&right), forward]).transpose();
        let cam_from_face = roll * upright;
        Some(FacePose { cam_from_face, centre: -(cam_from_face * head_in_face), half })
    };
    nearest(head, half, pose_at).map(|(.., face)| face)
}

/// Farther than nearest by so much: a courier steps back until all is in the picture, and a little more.
const STEP_BACK: (f64, f64) = (1.02, 1.25);
/// ... but not beyond the head's range, mm.
const FARTHEST_MM: f64 = 2450.0;

/// A face of this size and orientation as a courier would hold the head before it: as near as it allows or a little farther, aimed by
/// eye. `None` if it cannot be measured in this orientation.
pub fn place_by_hand(
    rng: &mut Rng,
    head: &Head,
    size_mm: [f64; 2],
    cam_from_face: Matrix3<f64>,
) -> Option<FacePose> {
    let half = size_mm.map(|s| s / 2.0);
    let normal: Vector3<f64> = cam_from_face.column(2).into();
    let pose_at = |depth: f64, aim: [f64; 2]| {
        let centre = grid_centre(head, normal, normal.z * depth)?;
        let centred = FacePose { cam_from_face, centre, half };
        (centre.z > 150.0)
            .then(|| FacePose { centre: centred.point(aim[0] * half[0], aim[1] * half[1]), ..centred })
    };
    let (depth, aim, near) = nearest(head, half, pose_at)?;
    let by_hand = (0..60).find_map(|_| {
        let farther = depth * rng.range(STEP_BACK.0, STEP_BACK.1);
        let off = aim.map(|a| a * rng.unit() + 0.08 * rng.normal());
        pose_at(farther, off).filter(|face| face.centre.norm() < FARTHEST_MM && has_room(face, head))
    });
    Some(by_hand.unwrap_or(near))
}

/// A face of this size and orientation where it can be measured; `None` if there is no such place.
pub fn place_face(
    rng: &mut Rng,
    head: &Head,
    size_mm: [f64; 2],
    cam_from_face: Matrix3<f64>,
) -> Option<FacePose> {
    let half = [size_mm[0] / 2.0, size_mm[1] / 2.0];
    let margin_mm = (0.02 * half[0].min(half[1])).max(2.0);
    let margin_px = 12.0;
    let normal: Vector3<f64> = cam_from_face.column(2).into();
    let centred = |depth: f64| -> Option<FacePose> {
        let centre = grid_centre(head, normal, normal.z * depth)?;
        (centre.z > 150.0).then_some(FacePose { cam_from_face, centre, half })
    };
    // First all depths at which the face could be measured with the grid near its middle ...
    let mut fits = Vec::new();
    let mut depth = 0.75 * half[0].max(half[1]).max(150.0);
    while depth < 3400.0 {
        if let Some(face) = centred(depth) {
            for _ in 0..6 {
                let shifted = shift(rng, &face, 0.12);
                if shifted.crossings(head, margin_mm, margin_px).is_some() {
                    fits.push((depth, shifted));
                    break;
                }
            }
        }
        depth *= 1.025;
    }
    if fits.is_empty() {
        return None;
    }
    // ... then one of them, moved about as a hand would.
    let (depth, fallback) = fits[rng.below(fits.len())];
    for _ in 0..30 {
        let about = depth * rng.range(0.985, 1.015);
        let moved = shift(rng, &centred(about)?, 0.3);
        if moved.crossings(head, margin_mm, margin_px).is_some() {
            return Some(moved);
        }
    }
    Some(fallback)
}

/// A face that must be refused for `reason`, near to where it could be measured.
pub fn place_unmeasurable(
    rng: &mut Rng,
    head: &Head,
    size_mm: [f64; 2],
    cam_from_face: Matrix3<f64>,
    reason: Refuse,
) -> Option<FacePose> {
    let good = place_face(rng, head, size_mm, cam_from_face)?;
    if reason == Refuse::LaserDead {
        return Some(good);
    }
    for _ in 0..300 {
        let depth = rng.range(0.6, 1.3);
        let mut face = shift(rng, &good, 1.0);
        face.centre *= depth;
        let crossings = (0..4).filter(|i| face.crossing(head, *i, 0.0).is_some()).count();
        let [a, b] = face.half;
        let seen = [[-a, -b], [a, -b], [a, b], [-a, b]]
            .iter()
            .filter(|c| face.px_inside(head, **c, 0.0).is_some())
            .count();
        // Clearly so: a stripe must miss by more than a hand's breadth of pixels, a border cut off a whole corner.
        let wanted = match reason {
            Refuse::StripeMissing => {
                let clear = (0..4).any(|i| misses_clearly(&face, head, i));
                crossings < 4 && clear && seen == 4
            }
            _ => {
                let lost = (0..4)
                    .filter_map(|i| face.crossing(head, i, 0.0))
                    .any(|c| c.at.iter().any(|at| face.px_inside(head, *at, -40.0).is_none()));
                crossings == 4 && lost && (1..=3).contains(&seen)
            }
        };
        if wanted {
            return Some(face);
        }
    }
    None
}

/// Whether laser `index` runs past one of the edges that it would have to cross by 3 % of the face.
fn misses_clearly(face: &FacePose, head: &Head, index: usize) -> bool {
    let slack = -0.03 * (face.half[0] + face.half[1]);
    face.crossing(head, index, slack).is_none()
}

fn shift(rng: &mut Rng, face: &FacePose, share: f64) -> FacePose {
    let right = face.half[0] * share * rng.range(-1.0, 1.0);
    let down = face.half[1] * share * rng.range(-1.0, 1.0);
    FacePose { centre: face.point(right, down), ..*face }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How often a face of this size finds a place.
    fn share_placed(size_mm: [f64; 2]) -> f64 {
        let head = Head::nominal().unwrap();
        let mut rng = Rng::new(3, 0);
        let mut placed = 0;
        for _ in 0..20 {
            let r = random_orientation(&mut rng, true, 30.0);
            if let Some(face) = place_face(&mut rng, &head, size_mm, r) {
                assert!(face.crossings(&head, 1.9, 11.9).is_some());
                placed += 1;
            }
        }
        f64::from(placed) / 20.0
    }

    #[test]
    fn faces_from_100_to_1800_mm_find_places_and_narrow_ones_do_not() {
        assert!(share_placed([143.0, 120.0]) > 0.3);
        assert!(share_placed([550.0, 350.0]) > 0.7);
        assert!(share_placed([1800.0, 900.0]) > 0.7);
        assert!(share_placed([900.0, 100.0]) < 0.01);
    }

    #[test]
    fn a_face_is_seen_from_where_it_was_asked_and_as_near_as_it_allows() {
        let head = Head::nominal().unwrap();
        for (from_deg, across, sign) in [
            ([0.0, 0.0], 0, 0.0),
            ([60.0, 0.0], 0, 1.0),
            ([-30.0, 0.0], 0, -1.0),
            ([0.0, 60.0], 1, -1.0),
            ([0.0, -60.0], 1, 1.0),
        ] {
            let face = place_seen_from(&head, [800.0, 600.0], from_deg, 45.0).unwrap();
            assert!(face.crossings(&head, 6.0, 60.0).is_some());
            let wanted = from_deg[0].abs().max(from_deg[1].abs());
            assert!((face.angle_to_normal_rad().to_degrees() - wanted).abs() < 1e-6, "{from_deg:?}");
            // Where the head is, right and down of the face's middle.
            let head_in_face = -(face.cam_from_face.transpose() * face.centre);
            assert!(
                head_in_face.z < 0.0 && head_in_face[across] * sign >= 0.0,
                "{from_deg:?}: {head_in_face}"
            );
            assert!((1000.0..1400.0).contains(&face.centre.norm()), "{from_deg:?}: {}", face.centre.norm());
        }
        assert!(place_seen_from(&head, [800.0, 10.0], [0.0, 0.0], 45.0).is_none());
    }

    #[test]
    fn a_courier_holds_the_head_near_and_never_too_far() {
        let head = Head::nominal().unwrap();
        let mut rng = Rng::new(11, 0);
        for size_mm in [[143.4, 120.5], [1200.0, 900.0]] {
            let mut placed = 0;
            for _ in 0..20 {
                let r = random_orientation(&mut rng, true, 20.0);
                let Some(face) = place_by_hand(&mut rng, &head, size_mm, r) else { continue };
                placed += 1;
                assert!(face.crossings(&head, 2.0, 12.0).is_some());
                assert!(face.centre.norm() < 2500.0, "{} mm", face.centre.norm());
            }
            assert!(placed > 10, "{size_mm:?}: {placed} of 20");
        }
    }

    #[test]
    fn key_points_lie_on_their_laser_plane_and_on_edges() {
        let head = Head::nominal().unwrap();
        let mut rng = Rng::new(9, 0);
        let r = random_orientation(&mut rng, true, 20.0);
        let face = place_face(&mut rng, &head, [400.0, 300.0], r).unwrap();
        for (i, c) in face.crossings(&head, 0.0, 0.0).unwrap().iter().enumerate() {
            for at in c.at {
                let point = face.point(at[0], at[1]);
                assert!((head.plane(i).dot(&point) - 1.0).abs() < 1e-12);
                let on_edge = (at[0].abs() - 200.0).abs() < 1e-9 || (at[1].abs() - 150.0).abs() < 1e-9;
                assert!(on_edge);
            }
        }
    }
}
