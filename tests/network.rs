//! The default way, with the network that ships: every recorded frame is right or refused, and most are measured.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::{FaceOutcome, Network, Settings, measure_face};
use boxline_edgenet::{EdgeNet, Options};
use boxline_tests::Recorded;

/// The paper's promise; a right outline is far within it, a wrong one far outside.
const PROMISED_MM: f64 = 5.0;
/// Of the twelve measurable frames; the network has never seen a picture of this renderer.
const LEAST_MEASURED: usize = 9;

#[test]
fn recorded_frames_are_right_or_refused() {
    let network = EdgeNet::embedded(&Options::default()).unwrap();
    let settings = Settings { network: Some(&network as &dyn Network), ..Settings::default() };
    let (mut wrong, mut refused, mut measured) = (Vec::new(), Vec::new(), 0);
    for name in ["b01", "b02", "b03", "b04", "b05", "b06", "refuse"] {
        let recorded = Recorded::read(name);
        for truth in &recorded.truth.faces {
            let what = format!("{name} {}", truth.frame);
            let frame = recorded.frame(&truth.frame);
            match measure_face(&frame, &recorded.calibration, &settings, &mut Vec::new()).unwrap() {
                FaceOutcome::Rejected(_) if recorded.truth.must_refuse => {}
                FaceOutcome::Rejected(reject) => refused.push(format!("{what}: {reject}")),
                FaceOutcome::Measured(face) if recorded.truth.must_refuse => {
                    wrong.push(format!("{what}: measured {:?}, to be refused", face.length));
                }
                FaceOutcome::Measured(face) => {
                    measured += 1;
                    for (found, truth_mm) in [face.length, face.width].into_iter().zip(truth.size_mm.unwrap())
                    {
                        if (found.value_mm - truth_mm).abs() > PROMISED_MM {
                            wrong.push(format!("{what}: {:.2} mm, truth {truth_mm}", found.value_mm));
                        }
                    }
                }
            }
        }
    }
    println!("{measured} measured; refused: {refused:#?}");
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
    assert!(measured >= LEAST_MEASURED, "{measured} of 12 measured; refused: {refused:#?}");
}
