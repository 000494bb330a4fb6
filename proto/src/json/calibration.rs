//! `calibration.json`, format `boxline-calibration/1`. Optional keys: `camera.p1`, `camera.p2`, `camera.k3`, 0 if they are not there;
//! `covariance`, of fx, fy, cx, cy, k1, k2 and the four planes as `p . X = 1`, p = -(a, b, c) / d in 1/mm, 18 x 18, or with p1, p2, k3
//! after them 21 x 21; `residuals` and `provenance`, which `boxline calibrate` writes for people and nothing reads.

use super::field::Field;
use super::file;
use super::syntax::parse_json;
use boxline::calib::{CalibrationCovariance, PAPER_PARAMETERS, PARAMETERS};
use boxline::{Calibration, CameraModel, Error, ErrorKind, LaserId};
use serde_json::{Value, json};
use std::path::Path;

const FORMAT: &str = "boxline-calibration/1";

/// Reads a calibration from bytes; `name` (a file, a device) goes into the errors.
///
/// # Errors
/// [`ErrorKind::InvalidCalibration`], naming `name` and the field.
pub fn parse_calibration(bytes: &[u8], name: &str) -> Result<Calibration, Error> {
    let value = parse_json(bytes, name, ErrorKind::InvalidCalibration)?;
    let root = Field::root(&value, name, ErrorKind::InvalidCalibration);
    root.check_format(FORMAT)?;
    let camera = root.get("camera")?;
    let number = |key: &str| camera.get(key)?.number();
    let term = |key: &str| camera.optional(key)?.map_or(Ok(0.0), |field| field.number());
    let camera = CameraModel {
        fx: number("fx")?,
        fy: number("fy")?,
        skew: number("skew")?,
        cx: number("cx")?,
        cy: number("cy")?,
        k1: number("k1")?,
        k2: number("k2")?,
        p1: term("p1")?,
        p2: term("p2")?,
        k3: term("k3")?,
    };
    let serial = root.get("serial")?.text()?;
    let image_size_px = root.get("image_size")?.array(Field::count)?;
    let laser_planes = root.get("laser_planes")?.array(Field::numbers)?;
    let calibration =
        Calibration::new(serial, image_size_px, camera, laser_planes).map_err(|e| e.in_context(name))?;
    let Some(covariance) = root.optional("covariance")? else { return Ok(calibration) };
    let rows = covariance.list()?;
    let size = if rows.len() == PAPER_PARAMETERS { PAPER_PARAMETERS } else { PARAMETERS };
    let mut values = CalibrationCovariance::zeros();
    if rows.len() != size {
        return Err(covariance.wrong("a list of 18 or 21"));
    }
    for (i, row) in rows.iter().enumerate() {
        let row = row.list()?;
        if row.len() != size {
            return Err(rows[i].wrong(&format!("a list of {size}")));
        }
        for (j, value) in row.iter().enumerate() {
            values[(i, j)] = value.number()?;
        }
    }
    calibration.with_covariance(values).map_err(|e| e.in_context(name))
}

/// Reads a calibration file.
///
/// # Errors
/// As [`parse_calibration`]; [`ErrorKind::Io`] if it cannot be read.
pub fn read_calibration(path: &Path) -> Result<Calibration, Error> {
    parse_calibration(&file::read(path)?, &path.display().to_string())
}

/// A camera as JSON, as in a calibration; p1, p2 and k3 only if the lens has them.
#[must_use]
pub fn camera_json(c: &CameraModel) -> Value {
    let mut value =
        json!({"fx": c.fx, "fy": c.fy, "skew": c.skew, "cx": c.cx, "cy": c.cy, "k1": c.k1, "k2": c.k2});
    if !c.has_paper_lens() {
        for (key, term) in [("p1", c.p1), ("p2", c.p2), ("k3", c.k3)] {
            value[key] = json!(term);
        }
    }
    value
}

/// How many rows of a covariance say something: those of p1, p2 and k3 only if the lens has them.
pub(crate) fn covariance_size(covariance: &CalibrationCovariance) -> usize {
    let more = (PAPER_PARAMETERS..PARAMETERS).any(|i| covariance[(i, i)] > 0.0);
    if more { PARAMETERS } else { PAPER_PARAMETERS }
}

/// A calibration as JSON. Reading it again gives the same calibration to the last bit. Laser planes are scaled to d = -1.
#[must_use]
pub fn calibration_json(calibration: &Calibration) -> Value {
    let plane = |id: LaserId| {
        let p = calibration.laser(id).per_mm;
        json!([p.x, p.y, p.z, -1.0])
    };
    let mut value = json!({
        "format": FORMAT,
        "serial": calibration.serial(),
        "image_size": [calibration.width_px(), calibration.height_px()],
        "camera": camera_json(calibration.camera()),
        "laser_planes": LaserId::ALL.map(plane),
    });
    if let Some(covariance) = calibration.covariance() {
        let size = covariance_size(covariance);
        let row = |i: usize| covariance.row(i).iter().take(size).copied().collect::<Vec<f64>>();
        value["covariance"] = json!((0..size).map(row).collect::<Vec<_>>());
    }
    value
}
