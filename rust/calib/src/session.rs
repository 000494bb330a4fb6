//! Frames taken one by one while somebody moves the board: is this one worth taking, and which pose is still missing? Pure: what a view
//! shows in, a verdict out. The camera need not be known: as long as fewer than three frames are taken, its focal length is guessed.

use super::board::{Board, BoardView, OnBoard};
use super::coverage::{Corner, corners_without};
use super::judge::tilt_deg;
use super::solve::{MIN_FRAMES, pairs_of};
use super::zhang;
use boxline::camera::CameraModel;
use boxline::frames::{Cam, Pose};
use boxline::units::Px;
use nalgebra::{Vector2, Vector3};

/// Twice the least with which a set is solved: every unknown is then seen more than once.
pub const ENOUGH_FRAMES: usize = 2 * MIN_FRAMES;
/// Circles that move by more between two frames are blurred by a tenth of it: an exposure lasts a tenth of the time between them.
const STILL_PX: f64 = 3.0;
/// A pose is new if it differs from each that was taken by one of these: the share of the distance, the angle between normals, and the way of
/// the circles' middle over the picture's width. Poses that differ by less tell nearly the same.
const NEW_DISTANCE: f64 = 0.15;
const NEW_ANGLE_DEG: f64 = 8.0;
const NEW_PLACE: f64 = 0.1;
/// A board counts as turned towards a side from here; the solver needs 12 degrees.
const TURNED_DEG: f64 = 15.0;
/// The farthest over the nearest; the solver needs 1.3.
const RANGE: f64 = 2.0;
/// Of the picture's width; a guess as long as frames tell nothing better: a field of view of 53 degrees.
const GUESSED_FOCAL: f64 = 1.0;
/// Fewest frames that tell a focal length, and what it may be, in widths.
const FRAMES_FOR_FOCAL: usize = 3;
const FOCAL_RANGE: std::ops::Range<f64> = 0.3..3.0;

/// A side of the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The last columns.
    Right,
    /// The last rows.
    Bottom,
    /// The first columns.
    Left,
    /// The first rows.
    Top,
}

impl Side {
    /// All.
    pub const ALL: [Self; 4] = [Self::Right, Self::Bottom, Self::Left, Self::Top];
}

impl std::fmt::Display for Side {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Right => "right",
            Self::Bottom => "bottom",
            Self::Left => "left",
            Self::Top => "top",
        })
    }
}

/// How the board stands, as well as one view tells.
#[derive(Clone, Copy, Debug)]
pub struct BoardPlace {
    /// Of the middle of the circles that are seen, mm along the camera's axis.
    pub distance_mm: f64,
    /// Between the board's normal and the camera's axis, degrees.
    pub tilt_deg: f64,
    /// The side of the picture where the board is nearest, if it is tilted.
    pub towards: Side,
    /// The middle of the circles that are seen.
    pub middle: Px,
    normal: Vector3<f64>,
}

/// What to do with a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// It holds still and is new.
    Take,
    /// Circles moved since the frame before, px rms; or there is none before it.
    Moving {
        /// `None` if the frame before shows other circles.
        shift_px: Option<f64>,
    },
    /// Nearly this pose was taken already.
    Known,
    /// The frame has another size than those before.
    OtherSize,
    /// Its circles lie on no plane before a camera.
    Unplaced,
}

/// What a set still lacks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Missing {
    /// Circles in a corner of the picture.
    Corner(Corner),
    /// The board turned so that it is nearer on this side of the picture.
    Turned(Side),
    /// The board nearer or farther.
    Distance {
        /// Seen from where to where, mm.
        range_mm: (f64, f64),
    },
    /// Just more of them.
    Frames {
        /// How many there are.
        taken: usize,
    },
}

impl std::fmt::Display for Missing {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Corner(corner) => write!(f, "circles in the picture's {corner} corner"),
            Self::Turned(side) => {
                write!(
                    f,
                    "the board turned by {TURNED_DEG:.0} degrees or more, nearer at the picture's {side}"
                )
            }
            Self::Distance { range_mm: (near, far) } => write!(
                f,
                "the board nearer or farther: seen from {near:.0} to {far:.0} mm, the farthest should be {RANGE:.0} times the nearest"
            ),
            Self::Frames { taken } => write!(f, "more frames: {taken} of {ENOUGH_FRAMES}"),
        }
    }
}

/// The frames taken so far.
#[derive(Clone, Debug)]
pub struct Session {
    board: Board,
    views: Vec<BoardView>,
    places: Vec<BoardPlace>,
    camera: Option<CameraModel>,
}

impl Session {
    /// None yet.
    #[must_use]
    pub const fn new(board: Board) -> Self {
        Self { board, views: Vec::new(), places: Vec::new(), camera: None }
    }

    /// How many.
    #[must_use]
    pub const fn taken(&self) -> usize {
        self.views.len()
    }

    /// Width and height of the frames.
    #[must_use]
    pub fn image_px(&self) -> Option<[usize; 2]> {
        self.views.first().map(|view| [view.width_px, view.height_px])
    }

    /// Where circles were seen.
    pub fn circles(&self) -> impl Iterator<Item = Px> {
        self.views.iter().flat_map(|view| &view.circles).map(|circle| circle.ellipse_centre)
    }

    /// Where the board of a view stands. `None` if its circles lie on no plane.
    #[must_use]
    pub fn place(&self, view: &BoardView) -> Option<BoardPlace> {
        let camera = self.camera.unwrap_or_else(|| guessed(view));
        place(&camera, &self.board, view)
    }

    /// Whether a view should be taken; `before` is the frame before it.
    #[must_use]
    pub fn judge(&self, view: &BoardView, before: Option<&BoardView>) -> Verdict {
        let size = |view: &BoardView| [view.width_px, view.height_px];
        if self.views.first().is_some_and(|first| size(first) != size(view)) {
            return Verdict::OtherSize;
        }
        let Some(place) = self.place(view) else { return Verdict::Unplaced };
        let shift_px = before.and_then(|before| shift_px(before, view));
        if shift_px.is_none_or(|shift| shift > STILL_PX) {
            return Verdict::Moving { shift_px };
        }
        let is_new = |taken: &BoardPlace| {
            (place.distance_mm / taken.distance_mm).ln().abs() > NEW_DISTANCE
                || place.normal.angle(&taken.normal).to_degrees() > NEW_ANGLE_DEG
                || place.middle.distance_px(taken.middle) > NEW_PLACE * view.width_px as f64
        };
        if self.places.iter().all(is_new) { Verdict::Take } else { Verdict::Known }
    }

    /// Adds a view; what all of them tell of the camera places the earlier ones anew. One whose circles lie on no plane is not added.
    pub fn take(&mut self, view: BoardView) -> bool {
        if self.place(&view).is_none() {
            return false;
        }
        self.views.push(view);
        self.camera = self.focal();
        let places = self.views.iter().map(|view| self.place(view)).collect::<Option<Vec<_>>>();
        match places {
            Some(places) => self.places = places,
            // With this camera one of them cannot be placed: go on with the guess, with which all could be.
            None => {
                self.camera = None;
                self.places = self.views.iter().filter_map(|view| self.place(view)).collect();
            }
        }
        true
    }

    /// What is missing, the most urgent first; nothing if it is enough.
    #[must_use]
    pub fn missing(&self) -> Vec<Missing> {
        let mut missing = Vec::new();
        let turned = |side: Side| self.places.iter().any(|p| p.tilt_deg >= TURNED_DEG && p.towards == side);
        missing.extend(Side::ALL.into_iter().filter(|side| !turned(*side)).map(Missing::Turned));
        let distances = self.places.iter().map(|p| p.distance_mm);
        let (near, far) = distances.fold((f64::INFINITY, 0.0f64), |(n, f), mm| (n.min(mm), f.max(mm)));
        if !self.places.is_empty() && far < RANGE * near {
            missing.push(Missing::Distance { range_mm: (near, far) });
        }
        if let Some(image_px) = self.image_px() {
            missing.extend(corners_without(|| self.circles(), image_px).into_iter().map(Missing::Corner));
        }
        if missing.is_empty() && self.taken() < ENOUGH_FRAMES {
            missing.push(Missing::Frames { taken: self.taken() });
        }
        missing
    }

    /// Zhang's closed form, if it gives a camera that can be.
    fn focal(&self) -> Option<CameraModel> {
        let first = self.views.first()?;
        let homographies: Vec<_> =
            self.views.iter().filter_map(|view| zhang::homography(&pairs_of(view, &self.board))).collect();
        if homographies.len() < FRAMES_FOR_FOCAL {
            return None;
        }
        let camera = zhang::camera(&homographies, first.width_px, first.height_px)?;
        let widths = camera.fx / first.width_px as f64;
        FOCAL_RANGE.contains(&widths).then_some(camera)
    }
}

fn guessed(view: &BoardView) -> CameraModel {
    let (width, height) = (view.width_px as f64, view.height_px as f64);
    let f = GUESSED_FOCAL * width;
    CameraModel { fx: f, fy: f, cx: 0.5 * (width - 1.0), cy: 0.5 * (height - 1.0), ..CameraModel::PINHOLE }
}

fn place(camera: &CameraModel, board: &Board, view: &BoardView) -> Option<BoardPlace> {
    let pose: Pose<Cam, OnBoard> = zhang::pose(camera, &pairs_of(view, board))?;
    let n = view.circles.len() as f64;
    let middle_mm: Vector2<f64> =
        view.circles.iter().map(|c| board.centre_mm(c.column, c.row)).sum::<Vector2<f64>>() / n;
    let sum = |of: fn(Px) -> f64| view.circles.iter().map(|c| of(c.ellipse_centre)).sum::<f64>();
    let middle = Px::new(sum(|px| px.u) / n, sum(|px| px.v) / n);
    let distance_mm = super::model::point_on_board(&pose, middle_mm).z;
    // Away from the camera: depth then falls along its x and y.
    let normal: Vector3<f64> = pose.rotation.column(2).into();
    let normal = if normal.z < 0.0 { -normal } else { normal };
    let towards = match (normal.x.abs() > normal.y.abs(), normal.x > 0.0, normal.y > 0.0) {
        (true, true, _) => Side::Right,
        (true, false, _) => Side::Left,
        (false, _, true) => Side::Bottom,
        (false, _, false) => Side::Top,
    };
    let can_be = distance_mm.is_finite() && distance_mm > 0.0 && normal.iter().all(|x| x.is_finite());
    can_be.then_some(BoardPlace { distance_mm, tilt_deg: tilt_deg(&pose), towards, middle, normal })
}

/// How far the circles that both show lie apart, px rms; each against the one that is nearest, since columns and rows may be counted
/// otherwise. `None` if half of the circles have none nearer than their neighbours.
fn shift_px(before: &BoardView, view: &BoardView) -> Option<f64> {
    let nearest = |at: Px, all: &mut dyn Iterator<Item = Px>| {
        all.map(|other| other.distance_px(at)).fold(f64::INFINITY, f64::min)
    };
    let (mut sum, mut count) = (0.0, 0usize);
    for (i, circle) in view.circles.iter().enumerate() {
        let at = circle.ellipse_centre;
        let mut others =
            view.circles.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, c)| c.ellipse_centre);
        let apart = nearest(at, &mut others);
        let shift = nearest(at, &mut before.circles.iter().map(|c| c.ellipse_centre));
        if shift < 0.25 * apart {
            sum += shift * shift;
            count += 1;
        }
    }
    (2 * count >= view.circles.len()).then(|| (sum / count.max(1) as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::Circle;
    use boxline::frames::Point;
    use nalgebra::Rotation3;

    const BOARD: Board = Board { columns: 12, rows: 11, pitch_mm: 100.0, diameter_mm: 50.0 };

    /// The board turned by so many degrees with one side nearer (0 right, 90 bottom), its middle at a place, mm.
    fn view(tilt_deg: f64, towards_deg: f64, at_mm: [f64; 3]) -> BoardView {
        let camera = CameraModel {
            fx: 2459.0,
            fy: 2454.0,
            cx: 1240.0,
            cy: 1033.0,
            k1: -0.034,
            k2: 0.32,
            ..CameraModel::PINHOLE
        };
        let (s, c) = towards_deg.to_radians().sin_cos();
        let axis = nalgebra::Unit::new_normalize(Vector3::new(-s, c, 0.0));
        let face_us = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let turn = Rotation3::from_axis_angle(&axis, tilt_deg.to_radians()) * face_us;
        let pose: Pose<Cam, OnBoard> = Pose::new(turn.into_inner(), Vector3::from(at_mm));
        let mut circles = Vec::new();
        for (row, column) in (0..11).flat_map(|r| (0..12).map(move |c| (r, c))) {
            let at = BOARD.centre_mm(column, row);
            let px = camera.px_from_point(&pose.transform(&Point::new(at.x, at.y, 0.0)));
            let inside = |px: &Px| px.u > 0.0 && px.v > 0.0 && px.u < 2591.0 && px.v < 1943.0;
            circles.extend(px.filter(inside).map(|ellipse_centre| Circle {
                column,
                row,
                ellipse_centre,
                rim: Vec::new(),
                rim_rms_px: 0.0,
            }));
        }
        BoardView { width_px: 2592, height_px: 1944, circles, rim_width_px: 3.0 }
    }

    fn take(session: &mut Session, view: BoardView) {
        assert_eq!(session.judge(&view, Some(&view)), Verdict::Take);
        assert!(session.take(view));
    }

    #[test]
    fn a_view_is_taken_once_and_only_if_it_holds_still() {
        let mut session = Session::new(BOARD);
        let first = view(20.0, 0.0, [0.0, 0.0, 1500.0]);
        assert_eq!(session.judge(&first, None), Verdict::Moving { shift_px: None });
        // 5 mm are 8 px.
        let moved = view(20.0, 0.0, [5.0, 0.0, 1500.0]);
        match session.judge(&moved, Some(&first)) {
            Verdict::Moving { shift_px: Some(px) } => assert!((px - 8.2).abs() < 0.5, "{px} px"),
            other => panic!("{other:?}"),
        }
        assert_eq!(session.judge(&view(20.0, 0.0, [1.0, 0.0, 1500.0]), Some(&first)), Verdict::Take);
        take(&mut session, first);
        let known = view(22.0, 0.0, [20.0, 0.0, 1550.0]);
        assert_eq!(session.judge(&known, Some(&known)), Verdict::Known);
        // Another tilt, distance, place.
        for new in [
            view(30.0, 0.0, [0.0, 0.0, 1500.0]),
            view(20.0, 0.0, [0.0, 0.0, 1900.0]),
            view(20.0, 0.0, [250.0, 0.0, 1500.0]),
        ] {
            assert_eq!(session.judge(&new, Some(&new)), Verdict::Take);
        }
        let small = BoardView { width_px: 1296, height_px: 972, ..view(30.0, 0.0, [0.0, 0.0, 1500.0]) };
        assert_eq!(session.judge(&small, Some(&small)), Verdict::OtherSize);
    }

    #[test]
    fn what_is_missing_is_named_until_it_is_taken() {
        let mut session = Session::new(BOARD);
        assert_eq!(session.missing(), Side::ALL.map(Missing::Turned));
        for (side, towards_deg) in Side::ALL.into_iter().zip([0.0, 90.0, 180.0, 270.0]) {
            let turned = view(25.0, towards_deg, [0.0, 0.0, 1900.0]);
            let place = session.place(&turned).unwrap();
            assert_eq!(place.towards, side);
            // The focal length is a guess at first, 5 % too long.
            assert!((place.tilt_deg - 25.0).abs() < 2.0, "{place:?}");
            take(&mut session, turned);
            assert!(!session.missing().contains(&Missing::Turned(side)), "{:?}", session.missing());
        }
        let place = session.place(&view(10.0, 0.0, [0.0, 0.0, 1900.0])).unwrap();
        assert!(
            (place.distance_mm / 1900.0 - 1.0).abs() < 0.02,
            "four tilted frames tell the focal length: {place:?}"
        );
        let corners = [Corner::TopLeft, Corner::TopRight, Corner::BottomLeft, Corner::BottomRight];
        let missing = session.missing();
        assert!(matches!(missing[0], Missing::Distance { .. }), "{missing:?}");
        assert_eq!(missing[1..], corners.map(Missing::Corner));
        // From near it fills the picture.
        take(&mut session, view(0.0, 0.0, [0.0, 0.0, 900.0]));
        assert_eq!(session.missing(), [Missing::Frames { taken: 5 }]);
        for i in 0..7 {
            let i = f64::from(i);
            take(&mut session, view(40.0, 50.0 * i, [0.0, 0.0, 1000.0 + 200.0 * i]));
        }
        assert_eq!((session.taken(), session.missing()), (ENOUGH_FRAMES, vec![]));
    }
}
