//! From what all frames show to the calibration: camera from the circles, then stripes, then everything together.
//!
//! In order: copies of a frame out, so that only different ones count; a start (`zhang`); centres from rims, anew with each camera; the
//! lens's terms (`lens`); out with frames whose typical circle is off by `MIN_OUTLIER_PX` and `OUTLIER` times the median frame, and in again
//! with those that the camera of the others fits; stripes, and which laser's each is (`planes`); all together (`adjust`); what does not fit
//! (`misfit`), sigmas with what may be wrong without being named (`nuisance`).

use super::adjust::{
    CentreObservation, Fixed, FrameObservations, Information, Loss, Scatter, StripeObservation, adjust,
    own_sigmas, residuals, rms_of_centres, scatter, weight,
};
use super::board::{Board, BoardView, Circle, OnBoard};
use super::judge;
use super::lens::{self, LensChoice, LensTerms, LensTrial};
use super::misfit::misfits;
use super::misfit_kind::{Misfit, MisfitKind};
use super::model::Shared;
use super::patterns::Solved;
use super::planes::{self, StripesInSpace};
use super::reject::{CalibrationReject, FrameReject};
use super::rim::{centre_from_rim, on_board};
use super::stripes::{BoardStripe, find_stripes};
use super::zhang;
use boxline::calibration::CalibrationCovariance;
use boxline::camera::CameraModel;
use boxline::frames::{Cam, Plane, Point, Pose};
use boxline::image::Frame;
use boxline::statistics::median;
use boxline::units::{LaserId, Px};
use nalgebra::{Vector2, Vector3};

/// Fewest frames: as the paper's set could be cut down to; 5 are less than what the checks below need.
pub const MIN_FRAMES: usize = 6;
/// Rounds of centres from rims with the camera of the round before; the first starts from ellipses.
const RIM_ROUNDS: usize = 3;
/// Residuals above this are no noise: the board is bent, the lens moves, or circles are mixed up. px an axis.
const MAX_RMS_PX: f64 = 2.0;
/// A frame is an outlier at so many times the median of all frames' scatter, and at least this, px.
const OUTLIER: f64 = 4.0;
const MIN_OUTLIER_PX: f64 = 0.3;
/// Rounds of judging frames by the camera that the others give; most sets need one, after which nothing changes.
const OUTLIER_ROUNDS: usize = 5;
/// Steps of a left-out frame's pose to a camera near the one that it was found with: quadratic, two are used.
const POSE_STEPS: usize = 4;
/// Rim statistics cannot be better than this: JPEG and interpolation, px.
const MIN_SIGMA_PX: f64 = 0.01;

/// How to solve.
#[derive(Clone, Copy, Debug, Default)]
pub struct CalibrationSettings {
    /// Estimate the skew too. The paper does not; a sensor has none.
    pub skew: bool,
    /// Which terms the lens has.
    pub lens: LensChoice,
}

/// The camera and the boards' poses, from circles alone.
#[derive(Clone, Debug)]
pub struct CameraSolution {
    board: Board,
    settings: CalibrationSettings,
    shared: Shared,
    views: Vec<BoardView>,
    frames: Vec<FrameObservations>,
    /// `None` for frames that take part.
    rejects: Vec<Option<FrameReject>>,
    lens: LensTerms,
    trials: Vec<LensTrial>,
}

/// Why a set fixes no camera, and which frames were left out before that was seen.
#[derive(Clone, Debug)]
pub struct CameraRefusal {
    /// Why.
    pub reject: CalibrationReject,
    /// Of every view, `None` if it took part; none of those that nobody looked at.
    pub rejects: Vec<Option<FrameReject>>,
}

impl std::fmt::Display for CameraRefusal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.reject.fmt(f)
    }
}

impl From<CameraRefusal> for CalibrationReject {
    fn from(refusal: CameraRefusal) -> Self {
        refusal.reject
    }
}

/// Solves the camera from the views of at least [`MIN_FRAMES`] different frames of one size.
///
/// # Errors
/// [`CameraRefusal`] if the views do not fix a camera.
pub fn solve_camera(
    views: Vec<BoardView>,
    board: &Board,
    settings: CalibrationSettings,
) -> Result<CameraSolution, CameraRefusal> {
    let rejects = copies(&views);
    let start = start(&views, &rejects, board)
        .map_err(|reject| CameraRefusal { reject, rejects: rejects.clone() })?;
    let Start { camera, frames } = start;
    let shared = Shared { camera, planes: [Vector3::new(0.01, 0.01, 0.0); 4] };
    let (lens, trials) = (settings.lens.start(), Vec::new());
    let mut solution =
        CameraSolution { board: *board, settings, shared, views, frames, rejects, lens, trials };
    match solution.solve_circles() {
        Ok(()) => Ok(solution),
        Err(reject) => Err(CameraRefusal { reject, rejects: solution.rejects }),
    }
}

/// A camera and poses to begin with.
struct Start {
    camera: CameraModel,
    frames: Vec<FrameObservations>,
}

/// Zhang's camera from the frames that count, and the pose of every one.
fn start(
    views: &[BoardView],
    rejects: &[Option<FrameReject>],
    board: &Board,
) -> Result<Start, CalibrationReject> {
    check_number(rejects)?;
    judge::check_counts(&counted(views, rejects), board)?;
    let pairs: Vec<Vec<(Vector2<f64>, Px)>> = views.iter().map(|v| pairs_of(v, board)).collect();
    let homographies: Vec<_> =
        counted(&pairs, rejects).into_iter().filter_map(|p| zhang::homography(p)).collect();
    let (width, height) = (views[0].width_px, views[0].height_px);
    let camera = zhang::camera(&homographies, width, height).ok_or_else(unsolved)?;
    let mut frames = Vec::with_capacity(views.len());
    for pairs in &pairs {
        let pose = zhang::pose(&camera, pairs).ok_or_else(unsolved)?;
        let centres = pairs
            .iter()
            .map(|(board_mm, at)| CentreObservation { board_mm: *board_mm, at: *at, sigma_px: 1.0 })
            .collect();
        frames.push(FrameObservations { pose, centres, stripes: Vec::new() });
    }
    judge::check_tilt(counted(&frames, rejects).into_iter().map(|f| &f.pose))?;
    Ok(Start { camera, frames })
}

/// Those of all frames that are not left out.
fn counted<'a, T>(all: &'a [T], rejects: &[Option<FrameReject>]) -> Vec<&'a T> {
    all.iter().zip(rejects).filter(|(_, reject)| reject.is_none()).map(|(one, _)| one).collect()
}

fn check_number(rejects: &[Option<FrameReject>]) -> Result<(), CalibrationReject> {
    let usable = rejects.iter().filter(|reject| reject.is_none()).count();
    if usable < MIN_FRAMES {
        return Err(CalibrationReject::TooFewFrames { usable, needed: MIN_FRAMES });
    }
    Ok(())
}

const fn unsolved() -> CalibrationReject {
    CalibrationReject::NoSolution { rms_px: f64::INFINITY, limit_px: MAX_RMS_PX }
}

/// Two shots of a board that stands still differ by noise, 0.03 to 0.05 px a circle and axis; copies by what encoding them again does.
const COPY_PX: f64 = 0.02;

/// Frames that show what an earlier one shows.
fn copies(views: &[BoardView]) -> Vec<Option<FrameReject>> {
    let place = |c: &Circle| (c.column, c.row);
    let rms_px = |a: &BoardView, b: &BoardView| {
        let same = a.circles.len() == b.circles.len()
            && a.circles.iter().zip(&b.circles).all(|(p, q)| place(p) == place(q));
        let distance = |(p, q): (&Circle, &Circle)| p.ellipse_centre.distance_px(q.ellipse_centre).powi(2);
        let sum: f64 = a.circles.iter().zip(&b.circles).map(distance).sum();
        same.then(|| (sum / a.circles.len() as f64).sqrt())
    };
    let of_view = |i: usize| {
        let near = |j: usize| rms_px(&views[j], &views[i]).filter(|rms_px| *rms_px < COPY_PX);
        (0..i).find_map(|j| Some(FrameReject::Copy { of: j, rms_px: near(j)? }))
    };
    (0..views.len()).map(of_view).collect()
}

pub(super) fn pairs_of(view: &BoardView, board: &Board) -> Vec<(Vector2<f64>, Px)> {
    view.circles.iter().map(|c| (board.centre_mm(c.column, c.row), c.ellipse_centre)).collect()
}

impl CameraSolution {
    /// Whether the i-th view takes part, and if not, why.
    #[must_use]
    pub fn reject(&self, view: usize) -> Option<&FrameReject> {
        self.rejects.get(view)?.as_ref()
    }

    /// The stripes on the board of the i-th view.
    #[must_use]
    pub fn find_stripes(&self, view: usize, frame: &Frame) -> Vec<BoardStripe> {
        find_stripes(frame, &self.board, &self.views[view], &self.shared.camera, &self.frames[view].pose)
    }

    /// The camera alone, without lasers.
    ///
    /// # Errors
    /// [`CalibrationReject::NoSolution`].
    pub fn alone(self) -> Result<CameraAlone, CalibrationReject> {
        self.with_lens_that_fits(Self::alone_with_its_lens, |found| &found.misfits)
    }

    /// Solves; where what is left has the shape of a lens and the frames choose the terms, solves with all of them too, and takes that if
    /// it then fits: frames left out of the fit ask for more than chance on all of them, which one corner of the picture may not give.
    fn with_lens_that_fits<T>(
        mut self,
        solve: impl Fn(Self) -> Result<T, CalibrationReject>,
        misfits: impl Fn(&T) -> &[Misfit],
    ) -> Result<T, CalibrationReject> {
        let found = solve(self.clone())?;
        let fits = |found: &T| misfits(found).iter().all(|misfit| misfit.kind != MisfitKind::Lens);
        let may_choose = self.settings.lens == LensChoice::ByData && self.lens != LensTerms::BROWN;
        if fits(&found) || !may_choose {
            return Ok(found);
        }
        self.lens = LensTerms::BROWN;
        let trial = self
            .adjust_camera()
            .and_then(|()| lens::by_fit(&self.shared, &self.used_frames(), self.fixed(false, true)));
        let Some(trial) = trial else { return Ok(found) };
        self.trials.push(trial);
        Ok(solve(self).ok().filter(fits).unwrap_or(found))
    }

    fn alone_with_its_lens(mut self) -> Result<CameraAlone, CalibrationReject> {
        let fixed = self.fixed(false, true);
        let mut used = self.used_frames();
        own_sigmas(&self.shared, &mut used);
        let spread = scatter(&self.shared, &used);
        adjust(&mut self.shared, &mut used, &spread, fixed, Loss::Tukey).ok_or_else(unsolved)?;
        let image_px = [self.views[0].width_px, self.views[0].height_px];
        let rms = rms_of_centres(&self.shared, &used);
        let (shared, frames, board) = (self.shared.clone(), used, self.board);
        let solved = Solved { shared, frames, scatter: spread, fixed, image_px, board };
        let found = misfits(&solved).ok_or_else(unsolved)?;
        Ok(CameraAlone {
            camera: found.shared.camera,
            covariance: found.covariance,
            skew_sigma_px: found.skew_sigma_px,
            centre_rms_px: [rms.x, rms.y],
            views: (0..self.views.len()).filter(|i| self.rejects[*i].is_none()).collect(),
            misfits: found.misfits,
            lens: self.lens,
            lens_trials: self.trials,
        })
    }

    /// Camera and lens from the circles, frames that do not fit left out, and whether the frames that are left fix them.
    fn solve_circles(&mut self) -> Result<(), CalibrationReject> {
        self.adjust_and_judge().ok_or_else(unsolved)?;
        if self.settings.lens == LensChoice::ByData {
            let before = self.lens;
            let fixed = self.fixed(false, true);
            (self.lens, self.trials) = lens::choose(&self.shared, &self.used_frames(), fixed);
            if self.lens != before {
                // What did not fit the narrower lens may fit this one.
                self.adjust_and_judge().ok_or_else(unsolved)?;
            }
        }
        let frames = counted(&self.frames, &self.rejects);
        let poses: Vec<_> = frames.iter().map(|f| f.pose).collect();
        judge::check_ratio(&counted(&self.views, &self.rejects), &self.board, &self.shared.camera, &poses)?;
        judge::check_tilt(poses.iter())?;
        let rms_px = self.rms_px().norm() / std::f64::consts::SQRT_2;
        if rms_px.is_nan() || rms_px > MAX_RMS_PX {
            return Err(CalibrationReject::NoSolution { rms_px, limit_px: MAX_RMS_PX });
        }
        check_number(&self.rejects)
    }

    fn fixed(&self, distortion: bool, planes: bool) -> Fixed {
        Fixed { skew: !self.settings.skew, distortion, lens: self.lens, planes, all: false }
    }

    /// Adjusts the camera and leaves out what does not fit. Only a finished camera judges: what a frame is off from one on the way
    /// says how far that one has to go. A frame that fits once others are left out takes part again.
    fn adjust_and_judge(&mut self) -> Option<()> {
        self.adjust_camera()?;
        for _ in 0..OUTLIER_ROUNDS {
            if !self.judge_frames() {
                break;
            }
            self.adjust_camera()?;
        }
        Some(())
    }

    fn adjust_camera(&mut self) -> Option<()> {
        for distortion in [true, false] {
            let mut used = self.used_frames();
            let spread = Scatter { centres: scatter(&self.shared, &used).centres, ..Scatter::EVEN };
            let fixed = self.fixed(distortion, true);
            adjust(&mut self.shared, &mut used, &spread, fixed, Loss::Huber)?;
            self.put_back(used);
        }
        for _ in 0..RIM_ROUNDS {
            self.centres_from_rims();
            let mut used = self.used_frames();
            let spread = Scatter { centres: scatter(&self.shared, &used).centres, ..Scatter::EVEN };
            let fixed = self.fixed(false, true);
            adjust(&mut self.shared, &mut used, &spread, fixed, Loss::Tukey)?;
            self.put_back(used);
        }
        Some(())
    }

    fn used_frames(&self) -> Vec<FrameObservations> {
        self.frames.iter().zip(&self.rejects).filter(|(_, r)| r.is_none()).map(|(f, _)| f.clone()).collect()
    }

    fn put_back(&mut self, used: Vec<FrameObservations>) {
        let places = self.frames.iter_mut().zip(&self.rejects).filter(|(_, r)| r.is_none());
        for ((frame, _), new) in places.zip(used) {
            *frame = new;
        }
    }

    /// Replaces the centres of ellipses by what the rims say with the present camera and poses.
    fn centres_from_rims(&mut self) {
        let radius_mm = 0.5 * self.board.diameter_mm;
        for (frame, view) in self.frames.iter_mut().zip(&self.views) {
            for (seen, circle) in frame.centres.iter_mut().zip(&view.circles) {
                let found =
                    centre_from_rim(&self.shared.camera, &frame.pose, seen.board_mm, radius_mm, &circle.rim);
                match found {
                    Some(centre) => {
                        seen.at = centre.at;
                        seen.sigma_px = centre.sigma_px.max(MIN_SIGMA_PX);
                    }
                    None => seen.sigma_px = 1e3,
                }
            }
        }
    }

    /// Leaves out the frames that the camera does not fit and takes back those that it fits; whether either happened. Copies stay out.
    fn judge_frames(&mut self) -> bool {
        self.pose_left_out_frames();
        let rms: Vec<f64> = self
            .frames
            .iter()
            .map(|frame| {
                let (centres, _) = residuals(&self.shared, frame);
                // The typical circle, not the worst: one covered circle is no reason to leave a frame out.
                let squares = centres.iter().map(|r| 0.5 * r.norm_squared());
                median(squares).map_or(f64::INFINITY, |m| (m / 0.69).sqrt())
            })
            .collect();
        let used = counted(&rms, &self.rejects).into_iter().copied();
        let limit_px = median(used).map_or(MIN_OUTLIER_PX, |m| (OUTLIER * m).max(MIN_OUTLIER_PX));
        let mut changed = false;
        for (reject, rms_px) in self.rejects.iter_mut().zip(rms) {
            let off = rms_px.is_nan() || rms_px > limit_px;
            if matches!(reject, Some(FrameReject::Copy { .. })) {
                continue;
            }
            changed |= off != reject.is_some();
            *reject = off.then_some(FrameReject::Outlier { rms_px, limit_px });
        }
        changed
    }

    /// Where the boards of left-out frames are in the present camera. One whose pose is not fixed stays where it was.
    fn pose_left_out_frames(&mut self) {
        let fixed = Fixed { all: true, ..self.fixed(false, true) };
        self.centres_from_rims();
        let judged = |reject: &Option<FrameReject>| matches!(reject, Some(FrameReject::Outlier { .. }));
        for (frame, _) in self.frames.iter_mut().zip(&self.rejects).filter(|(_, reject)| judged(reject)) {
            let mut posed = [frame.clone()];
            let posing = |posed: &mut [FrameObservations]| {
                adjust(&mut self.shared.clone(), posed, &Scatter::EVEN, fixed, Loss::Huber)
            };
            if (0..POSE_STEPS).all(|_| posing(&mut posed).is_some()) {
                let [posed] = posed;
                *frame = posed;
            }
        }
    }

    fn rms_px(&self) -> Vector2<f64> {
        rms_of_centres(&self.shared, &self.used_frames())
    }
}

/// One circle's residual.
#[derive(Clone, Copy, Debug)]
pub struct CentreResidual {
    /// Where the model projects the centre.
    pub at: Px,
    /// Observed minus projected (u, v), px.
    pub residual_px: Vector2<f64>,
    /// Whether it counted.
    pub used: bool,
}

/// One stripe centre's residual.
#[derive(Clone, Copy, Debug)]
pub struct StripeResidual {
    /// Which laser.
    pub laser: LaserId,
    /// Where it was seen.
    pub at: Px,
    /// Distance from the camera, mm along its axis.
    pub depth_mm: f64,
    /// Distance from the model across the stripe, px.
    pub residual_px: f64,
    /// Whether it counted.
    pub used: bool,
}

/// What one frame contributed.
#[derive(Clone, Debug)]
pub struct FrameResult {
    /// Which view, as given to [`solve_camera`].
    pub view: usize,
    /// Where the board is.
    pub cam_from_board: Pose<Cam, OnBoard>,
    /// Of every circle.
    pub centres: Vec<CentreResidual>,
    /// Of every stripe centre.
    pub stripes: Vec<StripeResidual>,
}

/// A solved camera without lasers.
#[derive(Clone, Debug)]
pub struct CameraAlone {
    /// The camera.
    pub camera: CameraModel,
    /// Of the camera's parameters; none of the planes.
    pub covariance: CalibrationCovariance,
    /// Sigma of the skew, px, if [`CalibrationSettings::skew`] asks for it.
    pub skew_sigma_px: Option<f64>,
    /// Root mean square of the circles' residuals, u and v, px.
    pub centre_rms_px: [f64; 2],
    /// The views that take part, as given to [`solve_camera`].
    pub views: Vec<usize>,
    /// The lens's terms.
    pub lens: LensTerms,
    /// What was tried to choose them; nothing if they were given.
    pub lens_trials: Vec<LensTrial>,
    /// What the model does not fit, the largest first.
    pub misfits: Vec<Misfit>,
}

/// A solved calibration.
#[derive(Clone, Debug)]
pub struct CalibrationSolution {
    /// The camera.
    pub camera: CameraModel,
    /// Laser 1 to 4.
    pub lasers: [Plane<Cam>; 4],
    /// What is known about them.
    pub covariance: CalibrationCovariance,
    /// Sigma of the skew, px, if [`CalibrationSettings::skew`] asks for it.
    pub skew_sigma_px: Option<f64>,
    /// Root mean square of the circles' residuals, u and v, px.
    pub centre_rms_px: [f64; 2],
    /// ... of the stripes' across, laser 1 to 4, px.
    pub stripe_rms_px: [f64; 4],
    /// How much larger circles scatter than their rims say, and stripes than speckle and noise say.
    pub scatter: [f64; 2],
    /// How many neighbouring circles, and stripe centres, go together.
    pub correlation: [f64; 2],
    /// Every frame that takes part.
    pub frames: Vec<FrameResult>,
    /// The lens's terms.
    pub lens: LensTerms,
    /// What was tried to choose them; nothing if they were given.
    pub lens_trials: Vec<LensTrial>,
    /// What the model does not fit, the largest first.
    pub misfits: Vec<Misfit>,
    pub(super) next: Vec<FrameObservations>,
    pub(super) shared: Shared,
    pub(super) information: Information,
    pub(super) image_px: [usize; 2],
    pub(super) board: Board,
}

/// Solves planes and camera together. `stripes` are those of every view, from [`CameraSolution::find_stripes`]; views that
/// take no part may have none.
///
/// # Errors
/// [`CalibrationReject`] with what is missing.
pub fn solve_all(
    solution: CameraSolution,
    stripes: &[Vec<BoardStripe>],
) -> Result<CalibrationSolution, CalibrationReject> {
    solution.with_lens_that_fits(|solution| solve_with_its_lens(solution, stripes), |found| &found.misfits)
}

fn solve_with_its_lens(
    mut solution: CameraSolution,
    stripes: &[Vec<BoardStripe>],
) -> Result<CalibrationSolution, CalibrationReject> {
    let camera = solution.shared.camera;
    let none = Vec::new();
    let in_space: Vec<StripesInSpace> = (0..solution.views.len())
        .map(|i| {
            let used = solution.rejects[i].is_none();
            let stripes = if used { stripes.get(i).unwrap_or(&none) } else { &none };
            let pose = &solution.frames[i].pose;
            let in_space = |px: &Px| {
                on_board(&camera, pose, *px).map(|at| pose.transform(&Point::new(at.x, at.y, 0.0)).mm)
            };
            let points = stripes.iter().map(|s| s.points.iter().filter_map(|(px, _)| in_space(px)).collect());
            StripesInSpace { stripes, points: points.collect() }
        })
        .collect();
    let (planes, lasers) = planes::start(&in_space).map_err(|found| {
        let (frames, needed) = (found.frames, judge::MIN_LASER_FRAMES);
        match found.missing {
            Some(laser) => CalibrationReject::LaserSeenTooRarely { laser, frames, needed },
            None => CalibrationReject::PairSeenTooRarely { pair: found.pair, frames, needed },
        }
    })?;
    let ranges = judge::check_lasers(&in_space, &lasers)?;
    drop(in_space);
    judge::check_distance(&ranges)?;
    solution.shared.planes = planes;
    for (i, lasers) in lasers.iter().enumerate() {
        for (stripe, laser) in stripes.get(i).unwrap_or(&none).iter().zip(lasers) {
            let Some(laser) = *laser else { continue };
            let seen = stripe.points.iter().map(|(at, sigma_px)| StripeObservation {
                laser,
                at: *at,
                sigma_px: *sigma_px,
            });
            solution.frames[i].stripes.extend(seen);
        }
        solution.frames[i].stripes.sort_by_key(|s| s.laser);
    }
    let fixed = solution.fixed(false, false);
    let mut used = solution.used_frames();
    let mut spread = scatter(&solution.shared, &used);
    spread.stripes = spread.stripes.max(1.0);
    adjust(&mut solution.shared, &mut used, &spread, fixed, Loss::Huber).ok_or_else(unsolved)?;
    for _ in 0..RIM_ROUNDS {
        solution.put_back(used);
        solution.centres_from_rims();
        used = solution.used_frames();
        own_sigmas(&solution.shared, &mut used);
        spread = scatter(&solution.shared, &used);
        adjust(&mut solution.shared, &mut used, &spread, fixed, Loss::Tukey).ok_or_else(unsolved)?;
    }
    let views: Vec<usize> = (0..solution.views.len()).filter(|i| solution.rejects[*i].is_none()).collect();
    let image_px = [solution.views[0].width_px, solution.views[0].height_px];
    summarise(solution, used, &views, spread, image_px).ok_or_else(unsolved)
}

fn summarise(
    solution: CameraSolution,
    used: Vec<FrameObservations>,
    views: &[usize],
    spread: Scatter,
    image_px: [usize; 2],
) -> Option<CalibrationSolution> {
    let fixed = solution.fixed(false, false);
    let CameraSolution { shared, board, lens, trials, .. } = solution;
    let found = misfits(&Solved {
        shared: shared.clone(),
        frames: used.clone(),
        scatter: spread,
        fixed,
        image_px,
        board,
    })?;
    let mut frames = Vec::with_capacity(used.len());
    let mut stripe_sums = [(0.0, 0.0f64); 4];
    for (seen, view) in used.iter().zip(views) {
        let (centres, stripes) = residuals(&shared, seen);
        let plane = Plane::<Cam>::new(super::model::board_plane(&seen.pose));
        let centres = centres.iter().zip(&seen.centres).map(|(r, c)| CentreResidual {
            at: Px::new(c.at.u - r.x, c.at.v - r.y),
            residual_px: *r,
            used: r.iter().all(|x| weight(x / (c.sigma_px * spread.centres), Loss::Tukey) > 0.0),
        });
        let stripes = stripes.iter().zip(&seen.stripes).map(|(r, s)| StripeResidual {
            laser: LaserId::ALL[s.laser],
            at: s.at,
            depth_mm: 1.0 / plane.inverse_depth_per_mm(&shared.camera.ray_from_px(s.at)),
            residual_px: *r,
            used: weight(r / (s.sigma_px * spread.stripes), Loss::Tukey) > 0.0,
        });
        let stripes: Vec<StripeResidual> = stripes.collect();
        for s in stripes.iter().filter(|s| s.used) {
            stripe_sums[s.laser.index()].0 += s.residual_px * s.residual_px;
            stripe_sums[s.laser.index()].1 += 1.0;
        }
        frames.push(FrameResult {
            view: *view,
            cam_from_board: seen.pose,
            centres: centres.collect(),
            stripes,
        });
    }
    let rms = rms_of_centres(&shared, &used);
    Some(CalibrationSolution {
        camera: found.shared.camera,
        lasers: planes::typed(&found.shared.planes),
        covariance: found.covariance,
        skew_sigma_px: found.skew_sigma_px,
        centre_rms_px: [rms.x, rms.y],
        stripe_rms_px: stripe_sums.map(|(sum, n)| (sum / n.max(1.0)).sqrt()),
        scatter: [spread.centres, spread.stripes],
        correlation: [spread.centre_correlation, spread.stripe_correlation],
        frames,
        lens,
        lens_trials: trials,
        misfits: found.misfits,
        next: used,
        shared,
        information: found.information,
        image_px,
        board,
    })
}
