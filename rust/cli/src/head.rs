//! `boxline devices`, `boxline laser`, `boxline head calibration`: a head on the cable, without its pictures.

use crate::Finished;
use crate::input::Usage;
use crate::say::say;
use anyhow::{Context, bail};
use boxline::Calibration;
use boxline_proto::json::{calibration_json, read_calibration, write_json};
use boxline_proto::message::{decode_calibration, encode_calibration};
use boxline_uvc::head::{self, Lasers};
use boxline_uvc::{Device, Selector, devices, store};
use clap::{Args as ClapArgs, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// The head lets lasers go out after 2 s without a word (uvc/PROTOCOL.md).
const LASER_REFRESH: Duration = Duration::from_millis(500);

#[derive(ClapArgs)]
pub struct DevicesArgs {
    /// Check the descriptors of all cameras for contradictions, also of those that cannot be used
    #[arg(long)]
    pub lint: bool,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

#[derive(ClapArgs)]
pub struct DeviceChoice {
    /// Which head, if more than one is attached: VENDOR:PRODUCT in hexadecimal, or its serial number
    #[arg(long, value_name = "1209:0001 | SERIAL", value_parser = selector)]
    pub device: Option<Selector>,
}

#[derive(ClapArgs)]
pub struct LaserArgs {
    #[command(flatten)]
    pub choice: DeviceChoice,
    /// Lasers to switch on, such as `1,3`; `all`; `off`
    #[arg(value_name = "LASERS", value_parser = lasers)]
    pub lasers: Lasers,
    /// Power of all lasers, percent
    #[arg(long, value_name = "PERCENT", value_parser = clap::value_parser!(u16).range(0..=100))]
    pub power: Option<u16>,
    /// How long they are on, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub seconds: u64,
}

#[derive(ClapArgs)]
pub struct HeadArgs {
    #[command(subcommand)]
    pub command: HeadCommand,
}

#[derive(Subcommand)]
pub enum HeadCommand {
    /// The calibration that is stored in the head
    Calibration(CalibrationArgs),
}

#[derive(ClapArgs)]
pub struct CalibrationArgs {
    #[command(subcommand)]
    pub command: CalibrationCommand,
}

#[derive(Subcommand)]
pub enum CalibrationCommand {
    /// Reads it into a file
    Read {
        #[command(flatten)]
        choice: DeviceChoice,
        /// Where to write
        #[arg(short, long, value_name = "FILE")]
        output: PathBuf,
    },
    /// Writes it from a file; a cable pulled meanwhile leaves the old one
    Write {
        #[command(flatten)]
        choice: DeviceChoice,
        /// The calibration
        #[arg(value_name = "CALIBRATION.json")]
        file: PathBuf,
        /// Also if the file is of a head with another serial number
        #[arg(long)]
        force: bool,
    },
}

/// `1209:0001`, else a serial number.
pub fn selector(text: &str) -> Result<Selector, String> {
    let number = |text: &str| u16::from_str_radix(text, 16).ok();
    match text.split_once(':') {
        Some((vendor, product)) => match (number(vendor), number(product)) {
            (Some(vendor), Some(product)) => {
                Ok(Selector { product: Some((vendor, product)), ..Selector::default() })
            }
            _ => Err("two hexadecimal numbers are needed, such as 1209:0001".into()),
        },
        None if text.is_empty() => Err("a serial number is needed".into()),
        None => Ok(Selector { serial: Some(text.to_owned()), ..Selector::default() }),
    }
}

fn lasers(text: &str) -> Result<Lasers, String> {
    match text {
        "all" => return Ok(Lasers::ALL),
        "off" => return Ok(Lasers::OFF),
        _ => {}
    }
    let mut bits = 0;
    for number in text.split(',') {
        match number.trim().parse::<u8>() {
            Ok(number @ 1..=4) => bits |= 1 << (number - 1),
            _ => return Err(format!("{number:?} is no laser: 1 to 4, separated by commas, `all` or `off`")),
        }
    }
    Lasers::from_bits(bits).map_err(|e| e.to_string())
}

impl DeviceChoice {
    /// Opens the head that is meant.
    pub fn open(&self) -> Result<Device, boxline_uvc::Error> {
        Device::open(&self.device.clone().unwrap_or_default())
    }
}

/// Runs `boxline devices`.
pub fn list(args: &DevicesArgs) -> anyhow::Result<Finished> {
    let found = devices()?;
    let mut lines = Vec::new();
    let mut objects = Vec::new();
    let mut findings = Vec::new();
    for device in &found {
        let (vendor, product) = device.product;
        let place = format!("{:03}/{:03}", device.place.0, device.place.1);
        let id = format!("{vendor:04x}:{product:04x}");
        match &device.state {
            Ok(identity) => {
                let kind = if identity.is_head { "head" } else { "camera" };
                lines.push(format!("{place} {id} {kind:6} {}", identity.serial));
                objects.push(json!({"place": place, "id": id, "kind": kind, "serial": identity.serial}));
            }
            Err(why) => {
                lines.push(format!("{place} {id} ?      {why}"));
                objects.push(json!({"place": place, "id": id, "error": why}));
            }
        }
        findings.extend(device.findings.iter().map(|finding| format!("{place}: {finding}")));
    }
    if args.lint {
        lines.extend(findings.iter().map(|finding| format!("lint: {finding}")));
        if findings.is_empty() && !found.is_empty() {
            lines.push("lint: no contradictions".into());
        }
    } else {
        findings.clear();
    }
    if found.is_empty() {
        lines.push("no camera is attached".into());
    }
    let stdout = if args.json {
        json!({"outcome": "listed", "devices": objects, "lint": findings}).to_string()
    } else {
        lines.join("\n")
    };
    Ok(Finished { stdout, exit_code: 0 })
}

/// Runs `boxline laser`.
pub fn laser(args: &LaserArgs) -> anyhow::Result<Finished> {
    let device = args.choice.open()?;
    if let Some(percent) = args.power {
        head::set_power_permille(&device, [percent * 10; 4])?;
    }
    let end = Instant::now() + Duration::from_secs(args.seconds);
    device.set_lasers(args.lasers)?;
    // If this program is killed, the head switches them off by itself.
    while args.lasers != Lasers::OFF && Instant::now() < end {
        std::thread::sleep(LASER_REFRESH.min(end.saturating_duration_since(Instant::now())));
        device.set_lasers(args.lasers)?;
    }
    device.set_lasers(Lasers::OFF)?;
    let celsius = head::temperature_celsius(&device)?;
    Ok(Finished {
        stdout: format!("lasers are off, the head has {celsius:.1} degrees Celsius"),
        exit_code: 0,
    })
}

/// Says that sigmas will lack the calibration's part: what was stored before the covariance was has none.
pub fn warn_without_covariance(calibration: &Calibration) {
    if calibration.covariance().is_none() {
        say(
            "warning: the calibration has no covariance, so sigmas will lack its part; `boxline calibrate` gives one",
        );
    }
}

/// Runs `boxline head`.
pub fn head(args: &HeadArgs) -> anyhow::Result<Finished> {
    let HeadCommand::Calibration(calibration) = &args.command;
    let bar = ProgressBar::no_length().with_style(ProgressStyle::with_template("{bar:30} page {pos}/{len}")?);
    let progress = |done: usize, all: usize| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    };
    let stdout = match &calibration.command {
        CalibrationCommand::Read { choice, output } => {
            let device = choice.open()?;
            let stored =
                decode_calibration(&store::read(&device, progress)?).context("stored calibration")?;
            warn_without_covariance(&stored);
            write_json(output, &calibration_json(&stored))?;
            format!("written {}: calibration of head {}", output.display(), stored.serial())
        }
        CalibrationCommand::Write { choice, file, force } => {
            let calibration = read_calibration(file)?;
            let device = choice.open()?;
            let serial = head::serial(&device)?;
            if serial != calibration.serial() && !force {
                let text = format!(
                    "{}: is of head {}, this is head {serial}; --force writes it all the same",
                    file.display(),
                    calibration.serial()
                );
                return Err(Usage(text).into());
            }
            warn_without_covariance(&calibration);
            let bytes = encode_calibration(&calibration);
            let info = store::write(&device, &bytes, progress)?;
            if usize::try_from(info.length) != Ok(bytes.len()) {
                bail!("the head stored {} bytes of {}", info.length, bytes.len());
            }
            format!("stored {} bytes in head {serial}, read back and compared", bytes.len())
        }
    };
    bar.finish_and_clear();
    Ok(Finished { stdout, exit_code: 0 })
}
