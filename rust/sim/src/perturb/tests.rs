use super::*;
use crate::Head;
use boxline::{LaserId, Px};
use nalgebra::{Rotation3, Vector2, Vector3};
use std::collections::BTreeSet;

const HALF_MM: [f64; 2] = [300.0, 200.0];
const BOARD: u8 = 120;

/// An even grey frame with a tilted face one metre away and four red stripes on it, 4 px wide.
struct Scene {
    head: Head,
    corners_cam_mm: [[f64; 3]; 4],
    normal_per_mm: Vector3<f64>,
    frame: Frame,
}

impl Scene {
    fn new() -> Self {
        let head = Head::nominal().unwrap();
        let camera = *head.calibration.camera();
        let turn = Rotation3::from_euler_angles(0.3, -0.2, 0.8);
        let middle = Vector3::new(10.0, -15.0, 1000.0);
        let at = |x: f64, y: f64| middle + turn * Vector3::new(x, y, 0.0);
        let [x, y] = HALF_MM;
        let corners = [at(-x, -y), at(x, -y), at(x, y), at(-x, y)];
        let normal = turn * Vector3::z();
        let normal_per_mm = normal / normal.dot(&middle);
        let (width, height) = (2592, 1944);
        let mut rgb = Vec::with_capacity(width * height * 3);
        for row in 0..height {
            for column in 0..width {
                let (ray, by_px) = camera.ray_from_px_with_jacobian(Px::new(column as f64, row as f64));
                let red: f64 = LaserId::ALL
                    .iter()
                    .map(|id| {
                        let d = normal_per_mm - head.calibration.laser(*id).per_mm;
                        let slope = by_px.transpose() * Vector2::new(d.x, d.y);
                        let px = d.dot(&ray.xy1) / slope.norm();
                        100.0 * (-0.5 * (px / 2.0).powi(2)).exp()
                    })
                    .sum();
                rgb.extend([(f64::from(BOARD) + red).min(255.0) as u8, BOARD, BOARD]);
            }
        }
        let frame = Frame::from_rgb(width, height, rgb).unwrap();
        Self { head, corners_cam_mm: corners.map(Into::into), normal_per_mm, frame }
    }

    fn shot(&self) -> Shot<'_> {
        Shot::new(&self.frame, &self.head.calibration, Some(self.corners_cam_mm))
    }

    /// The pixel of a place on the face.
    fn px(&self, x: f64, y: f64) -> [f64; 2] {
        let c = self.corners_cam_mm.map(Vector3::from);
        let (s, t) = (0.5 + 0.5 * x / HALF_MM[0], 0.5 + 0.5 * y / HALF_MM[1]);
        let p = c[0] + (c[1] - c[0]) * s + (c[3] - c[0]) * t;
        let px = self.head.calibration.camera().px_from_point(&Point::new(p.x, p.y, p.z)).unwrap();
        [px.u, px.v]
    }
}

fn pixel(frame: &Frame, [u, v]: [f64; 2]) -> [u8; 3] {
    let at = (v.round() as usize * frame.width_px() + u.round() as usize) * 3;
    [0, 1, 2].map(|c| frame.rgb()[at + c])
}

fn changed<'a>(before: &'a Frame, after: &'a Frame) -> impl Iterator<Item = [f64; 2]> + 'a {
    let pairs = before.rgb().chunks_exact(3).zip(after.rgb().chunks_exact(3));
    let width = before.width_px();
    pairs.enumerate().filter(|(_, (a, b))| a != b).map(move |(i, _)| [(i % width) as f64, (i / width) as f64])
}

/// Distance of a pixel from the inside of a convex quadrilateral's sides, negative inside.
fn outside_px(quad: &[[f64; 2]; 4], [u, v]: [f64; 2]) -> f64 {
    let turn =
        |a: [f64; 2], b: [f64; 2], p: [f64; 2]| (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]);
    let sign = turn(quad[0], quad[1], quad[2]).signum();
    (0..4)
        .map(|i| {
            let (a, b) = (quad[i], quad[(i + 1) % 4]);
            -sign * turn(a, b, [u, v]) / (b[0] - a[0]).hypot(b[1] - a[1])
        })
        .fold(f64::NEG_INFINITY, f64::max)
}

#[test]
fn every_change_has_a_name_of_its_own() {
    let all = Perturbation::all();
    let names: BTreeSet<String> = all.iter().map(ToString::to_string).collect();
    assert_eq!(names.len(), all.len());
}

#[test]
fn bars_and_dates_stay_off_the_face_and_paint_stays_on_it() {
    let scene = Scene::new();
    let shot = scene.shot();
    let face = *shot.corners_px().unwrap();
    let (mut bars_and_dates, mut paints) = (0, 0);
    for perturbation in Perturbation::all() {
        let beside = matches!(perturbation, Perturbation::Bars(_) | Perturbation::Date(_));
        if !beside && !matches!(perturbation, Perturbation::Paint(_)) {
            continue;
        }
        let Some(after) = perturbation.apply(&shot, 1).unwrap() else { continue };
        let outside = changed(&scene.frame, &after).map(|px| outside_px(&face, px));
        let [nearest, farthest] =
            outside.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], d| [a.min(d), b.max(d)]);
        assert!(farthest > nearest, "{perturbation} changes nothing");
        if beside {
            assert!(nearest > 8.0, "{perturbation} comes {nearest} px near the face");
            bars_and_dates += 1;
        } else {
            assert!(farthest < 1.0, "{perturbation} reaches {farthest} px beyond the face");
            paints += 1;
        }
    }
    assert!(bars_and_dates >= 4 && paints == Paint::ALL.len(), "{bars_and_dates} {paints}");
}

/// Along a line across the long side, half of the ink is reached where the ink is to begin.
#[test]
fn paint_begins_where_it_says() {
    let scene = Scene::new();
    let paint = Paint::ALL.into_iter().find(|p| p.to_string().starts_with("blue field, 12 mm")).unwrap();
    let after = Perturbation::Paint(paint).apply(&scene.shot(), 1).unwrap().unwrap();
    // Far from every stripe on this line: the frame is even there.
    let x = (-280..280)
        .step_by(20)
        .map(f64::from)
        .find(|x| (165..200).all(|y| pixel(&scene.frame, scene.px(*x, f64::from(y)))[0] == BOARD));
    let x = x.unwrap();
    let green = |y: f64| f64::from(pixel(&after, scene.px(x, y))[1]);
    let ink = green(170.0);
    assert!(ink < 90.0, "{ink}");
    assert_eq!(green(199.0), f64::from(BOARD));
    let border =
        (1700..2000).map(|y| f64::from(y) / 10.0).find(|y| green(*y) > 0.5 * (ink + f64::from(BOARD)));
    let border = border.unwrap();
    assert!((border - (HALF_MM[1] - 12.6)).abs() < 0.8, "{border}");
}

/// On black paint half of the laser's light is left, and its middle is where it was.
#[test]
fn paint_keeps_the_lasers() {
    let scene = Scene::new();
    let paint = Paint::ALL.into_iter().find(|p| p.to_string().starts_with("blue field")).unwrap();
    let after = Perturbation::Paint(paint).apply(&scene.shot(), 1).unwrap().unwrap();
    let light = picture::Light::get();
    let excess = |frame: &Frame, px: [f64; 2]| {
        let [red, green, _] = pixel(frame, px);
        f64::from(light.linear(red) - light.linear(green))
    };
    // Where a stripe crosses a line across the face.
    let camera = scene.head.calibration.camera();
    let crossing = |laser: LaserId| {
        let p = scene.normal_per_mm - scene.head.calibration.laser(laser).per_mm;
        let value = |x: f64| {
            let [u, v] = scene.px(x, 90.0);
            p.dot(&camera.ray_from_px(Px::new(u, v)).xy1)
        };
        (-2000..2000).map(|x| f64::from(x) / 10.0).find(|x| value(*x) * value(x + 0.1) <= 0.0)
    };
    let x = LaserId::ALL.into_iter().find_map(crossing).unwrap();
    let sums = |frame: &Frame| {
        let ground = excess(frame, scene.px(x - 40.0, 90.0));
        let (mut sum, mut moment) = (0.0, 0.0);
        for step in -80..=80 {
            let offset = f64::from(step) / 10.0;
            let light = excess(frame, scene.px(x + offset, 90.0)) - ground;
            sum += light;
            moment += light * offset;
        }
        (sum, moment / sum)
    };
    let ((before, middle_before), (painted, middle)) = (sums(&scene.frame), sums(&after));
    assert!((painted / before - 0.5).abs() < 0.05, "{}", painted / before);
    assert!((middle - middle_before).abs() < 0.2, "{middle} {middle_before}");
}

#[test]
fn light_changes_as_the_physics_says() {
    let scene = Scene::new();
    let shot = scene.shot();
    let light = picture::Light::get();
    let at = [20.0, 20.0];
    let linear = |p: Perturbation| {
        let after = p.apply(&shot, 1).unwrap().unwrap();
        pixel(&after, at).map(|level| light.linear(level) / light.linear(BOARD))
    };
    for gain in [0.6, 1.4] {
        assert!(linear(Perturbation::Brightness(gain)).iter().all(|x| (x - gain).abs() < 0.01));
    }
    let [red, green, blue] = linear(Perturbation::Temperature(4500.0));
    assert!(red > 1.1 && (green - 1.0).abs() < 0.01 && blue < 0.85, "{red} {green} {blue}");
    for level in 0..=u8::MAX {
        assert_eq!(light.level(light.linear(level)), level);
    }
}

#[test]
fn noise_is_as_strong_as_it_says_and_the_same_for_a_seed() {
    let scene = Scene::new();
    let noisy = |seed| Perturbation::Noise(5.0).apply(&scene.shot(), seed).unwrap().unwrap();
    let first = noisy(3);
    assert_eq!(first, noisy(3));
    assert_ne!(first, noisy(4));
    let green = first.rgb().iter().skip(1).step_by(3).map(|g| f64::from(*g) - f64::from(BOARD));
    let spread = (green.map(|d| d * d).sum::<f64>() / (2592.0 * 1944.0)).sqrt();
    assert!((spread - 5.0).abs() < 0.1, "{spread}");
}

#[test]
fn a_better_jpeg_is_nearer_to_the_frame() {
    let scene = Scene::new();
    let away = |quality| {
        let again = Perturbation::Jpeg { quality, halved_chroma: true }.apply(&scene.shot(), 1);
        let again = again.unwrap().unwrap();
        let squares =
            again.rgb().iter().zip(scene.frame.rgb()).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
        squares.sum::<f64>()
    };
    assert!(away(97) < 0.5 * away(50));
}

#[test]
fn without_a_face_there_is_no_paint_and_all_the_room() {
    let scene = Scene::new();
    let shot = Shot::new(&scene.frame, &scene.head.calibration, None);
    assert!(Perturbation::Paint(Paint::ALL[0]).apply(&shot, 1).unwrap().is_none());
    for change in [Perturbation::Bars(Sides::TopAndBottom), Perturbation::Date(Corner::ALL[3])] {
        assert!(change.apply(&shot, 1).unwrap().is_some(), "{change}");
    }
}
