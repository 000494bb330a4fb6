//! The face's outline in the paper's single map, on a plane that the stripes gave: the Hough transform's lines that are no stripe, of
//! which four make a rectangle about the grid that the map fills: edges along its sides, stripes between them and not beyond.

use super::edge_map::EdgeMapSettings;
use super::hough::{Line, lines_beside_stripes};
use crate::calibration::Calibration;
use crate::face::extent::{crossing_on, crossing_px};
use crate::face::map_outline::{RectangleCandidate, WeightedPoint, turned};
use crate::face::outline::{Across, InitialRectangle, MOST_TURN_RAD, SIDES, outward_sign, span_mm};
use crate::face::raster::{OnPlane, PlaneRaster};
use crate::frames::{Cam, Plane};
use crate::image::Frame;
use crate::network::{EdgeMap, MapView};
use crate::reject::Reject;
use crate::units::{LaserId, Px};
use std::f64::consts::PI;

/// Which lines may make the rectangle.
#[derive(Clone, Copy, Debug)]
struct PaperOutlineSettings {
    /// Opposite sides are parallel on the plane to this, rad: the transform's cells are half a degree in the picture, more on an oblique face. More
    /// lets other lines in.
    parallel_rad: f64,
    /// Lines whose direction is tried, and lines that are kept a side; strongest first. More takes longer.
    directions_tried: usize,
    lines_a_side: usize,
    /// Share of a side along which the map must show an edge: stripes and print hide some of it. More refuses more faces.
    least_share: f64,
    /// Distance from the foot of a line at which its direction on the plane is taken, px. More reaches beyond the picture, where
    /// distortion is not known.
    along_px: f64,
}

impl PaperOutlineSettings {
    const DEFAULT: Self =
        Self { parallel_rad: 0.05, directions_tried: 12, lines_a_side: 6, least_share: 0.5, along_px: 60.0 };
}

impl Default for PaperOutlineSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// How far from the grid the map is sampled, in its pixels: more than it is wide.
const REACH_STEPS: i32 = 640;

/// A line of the picture on the plane.
#[derive(Clone, Copy)]
struct Straight {
    across: Across,
    /// How far the raster must be turned for the line to run along an axis.
    angle_rad: f64,
    /// One of its points.
    through: OnPlane,
    votes: f64,
}

/// Finds the rectangle, or says that there is none.
pub(crate) fn hough_outline(
    frame: &Frame,
    calibration: &Calibration,
    plane: &Plane<Cam>,
    map: &EdgeMap,
) -> Result<InitialRectangle, Reject> {
    let open = |sides_found: usize| Reject::RectangleOpen { sides_found: sides_found as u8 };
    let search = Search::new(calibration, plane, map.view()).ok_or_else(|| open(0))?;
    let (lines, pixels) = lines_beside_stripes(frame, calibration, plane, map.view());
    let straights: Vec<Straight> = lines.iter().filter_map(|line| search.straight(line)).collect();
    let found =
        straights.iter().take(search.settings.directions_tried).map(|s| search.best(&straights, s.angle_rad));
    let best = found.max_by(|x, y| x.score().total_cmp(&y.score())).unwrap_or(Found::Sides(0));
    let level = match best {
        Found::Sides(sides_found) => return Err(open(sides_found)),
        Found::Rectangle { sides, .. } => level(sides),
    };
    // The transform's cells are coarser than the map's pixels.
    let spot = |px| Some(WeightedPoint { at: search.raster.on_plane(calibration, px)?, weight: 1.0 });
    let spots: Vec<WeightedPoint> = pixels.iter().filter_map(|p| spot(p.at)).collect();
    let RectangleCandidate { angle, offsets_mm } =
        level.fitted(&spots, search.mm_per_px * map.view().px_per_raster_px());
    let raster = search.raster.turned(angle);
    let at = Turned { search: &search, raster: &raster };
    let clear = (0..4).filter(|side| {
        let (from, to) = span_mm(&offsets_mm, *side);
        at.along_side(SIDES[*side].0, offsets_mm[*side]).share(from, to) >= search.settings.least_share
    });
    match clear.count() {
        4 => Ok(InitialRectangle::new(raster, offsets_mm, search.mm_per_px)),
        sides_found => Err(open(sides_found)),
    }
}

/// What the search looks at.
struct Search<'a> {
    settings: PaperOutlineSettings,
    calibration: &'a Calibration,
    map: MapView<'a>,
    raster: PlaneRaster,
    /// Of a frame pixel on the face.
    mm_per_px: f64,
    /// Where the stripes cross.
    crossings: Vec<OnPlane>,
    middle_px: Px,
}

/// The best of one direction.
enum Found {
    /// So many sides have a line.
    Sides(usize),
    Rectangle {
        score: f64,
        sides: [Straight; 4],
    },
}

impl Found {
    fn score(&self) -> f64 {
        match self {
            Self::Sides(sides) => *sides as f64 - 4.0,
            Self::Rectangle { score, .. } => *score,
        }
    }
}

impl<'a> Search<'a> {
    fn new(calibration: &'a Calibration, plane: &Plane<Cam>, map: MapView<'a>) -> Option<Self> {
        let [l1, l2, l3, l4] = LaserId::ALL;
        let middle_px = crossing_px(calibration, plane, l1, l3)?;
        let raster =
            PlaneRaster::new(calibration, plane, middle_px, crossing_px(calibration, plane, l1, l4)?)?;
        let mm_per_px = raster.mm_per_px(calibration, OnPlane::zeros())?;
        let crossings = [(l1, l3), (l1, l4), (l2, l3), (l2, l4)]
            .into_iter()
            .map(|(i, j)| raster.on_plane(calibration, crossing_px(calibration, plane, i, j)?))
            .collect::<Option<Vec<_>>>()?;
        let settings = PaperOutlineSettings::default();
        Some(Self { settings, calibration, map, raster, mm_per_px, crossings, middle_px })
    }

    /// A line of the picture on the plane, if it may be a side.
    fn straight(&self, line: &Line) -> Option<Straight> {
        let (s, c) = line.theta_rad.sin_cos();
        let off_px = line.distance_px(self.middle_px);
        let foot = Px::new(self.middle_px.u - off_px * c, self.middle_px.v - off_px * s);
        let along_px = self.settings.along_px;
        let at = |by: f64| {
            let px = Px::new(foot.u - s * by * along_px, foot.v + c * by * along_px);
            self.raster.on_plane(self.calibration, px)
        };
        let direction = at(1.0)? - at(-1.0)?;
        // A line has no sense of direction.
        let folded = |angle: f64| (angle + PI / 2.0).rem_euclid(PI) - PI / 2.0;
        let along_b = folded((-direction.x).atan2(direction.y));
        let along_a = folded(direction.y.atan2(direction.x));
        let (across, angle_rad) =
            if along_b.abs() < along_a.abs() { (Across::A, along_b) } else { (Across::B, along_a) };
        let votes = f64::from(line.votes);
        (angle_rad.abs() <= MOST_TURN_RAD).then_some(Straight { across, angle_rad, through: at(0.0)?, votes })
    }

    /// The best rectangle whose sides run along the axes when the raster is turned by an angle.
    fn best(&self, straights: &[Straight], angle_rad: f64) -> Found {
        let raster = self.raster.turned(angle_rad);
        let at = Turned { search: self, raster: &raster };
        let sides = [0, 1, 2, 3].map(|side| {
            let ((across, _), sign) = (SIDES[side], outward_sign(side));
            let inner = self
                .crossings
                .iter()
                .map(|crossing| sign * across.offset(turned(*crossing, angle_rad)))
                .fold(f64::NEG_INFINITY, f64::max);
            straights
                .iter()
                .filter(|s| {
                    s.across == across && (s.angle_rad - angle_rad).abs() < self.settings.parallel_rad
                })
                .map(|s| (across.offset(turned(s.through, angle_rad)), s))
                .filter(|(offset_mm, _)| sign * offset_mm > inner)
                .take(self.settings.lines_a_side)
                .map(|(offset_mm, s)| (offset_mm, *s, at.along_side(across, offset_mm)))
                .collect::<Vec<_>>()
        });
        let found = sides.iter().filter(|s| !s.is_empty()).count();
        if found < 4 {
            return Found::Sides(found);
        }
        let stripes = LaserId::ALL.map(|id| at.along_stripe(id));
        let mut best = Found::Sides(4);
        for (a0, first, low_a) in &sides[0] {
            for (a1, second, high_a) in &sides[1] {
                for (b0, third, low_b) in &sides[2] {
                    for (b1, fourth, high_b) in &sides[3] {
                        let edges = low_a.share(*b0, *b1)
                            + high_a.share(*b0, *b1)
                            + low_b.share(*a0, *a1)
                            + high_b.share(*a0, *a1);
                        let lit: f64 = LaserId::ALL
                            .into_iter()
                            .zip(&stripes)
                            .map(|(id, stripe)| {
                                let across_a = Across::A.stripes().contains(&id);
                                if across_a { stripe.overlap(*a0, *a1) } else { stripe.overlap(*b0, *b1) }
                            })
                            .sum();
                        if edges + lit > best.score() {
                            let sides = [*first, *second, *third, *fourth];
                            best = Found::Rectangle { score: edges + lit, sides };
                        }
                    }
                }
            }
        }
        best
    }
}

/// The mean direction of four lines, and where they lie when the raster is turned by it.
fn level(sides: [Straight; 4]) -> RectangleCandidate {
    let votes: f64 = sides.iter().map(|s| s.votes).sum();
    let angle = sides.iter().map(|s| s.votes * s.angle_rad).sum::<f64>() / votes;
    RectangleCandidate { angle, offsets_mm: sides.map(|s| s.across.offset(turned(s.through, angle))) }
}

/// The search in one direction.
struct Turned<'a> {
    search: &'a Search<'a>,
    raster: &'a PlaneRaster,
}

impl Turned<'_> {
    /// What the map shows along a side at an offset.
    fn along_side(&self, across: Across, offset_mm: f64) -> Profile {
        self.profile(|along_mm| Some(across.at(offset_mm, along_mm)))
    }

    /// What the map shows along a stripe, by the offset across the sides that it crosses.
    fn along_stripe(&self, id: LaserId) -> Profile {
        let across = if Across::A.stripes().contains(&id) { Across::A } else { Across::B };
        self.profile(|offset_mm| {
            let along = crossing_on(self.search.calibration, self.raster, across, offset_mm, id)?;
            Some(across.at(offset_mm, along))
        })
    }

    fn profile(&self, place: impl Fn(f64) -> Option<OnPlane>) -> Profile {
        let Search { calibration, map, mm_per_px, .. } = self.search;
        let step_mm = mm_per_px * map.px_per_raster_px();
        let [width, height] = map.size();
        let end = map.px_from_raster(width as f64 - 0.5, height as f64 - 0.5);
        let seen = |n: i32| {
            let px = self.raster.pixel(calibration, place(f64::from(n) * step_mm)?)?;
            let inside = px.u >= -0.5 && px.v >= -0.5 && px.u <= end.u && px.v <= end.v;
            (inside && map.at(px) >= EdgeMapSettings::DEFAULT.least_probability).then_some(())
        };
        let mut sums = vec![0.0];
        for n in -REACH_STEPS..=REACH_STEPS {
            sums.push(sums[sums.len() - 1] + if seen(n).is_some() { 1.0 } else { 0.0 });
        }
        Profile { step_mm, sums }
    }
}

/// Where the map shows a line along a straight way, in steps of a pixel of the map.
struct Profile {
    step_mm: f64,
    /// How many places before each, from [`REACH_STEPS`] steps before 0 on, show one.
    sums: Vec<f64>,
}

impl Profile {
    fn before(&self, at_mm: f64) -> f64 {
        let index = (at_mm / self.step_mm + f64::from(REACH_STEPS)).round();
        self.sums[(index.max(0.0) as usize).min(self.sums.len() - 1)]
    }

    /// Share of a stretch that shows the line.
    fn share(&self, from_mm: f64, to_mm: f64) -> f64 {
        let steps = ((to_mm - from_mm) / self.step_mm).max(1.0);
        ((self.before(to_mm) - self.before(from_mm)) / steps).min(1.0)
    }

    /// A stretch against what shows the line: intersection over union.
    fn overlap(&self, from_mm: f64, to_mm: f64) -> f64 {
        let steps = ((to_mm - from_mm) / self.step_mm).max(1.0);
        let inside = self.before(to_mm) - self.before(from_mm);
        let all = self.sums[self.sums.len() - 1];
        (inside / (steps + all - inside)).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::paper_head::paper_head;
    use nalgebra::Vector3;

    const FRAME: [usize; 2] = [648, 486];
    const MAP: [usize; 2] = [256, 192];
    /// Low and high a, low and high b, mm.
    const FACE_MM: [f64; 4] = [-150.0, 190.0, -110.0, 230.0];

    /// A tilted plane 0.6 m away and a raster on it that is turned against the stripes by 6 degrees.
    fn scene() -> (Calibration, Plane<Cam>, PlaneRaster) {
        let calibration = paper_head(0.25);
        let plane = Plane::new(Vector3::new(0.15, -0.1, 1.0) / 600.0);
        let search_map = EdgeMap::new(MAP[0], MAP[1], FRAME, vec![0.0; MAP[0] * MAP[1]]).expect("sizes fit");
        let raster = Search::new(&calibration, &plane, search_map.view()).expect("in view").raster;
        (calibration, plane, raster.turned(0.1))
    }

    /// The paper's map of a face: stripes and edges as lines 1.5 px wide; `beyond_mm` is how far the stripes run on.
    fn map_of(
        calibration: &Calibration,
        raster: &PlaneRaster,
        face_mm: &[f64; 4],
        beyond_mm: f64,
        lost_side: Option<usize>,
    ) -> EdgeMap {
        let empty = EdgeMap::new(MAP[0], MAP[1], FRAME, vec![0.0; MAP[0] * MAP[1]]).expect("sizes fit");
        let [a0, a1, b0, b1] = *face_mm;
        let mut values = vec![0.0f32; MAP[0] * MAP[1]];
        let px_mm = raster.mm_per_px(calibration, OnPlane::zeros()).expect("in view") * 648.0 / 256.0;
        for (i, value) in values.iter_mut().enumerate() {
            let px = empty.view().px_from_raster((i % MAP[0]) as f64, (i / MAP[0]) as f64);
            let Some(at) = raster.on_plane(calibration, px) else { continue };
            let inside = |by: f64| at.x > a0 - by && at.x < a1 + by && at.y > b0 - by && at.y < b1 + by;
            let mut off_mm = f64::INFINITY;
            for (side, place) in [at.x - a0, at.x - a1, at.y - b0, at.y - b1].into_iter().enumerate() {
                if inside(px_mm) && lost_side != Some(side) {
                    off_mm = off_mm.min(place.abs());
                }
            }
            for id in LaserId::ALL {
                let across = if id.number() <= 2 { Across::A } else { Across::B };
                let along =
                    crossing_on(calibration, raster, across, across.offset(at), id).expect("it crosses");
                if inside(beyond_mm) {
                    off_mm = off_mm.min((across.along(at) - along).abs());
                }
            }
            *value = (-0.5 * (off_mm / (0.75 * px_mm)).powi(2)).exp() as f32;
        }
        EdgeMap::new(MAP[0], MAP[1], FRAME, values).expect("sizes fit")
    }

    fn frame() -> Frame {
        Frame::from_rgb(FRAME[0], FRAME[1], vec![0; FRAME[0] * FRAME[1] * 3]).expect("the size fits")
    }

    #[test]
    fn the_sides_are_found_to_a_pixel_of_the_map_and_stripes_are_none() {
        let (calibration, plane, raster) = scene();
        for beyond_mm in [0.0, 60.0] {
            let map = map_of(&calibration, &raster, &FACE_MM, beyond_mm, None);
            let found = hough_outline(&frame(), &calibration, &plane, &map).expect("a face");
            let unit = found.mm_per_px * map.view().px_per_raster_px();
            for (side, (across, _)) in SIDES.into_iter().enumerate() {
                let (from, to) = span_mm(&FACE_MM, side);
                for along in [from, to] {
                    let corner = raster.cam_point(across.at(FACE_MM[side], along));
                    let off = across.offset(found.raster.of_cam(&corner)) - found.offsets_mm[side];
                    assert!(
                        off.abs() < 2.0 * unit,
                        "side {side}, {beyond_mm} mm: {off} mm, {unit} mm a pixel"
                    );
                }
            }
        }
    }

    #[test]
    fn a_face_without_one_of_its_edges_is_open() {
        let (calibration, plane, raster) = scene();
        for side in 0..4 {
            let map = map_of(&calibration, &raster, &FACE_MM, 0.0, Some(side));
            let refused = hough_outline(&frame(), &calibration, &plane, &map);
            assert!(matches!(refused, Err(Reject::RectangleOpen { sides_found: 3 })), "{side}: {refused:?}");
        }
        let empty = EdgeMap::new(MAP[0], MAP[1], FRAME, vec![0.0; MAP[0] * MAP[1]]).expect("sizes fit");
        let refused = hough_outline(&frame(), &calibration, &plane, &empty);
        assert!(matches!(refused, Err(Reject::RectangleOpen { sides_found: 0 })), "{refused:?}");
    }
}
