//! `calibration.json`, format `boxline-calibration/1`. Optional keys: `covariance`, 18 x 18, of fx, fy, cx, cy, k1, k2 and the
//! four planes as `p . X = 1`, p = -(a, b, c) / d in 1/mm; `residuals` and `provenance`, which `boxline calibrate` writes for
//! people and nothing reads.

use super::field::{Field, parse};
use super::file;
use boxline::calib::CalibrationCovariance;
use boxline::{Calibration, CameraModel, Error, ErrorKind, LaserId};
use serde_json::{Value, json};
use std::path::Path;

const FORMAT: &str = "boxline-calibration/1";

/// Reads a calibration from bytes; `name` (a file, a device) goes into the errors.
///
/// # Errors
/// [`ErrorKind::InvalidCalibration`], naming `name` and the field.
pub fn parse_calibration(bytes: &[u8], name: &str) -> Result<Calibration, Error> {
    let value = parse(bytes, name, ErrorKind::InvalidCalibration)?;
    let root = Field::root(&value, name, ErrorKind::InvalidCalibration);
    root.check_format(FORMAT)?;
    let camera = root.get("camera")?;
    let number = |key: &str| camera.get(key)?.number();
    let camera = CameraModel {
        fx: number("fx")?,
        fy: number("fy")?,
        skew: number("skew")?,
        cx: number("cx")?,
        cy: number("cy")?,
        k1: number("k1")?,
        k2: number("k2")?,
    };
    let serial = root.get("serial")?.text()?;
    let image_size_px = root.get("image_size")?.array(Field::count)?;
    let laser_planes = root.get("laser_planes")?.array(Field::numbers)?;
    let calibration =
        Calibration::new(serial, image_size_px, camera, laser_planes).map_err(|e| e.in_context(name))?;
    let Some(covariance) = root.optional("covariance")? else { return Ok(calibration) };
    let rows: [[f64; 18]; 18] = covariance.array(Field::numbers)?;
    calibration
        .with_covariance(CalibrationCovariance::from_fn(|i, j| rows[i][j]))
        .map_err(|e| e.in_context(name))
}

/// Reads a calibration file.
///
/// # Errors
/// As [`parse_calibration`]; [`ErrorKind::Io`] if it cannot be read.
pub fn read_calibration(path: &Path) -> Result<Calibration, Error> {
    parse_calibration(&file::read(path)?, &path.display().to_string())
}

/// A calibration as JSON. Reading it again gives the same calibration to the last bit. Laser planes are scaled to d = -1.
#[must_use]
pub fn calibration_json(calibration: &Calibration) -> Value {
    let c = calibration.camera();
    let plane = |id: LaserId| {
        let p = calibration.laser(id).per_mm;
        json!([p.x, p.y, p.z, -1.0])
    };
    let mut value = json!({
        "format": FORMAT,
        "serial": calibration.serial(),
        "image_size": [calibration.width_px(), calibration.height_px()],
        "camera": {"fx": c.fx, "fy": c.fy, "skew": c.skew, "cx": c.cx, "cy": c.cy, "k1": c.k1, "k2": c.k2},
        "laser_planes": LaserId::ALL.map(plane),
    });
    if let Some(covariance) = calibration.covariance() {
        let row = |i: usize| covariance.row(i).iter().copied().collect::<Vec<f64>>();
        value["covariance"] = json!((0..18).map(row).collect::<Vec<_>>());
    }
    value
}
