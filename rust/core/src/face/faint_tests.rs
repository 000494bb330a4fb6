//! Stripes fainter than a pixel's noise (the sun outdoors): how faint they may be, and how often something else is taken for them.
//! Drawn at full size, since what counts is how many pixels add up. The figures in `rust/UNCERTAINTY.md` come from
//! `cargo test --release -p boxline --lib -- --ignored --nocapture faint`.

use super::extent::{StripeContrast, crossing_px, inner_segments};
use crate::calibration::Calibration;
use crate::frames::{Cam, Plane};
use crate::image::Frame;
use crate::image::bands::band_maps;
use crate::image::laser_response::{Diagonal, faint_ridge_map, half_laser_response};
use crate::paper_head::paper_head;
use crate::stripe::grid_search::{
    Evidence, GridHypothesis, GridSearchSettings, climb, diagonals, find_planes,
};
use crate::units::{LaserId, Px};
use nalgebra::Vector3;

/// What the stripes lie on.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Ground {
    /// Noise of every pixel and colour for itself.
    Noise,
    /// Noise as a Bayer sensor and JPEG's chroma leave it: red and blue are known for every second row and column.
    Bayer,
    /// The same over cardboard with grain, printed bars and letters.
    Print,
}

/// Noise of laser response, grey levels.
const SIGMA: f64 = 12.0;
/// Standard deviation of a stripe's profile, px.
const WIDTH_PX: f64 = 2.8;

struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / (1u64 << 24) as f64
    }

    /// Nearly normal, variance 1.
    fn normal(&mut self) -> f64 {
        (0..4).map(|_| self.uniform() - 0.5).sum::<f64>() * 3f64.sqrt()
    }
}

/// A plane that a person might look at.
fn any_plane(noise: &mut Noise) -> Plane<Cam> {
    let depth_mm = 700.0 * 3f64.powf(noise.uniform());
    let tilt = |noise: &mut Noise| 0.5 * (noise.uniform() - 0.5);
    Plane::new(Vector3::new(tilt(noise), tilt(noise), 1.0) / depth_mm)
}

/// A frame with the four stripes of a plane, `snr` times the noise of laser response high; none without a plane.
fn draw(calibration: &Calibration, plane: Option<&Plane<Cam>>, snr: f64, ground: Ground, seed: u64) -> Frame {
    let [width, height] = [calibration.width_px() as usize, calibration.height_px() as usize];
    let noise = &mut Noise(seed.wrapping_mul(0x9E37_79B9).wrapping_add(7));
    let printed = bars(noise, width, height);
    let lines = plane.map(|plane| calibration.lasers().each_ref().map(|laser| plane.per_mm - laser.per_mm));
    // R - (G + B) / 2 of three equal noises has 1.5 times the variance of one.
    let each = SIGMA / 1.5f64.sqrt();
    let mut coarse = vec![[0.0; 2]; (width / 2 + 2) * (height / 2 + 2)];
    // Averaging four neighbours halves the noise, so it is drawn larger: the pixel's own is what it should be.
    coarse.iter_mut().for_each(|c| *c = [0; 2].map(|_: i32| each * 1.35 * noise.normal()));
    let mut rgb = Vec::with_capacity(width * height * 3);
    for v in 0..height {
        for u in 0..width {
            let mut light = 0.0;
            if let Some(lines) = &lines {
                let at = Px::new(u as f64, v as f64);
                // Pinhole steps: the stripe's curve is drawn by the camera's own rays.
                let (ray, jacobian) = calibration.camera().ray_from_px_with_jacobian(at);
                for line in lines {
                    let gradient = (jacobian.transpose() * line.xy()).norm();
                    let off_px = line.dot(&ray.xy1) / gradient;
                    if off_px.abs() < 4.0 * WIDTH_PX {
                        light += snr * SIGMA * (-0.5 * (off_px / WIDTH_PX).powi(2)).exp();
                    }
                }
            }
            let mut base = [150.0, 117.0, 90.0];
            if ground == Ground::Print {
                if let Some(dark) = printed[v * width + u] {
                    // Every fourth bar is red.
                    base =
                        if dark > 0.75 { [150.0, 60.0, 50.0] } else { base.map(|b| b * (0.3 + 0.6 * dark)) };
                }
                let grain = 1.0 + 0.06 * noise.normal();
                base = base.map(|b| b * grain);
            }
            let [red, blue] = if ground == Ground::Noise {
                [each * noise.normal(), each * noise.normal()]
            } else {
                let w = width / 2 + 2;
                let (i, j) = (u / 2, v / 2);
                let (fu, fv) = (if u % 2 == 0 { 0.25 } else { 0.75 }, if v % 2 == 0 { 0.25 } else { 0.75 });
                [0, 1].map(|k| {
                    let at = |di: usize, dj: usize| coarse[(j + dj) * w + i + di][k];
                    (at(0, 0) * (1.0 - fu) + at(1, 0) * fu) * (1.0 - fv)
                        + (at(0, 1) * (1.0 - fu) + at(1, 1) * fu) * fv
                })
            };
            let colours = [base[0] + light + red, base[1] + each * noise.normal(), base[2] + blue];
            rgb.extend(colours.map(|c| c.round().clamp(0.0, 255.0) as u8));
        }
    }
    Frame::from_rgb(width, height, rgb).expect("the size fits")
}

/// Forty printed bars anywhere, and how dark each is; the later over the earlier.
fn bars(noise: &mut Noise, width: usize, height: usize) -> Vec<Option<f64>> {
    let mut printed = vec![None; width * height];
    for _ in 0..40 {
        let [x, y, turn, long, dark] = [0; 5].map(|_: i32| noise.uniform());
        let (s, c) = (turn * std::f64::consts::TAU).sin_cos();
        let (half_long, half_wide) = ((50.0 + 400.0 * long) as i32, (4.0 + 16.0 * dark) as i32);
        for step in -2 * half_long..=2 * half_long {
            for beside in -2 * half_wide..=2 * half_wide {
                let (along, across) = (0.5 * f64::from(step), 0.5 * f64::from(beside));
                let u = x * width as f64 + c * along - s * across;
                let v = y * height as f64 + s * along + c * across;
                if u >= 0.0 && v >= 0.0 && u < width as f64 && v < height as f64 {
                    printed[v as usize * width + u as usize] = Some(dark);
                }
            }
        }
    }
    printed
}

/// As the pipeline searches: in the narrow map, then in the wide one.
fn planes_in(frame: &Frame, calibration: &Calibration, contrast: StripeContrast) -> Vec<GridHypothesis> {
    let diagonals = diagonals(calibration);
    let ridges = match contrast {
        StripeContrast::Clear => band_maps(frame, diagonals),
        StripeContrast::Faint => {
            let (width, height, laser_response) = half_laser_response(frame);
            diagonals.map(|d: Diagonal| faint_ridge_map(width, height, &laser_response, d))
        }
    };
    let grid = GridSearchSettings::default();
    let evidence = LaserId::ALL.map(|id| Evidence::ridge(&ridges[id.index() / 2]));
    match contrast {
        StripeContrast::Clear => find_planes(calibration, &evidence, &grid, grid.clear, 4),
        StripeContrast::Faint => {
            let planes = find_planes(calibration, &evidence, &grid, grid.faint, 4);
            planes.iter().map(|plane| climb(calibration, &evidence, &grid, plane)).collect()
        }
    }
}

/// Largest distance of the four crossings from where they are, px.
fn off_px(calibration: &Calibration, found: &Plane<Cam>, truth: &Plane<Cam>) -> f64 {
    let [l1, l2, l3, l4] = LaserId::ALL;
    let crossings = [(l1, l3), (l1, l4), (l2, l3), (l2, l4)].map(|(i, j)| {
        let at = |plane: &Plane<Cam>| crossing_px(calibration, plane, i, j);
        at(found).zip(at(truth)).map_or(f64::INFINITY, |(a, b)| a.distance_px(b))
    });
    crossings.into_iter().fold(0.0, f64::max)
}

#[test]
fn stripes_a_third_of_a_pixels_noise_high_are_found_and_nothing_in_noise() {
    let calibration = paper_head(1.0);
    let plane = any_plane(&mut Noise(3));
    for ground in [Ground::Noise, Ground::Bayer] {
        let frame = draw(&calibration, Some(&plane), 0.3, ground, 2);
        let found = planes_in(&frame, &calibration, StripeContrast::Faint);
        let inner =
            inner_segments(&frame, &calibration, &found[0].plane, StripeContrast::Faint).expect("followed");
        let off_px = off_px(&calibration, &inner.plane, &plane);
        assert!(off_px < 6.0, "{ground:?}: {off_px} px off");
    }
    let frame = draw(&calibration, None, 0.0, Ground::Bayer, 2);
    assert!(planes_in(&frame, &calibration, StripeContrast::Faint).is_empty());
}

#[test]
#[ignore = "a table, some minutes"]
fn faint_stripes_table() {
    let calibration = paper_head(1.0);
    let count: u64 = std::env::var("FAINT_FRAMES").ok().and_then(|n| n.parse().ok()).unwrap_or(12);
    for ground in [Ground::Noise, Ground::Bayer, Ground::Print] {
        for snr in [0.0, 0.3] {
            let (mut any, mut found, mut refined, mut best) =
                ([0; 2], [0; 2], [0; 2], [Vec::new(), Vec::new()]);
            for seed in 0..count {
                let plane = any_plane(&mut Noise(seed + 1));
                let drawn = Some(&plane).filter(|_| snr > 0.0);
                let frame = draw(&calibration, drawn, snr, ground, seed);
                for (k, contrast) in [StripeContrast::Clear, StripeContrast::Faint].into_iter().enumerate() {
                    let planes = planes_in(&frame, &calibration, contrast);
                    any[k] += usize::from(!planes.is_empty());
                    best[k].push(planes.first().map_or(-1.0, |p| p.total()));
                    found[k] +=
                        usize::from(planes.iter().any(|p| off_px(&calibration, &p.plane, &plane) < 12.0));
                    let inner = planes
                        .iter()
                        .filter_map(|p| inner_segments(&frame, &calibration, &p.plane, contrast));
                    if std::env::var("FAINT_MORE").is_ok() {
                        let offs: Vec<f64> =
                            planes.iter().map(|p| off_px(&calibration, &p.plane, &plane)).collect();
                        let inner: Vec<f64> = planes
                            .iter()
                            .map(|p| {
                                inner_segments(&frame, &calibration, &p.plane, contrast)
                                    .map_or(-1.0, |i| off_px(&calibration, &i.plane, &plane))
                            })
                            .collect();
                        println!("   {contrast:?} {offs:.1?} -> {inner:.1?}");
                    }
                    let mut offs = inner.map(|i| off_px(&calibration, &i.plane, &plane));
                    refined[k] += usize::from(offs.any(|o| o < 3.0));
                }
            }
            for (k, contrast) in [StripeContrast::Clear, StripeContrast::Faint].into_iter().enumerate() {
                best[k].sort_by(f32::total_cmp);
                println!(
                    "{ground:?} snr {snr} {contrast:?}: any plane in {} of {count}, the true one in {}, refined to 3 px in {}; \
                     strongest {:.2?}",
                    any[k], found[k], refined[k], best[k]
                );
            }
        }
    }
}
