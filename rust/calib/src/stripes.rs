//! The stripes on a board whose pose is known: straight lines of the ideal image, found by voting, followed in sub-pixel
//! steps over the white of the board. No laser plane is needed beforehand.

use super::board::{Board, BoardView, OnBoard};
use super::rim::board_matrix;
use boxline::camera::CameraModel;
use boxline::eigen::symmetric_eigen;
use boxline::frames::{Cam, Pose, Ray};
use boxline::image::Frame;
use boxline::image::laser_response::{Diagonal, RidgeMap, Z_STEPS, half_laser_response, ridge_map};
use boxline::stripe::peak::{Estimator, find_peak, foot_half_width_px, speckle_px};
use boxline::units::Px;
use nalgebra::{Matrix2, Matrix3, Vector2};

/// One stripe of one frame, not yet known which laser's.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardStripe {
    /// Whether u and v grow together along it: lasers 1 and 2. Else 3 and 4.
    pub down: bool,
    /// Where it crosses the middle of the board in view, along the image's x, in the ideal image.
    pub across: f64,
    /// Its centres with their standard deviations in px across it, in order along it.
    pub points: Vec<(Px, f64)>,
}

/// Ridge strength at which a place may belong to a stripe, sigmas of the local noise.
const MIN_RIDGE: f64 = 2.0;
/// Stripes stray from the diagonals by the tilt of the board: 13 degrees at 0.4 m and 45 degrees, more if nearer.
const MAX_TURN_DEG: f64 = 30.0;
const ANGLES: usize = 121;
/// Width of a bin across, in normalised coordinates: about 4 px.
const BIN: f64 = 1.6e-3;
/// Places within this of a line belong to it in the vote, normalised.
const NEAR: f64 = 4e-3;
/// Two stripes of a pair are about 0.17 apart, normalised, and never nearer than this.
const APART: f64 = 0.03;
/// Share of the line's way over the board on which it must be seen.
const MIN_COVERAGE: f64 = 0.35;
/// Pixels along the stripe that one centre takes in.
const BLOCK_PX: usize = 4;
/// Profiles reach so far to either side, px: twice the foot of the widest stripe.
const REACH_PX: usize = 40;
/// Farthest from the voted line that a centre is looked for, px.
const SEARCH_PX: f64 = 5.0;
/// A centre needs this height over the noise and in grey levels of laser response.
const MIN_SIGNAL_TO_NOISE: f64 = 5.0;
const MIN_AMPLITUDE: f64 = 4.0;
/// Fewest centres of a stripe.
const MIN_POINTS: usize = 12;

/// A straight line `normal . (x, y) = offset` of the ideal image.
#[derive(Clone, Copy)]
struct Line {
    normal: Vector2<f64>,
    offset: f64,
}

impl Line {
    fn distance(&self, at: Vector2<f64>) -> f64 {
        self.normal.dot(&at) - self.offset
    }

    fn along(&self) -> Vector2<f64> {
        Vector2::new(-self.normal.y, self.normal.x)
    }
}

/// The part of the board that is known to be in view and white: between the outermost circles.
struct Area<'a> {
    board: &'a Board,
    low: Vector2<f64>,
    high: Vector2<f64>,
    to_board: Matrix3<f64>,
    camera: &'a CameraModel,
}

impl<'a> Area<'a> {
    fn new(
        board: &'a Board,
        view: &BoardView,
        camera: &'a CameraModel,
        pose: &Pose<Cam, OnBoard>,
    ) -> Option<Self> {
        let centres = view.circles.iter().map(|c| board.centre_mm(c.column, c.row));
        let (low, high) = centres
            .fold((Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY)), |(low, high), c| {
                (low.inf(&c), high.sup(&c))
            });
        // Beyond the outermost circles the board goes on for at least their radius and a little.
        let beyond = Vector2::repeat(0.5 * board.diameter_mm);
        let to_board = board_matrix(pose).try_inverse()?;
        Some(Self { board, low: low - beyond, high: high + beyond, to_board, camera })
    }

    fn place(&self, ideal: Vector2<f64>) -> Option<Vector2<f64>> {
        let p = self.to_board * ideal.push(1.0);
        let at = p.xy() / p.z;
        (at >= self.low && at <= self.high).then_some(at)
    }
}

/// Finds the stripes of a frame, at most two of either direction.
pub(super) fn find_stripes(
    frame: &Frame,
    board: &Board,
    view: &BoardView,
    camera: &CameraModel,
    pose: &Pose<Cam, OnBoard>,
) -> Vec<BoardStripe> {
    let Some(area) = Area::new(board, view, camera, pose) else { return Vec::new() };
    let (w, h, laser_response) = half_laser_response(frame);
    let mut lines = Vec::new();
    for (diagonal, down) in [(Diagonal::Down, true), (Diagonal::Up, false)] {
        let map = ridge_map(w, h, &laser_response, diagonal);
        let mut places = ridge_places(&map, &area);
        let base = if down { Vector2::new(1.0, -1.0) } else { Vector2::new(1.0, 1.0) }.normalize();
        for _ in 0..2 {
            let Some(line) = strongest_line(&places, base) else { break };
            if coverage(&line, &places, &area) < MIN_COVERAGE {
                break;
            }
            places.retain(|(at, _)| line.distance(*at).abs() > APART);
            lines.push((down, line));
        }
    }
    let all: Vec<Line> = lines.iter().map(|(_, line)| *line).collect();
    let middle = 0.5 * (area.low + area.high);
    let middle = board_matrix(pose) * middle.push(1.0);
    let middle = middle.xy() / middle.z;
    let mut stripes = Vec::new();
    for (i, (down, line)) in lines.iter().enumerate() {
        let others: Vec<Line> = all.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, l)| *l).collect();
        let points = follow(frame, &area, line, &others);
        if points.len() >= MIN_POINTS {
            let across = -line.distance(middle) / line.normal.x;
            stripes.push(BoardStripe { down: *down, across, points });
        }
    }
    stripes
}

/// All places of strong ridge on the board: in the ideal image, with their strength.
fn ridge_places(map: &RidgeMap, area: &Area) -> Vec<(Vector2<f64>, f64)> {
    let mut places = Vec::new();
    for j in 0..map.height {
        for i in 0..map.width {
            let px = Px::new(2.0 * i as f64 + 0.5, 2.0 * j as f64 + 0.5);
            let strength = f64::from(map.at_px(px.u as f32, px.v as f32)) / f64::from(Z_STEPS);
            if strength < MIN_RIDGE {
                continue;
            }
            let ideal = area.camera.ray_from_px(px).xy1.xy();
            if area.place(ideal).is_some() {
                places.push((ideal, strength));
            }
        }
    }
    places
}

/// The line that most ridge lies on, refined to the middle of the ridge.
fn strongest_line(places: &[(Vector2<f64>, f64)], base: Vector2<f64>) -> Option<Line> {
    if places.len() < 50 {
        return None;
    }
    let bins = (2.0 * 2.0 / BIN) as usize;
    let mut best = (0.0, Line { normal: base, offset: 0.0 });
    let mut votes = vec![0f64; bins];
    for k in 0..ANGLES {
        let turn = (k as f64 / (ANGLES - 1) as f64 * 2.0 - 1.0) * MAX_TURN_DEG.to_radians();
        let (s, c) = turn.sin_cos();
        let normal = Vector2::new(c * base.x - s * base.y, s * base.x + c * base.y);
        votes.fill(0.0);
        for (at, strength) in places {
            let bin = (normal.dot(at) / BIN + 0.5 * bins as f64) as usize;
            if let Some(v) = votes.get_mut(bin) {
                *v += strength;
            }
        }
        for (bin, v) in votes.iter().enumerate() {
            if *v > best.0 {
                best = (*v, Line { normal, offset: (bin as f64 + 0.5 - 0.5 * bins as f64) * BIN });
            }
        }
    }
    let mut line = best.1;
    for near in [NEAR, NEAR, 0.7 * NEAR, 0.5 * NEAR, 0.5 * NEAR] {
        let (mut sum, mut middle, mut square) = (0.0, Vector2::zeros(), Matrix2::zeros());
        for (at, strength) in places.iter().filter(|(at, _)| line.distance(*at).abs() < near) {
            sum += strength;
            middle += at * *strength;
            square += at * at.transpose() * *strength;
        }
        if sum <= 0.0 {
            return None;
        }
        middle /= sum;
        let eigen = symmetric_eigen(&(square / sum - middle * middle.transpose()));
        let mut normal: Vector2<f64> = eigen.vectors.column(eigen.values.imin()).into();
        if normal.x < 0.0 {
            normal = -normal;
        }
        line = Line { normal, offset: normal.dot(&middle) };
    }
    Some(line)
}

/// Share of the line's way over the board on which there is ridge.
fn coverage(line: &Line, places: &[(Vector2<f64>, f64)], area: &Area) -> f64 {
    const STEP: f64 = 4e-3;
    let bin = |at: Vector2<f64>| ((line.along().dot(&at) / STEP) + 500.0).clamp(0.0, 999.0) as usize;
    let mut seen = [false; 1000];
    for (at, _) in places.iter().filter(|(at, _)| line.distance(*at).abs() < 0.5 * NEAR) {
        seen[bin(*at)] = true;
    }
    let (mut on, mut all) = (0.0, 0.0f64);
    for (i, seen) in seen.iter().enumerate() {
        let at = line.normal * line.offset + line.along() * ((i as f64 - 499.5) * STEP);
        if area.place(at).is_some() && in_image(area, at) {
            all += 1.0;
            on += f64::from(*seen);
        }
    }
    on / all.max(10.0)
}

fn in_image(area: &Area, at: Vector2<f64>) -> bool {
    // The principal point is near the image's middle.
    let c = area.camera;
    c.px_from_ray(&Ray::new(at.x, at.y))
        .is_some_and(|px| px.u > 0.0 && px.v > 0.0 && px.u < 2.2 * c.cx && px.v < 2.2 * c.cy)
}

/// Laser response between pixels.
fn laser_response(frame: &Frame, u: f64, v: f64) -> Option<f32> {
    let (x, y) = (u.floor(), v.floor());
    if x < 0.0 || y < 0.0 || x + 1.0 >= frame.width_px() as f64 || y + 1.0 >= frame.height_px() as f64 {
        return None;
    }
    let (fx, fy) = ((u - x) as f32, (v - y) as f32);
    let stride = 3 * frame.width_px();
    let first = y as usize * stride + x as usize * 3;
    let at = |i: usize| {
        let p = &frame.rgb()[i..i + 3];
        f32::from(p[0]) - 0.5 * (f32::from(p[1]) + f32::from(p[2]))
    };
    let top = at(first) * (1.0 - fx) + at(first + 3) * fx;
    let bottom = at(first + stride) * (1.0 - fx) + at(first + stride + 3) * fx;
    Some(top * (1.0 - fy) + bottom * fy)
}

/// Profile across the stripe at a place on its line, with the place and the normal in px.
struct Cut {
    at: Vector2<f64>,
    normal: Vector2<f64>,
    profile: Vec<f32>,
    usable: bool,
}

/// Sub-pixel centres along a line, only where nothing but white lies beside the stripe.
fn follow(frame: &Frame, area: &Area, line: &Line, others: &[Line]) -> Vec<(Px, f64)> {
    let camera = area.camera;
    let mean_f = 0.5 * (camera.fx + camera.fy);
    let step = 1.0 / mean_f;
    let mut cuts: Vec<Cut> = Vec::new();
    let mut t = -1.2;
    while t < 1.2 {
        t += step;
        let ideal = line.normal * line.offset + line.along() * t;
        let Some(on_board) = area.place(ideal) else { continue };
        let Some((px, px_by_ray)) = camera.px_from_ray_with_jacobian(&Ray::new(ideal.x, ideal.y)) else {
            continue;
        };
        let tangent = px_by_ray * line.along();
        let mut normal = Vector2::new(-tangent.y, tangent.x).normalize();
        if normal.x < 0.0 {
            normal = -normal;
        }
        let at = Vector2::new(px.u, px.v);
        let profile: Option<Vec<f32>> = (0..=2 * REACH_PX)
            .map(|k| {
                let p = at + normal * (k as f64 - REACH_PX as f64);
                laser_response(frame, p.x, p.y)
            })
            .collect();
        let Some(profile) = profile else { continue };
        // Distances in px become mm on the board by the local scale, from the next place along.
        let next = area.to_board * (ideal + line.along() * step).push(1.0);
        let mm_per_px = (next.xy() / next.z - on_board).norm().max(1e-6);
        let clear_px = area.board.from_rim_mm(on_board) / mm_per_px;
        let crossing_px =
            others.iter().map(|o| o.distance(ideal).abs() * mean_f).fold(f64::INFINITY, f64::min);
        // Until the width is known: room for the stripe itself.
        cuts.push(Cut { at, normal, profile, usable: clear_px.min(crossing_px) > 12.0 });
        let last = cuts.len() - 1;
        cuts[last].usable &= on_board >= area.low && on_board <= area.high;
    }
    let usable = cuts.iter().filter(|c| c.usable);
    let half_width_px = half_width_px(usable.map(|c| c.profile.as_slice())).unwrap_or(9.0);
    let mut points = Vec::new();
    for block in cuts.chunks_exact(BLOCK_PX) {
        // A block must be of one piece: the line may leave the image and come back.
        let length = (block[BLOCK_PX - 1].at - block[0].at).norm();
        if block.iter().any(|c| !c.usable) || length > 2.0 * BLOCK_PX as f64 {
            continue;
        }
        let mut mean = vec![0f32; 2 * REACH_PX + 1];
        for cut in block {
            mean.iter_mut().zip(&cut.profile).for_each(|(m, p)| *m += p / BLOCK_PX as f32);
        }
        let reach = ((2.0 * half_width_px + SEARCH_PX).ceil() as usize).min(REACH_PX);
        let profile = &mean[REACH_PX - reach..=REACH_PX + reach];
        let Some(peak) =
            find_peak(profile, reach as f64, SEARCH_PX, half_width_px, Estimator::CentreOfGravity)
        else {
            continue;
        };
        let shift = peak.position - reach as f64;
        if peak.amplitude < MIN_AMPLITUDE
            || peak.amplitude < MIN_SIGNAL_TO_NOISE * peak.noise
            || shift.abs() > SEARCH_PX + 1.0
        {
            continue;
        }
        let n = BLOCK_PX as f64;
        let at = block.iter().map(|c| c.at).sum::<Vector2<f64>>() / n;
        let normal = block.iter().map(|c| c.normal).sum::<Vector2<f64>>() / n;
        let centre = at + normal * shift;
        points.push((Px::new(centre.x, centre.y), peak.sigma.hypot(speckle_px(n))));
    }
    points
}

/// Half the width of the stripe at its foot from its mean profile.
fn half_width_px<'a>(profiles: impl Iterator<Item = &'a [f32]>) -> Option<f64> {
    let mut sum = vec![0f64; 2 * REACH_PX + 1];
    let mut count = 0.0;
    for profile in profiles {
        sum.iter_mut().zip(profile).for_each(|(s, p)| *s += f64::from(*p));
        count += 1.0;
    }
    if count < 16.0 {
        return None;
    }
    let even: Vec<f64> =
        (0..=REACH_PX).map(|d| (sum[REACH_PX - d] + sum[REACH_PX + d]) / (2.0 * count)).collect();
    let level = even[REACH_PX - 8..].iter().sum::<f64>() / 9.0;
    let top = even[..3].iter().copied().fold(f64::NEG_INFINITY, f64::max) - level;
    let below = even.iter().position(|y| y - level < 0.5 * top)?;
    (top > 0.0).then(|| foot_half_width_px(below as f64))
}
