//! Something that stands in front of a face and hides a piece of it, told by the lasers alone.
//!
//! Where a stripe meets such an object its light jumps, at once and by far, to where a nearer surface shows it. If it does so at the very
//! line that is taken for a side of the face, the object's edge may have been taken for it. Light whose run leads back to the stripe lies
//! on the floor or the wall that the box stands at; a single jump may be another laser's light on what is far behind; and a neighbour that
//! protrudes shows the foot of its wall at the line, its edge farther out. So both stripes must jump at the line, to one height, with the
//! foot below that edge elsewhere.

use super::lit::{LightSettings, StripeWidth, red_light};
use crate::calibration::Calibration;
use crate::edges::LEAST_SCATTER;
use crate::face::extent::crossing_on_px;
use crate::face::outline::{SIDES, outward_sign};
use crate::face::raster::PlaneRaster;
use crate::frames::{Plane, Point};
use crate::image::Frame;
use crate::statistics::robust_sigma_f32;
use crate::stripe::stripe_line::{ScanDirection, StripeLine};
use crate::units::{LaserId, Px};

/// How light in front of a face is looked for, and what of it is an object's. Where no reason stands, there is no record of how a value was chosen.
#[derive(Clone, Copy, Debug)]
struct InFrontSettings {
    /// Light is looked for from so far inside a side's line to so far beyond it, rows (or columns) along the stripe. More takes longer, and
    /// brighter light that begins elsewhere is looked at instead of what begins at the line.
    inside_px: i32,
    beyond_px: i32,
    /// ... and up to so far from the stripe, px along a row: 240 mm of height at 0.7 m, 700 mm at 1.2 m. More takes longer and meets other
    /// stripes.
    reach_across_px: i32,
    /// Half width of a stripe's middle. More takes in its dimmer flanks, less scatters more.
    middle: StripeWidth,
    /// Where its surroundings begin. More compares with what lies on other print, less takes its own light for that of its surroundings.
    beside: StripeWidth,
    /// Surroundings are so wide, px. More averages noise away and takes in other print.
    surroundings_px: i32,
    /// Light over scatter from which a row speaks for a stripe. More loses faint light, less joins noise to a piece.
    even_odds_light: f32,
    /// What one more of it says. More lets single rows decide.
    per_scatter: f32,
    /// The bounds of what a row says. Farther from 0 a dark row ends a piece sooner, and a bright one bridges more dark ones.
    least_row: f32,
    most_row: f32,
    /// What counts of a row's light over scatter in the mean. More lets a few bright rows make a piece clear.
    most_light: f32,
    /// A piece has so many rows and this mean of light over scatter. More misses small or dark objects, less takes noise for one.
    least_rows: i32,
    least_mean: f64,
    /// It jumps over so much, px across the stripe. More misses low objects.
    least_jump_px: f64,
    /// ... and does not lead back: where it would be at the line is at least this share of the jump away. More takes an oblique object for a
    /// wall that the box stands at.
    leads_back: f64,
    /// Less height may be a neighbour's, which hides nothing, mm; more is another laser's light behind the face. A larger range refuses faces
    /// that nothing hides.
    height_mm: [f64; 2],
    /// Heights of both stripes that differ by less than this share are one object's. More takes two things for one.
    same_height: f64,
    /// What is seen so near the line is at it, px: lines of a side that are nearer than 10 px are the same, and a piece begins some rows early
    /// or late. More takes what stands beside the face for what hides it, and misses objects whose foot is near the line.
    at_line_px: f64,
}

impl InFrontSettings {
    const DEFAULT: Self = Self {
        inside_px: 160,
        beyond_px: 220,
        reach_across_px: 170,
        middle: StripeWidth { share: 0.3, least_px: 1.0, most_px: 5.0 },
        beside: StripeWidth { share: 1.0, least_px: 4.0, most_px: 20.0 },
        surroundings_px: LightSettings::DEFAULT.surroundings_px,
        even_odds_light: 1.5,
        per_scatter: 0.5,
        least_row: -1.5,
        most_row: 2.0,
        most_light: 20.0,
        least_rows: 40,
        least_mean: 3.0,
        least_jump_px: 8.0,
        leads_back: 0.5,
        height_mm: [60.0, 700.0],
        same_height: 0.1,
        at_line_px: 15.0,
    };

    /// What a row says for a stripe; still a little more where it is brighter, so that a path keeps to the middle.
    fn row_says(&self, light: f32) -> f32 {
        let log_ratio = self.per_scatter * (light - self.even_odds_light);
        if log_ratio > 0.0 {
            log_ratio / (1.0 + log_ratio / self.most_row)
        } else {
            log_ratio.max(self.least_row)
        }
    }
}

impl Default for InFrontSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// An object in front of a face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct InFront {
    /// Height over the face's plane, mm.
    pub height_mm: f64,
    /// Where the first stripe meets it.
    pub at: Px,
}

/// A line that is taken for a side of a face.
#[derive(Clone, Copy)]
pub(crate) struct SideLine<'a> {
    pub frame: &'a Frame,
    pub calibration: &'a Calibration,
    pub raster: &'a PlaneRaster,
    /// Half the width of the stripes at their foot, px.
    pub half_width_px: f64,
    /// Size of a pixel on the face, mm.
    pub mm_per_px: f64,
    pub side: usize,
    pub offset_mm: f64,
}

impl SideLine<'_> {
    /// What both stripes of the side show in front of the face at its line, if they show the same.
    pub fn in_front(&self) -> Option<InFront> {
        let settings = &InFrontSettings::DEFAULT;
        let mut found = SIDES[self.side].0.stripes().into_iter().map(|id| {
            let strip = Strip::new(self, id, settings)?;
            strip.in_front(strip.brightest()?)
        });
        let (first, second) = (found.next()??, found.next()??);
        let [p, q] = [first.height_mm, second.height_mm];
        ((p - q).abs() < settings.same_height * p.max(q))
            .then_some(InFront { height_mm: 0.5 * (p + q), ..first })
    }
}

/// The picture beside a stripe, on the side of nearer surfaces.
struct Strip<'a> {
    line: &'a SideLine<'a>,
    settings: &'a InFrontSettings,
    id: LaserId,
    scan: ScanDirection,
    /// Row (or column) of each step from inside the side's line to beyond it, and where the stripe is in it.
    places: Vec<(i32, i32)>,
    /// Nearer surfaces show the stripe at columns that grow (1) or fall (-1).
    nearer: i32,
    middle: i32,
    beside: i32,
    /// From px along a row to px across the stripe.
    factor: f64,
}

/// A run of light that may be one stripe's.
#[derive(Clone, Copy, Default)]
struct Piece {
    score: f32,
    /// Its first step and how many there are.
    first: i32,
    count: i32,
    /// Sums for a straight line through it: steps, displacements, squares of steps, products of both.
    sums: [f32; 4],
    /// Sum of light over scatter.
    light: f32,
}

impl<'a> Strip<'a> {
    fn new(line: &'a SideLine<'a>, id: LaserId, settings: &'a InFrontSettings) -> Option<Self> {
        let SideLine { calibration, raster, half_width_px, side, offset_mm, .. } = *line;
        let at = |offset_mm: f64| crossing_on_px(calibration, raster, SIDES[side].0, offset_mm, id);
        let (start, beyond) = (at(offset_mm)?, at(offset_mm + outward_sign(side))?);
        let stripe = StripeLine::new(calibration, id, &raster.plane);
        let scan = stripe.scan;
        let outwards = if scan.along(beyond) > scan.along(start) { 1 } else { -1 };
        let first = scan.along(start).round();
        let on_face = stripe.place_at(calibration, first, scan.across(start))?;
        let (normal, distance_mm) = raster.plane.normal_and_distance_mm();
        let nearer = StripeLine::new(calibration, id, &Plane::new(normal / (0.95 * distance_mm)));
        let nearer = nearer.place_at(calibration, first, scan.across(start))?;
        let factor = on_face.bounded_factor().min(1.0);
        let [middle, beside] = [settings.middle, settings.beside]
            .map(|width| width.bounded(width.share * half_width_px / factor).round() as i32);
        let mut guess = scan.across(on_face.px);
        let steps = -settings.inside_px..=settings.beyond_px;
        let mut places = Vec::with_capacity(steps.clone().count());
        for step in steps {
            let row = first as i32 + outwards * step;
            guess = scan.across(stripe.place_at(calibration, f64::from(row), guess)?.px);
            places.push((row, guess.round() as i32));
        }
        let nearer = if scan.across(nearer.px) > scan.across(on_face.px) { 1 } else { -1 };
        Some(Self { line, settings, id, scan, places, nearer, middle, beside, factor })
    }

    /// Nearest displacement at which light is not the stripe on the face itself.
    fn nearest(&self) -> i32 {
        self.beside + self.middle + 3
    }

    /// Light over scatter in a row at each displacement from the nearest on; fewer at the picture's border.
    fn light(&self, (row, centre): (i32, i32)) -> Vec<f32> {
        let frame = self.line.frame;
        let size = [frame.width_px() as i32, frame.height_px() as i32];
        let [rows, columns] = if self.scan == ScanDirection::Rows { [size[1], size[0]] } else { size };
        if row < 0 || row >= rows {
            return Vec::new();
        }
        let red = |column: i32| {
            let (u, v) = if self.scan == ScanDirection::Rows { (column, row) } else { (row, column) };
            let at = 3 * (v as usize * size[0] as usize + u as usize);
            red_light(frame, at)[0]
        };
        let InFrontSettings { surroundings_px, reach_across_px, .. } = *self.settings;
        // Running sums from the innermost column on.
        let inner = self.nearest() - self.beside - surroundings_px;
        let columns = (inner..=reach_across_px + self.beside + surroundings_px)
            .map(|d| centre + self.nearer * d)
            .take_while(|c| (0..columns).contains(c));
        let mut sums = vec![0.0];
        let mut sum = 0.0;
        sums.extend(columns.map(|column| {
            sum += red(column);
            sum
        }));
        let mean = |from: i32, to: i32| {
            let (before, all) = (sums.get((from - inner) as usize)?, sums.get((to + 1 - inner) as usize)?);
            Some((all - before) / (to + 1 - from) as f32)
        };
        let over_surroundings = |d: i32| {
            let near = mean(d - self.beside - surroundings_px, d - self.beside)?;
            let far = mean(d + self.beside, d + self.beside + surroundings_px)?;
            Some(mean(d - self.middle, d + self.middle)? - near.max(far))
        };
        let mut light: Vec<f32> = (self.nearest()..=reach_across_px).map_while(over_surroundings).collect();
        let mut sizes: Vec<f32> = light.iter().map(|l| l.abs()).collect();
        if let Some(scatter) = robust_sigma_f32(&mut sizes) {
            light.iter_mut().for_each(|l| *l /= scatter.max(LEAST_SCATTER));
        }
        light
    }

    /// The piece of light that speaks most for a stripe: the best path over rows and displacements, a column a row at most.
    fn brightest(&self) -> Option<Piece> {
        let mut best = Piece::default();
        let mut before: Vec<Piece> = Vec::new();
        for (step, place) in (-self.settings.inside_px..).zip(&self.places) {
            let light = self.light(*place);
            let mut now = vec![Piece::default(); light.len()];
            for (d, (light, piece)) in light.iter().zip(&mut now).enumerate() {
                let near = before.get(d.saturating_sub(1)..(d + 2).min(before.len())).unwrap_or_default();
                let last = near.iter().copied().max_by(|p, q| p.score.total_cmp(&q.score));
                let last =
                    last.filter(|p| p.score > 0.0).unwrap_or(Piece { first: step, ..Piece::default() });
                let score = last.score + self.settings.row_says(*light);
                if score > 0.0 {
                    let (s, x) = (step as f32, (d as i32 + self.nearest()) as f32);
                    *piece = Piece {
                        score,
                        first: last.first,
                        count: last.count + 1,
                        sums: [
                            last.sums[0] + s,
                            last.sums[1] + x,
                            last.sums[2] + s * s,
                            last.sums[3] + s * x,
                        ],
                        light: last.light + light.min(self.settings.most_light),
                    };
                    if score > best.score {
                        best = *piece;
                    }
                }
            }
            before = now;
        }
        (best.count >= self.settings.least_rows).then_some(best)
    }

    /// The object that a piece lies on, if its edge is seen at the line.
    fn in_front(&self, piece: Piece) -> Option<InFront> {
        let SideLine { calibration, raster, mm_per_px, side, offset_mm, .. } = *self.line;
        let InFrontSettings { at_line_px, height_mm: [lowest_mm, highest_mm], .. } = *self.settings;
        let n = f64::from(piece.count);
        let [s, x, ss, sx] = piece.sums.map(f64::from);
        let slope = (n * sx - s * x) / (n * ss - s * s).max(1e-9);
        let at_line = (x - slope * s) / n;
        let jump = at_line + slope * f64::from(piece.first);
        let clear = f64::from(piece.light) >= self.settings.least_mean * n;
        let short = jump * self.factor < self.settings.least_jump_px;
        if !clear || short || at_line < self.settings.leads_back * jump {
            return None;
        }
        let (row, centre) = *self.places.get((piece.first + self.settings.inside_px) as usize)?;
        let (row, column) = (f64::from(row), f64::from(centre) + f64::from(self.nearer) * jump);
        let at = if self.scan == ScanDirection::Rows { Px::new(column, row) } else { Px::new(row, column) };
        let edge = calibration.laser(self.id).intersect(&calibration.camera().ray_from_px(at))?;
        let (normal, distance_mm) = raster.plane.normal_and_distance_mm();
        let height_mm = distance_mm - normal.dot(&edge.mm);
        let off_px = |on_plane| outward_sign(side) * (SIDES[side].0.offset(on_plane) - offset_mm) / mm_per_px;
        let seen_px = off_px(raster.on_plane(calibration, at)?);
        let foot_px = off_px(raster.of_cam(&Point::from_vector(edge.mm + normal * height_mm)));
        let hides = seen_px.abs() <= at_line_px && foot_px.abs() > at_line_px;
        (hides && (lowest_mm..highest_mm).contains(&height_mm)).then_some(InFront { height_mm, at })
    }
}

#[cfg(test)]
mod tests {
    use super::super::drawn::{DISTANCE_MM, Surface, drawn, face};
    use super::*;
    use crate::frames::{Cam, Plane};
    use nalgebra::Vector3;

    const SIDE: usize = 1;
    const OFFSET_MM: f64 = 170.0;

    /// The face up to `edge_mm` (as the camera sees it), beyond it another surface, if there is one.
    fn picture(edge_mm: f64, surface: Option<Plane<Cam>>) -> Frame {
        let (_, raster) = face();
        drawn(|on_face| {
            let on = if SIDES[SIDE].0.offset(on_face) < edge_mm { Some(raster.plane) } else { surface };
            Surface { on, paint: 1.0 }
        })
    }

    fn found(frame: &Frame) -> Option<InFront> {
        let (calibration, raster) = face();
        let mm_per_px = raster.mm_per_px(&calibration, SIDES[SIDE].0.at(OFFSET_MM, 0.0))?;
        let (calibration, raster) = (&calibration, &raster);
        let (side, offset_mm) = (SIDE, OFFSET_MM);
        SideLine { frame, calibration, raster, half_width_px: 8.0, mm_per_px, side, offset_mm }.in_front()
    }

    fn nearer_by(height_mm: f64) -> Option<Plane<Cam>> {
        Some(Plane::new(Vector3::z() / (DISTANCE_MM - height_mm)))
    }

    #[test]
    fn an_object_whose_edge_is_taken_for_a_side_is_found_with_its_height() {
        for height_mm in [90.0, 160.0, 300.0] {
            let object = found(&picture(OFFSET_MM, nearer_by(height_mm))).expect("both stripes jump");
            assert!((object.height_mm - height_mm).abs() < 0.05 * height_mm, "{object:?} for {height_mm}");
        }
    }

    #[test]
    fn what_stands_beside_the_face_or_behind_it_hides_nothing() {
        let gap_mm = 20.0 * 0.37; // 20 px between the face and the object
        let (_, raster) = face();
        let through = raster.cam_point(SIDES[SIDE].0.at(OFFSET_MM, 0.0)).mm;
        // A wall or floor that rises from the side towards the camera, by 60 degrees.
        let outwards = Vector3::new(0.5, 0.5, 0.0).normalize();
        let normal = (Vector3::z() + outwards * 3f64.sqrt()).normalize();
        let wall = Plane::new(normal / normal.dot(&through));
        for (what, frame) in [
            ("nothing", picture(OFFSET_MM, None)),
            ("a neighbour at the same height", picture(OFFSET_MM, nearer_by(0.0))),
            ("a neighbour that protrudes a little", picture(OFFSET_MM, nearer_by(30.0))),
            ("a neighbour set back", picture(OFFSET_MM, nearer_by(-150.0))),
            ("a wall", picture(OFFSET_MM, Some(wall))),
            ("an object with a gap", picture(OFFSET_MM + gap_mm, nearer_by(160.0))),
        ] {
            assert_eq!(found(&frame), None, "{what}");
        }
    }
}
