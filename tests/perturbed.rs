//! Changes of pictures that leave the sizes as they are, on some recorded boxes, with the network that ships: no result may become
//! wrong. `boxline evaluate tests/data --perturb` tries all changes on all of them.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::{BoxMeasurement, Frame, Network, Outcome, Settings, measure_box};
use boxline_edgenet::{EdgeNet, Options};
use boxline_proto::json::is_wrong_box;
use boxline_sim::perturb::{Perturbation, Shot};
use boxline_tests::Recorded;
use std::num::NonZeroUsize;

const RECORDINGS: [&str; 3] = ["b02", "b04", "b06"];
/// One of each sort.
const CHANGES: [&str; 6] = [
    "JPEG 4:2:0 quality 93",
    "brightness 1.4",
    "colour temperature 4500 K",
    "noise 5 levels",
    "date bottom right",
    "paint black frame, 3 mm wide, 6 mm inside",
];
/// What is wrong today: recording, change, and the lengths that came out, mm. One that is missing here is a new failure; one that
/// does not fail any more is to be taken out.
const KNOWN: [(&str, &str, [f64; 3]); 0] = [];
/// Other machines round otherwise.
const SAME_MM: f64 = 1.0;

fn sides_mm(found: &BoxMeasurement) -> [f64; 3] {
    [found.length, found.width, found.height].map(|side| side.value_mm)
}

/// What became wrong of one recording: the change and the sides.
fn wrong(name: &str) -> Vec<(String, [f64; 3])> {
    let options = Options { threads: NonZeroUsize::MIN, ..Options::default() };
    let network = EdgeNet::embedded(&options).unwrap();
    let settings = Settings { network: Some(&network as &dyn Network), ..Settings::default() };
    let recorded = Recorded::read(name);
    let truth_mm = recorded.truth.box_mm.unwrap();
    let frames = ["a", "b"].map(|id| recorded.frame(id));
    let shot =
        |i: usize| Shot::new(&frames[i], &recorded.calibration, recorded.truth.faces[i].corners_cam_mm);
    let shots = [shot(0), shot(1)];
    let mut wrong = Vec::new();
    let all = Perturbation::all();
    for change in CHANGES.map(|name| all.iter().find(|c| c.to_string() == name).unwrap()) {
        let changed = |i: usize| change.apply(&shots[i], i as u64).unwrap();
        let changed = [changed(0), changed(1)];
        assert!(changed.iter().any(Option::is_some), "{name} has no room for {change}");
        let [a, b]: [&Frame; 2] = [0, 1].map(|i| changed[i].as_ref().unwrap_or(&frames[i]));
        let report = measure_box(&[a, b], &recorded.calibration, &settings).unwrap();
        if let Outcome::Measured(found) = &report.outcome {
            println!("{name}, {change}: {:.1?}", sides_mm(found));
            if is_wrong_box(found, truth_mm) {
                wrong.push((change.to_string(), sides_mm(found)));
            }
        }
    }
    wrong
}

#[test]
fn changed_pictures_are_right_or_refused() {
    let found = std::thread::scope(|scope| {
        let each = RECORDINGS.map(|name| scope.spawn(move || (name, wrong(name))));
        each.map(|thread| thread.join().unwrap())
    });
    let found: Vec<(&str, String, [f64; 3])> = found
        .into_iter()
        .flat_map(|(name, wrong)| wrong.into_iter().map(move |(change, sides)| (name, change, sides)))
        .collect();
    let is = |known: &(&str, &str, [f64; 3]), found: &(&str, String, [f64; 3])| {
        let same = known.2.iter().zip(found.2).all(|(a, b)| (a - b).abs() < SAME_MM);
        known.0 == found.0 && known.1 == found.1 && same
    };
    let new: Vec<_> = found.iter().filter(|f| !KNOWN.iter().any(|k| is(k, f))).collect();
    let gone: Vec<_> = KNOWN.iter().filter(|k| !found.iter().any(|f| is(k, f))).collect();
    assert!(new.is_empty() && gone.is_empty(), "new: {new:#?}\nnot wrong any more, or otherwise: {gone:#?}");
}
