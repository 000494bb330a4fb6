//! Rendered boxes with each view a second time, the lasers off and the hand a little on: what only the difference shows is measured rightly,
//! and a view that does not fit changes nothing.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::{Frame, Outcome, measure_box};
use boxline_proto::json::{parse_calibration, parse_recording, parse_truth};
use boxline_sim::recording::{Hold, Kind, Recipe, render_recording};
use boxline_sim::{Split, Stock};
use boxline_tests::shipped;
use std::collections::BTreeMap;
use std::path::Path;

/// Stripes of this box are lost among its print (`boxline evaluate --simulate 1 --seed 100010709`, with and without `--off`).
const SEED: u64 = 100_010_709;

#[test]
fn a_box_whose_print_hides_its_stripes_is_measured_with_its_twin() {
    let mut files = BTreeMap::new();
    let recipe = Recipe { off: Some(Hold::Hand), ..Recipe::new(SEED, Kind::Box) };
    let stock = Stock::new(Split::HeldOut);
    render_recording(&recipe, &stock, |name, bytes| {
        files.insert(name.to_owned(), bytes);
        Ok(())
    })
    .unwrap();
    let recording = parse_recording(&files["recording.json"], "recording.json", Path::new("")).unwrap();
    let calibration = parse_calibration(&files["calibration.json"], "calibration.json").unwrap();
    let truth_mm = parse_truth(&files["truth.json"], "truth.json").unwrap().box_mm.unwrap();
    let frame = |id: &str| {
        let recorded = recording.frames.iter().find(|frame| frame.id == id).unwrap();
        Frame::from_jpeg(&files[recorded.file.to_str().unwrap()]).unwrap()
    };
    let outcome =
        |frames: &[Frame; 2]| measure_box(&frames.each_ref(), &calibration, &shipped()).unwrap().outcome;
    let mut frames = ["a", "b"].map(frame);
    let plain = outcome(&frames);
    assert!(matches!(plain, Outcome::Rejected(_)), "{plain:?}");

    let offs = ["a_off", "b_off"].map(frame);
    let error = frames[0].add_ambient(&offs[1]).unwrap_err();
    assert!(error.to_string().contains("another view"), "{error}");
    assert_eq!(outcome(&frames), plain, "nothing has changed");

    for (frame, off) in frames.iter_mut().zip(&offs) {
        let left_px = frame.add_ambient(off).unwrap().unwrap();
        assert!(left_px < 1.5, "{left_px} px");
    }
    let Outcome::Measured(found) = outcome(&frames) else { panic!("{:?}", outcome(&frames)) };
    for (side, truth_mm) in [found.length, found.width, found.height].iter().zip(truth_mm) {
        let off_mm = (side.value_mm - truth_mm).abs();
        assert!(off_mm < 3.0 && off_mm < 4.0 * side.sigma_mm, "{side:?}, {truth_mm} mm is right");
    }
}
