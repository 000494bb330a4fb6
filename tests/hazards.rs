//! Frames that show what the recorded boxes do not: stripes on real photographs, objects in front of a face, print and tape, oblique
//! views. Measured where the folder beside this repository is. No result may be wrong; those that are today are listed with their
//! reason. A result that is missing in a list is a new failure; one that does not occur any more is to be taken out.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::{FaceOutcome, Network, Outcome, Settings, measure_box, measure_face};
use boxline_edgenet::{EdgeNet, Options};
use boxline_proto::json::{Laser, Role, is_wrong_box};
use boxline_tests::Recorded;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

/// An object hides a part of the face, and the network of sides does not see it.
const OCCLUDED: [&str; 1] = ["occluded o01"];

/// A folder of recordings beside this repository.
fn shared(name: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared").join(name);
    if !folder.is_dir() {
        println!("SKIPPED: {} is not there", folder.display());
        return None;
    }
    Some(folder)
}

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
            match measure_face(&frame, &recorded.calibration, &settings, &mut Vec::new()).unwrap() {
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
    assert!(recordings.iter().all(|r| r.truth.faces.iter().all(|face| face.clicked_px.is_some())));
    assert!(wrong_faces(&recordings).is_empty());
}

#[test]
fn faces_with_an_object_in_front() {
    let Some(folder) = shared("recordings/occluded") else { return };
    assert_eq!(wrong_faces(&[Recorded::read_from(&folder)]), OCCLUDED);
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
        let report = measure_box(&[&a, &b], &recorded.calibration, &settings, &mut Vec::new()).unwrap();
        if let Outcome::Measured(found) = &report.outcome {
            assert!(!is_wrong_box(found, recorded.truth.box_mm.unwrap()), "{name}: {found:?}");
        }
    }
}
