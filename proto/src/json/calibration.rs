//! `calibration.json`, format `boxline-calibration/1`. Optional keys: `camera.p1`, `camera.p2`, `camera.k3`, 0 if they are not there;
//! `covariance`, of fx, fy, cx, cy, k1, k2 and the four planes as `p . X = 1`, p = -(a, b, c) / d in 1/mm, 18 x 18, or with p1, p2, k3
//! after them 21 x 21; `residuals` and `provenance`, which `boxline calibrate` writes for people and nothing reads.

use super::file;
use super::syntax::{Object, field_error, parse_json, read, text};
use boxline::calibration::{CalibrationCovariance, PAPER_PARAMETERS, PARAMETERS};
use boxline::{Calibration, CameraModel, Error, ErrorKind, LaserId};
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::Path;

const FORMAT: &str = "boxline-calibration/1";
/// A camera alone, as `boxline calibrate --camera-only` writes it: `image_size` and `camera` of a calibration.
pub const CAMERA_FORMAT: &str = "boxline-camera/1";

#[derive(Deserialize)]
struct File {
    #[serde(deserialize_with = "text")]
    serial: String,
    image_size: [u32; 2],
    camera: Object<Camera>,
    laser_planes: [[f64; 4]; 4],
    covariance: Option<Vec<Vec<f64>>>,
}

#[derive(Deserialize)]
struct CameraFile {
    image_size: [u32; 2],
    camera: Object<Camera>,
}

#[derive(Deserialize)]
struct Camera {
    fx: f64,
    fy: f64,
    skew: f64,
    cx: f64,
    cy: f64,
    k1: f64,
    k2: f64,
    p1: Option<f64>,
    p2: Option<f64>,
    k3: Option<f64>,
}

impl Camera {
    fn model(self) -> CameraModel {
        let Self { fx, fy, skew, cx, cy, k1, k2, p1, p2, k3 } = self;
        let [p1, p2, k3] = [p1, p2, k3].map(Option::unwrap_or_default);
        CameraModel { fx, fy, skew, cx, cy, k1, k2, p1, p2, k3 }
    }
}

/// Reads a calibration from bytes; `name` (a file, a device) goes into the errors.
///
/// # Errors
/// [`ErrorKind::InvalidCalibration`], naming `name` and the field.
pub fn parse_calibration(bytes: &[u8], name: &str) -> Result<Calibration, Error> {
    let kind = ErrorKind::InvalidCalibration;
    let File { serial, image_size, camera: Object(camera), laser_planes, covariance } =
        read(bytes, name, kind, Some(FORMAT))?;
    let calibration = Calibration::new(&serial, image_size, camera.model(), laser_planes)
        .map_err(|e| e.in_context(name))?;
    let Some(rows) = covariance else { return Ok(calibration) };
    let needed = |path: &str, found: usize, needed: &str| {
        field_error(kind, name, path, format_args!("found a list of {found}, a list of {needed} is needed"))
    };
    let size = rows.len();
    if ![PAPER_PARAMETERS, PARAMETERS].contains(&size) {
        return Err(needed("covariance", size, "18 or 21"));
    }
    let mut values = CalibrationCovariance::zeros();
    for (i, row) in rows.iter().enumerate() {
        if row.len() != size {
            return Err(needed(&format!("covariance[{i}]"), row.len(), &size.to_string()));
        }
        for (j, value) in row.iter().enumerate() {
            values[(i, j)] = *value;
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

/// Reads the camera of a calibration file or of a camera's own, and the image's width and height in px.
///
/// # Errors
/// As [`read_calibration`].
pub fn read_camera(path: &Path) -> Result<(CameraModel, [u32; 2]), Error> {
    let (bytes, name, kind) = (file::read(path)?, path.display().to_string(), ErrorKind::InvalidCalibration);
    if parse_json(&bytes, &name, kind)?["format"] != CAMERA_FORMAT {
        let calibration = parse_calibration(&bytes, &name)?;
        return Ok((*calibration.camera(), [calibration.width_px(), calibration.height_px()]));
    }
    let CameraFile { image_size, camera: Object(camera) } = read(&bytes, &name, kind, Some(CAMERA_FORMAT))?;
    let camera = camera.model();
    camera.check_on_sensor(image_size).map_err(|e| e.in_context(&name))?;
    Ok((camera, image_size))
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
