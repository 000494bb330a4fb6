//! What the checks of a measured face are for: a head that is bent, a face that is not flat or not a rectangle must be told by name,
//! and by how much. Drawn as points, each fault large enough that one face shows it; how small it may be is in `rust/UNCERTAINTY.md`.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::points::measure_points;
use boxline::{FaceMeasurement, Settings, WarningKind};
use boxline_proto::json::read_calibration;
use boxline_sim::Rng;
use boxline_sim::points::{Conditions, PointBox};
use std::path::Path;

const SOUND: Conditions = Conditions { drift_rad: 0.0, tilt_rad: 0.0, bulge_mm: 0.0, skew_rad: 0.0 };
const BOXES: u64 = 10;

/// The faces of some boxes, each with the box it belongs to.
fn faces(conditions: &Conditions, settings: &Settings) -> Vec<(PointBox, FaceMeasurement)> {
    let file = "../../tests/data/calibration_set/estimated.json";
    let calibration = read_calibration(&Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap();
    let mut all = Vec::new();
    for seed in 0..BOXES {
        let drawn = PointBox::random(&mut Rng::new(seed, 7), &calibration, conditions).unwrap();
        for seen in &drawn.faces {
            let face = measure_points(&calibration, &seen.stripes, &seen.sides, settings);
            all.extend(face.map(|face| (drawn.clone(), face)));
        }
    }
    assert!(all.len() as u64 >= 2 * BOXES - 2, "{} faces", all.len());
    all
}

fn share(faces: &[(PointBox, FaceMeasurement)], kind: WarningKind) -> f64 {
    let named = faces.iter().filter(|(_, face)| face.warnings.iter().any(|w| w.kind == kind));
    named.count() as f64 / faces.len() as f64
}

#[test]
fn sound_faces_raise_no_warnings() {
    let found = faces(&SOUND, &Settings::default());
    // Each of four checks speaks on a few sound faces in a thousand: twice in twenty is one run in a thousand.
    let named: Vec<_> = found.iter().flat_map(|(_, face)| &face.warnings).collect();
    assert!(named.len() <= 1, "{named:?}");
}

#[test]
fn a_tilted_laser_is_told_by_its_number() {
    let found = faces(&Conditions { tilt_rad: 3e-3, ..SOUND }, &Settings::default());
    assert!(share(&found, WarningKind::LaserMoved) >= 0.8, "{}", share(&found, WarningKind::LaserMoved));
    let named = found.iter().filter_map(|(drawn, face)| {
        let warning = face.warnings.iter().find(|w| w.kind == WarningKind::LaserMoved)?;
        warning.laser.map(|laser| laser == drawn.tilted)
    });
    let named: Vec<bool> = named.collect();
    assert!(named.len() >= 8 && named.iter().all(|right| *right), "{named:?}");
}

#[test]
fn a_bulge_and_a_dent_are_told_and_seen_in_the_heights() {
    for bulge_mm in [12.0, -12.0] {
        let found = faces(&Conditions { bulge_mm, ..SOUND }, &Settings::default());
        assert!(
            share(&found, WarningKind::FaceNotFlat) >= 0.7,
            "{}",
            share(&found, WarningKind::FaceNotFlat)
        );
        for (_, face) in &found {
            for warning in face.warnings.iter().filter(|w| w.kind == WarningKind::FaceNotFlat) {
                assert_eq!(warning.found > 0.0, bulge_mm > 0.0, "{warning}");
            }
        }
        // Single far faces scatter, their median does not.
        let mut rises: Vec<f64> = found.iter().map(|(_, face)| rise_mm(face)).collect();
        rises.sort_by(f64::total_cmp);
        let median_mm = rises[rises.len() / 2];
        assert!((0.7..1.3).contains(&(median_mm / bulge_mm)), "{median_mm} mm of {bulge_mm}: {rises:?}");
    }
}

/// How high the surface rises as the drawn bulge does, (1 - x^2) (1 - y^2): its slope over the face's heights.
fn rise_mm(face: &FaceMeasurement) -> f64 {
    let shapes = face.surface.iter().map(|p| {
        let [x, y] = [2.0 * p.at_mm[0] / face.length.value_mm, 2.0 * p.at_mm[1] / face.width.value_mm];
        (1.0 - x * x) * (1.0 - y * y)
    });
    let pairs: Vec<(f64, f64)> = shapes.zip(face.surface.iter().map(|p| p.height.value_mm)).collect();
    let count = pairs.len() as f64;
    let (mx, my) = pairs.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + x / count, b + y / count));
    let (xy, xx) =
        pairs.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + (x - mx) * (y - my), b + (x - mx) * (x - mx)));
    xy / xx
}

#[test]
fn a_skewed_face_is_told_and_its_angles_with_free_sides() {
    let skew_rad = 0.03;
    let settings = Settings { free: true, ..Settings::default() };
    let found = faces(&Conditions { skew_rad, ..SOUND }, &settings);
    assert!(
        share(&found, WarningKind::NotRightAngled) >= 0.8,
        "{}",
        share(&found, WarningKind::NotRightAngled)
    );
    for (_, face) in &found {
        let angles = face.corner_angles.unwrap();
        for (i, angle) in angles.iter().enumerate() {
            let off_rad = angle.value_rad - std::f64::consts::FRAC_PI_2;
            assert!((off_rad.abs() - skew_rad).abs() < 6.0 * angle.sigma_rad, "{angles:?}");
            // A parallelogram: neighbours differ, opposite ones agree.
            assert!(
                off_rad * (angles[(i + 1) % 4].value_rad - std::f64::consts::FRAC_PI_2) < 0.0,
                "{angles:?}"
            );
        }
    }
}
