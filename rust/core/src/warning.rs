//! What a measurement noticed about the face, the box or the head although it could measure: the number stands, with a
//! sigma that allows for what was seen.

use crate::units::LaserId;
use std::fmt;

/// What was noticed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum WarningKind {
    /// The four stripes do not agree on one plane: a laser has moved since the calibration. Found: its tilt, rad.
    LaserMoved,
    /// A stripe is not straight: the face bulges (positive, towards the camera) or dents. Found: the sagitta, mm.
    FaceNotFlat,
    /// The face is skewed: its two pairs of sides do not stand at right angles. Found: the angle beyond a right one, rad.
    NotRightAngled,
    /// Two opposite edges of the face differ. Found: the difference of their lengths, mm.
    OppositeEdges,
    /// A side of the face is a bow. Found: the sagitta of the one that bows most, mm, positive outwards.
    SideBowed,
    /// Beside a side of the face there is another line for which ten times more speaks than for the one that was measured: the two roundings of an
    /// edge, a seam, print. Found: how far outwards it lies, mm; its sigma is what the lines beside it add to the side's.
    EdgeDouble,
    /// The side that both frames show differs more than its sigmas allow. Found: the difference, mm.
    SidesDiffer,
}

impl WarningKind {
    /// All kinds.
    pub const ALL: [Self; 7] = [
        Self::LaserMoved,
        Self::FaceNotFlat,
        Self::NotRightAngled,
        Self::OppositeEdges,
        Self::SideBowed,
        Self::EdgeDouble,
        Self::SidesDiffer,
    ];

    /// The stable name, as in `--json` and protobuf.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::LaserMoved => "laser_moved",
            Self::FaceNotFlat => "face_not_flat",
            Self::NotRightAngled => "not_right_angled",
            Self::OppositeEdges => "opposite_edges",
            Self::SideBowed => "side_bowed",
            Self::EdgeDouble => "edge_double",
            Self::SidesDiffer => "sides_differ",
        }
    }

    /// Names of what was found and its sigma, with their unit.
    #[must_use]
    pub const fn number_names(self) -> [&'static str; 2] {
        match self {
            Self::LaserMoved => ["tilt_rad", "tilt_sigma_rad"],
            Self::FaceNotFlat | Self::SideBowed => ["sagitta_mm", "sagitta_sigma_mm"],
            Self::NotRightAngled => ["angle_rad", "angle_sigma_rad"],
            Self::EdgeDouble => ["offset_mm", "offset_sigma_mm"],
            Self::OppositeEdges | Self::SidesDiffer => ["difference_mm", "difference_sigma_mm"],
        }
    }
}

/// A check that failed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warning {
    /// Which check.
    pub kind: WarningKind,
    /// The laser that moved or whose stripe is bent, if it can be told.
    pub laser: Option<LaserId>,
    /// What was found, in the unit of the kind.
    pub found: f64,
    /// Standard deviation of what was found.
    pub sigma: f64,
    /// The check's statistic ...
    pub chi_square: f64,
    /// ... and what it may be: one sound face in a thousand has more. Of `edge_double`: the other line's share of the weight, and nine tenths.
    pub limit: f64,
}

impl Warning {
    /// The numbers as (name with unit, value), in a fixed order, for JSON and protobuf.
    #[must_use]
    pub fn numbers(&self) -> Vec<(&'static str, f64)> {
        let [found, sigma] = self.kind.number_names();
        let laser = self.laser.map(|l| ("laser", f64::from(l.number())));
        let rest = [
            (found, self.found),
            (sigma, self.sigma),
            ("chi_square", self.chi_square),
            ("limit", self.limit),
        ];
        laser.into_iter().chain(rest).collect()
    }
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (found, sigma) = (self.found, self.sigma);
        match (self.kind, self.laser) {
            (WarningKind::LaserMoved, Some(laser)) => write!(
                f,
                "laser {laser} has moved by about {:.2} ± {:.2} mrad since the calibration",
                found * 1e3,
                sigma * 1e3
            ),
            (WarningKind::LaserMoved, None) => write!(
                f,
                "the four stripes do not agree on one plane: a laser has moved by about {:.2} mrad since the calibration",
                found.abs() * 1e3
            ),
            (WarningKind::FaceNotFlat, laser) => {
                let what = if found > 0.0 { "bulges" } else { "is dented" };
                write!(f, "the face {what} by {:.1} ± {sigma:.1} mm", found.abs())?;
                laser.map_or(Ok(()), |laser| write!(f, " (stripe {laser})"))
            }
            (WarningKind::NotRightAngled, _) => write!(
                f,
                "the face is skewed: {:.2} ± {:.2} degrees from right angles",
                found.to_degrees().abs(),
                sigma.to_degrees()
            ),
            (WarningKind::OppositeEdges, _) => {
                write!(f, "opposite edges of the face differ by {:.1} ± {sigma:.1} mm", found.abs())
            }
            (WarningKind::SideBowed, _) => {
                let way = if found > 0.0 { "outwards" } else { "inwards" };
                write!(f, "a side of the face bows {way} by {:.1} ± {sigma:.1} mm", found.abs())
            }
            (WarningKind::EdgeDouble, _) => write!(
                f,
                "a side of the face may lie {:.1} mm farther {}, on another line beside it ({:.0} % of the weight)",
                found.abs(),
                if found > 0.0 { "out" } else { "in" },
                100.0 * self.chi_square
            ),
            (WarningKind::SidesDiffer, _) => write!(
                f,
                "the side that both frames show differs by {:.1} mm between them, {sigma:.1} mm is its sigma",
                found.abs()
            ),
        }
    }
}
