//! A face followed from frame to frame of a live view: stripes near its last plane, sides near its last sides, no network. Where that does not
//! find the same face again, and once in a while in any case, the frame is looked at in full.

use super::face::{check_size, measure_beside, measure_face};
use crate::calibration::Calibration;
use crate::error::Error;
use crate::face::outline::InitialRectangle;
use crate::face::raster::{OnPlane, PlaneRaster};
use crate::frames::{Cam, Plane, Point};
use crate::image::Frame;
use crate::measurement::{FaceMeasurement, FaceOutcome, Settings};
use crate::report::FaceReport;
use crate::units::{Estimate, Px};
use crate::warning::Warning;
use nalgebra::Vector3;

/// Frames that are followed before one is looked at in full: a second of a head's stream, in which a user sees that something else came
/// into view.
const FOLLOWED: u32 = 15;
/// Sides that differ by more of their common sigmas are those of another face: by chance, one of 370.
const SAME_FACE_SIGMAS: f64 = 3.0;

/// What a live view knows of a frame.
#[derive(Clone, Debug)]
pub enum LiveFace {
    /// It was looked at in full.
    Looked(FaceReport),
    /// It shows the face of an earlier frame.
    Followed(FollowedFace),
}

/// Where a face is in a frame that was not looked at in full: for the screen. Lengths are those that were measured in the last frame that
/// was; this one has none.
#[derive(Clone, Debug, PartialEq)]
pub struct FollowedFace {
    /// Corners on the sensor, going round.
    pub corners_px: [Px; 4],
    /// Where stripe i (index 0-3) crosses two edges of the face.
    pub key_points_px: [[Px; 2]; 4],
    /// The longer side, as measured before.
    pub length: Estimate,
    /// The shorter side, as measured before.
    pub width: Estimate,
    /// As in [`FaceMeasurement::confidence`], then.
    pub confidence: Option<f64>,
    /// As in [`FaceMeasurement::warnings`], then.
    pub warnings: Vec<Warning>,
}

impl LiveFace {
    /// The face's corners on the sensor, going round, if there is one.
    #[must_use]
    pub fn corners_px(&self) -> Option<[Px; 4]> {
        match self {
            Self::Looked(FaceReport { outcome: FaceOutcome::Measured(face), .. }) => Some(face.corners_px),
            Self::Looked(_) => None,
            Self::Followed(face) => Some(face.corners_px),
        }
    }
}

/// Follows a face.
#[derive(Debug, Default)]
pub struct Tracker {
    track: Option<Track>,
}

/// A face that was measured, and where it was seen last.
#[derive(Debug)]
struct Track {
    face: FollowedFace,
    plane: Plane<Cam>,
    corners: [Point<Cam>; 4],
    /// Frames since it was measured.
    followed: u32,
}

impl Tracker {
    /// Takes the next frame of the stream.
    ///
    /// # Errors
    /// As [`measure_face`].
    pub fn next(
        &mut self,
        frame: &Frame,
        calibration: &Calibration,
        settings: &Settings,
    ) -> Result<LiveFace, Error> {
        check_size(frame, calibration)?;
        let track = self.track.take().filter(|track| track.followed < FOLLOWED);
        if let Some(track) = track.and_then(|track| track.follow(frame, calibration, settings)) {
            let face = track.face.clone();
            self.track = Some(track);
            return Ok(LiveFace::Followed(face));
        }
        let report = measure_face(frame, calibration, settings)?;
        if let FaceOutcome::Measured(face) = &report.outcome {
            self.track = Some(Track::of(face));
        }
        Ok(LiveFace::Looked(report))
    }
}

impl Track {
    fn of(face: &FaceMeasurement) -> Self {
        let known = FollowedFace {
            corners_px: face.corners_px,
            key_points_px: face.key_points_px,
            length: face.length,
            width: face.width,
            confidence: face.confidence,
            warnings: face.warnings.clone(),
        };
        Self { face: known, plane: face.plane, corners: face.corners, followed: 0 }
    }

    /// Where the face is in the next frame, if it is there.
    fn follow(self, frame: &Frame, calibration: &Calibration, settings: &Settings) -> Option<Self> {
        let outline = |plane: &Plane<Cam>| self.outline_on(plane, calibration);
        let seen = measure_beside(frame, calibration, settings, &self.plane, outline)?;
        let same = |before: Estimate, now: Estimate| {
            (now.value_mm - before.value_mm).abs() <= SAME_FACE_SIGMAS * now.sigma_mm.hypot(before.sigma_mm)
        };
        if !same(self.face.length, seen.length) || !same(self.face.width, seen.width) {
            return None;
        }
        let face =
            FollowedFace { corners_px: seen.corners_px, key_points_px: seen.key_points_px, ..self.face };
        Some(Self { face, plane: seen.plane, corners: seen.corners, followed: self.followed + 1 })
    }

    /// The face's sides on a plane a little different.
    fn outline_on(&self, plane: &Plane<Cam>, calibration: &Calibration) -> Option<InitialRectangle> {
        let [first, second, opposite, last] = self.corners.each_ref().map(|corner| corner.mm);
        let middle = (first + second + opposite + last) / 4.0;
        // Axis b is a quarter turn from a as the normal has it; the corners may go round either way.
        let (normal, _) = self.plane.normal_and_distance_mm();
        let [one, other]: [Vector3<f64>; 2] = [second - first, last - first];
        let along = if normal.cross(&one).dot(&other) > 0.0 { one } else { other };
        let raster = PlaneRaster::along(&self.plane, middle, &along)?;
        let [low, high] = [self.corners[0], self.corners[2]].map(|corner| raster.of_cam(&corner));
        let raster = raster.on(plane);
        let mm_per_px = raster.mm_per_px(calibration, OnPlane::zeros())?;
        Some(InitialRectangle::new(raster, [low.x, high.x, low.y, high.y], mm_per_px))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::EdgeMethod;
    use crate::paper_head::paper_head;
    use crate::scene::drawn::{Surface, drawn_on};
    use nalgebra::Rotation3;

    /// Half sizes of the face, mm.
    const HALF_MM: [f64; 2] = [190.0, 140.0];
    /// What lies behind it in the dark, as paint.
    const BEHIND: f64 = 0.15;

    fn settings() -> Settings<'static> {
        Settings { edges: EdgeMethod::Gradient, least_confidence: 0.0, ..Settings::default() }
    }

    /// A face of these half sizes, its middle at a place in the camera frame, turned by angles about x, y and z (the stripes run at 45
    /// degrees), under four stripes.
    fn drawn(calibration: &Calibration, half_mm: [f64; 2], middle: [f64; 3], turned: [f64; 3]) -> Frame {
        let turn = Rotation3::from_euler_angles(turned[0], turned[1], turned[2]);
        let (normal, middle) = (turn * Vector3::z(), Vector3::from(middle));
        let plane = Plane::new(normal / normal.dot(&middle));
        let raster = PlaneRaster::along(&plane, middle, &(turn * Vector3::x())).expect("a direction");
        drawn_on(calibration, &raster, |at| {
            let on_face = at.x.abs() < half_mm[0] && at.y.abs() < half_mm[1];
            Surface { on: on_face.then_some(plane), paint: if on_face { 1.0 } else { BEHIND } }
        })
    }

    /// A hand that moves by 5 mm and a third of a degree from frame to frame; then another face, then none.
    #[test]
    fn a_face_is_followed_until_another_one_is_there() {
        let calibration = paper_head(1.0);
        let mut tracker = Tracker::default();
        let mut next = |half: [f64; 2], step: f64| {
            let middle = [33.0 + 2.0 * step, 27.0 + 3.0 * step, 900.0 + 4.0 * step];
            let turned = [0.12 + 0.004 * step, -0.2 + 0.003 * step, 0.75 + 0.002 * step];
            let frame = drawn(&calibration, half, middle, turned);
            let full = measure_face(&frame, &calibration, &settings()).expect("the sizes fit");
            (tracker.next(&frame, &calibration, &settings()).expect("the sizes fit"), full.outcome)
        };
        let (first, _) = next(HALF_MM, 0.0);
        let LiveFace::Looked(FaceReport { outcome: FaceOutcome::Measured(face), .. }) = first else {
            panic!("the first frame is looked at in full: {first:?}");
        };
        for step in 1..=3 {
            let (seen, full) = next(HALF_MM, f64::from(step));
            let LiveFace::Followed(followed) = &seen else { panic!("step {step}: {seen:?}") };
            // What is shown was measured; where it is shown is where the face is.
            assert_eq!((followed.length, followed.width), (face.length, face.width));
            let FaceOutcome::Measured(full) = full else { panic!("step {step}: {full:?}") };
            for (a, b) in followed.corners_px.iter().zip(&full.corners_px) {
                assert!((a.u - b.u).hypot(a.v - b.v) < 0.5, "step {step}: {a:?}, {b:?}");
            }
        }
        let (other, _) = next([HALF_MM[0] - 8.0, HALF_MM[1]], 3.0);
        assert!(matches!(other, LiveFace::Looked(_)), "{other:?}");
        let (far, _) = next([HALF_MM[0] - 8.0, HALF_MM[1]], 30.0);
        assert!(matches!(far, LiveFace::Looked(_)), "{far:?}");
        let (none, _) = next([0.0; 2], 30.0);
        assert!(none.corners_px().is_none(), "{none:?}");
    }

    #[test]
    fn once_a_second_a_frame_is_looked_at() {
        let calibration = paper_head(1.0);
        let frame = drawn(&calibration, HALF_MM, [33.0, 27.0, 900.0], [0.1, 0.2, 0.75]);
        let mut tracker = Tracker::default();
        let looked: Vec<bool> = (0..=FOLLOWED + 1)
            .map(|_| {
                let seen = tracker.next(&frame, &calibration, &settings()).expect("the size fits");
                matches!(seen, LiveFace::Looked(_))
            })
            .collect();
        let expected: Vec<bool> = (0..=FOLLOWED + 1).map(|i| i == 0 || i == FOLLOWED + 1).collect();
        assert_eq!(looked, expected);
    }
}
