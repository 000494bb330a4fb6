//! The renderer shares core's camera, so it cannot find that camera's mistakes: projections are pinned to OpenCV's.
//! The table is what `projection_table.py` beside this file prints.

use boxline::CameraModel;
use boxline::frames::Point;
use boxline_sim::head::SENSOR_PX;
use boxline_sim::render::{Options, Stage};
use boxline_sim::truth::{Shot, face_of, face_truth};
use boxline_sim::world::{Plan, compose};
use boxline_sim::{Head, Raster, Rng, Stock};

const CAMERA: CameraModel = CameraModel {
    fx: 2431.5,
    fy: 2440.25,
    skew: 0.0,
    cx: 1301.25,
    cy: 968.5,
    k1: -0.0412,
    k2: 0.2875,
    ..CameraModel::PINHOLE
};

const TABLE: [([f64; 3], [f64; 2]); 7] = [
    ([0.0, 0.0, 1000.0], [1301.2500000, 968.5000000]),
    ([120.0, -80.0, 350.0], [2133.8505716, 411.4354870]),
    ([-310.5, 205.25, 884.0], [448.6449320, 1534.1262009]),
    ([700.0, 500.0, 2400.0], [2010.8229869, 1477.1617553]),
    ([-1020.0, 640.0, 2015.5], [94.5346323, 1728.3794389]),
    ([160.0, 118.0, 331.0], [2453.2657295, 1821.1690142]),
    ([-1200.0, -900.0, 2450.0], [136.1956690, 91.5648269]),
];

#[test]
fn projections_agree_with_opencv() {
    for ([x, y, z], [u, v]) in TABLE {
        let px = CAMERA.px_from_point(&Point::new(x, y, z)).unwrap();
        assert!((px.u - u).abs() < 1e-5 && (px.v - v).abs() < 1e-5, "({x}, {y}, {z}): {px:?}");
    }
}

/// Truth corners, their pixels and the rays of those pixels agree; the face has the size that the file says.
#[test]
fn truth_corners_are_where_the_rays_go() {
    let head = Head::random(&mut Rng::new(4, 1)).unwrap();
    let stock = Stock::default();
    let scene = compose(&mut Rng::new(4, 2), &head, Plan::Box, &stock);
    assert_eq!(scene.views.len(), 2);
    for view in &scene.views {
        let shot = Shot { scene: &scene, view, id: "a".into(), off: None };
        let truth = face_truth(&head, &shot, &stock);
        let numbers = |key: &str, i: usize| -> Vec<f64> {
            truth[key][i].as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect()
        };
        let stage =
            Stage::new(&scene, view, &head, Raster::full(SENSOR_PX), &stock.photos, Options::default());
        for i in 0..4 {
            let (mm, px) = (numbers("corners_cam_mm", i), numbers("corners_px", i));
            let ray = stage.ray(px[0], px[1]);
            let off = f64::from(ray.x) * mm[2] - mm[0];
            assert!(off.hypot(f64::from(ray.y) * mm[2] - mm[1]) < 1e-3 * mm[2] / 1000.0, "corner {i}: {off}");
        }
        let side = |i: usize, j: usize| {
            let (a, b) = (numbers("corners_cam_mm", i), numbers("corners_cam_mm", j));
            a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
        };
        let size = face_of(&scene, view).unwrap().size_mm();
        for (i, j, expected) in [(0, 1, size[0]), (3, 2, size[0]), (1, 2, size[1]), (0, 3, size[1])] {
            assert!((side(i, j) - expected).abs() < 1e-4);
        }
    }
}
