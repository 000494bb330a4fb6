//! A face from points without pictures: the door for programs that draw stripe and edge points from a known scene and ask
//! whether the sigmas are true. From here on everything is the product's own way: plane, joint fit, sharp edges, checks.
//! No part of the product's interface.

use crate::calibration::Calibration;
use crate::cuboid;
use crate::edges::EdgePoint;
use crate::face::extent::crossing_px;
use crate::face::outline::{InitialRectangle, SIDES};
use crate::face::plane_fit::{StripeObservation, fit_plane};
use crate::face::raster::{OnPlane, PlaneRaster};
use crate::frames::Plane;
use crate::measurement::{FaceMeasurement, Outcome, Settings};
use crate::rectangle::FaceObservations;
use crate::rectangle::rounding::EdgeProfile;
use crate::rectangle::sharp_edge::{combine, from_shading};
use crate::rectangle::side_view::{middle, outwards};
use crate::units::{LaserId, Px};
use crate::warning::Warning;
use nalgebra::Vector3;

/// A point in the image and its standard deviation across its stripe or side, px.
pub type PointWithSigma = (Px, f64);

/// What is seen of one side of a face.
#[derive(Clone, Debug, Default)]
pub struct SidePoints {
    /// Points of the edge in the image.
    pub points: Vec<PointWithSigma>,
    /// Stripe points on the surface beyond, at a right angle through the sharp edge ...
    pub beyond: Vec<(LaserId, Px)>,
    /// ... and the standard deviation of the place that they tell, mm.
    pub beyond_sigma_mm: f64,
    /// Brightness across the side, if it is seen.
    pub profile: Option<BrightnessProfile>,
}

/// Brightness across a side in linear light, one sample a px outwards.
#[derive(Clone, Debug, Default)]
pub struct BrightnessProfile {
    /// The first sample lies so far inside the strongest gradient.
    pub inside_px: usize,
    /// Brightness and its standard deviation.
    pub samples: Vec<(f64, f64)>,
}

/// Measures a face from the points of its four stripes, along each in order, and of its four sides, in any order of sides.
/// `None` if they fix no rectangle.
#[must_use]
pub fn measure_points(
    calibration: &Calibration,
    stripes: &[Vec<PointWithSigma>; 4],
    sides: &[SidePoints; 4],
    settings: &Settings,
) -> Option<FaceMeasurement> {
    let observation = |laser: LaserId| {
        stripes[laser.index()].iter().map(move |&(at, sigma_px)| StripeObservation { laser, at, sigma_px })
    };
    let stripes: Vec<StripeObservation> = LaserId::ALL.into_iter().flat_map(observation).collect();
    let far = Plane::new(Vector3::z() * 1e-3);
    let plane = fit_plane(calibration, &stripes, &far)?.plane;
    let [l1, _, l3, l4] = LaserId::ALL;
    let (at, towards) =
        (crossing_px(calibration, &plane, l1, l3)?, crossing_px(calibration, &plane, l1, l4)?);
    let raster = PlaneRaster::new(calibration, &plane, at, towards)?;
    let middles: Vec<OnPlane> = sides
        .iter()
        .map(|side| {
            let on = side.points.iter().map(|(at, _)| raster.on_plane(calibration, *at));
            let sum: OnPlane = on.collect::<Option<Vec<_>>>()?.into_iter().sum();
            Some(sum / side.points.len() as f64)
        })
        .collect::<Option<_>>()?;
    let order = SIDES.map(|(across, high)| {
        let place = |i: &usize| across.offset(middles[*i]);
        if high {
            (0..4).max_by(|i, j| place(i).total_cmp(&place(j)))
        } else {
            (0..4).min_by(|i, j| place(i).total_cmp(&place(j)))
        }
        .unwrap_or(0)
    });
    let edges = order.map(|i| {
        sides[i].points.iter().map(|&(at, sigma_px)| EdgePoint { at, sigma_px }).collect::<Vec<_>>()
    });
    let offsets_mm = [0, 1, 2, 3].map(|side| SIDES[side].0.offset(middles[order[side]]));
    let mm_per_px = raster.mm_per_px(calibration, OnPlane::zeros())?;
    let initial = InitialRectangle::new(raster, offsets_mm, mm_per_px);
    let observed = FaceObservations { calibration, stripes: &stripes, edges: &edges };
    let fitted = observed.fit(&initial, settings)?;
    let profiles = order.map(|i| {
        let profile = sides[i].profile.as_ref()?;
        let (light, sigma) = profile.samples.iter().copied().unzip();
        Some(EdgeProfile { inside_px: profile.inside_px, light, sigma })
    });
    let expected = from_shading(calibration, &fitted.fit, &profiles);
    let corrections = [0, 1, 2, 3].map(|side| {
        let expected = expected[side];
        let seen = &sides[order[side]];
        let places = seen.beyond.iter().filter_map(|(laser, at)| {
            let on_laser = calibration.laser(*laser).intersect(&calibration.camera().ray_from_px(*at))?;
            Some((on_laser.mm - middle(&fitted.fit, side)).dot(&outwards(&fitted.fit, side)))
        });
        let (sum, count) = places.fold((0.0, 0.0), |(s, n), place| (s + place, n + 1.0));
        if count > 0.0 { combine(expected, sum / count, seen.beyond_sigma_mm) } else { expected }
    });
    observed.by_fit(fitted, &corrections)
}

/// Puts two faces of a box together.
#[must_use]
pub fn measure_box_of(first: &FaceMeasurement, second: &FaceMeasurement) -> (Outcome, Vec<Warning>) {
    cuboid::assemble(&[first, second], None)
}
