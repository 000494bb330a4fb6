//! `boxline capture`: from a head on the cable to a recording. Each view is taken twice, with all lasers on and with all off, so that
//! sunlight can be subtracted. Where the cable comes out, the view is taken again as soon as the head is back.

use crate::Finished;
use crate::head::{DeviceChoice, warn_without_covariance};
use crate::input::Usage;
use crate::output::folder_of;
use crate::say::say;
use anyhow::Context;
use boxline::Calibration;
use boxline_proto::json::{
    Laser, RecordedFrame, Recording, Role, calibration_json, read_calibration, recording_json, write_json,
};
use boxline_proto::message::decode_calibration;
use boxline_uvc::head::{self, Lasers};
use boxline_uvc::{Counters, Device, Error, ErrorKind, Frame, Selector, Stream, StreamSettings, store};
use clap::Args as ClapArgs;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};
use std::io::IsTerminal;
use std::path::PathBuf;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

#[derive(ClapArgs)]
pub struct CaptureArgs {
    #[command(flatten)]
    pub choice: DeviceChoice,
    /// Folder for the recording; must not be there yet
    #[arg(short, long, value_name = "FOLDER")]
    pub output: PathBuf,
    /// How many views; the first two are `a` and `b`, which `boxline measure` takes
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=26))]
    pub views: u8,
    /// Views are of the calibration board, not of a box
    #[arg(long)]
    pub board: bool,
    /// The head's calibration, if it has none stored
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// Seconds to wait for a head that was unplugged
    #[arg(long, default_value_t = BACK_SECONDS, value_name = "SECONDS")]
    pub reconnect: u64,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// A head that gives no frame for so long is treated like one that was unplugged.
const FRAME_LIMIT: Duration = Duration::from_secs(3);
/// Frames until a switch of the lasers must show; it takes 1 to 3.
const SWITCH_FRAMES: u32 = 30;
const RETRY: Duration = Duration::from_millis(300);

/// Seconds to wait for a head that was unplugged.
const BACK_SECONDS: u64 = 30;
/// The same where nobody says otherwise.
pub const BACK_WITHIN: Duration = Duration::from_secs(BACK_SECONDS);

/// A head with its stream.
pub struct Camera {
    pub device: Device,
    stream: Stream,
}

impl Camera {
    /// Opens the head that is meant and starts its stream.
    pub fn open(selector: &Selector) -> Result<Self, Error> {
        let device = Device::open(selector)?;
        let stream = device.start(&StreamSettings { waiting_frames: 2 })?;
        Ok(Self { device, stream })
    }

    /// A frame whose whole exposure saw these lasers and no others.
    pub fn frame(&self, lasers: Lasers, bar: &ProgressBar) -> Result<Frame, Error> {
        self.device.set_lasers(lasers)?;
        let begun = Instant::now();
        for taken in 1..=SWITCH_FRAMES {
            let frame = self.stream.next_frame(FRAME_LIMIT)?;
            bar.set_message(format!(
                "{:.1} frames/s",
                f64::from(taken) / begun.elapsed().as_secs_f64().max(1e-3)
            ));
            bar.tick();
            let Some(tag) = frame.tag else {
                let text = "its frames do not say which lasers were on (uvc/PROTOCOL.md, \"Frame tag\")";
                return Err(Error::new(ErrorKind::Unsupported, text));
            };
            if tag.lasers == lasers.bits() && !tag.switched {
                return Ok(frame);
            }
        }
        let text =
            format!("lasers {:04b} were asked for and do not show in {SWITCH_FRAMES} frames", lasers.bits());
        Err(Error::new(ErrorKind::Protocol, text))
    }
}

/// Whether waiting for the cable can help.
pub fn may_come_back(error: &Error) -> bool {
    matches!(error.kind(), ErrorKind::DeviceLost | ErrorKind::NotFound | ErrorKind::Timeout | ErrorKind::Io)
}

/// Runs `boxline capture`.
pub fn capture(args: &CaptureArgs) -> anyhow::Result<Finished> {
    if args.output.exists() {
        return Err(
            Usage(format!("{}: is there already; nothing is overwritten", args.output.display())).into()
        );
    }
    let parent = folder_of(&args.output);
    let beside = tempfile::Builder::new()
        .prefix(".boxline-")
        .tempdir_in(parent)
        .with_context(|| parent.display().to_string())?;
    let folder = beside.path().join("recording");
    std::fs::create_dir(&folder).with_context(|| folder.display().to_string())?;

    let mut camera = Camera::open(&args.choice.device.clone().unwrap_or_default())?;
    let serial = head::serial(&camera.device)?;
    let same = Selector { serial: Some(camera.device.serial().to_owned()), ..Selector::default() };
    let calibration = calibration(args, &camera.device)?;
    let negotiated = camera.stream.negotiated().clone();
    for reason in negotiated.mode.fallback.iter().chain(&negotiated.fallback) {
        say(&format!("note: {reason}"));
    }
    let bar = ProgressBar::new(u64::from(args.views))
        .with_style(ProgressStyle::with_template("{bar:30} view {pos}/{len} {msg}")?);
    let mut counters: Vec<Counters> = Vec::new();
    let mut frames = Vec::new();
    let mut stamps = Vec::new();
    for view in 0..args.views {
        let name = char::from(b'a' + view);
        if std::io::stdin().is_terminal() {
            bar.suspend(|| say(&format!("view {name}: point the head, then press Enter")));
            std::io::stdin().read_line(&mut String::new())?;
        }
        let pair = loop {
            let lit = camera.frame(Lasers::ALL, &bar);
            match lit.and_then(|lit| Ok([lit, camera.frame(Lasers::OFF, &bar)?])) {
                Ok(pair) => break pair,
                Err(e) if may_come_back(&e) => {
                    bar.suspend(|| say(&format!("note: {e}; waiting for the head")));
                    counters.push(camera.stream.counters());
                    // Closed before it is opened again, so that the new one finds the interfaces free.
                    drop(camera);
                    camera = reopen(&same, Duration::from_secs(args.reconnect), e)?;
                }
                Err(e) => return Err(e.into()),
            }
        };
        for (frame, (suffix, laser)) in pair.iter().zip([("", Laser::On), ("_off", Laser::Off)]) {
            let id = format!("{name}{suffix}");
            let file = folder.join(format!("{id}.jpg"));
            std::fs::write(&file, &frame.jpeg).with_context(|| file.display().to_string())?;
            stamps.push(stamp(&id, frame));
            let role = if args.board { Role::Board } else { Role::Face };
            frames.push(RecordedFrame { id, file, role, laser });
        }
        bar.inc(1);
    }
    let celsius = head::temperature_celsius(&camera.device)?;
    counters.push(camera.stream.stop()?);
    bar.finish_and_clear();

    let calibration_file = folder.join("calibration.json");
    write_json(&calibration_file, &calibration_json(&calibration))?;
    let recording = Recording { folder: folder.clone(), serial: serial.clone(), calibration_file, frames };
    write_json(&folder.join("recording.json"), &recording_json(&recording)?)?;
    let (mode, streams) = (&negotiated.mode, counters.iter().map(counters_json).collect::<Vec<_>>());
    let details = json!({
        "format": "boxline-capture/1",
        "serial": serial,
        "width_px": mode.width,
        "height_px": mode.height,
        "frames_per_second": 1e7 / f64::from(mode.interval),
        "head_celsius": celsius,
        "streams": streams,
        "frames": stamps,
    });
    write_json(&folder.join("capture.json"), &details)?;
    std::fs::rename(&folder, &args.output).with_context(|| args.output.display().to_string())?;
    let stdout = if args.json {
        json!({"outcome": "captured", "folder": args.output.display().to_string(), "streams": streams})
            .to_string()
    } else {
        let lost: u64 = counters.iter().map(|c| c.dropped() - c.slow_reader + c.missing).sum();
        format!(
            "{}: {} views of head {serial}, {lost} frames lost on the way",
            args.output.display(),
            args.views
        )
    };
    Ok(Finished { stdout, exit_code: 0 })
}

fn calibration(args: &CaptureArgs, device: &Device) -> anyhow::Result<Calibration> {
    if let Some(file) = &args.calibration {
        return Ok(read_calibration(file)?);
    }
    let bytes = store::read(device, |_, _| ()).context("no --calibration was given")?;
    let stored = decode_calibration(&bytes).context("the calibration stored in the head")?;
    warn_without_covariance(&stored);
    Ok(stored)
}

/// Tries to open it until the limit.
pub fn reopen(selector: &Selector, limit: Duration, mut last: Error) -> anyhow::Result<Camera> {
    let end = Instant::now() + limit;
    while Instant::now() < end {
        match Camera::open(selector) {
            Ok(camera) => return Ok(camera),
            Err(e) => last = e,
        }
        std::thread::sleep(RETRY);
    }
    Err(anyhow::Error::new(last).context(format!("the head did not come back within {} s", limit.as_secs())))
}

fn stamp(id: &str, frame: &Frame) -> Value {
    let ago = frame.received_at.elapsed();
    let at = SystemTime::now().checked_sub(ago).and_then(|at| at.duration_since(UNIX_EPOCH).ok());
    json!({
        "id": id,
        "received_at_nanos": at.map(|at| u64::try_from(at.as_nanos()).unwrap_or(u64::MAX)),
        "device_ticks": frame.pts,
        "sequence": frame.tag.map(|tag| tag.sequence),
        "lasers": frame.tag.map(|tag| tag.lasers),
        "bytes": frame.jpeg.len(),
    })
}

fn counters_json(c: &Counters) -> Value {
    json!({
        "delivered": c.delivered,
        "first": c.first,
        "device_error": c.device_error,
        "transfer": c.transfer,
        "torn": c.torn,
        "not_jpeg": c.not_jpeg,
        "too_large": c.too_large,
        "slow_reader": c.slow_reader,
        "missing": c.missing,
    })
}
