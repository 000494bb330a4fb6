//! Views that cannot be measured. Each refusal carries what was found and what was needed.

use crate::units::{Estimate, LaserId, Px};
use std::fmt;

/// Why a frame or a pair of frames was refused. `reason()` is the stable name in JSON and protobuf.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Reject {
    /// No plane was found on which the stripes form the grid: there is no box face in view, or no laser light.
    NoBox {
        /// Best share of the four inner stripe segments that were lit on one common plane, 0 to 1.
        best_share: f64,
        /// The share that is needed.
        needed_share: f64,
    },
    /// The laser light of one or more stripes is not visible on the face although the others are.
    StripeNotFound {
        /// The stripe that is missing.
        laser: LaserId,
        /// Share of it that is seen on the face, 0 to 1.
        seen_share: f64,
        /// The share that is needed.
        needed_share: f64,
    },
    /// A stripe does not cross two opposite edges of the face: the face is too small or the head is aimed beside it.
    StripeMissing {
        /// The stripe that misses the face or one of its edges.
        laser: LaserId,
        /// How many of the four stripes cross the face properly.
        stripes_on_face: u8,
    },
    /// A part of the face lies outside the image.
    FaceCutByBorder {
        /// Sides of the face that reach the image border.
        sides_cut: u8,
        /// The place on the border where the face is cut first.
        at: Px,
    },
    /// The stripes do not agree on one plane.
    FaceNotPlanar {
        /// Root mean square of the stripe residuals, px.
        rms_px: f64,
        /// What is allowed.
        limit_px: f64,
    },
    /// Not all four sides of the face could be found.
    RectangleOpen {
        /// Sides that were found.
        sides_found: u8,
    },
    /// Several lines may be the face's sides.
    OutlineUnsure {
        /// Probability that the likeliest four are right, 0 to 1.
        support: f64,
        /// The probability that is needed.
        needed_support: f64,
        /// Overlap of the outline with the face as the network sees it (intersection over union), 0 to 1.
        overlap: f64,
        /// The overlap that is needed.
        needed_overlap: f64,
    },
    /// Something in front of the face hides a piece of a side.
    FaceHidden {
        /// Sides of which a piece is hidden.
        sides_hidden: u8,
        /// Where a stripe of the side that is hidden most surely meets it; where none does, that side's middle.
        at: Px,
        /// Probability that something hides it, 0 to 1.
        probability: f64,
        /// The probability from which a face is refused for it.
        limit: f64,
        /// How far in front of the face it is where both stripes of that side meet it, mm.
        in_front_mm: Option<f64>,
    },
    /// The face is seen from farther away than the head is made for, and could be measured from nearer.
    TooFar {
        /// Distance of the face's middle, mm.
        distance_mm: f64,
        /// From here the whole face is in view, mm.
        limit_mm: f64,
    },
    /// The four sides do not form a rectangle.
    NotARectangle {
        /// Root mean square of the edge residuals, px.
        rms_px: f64,
        /// What is allowed.
        limit_px: f64,
    },
    /// The two frames have no side of equal length, so they are not two adjacent faces of one box.
    SidesDisagree {
        /// The side of the first frame that fits best.
        first: Estimate,
        /// The side of the second frame that fits best.
        second: Estimate,
        /// The largest difference that is allowed, mm.
        limit_mm: f64,
    },
}

impl Reject {
    /// The stable name of the reason, as in `--json` and protobuf.
    #[must_use]
    pub const fn reason(&self) -> &'static str {
        match self {
            Self::NoBox { .. } => "no_box",
            Self::StripeNotFound { .. } => "stripe_not_found",
            Self::StripeMissing { .. } => "stripe_missing",
            Self::FaceCutByBorder { .. } => "face_cut_by_border",
            Self::FaceNotPlanar { .. } => "face_not_planar",
            Self::RectangleOpen { .. } => "rectangle_open",
            Self::OutlineUnsure { .. } => "outline_unsure",
            Self::FaceHidden { .. } => "face_hidden",
            Self::TooFar { .. } => "too_far",
            Self::NotARectangle { .. } => "not_a_rectangle",
            Self::SidesDisagree { .. } => "sides_disagree",
        }
    }

    /// The numbers of the refusal as (name with unit, value), in a fixed order, for JSON and protobuf.
    #[must_use]
    pub fn numbers(&self) -> Vec<(&'static str, f64)> {
        match *self {
            Self::NoBox { best_share, needed_share } => {
                vec![("best_share", best_share), ("needed_share", needed_share)]
            }
            Self::StripeNotFound { laser, seen_share, needed_share } => vec![
                ("laser", f64::from(laser.number())),
                ("seen_share", seen_share),
                ("needed_share", needed_share),
            ],
            Self::StripeMissing { laser, stripes_on_face } => {
                vec![("laser", f64::from(laser.number())), ("stripes_on_face", f64::from(stripes_on_face))]
            }
            Self::FaceCutByBorder { sides_cut, at } => {
                vec![("sides_cut", f64::from(sides_cut)), ("at_u_px", at.u), ("at_v_px", at.v)]
            }
            Self::FaceNotPlanar { rms_px, limit_px } | Self::NotARectangle { rms_px, limit_px } => {
                vec![("rms_px", rms_px), ("limit_px", limit_px)]
            }
            Self::OutlineUnsure { support, needed_support, overlap, needed_overlap } => vec![
                ("support", support),
                ("needed_support", needed_support),
                ("overlap", overlap),
                ("needed_overlap", needed_overlap),
            ],
            Self::FaceHidden { sides_hidden, at, probability, limit, in_front_mm } => {
                let mut numbers = vec![
                    ("sides_hidden", f64::from(sides_hidden)),
                    ("at_u_px", at.u),
                    ("at_v_px", at.v),
                    ("probability", probability),
                    ("limit", limit),
                ];
                numbers.extend(in_front_mm.map(|mm| ("in_front_mm", mm)));
                numbers
            }
            Self::TooFar { distance_mm, limit_mm } => {
                vec![("distance_mm", distance_mm), ("limit_mm", limit_mm)]
            }
            Self::RectangleOpen { sides_found } => vec![("sides_found", f64::from(sides_found))],
            Self::SidesDisagree { first, second, limit_mm } => vec![
                ("first_mm", first.value_mm),
                ("first_sigma_mm", first.sigma_mm),
                ("second_mm", second.value_mm),
                ("second_sigma_mm", second.sigma_mm),
                ("limit_mm", limit_mm),
            ],
        }
    }
}

impl fmt::Display for Reject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoBox { best_share, needed_share } => write!(
                f,
                "no box face in view: at most {:.0} % of a stripe grid fits one plane, {:.0} % are needed",
                best_share * 100.0,
                needed_share * 100.0
            ),
            Self::StripeNotFound { laser, seen_share, needed_share } => write!(
                f,
                "stripe {laser} is not visible: {:.0} % of it is seen on the face, {:.0} % are needed",
                seen_share * 100.0,
                needed_share * 100.0
            ),
            Self::StripeMissing { laser, stripes_on_face } => write!(
                f,
                "stripe {laser} does not cross the face ({stripes_on_face} of 4 stripes do): aim at its middle or go closer"
            ),
            Self::FaceCutByBorder { sides_cut, at } => write!(
                f,
                "the face reaches the image border on {sides_cut} side(s), first at ({:.0}, {:.0}) px: step back",
                at.u, at.v
            ),
            Self::FaceNotPlanar { rms_px, limit_px } => {
                write!(f, "the stripes do not lie on one plane: rms {rms_px:.2} px, allowed {limit_px:.2} px")
            }
            Self::RectangleOpen { sides_found } => {
                write!(f, "only {sides_found} of 4 sides of the face were found")
            }
            Self::OutlineUnsure { support, needed_support, .. } => write!(
                f,
                "the face's outline is not clear: right with a probability of {support:.3}, needed {needed_support:.3}"
            ),
            Self::FaceHidden { sides_hidden, at, probability, limit, in_front_mm } => {
                let far = in_front_mm.map_or_else(String::new, |mm| format!("{mm:.0} mm "));
                write!(
                    f,
                    "something {far}in front of the face hides {sides_hidden} side(s), first at ({:.0}, {:.0}) px: \
                     probability {probability:.2}, allowed {limit:.2}",
                    at.u, at.v
                )
            }
            Self::TooFar { distance_mm, limit_mm } => write!(
                f,
                "the face is {:.2} m away and can be measured from {:.2} m",
                distance_mm * 1e-3,
                limit_mm * 1e-3
            ),
            Self::NotARectangle { rms_px, limit_px } => write!(
                f,
                "the four sides do not form a rectangle: rms {rms_px:.2} px, allowed {limit_px:.2} px"
            ),
            Self::SidesDisagree { first, second, limit_mm } => write!(
                f,
                "the two faces share no side: closest are {:.1} and {:.1} mm, allowed difference {limit_mm:.1} mm",
                first.value_mm, second.value_mm
            ),
        }
    }
}
