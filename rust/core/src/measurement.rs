//! Results: what a frame tells about one face, what two or three frames tell about a box, and the settings that choose the way.

use crate::calibration::PARAMETERS;
use crate::frames::{Cam, Plane, Point};
use crate::network::{EdgeMapNetwork, Network};
use crate::reject::Reject;
use crate::trace::Trace;
use crate::units::{AngleEstimate, Estimate, Px, Volume};
use crate::warning::Warning;
use nalgebra::{Matrix2, SMatrix};
use std::sync::atomic::AtomicBool;

/// How the sides are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Joint fit of a rectangle to all stripe and edge pixels (the default).
    #[default]
    Fit,
    /// The paper's eight key points, eqs. 5-11.
    Keypoints,
}

/// How the edges of the face are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EdgeMethod {
    /// The network says which stripes and edges are the face's ([`Settings::network`]; without one, as `Gradient`), gradients
    /// say where exactly (the default).
    #[default]
    Net,
    /// The same without a network: the stripes' ends and light and the picture's edges tell which lines are the face's, so few results are as
    /// likely right as [`Settings::least_confidence`] asks by default.
    Gradient,
    /// The paper's chain: edge map ([`Settings::edge_map`], that of [`Settings::network`], or the picture's gradient), Hough transform
    /// (eq. 20), clustering, line fits.
    Hough,
}

/// Threads that the caller lends, as many as it likes: the library has none of its own.
pub trait Workers: Sync {
    /// Does both pieces of work, side by side if a thread is free.
    fn both(&self, first: &mut (dyn FnMut() + Send), second: &mut (dyn FnMut() + Send));
}

/// What the caller may choose. `Default` is what the courier uses.
#[derive(Clone, Copy)]
pub struct Settings<'a> {
    /// How the sides are computed.
    pub method: Method,
    /// How the edges are found.
    pub edges: EdgeMethod,
    /// Settles an A x A x B box: 0 for the first candidate, 1 for the second.
    pub choose: Option<usize>,
    /// The network for [`EdgeMethod::Net`] and [`EdgeMethod::Hough`].
    pub network: Option<&'a dyn Network>,
    /// The paper's network for [`EdgeMethod::Hough`]; if there is one, `network` is not asked there.
    pub edge_map: Option<&'a dyn EdgeMapNetwork>,
    /// Measures the frames of a box side by side; `None`: one after the other.
    pub workers: Option<&'a dyn Workers>,
    /// Becomes true when the result is not wanted any more; looked at between stages.
    pub cancelled: Option<&'a AtomicBool>,
    /// How far each laser may have turned since the calibration, rad, 1 sigma. A larger one makes sigmas larger and lets
    /// more pass as normal.
    pub drift_rad: f64,
    /// Least probability that a result is right, 0 to 1: what is less likely is refused. A larger one measures fewer boxes and fewer
    /// wrongly; `rust/ACCURACY.md` has the curve.
    pub least_confidence: f64,
    /// The four sides of a face need not stand at right angles; the corner angles are reported.
    pub free: bool,
    /// Gets what each stage found, for pictures and logs; `None`: nobody looks.
    pub trace: Option<&'a dyn Trace>,
}

/// Half of the 0.1 mrad that a laser's pointing drifts with temperature (PHYSICS.md): the four sit on one carrier and part
/// of it is common.
pub const USUAL_DRIFT_RAD: f64 = 0.05e-3;

/// [`Settings::least_confidence`] unless told otherwise: under it at most 1 result in 200 may be wrong (off by more than 5 mm, or by more
/// than 3 mm and 4 sigmas). Of 762 measurable boxes of the learning and the choosing seeds, by two frames without the lasers off, it leaves
/// 298, none wrong; at 0.97 it would be 356 and none, at 0.95 406 and 1, at 0.9 473 and 3, at 0.99 231. Boxes of final sets have broken lower
/// limits each time: of those that are used up one was still wrong by 24 mm at 0.97 (`rust/SEEDS.md`).
pub const LEAST_CONFIDENCE: f64 = 0.98;

impl Default for Settings<'_> {
    fn default() -> Self {
        Self {
            method: Method::default(),
            edges: EdgeMethod::default(),
            choose: None,
            network: None,
            edge_map: None,
            workers: None,
            cancelled: None,
            drift_rad: USUAL_DRIFT_RAD,
            least_confidence: LEAST_CONFIDENCE,
            free: false,
            trace: None,
        }
    }
}

impl std::fmt::Debug for Settings<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Settings")
            .field("method", &self.method)
            .field("edges", &self.edges)
            .field("choose", &self.choose)
            .field("network", &self.network.is_some())
            .field("edge_map", &self.edge_map.is_some())
            .field("workers", &self.workers.is_some())
            .field("drift_rad", &self.drift_rad)
            .field("least_confidence", &self.least_confidence)
            .field("free", &self.free)
            .field("trace", &self.trace.is_some())
            .finish()
    }
}

/// Causes that both faces of a box share: the parameters of the calibration (made independent), tilts of four lasers, the radius of
/// the box's edges.
pub const SHARED_CAUSES: usize = PARAMETERS + 4 + 1;

/// Where the variances of a face's length and width come from. What two faces share is kept apart, because it neither
/// averages out in a side that both show nor in the volume.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SideUncertainty {
    /// Covariance of length and width from what this frame has for itself: noise, edge blur, light on the edges; mm^2.
    pub own_mm2: Matrix2<f64>,
    /// Change of length and width for one sigma of each shared cause, mm.
    pub shared_mm: SMatrix<f64, 2, SHARED_CAUSES>,
}

impl SideUncertainty {
    /// Covariance of length and width, mm^2.
    #[must_use]
    pub fn covariance_mm2(&self) -> Matrix2<f64> {
        self.own_mm2 + self.shared_mm * self.shared_mm.transpose()
    }
}

/// One measured face. Sides: corners 0-1 and 3-2 are `length` edges, 1-2 and 0-3 `width` edges.
#[derive(Clone, Debug, PartialEq)]
pub struct FaceMeasurement {
    /// The longer side.
    pub length: Estimate,
    /// The shorter side.
    pub width: Estimate,
    /// The plane of the face.
    pub plane: Plane<Cam>,
    /// Corners of the sharp face on the sensor, going round.
    pub corners_px: [Px; 4],
    /// The same corners in the camera frame.
    pub corners: [Point<Cam>; 4],
    /// D1..D8: where stripe i (index 0-3) crosses the two edges of the face.
    pub key_points_px: [[Px; 2]; 4],
    /// Root mean square of all stripe and edge residuals, px.
    pub rms_px: f64,
    /// Stripe points that were used, thinned; per laser. For overlays.
    pub stripe_points_px: [Vec<Px>; 4],
    /// Edge points that were used, per side (0: corner 0-1, 1: 1-2, 2: 2-3, 3: 3-0). For overlays.
    pub edge_points_px: [Vec<Px>; 4],
    /// What length and width share with another face. Zero where it is not known (a decoded message).
    pub uncertainty: SideUncertainty,
    /// Angles at the corners, if right angles were not imposed ([`Settings::free`]).
    pub corner_angles: Option<[AngleEstimate; 4]>,
    /// Checks that failed.
    pub warnings: Vec<Warning>,
    /// How far the surface lies from the fitted plane, along each stripe: a curvature map. Empty where it is not known.
    pub surface: Vec<SurfacePoint>,
    /// How straight each side is (0: corner 0-1, 1: 1-2, 2: 2-3, 3: 3-0). Sigmas allow for it.
    pub straightness: [Straightness; 4],
    /// Length and width of the smallest rectangle of this direction that encloses the face: what a tunnel on a belt reads.
    pub enclosing: [Estimate; 2],
    /// What the stripes' light says of each side, in the same order; `None` on the paper's map, or in a decoded message of an older program.
    pub light: Option<[SideLight; 4]>,
    /// Probability that both sides are within 5 mm ([`crate::confidence`]), as this frame alone tells; `None` on the paper's map.
    pub confidence: Option<f64>,
}

/// How far a side of a face departs from a straight line; zero where it was not seen well enough to tell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Straightness {
    /// Its middle against its ends, positive outwards.
    pub sagitta: Estimate,
    /// Root mean square of all it departs beyond noise, bow and waves together, mm.
    pub rms_mm: f64,
}

/// What the light of the two stripes that cross a side says of it: light on the face's plane just inside and just beyond.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SideLight {
    /// It ends at the side, on one stripe at least, and goes on beyond it on none.
    Confirmed,
    /// Neither stripe tells: the surroundings are too dark or too bright, or something is printed there.
    Dark,
    /// It goes on beyond the side: something flush lies there, or the side is a line of print.
    Open,
    /// It is missing inside the side: the face may end before it.
    Contradicted,
}

impl SideLight {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Confirmed, Self::Dark, Self::Open, Self::Contradicted];

    /// The stable name, as in `--json` and protobuf.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Confirmed => "confirmed",
            Self::Dark => "dark",
            Self::Open => "open",
            Self::Contradicted => "contradicted",
        }
    }
}

/// A piece of a stripe on a face against the fitted plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position on the face along its length and along its width, from its middle, mm.
    pub at_mm: [f64; 2],
    /// Towards the camera, mm.
    pub height: Estimate,
}

/// Three sides and the volume, sorted: length >= width >= height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoxMeasurement {
    /// Longest side.
    pub length: Estimate,
    /// Middle side.
    pub width: Estimate,
    /// Shortest side.
    pub height: Estimate,
    /// length x width x height.
    pub volume: Volume,
}

/// What one frame gives.
#[derive(Clone, Debug, PartialEq)]
pub enum FaceOutcome {
    /// The face was measured.
    Measured(Box<FaceMeasurement>),
    /// The view cannot be measured.
    Rejected(Reject),
}

impl FaceOutcome {
    /// The face, if it was measured.
    #[must_use]
    pub fn measured(&self) -> Option<&FaceMeasurement> {
        match self {
            Self::Measured(face) => Some(face),
            Self::Rejected(_) => None,
        }
    }
}

/// What two or three frames give.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// The box was measured.
    Measured(BoxMeasurement),
    /// All frames show A x B: the box is A x A x B or A x B x B. Both candidates, the more likely first.
    Ambiguous([BoxMeasurement; 2]),
    /// The view cannot be measured.
    Rejected(Reject),
}

/// A box that may be the right one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Its sides.
    pub sides: BoxMeasurement,
    /// Probability that it is the right one.
    pub confidence: f64,
}

/// How far the box was seen to reach behind both faces: what settled an A x A x B box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthEstimate {
    /// Behind the faces; only good to tell two depths from each other.
    pub depth: Estimate,
    /// Natural logarithm of the odds against the other box, of all stripes together.
    pub log_odds: f64,
    /// Stripes on neighbouring faces that say so; none says otherwise.
    pub stripes: usize,
}

/// Name of each stage and the time spent in it, nanoseconds, in the order in which the stages first ran; frames add up.
pub type StageTimes = Vec<(&'static str, u64)>;

#[cfg(test)]
impl FaceMeasurement {
    /// A face straight ahead, with as many px as mm, for tests of what is done with faces.
    pub(crate) fn made_up(length_mm: f64, width_mm: f64) -> Self {
        Self {
            length: Estimate::new(length_mm, 0.4),
            width: Estimate::new(width_mm, 0.4),
            plane: Plane::new(nalgebra::Vector3::z() * 1e-3),
            corners_px: [(0.0, 0.0), (length_mm, 0.0), (length_mm, width_mm), (0.0, width_mm)]
                .map(|(u, v)| Px::new(u, v)),
            corners: [Point::new(0.0, 0.0, 1000.0); 4],
            key_points_px: [[Px::new(0.0, 0.0); 2]; 4],
            rms_px: 0.2,
            stripe_points_px: Default::default(),
            edge_points_px: Default::default(),
            uncertainty: SideUncertainty::default(),
            corner_angles: None,
            warnings: Vec::new(),
            surface: Vec::new(),
            straightness: Default::default(),
            light: None,
            enclosing: [Estimate::new(length_mm, 0.4), Estimate::new(width_mm, 0.4)],
            confidence: None,
        }
    }
}
