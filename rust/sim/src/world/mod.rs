//! A scene in world coordinates: z up, floor at z = 0, the target box upright about x = y = 0, its front towards -y.
//!
//! [`mod@compose`] draws a whole measurement (box, poses, surroundings, light), [`twin`] one of a box that is given; [`View`]
//! says where the head stands.

mod beams;
pub mod compose;
pub mod detour;
pub mod flap;
pub mod light;
mod neighbours;
pub mod occluder;
pub mod room;
pub mod stand;
pub mod twin;

pub use compose::{Plan, Scene, compose, empty};
pub use detour::Bounce;
pub use light::Lighting;
pub use occluder::Hidden;

use crate::material::Appearance;
use crate::pose::FacePose;
use crate::shape::Shape;
use crate::solid::{Solid, face_axes, face_beside};
use nalgebra::{Matrix3, Rotation3, Vector3};

/// What a body is in the truth and the labels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// The box to be measured.
    Target,
    /// Another box.
    Carton,
    /// A flap of a box that stands open.
    Flap,
    /// What boxes stand on: pallet, table, shelf.
    Stand,
    /// Floor, wall, rack.
    Room,
    /// Something that hides parts of the target: hand, post, strap, roll; a box that does is a carton.
    Occluder,
}

/// A cuboid of the scene.
#[derive(Clone, Debug)]
pub struct Body {
    /// Middle, mm.
    pub centre: Vector3<f64>,
    /// World from body.
    pub rotation: Matrix3<f64>,
    /// Half sizes, mm.
    pub half: Vector3<f64>,
    /// Rounding, bulges, waves.
    pub shape: Shape,
    /// Appearance.
    pub look: Appearance,
    /// Meaning.
    pub role: Role,
}

impl Body {
    /// An upright body, turned by `yaw_rad` about z, given by its foot (the middle of its underside).
    #[must_use]
    pub fn upright(
        foot: Vector3<f64>,
        size: Vector3<f64>,
        yaw_rad: f64,
        look: Appearance,
        role: Role,
    ) -> Self {
        Self {
            centre: foot + Vector3::z() * (size.z / 2.0),
            rotation: Rotation3::from_axis_angle(&Vector3::z_axis(), yaw_rad).into_inner(),
            half: size / 2.0,
            shape: Shape::default(),
            look,
            role,
        }
    }

    /// Rounds the edges.
    #[must_use]
    pub fn rounded(self, radius_mm: f64) -> Self {
        Self { shape: Shape { radius_mm, ..self.shape }, ..self }
    }

    /// Gives it a shape.
    #[must_use]
    pub fn shaped(self, shape: Shape) -> Self {
        Self { shape, ..self }
    }

    /// The body in the camera frame of a view.
    #[must_use]
    pub fn solid(&self, view: &View) -> Solid {
        Solid::new(&(view.cam_from_world * self.rotation), view.point(self.centre), self.half, &self.shape)
    }

    /// The face of the sharp box in the camera frame.
    #[must_use]
    pub fn face(&self, index: usize, view: &View) -> FacePose {
        let cam_from_face = view.cam_from_world * self.rotation * axes(index);
        let half = face_half(&self.half, index);
        let out = -axes(index).column(2) * self.half[index / 2];
        FacePose { cam_from_face, centre: view.point(self.centre + self.rotation * out), half }
    }

    /// From the innermost to the outermost place of an edge of a face, in the plane of that face, mm; edges as the face's picture
    /// axes have them: 0 left, 1 right, 2 upper, 3 lower.
    #[must_use]
    pub fn edge_wave_mm(&self, face: usize, side: usize) -> f32 {
        self.shape.edge_wave_mm(face, face_beside(face, side))
    }

    /// Whether the segment between two world points meets the body.
    #[must_use]
    pub fn blocks(&self, from: Vector3<f64>, to: Vector3<f64>) -> bool {
        let o = self.rotation.transpose() * (from - self.centre);
        let d = self.rotation.transpose() * (to - from);
        let (mut near, mut far) = (0.0f64, 0.9995f64);
        for axis in 0..3 {
            let inverse = 1.0 / if d[axis].abs() < 1e-12 { 1e-12 } else { d[axis] };
            let (a, b) = ((-self.half[axis] - o[axis]) * inverse, (self.half[axis] - o[axis]) * inverse);
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        near < far
    }

    /// Whether one of a grid of points within this body, a plate, lies in or on another.
    #[must_use]
    pub fn touches(&self, other: &Self) -> bool {
        const POINTS: usize = 8;
        let share = |i: usize| i as f64 / (POINTS - 1) as f64 * 2.0 - 1.0;
        (0..POINTS * POINTS).any(|i| {
            let at = Vector3::new(share(i / POINTS) * self.half.x, share(i % POINTS) * self.half.y, 0.0);
            other.distance_mm(self.centre + self.rotation * at) < self.half.z
        })
    }

    /// Width of the gap between two bodies along that of their axes along which it is widest, mm; negative if they overlap.
    #[must_use]
    pub fn apart_mm(&self, other: &Self) -> f64 {
        let between = other.centre - self.centre;
        let reach = |b: &Self, way: &Vector3<f64>| (b.rotation.transpose() * way).abs().dot(&b.half);
        let ways = (0..3).flat_map(|axis| [self, other].map(|b| b.rotation.column(axis).into_owned()));
        ways.map(|way| way.dot(&between).abs() - reach(self, &way) - reach(other, &way))
            .fold(f64::NEG_INFINITY, f64::max)
    }

    /// Distance of a world point to the body, mm; 0 inside.
    #[must_use]
    pub fn distance_mm(&self, point: Vector3<f64>) -> f64 {
        let p = self.rotation.transpose() * (point - self.centre);
        (p.abs() - self.half).map(|c| c.max(0.0)).norm()
    }
}

/// Columns right, down, into the box of a face in its body's frame.
#[must_use]
pub fn axes(face: usize) -> Matrix3<f64> {
    let (right, down) = face_axes(face);
    Matrix3::from_columns(&[right, down, right.cross(&down)])
}

/// Half sizes of a face along right and down.
#[must_use]
pub fn face_half(half: &Vector3<f64>, face: usize) -> [f64; 2] {
    let (right, down) = face_axes(face);
    [right.component_mul(half).norm(), down.component_mul(half).norm()]
}

/// Where the head is.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Rotation from the world to the camera frame.
    pub cam_from_world: Matrix3<f64>,
    /// Camera's centre in the world, mm.
    pub camera_mm: Vector3<f64>,
    /// The face looked at.
    pub face: usize,
    /// Exposure: 1 maps a white surface under the face's light to full scale.
    pub exposure: f64,
    /// Laser light that comes by way of another surface.
    pub bounce: Option<Bounce>,
}

impl View {
    /// The view in which face `index` of an upright box about `box_centre` has the given pose.
    #[must_use]
    pub fn of_face(pose: &FacePose, index: usize, box_centre: Vector3<f64>, half: &Vector3<f64>) -> Self {
        let cam_from_world = pose.cam_from_face * axes(index).transpose();
        let face_centre = box_centre - axes(index).column(2) * half[index / 2];
        let camera_mm = face_centre - cam_from_world.transpose() * pose.centre;
        Self { cam_from_world, camera_mm, face: index, exposure: 1.0, bounce: None }
    }

    /// The view whose picture is this one's mirror image in the floor: of a camera that looks up from below it. Its frame is
    /// left-handed.
    #[must_use]
    pub fn in_floor(&self) -> Self {
        let flip = Vector3::new(1.0, 1.0, -1.0);
        Self {
            cam_from_world: self.cam_from_world * Matrix3::from_diagonal(&flip),
            camera_mm: self.camera_mm.component_mul(&flip),
            ..*self
        }
    }

    /// A world point in the camera frame.
    #[must_use]
    pub fn point(&self, world: Vector3<f64>) -> Vector3<f64> {
        self.cam_from_world * (world - self.camera_mm)
    }

    /// A point of the camera frame in the world.
    #[must_use]
    pub fn world(&self, cam: Vector3<f64>) -> Vector3<f64> {
        self.cam_from_world.transpose() * cam + self.camera_mm
    }
}
