//! What a frame and the network's maps show along and beside a line, as a picture of one size: [`crate::network::LineStrip`].

use crate::calibration::Calibration;
use crate::face::outline::{SIDES, outward_sign};
use crate::face::raster::PlaneRaster;
use crate::image::Frame;
use crate::network::{Channel, FaceMaps, LineStrip, STRIP, StripeLight};
use crate::units::{LaserId, Px};

/// Rows: so far outwards of the line, px. Near it a px apart, as edges are blurred; then ever wider, to a flush neighbour's middle.
const ROWS_PX: [f64; 45] = [
    -95.0, -77.0, -62.0, -50.0, -40.0, -32.0, -26.0, -21.0, -17.0, -14.0, -12.0, -11.0, -10.0, -9.0, -8.0,
    -7.0, -6.0, -5.0, -4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0,
    12.0, 14.0, 17.0, 21.0, 26.0, 32.0, 40.0, 50.0, 62.0, 77.0, 95.0,
];
/// The same for the maps, whose pixels are five of the frame's.
const MAP_ROWS_PX: [f64; 9] = [-64.0, -32.0, -16.0, -8.0, 0.0, 8.0, 16.0, 32.0, 64.0];
/// How far the strip goes beyond the side's ends, in lengths of the side: the corners belong to what is to be seen.
const BEYOND: f64 = 0.2;
const COLUMNS: usize = STRIP[2];
/// Columns are means of so many pixels along the line.
const PER_COLUMN: usize = 4;
/// Exact projections every so many columns and at both borders and the middle row; straight lines between.
const NODE: usize = 8;
const NODES: usize = COLUMNS / NODE + 1;
const REACH_PX: f64 = ROWS_PX[ROWS_PX.len() - 1];
/// What the values of the last row are divided by, so that they are about as large as the others.
const LOG_ODDS: f32 = 16.0;
const AWAY_PX: f64 = 64.0;

/// A line that may be a side.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub side: usize,
    pub offset_mm: f64,
    /// Where the side begins and ends along its direction, mm.
    pub span_mm: (f64, f64),
    /// Size of a pixel on the face, mm.
    pub mm_per_px: f64,
    /// Distance to the outline's side, px outwards.
    pub away_px: f64,
    pub strength: f32,
    pub log_odds: f32,
    /// As [`LineStrip::bin`].
    pub bin: Option<f64>,
    pub light: StripeLight,
}

/// The strip of a line; `None` if the plane is not seen there.
pub(super) fn strip(
    frame: &Frame,
    calibration: &Calibration,
    raster: &PlaneRaster,
    maps: &FaceMaps,
    place: &Place,
) -> Option<LineStrip> {
    let ((across, _), sign) = (SIDES[place.side], outward_sign(place.side));
    let (from, to) = place.span_mm;
    let pixel = |column: f64, out_px: f64| {
        let along = from + (to - from) * ((1.0 + 2.0 * BEYOND) * column / COLUMNS as f64 - BEYOND);
        raster.pixel(calibration, across.at(place.offset_mm + sign * out_px * place.mm_per_px, along))
    };
    let mut nodes = [[Px::new(0.0, 0.0); 3]; NODES];
    for (n, node) in nodes.iter_mut().enumerate() {
        for (at, out_px) in node.iter_mut().zip([-REACH_PX, 0.0, REACH_PX]) {
            *at = pixel((n * NODE) as f64, out_px)?;
        }
    }
    let between = |p: Px, q: Px, w: f64| Px::new(p.u + (q.u - p.u) * w, p.v + (q.v - p.v) * w);
    // Inside, on and outside of the line at a place along it.
    let at_column = |column: f64| {
        let n = ((column / NODE as f64) as usize).min(NODES - 2);
        let w = column / NODE as f64 - n as f64;
        [0, 1, 2].map(|i| between(nodes[n][i], nodes[n + 1][i], w))
    };
    let at_row = |[inside, line, outside]: [Px; 3], out_px: f64| {
        between(line, if out_px < 0.0 { inside } else { outside }, out_px.abs() / REACH_PX)
    };
    let mut values = vec![0.0; STRIP.iter().product()];
    let mut put = |row: usize, column: usize, channels: [f32; 3]| {
        for (channel, value) in channels.into_iter().enumerate() {
            values[(channel * STRIP[1] + row) * COLUMNS + column] = value;
        }
    };
    let facts = [place.log_odds / LOG_ODDS, place.strength, (place.away_px / AWAY_PX) as f32];
    for column in 0..COLUMNS {
        let places: [_; PER_COLUMN] =
            std::array::from_fn(|k| at_column(column as f64 + (k as f64 + 0.5) / PER_COLUMN as f64));
        for (row, out_px) in ROWS_PX.into_iter().enumerate() {
            put(row, column, mean_rgb(frame, places.map(|p| at_row(p, out_px))));
        }
        let middle = at_column(column as f64 + 0.5);
        for (i, out_px) in MAP_ROWS_PX.into_iter().enumerate() {
            let at = at_row(middle, out_px);
            let value = |channel| maps.at(channel, at);
            let laser = LaserId::ALL.map(|id| value(Channel::Laser(id))).into_iter().fold(0.0, f32::max);
            let row = ROWS_PX.len() + 2 * i;
            put(row, column, [Channel::FaceEdge, Channel::OtherEdge, Channel::FaceMask].map(value));
            put(row + 1, column, [value(Channel::Corner), value(Channel::StrayLight), laser]);
        }
        put(STRIP[1] - 1, column, facts);
    }
    let [_, middle, outside] = at_column(0.5 * COLUMNS as f64);
    let length_px = middle.distance_px(outside).max(f64::MIN_POSITIVE);
    let outwards = [(outside.u - middle.u) / length_px, (outside.v - middle.v) / length_px];
    Some(LineStrip {
        values,
        side: place.side,
        middle,
        outwards,
        log_odds: place.log_odds,
        bin: place.bin,
        light: place.light,
    })
}

/// Mean colour of the pixels, 0 to 1; black outside of the frame.
fn mean_rgb(frame: &Frame, places: [Px; PER_COLUMN]) -> [f32; 3] {
    let (width, height) = (frame.width_px(), frame.height_px());
    let (mut sum, mut count) = ([0u32; 3], 0u32);
    for at in places {
        let (u, v) = (at.u + 0.5, at.v + 0.5);
        // Through 32 bits: one instruction, where a cast to usize takes several.
        let (x, y) = (u as u32 as usize, v as u32 as usize);
        if u >= 0.0 && v >= 0.0 && x < width && y < height {
            let rgb = &frame.rgb()[(y * width + x) * 3..][..3];
            sum.iter_mut().zip(rgb).for_each(|(s, value)| *s += u32::from(*value));
            count += 1;
        }
    }
    let scale = 1.0 / (255.0 * count.max(1) as f32);
    sum.map(|s| s as f32 * scale)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::Plane;
    use crate::network::CHANNELS;
    use crate::paper_head::paper_head;
    use nalgebra::Vector3;

    /// A frame whose colours tell the place: red and green are u and v in tens of px; and maps that tell u.
    fn told_places() -> (Frame, FaceMaps) {
        let (width, height) = (2592, 1944);
        let mut rgb = Vec::with_capacity(width * height * 3);
        for v in 0..height {
            for u in 0..width {
                rgb.extend([(u / 11) as u8, (v / 11) as u8, 7]);
            }
        }
        let values = (0..CHANNELS * 256 * 192).map(|i| (i % 256) as f32 / 255.0).collect();
        let maps = FaceMaps::new(256, 192, [width, height], values).expect("sizes fit");
        (Frame::from_rgb(width, height, rgb).expect("the size fits"), maps)
    }

    #[test]
    fn rows_lie_beside_the_line_and_columns_along_it() {
        let head = paper_head(1.0);
        let plane = Plane::new(Vector3::new(0.15, -0.1, 1.0) / 900.0);
        let at = Px::new(1296.0, 972.0);
        let raster = PlaneRaster::new(&head, &plane, at, Px::new(1500.0, 1150.0)).expect("in view");
        let (frame, maps) = told_places();
        let mm_per_px = raster.mm_per_px(&head, nalgebra::Vector2::new(0.0, 0.0)).expect("in view");
        for (side, (across, _)) in SIDES.into_iter().enumerate() {
            let sign = outward_sign(side);
            let place = Place {
                light: StripeLight::default(),
                side,
                offset_mm: sign * 120.0,
                span_mm: (-90.0, 110.0),
                mm_per_px,
                away_px: 32.0,
                strength: 0.5,
                log_odds: 8.0,
                bin: None,
            };
            let strip = strip(&frame, &head, &raster, &maps, &place).expect("in view");
            let value =
                |c: usize, row: usize, column: usize| strip.values[(c * STRIP[1] + row) * COLUMNS + column];
            for (row, column) in [(0, 0), (0, 63), (22, 5), (22, 40), (30, 20), (44, 0), (44, 63)] {
                let along = -90.0 + 200.0 * (1.4 * (column as f64 + 0.5) / 64.0 - 0.2);
                let offset = sign * (120.0 + ROWS_PX[row] * mm_per_px);
                let want = raster.pixel(&head, across.at(offset, along)).expect("in view");
                let found = [0, 1].map(|c| f64::from(value(c, row, column)) * 255.0 * 11.0 + 5.0);
                // Colours change every 11 px.
                assert!(
                    (found[0] - want.u).abs() < 7.5 && (found[1] - want.v).abs() < 7.5,
                    "side {side}, row {row}, column {column}: {found:?}, {want:?} is right"
                );
            }
            let middle = raster.pixel(&head, across.at(sign * 120.0, 10.0)).expect("in view");
            assert!(strip.middle.distance_px(middle) < 0.5);
            assert!(strip.outwards[0] * (middle.u - at.u) + strip.outwards[1] * (middle.v - at.v) > 0.0);
            let in_map = value(0, 45 + 8, 32) * 255.0;
            let want = maps.raster_from_px(middle)[0] as f32;
            assert!((in_map - want).abs() < 2.0, "{in_map}, {want} is right");
            assert_eq!([0, 1, 2].map(|c| value(c, 63, 10)), [0.5, 0.5, 0.5], "facts");
            assert!(strip.values.iter().all(|v| (0.0..=1.0).contains(v)));
        }
    }

    #[test]
    fn beyond_the_frame_it_is_black() {
        let frame = Frame::from_rgb(8, 8, vec![90; 8 * 8 * 3]).expect("the size fits");
        let at = |u| [Px::new(u, 3.0); PER_COLUMN];
        assert_eq!(mean_rgb(&frame, at(3.0)), [90.0 / 255.0; 3]);
        for far in [-1.0, 8.0, 1e12, f64::NAN, f64::INFINITY] {
            assert_eq!(mean_rgb(&frame, at(far)), [0.0; 3]);
        }
    }
}
