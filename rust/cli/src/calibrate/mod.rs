//! `boxline calibrate`: a folder of board frames in, the head's calibration and a report out.

mod input;
mod live;
mod plots;
mod provenance;
mod report;

use crate::Finished;
use crate::head::DeviceChoice;
use crate::input::{Usage, read_frame};
use crate::output::{check_outputs, write_whole};
use anyhow::Context;
use boxline::calibration::{CalibrationCovariance, PAPER_PARAMETERS};
use boxline::{Calibration, CameraModel, Frame, LaserId};
use boxline_calib::uncertainty::{side_sigma_mm, usual_distance_mm};
use boxline_calib::{
    Advice, BoardStripe, CalibrationReject, CalibrationSettings, CalibrationSolution, CameraSolution,
    FrameReject, LensChoice, LensTerms, LensTrial, MIN_FRAMES, Misfit, empty_corners, find_board, next_frame,
    solve_all, solve_camera,
};
use boxline_proto::json::{CAMERA_FORMAT, calibration_json, camera_json, write_json};
use clap::builder::NonEmptyStringValueParser;
use clap::{Args as ClapArgs, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use input::{BoardFrame, BoardSpec, Input, parse_board_spec};
use rayon::prelude::*; // frames are independent; scoped threads would need a queue of our own
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::Instant;

pub use plots::COLOURS;

const SOLVED: u8 = 0;
const REFUSED: u8 = 3;
/// Sides whose standard deviation is told, mm.
pub const SIDES_MM: [f64; 4] = [150.0, 600.0, 1200.0, 1800.0];

#[derive(ClapArgs)]
pub struct CalibrateArgs {
    /// Folder with frames of a board, lasers on: a recording, or any JPEGs
    #[arg(value_name = "FOLDER", required_unless_present = "live")]
    pub folder: Option<PathBuf>,
    /// Take the frames with a head: each pose of the board that is new and held still, until no pose is missing; Ctrl-C ends it
    /// earlier. Lasers blink when a frame is taken
    #[arg(long, conflicts_with = "folder", requires = "board")]
    pub live: bool,
    #[command(flatten)]
    pub choice: DeviceChoice,
    /// Where a live session keeps its frames; those that are there count, so it can go on, or be calibrated again as FOLDER
    #[arg(long, value_name = "FOLDER", requires = "live")]
    pub keep: Option<PathBuf>,
    /// End a live session at so many frames, whatever is missing
    #[arg(long, value_name = "NUMBER", requires = "live", value_parser = clap::value_parser!(u16).range(6..=500))]
    pub frames: Option<u16>,
    /// Where to write the calibration
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Write a report with pictures (one HTML file)
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// The board, if it is not board.json of the folder: columns, rows, pitch and diameter in mm (7x7:37.5:18.75), or a file
    #[arg(long, value_name = "GRID|FILE", value_parser = parse_board_spec)]
    pub board: Option<BoardSpec>,
    /// Serial number of the head, if it is not the recording's or the folder's name
    #[arg(long, value_name = "TEXT", value_parser = NonEmptyStringValueParser::new())]
    pub serial: Option<String>,
    /// The camera alone, from frames without lasers (format boxline-camera/1, which `boxline convert` reads)
    #[arg(long, conflicts_with = "report")]
    pub camera_only: bool,
    /// Terms of the lens: those that frames left out of the fit call a hundred times likelier, the paper's k1 and k2, or
    /// also p1, p2 and k3 (Brown)
    #[arg(long, value_enum, default_value_t = Lens::ByData)]
    pub lens: Lens,
    /// Estimate the skew too
    #[arg(long)]
    pub skew: bool,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// As [`LensChoice`].
#[derive(Clone, Copy, ValueEnum)]
pub enum Lens {
    ByData,
    Paper,
    Brown,
}

impl From<Lens> for LensChoice {
    fn from(lens: Lens) -> Self {
        match lens {
            Lens::ByData => Self::ByData,
            Lens::Paper => Self::Paper,
            Lens::Brown => Self::Brown,
        }
    }
}

/// Everything that is told about a solved set.
pub struct Solved {
    pub serial: String,
    /// All board frames of the recording, and why those are left out that are.
    pub names: Vec<String>,
    pub left_out: Vec<(String, FrameReject)>,
    /// Index into `names` of every view that was solved with.
    pub views: Vec<usize>,
    pub solution: CalibrationSolution,
    pub size_px: [usize; 2],
    pub side_sigmas_mm: [Option<f64>; 4],
    pub advice: Option<Advice>,
    pub seconds: f64,
}

/// Runs `boxline calibrate`.
pub fn calibrate(args: &CalibrateArgs) -> anyhow::Result<Finished> {
    // Told now, not after minutes of work.
    check_outputs(&outputs(args), [])?;
    match &args.folder {
        Some(folder) => solve(args, Input::read(folder, args)?),
        None => live(args),
    }
}

fn outputs(args: &CalibrateArgs) -> Vec<&Path> {
    [Some(&args.output), args.report.as_ref()].into_iter().flatten().map(PathBuf::as_path).collect()
}

/// Takes frames with a head, then solves with them.
fn live(args: &CalibrateArgs) -> anyhow::Result<Finished> {
    if let Some(folder) = args.keep.as_ref().filter(|folder| folder.join("recording.json").exists()) {
        let text = format!("{}: is a recording, to which nothing is added", folder.display());
        return Err(Usage(text).into());
    }
    let board = input::read_board_of(args, Path::new("."), &mut Vec::new())?;
    let taken = live::take(args, &board)?;
    if taken.count == 0 {
        return Ok(refused(args, &[], &CalibrationReject::TooFewFrames { usable: 0, needed: MIN_FRAMES }));
    }
    let mut input = Input::read(&taken.folder, args)?;
    if args.serial.is_none() {
        input.serial = taken.serial;
    }
    let finished = solve(args, input);
    drop(taken.temporary); // read for the last time
    finished
}

fn solve(args: &CalibrateArgs, input: Input) -> anyhow::Result<Finished> {
    let start = Instant::now();
    check_outputs(&outputs(args), input.all_files())?;
    let mut left_out = Vec::new();
    let names: Vec<String> = input.frames.iter().map(|f| f.id.clone()).collect();
    let camera = match solve_circles(&input, args, &mut left_out) {
        Ok(found) if args.camera_only => return camera_alone(args, &input, &left_out, found),
        other => other,
    };
    match camera.and_then(|circles| solve_stripes(&input, circles)) {
        Ok((views, solution, size_px)) => {
            let sigma = |side: f64| {
                let (camera, lasers) = (&solution.camera, &solution.lasers);
                side_sigma_mm(camera, lasers, &solution.covariance, side, usual_distance_mm(side))
            };
            let solved = Solved {
                serial: input.serial.clone(),
                names,
                left_out,
                views,
                side_sigmas_mm: SIDES_MM.map(sigma),
                advice: next_frame(&solution),
                solution,
                size_px,
                seconds: start.elapsed().as_secs_f64(),
            };
            let mut value = calibration_value(&solved)?;
            let used: Vec<&str> =
                solved.solution.frames.iter().map(|f| solved.names[solved.views[f.view]].as_str()).collect();
            value["provenance"] = provenance::value(&input, &used)?;
            write_json(&args.output, &value)?;
            if let Some(path) = &args.report {
                write_whole(path, report::html(&solved)?.as_bytes())?;
            }
            let stdout =
                if args.json { outcome_json(&solved, &value).to_string() } else { text(&solved, args) };
            Ok(Finished { stdout, exit_code: SOLVED })
        }
        Err(reject) => Ok(refused(args, &left_out, &reject)),
    }
}

fn refused(args: &CalibrateArgs, left_out: &[(String, FrameReject)], reject: &CalibrationReject) -> Finished {
    let stdout = if args.json {
        let left_out: Vec<Value> = left_out.iter().map(left_out_json).collect();
        let reason = json!({"reason": reject.reason(), "text": reject.to_string()});
        json!({"outcome": "rejected", "reject": reason, "left_out": left_out}).to_string()
    } else {
        let lines = left_out.iter().map(|(name, why)| format!("left out   {name}: {why}\n"));
        format!("{}not calibrated: {reject}", lines.collect::<String>())
    };
    Finished { stdout, exit_code: REFUSED }
}

/// Writes the camera alone.
fn camera_alone(
    args: &CalibrateArgs,
    input: &Input,
    left_out: &[(String, FrameReject)],
    circles: Circles,
) -> anyhow::Result<Finished> {
    let Circles { indices, camera, size_px } = circles;
    let camera = match camera.alone() {
        Ok(camera) => camera,
        Err(reject) => return Ok(refused(args, left_out, &reject)),
    };
    let used: Vec<&str> = camera.views.iter().map(|view| input.frames[indices[*view]].id.as_str()).collect();
    let rows = camera_rows(&camera.camera, camera.lens, &camera.covariance, camera.skew_sigma_px);
    let mut value = json!({
        "format": CAMERA_FORMAT,
        "image_size": size_px,
        "camera": camera_json(&camera.camera),
        "sigmas": rows.iter().map(|(name, _, sigma)| ((*name).to_owned(), json!(sigma))).collect::<serde_json::Map<_, _>>(),
        "residuals": {
            "circles_rms_px": camera.centre_rms_px,
            "frames": used.len(),
            "lens": lens_json(camera.lens, &camera.lens_trials),
        },
    });
    value["provenance"] = provenance::value(input, &used)?;
    write_json(&args.output, &value)?;
    let misfits: Vec<String> = camera.misfits.iter().map(ToString::to_string).collect();
    let stdout = if args.json {
        json!({
            "outcome": "calibrated",
            "camera": value,
            "left_out": left_out.iter().map(left_out_json).collect::<Vec<_>>(),
            "warnings": misfits,
            "misfits": camera.misfits.iter().map(misfit_json).collect::<Vec<_>>(),
        })
        .to_string()
    } else {
        let [u, v] = camera.centre_rms_px;
        let mut lines = vec![format!("{} frames of {}", used.len(), input.frames.len())];
        lines.extend(left_out.iter().map(|(name, why)| format!("left out   {name}: {why}")));
        lines.extend(row_lines(&rows));
        lines.push(format!("lens       {}", lens_text(camera.lens, &camera.lens_trials)));
        lines.push(format!("circles    {u:.3}, {v:.3} px rms (u, v)"));
        lines.extend(misfits.iter().map(|misfit| format!("warning    {misfit}")));
        lines.push(format!("written    {}", args.output.display()));
        lines.push("(± is one standard deviation)".to_owned());
        lines.join("\n")
    };
    Ok(Finished { stdout, exit_code: SOLVED })
}

type Found = (Vec<usize>, CalibrationSolution, [usize; 2]);

/// The camera from the circles of those frames that show the board.
struct Circles {
    /// Index of the frame of each view.
    indices: Vec<usize>,
    camera: CameraSolution,
    size_px: [usize; 2],
}

fn load(frame: &BoardFrame) -> Result<Frame, FrameReject> {
    read_frame(&frame.file).map_err(|e| FrameReject::Unreadable { text: e.to_string() })
}

fn solve_circles(
    input: &Input,
    args: &CalibrateArgs,
    left_out: &mut Vec<(String, FrameReject)>,
) -> Result<Circles, CalibrationReject> {
    let (frames, board) = (&input.frames, &input.board);
    let bar = progress(frames.len() as u64, "circles");
    let found: Vec<_> = (0..frames.len())
        .into_par_iter()
        .map(|i| {
            let frame = load(&frames[i])?;
            let size = [frame.width_px(), frame.height_px()];
            let view = find_board(&frame, board);
            bar.inc(1);
            Ok((size, view))
        })
        .collect();
    bar.finish_and_clear();
    // The size of most frames is the head's; of as many, the larger.
    let sizes: Vec<[usize; 2]> =
        found.iter().filter_map(|f| f.as_ref().ok().map(|(size, _)| *size)).collect();
    let count = |size: &[usize; 2]| sizes.iter().filter(|s| *s == size).count();
    let size_px = sizes.iter().copied().max_by_key(|size| (count(size), *size)).unwrap_or_default();
    let (mut views, mut indices) = (Vec::new(), Vec::new());
    for (i, found) in found.into_iter().enumerate() {
        let view = found.and_then(|(size, view)| {
            if size == size_px { view } else { Err(FrameReject::OtherSize { found: size, needed: size_px }) }
        });
        match view {
            Ok(view) => {
                views.push(view);
                indices.push(i);
            }
            Err(why) => left_out.push((frames[i].id.clone(), why)),
        }
    }
    let solved = solve_camera(views, board, CalibrationSettings { skew: args.skew, lens: args.lens.into() });
    let reject_of = |view: usize| match &solved {
        Ok(camera) => camera.reject(view),
        Err(refusal) => refusal.rejects.get(view)?.as_ref(),
    };
    for (view, i) in indices.iter().enumerate() {
        left_out.extend(reject_of(view).map(|why| (frames[*i].id.clone(), why.clone())));
    }
    let camera = solved?;
    Ok(Circles { indices, camera, size_px })
}

/// Camera and lasers from the stripes on those boards.
fn solve_stripes(input: &Input, circles: Circles) -> Result<Found, CalibrationReject> {
    let Circles { indices, camera, size_px } = circles;
    let bar = progress(indices.len() as u64, "stripes");
    // Frames are decoded twice: 40 ms each, against 15 MB each to keep them.
    let stripes: Vec<Vec<BoardStripe>> = (0..indices.len())
        .into_par_iter()
        .map(|view| {
            bar.inc(1);
            if camera.reject(view).is_some() {
                return Vec::new();
            }
            load(&input.frames[indices[view]])
                .map_or_else(|_unreadable| Vec::new(), |frame| camera.find_stripes(view, &frame))
        })
        .collect();
    bar.finish_and_clear();
    let solution = solve_all(camera, &stripes)?;
    Ok((indices, solution, size_px))
}

/// On a terminal only; indicatif hides it elsewhere.
fn progress(length: u64, what: &'static str) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg:8} {bar:40} {pos}/{len}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(length).with_style(style).with_message(what)
}

fn calibration_value(solved: &Solved) -> anyhow::Result<Value> {
    let s = &solved.solution;
    let planes = s.lasers.map(|plane| [plane.per_mm.x, plane.per_mm.y, plane.per_mm.z, -1.0]);
    let size = solved.size_px.map(|n| u32::try_from(n).unwrap_or(u32::MAX));
    let calibration = Calibration::new(solved.serial.clone(), size, s.camera, planes)
        .and_then(|c| c.with_covariance(s.covariance))
        .context("the solution is no head's calibration")?;
    let mut value = calibration_json(&calibration);
    value["residuals"] = json!({
        "circles_rms_px": s.centre_rms_px,
        "stripes_rms_px": s.stripe_rms_px,
        "skew_sigma_px": s.skew_sigma_px,
        "frames": s.frames.len(),
        "circles": s.frames.iter().map(|f| f.centres.len()).sum::<usize>(),
        "stripe_points": s.frames.iter().map(|f| f.stripes.len()).sum::<usize>(),
        "lens": lens_json(s.lens, &s.lens_trials),
        "side_sigma_mm": SIDES_MM.iter().zip(solved.side_sigmas_mm).map(|(side, sigma)| {
            json!({"side_mm": side, "distance_mm": usual_distance_mm(*side), "sigma_mm": sigma})
        }).collect::<Vec<_>>(),
    });
    Ok(value)
}

fn misfit_json(misfit: &Misfit) -> Value {
    json!({
        "kind": misfit.kind.name(),
        "size": misfit.size,
        "circles_rms_px": misfit.rms_px,
        "single_circles_px": misfit.single_px,
        "chi_square": misfit.chi_square,
        "limit": misfit.limit,
        "text": misfit.to_string(),
    })
}

fn left_out_json((name, why): &(String, FrameReject)) -> Value {
    json!({"frame": name, "why": why.to_string()})
}

fn outcome_json(solved: &Solved, calibration: &Value) -> Value {
    json!({
        "outcome": "calibrated",
        "calibration": calibration,
        "left_out": solved.left_out.iter().map(left_out_json).collect::<Vec<_>>(),
        "warnings": warnings(solved),
        "misfits": solved.solution.misfits.iter().map(misfit_json).collect::<Vec<_>>(),
        "next_frame": solved.advice.as_ref().map(advice_text),
        "seconds": solved.seconds,
    })
}

/// What a user should know who relies on a solved calibration.
pub fn warnings(solved: &Solved) -> Vec<String> {
    let misfits = solved.solution.misfits.iter().map(ToString::to_string);
    let corners = empty_corners(&solved.solution).into_iter().map(|corner| {
        format!("no circle near the {corner} corner of the picture: the distortion there is extrapolated")
    });
    misfits.chain(corners).collect()
}

/// From where to where a laser was seen, mm; what spans its plane.
fn range_mm(s: &CalibrationSolution, id: LaserId) -> (f64, f64) {
    let seen = s.frames.iter().flat_map(|f| &f.stripes).filter(|p| p.used && p.laser == id);
    seen.fold((f64::INFINITY, 0.0), |(near, far), p| (near.min(p.depth_mm), far.max(p.depth_mm)))
}

/// Names, values and sigmas of the camera's parameters.
pub fn camera_rows(
    c: &CameraModel,
    lens: LensTerms,
    covariance: &CalibrationCovariance,
    skew_sigma_px: Option<f64>,
) -> Vec<(&'static str, f64, f64)> {
    let values = [("fx", c.fx), ("fy", c.fy), ("cx", c.cx), ("cy", c.cy), ("k1", c.k1), ("k2", c.k2)];
    let more = [("p1", c.p1, lens.decentred), ("p2", c.p2, lens.decentred), ("k3", c.k3, lens.k3)];
    let sigma = |i: usize| covariance[(i, i)].max(0.0).sqrt();
    let paper = values.into_iter().enumerate().map(|(i, (name, value))| (name, value, sigma(i)));
    let more = more.into_iter().enumerate().filter(|(_, (.., used))| *used);
    let more = more.map(|(i, (name, value, _))| (name, value, sigma(PAPER_PARAMETERS + i)));
    paper.chain(more).chain(skew_sigma_px.map(|sigma| ("skew", c.skew, sigma))).collect()
}

fn row_lines(rows: &[(&'static str, f64, f64)]) -> impl Iterator<Item = String> {
    rows.iter().map(|(name, value, sigma)| {
        let digits = if name.starts_with(['k', 'p']) { 6 } else { 3 };
        format!("{name:<11}{value:.digits$} ± {sigma:.digits$}")
    })
}

fn lens_json(lens: LensTerms, trials: &[LensTrial]) -> Value {
    let tried = trials.iter().map(|trial| {
        json!({
            "terms": trial.terms.name(),
            "left_out_rms_px": trial.left_out_rms_px,
            "log_likelihood_gain": trial.gain,
            "by_fit": trial.by_fit,
        })
    });
    json!({"terms": lens.name(), "tried": tried.collect::<Vec<_>>()})
}

/// Which terms the lens has, and why.
pub fn lens_text(lens: LensTerms, trials: &[LensTrial]) -> String {
    let tried = trials.iter().map(|trial| {
        let why = match trial.gain {
            Some(gain) => format!(" (log-likelihood {gain:+.1})"),
            None if trial.by_fit => " (taken: without all of them the lens does not fit)".to_owned(),
            None => String::new(),
        };
        format!("{}: {:.4} px{why}", trial.terms.name(), trial.left_out_rms_px)
    });
    let tried: Vec<String> = tried.collect();
    if tried.is_empty() {
        return format!("{}, as asked", lens.name());
    }
    format!("{}; on frames left out {}", lens.name(), tried.join("; "))
}

/// What to take next, in words.
pub fn advice_text(advice: &Advice) -> String {
    let side = match advice.towards_deg as i32 {
        0 => "right",
        90 => "bottom",
        180 => "left",
        _ => "top",
    };
    let tilt = if advice.tilt_deg == 0.0 {
        "facing the head".to_owned()
    } else {
        format!("turned by {:.0} degrees towards the picture's {side}", advice.tilt_deg)
    };
    format!(
        "a frame of the board at {:.0} mm, {tilt}, would bring the 1800 mm side from {:.3} to {:.3} mm (1 sigma)",
        advice.distance_mm, advice.sigma_now_mm, advice.sigma_then_mm
    )
}

fn text(solved: &Solved, args: &CalibrateArgs) -> String {
    let s = &solved.solution;
    let mut lines = vec![format!(
        "{} frames of {}, {} circles, {} stripe points, {:.1} s",
        s.frames.len(),
        solved.names.len(),
        s.frames.iter().map(|f| f.centres.len()).sum::<usize>(),
        s.frames.iter().map(|f| f.stripes.len()).sum::<usize>(),
        solved.seconds
    )];
    lines.extend(solved.left_out.iter().map(|(name, why)| format!("left out   {name}: {why}")));
    lines.extend(row_lines(&camera_rows(&s.camera, s.lens, &s.covariance, s.skew_sigma_px)));
    lines.push(format!("lens       {}", lens_text(s.lens, &s.lens_trials)));
    lines.push(format!("circles    {:.3}, {:.3} px rms (u, v)", s.centre_rms_px[0], s.centre_rms_px[1]));
    for id in LaserId::ALL {
        let frames = s.frames.iter().filter(|f| f.stripes.iter().any(|p| p.laser == id)).count();
        let (near, far) = range_mm(s, id);
        lines.push(format!(
            "laser {id}    {:.3} px rms, in {frames} frames, from {near:.0} to {far:.0} mm",
            s.stripe_rms_px[id.index()]
        ));
    }
    for (side, sigma) in SIDES_MM.iter().zip(solved.side_sigmas_mm) {
        let sigma = sigma.map_or("unknown".to_owned(), |x| format!("{x:.3} mm"));
        lines.push(format!(
            "side {side:<5} ± {sigma} at {:.0} mm, from the calibration alone",
            usual_distance_mm(*side)
        ));
    }
    lines.extend(warnings(solved).into_iter().map(|warning| format!("warning    {warning}")));
    lines.extend(solved.advice.as_ref().map(|a| format!("next       {}", advice_text(a))));
    lines.push(format!("written    {}", args.output.display()));
    lines.extend(args.report.as_ref().map(|path| format!("report     {}", path.display())));
    lines.push("(± is one standard deviation)".to_owned());
    lines.join("\n")
}
