//! Does the covariance say how solves scatter? Hundreds of synthetic sets, observed with known noise, solved like real ones.

use super::adjust::{CentreSeen, Fixed, FrameSeen, Loss, Scatter, StripeSeen, adjust, solve_scaled};
use super::board::{Board, OnBoard};
use super::model::{SHARED, Shared, board_plane, moved};
use super::rim::on_board;
use crate::camera::CameraModel;
use crate::frames::{Cam, Point, Pose, Ray};
use crate::units::Px;
use nalgebra::{Rotation3, SMatrix, SVector, Vector3};

const BOARD: Board = Board { columns: 12, rows: 11, pitch_mm: 100.0, diameter_mm: 50.0 };
const CENTRE_SIGMA_PX: f64 = 0.05;
const STRIPE_SIGMA_PX: f64 = 0.3;
const SOLVES: usize = 300;

/// xorshift64*, summed to a bell: enough for noise, and the same on every machine.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

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
fn frames(head: &Shared) -> Vec<FrameSeen> {
    let mut noise = Noise(7);
    let face_us = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    (0..8)
        .map(|i| {
            let mut angle = |most: f64| (noise.uniform() * 2.0 - 1.0) * most;
            let turn = Rotation3::from_euler_angles(angle(0.6), angle(0.6), angle(3.0)) * face_us;
            let depth = 800.0 + 230.0 * f64::from(i);
            let pose: Pose<Cam, OnBoard> =
                Pose::new(turn.into_inner(), Vector3::new(angle(150.0), angle(120.0), depth));
            let inside = |px: &Px| px.u > 0.0 && px.v > 0.0 && px.u < 2591.0 && px.v < 1943.0;
            let mut frame = FrameSeen { pose, centres: Vec::new(), stripes: Vec::new() };
            for (column, row) in (0..12).flat_map(|c| (0..11).map(move |r| (c, r))) {
                let board_mm = BOARD.centre_mm(column, row);
                let point = pose.transform(&Point::new(board_mm.x, board_mm.y, 0.0));
                let at = head.camera.px_from_point(&point).filter(inside);
                frame.centres.extend(at.map(|at| CentreSeen { board_mm, at, sigma_px: CENTRE_SIGMA_PX }));
            }
            for laser in 0..4 {
                let line = board_plane(&pose) - head.planes[laser];
                for k in 0..120 {
                    let y = (f64::from(k) / 120.0 - 0.5) * 0.75;
                    let ray = Ray::new(-(line.y * y + line.z) / line.x, y);
                    let at = head.camera.px_from_ray(&ray).filter(inside);
                    let lit = |px: &Px| on_board(&head.camera, &pose, *px).is_some_and(|b| b.amax() < 600.0);
                    let at = at.filter(lit);
                    frame.stripes.extend(at.map(|at| StripeSeen { laser, at, sigma_px: STRIPE_SIGMA_PX }));
                }
            }
            frame
        })
        .collect()
}

#[test]
fn hundreds_of_solves_scatter_as_the_covariance_says() {
    let head = head();
    let clean = frames(&head);
    let scatter = Scatter { centres: 1.0, stripes: 1.0, stripe_correlation: 1.0, centre_correlation: 1.0 };
    let fixed = Fixed { skew: true, distortion: false, planes: false };
    let mut noise = Noise(1);
    let mut squares = SVector::<f64, 18>::zeros();
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
            18 => 0.0,
            _ => 1e-5 * noise.normal(),
        }));
        // As in `solve`: far residuals pull until the way is found.
        adjust(&mut found, &mut seen, &scatter, fixed, Loss::Huber).expect("a good set");
        let information = adjust(&mut found, &mut seen, &scatter, fixed, Loss::Tukey).expect("a good set");
        let (_, inverse) = solve_scaled(&information, &SVector::<f64, SHARED>::zeros()).expect("a good set");
        let covariance: SMatrix<f64, 18, 18> = inverse.fixed_view::<18, 18>(0, 0).into();
        let error = difference(&found, &head);
        squares += SVector::from_fn(|i, _| error[i] * error[i] / covariance[(i, i)]);
        // In units of the sigmas, to invert an even matrix.
        let units = SVector::<f64, 18>::from_fn(|i, _| 1.0 / covariance[(i, i)].sqrt());
        let even = SMatrix::from_diagonal(&units) * covariance * SMatrix::from_diagonal(&units);
        let scaled = error.component_mul(&units);
        chi_squares.push(scaled.dot(&even.cholesky().expect("positive").solve(&scaled)));
    }
    // Tukey's loss costs 5 % of the efficiency, in variance; 300 draws scatter by 8 % in variance (1 sigma), 4 of them.
    let ratio = squares / SOLVES as f64;
    assert!(ratio.iter().all(|r| (0.7..1.4).contains(r)), "variance over predicted, by parameter: {ratio}");
    // Mean of chi^2 with 18 degrees of freedom: 18 +- 6 / sqrt(300); with Tukey's 5 % up to 19 and a little.
    let mean = chi_squares.iter().sum::<f64>() / SOLVES as f64;
    assert!((16.5..20.5).contains(&mean), "mean chi^2 {mean}, 18 expected");
    let outside = chi_squares.iter().filter(|c| **c > 34.8).count(); // 1 % of chi^2 with 18 degrees of freedom
    assert!(outside <= 15, "{outside} of {SOLVES} beyond the 1 % quantile");
}

fn difference(a: &Shared, b: &Shared) -> SVector<f64, 18> {
    let camera = |c: &CameraModel| [c.fx, c.fy, c.cx, c.cy, c.k1, c.k2];
    SVector::from_fn(|i, _| {
        if i < 6 {
            camera(&a.camera)[i] - camera(&b.camera)[i]
        } else {
            a.planes[(i - 6) / 3][(i - 6) % 3] - b.planes[(i - 6) / 3][(i - 6) % 3]
        }
    })
}
