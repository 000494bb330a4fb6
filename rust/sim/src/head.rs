//! A head: its calibration as core knows it, and what core does not know (power and width of the beams, where they start).

use crate::error::Error;
use crate::rng::Rng;
use boxline::{Calibration, CameraModel, LaserId};
use nalgebra::Vector3;
use serde_json::{Value, json};

/// The sensor's size, px.
pub const SENSOR_PX: [u32; 2] = [2592, 1944];

/// Table 2 of the paper: the head's nominal camera.
const NOMINAL_CAMERA: CameraModel = CameraModel {
    fx: 2458.9172,
    fy: 2453.81,
    skew: 0.0,
    cx: 1239.5188,
    cy: 1032.559,
    k1: -0.034_159_37,
    k2: 0.321_070_446,
    ..CameraModel::PINHOLE
};

/// Table 2 of the paper: the nominal laser planes `p . X = 1`, 1/mm.
const NOMINAL_PLANES: [[f64; 3]; 4] = [
    [0.007_929_1, -0.008_173_94, 0.000_180_65],
    [0.010_784_76, -0.011_211_47, 0.002_238_45],
    [0.010_373_54, 0.009_591_61, 0.001_707_05],
    [0.007_998_85, 0.007_305_13, -0.000_385_06],
];

/// Which head.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HeadKind {
    /// The paper's ([`Head::nominal`]).
    Nominal,
    /// As production scatters it ([`Head::random`]).
    #[default]
    Random,
    /// With a real lens ([`Head::real`]).
    Real,
}

/// One line laser.
#[derive(Clone, Copy, Debug)]
pub struct Beam {
    /// Where the light comes from: on the camera's x axis, mm.
    pub source_mm: Vector3<f64>,
    /// Unit direction of the fan's middle, in the laser's plane.
    pub forward: Vector3<f64>,
    /// Half of the fan's opening, rad.
    pub fan_half_rad: f64,
    /// Standard deviation of the sheet's thickness as an angle, rad.
    pub sigma_rad: f64,
    /// Relative power, about 1; 0 is a dead laser.
    pub power: f64,
}

/// A head with its four beams.
#[derive(Clone, Debug)]
pub struct Head {
    /// What core gets to know.
    pub calibration: Calibration,
    /// The beams in the order of the planes.
    pub beams: [Beam; 4],
}

impl Head {
    /// The head of the paper's Table 2, all beams alike.
    ///
    /// # Errors
    /// None in practice: the numbers are fixed and tested.
    pub fn nominal() -> Result<Self, Error> {
        Self::new("SIM-NOMINAL", NOMINAL_CAMERA, NOMINAL_PLANES, [1.0; 4], [2.5; 4])
    }

    /// A head as production would scatter it: intrinsics within 3 %, planes within 2 to 3 %, unequal beams.
    ///
    /// # Errors
    /// None in practice: a draw that core refuses is drawn again, many times.
    pub fn random(rng: &mut Rng) -> Result<Self, Error> {
        let mut last = None;
        for _ in 0..50 {
            let mut camera = NOMINAL_CAMERA;
            let focal = rng.range(0.97, 1.03);
            camera.fx *= focal * rng.range(0.998, 1.002);
            camera.fy *= focal * rng.range(0.998, 1.002);
            camera.cx = f64::from(SENSOR_PX[0] - 1) / 2.0 + rng.normal() * 25.0;
            camera.cy = f64::from(SENSOR_PX[1] - 1) / 2.0 + rng.normal() * 25.0;
            camera.k1 += rng.range(-0.02, 0.02);
            camera.k2 += rng.range(-0.08, 0.08);
            let tilt = rng.log_range(0.003, 0.02); // one laser's pointing error, rad
            let planes = NOMINAL_PLANES.map(|p| {
                let p = Vector3::from(p);
                let turned = p + p.norm() * tilt * Vector3::new(rng.normal(), rng.normal(), rng.normal());
                (turned * rng.range(0.975, 1.025)).into()
            });
            let power = [0; 4].map(|_| rng.range(0.75, 1.25));
            let width = rng.range(1.6, 3.6); // sigma, px
            let sigma_px = [0; 4].map(|_| width * rng.range(0.85, 1.15));
            let serial = format!("SIM-{:06X}", rng.bits() >> 8);
            match Self::new(&serial, camera, planes, power, sigma_px) {
                Ok(head) => return Ok(head),
                Err(error) => last = Some(error),
            }
        }
        Err(last.unwrap_or_else(|| Error::new("head", "no head drawn")))
    }

    /// A head as [`Self::random`] with a real lens: decentred by up to 0.01, and k3.
    ///
    /// # Errors
    /// As [`Self::random`].
    pub fn real(rng: &mut Rng) -> Result<Self, Error> {
        let head = Self::random(rng)?;
        let mut camera = *head.calibration.camera();
        let (size, way) = (rng.range(0.001, 0.01), rng.range(0.0, std::f64::consts::TAU));
        (camera.p1, camera.p2, camera.k3) = (size * way.cos(), size * way.sin(), rng.range(-0.2, 0.2));
        head.with_camera(camera)
    }

    /// The head of a kind for a seed's random numbers.
    ///
    /// # Errors
    /// As [`Self::random`].
    pub fn of_kind(kind: HeadKind, rng: &mut Rng) -> Result<Self, Error> {
        match kind {
            HeadKind::Nominal => Self::nominal(),
            HeadKind::Random => Self::random(rng),
            HeadKind::Real => Self::real(rng),
        }
    }

    /// The same with another focal length, by this factor.
    ///
    /// # Errors
    /// If core refuses it.
    pub fn with_focus(&self, factor: f64) -> Result<Self, Error> {
        let camera = *self.calibration.camera();
        self.with_camera(CameraModel { fx: camera.fx * factor, fy: camera.fy * factor, ..camera })
    }

    /// The same beams beside another camera.
    fn with_camera(&self, camera: CameraModel) -> Result<Self, Error> {
        let planes = [0, 1, 2, 3].map(|i| self.plane(i).into());
        let head = Self::new(self.calibration.serial(), camera, planes, [1.0; 4], [2.5; 4])?;
        Ok(Self { beams: self.beams, ..head })
    }

    /// A head with these parameters and usual beams; planes `p . X = 1`, 1/mm.
    ///
    /// # Errors
    /// If core refuses them.
    pub fn of(serial: &str, camera: CameraModel, planes: [Vector3<f64>; 4]) -> Result<Self, Error> {
        Self::new(serial, camera, planes.map(Into::into), [1.0; 4], [2.5; 4])
    }

    fn new(
        serial: &str,
        camera: CameraModel,
        planes: [[f64; 3]; 4],
        power: [f64; 4],
        sigma_px: [f64; 4],
    ) -> Result<Self, Error> {
        // Rounded as the file will have it, so that a reader of the file sees the very planes that were rendered.
        let round = |x: f64, digits: i32| (x * 10f64.powi(digits)).round() / 10f64.powi(digits);
        let camera = CameraModel {
            fx: round(camera.fx, 6),
            fy: round(camera.fy, 6),
            skew: 0.0,
            cx: round(camera.cx, 6),
            cy: round(camera.cy, 6),
            k1: round(camera.k1, 9),
            k2: round(camera.k2, 9),
            p1: round(camera.p1, 9),
            p2: round(camera.p2, 9),
            k3: round(camera.k3, 9),
        };
        let planes = planes.map(|p| p.map(|x| round(x, 10)));
        let calibration =
            Calibration::new(serial, SENSOR_PX, camera, planes.map(|p| [p[0], p[1], p[2], -1.0]))
                .map_err(|e| Error::new("head", e))?;
        let beams = [0, 1, 2, 3].map(|i| {
            let p = Vector3::from(planes[i]);
            let n = p.normalize();
            Beam {
                source_mm: Vector3::new(1.0 / p.x, 0.0, 0.0),
                forward: (Vector3::z() - n * n.z).normalize(),
                fan_half_rad: 30f64.to_radians(),
                sigma_rad: sigma_px[i] / camera.fx,
                power: power[i],
            }
        });
        Ok(Self { calibration, beams })
    }

    /// Plane `p . X = 1` of laser `index` (0 to 3), 1/mm.
    #[must_use]
    pub fn plane(&self, index: usize) -> Vector3<f64> {
        self.calibration.laser(LaserId::ALL[index]).per_mm
    }

    /// The contents of `calibration.json`.
    #[must_use]
    pub fn calibration_json(&self) -> Value {
        let camera = self.calibration.camera();
        let planes: Vec<[f64; 4]> = (0..4)
            .map(|i| {
                let p = self.plane(i);
                [p.x, p.y, p.z, -1.0]
            })
            .collect();
        let mut value = json!({
            "format": "boxline-calibration/1",
            "serial": self.calibration.serial(),
            "image_size": SENSOR_PX,
            "camera": {"fx": camera.fx, "fy": camera.fy, "skew": camera.skew, "cx": camera.cx, "cy": camera.cy,
                       "k1": camera.k1, "k2": camera.k2},
            "laser_planes": planes,
        });
        if !camera.has_paper_lens() {
            for (key, term) in [("p1", camera.p1), ("p2", camera.p2), ("k3", camera.k3)] {
                value["camera"][key] = json!(term);
            }
        }
        value
    }
}
