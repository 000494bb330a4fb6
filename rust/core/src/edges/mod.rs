//! The edges of a face: where along a direction a straight edge lies ([`side_scan`]), and its course found by gradients
//! along the predicted normals ([`subpixel`]) or by the paper's edge map and Hough transform ([`map`], [`hough`]).

pub(crate) mod hough;
mod line_tone;
pub(crate) mod map;
pub(crate) mod side_scan;
pub(crate) mod subpixel;

use crate::calibration::Calibration;
use crate::face::outline::InitialRectangle;
use crate::image::Frame;
use crate::statistics::robust_sigma_f32;
use crate::units::Px;
use std::ops::{Add, Mul};
use std::sync::LazyLock;
use wide::f32x4;

/// A point on a side of the face.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgePoint {
    pub at: Px,
    /// Standard deviation across the side, px.
    pub sigma_px: f64,
}

/// Finds the points of the four sides near a initial rectangle. `keep_out` are places with a radius (px) where laser light
/// disturbs.
pub(crate) trait EdgeDetector {
    /// Edge points per side, in the order of [`crate::face::outline::SIDES`].
    fn edge_points(
        &self,
        frame: &Frame,
        calibration: &Calibration,
        initial: &InitialRectangle,
        keep_out: &[(Px, f64)],
    ) -> [Vec<EdgePoint>; 4];
}

/// What edges are seen in: brightness without red, where the laser hardly shows, and the colour difference red - blue,
/// which tells cardboard from grey floor of the same brightness. Grey levels.
pub(crate) type ColourTone = [f32; 2];

/// The tone at a sub-pixel position.
#[cfg(test)]
pub(crate) fn tone(frame: &Frame, u: f64, v: f64) -> Option<ColourTone> {
    let [brightness, hue, ..] = tones(frame, Palette::get(), u, v)?.to_array();
    Some([brightness, hue])
}

/// Linear light of each grey level, full scale 255. A blurred step lies where light is half way between its sides; the tone curve
/// moves that towards the dark side, by up to a pixel.
pub(crate) fn linear_light() -> &'static [f32; 256] {
    static LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| {
        std::array::from_fn(|level| {
            let c = level as f32 / 255.0;
            255.0 * if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
        })
    });
    &LINEAR
}

/// What each level of red, green and blue adds to the tone and to the same in [`linear_light`].
pub(crate) struct Palette([[f32x4; 256]; 3]);

impl Palette {
    /// The only one.
    pub fn get() -> &'static Self {
        static PALETTE: LazyLock<Palette> = LazyLock::new(|| {
            // Brightness and hue of red, green and blue.
            Palette([[0.0, 0.5], [0.5, 0.0], [0.5, -0.5]].map(|[brightness, hue]| {
                std::array::from_fn(|level| {
                    let (grey, light) = (level as f32, linear_light()[level]);
                    f32x4::from([brightness * grey, hue * grey, brightness * light, hue * light])
                })
            }))
        });
        &PALETTE
    }
}

/// The tone at a sub-pixel position, and the same in [`linear_light`].
#[inline]
pub(crate) fn tones(frame: &Frame, palette: &Palette, u: f64, v: f64) -> Option<f32x4> {
    let [reds, greens, blues] = &palette.0;
    sampled(frame, u, v, |[red, green, blue]| {
        reds[usize::from(red)] + greens[usize::from(green)] + blues[usize::from(blue)]
    })
}

/// Brightness without red at a sub-pixel position, in [`linear_light`].
#[inline]
pub(crate) fn light(frame: &Frame, linear: &[f32; 256], u: f64, v: f64) -> Option<f32> {
    let of = |[_, green, blue]: [u8; 3]| 0.5 * (linear[usize::from(green)] + linear[usize::from(blue)]);
    sampled(frame, u, v, of)
}

/// `R - (G + B) / 2` at a sub-pixel position, grey levels: where laser light is.
#[inline]
pub(crate) fn laser_response(frame: &Frame, u: f64, v: f64) -> Option<f32> {
    let of = |[red, green, blue]: [u8; 3]| f32::from(red) - 0.5 * (f32::from(green) + f32::from(blue));
    sampled(frame, u, v, of)
}

/// What a pixel tells, at a sub-pixel position, bilinear.
#[inline]
fn sampled<T: Copy + Add<Output = T> + Mul<f32, Output = T>>(
    frame: &Frame,
    u: f64,
    v: f64,
    sample: impl Fn([u8; 3]) -> T,
) -> Option<T> {
    let (w, h) = (frame.width_px(), frame.height_px());
    if !(u >= 0.0 && v >= 0.0) {
        return None;
    }
    // Through 32 bits: one instruction, where a cast to usize takes several.
    let (x, y) = (u as u32, v as u32);
    let (fu, fv) = ((u - f64::from(x)) as f32, (v - f64::from(y)) as f32);
    let (x, y) = (x as usize, y as usize);
    if x + 1 >= w || y + 1 >= h {
        return None;
    }
    let rows = [y, y + 1].map(|row| frame.rgb().get((row * w + x) * 3..(row * w + x) * 3 + 6));
    let [Some(top), Some(bottom)] = rows else { return None };
    let sample = |p: &[u8], weight: f32| sample([p[0], p[1], p[2]]) * weight;
    let top = sample(&top[..3], (1.0 - fu) * (1.0 - fv)) + sample(&top[3..], fu * (1.0 - fv));
    Some(top + sample(&bottom[..3], (1.0 - fu) * fv) + sample(&bottom[3..], fu * fv))
}

/// Scale of zero-mean noise from the median of its absolute values; `floor` where the picture is flat.
pub(crate) fn noise_of(absolute: &mut [f32], floor: f32) -> f32 {
    robust_sigma_f32(absolute).map_or(floor, |sigma| sigma.max(floor))
}

/// The tone at half resolution, one plane a channel.
pub(crate) fn tone_half(frame: &Frame) -> (usize, usize, [Vec<f32>; 2]) {
    let (w, h) = (frame.width_px() / 2, frame.height_px() / 2);
    let stride = frame.width_px() * 3;
    let mut planes = [vec![0f32; w * h], vec![0f32; w * h]];
    for j in 0..h {
        let top = &frame.rgb()[2 * j * stride..][..w * 6];
        let bottom = &frame.rgb()[(2 * j + 1) * stride..][..w * 6];
        for (i, (t, b)) in top.chunks_exact(6).zip(bottom.chunks_exact(6)).enumerate() {
            let sum = |c: usize| [t[c], t[c + 3], b[c], b[c + 3]].iter().map(|x| f32::from(*x)).sum::<f32>();
            let (red, green, blue) = (sum(0), sum(1), sum(2));
            planes[0][j * w + i] = (green + blue) / 8.0;
            planes[1][j * w + i] = (red - blue) / 8.0;
        }
    }
    (w, h, planes)
}

#[cfg(test)]
mod tests {
    use super::hough::HoughDetector;
    use super::map::edge_pixels;
    use super::subpixel::GradientDetector;
    use super::*;
    use crate::face::outline::{SIDES, span_mm};
    use crate::face::raster::{OnPlane, PlaneRaster};
    use crate::frames::Plane;
    use crate::paper_head::paper_head;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    const WIDTH: usize = 648;
    const HEIGHT: usize = 486;

    /// A tilted plane 0.6 m away, rolled by about 45 degrees, with a rectangle on it.
    fn rectangle(calibration: &Calibration) -> InitialRectangle {
        let plane = Plane::new(Vector3::new(0.15, -0.1, 1.0) / 600.0);
        let raster = PlaneRaster::new(calibration, &plane, Px::new(324.0, 243.0), Px::new(400.0, 310.0))
            .expect("in view");
        let mm_per_px = raster.mm_per_px(calibration, OnPlane::zeros()).expect("in view");
        InitialRectangle {
            raster,
            offsets_mm: [-140.3, 120.9, -90.2, 100.6],
            at_ends: [true; 4],
            lines: Default::default(),
            mm_per_px,
        }
    }

    /// The picture of the rectangle, `face` grey on `ground` grey, 4 x 4 rays a pixel.
    fn picture(calibration: &Calibration, r: &InitialRectangle, face: u8, ground: u8) -> Frame {
        let [a0, a1, b0, b1] = r.offsets_mm;
        let mut rgb = Vec::with_capacity(WIDTH * HEIGHT * 3);
        for v in 0..HEIGHT {
            for u in 0..WIDTH {
                let mut inside = 0;
                for k in 0..16 {
                    let (du, dv) = (f64::from(k % 4) * 0.25 - 0.375, f64::from(k / 4) * 0.25 - 0.375);
                    let at = r.raster.on_plane(calibration, Px::new(u as f64 + du, v as f64 + dv));
                    let on_face = at.is_some_and(|p| p.x > a0 && p.x < a1 && p.y > b0 && p.y < b1);
                    inside += i32::from(on_face);
                }
                let grey = i32::from(ground) + (i32::from(face) - i32::from(ground)) * inside / 16;
                rgb.extend([u8::try_from(grey).expect("between both"); 3]);
            }
        }
        Frame::from_rgb(WIDTH, HEIGHT, rgb).expect("the size fits")
    }

    fn detectors() -> [(&'static str, &'static dyn EdgeDetector); 2] {
        [("gradient", &GradientDetector::DEFAULT), ("hough", &HoughDetector { map: None, stripes_on: None })]
    }

    #[test]
    fn both_detectors_find_known_sides_to_a_fifth_of_a_pixel() {
        let calibration = paper_head(0.25);
        let truth = rectangle(&calibration);
        let frame = picture(&calibration, &truth, 180, 90);
        let mut initial = truth.clone();
        for (offset, px) in initial.offsets_mm.iter_mut().zip([3.0, -2.0, 1.0, 4.0]) {
            *offset += px * truth.mm_per_px;
        }
        for (name, detector) in detectors() {
            let points = detector.edge_points(&frame, &calibration, &initial, &[]);
            for (side, points) in points.iter().enumerate() {
                assert!(points.len() >= 15, "{name}, side {side}: {} points", points.len());
                let off_px = |p: &EdgePoint| {
                    let at = truth.raster.on_plane(&calibration, p.at).expect("on the plane");
                    (SIDES[side].0.offset(at) - truth.offsets_mm[side]) / truth.mm_per_px
                };
                let mean = points.iter().map(off_px).sum::<f64>() / points.len() as f64;
                let worst = points.iter().map(|p| off_px(p).abs()).fold(0.0, f64::max);
                assert!(mean.abs() < 0.2, "{name}, side {side}: {mean} px off");
                assert!(worst < 1.0, "{name}, side {side}: a point is {worst} px off");
            }
        }
    }

    #[test]
    fn the_strongest_candidate_of_a_scan_is_the_edge_to_a_pixel() {
        let calibration = paper_head(0.25);
        let truth = rectangle(&calibration);
        let frame = picture(&calibration, &truth, 180, 90);
        let (offsets, px) = (truth.offsets_mm, truth.mm_per_px);
        for (side, (across, _)) in SIDES.into_iter().enumerate() {
            let range = side_scan::ScanRange {
                across,
                from_mm: offsets[side] - 20.0 * px,
                to_mm: offsets[side] + 20.0 * px,
                span_mm: span_mm(&offsets, side),
                step_mm: 0.8 * px,
            };
            let scan = side_scan::SideScan::new(&frame, &calibration, &truth.raster, &range);
            let found = scan.candidates(8.0 * px, 4.0 * px, 0.2, 8);
            let off_px = (found[0].offset_mm - offsets[side]) / px;
            assert!(
                found[0].strength > 0.9 && off_px.abs() < 1.0,
                "side {side}: {off_px} px, {:?}",
                found[0]
            );
        }
    }

    #[test]
    fn no_point_lies_where_laser_light_disturbs() {
        let calibration = paper_head(0.25);
        let truth = rectangle(&calibration);
        let frame = picture(&calibration, &truth, 180, 90);
        let middle = |side: usize| {
            let (from, to) = span_mm(&truth.offsets_mm, side);
            let at = SIDES[side].0.at(truth.offsets_mm[side], 0.5 * (from + to));
            (truth.raster.pixel(&calibration, at).expect("in view"), 20.0)
        };
        let keep_out = [middle(0), middle(2)];
        for (name, detector) in detectors() {
            for p in detector.edge_points(&frame, &calibration, &truth, &keep_out).iter().flatten() {
                let near = keep_out.iter().map(|(c, _)| c.distance_px(p.at)).fold(f64::INFINITY, f64::min);
                // An averaged point stands for profiles up to 4 px beside it.
                assert!(near > 20.0 - 5.0, "{name}: a point {near} px from a stripe");
            }
        }
    }

    #[test]
    fn a_black_frame_has_no_edges() {
        let calibration = paper_head(0.25);
        let initial = rectangle(&calibration);
        let frame = Frame::from_rgb(WIDTH, HEIGHT, vec![0; WIDTH * HEIGHT * 3]).expect("the size fits");
        assert!(edge_pixels(&frame).is_empty());
        for (name, detector) in detectors() {
            let points = detector.edge_points(&frame, &calibration, &initial, &[]);
            assert!(points.iter().all(Vec::is_empty), "{name}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn frames_of_any_size_do_no_harm(width in 1..90usize, height in 1..90usize, seed: u32) {
            let mut state = seed;
            let rgb = (0..width * height * 3)
                .map(|_| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (state >> 24) as u8
                })
                .collect();
            let frame = Frame::from_rgb(width, height, rgb).expect("the size fits");
            let calibration = paper_head(0.25); // of another size: the frame ends where sides are looked for
            let initial = rectangle(&calibration);
            for pixel in edge_pixels(&frame) {
                prop_assert!(pixel.at.u > 0.0 && pixel.at.u < width as f64);
                prop_assert!(pixel.at.v > 0.0 && pixel.at.v < height as f64);
            }
            for (_, detector) in detectors() {
                for p in detector.edge_points(&frame, &calibration, &initial, &[]).iter().flatten() {
                    prop_assert!(p.at.u.is_finite() && p.at.v.is_finite() && p.sigma_px > 0.0);
                }
            }
        }
    }
}
