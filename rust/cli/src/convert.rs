//! `boxline convert`: the camera of a calibration to and from OpenCV's model, in OpenCV's own JSON
//! (`cv2.FileStorage("camera.json", ...)`: nodes camera_matrix, distortion_coefficients, image_width, image_height). Its YAML
//! starts with a line and has tags that parsers of YAML 1.2 refuse, and `FileStorage` reads and writes JSON by the file's
//! name: so JSON only.

use crate::Finished;
use crate::output::check_outputs;
use boxline::{Calibration, CameraModel, Error, ErrorKind};
use boxline_calib::opencv::{OpenCvCamera, RefitResidual, from_opencv, to_opencv};
use boxline_proto::json::{
    calibration_json, open_plain_file, parse_json, read_calibration, read_camera, write_json,
};
use clap::{Args as ClapArgs, ValueEnum};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

#[derive(ClapArgs)]
pub struct ConvertArgs {
    /// The calibration (or the camera of `calibrate --camera-only`) whose camera is written; with --from, the calibration
    /// whose head and laser planes are kept
    #[arg(value_name = "CALIBRATION.json")]
    pub calibration: PathBuf,
    /// Write the camera in this model; this or --from is needed
    #[arg(long, value_enum, required_unless_present = "from", conflicts_with = "from")]
    pub to: Option<Model>,
    /// Take the camera from a file in this model, given by --camera
    #[arg(long, value_enum, requires = "camera")]
    pub from: Option<Model>,
    /// The other program's camera
    #[arg(long, value_name = "FILE", requires = "from", conflicts_with = "to")]
    pub camera: Option<PathBuf>,
    /// Where to write
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum Model {
    Opencv,
}

/// More than this is another lens: a pixel at the sensor's corner is 0.4 mm on a face at 1 m.
const MOST_LEFT_PX: f64 = 1.0;
/// What is told of a covariance that is not written.
const DROPPED: &str = "the calibration's covariance is of its old camera: the written file has none";
/// Files of a camera have a few hundred bytes.
const MAX_BYTES: u64 = 1 << 20;

/// Runs `boxline convert`.
pub fn convert(args: &ConvertArgs) -> anyhow::Result<Finished> {
    check_outputs(
        &[&args.output],
        [Some(&args.calibration), args.camera.as_ref()].into_iter().flatten().map(PathBuf::as_path),
    )?;
    let Converted { value, residual, dropped } = match (&args.from, &args.camera) {
        (Some(Model::Opencv), Some(camera)) => taken_from_opencv(&args.calibration, camera)?,
        _ => as_opencv(&args.calibration)?,
    };
    let RefitResidual { rms_px, max_px } = residual;
    if max_px > MOST_LEFT_PX {
        let from = args.camera.as_ref().unwrap_or(&args.calibration);
        let text = format!(
            "the other model cannot have this lens: {rms_px:.3} px rms and {max_px:.3} px at most would be left, at most {MOST_LEFT_PX} px is allowed"
        );
        return Err(Error::new(ErrorKind::InvalidCalibration, text).in_context(from.display()).into());
    }
    write_json(&args.output, &value)?;
    let warnings: Vec<&str> = dropped.then_some(DROPPED).into_iter().collect();
    let stdout = if args.json {
        json!({"outcome": "converted", "rms_px": rms_px, "max_px": max_px, "warnings": warnings}).to_string()
    } else {
        let written = format!(
            "written {}: refitted over the sensor, {rms_px:.4} px rms and {max_px:.4} px at most are left",
            args.output.display()
        );
        let warnings = warnings.iter().map(|warning| format!("\nwarning {warning}"));
        format!("{written}{}", warnings.collect::<String>())
    };
    Ok(Finished { stdout, exit_code: 0 })
}

/// What is written.
struct Converted {
    value: Value,
    residual: RefitResidual,
    /// There was a covariance, of the camera that is replaced.
    dropped: bool,
}

/// A calibration with the camera of a file of OpenCV's.
fn taken_from_opencv(calibration: &Path, camera: &Path) -> anyhow::Result<Converted> {
    let calibration = read_calibration(calibration)?;
    let (width, height) = (calibration.width_px(), calibration.height_px());
    let opencv = read_opencv(camera, width, height)?;
    // What is wrong with focal lengths or centre is not to be called the distortion's.
    let OpenCvCamera { fx, fy, cx, cy, .. } = opencv;
    let without_lens = CameraModel { fx, fy, cx, cy, ..CameraModel::PINHOLE };
    without_lens
        .check_on_sensor([width, height])
        .map_err(|e| invalid(e.to_string()).in_context(camera.display()))?;
    let (model, residual) = from_opencv(&opencv, width, height).ok_or_else(|| {
        invalid("the distortion has no inverse over the sensor").in_context(camera.display())
    })?;
    let planes = calibration.lasers().map(|plane| [plane.per_mm.x, plane.per_mm.y, plane.per_mm.z, -1.0]);
    let taken = Calibration::new(calibration.serial(), [width, height], model, planes)?;
    let dropped = calibration.covariance().is_some();
    Ok(Converted { value: calibration_json(&taken), residual, dropped })
}

/// The camera of a calibration, or of its own file, in OpenCV's model.
fn as_opencv(file: &Path) -> anyhow::Result<Converted> {
    let (camera, [width, height]) = read_camera(file)?;
    let named = |text: String| Error::new(ErrorKind::InvalidCalibration, text).in_context(file.display());
    if camera.skew != 0.0 {
        let skew = camera.skew;
        return Err(named(format!(
            "camera.skew is {skew} px: OpenCV's model has no skew, only 0 can be written"
        ))
        .into());
    }
    let (opencv, residual) =
        to_opencv(&camera, width, height).ok_or_else(|| named("the distortion has no inverse".into()))?;
    Ok(Converted { value: opencv_json(&opencv, width, height), residual, dropped: false })
}

fn matrix(rows: usize, cols: usize, data: &[f64]) -> Value {
    json!({"type_id": "opencv-matrix", "rows": rows, "cols": cols, "dt": "d", "data": data})
}

fn opencv_json(c: &OpenCvCamera, width: u32, height: u32) -> Value {
    json!({
        "image_width": width,
        "image_height": height,
        "camera_matrix": matrix(3, 3, &[c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0]),
        "distortion_coefficients": matrix(1, 5, &c.distortion),
    })
}

fn invalid(text: impl Into<String>) -> Error {
    Error::new(ErrorKind::InvalidFile, text)
}

fn read_opencv(path: &Path, width: u32, height: u32) -> Result<OpenCvCamera, Error> {
    use std::io::Read;
    let name = path.display().to_string();
    let io =
        |e: std::io::Error| Error::new(ErrorKind::Io, format!("{name}: cannot read: {e}")).with_source(e);
    let mut bytes = Vec::new();
    open_plain_file(path).map_err(io)?.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(io)?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(invalid(format!("{name}: larger than {MAX_BYTES} bytes, the most that is allowed")));
    }
    let value = parse_json(&bytes, &name, ErrorKind::InvalidFile)?;
    camera_of(&value, width, height).map_err(|e| e.in_context(&name))
}

fn camera_of(value: &Value, width: u32, height: u32) -> Result<OpenCvCamera, Error> {
    // The fisheye model has four coefficients of another formula, which look like ours. OpenCV's file does not tell, others do.
    for key in ["distortion_model", "camera_model", "model"] {
        let model = value[key].as_str().unwrap_or_default();
        if ["fisheye", "equidistant"].iter().any(|name| model.to_ascii_lowercase().contains(name)) {
            return Err(invalid(format!(
                "{key} is {model:?}: only lenses with k1, k2, p1, p2, k3 are understood"
            )));
        }
    }
    for (key, needed) in [("image_width", width), ("image_height", height)] {
        // Without it, it is the calibration's. Anything else that is no such number is another file than it seems to be.
        if let Some(found) = value.get(key).filter(|found| found.as_u64() != Some(u64::from(needed))) {
            return Err(invalid(format!("{key} is {found}, the calibration has {needed}")));
        }
    }
    let numbers = |key: &str| -> Result<Vec<f64>, Error> {
        let data =
            value[key]["data"].as_array().ok_or_else(|| invalid(format!("{key}.data: a list is needed")))?;
        let read = |x: &Value| x.as_f64().filter(|x| x.is_finite());
        data.iter()
            .map(read)
            .collect::<Option<_>>()
            .ok_or_else(|| invalid(format!("{key}.data: finite numbers are needed")))
    };
    let k = numbers("camera_matrix")?;
    let Ok([fx, skew, cx, below, fy, cy, last @ ..]) = <[f64; 9]>::try_from(&k[..]) else {
        return Err(invalid(format!("camera_matrix.data has {} numbers, 9 are needed", k.len())));
    };
    if below != 0.0 || last != [0.0, 0.0, 1.0] {
        return Err(invalid(format!(
            "camera_matrix.data has {below} in row 2, column 1 and {last:?} as its last row, 0 and [0, 0, 1] are needed"
        )));
    }
    if fx <= 0.0 || fy <= 0.0 {
        return Err(invalid(format!(
            "camera_matrix: focal lengths {fx} and {fy} px, positive ones are needed"
        )));
    }
    if skew != 0.0 {
        return Err(invalid(format!("camera_matrix: skew {skew} px, OpenCV's model has none: 0 is needed")));
    }
    let mut d = numbers("distortion_coefficients")?;
    if ![4, 5].contains(&d.len()) {
        return Err(invalid(format!(
            "distortion_coefficients.data has {} numbers, 4 or 5 are understood",
            d.len()
        )));
    }
    d.resize(5, 0.0);
    Ok(OpenCvCamera { fx, fy, cx, cy, distortion: [d[0], d[1], d[2], d[3], d[4]] })
}
