//! Which stripe is which laser's, and a start for the four planes: total least squares through the stripes' points in
//! space, as the paper does.

use super::stripes::BoardStripe;
use boxline::eigen::symmetric_eigen;
use boxline::frames::{Cam, Plane};
use boxline::units::LaserId;
use nalgebra::{Matrix3, Vector3};

/// The stripes of one frame in space.
pub(super) struct StripesInSpace<'a> {
    pub stripes: &'a [BoardStripe],
    /// Points in the camera frame, mm, beside each stripe's own.
    pub points: Vec<Vec<Vector3<f64>>>,
}

/// A plane that strays from a stripe by more than this share of the distance has not made it, rad: half the 0.17 between
/// two stripes of a pair, with room for a board that is not quite flat.
const MAX_ANGLE: f64 = 0.03;

/// By direction and order, as the head is built (CONVENTIONS.md): of the stripes on which u and v grow together laser 1 is
/// the right one, of the others laser 4. `None` unless both are seen.
fn by_order(stripes: &[BoardStripe]) -> Vec<Option<usize>> {
    let mut lasers = vec![None; stripes.len()];
    for (down, right, left) in [(true, 0, 1), (false, 3, 2)] {
        let pair: Vec<usize> = (0..stripes.len()).filter(|i| stripes[*i].down == down).collect();
        if let [a, b] = pair[..] {
            let (r, l) = if stripes[a].across > stripes[b].across { (a, b) } else { (b, a) };
            (lasers[r], lasers[l]) = (Some(right), Some(left));
        }
    }
    lasers
}

/// The laser of every stripe of every frame, 0 to 3; `None` for stripes that fit no plane.
pub(super) type LasersOfFrames = Vec<Vec<Option<usize>>>;

/// A pair whose stripes are seen together in too few frames to tell them apart.
pub(super) struct IncompletePair {
    pub pair: [LaserId; 2],
    /// The one that is missing, if the other pair tells.
    pub missing: Option<LaserId>,
    /// Frames with both.
    pub frames: usize,
}

/// The planes (`p . X = 1`) and the laser of every stripe of every frame; `None` for stripes that fit no plane.
pub(super) fn start(
    frames: &[StripesInSpace],
) -> Result<([Vector3<f64>; 4], LasersOfFrames), IncompletePair> {
    let mut lasers: Vec<Vec<Option<usize>>> = frames.iter().map(|f| by_order(f.stripes)).collect();
    let mut planes = [Vector3::zeros(); 4];
    // The second pass has the stripes that were alone, and is without those that were not the lasers'.
    for _ in 0..3 {
        for id in LaserId::ALL {
            planes[id.index()] = robust_plane(&sets_of(frames, &lasers, id.index()))
                .ok_or_else(|| incomplete_pair(frames, &lasers, id))?;
        }
        for (frame, lasers) in frames.iter().zip(&mut lasers) {
            for (i, (stripe, points)) in frame.stripes.iter().zip(&frame.points).enumerate() {
                let range = if stripe.down { 0..2 } else { 2..4 };
                let off = |laser: &usize| mean_angle(&planes[*laser], points);
                lasers[i] = range.min_by(|a, b| off(a).total_cmp(&off(b))).filter(|l| off(l) < MAX_ANGLE);
            }
            // Two stripes cannot be one laser's: keep the better.
            for (laser, plane) in planes.iter().enumerate() {
                let mine: Vec<usize> = (0..lasers.len()).filter(|i| lasers[*i] == Some(laser)).collect();
                if let [a, b] = mine[..] {
                    let off = |i: usize| mean_angle(plane, &frame.points[i]);
                    lasers[if off(a) < off(b) { b } else { a }] = None;
                }
            }
        }
    }
    Ok((planes, lasers))
}

/// Mean angle between the plane and the points as seen from the camera, rad.
fn mean_angle(plane: &Vector3<f64>, points: &[Vector3<f64>]) -> f64 {
    let sum: f64 = points.iter().map(|p| ((plane.dot(p) - 1.0) / plane.norm()).abs() / p.norm()).sum();
    sum / points.len().max(1) as f64
}

/// Points of one stripe.
type Points = Vec<Vector3<f64>>;

fn sets_of<'a>(frames: &'a [StripesInSpace], lasers: &[Vec<Option<usize>>], laser: usize) -> Vec<&'a Points> {
    let of_frame = |(frame, lasers): (&'a StripesInSpace, &Vec<Option<usize>>)| {
        let mine = frame.points.iter().zip(lasers).filter(|(_, l)| **l == Some(laser));
        mine.map(|(p, _)| p).collect::<Vec<_>>()
    };
    frames.iter().zip(lasers).flat_map(of_frame).collect()
}

/// An exit is taken for the counterpart of another if it is so many times nearer to it than to that one's twin. The exits of a pair lie 30 mm
/// apart, and a plane that is off by 3 % has its exit off by 3 to 4 mm.
const NEARER: f64 = 2.0;

/// Which of a pair is missing. A stripe alone has no order; but a head is built symmetric about the plane of its axis and
/// its exits (y = 0), so the plane of the lone stripes leaves the camera's x axis (at 1 / p.x) where that of its counterpart in the other
/// pair does, 1 where 4, 2 where 3, and those of a pair leave it far apart. A beam that is turned moves its plane much, its exit little.
fn incomplete_pair(frames: &[StripesInSpace], lasers: &[Vec<Option<usize>>], id: LaserId) -> IncompletePair {
    let down = id.number() <= 2;
    let pair = if down { [LaserId::ALL[0], LaserId::ALL[1]] } else { [LaserId::ALL[2], LaserId::ALL[3]] };
    let both = |f: &&StripesInSpace| f.stripes.iter().filter(|s| s.down == down).count() == 2;
    let lone: Vec<&Points> = frames
        .iter()
        .filter(|f| !both(f))
        .flat_map(|f| f.stripes.iter().zip(&f.points).filter(|(s, _)| s.down == down).map(|(_, p)| p))
        .collect();
    let seen = robust_plane(&lone);
    let off = |id: LaserId| {
        let other = robust_plane(&sets_of(frames, lasers, 3 - id.index()))?;
        Some((1.0 / seen?.x - 1.0 / other.x).abs())
    };
    let missing = match (off(pair[0]), off(pair[1])) {
        (Some(first), Some(second)) if NEARER * first < second => Some(pair[1]),
        (Some(first), Some(second)) if NEARER * second < first => Some(pair[0]),
        _ => None,
    };
    IncompletePair { pair, missing, frames: frames.iter().filter(both).count() }
}

/// The plane of most stripes: fitted, then without the stripes that stray, twice.
fn robust_plane(sets: &[&Points]) -> Option<Vector3<f64>> {
    // Two frames span a plane: the pair on which most frames agree starts.
    let agreeing = |plane: &Vector3<f64>| sets.iter().filter(|s| mean_angle(plane, s) < MAX_ANGLE).count();
    let mut best: Option<(usize, Vector3<f64>)> = None;
    for i in 0..sets.len() {
        for j in 0..i {
            if let Some(plane) = plane_through(&[sets[i], sets[j]]) {
                let count = agreeing(&plane);
                if best.is_none_or(|(most, _)| count > most) {
                    best = Some((count, plane));
                }
            }
        }
    }
    let mut plane = best?.1;
    for _ in 0..2 {
        let near: Vec<&Points> = sets.iter().copied().filter(|s| mean_angle(&plane, s) < MAX_ANGLE).collect();
        plane = plane_through(&near)?;
    }
    Some(plane)
}

/// Total least squares: the normal is where the points spread least.
fn plane_through(sets: &[&Points]) -> Option<Vector3<f64>> {
    let n = sets.iter().map(|s| s.len()).sum::<usize>() as f64;
    if n < 3.0 {
        return None;
    }
    let all = || sets.iter().flat_map(|s| s.iter());
    let middle = all().sum::<Vector3<f64>>() / n;
    let spread = all().map(|p| (p - middle) * (p - middle).transpose()).sum::<Matrix3<f64>>();
    let eigen = symmetric_eigen(&spread);
    let normal: Vector3<f64> = eigen.vectors.column(eigen.values.imin()).into();
    let distance = normal.dot(&middle);
    (distance.abs() > 1.0).then(|| normal / distance)
}

/// The planes as types.
pub(super) fn typed(planes: &[Vector3<f64>; 4]) -> [Plane<Cam>; 4] {
    planes.map(Plane::new)
}
