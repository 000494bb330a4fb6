//! Does the covariance say how solves scatter? Hundreds of synthetic sets, observed with known noise, solved like real ones.

use super::adjust::{
    CentreObservation, Fixed, FrameObservations, Loss, Scatter, StripeObservation, adjust, covariance,
    own_sigmas, scatter, solve_scaled,
};
use super::board::{Board, OnBoard};
use super::lens::{self, LensTerms};
use super::misfit::{Found, misfits};
use super::misfit_kind::MisfitKind;
use super::model::{SHARED, SKEW, Shared, board_plane, moved};
use super::patterns::Solved;
use super::planes;
use super::rim::on_board;
use super::uncertainty::{SideSeen, side_sigma_mm, usual_distance_mm};
use crate::noise::Noise;
use boxline::calibration::{CalibrationCovariance, PARAMETERS};
use boxline::camera::CameraModel;
use boxline::frames::{Cam, Point, Pose, Ray};
use boxline::units::Px;
use nalgebra::{Rotation3, SMatrix, SVector, Vector3};

const BOARD: Board = Board { columns: 12, rows: 11, pitch_mm: 100.0, diameter_mm: 50.0 };
const CENTRE_SIGMA_PX: f64 = 0.05;
const STRIPE_SIGMA_PX: f64 = 0.3;
const SOLVES: usize = 300;

fn head() -> Shared {
    Shared {
        camera: CameraModel {
            fx: 2458.9,
            fy: 2453.8,
            skew: 0.0,
            cx: 1239.5,
            cy: 1032.6,
            k1: -0.034,
            k2: 0.32,
            ..CameraModel::PINHOLE
        },
        planes: [
            Vector3::new(0.0079291, -0.00817394, 0.00018065),
            Vector3::new(0.01078476, -0.01121147, 0.00223845),
            Vector3::new(0.01037354, 0.00959161, 0.00170705),
            Vector3::new(0.00799885, 0.00730513, -0.00038506),
        ],
    }
}

/// Frames without noise: circles and stripe centres where the head sees them.
fn frames(head: &Shared, noise: &mut Noise) -> Vec<FrameObservations> {
    let face_us = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    (0..8)
        .map(|i| {
            let mut angle = |most: f64| (noise.uniform() * 2.0 - 1.0) * most;
            let turn = Rotation3::from_euler_angles(angle(0.6), angle(0.6), angle(3.0)) * face_us;
            let depth = 800.0 + 230.0 * f64::from(i);
            let pose: Pose<Cam, OnBoard> =
                Pose::new(turn.into_inner(), Vector3::new(angle(150.0), angle(120.0), depth));
            let inside = |px: &Px| px.u > 0.0 && px.v > 0.0 && px.u < 2591.0 && px.v < 1943.0;
            let mut frame = FrameObservations { pose, centres: Vec::new(), stripes: Vec::new() };
            for (column, row) in (0..12).flat_map(|c| (0..11).map(move |r| (c, r))) {
                let board_mm = BOARD.centre_mm(column, row);
                let point = pose.transform(&Point::new(board_mm.x, board_mm.y, 0.0));
                let at = head.camera.px_from_point(&point).filter(inside);
                frame.centres.extend(at.map(|at| CentreObservation {
                    board_mm,
                    at,
                    sigma_px: CENTRE_SIGMA_PX,
                }));
            }
            for laser in 0..4 {
                let line = board_plane(&pose) - head.planes[laser];
                for k in 0..120 {
                    let y = (f64::from(k) / 120.0 - 0.5) * 0.75;
                    let ray = Ray::new(-(line.y * y + line.z) / line.x, y);
                    let at = head.camera.px_from_ray(&ray).filter(inside);
                    let lit = |px: &Px| on_board(&head.camera, &pose, *px).is_some_and(|b| b.amax() < 600.0);
                    let at = at.filter(lit);
                    frame.stripes.extend(at.map(|at| StripeObservation {
                        laser,
                        at,
                        sigma_px: STRIPE_SIGMA_PX,
                    }));
                }
            }
            frame
        })
        .collect()
}

#[test]
fn hundreds_of_solves_scatter_as_the_covariance_says() {
    let head = head();
    let clean = frames(&head, &mut Noise::new(7));
    let fixed = Fixed { skew: true, distortion: false, lens: LensTerms::BROWN, planes: false, all: false };
    let mut noise = Noise::new(1);
    let mut squares = SVector::<f64, PARAMETERS>::zeros();
    let mut chi_squares = Vec::new();
    for _ in 0..SOLVES {
        let mut seen = clean.clone();
        for frame in &mut seen {
            for c in &mut frame.centres {
                c.at = Px::new(
                    c.at.u + CENTRE_SIGMA_PX * noise.normal(),
                    c.at.v + CENTRE_SIGMA_PX * noise.normal(),
                );
            }
            for s in &mut frame.stripes {
                // Along and across alike: along the stripe it changes nothing.
                s.at = Px::new(
                    s.at.u + STRIPE_SIGMA_PX * noise.normal(),
                    s.at.v + STRIPE_SIGMA_PX * noise.normal(),
                );
            }
            // Not from the truth: a fit that does not move would pass.
            let step = SVector::from_fn(|i, _| noise.normal() * if i < 3 { 1e-3 } else { 1.0 });
            frame.pose = moved(&frame.pose, &step);
        }
        let mut found = head.plus(&SVector::from_fn(|i, _| match i {
            0..4 => 5.0 * noise.normal(),
            4 | 5 => 0.01 * noise.normal(),
            SKEW => 0.0,
            18..SKEW => 0.001 * noise.normal(),
            _ => 1e-5 * noise.normal(),
        }));
        // As in `solve`: far residuals pull until the way is found.
        adjust(&mut found, &mut seen, &Scatter::EVEN, fixed, Loss::Huber).expect("a good set");
        let information =
            adjust(&mut found, &mut seen, &Scatter::EVEN, fixed, Loss::Tukey).expect("a good set");
        let (_, inverse) = solve_scaled(&information, &SVector::<f64, SHARED>::zeros()).expect("a good set");
        let covariance = covariance(&inverse);
        let error = found.minus(&head);
        squares += SVector::from_fn(|i, _| error[i] * error[i] / covariance[(i, i)]);
        // In units of the sigmas, to invert an even matrix.
        let units = SVector::<f64, PARAMETERS>::from_fn(|i, _| 1.0 / covariance[(i, i)].sqrt());
        let even = SMatrix::from_diagonal(&units) * covariance * SMatrix::from_diagonal(&units);
        let scaled = error.component_mul(&units);
        chi_squares.push(scaled.dot(&even.cholesky().expect("positive").solve(&scaled)));
    }
    // Tukey's loss costs 5 % of the efficiency, in variance; 300 draws scatter by 8 % in variance (1 sigma), 4 of them.
    let ratio = squares / SOLVES as f64;
    assert!(ratio.iter().all(|r| (0.7..1.4).contains(r)), "variance over predicted, by parameter: {ratio}");
    // Mean of chi^2 with 21 degrees of freedom: 21 +- 6.5 / sqrt(300); with Tukey's 5 % up to 22 and a little.
    let mean = chi_squares.iter().sum::<f64>() / SOLVES as f64;
    assert!((19.4..23.6).contains(&mean), "mean chi^2 {mean}, 21 expected");
    let outside = chi_squares.iter().filter(|c| **c > 38.9).count(); // 1 % of chi^2 with 21 degrees of freedom
    assert!(outside <= 15, "{outside} of {SOLVES} beyond the 1 % quantile");
}

/// Of sets whose lens is the paper's few get more terms, and a lens that has more gets those it has.
#[test]
fn frames_left_out_tell_which_terms_the_lens_has() {
    let fixed = Fixed { skew: true, distortion: false, lens: LensTerms::PAPER, planes: true, all: false };
    let mut noise = Noise::new(3);
    let mut chosen = |camera: CameraModel| {
        let head = Shared { camera, ..head() };
        let mut seen = frames(&head, &mut Noise::new(7));
        for c in seen.iter_mut().flat_map(|frame| &mut frame.centres) {
            c.at.u += CENTRE_SIGMA_PX * noise.normal();
            c.at.v += CENTRE_SIGMA_PX * noise.normal();
        }
        seen.iter_mut().for_each(|frame| frame.stripes.clear());
        let paper = CameraModel { p1: 0.0, p2: 0.0, k3: 0.0, ..camera };
        let mut shared = Shared { camera: paper, ..head };
        adjust(&mut shared, &mut seen, &Scatter::EVEN, fixed, Loss::Huber).expect("a good set");
        let (terms, trials) = lens::choose(&shared, &seen, fixed);
        assert_eq!((trials[0].terms, trials[0].gain), (LensTerms::PAPER, None));
        println!("{trials:?}");
        terms
    };
    let camera = head().camera;
    let more = (0..20).filter(|_| chosen(camera) != LensTerms::PAPER).count();
    assert!(more <= 1, "{more} of 20 sets of a paper's lens have more terms");
    let decentred = CameraModel { p1: 0.004, p2: -0.003, ..camera };
    assert_eq!(chosen(decentred), LensTerms { decentred: true, k3: false });
    assert_eq!(chosen(CameraModel { k3: 2.0, ..camera }), LensTerms { decentred: false, k3: true });
    assert_eq!(chosen(CameraModel { k3: 2.0, ..decentred }), LensTerms::BROWN);
}

/// A set of frames with something wrong in it, solved with the paper's lens.
struct WrongSet {
    found: Found,
    /// How large what is wrong is, as [`Misfit::size`](super::misfit_kind::Misfit::size) has it; `None` for a lens.
    size: Option<f64>,
    /// Errors of fx, fy, cx, cy in their sigmas, what was found taken in.
    sigmas: [f64; 4],
}

/// Standard deviation of a list.
fn spread(all: &[f64]) -> f64 {
    let n = all.len() as f64;
    let mean = all.iter().sum::<f64>() / n;
    (all.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt()
}

fn wrong_set(noise: &mut Noise, kind: Option<MisfitKind>) -> WrongSet {
    let head = head();
    let mut seen = frames(&head, noise);
    let mut size = None;
    let mut focus = Vec::new();
    for (i, frame) in seen.iter_mut().enumerate() {
        let camera = match kind {
            Some(MisfitKind::Lens) => CameraModel { p1: 0.004, p2: -0.003, ..head.camera },
            Some(MisfitKind::FocusChanges) => {
                let share = 1.0 + 0.002 * noise.normal();
                focus.push(share);
                CameraModel { fx: head.camera.fx * share, fy: head.camera.fy * share, ..head.camera }
            }
            Some(MisfitKind::Shifted) => {
                let shift = if i % 2 == 0 { 1.0 } else { -1.0 };
                size = Some(spread(&[1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0]) * f64::hypot(3.0, 2.0));
                CameraModel {
                    cx: head.camera.cx + 3.0 * shift,
                    cy: head.camera.cy - 2.0 * shift,
                    ..head.camera
                }
            }
            _ => head.camera,
        };
        let pose = frame.pose;
        let larger = if i % 2 == 0 { 1.002 } else { 1.0 };
        // 1.5 mm from the middle to the corners.
        let bow = |x: f64, y: f64| match kind {
            Some(MisfitKind::BoardBowed) => 1.5 * (x * x + y * y) / (550.0 * 550.0 + 500.0 * 500.0),
            _ => 0.0,
        };
        for c in &mut frame.centres {
            let (x, y) = (c.board_mm.x, c.board_mm.y);
            // Every third frame shows columns and rows exchanged, as parts of a grid may be.
            let (along, down) = match kind {
                Some(MisfitKind::BoardStretched) if i % 3 == 1 => (1.0, 1.001),
                Some(MisfitKind::BoardStretched) => (1.001, 1.0),
                Some(MisfitKind::BoardsDiffer) => (larger, 1.0),
                _ => (1.0, 1.0),
            };
            let point = pose.transform(&Point::new(x * along, y * down, bow(x, y)));
            c.at = camera.px_from_point(&point).expect("in front of the camera");
            c.at.u += CENTRE_SIGMA_PX * noise.normal();
            c.at.v += CENTRE_SIGMA_PX * noise.normal();
        }
        for s in &mut frame.stripes {
            // Where the laser meets the board that is bowed there.
            let on_board = on_board(&head.camera, &pose, s.at).expect("on the board");
            let normal: Vector3<f64> = pose.rotation.column(2).into();
            let lifted = Pose::new(pose.rotation, pose.translation_mm + normal * bow(on_board.x, on_board.y));
            let line = board_plane(&lifted) - head.planes[s.laser];
            let ray = head.camera.ray_from_px(s.at);
            let moved = Ray::new(-(line.y * ray.xy1.y + line.z) / line.x, ray.xy1.y);
            // Where the camera of the frame sees the same ray; along the stripe it does not matter.
            s.at = camera.px_from_ray(&moved).expect("in the picture");
            s.at.u += STRIPE_SIGMA_PX * noise.normal();
        }
    }
    size = match kind {
        Some(MisfitKind::BoardBowed) => {
            let corners = seen.iter().flat_map(|f| &f.centres).map(|c| c.board_mm.norm_squared());
            Some(1.5 * corners.fold(0.0, f64::max) / (550.0 * 550.0 + 500.0 * 500.0))
        }
        Some(MisfitKind::BoardStretched) => Some(0.001),
        Some(MisfitKind::FocusChanges) => Some(spread(&focus)),
        // Only the columns' pitch differs, by 0.002 in every second frame.
        Some(MisfitKind::BoardsDiffer) => {
            Some(0.001 * spread(&[1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0]) / 2f64.sqrt())
        }
        _ => size,
    };
    let fixed = Fixed { skew: true, distortion: false, lens: LensTerms::PAPER, planes: false, all: false };
    let mut shared = head.clone();
    adjust(&mut shared, &mut seen, &Scatter::EVEN, fixed, Loss::Huber).expect("a good set");
    for _ in 0..3 {
        own_sigmas(&shared, &mut seen);
        let spread = scatter(&shared, &seen);
        adjust(&mut shared, &mut seen, &spread, fixed, Loss::Tukey).expect("a good set");
    }
    let spread = scatter(&shared, &seen);
    let solved = Solved {
        shared: shared.clone(),
        frames: seen,
        scatter: spread,
        fixed,
        image_px: [2592, 1944],
        board: BOARD,
    };
    let found = misfits(&solved).expect("a good set");
    for misfit in &found.misfits {
        println!("{kind:?}: {misfit}, chi^2 {:.0} over {:.0}; {size:?}", misfit.chi_square, misfit.limit);
    }
    let error = found.shared.minus(&head);
    let sigmas = [0, 1, 2, 3].map(|i| error[i] / found.covariance[(i, i)].sqrt());
    WrongSet { found, size, sigmas }
}

/// What is named in sets with something wrong in them, or with nothing.
struct Rates {
    sets: usize,
    /// Sets in which each kind, in the order of [`MisfitKind::ALL`], is named first; the last: nothing is named.
    first: [usize; 7],
    /// Sets in which it is named at all.
    named: [usize; 6],
    /// Mean size over the true one where the right kind is named first.
    size: f64,
    /// Mean (error/sigma)^2 of fx, fy, cx, cy.
    square: f64,
}

fn rates(kind: Option<MisfitKind>, sets: usize) -> Rates {
    let index = |kind: MisfitKind| MisfitKind::ALL.iter().position(|k| *k == kind).expect("one of all");
    let mut noise = Noise::new(11 + kind.map_or(0, |kind| 1 + index(kind) as u64));
    let mut rates = Rates { sets, first: [0; 7], named: [0; 6], size: 0.0, square: 0.0 };
    let mut ratios = Vec::new();
    for _ in 0..sets {
        let set = wrong_set(&mut noise, kind);
        rates.square += set.sigmas.iter().map(|s| s * s).sum::<f64>() / 4.0 / sets as f64;
        let first = set.found.misfits.first();
        rates.first[first.map_or(6, |first| index(first.kind))] += 1;
        set.found.misfits.iter().for_each(|misfit| rates.named[index(misfit.kind)] += 1);
        ratios
            .extend(first.zip(set.size).filter(|(m, _)| Some(m.kind) == kind).map(|(m, size)| m.size / size));
    }
    rates.size = ratios.iter().sum::<f64>() / ratios.len().max(1) as f64;
    rates
}

/// Wilson's interval of a share that holds it in 95 of 100, percent.
fn interval(hits: usize, of: usize) -> [f64; 2] {
    let (n, p, z) = (of as f64, hits as f64 / of as f64, 1.96f64);
    let middle = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    [middle - half, middle + half].map(|x| 100.0 * x.clamp(0.0, 1.0))
}

/// Each pattern is named first where it is, with its size, and none where nothing is wrong; sigmas take in what it does to the camera.
#[test]
fn what_does_not_fit_is_named() {
    const SETS: usize = 10;
    let sound = rates(None, 2 * SETS);
    let alarms = sound.sets - sound.first[6];
    assert!(alarms <= 1, "{alarms} of {} sound sets", sound.sets);
    for (i, kind) in MisfitKind::ALL.into_iter().enumerate() {
        let Rates { first, size, square, .. } = rates(Some(kind), SETS);
        assert!(first[i] + 1 >= SETS, "{kind:?} is named first in {} of {SETS} sets", first[i]);
        // Boards that differ: a stretch of its own takes half of what a frame says about the camera, and what is left is in the size.
        let (limit, most) = if kind == MisfitKind::BoardsDiffer { (0.15, 4.0) } else { (0.05, 3.0) };
        // A lens has no size of its own.
        assert!(
            kind == MisfitKind::Lens || (size - 1.0).abs() < limit,
            "{kind:?}: size {size} of the true one"
        );
        // A mean of 40 squares of which some ten are independent scatters by 0.45.
        assert!(square < most, "{kind:?}: mean (error/sigma)^2 {square}");
    }
}

#[test]
#[ignore = "for reading: cargo test --release -p boxline-calib --lib -- --ignored --nocapture how_often_what_does_not_fit_is_named"]
fn how_often_what_does_not_fit_is_named() {
    const SETS: usize = 40;
    let kinds = std::iter::once(None).chain(MisfitKind::ALL.map(Some));
    let names: Vec<&str> = MisfitKind::ALL.iter().map(|kind| kind.name()).collect();
    println!(
        "| what is wrong, {SETS} sets | first, of all (95 %) | named: {} | size | (error/sigma)^2 |",
        names.join(", ")
    );
    std::thread::scope(|scope| {
        let all: Vec<_> = kinds.map(|kind| (kind, scope.spawn(move || rates(kind, SETS)))).collect();
        for (kind, rates) in all {
            let rates = rates.join().expect("a worker panicked");
            let name = kind.map_or("nothing", MisfitKind::name);
            let right = MisfitKind::ALL.iter().position(|k| Some(*k) == kind).unwrap_or(6);
            let [low, high] = interval(rates.first[right], SETS);
            let named: Vec<String> = rates.named.iter().map(ToString::to_string).collect();
            println!(
                "| {name} | {} of {SETS} ({low:.0} to {high:.0} %) | {} | {:.3} | {:.2} |",
                rates.first[right],
                named.join(", "),
                rates.size,
                rates.square
            );
        }
    });
}

/// A k3 that the camera has not moves it and its planes; sigmas say by how much, and those of sides are no larger for it.
#[test]
fn sigmas_take_in_a_term_that_was_not_chosen() {
    const SETS: usize = 60;
    let terms = LensTerms { decentred: true, k3: false };
    let fixed = Fixed { skew: true, distortion: false, lens: terms, planes: false, all: false };
    let mut noise = Noise::new(5);
    let (mut squares, mut without) = (0.0, 0.0);
    let mut sides = [(600.0, 0.0, 0.0), (1800.0, 0.0, 0.0)];
    for _ in 0..SETS {
        let mut head = head();
        head.camera.p1 = 0.004;
        head.camera.p2 = -0.003;
        head.camera.k3 = 0.1 * noise.normal();
        let mut seen = frames(&head, &mut noise);
        for c in seen.iter_mut().flat_map(|frame| &mut frame.centres) {
            c.at.u += CENTRE_SIGMA_PX * noise.normal();
            c.at.v += CENTRE_SIGMA_PX * noise.normal();
        }
        for s in seen.iter_mut().flat_map(|frame| &mut frame.stripes) {
            s.at.u += STRIPE_SIGMA_PX * noise.normal();
        }
        let mut shared = Shared { camera: CameraModel { k3: 0.0, ..head.camera }, ..head.clone() };
        adjust(&mut shared, &mut seen, &Scatter::EVEN, fixed, Loss::Huber).expect("a good set");
        let spread = scatter(&shared, &seen);
        let information = adjust(&mut shared, &mut seen, &spread, fixed, Loss::Tukey).expect("a good set");
        let (_, inverse) = solve_scaled(&information, &SVector::zeros()).expect("a good set");
        let plain = covariance(&inverse);
        let solved = Solved {
            shared: shared.clone(),
            frames: seen,
            scatter: spread,
            fixed,
            image_px: [2592, 1944],
            board: BOARD,
        };
        let covariance = misfits(&solved).expect("a good set").covariance;
        let error = shared.minus(&head);
        let square = |c: &CalibrationCovariance| (0..4).map(|i| error[i].powi(2) / c[(i, i)]).sum::<f64>();
        squares += square(&covariance) / 4.0 / SETS as f64;
        without += square(&plain) / 4.0 / SETS as f64;
        let (lasers, found) = (planes::typed(&head.planes), planes::typed(&shared.planes));
        for (side_mm, z, sigma) in &mut sides {
            let distance_mm = usual_distance_mm(*side_mm);
            let seen = SideSeen::new(|ray| head.camera.px_from_ray(ray), &lasers, *side_mm, distance_mm);
            let length_mm = seen.and_then(|seen| seen.length_mm(&shared.camera, &found)).expect("in view");
            let sigma_mm =
                side_sigma_mm(&shared.camera, &found, &covariance, *side_mm, distance_mm).expect("in view");
            *z += ((length_mm - *side_mm) / sigma_mm).powi(2) / SETS as f64;
            *sigma += sigma_mm / SETS as f64;
        }
    }
    println!(
        "(error/sigma)^2 of fx, fy, cx, cy {squares:.2}, {without:.2} as if k3 were known; sides {sides:.3?}"
    );
    // fx and fy go together, so 60 sets are 180 squares at most: 0.1 of a mean, of which this allows three.
    assert!((0.7..1.3).contains(&squares), "mean (error/sigma)^2 {squares}");
    assert!(without > 1.5, "{without}: k3 moves nothing, this proves nothing");
    assert!(sides.iter().all(|(_, z, _)| (0.5..1.6).contains(z)), "sides: mean (error/sigma)^2 {sides:?}");
}
