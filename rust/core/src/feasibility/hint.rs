//! How to move the head so that a refused face can be measured. Where the face's rectangle is known, moves are tried on it and
//! the fewest that clear all obstacles are told; where it is not, the refusal itself says the direction.

use super::obstacle::{MARGIN, grid_middle, obstacles};
use crate::calibration::Calibration;
use crate::face_geometry::view::FacePose;
use crate::reject::Reject;
use crate::units::{LaserId, Px};
use nalgebra::{Rotation3, Vector3};
use std::fmt;

/// One move of the head. Right, down and clockwise are the user's, who looks along the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Move {
    /// Go towards the face, mm; `None` where the amount is not known.
    Closer(Option<f64>),
    /// Go away from the face, mm.
    Farther(Option<f64>),
    /// Turn the head about its line of sight, rad; negative anticlockwise.
    RollClockwise(f64),
    /// Turn the head to look elsewhere, rad; negative left and up.
    Aim {
        /// To the right.
        right_rad: f64,
        /// Downwards.
        down_rad: f64,
    },
    /// Step aside until the face is seen this much straighter, rad.
    LookStraighter(f64),
}

/// What to do about a refused view: moves in the order in which to make them.
#[derive(Clone, Debug, PartialEq)]
pub struct Hint {
    /// At least one.
    pub moves: Vec<Move>,
}

/// Which moves are tried and told. Where a field gives no reason for its value, none is on record.
#[derive(Clone, Copy, Debug)]
struct HintSettings {
    /// Room that a view has when the hint was followed, in units of the usual margin, most first: nobody moves exactly. More asks for longer moves.
    room: [f64; 3],
    /// Distances that are tried: so many steps either way, a factor of 4.8. More takes longer.
    steps: i32,
    /// ... from one of them to the next. More tells distances less exactly.
    step: f64,
    /// What such a step costs, in moves. More tells another move in place of a long way.
    step_cost: f64,
    /// Smaller angles than this are no instruction, rad: 2 degrees. More leaves out moves that would help.
    least_angle_rad: f64,
    /// By how much to aim where only the direction is known, rad: a tenth of the field of view, and half of it beside a move closer. More may lose
    /// the face at the other border.
    blind_aim_rad: f64,
}

impl HintSettings {
    const DEFAULT: Self = Self {
        room: [3.0, 1.5, 0.5],
        steps: 40,
        step: 1.04,
        step_cost: 0.02,
        least_angle_rad: 0.035,
        blind_aim_rad: 0.1,
    };
}

impl Default for HintSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl Hint {
    /// The hint for a refused view, from the rectangle that was seen (in the camera frame) or from the refusal alone. `None`
    /// if moving does not help: the rectangle could be measured from here, or the refusal is of another kind.
    pub(crate) fn new(calibration: &Calibration, seen: Option<&FacePose>, reject: &Reject) -> Option<Self> {
        if let Reject::TooFar { distance_mm, limit_mm } = reject {
            return Some(Self { moves: vec![Move::Closer(Some(distance_mm - limit_mm))] });
        }
        let geometric = matches!(
            reject,
            Reject::StripeMissing { .. }
                | Reject::FaceCutByBorder { .. }
                | Reject::RectangleOpen { .. }
                | Reject::OutlineUnsure { .. }
        );
        if !geometric {
            return None;
        }
        match seen {
            // A rectangle that stands clear here contradicts a refusal for its place: then it is not the face.
            Some(pose) if !obstacles(calibration, pose, 0.0).is_empty() => Self::for_pose(calibration, pose),
            _ => Self::blind(calibration, reject),
        }
    }

    /// The fewest moves, and among those the least change of distance, that clear all obstacles.
    pub(crate) fn for_pose(calibration: &Calibration, pose: &FacePose) -> Option<Self> {
        for room in HintSettings::DEFAULT.room {
            let mut best: Option<(f64, Self)> = None;
            for plan in plans(calibration, pose) {
                let Some((moves, moved)) = plan.carry_out(calibration, pose) else { continue };
                let cost = plan.cost(moves.len());
                if moves.is_empty() || best.as_ref().is_some_and(|(least, _)| *least <= cost) {
                    continue;
                }
                if obstacles(calibration, &moved, MARGIN * room).is_empty() {
                    best = Some((cost, Self { moves }));
                }
            }
            if let Some((_, hint)) = best {
                return Some(hint);
            }
        }
        None
    }

    /// From the refusal alone.
    fn blind(calibration: &Calibration, reject: &Reject) -> Option<Self> {
        let HintSettings { blind_aim_rad, .. } = HintSettings::DEFAULT;
        let aim_at = |px: Px| {
            let x = (px.u / f64::from(calibration.width_px()) - 0.5) * 2.0;
            let y = (px.v / f64::from(calibration.height_px()) - 0.5) * 2.0;
            // The border that is nearer is the one that cuts.
            let (right, down) = if x.abs() > y.abs() { (x.signum(), 0.0) } else { (0.0, y.signum()) };
            Move::Aim { right_rad: right * blind_aim_rad, down_rad: down * blind_aim_rad }
        };
        let moves = match reject {
            Reject::FaceCutByBorder { sides_cut: 0 | 1, at } => vec![aim_at(*at)],
            Reject::FaceCutByBorder { .. } => vec![Move::Farther(None)],
            // A stripe that misses passes beside the face: nearer, the grid is smaller.
            Reject::StripeMissing { laser, .. } => {
                let [l1, _, _, l4] = LaserId::ALL;
                // Stripes 1 and 4 are the right ones of their pairs: the face lies to their left.
                let right = if *laser == l1 || *laser == l4 { -1.0 } else { 1.0 };
                vec![Move::Closer(None), Move::Aim { right_rad: right * blind_aim_rad * 0.5, down_rad: 0.0 }]
            }
            _ => return None,
        };
        Some(Self { moves })
    }
}

/// Which moves to make, and how far; none where zero.
#[derive(Clone, Copy, Debug)]
struct PlannedMoves {
    roll_rad: f64,
    straighten: bool,
    steps: i32,
    /// Between the picture's middle (0) and the grid's (1).
    aim: Option<f64>,
}

/// All plans for a pose.
fn plans(calibration: &Calibration, pose: &FacePose) -> Vec<PlannedMoves> {
    let HintSettings { steps: most_steps, least_angle_rad, .. } = HintSettings::DEFAULT;
    let skewed = misalignment_rad(calibration, pose).filter(|angle| angle.abs() > least_angle_rad);
    let rolls = [Some(0.0), skewed, skewed.map(|angle| -angle)];
    let mut all = Vec::new();
    for roll_rad in rolls.into_iter().flatten() {
        for straighten in [false, true] {
            for steps in -most_steps..=most_steps {
                for aim in [None, Some(1.0), Some(0.5), Some(0.0)] {
                    all.push(PlannedMoves { roll_rad, straighten, steps, aim });
                }
            }
        }
    }
    all
}

impl PlannedMoves {
    fn cost(&self, moves: usize) -> f64 {
        moves as f64 + f64::from(self.steps.abs()) * HintSettings::DEFAULT.step_cost
    }

    /// The moves and where the face is then.
    fn carry_out(&self, calibration: &Calibration, pose: &FacePose) -> Option<(Vec<Move>, FacePose)> {
        let HintSettings { step, least_angle_rad, .. } = HintSettings::DEFAULT;
        let mut moves = Vec::new();
        if self.roll_rad != 0.0 {
            moves.push(Move::RollClockwise(self.roll_rad));
        }
        let tilt_rad = pose.axes.column(2).angle(&pose.middle);
        if self.straighten {
            if tilt_rad < least_angle_rad {
                return None;
            }
            moves.push(Move::LookStraighter(tilt_rad));
        }
        let change_mm = pose.middle.norm() * (step.powi(self.steps) - 1.0);
        if change_mm > 0.0 {
            moves.push(Move::Farther(Some(change_mm)));
        } else if change_mm < 0.0 {
            moves.push(Move::Closer(Some(-change_mm)));
        }
        let mut moved = follow(pose, &moves);
        if let Some(share) = self.aim {
            let middle = |n: u32| 0.5 * (f64::from(n) - 1.0);
            let centre = Px::new(middle(calibration.width_px()), middle(calibration.height_px()));
            let centre = calibration.camera().ray_from_px(centre).xy1;
            let target = grid_middle(calibration, moved.middle.z)? * share + centre * (1.0 - share);
            let right_rad = moved.middle.x.atan2(moved.middle.z) - target.x.atan();
            let turned = follow(&moved, &[Move::Aim { right_rad, down_rad: 0.0 }]);
            let down_rad = turned.middle.y.atan2(turned.middle.z) - target.y.atan();
            if right_rad.hypot(down_rad) < least_angle_rad {
                return None;
            }
            let aim = Move::Aim { right_rad, down_rad };
            moves.push(aim);
            moved = follow(&moved, &[aim]);
        }
        Some((moves, moved))
    }
}

/// Where the face is, seen from the head, after these moves. A distance that is not known stays.
pub(crate) fn follow(pose: &FacePose, moves: &[Move]) -> FacePose {
    let mut pose = *pose;
    let turn = |pose: &mut FacePose, rotation: Rotation3<f64>| {
        pose.axes = rotation.matrix() * pose.axes;
        pose.middle = rotation * pose.middle;
    };
    for one in moves {
        match *one {
            Move::Closer(by_mm) => {
                pose.middle *= 1.0 - by_mm.unwrap_or(0.0) / pose.middle.norm();
            }
            Move::Farther(by_mm) => {
                pose.middle *= 1.0 + by_mm.unwrap_or(0.0) / pose.middle.norm();
            }
            // The head turns one way, what it sees the other.
            Move::RollClockwise(angle) => {
                turn(&mut pose, Rotation3::from_axis_angle(&Vector3::z_axis(), -angle));
            }
            Move::Aim { right_rad, down_rad } => {
                turn(&mut pose, Rotation3::from_axis_angle(&Vector3::y_axis(), -right_rad));
                turn(&mut pose, Rotation3::from_axis_angle(&Vector3::x_axis(), down_rad));
            }
            Move::LookStraighter(angle) => {
                let normal: Vector3<f64> = pose.axes.column(2).into();
                let axis = nalgebra::Unit::try_new(normal.cross(&pose.middle), 1e-9);
                if let Some(axis) = axis {
                    pose.axes = Rotation3::from_axis_angle(&axis, angle).matrix() * pose.axes;
                }
            }
        }
    }
    pose
}

/// Mean angle between the stripes and the sides they should run along, rad, -45 to 45 degrees.
fn misalignment_rad(calibration: &Calibration, pose: &FacePose) -> Option<f64> {
    let (mut s, mut c) = (0.0, 0.0);
    for plane in calibration.lasers() {
        let p = plane.per_mm;
        let angle = p.dot(&pose.axes.column(0)).atan2(-p.dot(&pose.axes.column(1)));
        s += (4.0 * angle).sin();
        c += (4.0 * angle).cos();
    }
    (s.hypot(c) > 1e-6).then(|| 0.25 * s.atan2(c))
}

impl Move {
    /// The stable name, as in JSON.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Closer(_) => "closer",
            Self::Farther(_) => "farther",
            Self::RollClockwise(_) => "roll",
            Self::Aim { .. } => "aim",
            Self::LookStraighter(_) => "look_straighter",
        }
    }

    /// The numbers of the move as (name with unit, value).
    #[must_use]
    pub fn numbers(&self) -> Vec<(&'static str, f64)> {
        match *self {
            Self::Closer(by) | Self::Farther(by) => by.map(|by_mm| ("by_mm", by_mm)).into_iter().collect(),
            Self::RollClockwise(angle) => vec![("clockwise_rad", angle)],
            Self::Aim { right_rad, down_rad } => vec![("right_rad", right_rad), ("down_rad", down_rad)],
            Self::LookStraighter(angle) => vec![("by_rad", angle)],
        }
    }
}

impl fmt::Display for Move {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mm = |f: &mut fmt::Formatter<'_>, by: &Option<f64>, way: &str| match by {
            Some(by_mm) => write!(f, "go {:.0} cm {way}", (by_mm / 10.0).max(1.0)),
            None => write!(f, "go {way}"),
        };
        match self {
            Self::Closer(by) => mm(f, by, "closer"),
            Self::Farther(by) => mm(f, by, "farther away"),
            Self::RollClockwise(angle) => {
                let way = if *angle > 0.0 { "clockwise" } else { "anticlockwise" };
                write!(f, "roll the head by {:.0} degrees {way}", angle.to_degrees().abs())
            }
            Self::Aim { right_rad, down_rad } => {
                let part = |angle: f64, plus: &str, minus: &str| {
                    let degrees = angle.to_degrees().abs();
                    (degrees >= 1.0)
                        .then(|| format!("{degrees:.0} degrees {}", if angle > 0.0 { plus } else { minus }))
                };
                let parts: Vec<String> =
                    [part(*right_rad, "to the right", "to the left"), part(*down_rad, "down", "up")]
                        .into_iter()
                        .flatten()
                        .collect();
                write!(f, "aim {}", parts.join(" and "))
            }
            Self::LookStraighter(angle) => {
                write!(f, "look at the face {:.0} degrees straighter", angle.to_degrees())
            }
        }
    }
}

impl fmt::Display for Hint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, one) in self.moves.iter().enumerate() {
            write!(f, "{}{one}", if i > 0 { ", " } else { "" })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::face_geometry::simulation::{drawn_face, head};
    use crate::noise::Noise;

    /// A face that can be measured, and the head moved away from there by hand's or a beginner's errors.
    fn spoilt(calibration: &Calibration, noise: &mut Noise) -> FacePose {
        let pose = drawn_face(calibration, noise);
        let mut moves = vec![];
        if noise.uniform() < 0.5 {
            moves.push(Move::RollClockwise(noise.between(-0.75, 0.75)));
        }
        if noise.uniform() < 0.5 {
            let factor = noise.between(0.4, 2.2);
            moves.push(Move::Farther(Some(pose.middle.norm() * (factor - 1.0))));
        }
        if noise.uniform() < 0.5 {
            moves.push(Move::Aim {
                right_rad: noise.between(-0.25, 0.25),
                down_rad: noise.between(-0.2, 0.2),
            });
        }
        follow(&pose, &moves)
    }

    #[test]
    fn following_the_hint_makes_the_face_feasible_even_if_followed_by_hand() {
        let calibration = head();
        let mut noise = Noise::new(41);
        let (mut refused, mut helped, mut by_hand) = (0, 0, 0);
        while refused < 300 {
            let pose = spoilt(&calibration, &mut noise);
            if obstacles(&calibration, &pose, 0.0).is_empty() {
                continue;
            }
            refused += 1;
            let Some(hint) = Hint::for_pose(&calibration, &pose) else { continue };
            let moved = follow(&pose, &hint.moves);
            assert!(obstacles(&calibration, &moved, 0.0).is_empty(), "{hint}: {moved:?}");
            helped += 1;
            // A tenth too much or too little of everything.
            let mut inexact = |x: f64| x * noise.between(0.9, 1.1);
            let moves: Vec<Move> = hint
                .moves
                .iter()
                .map(|one| match *one {
                    Move::Closer(by) => Move::Closer(by.map(&mut inexact)),
                    Move::Farther(by) => Move::Farther(by.map(&mut inexact)),
                    Move::RollClockwise(angle) => Move::RollClockwise(inexact(angle)),
                    Move::Aim { right_rad, down_rad } => {
                        Move::Aim { right_rad: inexact(right_rad), down_rad: inexact(down_rad) }
                    }
                    Move::LookStraighter(angle) => Move::LookStraighter(inexact(angle)),
                })
                .collect();
            by_hand += usize::from(obstacles(&calibration, &follow(&pose, &moves), 0.0).is_empty());
        }
        println!(
            "{helped} of {refused} refused views have a hint; {by_hand} are feasible when it is followed to 10 %"
        );
        assert!(helped * 100 >= refused * 97, "{helped} of {refused} have a hint");
        assert!(by_hand * 100 >= helped * 90, "{by_hand} of {helped}");
    }

    #[test]
    fn a_single_fault_has_a_single_cure_of_its_own_kind() {
        let calibration = head();
        let mut noise = Noise::new(42);
        let mut cures = [0; 3];
        for _ in 0..200 {
            let pose = drawn_face(&calibration, &mut noise);
            let roll = follow(&pose, &[Move::RollClockwise(0.6)]);
            let near = follow(&pose, &[Move::Closer(Some(0.45 * pose.middle.norm()))]);
            let aside = follow(&pose, &[Move::Aim { right_rad: -0.3, down_rad: 0.0 }]);
            for ((i, spoilt), wanted) in
                [roll, near, aside].iter().enumerate().zip(["roll", "farther", "aim"])
            {
                let Some(hint) = Hint::for_pose(&calibration, spoilt) else { continue };
                cures[i] += usize::from(hint.moves.iter().any(|m| m.name() == wanted));
                if wanted == "aim"
                    && hint.moves.len() == 1
                    && let Move::Aim { right_rad, .. } = hint.moves[0]
                {
                    assert!(right_rad > 0.1, "aimed left of the face: aim right, not {right_rad}");
                }
            }
        }
        assert!(cures.iter().all(|n| *n >= 150), "{cures:?}");
    }

    #[test]
    fn a_refusal_without_a_rectangle_still_says_which_way() {
        let calibration = head();
        let hint = |reject: &Reject| Hint::new(&calibration, None, reject).map(|h| h.to_string());
        let right = Reject::FaceCutByBorder { sides_cut: 1, at: Px::new(2591.0, 900.0) };
        assert_eq!(hint(&right).as_deref(), Some("aim 6 degrees to the right"));
        let all = Reject::FaceCutByBorder { sides_cut: 3, at: Px::new(2591.0, 900.0) };
        assert_eq!(hint(&all).as_deref(), Some("go farther away"));
        let missing = Reject::StripeMissing { laser: LaserId::ALL[0], stripes_on_face: 3 };
        assert_eq!(hint(&missing).as_deref(), Some("go closer, aim 3 degrees to the left"));
        assert_eq!(hint(&Reject::FaceNotPlanar { rms_px: 2.0, limit_px: 1.5 }), None);
    }
}
