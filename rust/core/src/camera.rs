//! The camera: the only doors between [`Px`] and rays. Paper eqs. 1-3.
//!
//! `K = [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]`; `(xd, yd, 1) = K^-1 (u, v, 1)` is the *distorted* normalised coordinate,
//! `r^2 = xd^2 + yd^2`, and the ideal one is
//!
//! ```text
//! x = xd (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 xd yd + p2 (r^2 + 2 xd^2)
//! y = yd (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 yd^2) + 2 p2 xd yd
//! ```
//!
//! The paper has k1 and k2 (eq. 3). k3, and p1 and p2 for a lens that is not centred on the axis (Brown, "Decentering distortion of
//! lenses", Photogrammetric Engineering 32, 1966), are 0 unless a calibration found that they are needed. The polynomial goes from distorted to
//! ideal, the opposite way to OpenCV's. So pixel to ray is closed, ray to pixel iterates.

use crate::error::{Error, ErrorKind};
use crate::frames::{Cam, Point, Ray};
use crate::units::Px;
use nalgebra::{Matrix2, Vector2};

/// Intrinsics and distortion of the head's camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraModel {
    /// Focal length along the rows, px.
    pub fx: f64,
    /// Focal length along the columns, px.
    pub fy: f64,
    /// Skew, px.
    pub skew: f64,
    /// Principal point, column, px.
    pub cx: f64,
    /// Principal point, row, px.
    pub cy: f64,
    /// Coefficient of r^2.
    pub k1: f64,
    /// Coefficient of r^4.
    pub k2: f64,
    /// Decentring along the columns.
    pub p1: f64,
    /// Decentring along the rows.
    pub p2: f64,
    /// Coefficient of r^6.
    pub k3: f64,
}

/// Largest skew of a camera, of its focal length: rad.
const MOST_SKEW: f64 = 0.01;

/// Newton steps of [`CameraModel::px_from_ray`]; it converges quadratically, 2 to 4 are used.
const MAX_STEPS: usize = 30;
/// Least slope of ideal over distorted: below, the polynomial turns back.
const LEAST_SLOPE: f64 = 0.05;
/// Places along each side of the sensor where the inverse is tried: polynomials of degree 7 do not turn back and forth between two.
const INVERSE_PLACES: u32 = 33;
/// How near to a pixel its ray leads back, px: a thousandth of what any stage sees.
const INVERSE_PX: f64 = 1e-5;

impl CameraModel {
    /// A focal length of 1 px and nothing else: what is not named in a camera with fewer terms.
    pub const PINHOLE: Self =
        Self { fx: 1.0, fy: 1.0, skew: 0.0, cx: 0.0, cy: 0.0, k1: 0.0, k2: 0.0, p1: 0.0, p2: 0.0, k3: 0.0 };

    /// Whether the distortion is the paper's: k1 and k2 alone.
    #[must_use]
    pub fn has_paper_lens(&self) -> bool {
        self.is_centred() && self.k3 == 0.0
    }

    fn is_centred(&self) -> bool {
        self.p1 == 0.0 && self.p2 == 0.0
    }

    /// The ideal ray of a pixel, closed form (eq. 3).
    #[must_use]
    pub fn ray_from_px(&self, px: Px) -> Ray<Cam> {
        self.ray_from_distorted(self.distorted_from_px(px))
    }

    /// The ideal ray of a pixel and its derivative: columns d(x, y)/du and d(x, y)/dv.
    #[must_use]
    pub fn ray_from_px_with_jacobian(&self, px: Px) -> (Ray<Cam>, Matrix2<f64>) {
        let d = self.distorted_from_px(px);
        let k_inverse = Matrix2::new(1.0 / self.fx, -self.skew / (self.fx * self.fy), 0.0, 1.0 / self.fy);
        (self.ray_from_distorted(d), self.ideal_by_distorted(d) * k_inverse)
    }

    /// The pixel of an ideal ray; `None` where the distortion polynomial has no inverse (far outside the image).
    /// The residual in normalised coordinates is below 1e-12.
    #[must_use]
    pub fn px_from_ray(&self, ray: &Ray<Cam>) -> Option<Px> {
        let ideal = Vector2::new(ray.xy1.x, ray.xy1.y);
        let radius = ideal.norm();
        if !radius.is_finite() {
            return None;
        }
        if radius < 1e-15 {
            return Some(self.px_from_distorted(ideal));
        }
        let distorted = if self.is_centred() {
            ideal * (self.distorted_radius(radius)? / radius)
        } else {
            self.distorted_from_ideal(ideal)?
        };
        Some(self.px_from_distorted(distorted))
    }

    /// Newton on rho (1 + k1 rho^2 + k2 rho^4 + k3 rho^6) = radius: without decentring the direction does not change.
    fn distorted_radius(&self, radius: f64) -> Option<f64> {
        let mut rho = radius;
        for _ in 0..MAX_STEPS {
            let r2 = rho * rho;
            let slope = 1.0 + r2 * (3.0 * self.k1 + r2 * (5.0 * self.k2 + 7.0 * self.k3 * r2));
            if slope <= LEAST_SLOPE {
                return None; // the polynomial turns back here
            }
            let step = (rho * self.ideal_per_distorted(r2) - radius) / slope;
            rho -= step;
            // What the next step would change is of the order of this one's square.
            if step.abs() < 1e-9 * (1.0 + rho) {
                break;
            }
        }
        let residual = rho * self.ideal_per_distorted(rho * rho) - radius;
        (residual.abs() < 1e-12 * (1.0 + radius) && rho > 0.0).then_some(rho)
    }

    /// The same in two dimensions.
    fn distorted_from_ideal(&self, ideal: Vector2<f64>) -> Option<Vector2<f64>> {
        let off = |d: Vector2<f64>| self.ray_from_distorted(d).xy1.xy() - ideal;
        let mut d = ideal;
        for _ in 0..MAX_STEPS {
            let slope = self.ideal_by_distorted(d);
            // The slope is symmetric; its smaller eigenvalue.
            let (mean, half) = (0.5 * slope.trace(), 0.5 * (slope[(0, 0)] - slope[(1, 1)]));
            let least = mean - half.hypot(slope[(0, 1)]);
            if least.is_nan() || least <= LEAST_SLOPE {
                return None;
            }
            let step = slope.try_inverse()? * off(d);
            d -= step;
            if step.norm() < 1e-9 * (1.0 + d.norm()) {
                break;
            }
        }
        (off(d).norm() < 1e-12 * (1.0 + ideal.norm())).then_some(d)
    }

    /// The pixel of a point in front of the camera.
    #[must_use]
    pub fn px_from_point(&self, point: &Point<Cam>) -> Option<Px> {
        let p = &point.mm;
        if p.z <= 1e-6 {
            return None;
        }
        self.px_from_ray(&Ray::new(p.x / p.z, p.y / p.z))
    }

    /// The pixel of an ideal ray and its derivative: columns d(u, v)/dx and d(u, v)/dy.
    #[must_use]
    pub fn px_from_ray_with_jacobian(&self, ray: &Ray<Cam>) -> Option<(Px, Matrix2<f64>)> {
        let px = self.px_from_ray(ray)?;
        let (_, ray_by_px) = self.ray_from_px_with_jacobian(px);
        Some((px, ray_by_px.try_inverse()?))
    }

    /// Checks the camera of a sensor of this size.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidCalibration`], naming the number: not finite, not a head's, or a lens without an inverse.
    pub fn check_on_sensor(&self, image_size_px: [u32; 2]) -> Result<(), Error> {
        let invalid = |text: String| Error::new(ErrorKind::InvalidCalibration, text);
        let [width_px, height_px] = image_size_px;
        if !(64..=16_384).contains(&width_px) || !(64..=16_384).contains(&height_px) {
            return Err(invalid(format!(
                "image_size is {width_px} x {height_px} px, 64 to 16384 px each are allowed"
            )));
        }
        self.check()?;
        // 0.1 and 10 image sides are fields of view of 157 and 6 degrees: no head is outside, and searches are bounded.
        let side_px = f64::from(width_px.max(height_px));
        for (name, value) in [("fx", self.fx), ("fy", self.fy)] {
            if !(0.1 * side_px..=10.0 * side_px).contains(&value) {
                return Err(invalid(format!(
                    "camera.{name} is {value} px, {:.0} to {:.0} px are allowed for this image size",
                    0.1 * side_px,
                    10.0 * side_px
                )));
            }
        }
        // Rows and columns of a sensor are square to far less.
        let most_px = MOST_SKEW * self.fx;
        if self.skew.abs() > most_px {
            return Err(invalid(format!(
                "camera.skew is {} px, {:.1} to {most_px:.1} px are allowed for this focal length",
                self.skew, -most_px
            )));
        }
        // A frame cut out of a larger one may have its centre outside, but no picture is far from its lens's axis.
        for (name, value, side_px) in [("cx", self.cx, width_px), ("cy", self.cy, height_px)] {
            let side_px = f64::from(side_px);
            if !(-0.5 * side_px..=1.5 * side_px).contains(&value) {
                return Err(invalid(format!(
                    "camera.{name} is {value} px, {:.0} to {:.0} px are allowed for this image size",
                    -0.5 * side_px,
                    1.5 * side_px
                )));
            }
        }
        self.check_inverse(width_px, height_px)
    }

    /// Fails unless all numbers are finite and the focal lengths positive.
    fn check(&self) -> Result<(), Error> {
        let named = [
            ("fx", self.fx),
            ("fy", self.fy),
            ("skew", self.skew),
            ("cx", self.cx),
            ("cy", self.cy),
            ("k1", self.k1),
            ("k2", self.k2),
            ("p1", self.p1),
            ("p2", self.p2),
            ("k3", self.k3),
        ];
        for (name, value) in named {
            if !value.is_finite() {
                return Err(Error::new(
                    ErrorKind::InvalidCalibration,
                    format!("camera.{name} is {value}, a finite number is needed"),
                ));
            }
        }
        for (name, value) in [("fx", self.fx), ("fy", self.fy)] {
            if value < 1.0 {
                return Err(Error::new(
                    ErrorKind::InvalidCalibration,
                    format!("camera.{name} is {value} px, at least 1 px is needed"),
                ));
            }
        }
        Ok(())
    }

    /// Fails unless every pixel of a sensor of this size has a ray that leads back to it: what measures goes both ways.
    pub(crate) fn check_inverse(&self, width_px: u32, height_px: u32) -> Result<(), Error> {
        let (right, bottom) = (f64::from(width_px) - 1.0, f64::from(height_px) - 1.0);
        let share = |i: u32| f64::from(i) / f64::from(INVERSE_PLACES - 1);
        for i in 0..INVERSE_PLACES * INVERSE_PLACES {
            let px = Px::new(right * share(i % INVERSE_PLACES), bottom * share(i / INVERSE_PLACES));
            let back = self.px_from_ray(&self.ray_from_px(px));
            if back.is_some_and(|back| back.distance_px(px) < INVERSE_PX) {
                continue;
            }
            let named = [
                ("skew", self.skew),
                ("k1", self.k1),
                ("k2", self.k2),
                ("p1", self.p1),
                ("p2", self.p2),
                ("k3", self.k3),
            ];
            let terms = named.iter().filter(|(_, term)| *term != 0.0);
            let terms: Vec<String> = terms.map(|(name, term)| format!("camera.{name} is {term:?}")).collect();
            return Err(Error::new(
                ErrorKind::InvalidCalibration,
                format!(
                    "{}: the distortion has no inverse at pixel ({:.0}, {:.0})",
                    terms.join(", "),
                    px.u,
                    px.v
                ),
            ));
        }
        Ok(())
    }

    fn ideal_per_distorted(&self, r2: f64) -> f64 {
        1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
    }

    fn ray_from_distorted(&self, d: Vector2<f64>) -> Ray<Cam> {
        let r2 = d.norm_squared();
        let scale = self.ideal_per_distorted(r2);
        if self.is_centred() {
            return Ray::new(d.x * scale, d.y * scale);
        }
        let both = 2.0 * d.x * d.y;
        Ray::new(
            d.x * scale + self.p1 * both + self.p2 * (r2 + 2.0 * d.x * d.x),
            d.y * scale + self.p1 * (r2 + 2.0 * d.y * d.y) + self.p2 * both,
        )
    }

    /// Derivative of the ideal coordinate by the distorted one (both normalised, without unit); symmetric.
    #[must_use]
    pub fn ideal_by_distorted(&self, d: Vector2<f64>) -> Matrix2<f64> {
        let r2 = d.norm_squared();
        let radial = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + 3.0 * self.k3 * r2));
        let centred = Matrix2::identity() * self.ideal_per_distorted(r2) + d * d.transpose() * radial;
        if self.is_centred() {
            return centred;
        }
        let (p1, p2, x, y) = (self.p1, self.p2, d.x, d.y);
        let beside = 2.0 * (p1 * x + p2 * y);
        centred + Matrix2::new(2.0 * p1 * y + 6.0 * p2 * x, beside, beside, 6.0 * p1 * y + 2.0 * p2 * x)
    }

    /// Where a pixel is in normalised coordinates, `x / z` and `y / z`, as the lens distorts them.
    #[must_use]
    pub fn distorted_from_px(&self, px: Px) -> Vector2<f64> {
        let y = (px.v - self.cy) / self.fy;
        Vector2::new((px.u - self.cx - self.skew * y) / self.fx, y)
    }

    fn px_from_distorted(&self, d: Vector2<f64>) -> Px {
        Px::new(self.fx * d.x + self.skew * d.y + self.cx, self.fy * d.y + self.cy)
    }
}
