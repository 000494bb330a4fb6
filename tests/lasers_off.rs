//! Rendered boxes with each view a second time, the lasers off and the hand a little on: what only the difference shows is measured rightly,
//! and a view that does not fit changes nothing.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::{Frame, Outcome, measure_box};
use boxline_sim::recording::{HeadHold, Kind, Recipe};
use boxline_sim::{Split, Stock};
use boxline_tests::{Rendered, shipped};

/// Stripes of this box are lost among its print (`boxline evaluate --simulate 1 --seed 100010709`, with and without `--off`).
const SEED: u64 = 100_010_709;

#[test]
fn a_box_whose_print_hides_its_stripes_is_measured_with_its_twin() {
    let recipe = Recipe { off: Some(HeadHold::Hand), ..Recipe::new(SEED, Kind::Box) };
    let rendered = Rendered::new(&recipe, &Stock::new(Split::HeldOut));
    let truth_mm = rendered.truth.box_mm.unwrap();
    let frame = |id| rendered.frame(id);
    let outcome = |frames: &[Frame; 2]| {
        measure_box(&frames.each_ref(), &rendered.calibration, &shipped()).unwrap().outcome
    };
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
