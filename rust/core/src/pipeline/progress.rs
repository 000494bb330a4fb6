//! What is known while a frame is looked at: how long each stage took, and the last rectangle that was seen.

use crate::face::raster::PlaneRaster;
use crate::face_geometry::view::FacePose;
use crate::measurement::StageTimes;
use crate::rectangle;
use std::time::Instant;

/// Times, and the face's pose: if the view is refused, it says how to move.
pub(super) struct Progress {
    since: Instant,
    pub times: StageTimes,
    pub pose: Option<FacePose>,
}

impl Progress {
    pub fn new() -> Self {
        Self { since: Instant::now(), times: StageTimes::new(), pose: None }
    }

    /// Keeps the pose of a rectangle.
    pub fn see(&mut self, raster: &PlaneRaster, offsets_mm: &[f64; 4]) {
        let corners = rectangle::corner_points(offsets_mm).map(|corner| raster.cam_point(corner).mm);
        self.pose = FacePose::from_corners(corners).or(self.pose);
    }

    /// Adds the time since the last call to that of a stage.
    pub fn lap(&mut self, stage: &'static str) {
        let now = Instant::now();
        let nanos = u64::try_from((now - self.since).as_nanos()).unwrap_or(u64::MAX);
        self.since = now;
        add_time(&mut self.times, stage, nanos);
    }
}

/// Adds to the time of a stage.
pub(super) fn add_time(times: &mut StageTimes, stage: &'static str, nanos: u64) {
    match times.iter_mut().find(|(name, _)| *name == stage) {
        Some((_, sum)) => *sum += nanos,
        None => times.push((stage, nanos)),
    }
}
