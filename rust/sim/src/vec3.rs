//! Three floats for the ray caster: `f32` carries 0.0002 mm at 3 m and 0.0002 px, and is twice as fast as core's `f64`.

use nalgebra::{Matrix3, Vector3};
use std::ops::{Add, AddAssign, Index, Mul, Neg, Sub};

/// A vector, mm or unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct V3 {
    /// x
    pub x: f32,
    /// y
    pub y: f32,
    /// z
    pub z: f32,
}

/// Shorthand for a vector.
#[inline]
#[must_use]
pub const fn v3(x: f32, y: f32, z: f32) -> V3 {
    V3 { x, y, z }
}

impl V3 {
    /// Scalar product.
    #[inline]
    #[must_use]
    pub fn dot(self, o: Self) -> f32 {
        self.x * o.x + self.y * o.y + self.z * o.z
    }

    /// Length.
    #[inline]
    #[must_use]
    pub fn norm(self) -> f32 {
        self.dot(self).sqrt()
    }

    /// The same direction with length one.
    #[inline]
    #[must_use]
    pub fn unit(self) -> Self {
        self * (1.0 / self.norm().max(1e-20))
    }

    /// Absolute value of each.
    #[inline]
    #[must_use]
    pub fn abs(self) -> Self {
        v3(self.x.abs(), self.y.abs(), self.z.abs())
    }

    /// The larger of each.
    #[inline]
    #[must_use]
    pub fn max(self, low: f32) -> Self {
        v3(self.x.max(low), self.y.max(low), self.z.max(low))
    }

    /// Product of each with each.
    #[inline]
    #[must_use]
    pub fn times(self, o: Self) -> Self {
        v3(self.x * o.x, self.y * o.y, self.z * o.z)
    }

    /// The largest of the three.
    #[inline]
    #[must_use]
    pub fn largest(self) -> f32 {
        self.x.max(self.y).max(self.z)
    }
}

impl From<Vector3<f64>> for V3 {
    fn from(v: Vector3<f64>) -> Self {
        v3(v.x as f32, v.y as f32, v.z as f32)
    }
}

impl Add for V3 {
    type Output = Self;
    #[inline]
    fn add(self, o: Self) -> Self {
        v3(self.x + o.x, self.y + o.y, self.z + o.z)
    }
}

impl AddAssign for V3 {
    #[inline]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}

impl Sub for V3 {
    type Output = Self;
    #[inline]
    fn sub(self, o: Self) -> Self {
        v3(self.x - o.x, self.y - o.y, self.z - o.z)
    }
}

impl Mul<f32> for V3 {
    type Output = Self;
    #[inline]
    fn mul(self, s: f32) -> Self {
        v3(self.x * s, self.y * s, self.z * s)
    }
}

impl Neg for V3 {
    type Output = Self;
    #[inline]
    fn neg(self) -> Self {
        v3(-self.x, -self.y, -self.z)
    }
}

impl Index<usize> for V3 {
    type Output = f32;
    #[inline]
    fn index(&self, i: usize) -> &f32 {
        match i {
            0 => &self.x,
            1 => &self.y,
            _ => &self.z,
        }
    }
}

/// A rotation by rows.
#[derive(Clone, Copy, Debug)]
pub struct Rows {
    rows: [V3; 3],
}

impl Rows {
    /// From core's matrix.
    #[must_use]
    pub fn new(m: &Matrix3<f64>) -> Self {
        Self { rows: [0, 1, 2].map(|i| m.row(i).transpose().into()) }
    }

    /// Matrix times vector.
    #[inline]
    #[must_use]
    pub fn apply(&self, v: V3) -> V3 {
        v3(self.rows[0].dot(v), self.rows[1].dot(v), self.rows[2].dot(v))
    }

    /// Transposed matrix times vector.
    #[inline]
    #[must_use]
    pub fn apply_transposed(&self, v: V3) -> V3 {
        self.rows[0] * v.x + self.rows[1] * v.y + self.rows[2] * v.z
    }
}
