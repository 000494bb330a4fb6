//! Where a plane predicts the stripe of a laser, and along which axis of the image it is scanned.

use crate::calibration::Calibration;
use crate::frames::{Cam, Plane};
use crate::units::{LaserId, Px};
use nalgebra::Vector3;

/// The direction in which a stripe is walked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ScanDirection {
    /// Row by row: `along` is v, the profile runs along u.
    Rows,
    /// Column by column: `along` is u, the profile runs along v.
    Columns,
}

impl ScanDirection {
    /// The coordinate along the walk.
    pub fn along(self, px: Px) -> f64 {
        match self {
            Self::Rows => px.v,
            Self::Columns => px.u,
        }
    }

    /// The coordinate across the walk.
    pub fn across(self, px: Px) -> f64 {
        match self {
            Self::Rows => px.u,
            Self::Columns => px.v,
        }
    }
}

/// The line of laser `id` on a plane: coefficients `q - p` of the ideal image, and how it is walked.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StripeLine {
    coefficients: Vector3<f64>,
    pub scan: ScanDirection,
}

impl StripeLine {
    /// The line of a laser on a plane.
    pub fn new(calibration: &Calibration, id: LaserId, plane: &Plane<Cam>) -> Self {
        let coefficients = plane.per_mm - calibration.laser(id).per_mm;
        let scan = if coefficients.x.abs() >= coefficients.y.abs() {
            ScanDirection::Rows
        } else {
            ScanDirection::Columns
        };
        Self { coefficients, scan }
    }

    /// The pixel of the line at `along_px`, starting from a guess of the other coordinate; and |d(across)/d(normal)|,
    /// the factor from a shift along the profile to one across the stripe.
    pub fn px_at(&self, calibration: &Calibration, along_px: f64, guess_px: f64) -> Option<(Px, f64)> {
        self.place_at(calibration, along_px, guess_px).map(|place| (place.px, place.factor))
    }

    /// As [`Self::px_at`], with the line's slope there.
    pub fn place_at(&self, calibration: &Calibration, along_px: f64, guess_px: f64) -> Option<OnLine> {
        let mut other = guess_px;
        let mut found = OnLine { px: Px::new(0.0, 0.0), factor: 0.0, slope: 0.0 };
        for _ in 0..8 {
            let px = match self.scan {
                ScanDirection::Rows => Px::new(other, along_px),
                ScanDirection::Columns => Px::new(along_px, other),
            };
            let (ray, jacobian) = calibration.camera().ray_from_px_with_jacobian(px);
            let value = self.coefficients.dot(&ray.xy1);
            let gradient = jacobian.transpose() * self.coefficients.xy();
            let (across, along) = match self.scan {
                ScanDirection::Rows => (gradient.x, gradient.y),
                ScanDirection::Columns => (gradient.y, gradient.x),
            };
            if across.abs() < 1e-12 {
                return None;
            }
            found = OnLine { px, factor: (across / gradient.norm()).abs(), slope: -along / across };
            let step = value / across;
            other -= step;
            if step.abs() < 1e-4 {
                break;
            }
        }
        other.is_finite().then_some(found)
    }
}

/// Least factor by which widths across a stripe are divided, so that profiles stay short on any head. A line is walked along its steeper axis:
/// with square pixels and no distortion the factor is 0.7 or more, so the bound itself (there is no record of how it was chosen) hardly counts.
const LEAST_FACTOR: f64 = 0.3;

/// A place on a stripe's line.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OnLine {
    pub px: Px,
    /// |d(across)/d(normal)|.
    pub factor: f64,
    /// d(across)/d(along).
    pub slope: f64,
}

impl OnLine {
    /// The factor, large enough to divide by.
    pub fn bounded_factor(&self) -> f64 {
        self.factor.max(LEAST_FACTOR)
    }
}
