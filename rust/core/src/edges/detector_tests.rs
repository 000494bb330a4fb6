//! What every detector of edges must do, and the picture that it is tried on: each detector's tests call these.

use super::{EdgeDetector, EdgePoint};
use crate::calibration::Calibration;
use crate::face::outline::{InitialRectangle, SIDES, span_mm};
use crate::face::raster::{OnPlane, PlaneRaster};
use crate::frames::Plane;
use crate::image::Frame;
use crate::paper_head::paper_head;
use crate::units::Px;
use nalgebra::Vector3;

const WIDTH: usize = 648;
const HEIGHT: usize = 486;

/// A tilted plane 0.6 m away, rolled by about 45 degrees, with a rectangle on it.
pub(crate) fn rectangle(calibration: &Calibration) -> InitialRectangle {
    let plane = Plane::new(Vector3::new(0.15, -0.1, 1.0) / 600.0);
    let raster =
        PlaneRaster::new(calibration, &plane, Px::new(324.0, 243.0), Px::new(400.0, 310.0)).expect("in view");
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
pub(crate) fn picture(calibration: &Calibration, r: &InitialRectangle, face: u8, ground: u8) -> Frame {
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

/// Known sides are found to a fifth of a pixel, from some pixels beside them.
pub(crate) fn finds_known_sides(detector: &dyn EdgeDetector) {
    let calibration = paper_head(0.25);
    let truth = rectangle(&calibration);
    let frame = picture(&calibration, &truth, 180, 90);
    let mut initial = truth.clone();
    for (offset, px) in initial.offsets_mm.iter_mut().zip([3.0, -2.0, 1.0, 4.0]) {
        *offset += px * truth.mm_per_px;
    }
    let points = detector.edge_points(&frame, &calibration, &initial, &[]);
    for (side, points) in points.iter().enumerate() {
        assert!(points.len() >= 15, "side {side}: {} points", points.len());
        let off_px = |p: &EdgePoint| {
            let at = truth.raster.on_plane(&calibration, p.at).expect("on the plane");
            (SIDES[side].0.offset(at) - truth.offsets_mm[side]) / truth.mm_per_px
        };
        let mean = points.iter().map(off_px).sum::<f64>() / points.len() as f64;
        let worst = points.iter().map(|p| off_px(p).abs()).fold(0.0, f64::max);
        assert!(mean.abs() < 0.2, "side {side}: {mean} px off");
        assert!(worst < 1.0, "side {side}: a point is {worst} px off");
    }
}

/// No point lies where laser light disturbs.
pub(crate) fn keeps_out_of_laser_light(detector: &dyn EdgeDetector) {
    let calibration = paper_head(0.25);
    let truth = rectangle(&calibration);
    let frame = picture(&calibration, &truth, 180, 90);
    let middle = |side: usize| {
        let (from, to) = span_mm(&truth.offsets_mm, side);
        let at = SIDES[side].0.at(truth.offsets_mm[side], 0.5 * (from + to));
        (truth.raster.pixel(&calibration, at).expect("in view"), 20.0)
    };
    let keep_out = [middle(0), middle(2)];
    for p in detector.edge_points(&frame, &calibration, &truth, &keep_out).iter().flatten() {
        let near = keep_out.iter().map(|(c, _)| c.distance_px(p.at)).fold(f64::INFINITY, f64::min);
        // An averaged point stands for profiles up to 4 px beside it.
        assert!(near > 20.0 - 5.0, "a point {near} px from a stripe");
    }
}

/// A black frame has no edges.
pub(crate) fn finds_nothing_in_the_dark(detector: &dyn EdgeDetector) {
    let calibration = paper_head(0.25);
    let frame = Frame::from_rgb(WIDTH, HEIGHT, vec![0; WIDTH * HEIGHT * 3]).expect("the size fits");
    let points = detector.edge_points(&frame, &calibration, &rectangle(&calibration), &[]);
    assert!(points.iter().all(Vec::is_empty));
}

/// A frame of noise, of any size.
pub(crate) fn noise_frame(width: usize, height: usize, seed: u32) -> Frame {
    let mut random = fastrand::Rng::with_seed(seed.into());
    let rgb = (0..width * height * 3).map(|_| random.u8(..)).collect();
    Frame::from_rgb(width, height, rgb).expect("the size fits")
}

/// Frames that end where sides are looked for do no harm.
pub(crate) fn bears_frames_of_any_size(detector: &dyn EdgeDetector, width: usize, height: usize, seed: u32) {
    let frame = noise_frame(width, height, seed);
    let calibration = paper_head(0.25); // of another size
    let points = detector.edge_points(&frame, &calibration, &rectangle(&calibration), &[]);
    for p in points.iter().flatten() {
        assert!(p.at.u.is_finite() && p.at.v.is_finite() && p.sigma_px > 0.0, "{p:?}");
    }
}
