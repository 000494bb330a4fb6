//! Whether a stripe's light lies on the face's plane, at every place along its line over the whole frame, and what that says of a line that
//! may be a side of the face.
//!
//! In linear light a stripe adds to the red of what it lies on a share of that red which is the same on print, tape and board: only angle,
//! distance and the picture's limit change it. So no light is told from dark paint: where there is little red to add to, or none can be
//! added, nothing is said. Light that lies on the plane inside a line and not beyond it shows that the face ends there. Light that goes on
//! beyond it on both stripes leaves open whether the line is print or a flush neighbour's edge; on one of them alone, or light that is
//! missing inside, speaks against the line.

use crate::calibration::Calibration;
use crate::edges::{LEAST_SCATTER, linear_light};
use crate::face::extent::{FaceStripes, crossing_on_px, inner_segment};
use crate::face::outline::{InitialRectangle, SIDES, outward_sign};
use crate::face::raster::PlaneRaster;
use crate::frames::{Cam, Plane, Point};
use crate::image::Frame;
use crate::measurement::{FaceMeasurement, SideLight};
use crate::network::StripeLight;
use crate::statistics::{robust_sigma_f32, weighted_median_f32};
use crate::stripe::stripe_line::ScanDirection;
use crate::units::{LaserId, Px};

/// A width in half widths of a stripe's foot, with bounds in px.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StripeWidth {
    /// In half widths of the stripe's foot.
    pub share: f64,
    /// Bounds, px: the width of a stripe is measured, and may be wrong. Narrower ones trust it less.
    pub least_px: f64,
    pub most_px: f64,
}

impl StripeWidth {
    pub fn bounded(&self, px: f64) -> f64 {
        px.clamp(self.least_px, self.most_px)
    }
}

/// How a stripe's light is looked at, and what it says. Where no reason stands, there is no record of how a value was chosen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LightSettings {
    /// Half width of the stripe's middle. More takes in its dimmer flanks, less scatters more.
    middle: StripeWidth,
    /// Where its surroundings begin. More compares with what lies on other print, less takes its own light for that of its surroundings.
    beside: StripeWidth,
    /// Surroundings are so wide, px. More averages noise away and takes in other print.
    pub surroundings_px: i32,
    /// The scatter is that of so many places beyond them on both sides. More is steadier and farther away.
    scatter_places: i32,
    /// What light is expected at least, of what a row's red would add as other rows do. More takes dim light for none.
    expected_share: f32,
    /// Where that is more than fits below the picture's limit, this share of what is left up to it stands for it. More takes saturated rows for
    /// unlit ones.
    headroom_share: f32,
    /// How likely a row is that is neither lit as expected nor unlit, beside the likeliest one: print. No row says more than this leaves, 2.0.
    /// More lets every row say less.
    print_likelihood: f32,
    /// What is looked at on both sides of a line, px along the stripe: from where blur and rounding are over ... More loses what ends near it.
    pub(super) nearest_px: f64,
    /// ... to any of these, since single rows may lie on anything. More looks past other edges.
    ends_px: [f64; 4],
    /// ... and to this place for a verdict. More meets other edges, less leaves more sides without one.
    verdict_px: f64,
    /// A verdict needs odds of 150 to 1 if rows were independent; a stripe's speckle makes neighbours alike (`stripe/centres`): some 10 to 1.
    /// More leaves more sides without one.
    verdict_log_odds: f64,
    /// Most that a stripe says: rows beside each other see the same, and a surface that bends away a little is taken for the face's. More lets
    /// such a surface overrule the networks.
    most_log_odds: f64,
}

impl LightSettings {
    pub const DEFAULT: Self = Self {
        middle: StripeWidth { share: 0.35, least_px: 1.0, most_px: 6.0 },
        beside: StripeWidth { share: 1.1, least_px: 5.0, most_px: 20.0 },
        surroundings_px: 5,
        scatter_places: 6,
        expected_share: 0.35,
        headroom_share: 0.7,
        print_likelihood: 0.15,
        nearest_px: 6.0,
        ends_px: [12.0, 18.0, 24.0, 30.0],
        verdict_px: 18.0,
        verdict_log_odds: 5.0,
        most_log_odds: 20.0,
    };
}

impl Default for LightSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// A stripe's line, where it crosses another line, and a place farther out.
type Crossing<'a> = (&'a LitLine, Px, Px);

/// The four stripes' lines over the frame; `None` for one that cannot be followed.
pub(crate) struct LitLines {
    lines: [Option<LitLine>; 4],
    settings: LightSettings,
}

impl LitLines {
    /// On the plane of a face's stripes.
    pub fn of(frame: &Frame, calibration: &Calibration, stripes: &FaceStripes) -> Self {
        Self::on(frame, calibration, &stripes.fit.plane, stripes.half_width_px)
    }

    fn on(frame: &Frame, calibration: &Calibration, plane: &Plane<Cam>, half_width_px: f64) -> Self {
        let settings = LightSettings::default();
        let line = |id| LitLine::new(frame, calibration, plane, id, half_width_px, &settings);
        Self { lines: LaserId::ALL.map(line), settings }
    }

    /// Where both stripes that cross a line do so, and a mm farther out; `None` for one that cannot be followed.
    fn crossings(
        &self,
        calibration: &Calibration,
        raster: &PlaneRaster,
        side: usize,
        offset_mm: f64,
    ) -> [Option<Crossing<'_>>; 2] {
        let (across, _) = SIDES[side];
        across.stripes().map(|id| {
            let at = |offset_mm: f64| crossing_on_px(calibration, raster, across, offset_mm, id);
            Some((self.lines[id.index()].as_ref()?, at(offset_mm)?, at(offset_mm + outward_sign(side))?))
        })
    }

    /// What the light of both stripes that cross a line says of it, but for a step.
    pub fn at(
        &self,
        calibration: &Calibration,
        raster: &PlaneRaster,
        side: usize,
        offset_mm: f64,
    ) -> StripeLight {
        let LightSettings { nearest_px, ends_px, most_log_odds, .. } = self.settings;
        let of_stripe = |(line, at, beyond): Crossing<'_>| {
            // Running sums outwards or inwards, for light or against it.
            let most = |sign: f64, outwards: f64| {
                let sum = |to: f64| sign * line.between(at, beyond, [nearest_px, to].map(|px| outwards * px));
                ends_px.map(sum).into_iter().fold(0.0, f64::max).min(most_log_odds)
            };
            [most(1.0, 1.0), most(-1.0, -1.0), line.to_border(at, beyond, &self.settings)]
        };
        let crossings = self.crossings(calibration, raster, side, offset_mm);
        // A stripe that cannot be followed has no light anywhere.
        let of_crossing =
            |crossing: Option<Crossing<'_>>| crossing.map_or([0.0, 0.0, -most_log_odds], of_stripe);
        let [[p, no_p, border_p], [q, no_q, border_q]] = crossings.map(of_crossing);
        StripeLight {
            beyond: [p.min(q), p.max(q)],
            missing: no_p + no_q,
            to_border: border_p.max(border_q),
            step: 0.0,
        }
    }

    /// What the light says of each side of a face that was measured along an outline, going round as its corners do.
    pub fn of_sides(
        &self,
        calibration: &Calibration,
        outline: &InitialRectangle,
        face: &FaceMeasurement,
    ) -> [SideLight; 4] {
        let raster = &outline.raster;
        [0, 1, 2, 3].map(|k| {
            let middle = Point::from_vector(0.5 * (face.corners[k].mm + face.corners[(k + 1) % 4].mm));
            let middle = raster.of_cam(&middle);
            let offset_mm = |side: usize| SIDES[side].0.offset(middle);
            // The one of the outline's sides on which it lies.
            let off = |side: &usize| (offset_mm(*side) - outline.offsets_mm[*side]).abs();
            let side = (0..4).min_by(|i, j| off(i).total_cmp(&off(j))).unwrap_or(0);
            self.verdict(calibration, raster, side, offset_mm(side))
        })
    }

    /// The same in a word.
    fn verdict(
        &self,
        calibration: &Calibration,
        raster: &PlaneRaster,
        side: usize,
        offset_mm: f64,
    ) -> SideLight {
        let LightSettings { nearest_px, verdict_px, verdict_log_odds: enough, .. } = self.settings;
        let of_stripe = |(line, at, beyond): Crossing<'_>| {
            let sum = |from: f64, to: f64| line.between(at, beyond, [from, to]);
            [sum(-verdict_px, -nearest_px), sum(nearest_px, verdict_px)]
        };
        let crossings = self.crossings(calibration, raster, side, offset_mm);
        let stripes = crossings.map(|crossing| crossing.map(of_stripe).unwrap_or_default());
        if stripes.iter().any(|[inside, _]| *inside < -enough) {
            SideLight::Contradicted
        } else if stripes.iter().any(|[_, beyond]| *beyond > enough) {
            SideLight::Open
        } else if stripes.iter().any(|[inside, beyond]| *inside > enough && *beyond < -enough) {
            SideLight::Confirmed
        } else {
            SideLight::Dark
        }
    }
}

/// What a row of the frame shows of the light in it.
#[derive(Clone, Copy, Default)]
struct Row {
    /// Linear red of the stripe's middle over its surroundings to the left and to the right, and of what it lies on if that is as there;
    /// share of full scale.
    light: [f32; 2],
    ambient: [f32; 2],
    scatter: f32,
    seen: bool,
}

/// A stripe's line over the frame.
struct LitLine {
    scan: ScanDirection,
    /// Running sums of what rows say, from row 0 on: the logarithm of how much likelier they are if the light is on the plane.
    sums: Vec<f32>,
    /// Length of the line in a row, px.
    px_per_row: f64,
}

impl LitLine {
    /// Between its crossings the stripe is on the face.
    fn new(
        frame: &Frame,
        calibration: &Calibration,
        plane: &Plane<Cam>,
        id: LaserId,
        half_width_px: f64,
        settings: &LightSettings,
    ) -> Option<Self> {
        let (line, inner, crossing) = inner_segment(calibration, plane, id)?;
        let scan = line.scan;
        let [rows, columns] = match scan {
            ScanDirection::Rows => [frame.height_px(), frame.width_px()],
            ScanDirection::Columns => [frame.width_px(), frame.height_px()],
        };
        let middle_row = (0.5 * (inner.start + inner.end)).round().clamp(0.0, rows as f64 - 1.0);
        let start = line.place_at(calibration, middle_row, scan.across(crossing))?;
        let mut found = vec![Row::default(); rows];
        let spacing = 1.0 / start.bounded_factor();
        let widths = [settings.middle, settings.beside]
            .map(|width| width.bounded(width.share * half_width_px * spacing).round() as i32);
        for outwards in [-1i32, 1] {
            let (mut guess, mut row) = (scan.across(start.px), middle_row as i32);
            while let Some(place) = (0..rows as i32)
                .contains(&row)
                .then(|| line.place_at(calibration, f64::from(row), guess))
                .flatten()
            {
                let here = scan.across(place.px);
                if !(0.0..columns as f64).contains(&here) {
                    break;
                }
                guess = here + f64::from(outwards) * place.slope;
                found[row as usize] = look(frame, scan, row, here.round() as i32, widths, settings);
                row += outwards;
            }
        }
        let inner = (inner.start.max(0.0) as usize).min(rows)..(inner.end.max(0.0) as usize + 1).min(rows);
        let share = light_share(&found[inner])?;
        let mut sums = Vec::with_capacity(rows + 1);
        sums.push(0.0);
        let mut sum = 0.0;
        for row in &found {
            sum += row.says(share, settings);
            sums.push(sum);
        }
        let px_per_row = 1f64.hypot(start.slope);
        Some(Self { scan, sums, px_per_row })
    }

    /// What speaks for light on the plane from a place to the picture's border: all rows together, less what speaks most for its having
    /// ended somewhere; `beyond` is a pixel farther out.
    fn to_border(&self, at: Px, beyond: Px, settings: &LightSettings) -> f64 {
        let LightSettings { nearest_px, most_log_odds, .. } = *settings;
        let along = self.scan.along(at);
        let outwards = (self.scan.along(beyond) - along).signum();
        let border = self.sums.len() - 1;
        let from =
            (along + outwards * nearest_px / self.px_per_row).round().clamp(0.0, border as f64) as usize;
        let (mut sum, mut most, mut most_lost) = (0.0, 0.0f32, 0.0f32);
        let mut take = |row: usize| {
            sum = outwards as f32 * (self.sums[row] - self.sums[from]);
            most = most.max(sum);
            most_lost = most_lost.max(most - sum);
        };
        if outwards > 0.0 {
            (from..=border).for_each(&mut take)
        } else {
            (0..=from).rev().for_each(&mut take)
        }
        (f64::from(sum).min(most_log_odds) - f64::from(most_lost)).clamp(-most_log_odds, most_log_odds)
    }

    /// What the rows between two distances outwards of a place say, px along the stripe; `beyond` is a pixel farther out.
    fn between(&self, at: Px, beyond: Px, [from_px, to_px]: [f64; 2]) -> f64 {
        let along = self.scan.along(at);
        let outwards = (self.scan.along(beyond) - along).signum();
        let row = |px: f64| {
            ((along + outwards * px / self.px_per_row).round().max(0.0) as usize).min(self.sums.len() - 1)
        };
        let (p, q) = (row(from_px), row(to_px));
        f64::from(self.sums[p.max(q)] - self.sums[p.min(q)])
    }
}

/// What the light adds to the red of what it lies on, as a share of that red: the median over rows, of which each counts as it could tell.
/// Rows on print, whose tone scatters, or on what is as bright as the picture can be hardly do.
fn light_share(rows: &[Row]) -> Option<f32> {
    let of_row = |row: &Row| {
        let [light, ambient] = [row.light, row.ambient].map(|[left, right]| 0.5 * (left + right));
        let step = 0.5 * (row.light[0] - row.light[1]);
        let weight = ambient.min(1.0 - ambient).max(LEAST_SCATTER) / row.scatter.hypot(step);
        (light / ambient.max(LEAST_SCATTER), weight * weight)
    };
    let mut all: Vec<(f32, f32)> = rows.iter().filter(|row| row.seen).map(of_row).collect();
    weighted_median_f32(&mut all)
}

impl Row {
    /// How much likelier the row is if the light is on the plane, as a logarithm; `share`: what light adds to the red of a row that is lit.
    /// The tone under the stripe is not seen: it is anything between those to its left and right, for lit and for unlit what suits best.
    fn says(&self, share: f32, settings: &LightSettings) -> f32 {
        if !self.seen {
            return 0.0;
        }
        let [dark, bright] = [self.ambient[0].min(self.ambient[1]), self.ambient[0].max(self.ambient[1])];
        let [least, most] = [self.light[0].min(self.light[1]), self.light[0].max(self.light[1])];
        let LightSettings { expected_share, headroom_share, print_likelihood, .. } = *settings;
        let expected = expected_share * (share * dark).min(headroom_share * (1.0 - bright)).max(0.0);
        let likelihood = |off: f32| print_likelihood + (-0.5 * (off / self.scatter).powi(2)).exp();
        let unlit = least.max(0.0) - most.min(0.0);
        (likelihood((expected - most).max(0.0)) / likelihood(unlit)).ln()
    }
}

/// Linear red of a pixel, share of full scale: the lasers' alone and the rest, if the frame has its twin, else all of it and none. `at`: the
/// index of the pixel's first byte.
#[inline]
pub(super) fn red_light(frame: &Frame, at: usize) -> [f32; 2] {
    let linear = |level: u8| linear_light()[usize::from(level)] / 255.0;
    let ambient = frame.ambient_red(at).map_or(0.0, linear);
    [linear(frame.rgb()[at]) - ambient, ambient]
}

/// A row across a stripe's line; not seen near the picture's border.
fn look(
    frame: &Frame,
    scan: ScanDirection,
    row: i32,
    centre: i32,
    [middle, beside]: [i32; 2],
    settings: &LightSettings,
) -> Row {
    let LightSettings { surroundings_px, scatter_places, .. } = *settings;
    let (width, columns) = match scan {
        ScanDirection::Rows => (frame.width_px(), frame.width_px()),
        ScanDirection::Columns => (frame.width_px(), frame.height_px()),
    };
    let step = 2 * middle + 1;
    let reach = beside + surroundings_px + step * (scatter_places + 1);
    let inside = |c: i32| (0..columns as i32).contains(&c);
    if !(inside(centre - beside - surroundings_px) && inside(centre + beside + surroundings_px)) {
        return Row::default();
    }
    let at = |column: i32| match scan {
        ScanDirection::Rows => 3 * (row as usize * width + column as usize),
        ScanDirection::Columns => 3 * (column as usize * width + row as usize),
    };
    let red = |column: i32| red_light(frame, at(column))[0];
    let mean = |from: i32, to: i32| (from..=to).map(red).sum::<f32>() / (to - from + 1) as f32;
    let [left, right] = [
        mean(centre - beside - surroundings_px, centre - beside),
        mean(centre + beside, centre + beside + surroundings_px),
    ];
    let on_line = mean(centre - middle, centre + middle);
    let light = [left, right].map(|surroundings| on_line - surroundings);
    let unlit = (centre - middle..=centre + middle).map(|column| red_light(frame, at(column))[1]);
    let ambient = if frame.has_ambient() { [unlit.sum::<f32>() / step as f32; 2] } else { [left, right] };
    // The same at places where the stripe is not.
    let mut others: Vec<f32> = Vec::with_capacity(2 * scatter_places as usize);
    let low = (centre - reach).max(0);
    let high = (centre + reach).min(columns as i32 - 1);
    for side in [-1, 1] {
        let mut before: Option<f32> = None;
        for place in 0..=scatter_places {
            let at = centre + side * (beside + surroundings_px + place * step + middle + 1);
            if at - middle < low || at + middle > high {
                break;
            }
            let here = mean(at - middle, at + middle);
            others.extend(before.map(|before| (here - before).abs()));
            before = Some(here);
        }
    }
    // Of differences of two.
    let scatter =
        robust_sigma_f32(&mut others).map_or(LEAST_SCATTER, |sigma| sigma / std::f32::consts::SQRT_2);
    Row { light, ambient, scatter: scatter.max(LEAST_SCATTER), seen: true }
}

#[cfg(test)]
mod tests {
    use super::super::drawn::{DISTANCE_MM, Surface, drawn, face};
    use super::*;
    use crate::face::extent::crossing_on;
    use crate::face::raster::OnPlane;
    use nalgebra::Vector3;

    const SIDE: usize = 1;
    const OFFSET_MM: f64 = 170.0;
    const PX_MM: f64 = 0.37; // a pixel on the face

    /// What the light says of a line so many px outwards of the side.
    fn at(frame: &Frame, out_px: f64) -> StripeLight {
        let (calibration, raster) = face();
        let lines = LitLines::on(frame, &calibration, &raster.plane, 8.0);
        lines.at(&calibration, &raster, SIDE, OFFSET_MM + out_px * PX_MM)
    }

    fn verdict(frame: &Frame, out_px: f64) -> SideLight {
        let (calibration, raster) = face();
        let lines = LitLines::on(frame, &calibration, &raster.plane, 8.0);
        lines.verdict(&calibration, &raster, SIDE, OFFSET_MM + out_px * PX_MM)
    }

    fn offset(on_face: OnPlane) -> f64 {
        SIDES[SIDE].0.offset(on_face)
    }

    #[test]
    fn light_ends_at_a_side_and_nowhere_else_whatever_is_painted_on_the_face() {
        let (_, raster) = face();
        let behind = Some(Plane::new(Vector3::z() / (DISTANCE_MM + 200.0)));
        for (what, band) in
            [("plain board", 1.0), ("a dark band inside", 0.05), ("a bright band inside", 3.0)]
        {
            let frame = drawn(|on_face| {
                let on = if offset(on_face) < OFFSET_MM { Some(raster.plane) } else { behind };
                let inside_px = (OFFSET_MM - offset(on_face)) / PX_MM;
                Surface { on, paint: if (40.0..80.0).contains(&inside_px) { band } else { 1.0 } }
            });
            let side = at(&frame, 0.0);
            assert!(side.beyond[1] < 1.0 && side.missing < 1.0, "{what}: {side:?} at the side");
            let within = at(&frame, -80.0);
            assert!(within.beyond[0] > 5.0, "{what}: {within:?} at its inner edge");
            assert!(within.missing < 1.0, "{what}: {within:?} at its inner edge");
            let outside = at(&frame, 60.0);
            assert!(outside.missing > 10.0 && outside.beyond[1] < 1.0, "{what}: {outside:?} outside");
            let verdicts = [-80.0, 0.0, 60.0].map(|out_px| verdict(&frame, out_px));
            assert_eq!(verdicts, [SideLight::Open, SideLight::Confirmed, SideLight::Contradicted], "{what}");
        }
    }

    #[test]
    fn letters_along_most_of_a_stripe_hide_neither_its_light_nor_where_that_ends() {
        let (calibration, raster) = face();
        let behind = Some(Plane::new(Vector3::z() / (DISTANCE_MM + 200.0)));
        // Their strokes end just beside the stripe: its middle and one side lie on ink, the other side on board.
        let frame = drawn(|on_face| {
            let off = offset(on_face);
            let on = if off < OFFSET_MM { Some(raster.plane) } else { behind };
            let across = SIDES[SIDE].0;
            let beside_px = |id| {
                crossing_on(&calibration, &raster, across, off, id)
                    .map(|at| (across.along(on_face) - at) / PX_MM)
            };
            let under =
                across.stripes().into_iter().filter_map(beside_px).any(|px| (-40.0..6.0).contains(&px));
            let letter = off < OFFSET_MM - 50.0 * PX_MM && (off / (60.0 * PX_MM)).rem_euclid(1.0) < 0.7;
            Surface { on, paint: if under && letter { 0.1 } else { 1.0 } }
        });
        let (side, outside) = (at(&frame, 0.0), at(&frame, 60.0));
        assert!(side.missing < 1.0 && side.beyond[1] < 1.0, "{side:?} at the side");
        assert!(outside.missing > 10.0 && outside.beyond[1] < 1.0, "{outside:?} outside");
        assert_eq!(verdict(&frame, 0.0), SideLight::Confirmed);
    }

    #[test]
    fn where_the_stripes_surroundings_differ_a_row_says_what_suits_both() {
        let row = |light, ambient| Row { light, ambient, scatter: 0.01, seen: true };
        // An edge along the stripe, whose middle is as dark as one side, as bright as the other, brighter or darker than both.
        let [dark, bright, lit, ink] = [[0.0, -0.4], [0.4, 0.0], [0.5, 0.3], [-0.1, -0.5]]
            .map(|light| row(light, [0.2, 0.6]).says(1.0, &LightSettings::DEFAULT));
        assert!(
            dark < -1.5 && bright.abs() < 0.1 && lit > 1.5 && ink.abs() < 0.1,
            "{dark} {bright} {lit} {ink}"
        );
        assert_eq!(Row { seen: false, ..row([0.5; 2], [0.2; 2]) }.says(1.0, &LightSettings::DEFAULT), 0.0);
    }

    #[test]
    fn a_flush_neighbour_is_lit_on_and_dark_surroundings_say_nothing() {
        let (_, raster) = face();
        let neighbour = drawn(|_| Surface { on: Some(raster.plane), paint: 1.0 });
        assert!(at(&neighbour, 0.0).beyond[0] > 10.0, "{:?}", at(&neighbour, 0.0));
        assert_eq!(verdict(&neighbour, 0.0), SideLight::Open);
        // Nothing tells it from a face that leaves the picture, but its far edge.
        let ends = drawn(|on_face| {
            let near = offset(on_face) < OFFSET_MM + 80.0 * PX_MM;
            Surface { on: near.then_some(raster.plane), paint: 1.0 }
        });
        let [to_border, to_its_edge] = [&neighbour, &ends].map(|frame| at(frame, 0.0).to_border);
        assert!(to_border > 10.0 && to_its_edge < -10.0, "{to_border} {to_its_edge}");
        let dark = drawn(|on_face| {
            let face = offset(on_face) < OFFSET_MM;
            Surface { on: face.then_some(raster.plane), paint: if face { 1.0 } else { 0.01 } }
        });
        let outside = at(&dark, 60.0);
        assert!(outside.missing < 2.0 && outside.beyond[1] < 2.0, "{outside:?}");
        assert_eq!(verdict(&dark, 60.0), SideLight::Dark);
    }

    #[test]
    fn light_that_goes_on_on_one_stripe_is_told_from_light_that_does_on_both() {
        let (calibration, raster) = face();
        // Beyond the line only one stripe's half is lit: no straight side has that.
        let along = SIDES[SIDE]
            .0
            .stripes()
            .map(|id| crossing_on(&calibration, &raster, SIDES[SIDE].0, OFFSET_MM, id));
        let middle = along.into_iter().flatten().sum::<f64>() / 2.0;
        let frame = drawn(|on_face| {
            let lit = offset(on_face) < OFFSET_MM || SIDES[SIDE].0.along(on_face) < middle;
            Surface { on: lit.then_some(raster.plane), paint: 1.0 }
        });
        let light = at(&frame, 0.0);
        assert!(light.beyond[0] < 1.0 && light.beyond[1] > 10.0, "{light:?}");
    }
}
