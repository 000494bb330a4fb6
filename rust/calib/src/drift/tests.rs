//! Drift from faces simulated at the level of line coefficients: heads whose lasers moved, faces as a courier sees them.

use super::*;
use crate::face_simulation::{head, some_face};
use crate::noise::Noise;
use boxline::frames::Plane;

/// The head with its lasers moved.
fn moved_head(motions: &Motions) -> Calibration {
    let head = head();
    let by_motion = all_planes_by_motion(&head).expect("planes");
    let planes = moved(head.lasers(), &by_motion, motions).map(|p| {
        let p: Plane<Cam> = p;
        [p.per_mm.x, p.per_mm.y, p.per_mm.z, -1.0]
    });
    Calibration::new("moved", [2592, 1944], *head.camera(), planes).expect("still a head")
}

/// Faces seen by a head that has moved, measured with the old calibration.
fn faces(truth: &Calibration, count: usize, noise: &mut Noise, sigmas: f64) -> Vec<ObservedFace> {
    let believed = head();
    (0..count)
        .map(|_| {
            let (start, lines) = some_face(truth, noise, sigmas);
            let fitted = FittedFace::new(believed.camera(), believed.lasers(), &lines, &[], &start)
                .expect("16 numbers fix 8");
            let sharp_mm = fitted.state.lengths_mm().map(|side| (side, 0.3));
            ObservedFace { lines, start: fitted.state, sharp_mm, known: Vec::new() }
        })
        .collect()
}

/// Every laser tilted by 0.2 to 1 mrad either way and twisted by half as much.
fn some_motion(noise: &mut Noise) -> Motions {
    let mut motions = Motions::zeros();
    for k in 0..4 {
        let sign = if noise.uniform() < 0.5 { -1.0 } else { 1.0 };
        motions[3 * k] = sign * noise.between(0.2e-3, 1e-3);
        motions[3 * k + 1] = 0.5e-3 * noise.normal();
    }
    motions
}

fn count(drift: &Drift, kind: DirectionKind) -> usize {
    drift.directions.iter().filter(|d| d.observable() && d.kind == kind).count()
}

#[test]
fn flat_faces_leave_four_parameters_open_rectangles_one_and_rulers_none() {
    let mut noise = Noise::new(11);
    let rectangles = faces(&head(), 60, &mut noise, 1.0);
    let mut flat = rectangles.clone();
    for side in flat.iter_mut().flat_map(|f| &mut f.lines.sides) {
        for p in side {
            p.sigma_px *= 1e4;
        }
    }
    let drift = estimate_drift(&head(), &flat).expect("60 faces");
    assert_eq!(count(&drift, DirectionKind::Stripes), 8);
    assert!(drift.directions[8..].iter().all(|d| d.eigenvalue < 0.1), "{:?}", drift.directions);

    let drift = estimate_drift(&head(), &rectangles).expect("60 faces");
    assert_eq!((count(&drift, DirectionKind::Scale), drift.test.degrees_of_freedom), (0, 11));
    let last = &drift.directions[11];
    assert!(last.kind == DirectionKind::Scale && last.share > 0.999 && last.eigenvalue < 1e-2, "{last:?}");

    let drift = estimate_drift(&head(), &with_ruler(rectangles, 1.0)).expect("60 faces");
    assert_eq!(drift.test.degrees_of_freedom, 12);
}

/// Both sides of every second face are known: `factor` times what the measurement says.
fn with_ruler(mut faces: Vec<ObservedFace>, factor: f64) -> Vec<ObservedFace> {
    for face in faces.iter_mut().step_by(2) {
        let [length, width] = face.sharp_mm.map(|(mm, _)| mm * factor);
        *face = face.clone().with_known(0, length).with_known(1, width);
    }
    faces
}

/// Squared errors of the estimate along the observable directions, in their posterior variances.
fn squared_errors(drift: &Drift, truth: &Motions) -> (f64, f64) {
    let head = head();
    let by_motion = all_planes_by_motion(&head).expect("planes");
    let prior = possible_covariance(&head, &by_motion).expect("regular");
    let inverse = prior.cholesky().expect("positive").l().try_inverse().expect("regular");
    let error = inverse * (drift.motions - truth);
    let observable: Vec<_> = drift.directions.iter().filter(|d| d.observable()).collect();
    let sum = observable.iter().map(|d| d.vector.dot(&error).powi(2) * (1.0 + d.eigenvalue)).sum();
    (sum, observable.len() as f64)
}

#[test]
fn tilted_lasers_are_estimated_within_their_sigma() {
    let mut noise = Noise::new(12);
    let (mut squares, mut directions, mut seen) = (0.0, 0.0, 0);
    const RUNS: usize = 60;
    for _ in 0..RUNS {
        let truth = some_motion(&mut noise);
        let seen_faces = faces(&moved_head(&truth), 40, &mut noise, 1.0);
        let drift = estimate_drift(&head(), &seen_faces).expect("40 faces");
        let (sum, n) = squared_errors(&drift, &truth);
        squares += sum;
        directions += n;
        seen += usize::from(drift.test.significant());
        // The scale stays as well known as it was: 0.07 % from the carrier, some more from shifts.
        let scale = drift.directions.iter().find(|d| d.kind == DirectionKind::Scale).expect("named");
        assert!(!scale.observable() && scale.scale_sigma > PRIOR_SCALE * 0.9, "{scale:?}");
    }
    // 660 squares: 1 +- 0.055; four of them, and what weights of far faces cost.
    let ratio = squares / directions;
    assert!((0.75..1.25).contains(&ratio), "mean squared error over variance {ratio}");
    assert_eq!(seen, RUNS, "tilts of 0.2 to 1 mrad are seen by 40 faces");
}

#[test]
fn lasers_that_stay_raise_no_alarm() {
    let mut noise = Noise::new(13);
    let alarms = (0..100)
        .filter(|_| {
            let seen = faces(&head(), 20, &mut noise, 1.0);
            estimate_drift(&head(), &seen).expect("20 faces").test.significant()
        })
        .count();
    // One in a hundred is expected; seven have a chance of 1e-4.
    assert!(alarms < 7, "{alarms} of 100");
}

#[test]
fn a_changed_scale_shows_only_against_known_lengths() {
    let mut noise = Noise::new(14);
    let by_motion = all_planes_by_motion(&head()).expect("planes");
    let truth = scale_motion(head().lasers(), &by_motion).expect("regular") * 2e-3;
    let seen = faces(&moved_head(&truth), 60, &mut noise, 1.0);
    let without = estimate_drift(&head(), &seen).expect("60 faces");
    assert!(!without.test.significant(), "{:?}", without.test);
    let with = estimate_drift(&head(), &with_ruler(seen, 1.002)).expect("60 faces");
    assert!(with.test.degrees_of_freedom == 12 && with.test.significant(), "{:?}", with.test);
    let updated = with.apply(&head()).expect("a head");
    let wider =
        updated.lasers()[0].normal_and_distance_mm().1 / head().lasers()[0].normal_and_distance_mm().1;
    let sigma = with.directions.iter().map(|d| d.scale_sigma).fold(0.0, f64::max);
    assert!(sigma < PRIOR_SCALE && (wider - 1.002).abs() < 3.0 * sigma, "{wider}, sigma {sigma}");
}

#[test]
fn one_face_that_is_no_rectangle_does_not_bend_the_head() {
    let mut noise = Noise::new(15);
    let mut seen = faces(&head(), 40, &mut noise, 1.0);
    seen[7].lines.sides[0][0].at.u += 40.0;
    let drift = estimate_drift(&head(), &seen).expect("40 faces");
    let bad = drift.face_chi_squares[7].expect("fitted");
    assert!(bad > 100.0, "{bad}");
    assert!(!drift.test.significant(), "{:?}", drift.test);
}

/// What is known of a calibration counts: a change within its own covariance is none.
#[test]
fn a_poor_calibration_allows_more_before_it_is_called_changed() {
    let mut noise = Noise::new(16);
    let truth = some_motion(&mut noise);
    let seen = faces(&moved_head(&truth), 40, &mut noise, 1.0);
    let by_motion = blocks(&all_planes_by_motion(&head()).expect("planes"));
    let poor = MotionMatrix::identity() * 4e-6; // 2 mrad, 2 um
    let mut covariance = CalibrationCovariance::identity() * 1e-8;
    covariance.fixed_view_mut::<12, 12>(6, 6).copy_from(&(by_motion * poor * by_motion.transpose()));
    let symmetric = (covariance + covariance.transpose()) * 0.5;
    let calibration = head().with_covariance(symmetric).expect("symmetric");
    let drift = estimate_drift(&calibration, &seen).expect("40 faces");
    assert!(!drift.test.significant(), "{:?}", drift.test);
    assert!(estimate_drift(&head(), &seen).expect("40 faces").test.significant());
    let updated = drift.apply(&calibration).expect("a head");
    assert!(updated.covariance().is_some() && drift.apply(&head()).expect("a head").covariance().is_none());
}

#[test]
fn too_few_faces_are_refused() {
    let seen = faces(&head(), 2, &mut Noise::new(17), 1.0);
    let error = estimate_drift(&head(), &seen).expect_err("two faces");
    assert!(error.to_string().contains("2 measured faces, 3 are needed"), "{error}");
}

/// `cargo test --release -p boxline-calib --lib -- --ignored --nocapture how_often_a_moved_laser_is_seen`
#[test]
#[ignore = "a table for rust/CALIBRATION.md, minutes"]
fn how_often_a_moved_laser_is_seen() {
    let mut noise = Noise::new(21);
    println!("faces | still | one laser tilted by 0.01 | 0.02 | 0.05 | 0.2 mrad | sigma of its tilt, mrad");
    for count in [6, 10, 20, 40] {
        let runs = 200;
        let mut rates = Vec::new();
        let mut sigma = 0.0;
        for tilt_rad in [0.0, 0.01e-3, 0.02e-3, 0.05e-3, 0.2e-3] {
            let mut alarms = 0;
            for run in 0..runs {
                let mut truth = Motions::zeros();
                truth[3 * (run % 4)] = if run % 8 < 4 { tilt_rad } else { -tilt_rad };
                let seen = faces(&moved_head(&truth), count, &mut noise, 1.0);
                let drift = estimate_drift(&head(), &seen).expect("faces");
                alarms += usize::from(drift.test.significant());
                sigma += drift.lasers[run % 4].1.tilt_rad / (5 * runs) as f64;
            }
            rates.push(format!("{:.1} %", 100.0 * alarms as f64 / runs as f64));
        }
        println!("{count} | {} | {:.3}", rates.join(" | "), sigma * 1e3);
    }
}
