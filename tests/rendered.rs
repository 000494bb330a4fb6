//! Twenty rendered boxes with all hazards, two views each, measured as the program ships: none may be wrong. Which seeds these are is
//! written in `rust/SEEDS.md`; they belong to the learning set, so what is measured here is no figure.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::{Outcome, measure_box};
use boxline_proto::json::is_wrong_box;
use boxline_sim::recording::{Kind, Recipe};
use boxline_sim::{Split, Stock};
use boxline_tests::{Rendered, shipped};
use std::thread;

const SEEDS: std::ops::Range<u64> = 100_010_710..100_010_730;
/// A program that refuses everything is never wrong.
const LEAST_MEASURED: usize = 4;

#[test]
fn of_twenty_rendered_boxes_none_is_wrong() {
    let stock = Stock::new(Split::HeldOut);
    // Rendering takes most of the time.
    let half = (SEEDS.start + SEEDS.end) / 2;
    let outcomes: Vec<(u64, Outcome, bool)> = thread::scope(|scope| {
        let part = |seeds: std::ops::Range<u64>| {
            let stock = &stock;
            scope.spawn(move || seeds.map(|seed| measured(seed, stock)).collect::<Vec<_>>())
        };
        let parts = [part(SEEDS.start..half), part(half..SEEDS.end)];
        parts.into_iter().flat_map(|part| part.join().unwrap()).collect()
    });
    let measured = outcomes.iter().filter(|(_, outcome, _)| matches!(outcome, Outcome::Measured(_))).count();
    let wrong: Vec<_> = outcomes.iter().filter(|(_, _, wrong)| *wrong).collect();
    println!("{measured} of {} measured", outcomes.len());
    assert!(wrong.is_empty(), "wrong: {wrong:#?}");
    assert!(measured >= LEAST_MEASURED, "only {measured} measured");
}

/// What comes out for a seed, and whether it is wrong.
fn measured(seed: u64, stock: &Stock) -> (u64, Outcome, bool) {
    let rendered = Rendered::new(&Recipe::new(seed, Kind::Box), stock);
    let frames = ["a", "b"].map(|id| rendered.frame(id));
    let outcome = measure_box(&frames.each_ref(), &rendered.calibration, &shipped()).unwrap().outcome;
    let wrong = match &outcome {
        Outcome::Measured(found) => is_wrong_box(found, rendered.truth.box_mm.unwrap()),
        Outcome::Ambiguous(_) | Outcome::Rejected(_) => false,
    };
    (seed, outcome, wrong)
}
