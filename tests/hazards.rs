//! Frames that show what the recorded boxes do not: stripes on real photographs, objects in front of a face, print and tape, oblique
//! views. Measured where the folder beside this repository is. No result may be wrong.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::frames::{Cam, Plane};
use boxline::{
    Calibration, FaceOutcome, Frame, Network, Outcome, Px, Reject, Settings, measure_box, measure_face,
};
use boxline_edgenet::{EdgeNet, Options};
use boxline_proto::json::{Laser, Role, is_wrong_box};
use boxline_tests::{Recorded, shared};
use std::num::NonZeroUsize;
use std::path::PathBuf;

/// The default way, on one thread: tests run side by side.
fn network() -> EdgeNet {
    EdgeNet::embedded(&Options { threads: NonZeroUsize::MIN, ..Options::default() }).unwrap()
}

/// Measures each frame of some recordings by itself; the names of the wrong ones.
fn wrong_faces(recordings: &[Recorded]) -> Vec<String> {
    let network = network();
    let settings = Settings { network: Some(&network as &dyn Network), ..Settings::default() };
    let (mut wrong, mut measured, mut refused) = (Vec::new(), 0, 0);
    for recorded in recordings {
        for shown in recorded.recording.frames.iter().filter(|f| f.role == Role::Face && f.laser == Laser::On)
        {
            let truth = recorded.truth.faces.iter().find(|face| face.frame == shown.id).unwrap();
            let frame = recorded.frame(&shown.id);
            match measure_face(&frame, &recorded.calibration, &settings).unwrap().outcome {
                FaceOutcome::Rejected(_) => refused += 1,
                FaceOutcome::Measured(face) => {
                    measured += 1;
                    if recorded.truth.must_refuse || truth.is_wrong(&face) {
                        wrong.push(format!("{} {}", recorded.name(), shown.id));
                    }
                }
            }
        }
    }
    println!("{measured} measured, {refused} refused, wrong: {wrong:?}");
    wrong
}

/// A quarter of the frames would do for most changes, but all take half a minute only.
#[test]
fn real_photographs() {
    let Some(folder) = shared("real/boxes") else { return };
    let mut folders: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    folders.retain(|folder| folder.join("recording.json").is_file());
    folders.sort();
    let recordings: Vec<Recorded> = folders.iter().map(|folder| Recorded::read_from(folder)).collect();
    // Where the truth was clicked, lines are judged, not millimetres.
    assert!(recordings.iter().all(|r| r.truth.faces.iter().all(|face| face.notes.click_px.is_some())));
    assert!(wrong_faces(&recordings).is_empty());
}

#[test]
fn faces_with_an_object_in_front() {
    let Some(folder) = shared("recordings/occluded") else { return };
    assert_eq!(wrong_faces(&[Recorded::read_from(&folder)]), [""; 0]);
}

#[test]
fn oblique_views() {
    let Some(folder) = shared("recordings/poses") else { return };
    assert_eq!(wrong_faces(&[Recorded::read_from(&folder)]), [""; 0]);
}

#[test]
fn one_colour_print_and_tape() {
    let network = network();
    let settings = Settings { network: Some(&network as &dyn Network), ..Settings::default() };
    for name in ["d01", "d02", "d03"] {
        let Some(folder) = shared(&format!("recordings/{name}")) else { return };
        let recorded = Recorded::read_from(&folder);
        let [a, b] = ["a", "b"].map(|id| recorded.frame(id));
        let report = measure_box(&[&a, &b], &recorded.calibration, &settings).unwrap();
        if let Outcome::Measured(found) = &report.outcome {
            assert!(!is_wrong_box(found, recorded.truth.box_mm.unwrap()), "{name}: {found:?}");
        }
    }
}

/// Tiles of a floor 0.7 m in front of the head: light board between dark seams, with stripes that go on over all of it. `lit_mm` is how far
/// from the middle of a tile they do.
fn tiles(calibration: &Calibration, half_mm: f64, lit_mm: f64) -> Frame {
    let floor: Plane<Cam> = Plane::new([0.1, -0.05, 1.0].map(|x| x / 700.0).into());
    let [width, height] = [calibration.width_px() as usize, calibration.height_px() as usize];
    let mut rgb = Vec::with_capacity(3 * width * height);
    for v in 0..height {
        for u in 0..width {
            let (ray, jacobian) = calibration.camera().ray_from_px_with_jacobian(Px::new(u as f64, v as f64));
            let at = floor.intersect(&ray).unwrap().mm;
            let diagonal = [(at.x + at.y) / 2f64.sqrt(), (at.x - at.y) / 2f64.sqrt()];
            let tile = diagonal.map(|x| ((x + half_mm) / (2.0 * half_mm)).floor());
            let from_seam =
                diagonal.map(|x| half_mm - ((x + half_mm).rem_euclid(2.0 * half_mm) - half_mm).abs());
            let shade = (tile[0] * 5.0 + tile[1] * 3.0).rem_euclid(4.0) * 12.0;
            let grain = (u * 7919 + v * 104_729) % 11;
            let seam = from_seam[0].min(from_seam[1]) < 1.5;
            let grey = if seam { 45.0 } else { 130.0 + shade } + grain as f64;
            let mut light = 0.0;
            if diagonal.iter().all(|x| x.abs() < lit_mm) {
                for laser in calibration.lasers() {
                    let line = floor.per_mm - laser.per_mm;
                    let off_px = line.dot(&ray.xy1) / (jacobian.transpose() * line.xy()).norm();
                    light += 150.0 * (-0.5 * (off_px / 2.8).powi(2)).exp();
                }
            }
            rgb.extend([grey + light, grey + 0.2 * light, grey + 0.2 * light].map(|x| x.min(255.0) as u8));
        }
    }
    Frame::from_rgb(width, height, rgb).unwrap()
}

#[test]
fn a_tile_of_a_floor_is_no_face() {
    let calibration = Recorded::read("b02").calibration;
    let network = network();
    let network: Option<&dyn Network> = Some(&network);
    let settings = Settings { network, least_confidence: 0.0, ..Settings::default() };
    let measure =
        |lit_mm| measure_face(&tiles(&calibration, 150.0, lit_mm), &calibration, &settings).unwrap().outcome;
    // The same tile as the face of a box, beside which the light falls elsewhere, can be measured.
    assert!(matches!(measure(150.0), FaceOutcome::Measured(_)), "{:?}", measure(150.0));
    let refused = measure(f64::INFINITY);
    assert!(matches!(refused, FaceOutcome::Rejected(Reject::RectangleOpen { .. })), "{refused:?}");
}
