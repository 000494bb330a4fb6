//! The class-specific part of a camera's descriptors (UVC 1.1 and 1.5, chapter 3): units and terminals of the control interface,
//! formats and frame sizes of the streaming interfaces.

use super::{
    Block, Configuration, Endpoint, EndpointKind, Finding, Interface, broken, u8_at, u16_at, u32_at,
};
use crate::{Error, ErrorKind};

pub(crate) const VIDEO: u8 = 0x0E;
pub(crate) const CONTROL: u8 = 1;
pub(crate) const STREAMING: u8 = 2;
pub(crate) const VC_HEADER: u8 = 1;
pub(crate) const VC_INPUT_TERMINAL: u8 = 2;
pub(crate) const VC_OUTPUT_TERMINAL: u8 = 3;
pub(crate) const VC_SELECTOR: u8 = 4;
pub(crate) const VC_PROCESSING: u8 = 5;
pub(crate) const VC_EXTENSION: u8 = 6;
pub(crate) const VC_ENCODING: u8 = 7;
pub(crate) const VS_INPUT_HEADER: u8 = 1;
pub(crate) const VS_FORMAT_MJPEG: u8 = 6;
pub(crate) const VS_FRAME_MJPEG: u8 = 7;
/// Other formats: uncompressed, MPEG-2 TS, DV, frame-based, stream-based, H.264, H.264 simulcast, VP8, VP8 simulcast.
const OTHER_FORMATS: [u8; 9] = [0x04, 0x0A, 0x0C, 0x10, 0x12, 0x13, 0x15, 0x16, 0x18];

/// Said of other devices.
pub(super) const NO_CAMERA: &str = "no video control interface (class 14, subclass 1)";

/// Version of the video class that a device follows; it fixes the length of probe and commit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum UvcVersion {
    /// 1.0: 26 bytes.
    V1_0,
    /// 1.1: 34 bytes.
    V1_1,
    /// 1.5: 48 bytes.
    V1_5,
}

impl UvcVersion {
    /// From the header's bcdUVC. Unknown ones count as the next lower.
    pub fn from_bcd(bcd: u16) -> Self {
        match bcd {
            ..0x0110 => Self::V1_0,
            0x0110..0x0150 => Self::V1_1,
            _ => Self::V1_5,
        }
    }

    /// As in the header.
    pub fn bcd(self) -> u16 {
        match self {
            Self::V1_0 => 0x0100,
            Self::V1_1 => 0x0110,
            Self::V1_5 => 0x0150,
        }
    }
}

/// A unit or terminal of the control interface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unit {
    /// Unique in the interface, never 0.
    pub id: u8,
    /// bDescriptorSubtype.
    pub subtype: u8,
    /// Units that feed this one.
    pub sources: Vec<u8>,
    /// What an extension unit has beside.
    pub extension: Option<Extension>,
    /// Where it stands.
    pub offset: usize,
}

/// A vendor's unit (UVC 1.5, table 3-11).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Extension {
    /// Which vendor's, in the byte order of the descriptor.
    pub guid: [u8; 16],
    /// How many controls it says it has.
    pub control_count: u8,
    /// Bit n: control n + 1 is there.
    pub controls: Vec<u8>,
}

impl Extension {
    /// Whether a control is there; selectors count from 1.
    pub fn has(&self, selector: u8) -> bool {
        let Some(bit) = selector.checked_sub(1) else { return false };
        self.controls.get(usize::from(bit / 8)).is_some_and(|byte| byte >> (bit % 8) & 1 == 1)
    }
}

/// A size of picture in a format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameSize {
    /// bFrameIndex.
    pub index: u8,
    /// Columns.
    pub width: u16,
    /// Rows.
    pub height: u16,
    /// dwMaxVideoFrameBufferSize, as the device claims it.
    pub max_bytes: u32,
    /// Units of 100 ns.
    pub default_interval: u32,
    /// The intervals between frames that it offers.
    pub intervals: Intervals,
}

/// Intervals between frames, units of 100 ns.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Intervals {
    /// These, shortest first.
    Listed(Vec<u32>),
    /// Every `step` from `shortest` to `longest`; with a step of 0 every one between them.
    Range {
        /// At the highest rate.
        shortest: u32,
        /// At the lowest rate.
        longest: u32,
        /// From one to the next.
        step: u32,
    },
}

impl Intervals {
    /// The interval that is nearest to `wanted`; never 0. `None` if there is none.
    pub fn nearest(&self, wanted: u32) -> Option<u32> {
        match self {
            Self::Listed(all) => all.iter().copied().filter(|i| *i > 0).min_by_key(|i| i.abs_diff(wanted)),
            &Self::Range { shortest, longest, step } => {
                let beyond = wanted.clamp(shortest, longest.max(shortest)) - shortest;
                let down = beyond.checked_rem(step).unwrap_or(0);
                let below = beyond - down + shortest;
                let above = below.saturating_add(step).min(longest.max(shortest));
                // The longest is offered too where steps do not end at it (UVC 1.5, table 3-13, says they do).
                [below, above].into_iter().filter(|i| *i > 0).min_by_key(|i| i.abs_diff(wanted))
            }
        }
    }

    /// Whether an interval is offered.
    pub fn has(&self, interval: u32) -> bool {
        self.nearest(interval) == Some(interval)
    }

    /// What contradicts itself in it.
    pub(super) fn contradiction(&self) -> Option<String> {
        match self {
            Self::Listed(all) => all.contains(&0).then(|| "an interval of 0".to_owned()),
            &Self::Range { shortest: 0, .. } => Some("an interval of 0".to_owned()),
            // The number of steps is not looked at: rates of whole frames make intervals that are rounded.
            &Self::Range { shortest, longest, .. } => {
                (longest < shortest).then(|| format!("intervals of {shortest} to {longest}"))
            }
        }
    }
}

/// What the pictures of a format are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FormatKind {
    /// One JPEG each.
    Mjpeg,
    /// Something else, with its bDescriptorSubtype.
    Other(u8),
}

/// A format with its sizes; sizes are read for MJPEG only.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Format {
    /// bFormatIndex.
    pub index: u8,
    /// What its pictures are.
    pub kind: FormatKind,
    /// How many sizes it says it has.
    pub frame_count: u8,
    /// The sizes that follow it.
    pub frames: Vec<FrameSize>,
    /// Where it stands.
    pub offset: usize,
}

/// An alternate setting that carries the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Alternate {
    /// What SET_INTERFACE takes.
    pub setting: u8,
    /// The stream's endpoint in it.
    pub endpoint: Endpoint,
}

/// A streaming interface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StreamingInterface {
    /// Its number.
    pub number: u8,
    /// The endpoint that its header names.
    pub endpoint: u8,
    /// The terminal that feeds it.
    pub terminal_link: u8,
    /// Formats in the order of the bytes.
    pub formats: Vec<Format>,
    /// Alternate settings with the stream's endpoint, smallest first.
    pub alternates: Vec<Alternate>,
}

/// The camera function of a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VideoFunction {
    /// Number of the control interface.
    pub control_interface: u8,
    /// Version of the class.
    pub version: UvcVersion,
    /// Ticks a second of the time stamps in payload headers.
    pub clock_hz: u32,
    /// Streaming interfaces that the header lists.
    pub streaming_numbers: Vec<u8>,
    /// Units and terminals.
    pub units: Vec<Unit>,
    /// Those of the listed interfaces that are there.
    pub streaming: Vec<StreamingInterface>,
}

impl VideoFunction {
    /// Finds the first camera of a configuration.
    pub fn parse(configuration: &Configuration) -> Result<Self, Error> {
        let found = Self::read(configuration)?;
        found.ok_or_else(|| Error::new(ErrorKind::Unsupported, NO_CAMERA))
    }

    /// The same; `None` if there is no camera.
    pub(super) fn read(configuration: &Configuration) -> Result<Option<Self>, Finding> {
        let control = configuration.interfaces.iter().find(|interface| interface.class == (VIDEO, CONTROL));
        let Some(control) = control else { return Ok(None) };
        let mut header = None;
        let mut units = Vec::new();
        for (offset, bytes) in &control.class_specific {
            let block = Block { offset: *offset, bytes };
            match u8_at(&block, 2)? {
                VC_HEADER => header = Some(parse_header(&block)?),
                subtype => units.extend(parse_unit(&block, subtype)?),
            }
        }
        let (bcd, clock_hz, streaming_numbers) =
            header.ok_or_else(|| broken(control.offset, "a video control interface without its header"))?;
        let mut streaming = Vec::new();
        for &number in &streaming_numbers {
            if let Some(parsed) = StreamingInterface::parse(configuration, number)? {
                streaming.push(parsed);
            }
        }
        let version = UvcVersion::from_bcd(bcd);
        let control_interface = control.number;
        Ok(Some(Self { control_interface, version, clock_hz, streaming_numbers, units, streaming }))
    }

    /// The extension unit of a vendor.
    pub fn extension(&self, guid: &[u8; 16]) -> Option<(u8, &Extension)> {
        self.units.iter().find_map(|unit| {
            let extension = unit.extension.as_ref().filter(|extension| extension.guid == *guid)?;
            Some((unit.id, extension))
        })
    }
}

fn parse_header(block: &Block<'_>) -> Result<(u16, u32, Vec<u8>), Finding> {
    let count = usize::from(u8_at(block, 11)?);
    let numbers = block.bytes.get(12..12 + count).ok_or_else(|| {
        broken(
            block.offset,
            format!("{count} streaming interfaces in a header of {} bytes", block.bytes.len()),
        )
    })?;
    Ok((u16_at(block, 3)?, u32_at(block, 7)?, numbers.to_vec()))
}

fn parse_unit(block: &Block<'_>, subtype: u8) -> Result<Option<Unit>, Finding> {
    let list = |count_at: usize| -> Result<Vec<u8>, Finding> {
        let count = usize::from(u8_at(block, count_at)?);
        let sources = block.bytes.get(count_at + 1..count_at + 1 + count);
        sources.map(<[u8]>::to_vec).ok_or_else(|| {
            broken(block.offset, format!("{count} inputs in a unit of {} bytes", block.bytes.len()))
        })
    };
    let (sources, extension) = match subtype {
        VC_INPUT_TERMINAL => (Vec::new(), None),
        VC_OUTPUT_TERMINAL => (vec![u8_at(block, 7)?], None),
        VC_SELECTOR => (list(4)?, None),
        VC_PROCESSING | VC_ENCODING => (vec![u8_at(block, 4)?], None),
        VC_EXTENSION => {
            let sources = list(21)?;
            let size_at = 22 + sources.len();
            let size = usize::from(u8_at(block, size_at)?);
            let controls = block.bytes.get(size_at + 1..size_at + 1 + size).ok_or_else(|| {
                broken(
                    block.offset,
                    format!("{size} bytes of controls in a unit of {} bytes", block.bytes.len()),
                )
            })?;
            let guid = block.bytes.get(4..20).and_then(|guid| guid.try_into().ok());
            let guid =
                guid.ok_or_else(|| broken(block.offset, "an extension unit too short for its GUID"))?;
            (sources, Some(Extension { guid, control_count: u8_at(block, 20)?, controls: controls.to_vec() }))
        }
        _ => return Ok(None),
    };
    Ok(Some(Unit { id: u8_at(block, 3)?, subtype, sources, extension, offset: block.offset }))
}

impl StreamingInterface {
    fn parse(configuration: &Configuration, number: u8) -> Result<Option<Self>, Finding> {
        let settings: Vec<&Interface> = configuration
            .alternates(number)
            .filter(|interface| interface.class == (VIDEO, STREAMING))
            .collect();
        let Some(first) = settings.first() else { return Ok(None) };
        let mut header = None;
        let mut formats: Vec<Format> = Vec::new();
        for (offset, bytes) in &first.class_specific {
            let block = Block { offset: *offset, bytes };
            match (u8_at(&block, 2)?, formats.last_mut()) {
                (VS_INPUT_HEADER, _) => header = Some((u8_at(&block, 6)?, u8_at(&block, 8)?)),
                (VS_FORMAT_MJPEG, _) => formats.push(Format::parse(&block, FormatKind::Mjpeg)?),
                (VS_FRAME_MJPEG, Some(format)) if format.kind == FormatKind::Mjpeg => {
                    format.frames.push(FrameSize::parse(&block)?)
                }
                (VS_FRAME_MJPEG, _) => return Err(broken(*offset, "an MJPEG frame outside an MJPEG format")),
                (other, _) if OTHER_FORMATS.contains(&other) => {
                    formats.push(Format::parse(&block, FormatKind::Other(other))?)
                }
                _ => {}
            }
        }
        let (endpoint, terminal_link) =
            header.ok_or_else(|| broken(first.offset, "a streaming interface without its header"))?;
        let mut alternates: Vec<Alternate> = settings
            .iter()
            .flat_map(|setting| setting.endpoints.iter().map(|&e| (setting.alternate, e)))
            .filter(|(_, e)| e.address == endpoint && e.is_in() && e.packet_bytes() > 0)
            .filter(|(_, e)| matches!(e.kind, EndpointKind::Bulk | EndpointKind::Isochronous))
            .map(|(setting, endpoint)| Alternate { setting, endpoint })
            .collect();
        alternates.sort_by_key(|alternate| alternate.endpoint.bytes_per_interval());
        Ok(Some(Self { number, endpoint, terminal_link, formats, alternates }))
    }
}

impl Format {
    fn parse(block: &Block<'_>, kind: FormatKind) -> Result<Self, Finding> {
        let (index, frame_count) = (u8_at(block, 3)?, u8_at(block, 4)?);
        Ok(Self { index, kind, frame_count, frames: Vec::new(), offset: block.offset })
    }
}

impl FrameSize {
    fn parse(block: &Block<'_>) -> Result<Self, Finding> {
        // bFrameIntervalType: 0 is a range (shortest, longest, step), else that many intervals.
        let interval = |i: usize| u32_at(block, 26 + 4 * i);
        let intervals = match usize::from(u8_at(block, 25)?) {
            0 => Intervals::Range { shortest: interval(0)?, longest: interval(1)?, step: interval(2)? },
            count => {
                let mut all = (0..count).map(interval).collect::<Result<Vec<_>, _>>()?;
                all.sort_unstable();
                Intervals::Listed(all)
            }
        };
        Ok(Self {
            index: u8_at(block, 3)?,
            width: u16_at(block, 5)?,
            height: u16_at(block, 7)?,
            max_bytes: u32_at(block, 17)?,
            default_interval: u32_at(block, 21)?,
            intervals,
        })
    }
}
