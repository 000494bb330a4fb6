//! `boxline emulate`: a head made of software that shows a recording, or a rendered box, attached to this machine or offered to others.

use crate::Finished;
use crate::input::Usage;
use crate::say::say;
use anyhow::Context;
use boxline::Calibration;
use boxline_proto::json::{Laser, Recording, read_calibration, read_recording};
use boxline_proto::message::encode_calibration;
#[cfg(feature = "render")]
use boxline_sim::{
    Split, Stock,
    recording::{HeadHold, Kind, Recipe, write_recording},
};
use boxline_uvc::descriptor::UvcVersion;
use boxline_uvc::emulator::{FrameRequest, Pipe, Settings, SoftwareHead, Source, WithoutBus, usbip};
use boxline_uvc::head::Lasers;
use boxline_uvc::store;
use clap::{Args as ClapArgs, ValueEnum};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::sync::Arc;

#[derive(ClapArgs)]
pub struct EmulateArgs {
    /// The recording to show: with the lasers on its lit frames, with the lasers off the others
    #[arg(value_name = "FOLDER")]
    #[cfg_attr(feature = "render", arg(required_unless_present = "render"))]
    #[cfg_attr(not(feature = "render"), arg(required = true))]
    pub recording: Option<PathBuf>,
    /// Show what `boxline render --off` makes of this seed, rendered before the head is attached
    #[cfg(feature = "render")]
    #[arg(long, value_name = "SEED", conflicts_with = "recording")]
    pub render: Option<u64>,
    /// Offer the head to `usbip attach` of other machines, instead of attaching it to this one
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub listen: Option<String>,
    /// How the stream travels
    #[arg(long, value_enum, default_value_t = PipeName::Bulk)]
    pub pipe: PipeName,
    /// Version of the video class
    #[arg(long, value_enum, default_value_t = VersionName::V1_1)]
    pub uvc: VersionName,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum PipeName {
    Bulk,
    Isochronous,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum VersionName {
    #[value(name = "1.0")]
    V1_0,
    #[value(name = "1.1")]
    V1_1,
    #[value(name = "1.5")]
    V1_5,
}

/// Where Linux keeps the host controller that software devices attach to.
const CONTROLLER: &str = "/sys/devices/platform/vhci_hcd.0";

/// Runs `boxline emulate`.
pub fn emulate(args: &EmulateArgs) -> anyhow::Result<Finished> {
    let (calibration, source) = shown(args)?;
    let settings = Settings {
        version: match args.uvc {
            VersionName::V1_0 => UvcVersion::V1_0,
            VersionName::V1_1 => UvcVersion::V1_1,
            VersionName::V1_5 => UvcVersion::V1_5,
        },
        pipe: match args.pipe {
            PipeName::Bulk => Pipe::Bulk,
            PipeName::Isochronous => Pipe::Isochronous,
        },
        serial: calibration.serial().to_owned(),
        paced: true,
        ..Settings::default()
    };
    let head = WithoutBus::new(SoftwareHead::new(settings, source));
    store::write(&head, &encode_calibration(&calibration), |_, _| ())?;
    let head = head.0.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    match &args.listen {
        Some(address) => {
            let listener = TcpListener::bind(address).with_context(|| address.clone())?;
            let address = listener.local_addr()?;
            say(&format!(
                "listening: modprobe vhci-hcd; usbip --tcp-port {} attach -r {} -b 1-1",
                address.port(),
                address.ip()
            ));
            usbip::listen(&listener, head, say)?;
        }
        None => {
            say(&format!("attaching to {CONTROLLER}; end with Ctrl-C, which is an unplug"));
            let (_, result) = usbip::attach(head, Path::new(CONTROLLER));
            result.with_context(|| format!("{CONTROLLER}: needs root and `modprobe vhci-hcd`"))?;
        }
    }
    Ok(Finished { stdout: "detached".into(), exit_code: 0 })
}

/// The head's calibration, and its pictures.
fn shown(args: &EmulateArgs) -> anyhow::Result<(Calibration, Source)> {
    #[cfg(feature = "render")]
    if let Some(seed) = args.render {
        let folder = tempfile::tempdir()?; // gone when the frames are read
        let recipe = Recipe { off: Some(HeadHold::Hand), ..Recipe::new(seed, Kind::Box) };
        write_recording(folder.path(), &recipe, &Stock::new(Split::Training))?;
        return recorded(folder.path());
    }
    recorded(args.recording.as_deref().context("a recording is needed")?)
}

fn recorded(folder: &Path) -> anyhow::Result<(Calibration, Source)> {
    let recording = read_recording(folder)?;
    Ok((read_calibration(&recording.calibration_file)?, source(&recording)?))
}

/// Lit frames while all lasers are on, unlit ones otherwise; the next view each time the lasers are lit.
fn source(recording: &Recording) -> anyhow::Result<Source> {
    let frames = |laser: Laser| -> anyhow::Result<Vec<Arc<[u8]>>> {
        let chosen = recording.frames.iter().filter(|frame| frame.laser == laser);
        chosen
            .map(|frame| {
                let bytes = std::fs::read(&frame.file).with_context(|| frame.file.display().to_string())?;
                Ok(Arc::from(bytes))
            })
            .collect()
    };
    let (lit, unlit) = (frames(Laser::On)?, frames(Laser::Off)?);
    if lit.is_empty() {
        return Err(Usage(format!("{}: no frame with the lasers on", recording.folder.display())).into());
    }
    let mut view = lit.len() - 1;
    let mut were_on = false;
    Ok(Box::new(move |shot: FrameRequest| {
        let on = shot.lasers == Lasers::ALL;
        if on && !were_on {
            view = (view + 1) % lit.len();
        }
        were_on = on;
        // A recording may have fewer unlit frames than lit ones.
        let shown = if on || unlit.is_empty() { &lit } else { &unlit };
        Some(shown[view % shown.len()].clone())
    }))
}
