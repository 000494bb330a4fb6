//! Which combinations of the twelve plane parameters the faces tell: eigenvectors of their information, named in words.

use super::{LaserMotion, scale_motion};
use boxline::eigen::symmetric_eigen;
use boxline::face_geometry::laser_motion::{MotionMatrix, Motions, motions_of};
use boxline::frames::{Cam, Plane};
use nalgebra::{Matrix3, Vector3};

/// What a direction mostly is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DirectionKind {
    /// The lasers against each other: the stripes of one flat face show it.
    Stripes,
    /// All depths bent together, `1 / z -> 1 / z + v . x`: stripes cannot show it, right angles do.
    Depth,
    /// All lengths together: only a known length shows it.
    Scale,
}

impl DirectionKind {
    /// In words.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Stripes => "lasers against each other",
            Self::Depth => "all depths bent together",
            Self::Scale => "global scale",
        }
    }

    /// What makes it observable.
    #[must_use]
    pub const fn needs(self) -> &'static str {
        match self {
            Self::Stripes => "more faces, near and far",
            Self::Depth => "more faces, tilted differently",
            Self::Scale => "one known length",
        }
    }
}

/// One independent combination of the twelve parameters.
#[derive(Clone, Debug)]
pub struct Direction {
    /// What it mostly is.
    pub kind: DirectionKind,
    /// How much of it, 0 to 1.
    pub share: f64,
    /// What the faces say about it over what was thought possible before: information in units of the prior's.
    pub eigenvalue: f64,
    /// One sigma of it as the faces tell it; for a direction that is not observable, as thought possible before.
    pub one_sigma: [LaserMotion; 4],
    /// One sigma of it as a relative change of all lengths.
    pub scale_sigma: f64,
    /// Unit vector, in units of the prior.
    pub(super) vector: Motions,
}

impl Direction {
    /// Whether the faces say more about it than was known before.
    #[must_use]
    pub fn observable(&self) -> bool {
        self.eigenvalue > 1.0
    }

    /// The largest turn of a laser in one sigma, rad.
    #[must_use]
    pub fn turn_sigma_rad(&self) -> f64 {
        self.one_sigma.iter().map(|m| m.tilt_rad.abs().max(m.twist_rad.abs())).fold(0.0, f64::max)
    }
}

/// The eigenvectors of the faces' information, in units of the prior (`motions = units y`), best known first.
pub(super) fn directions(
    information: &MotionMatrix,
    units: &MotionMatrix,
    by_motion: &[Matrix3<f64>; 4],
    planes: &[Plane<Cam>; 4],
) -> Option<Vec<Direction>> {
    if !information.iter().all(|x| x.is_finite()) {
        return None;
    }
    let whitened = |motions: Motions| units.solve_lower_triangular(&motions);
    // The named directions, made orthogonal: scale, then the three of depth; what is left are the lasers against each other.
    let scale = whitened(scale_motion(planes, by_motion)?)?;
    let mut named = vec![scale];
    for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
        named.push(whitened(motions_of(by_motion, &[axis; 4])?)?);
    }
    for i in 0..named.len() {
        for j in 0..i {
            let part = named[j] * named[j].dot(&named[i]);
            named[i] -= part;
        }
        named[i] = named[i].try_normalize(1e-12)?;
    }
    let scale_step = scale.norm_squared();
    let eigen = symmetric_eigen(information);
    let mut all: Vec<Direction> = (0..12)
        .map(|i| {
            let vector: Motions = eigen.vectors.column(i).into();
            let eigenvalue = eigen.values[i].max(0.0);
            let of_scale = named[0].dot(&vector).powi(2);
            let of_depth: f64 = named[1..].iter().map(|n| n.dot(&vector).powi(2)).sum();
            let shares = [
                (DirectionKind::Scale, of_scale),
                (DirectionKind::Depth, of_depth),
                (DirectionKind::Stripes, 1.0 - of_scale - of_depth),
            ];
            let (kind, share) = shares.into_iter().fold(shares[0], |a, b| if b.1 > a.1 { b } else { a });
            let sigma = 1.0 / eigenvalue.max(1.0).sqrt();
            let motions = units * vector * sigma;
            Direction {
                kind,
                share,
                eigenvalue,
                one_sigma: std::array::from_fn(|k| LaserMotion::from(&motions, k)),
                scale_sigma: (scale.dot(&vector) / scale_step * sigma).abs(),
                vector,
            }
        })
        .collect();
    all.sort_by(|a, b| b.eigenvalue.total_cmp(&a.eigenvalue));
    Some(all)
}
