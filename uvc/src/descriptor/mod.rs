//! Descriptors as USB 2.0, chapter 9 lays them out: device, configuration, interfaces, endpoints, and whatever lies between them.
//! `video` reads the class-specific part, [`lint()`] looks for contradictions. Bytes come from a
//! device that nobody vouches for, so what is broken never causes a panic. What hosts forgive (a total that does not fit, a broken
//! microphone, rubbish at the end) is skipped and kept as a finding; a broken description of the video is an error with its offset.

mod lint;
mod video;

pub use lint::{Finding, lint};
pub use video::{
    Alternate, Extension, Format, FormatKind, FrameSize, Intervals, StreamingInterface, Unit, UvcVersion,
    VideoFunction,
};

use crate::{Error, ErrorKind};

pub(crate) const DEVICE: u8 = 0x01;
pub(crate) const CONFIGURATION: u8 = 0x02;
pub(crate) const INTERFACE: u8 = 0x04;
pub(crate) const ENDPOINT: u8 = 0x05;
pub(crate) const CS_INTERFACE: u8 = 0x24;

/// The device descriptor (USB 2.0, table 9-8).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Device {
    /// USB version, binary-coded decimal: 0x0200.
    pub usb_bcd: u16,
    /// Vendor's number.
    pub vendor_id: u16,
    /// Product's number.
    pub product_id: u16,
    /// Which string is the serial number; 0: none.
    pub serial_string: u8,
}

/// An endpoint (USB 2.0, table 9-13).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// Bit 7: to the host.
    pub address: u8,
    /// How it transfers.
    pub kind: EndpointKind,
    /// The field as it stands: bits 10..0 bytes, bits 12..11 further transactions in a microframe.
    pub max_packet_field: u16,
}

/// How an endpoint transfers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EndpointKind {
    /// Commands and answers.
    Control,
    /// Reserved bandwidth, no repeats.
    Isochronous,
    /// What is left of the bus, repeated until it arrives.
    Bulk,
    /// Small messages in time.
    Interrupt,
}

impl Endpoint {
    /// The most bytes in one interval: packet size times transactions (high speed, USB 2.0, 9.6.6).
    pub fn bytes_per_interval(&self) -> usize {
        let transactions = 1 + usize::from(self.max_packet_field >> 11 & 3);
        usize::from(self.max_packet_field & 0x7FF) * transactions
    }

    /// The bytes of one packet; a shorter one ends a bulk transfer.
    pub fn packet_bytes(&self) -> usize {
        usize::from(self.max_packet_field & 0x7FF)
    }

    /// Whether data flows to the host.
    pub fn is_in(&self) -> bool {
        self.address & 0x80 != 0
    }
}

/// One alternate setting of one interface, with what follows it up to the next.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Interface {
    /// Its number.
    pub number: u8,
    /// Which alternate setting this is.
    pub alternate: u8,
    /// Class, subclass.
    pub class: (u8, u8),
    /// How many endpoints it says it has.
    pub endpoint_count: u8,
    /// The endpoints that follow.
    pub endpoints: Vec<Endpoint>,
    /// Class-specific descriptors before the first endpoint, with their offsets.
    pub class_specific: Vec<(usize, Vec<u8>)>,
    /// Where it starts.
    pub offset: usize,
}

/// A configuration, and every alternate setting in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Configuration {
    /// What SET_CONFIGURATION takes.
    pub value: u8,
    /// How many interfaces it says it has.
    pub interface_count: u8,
    /// All alternate settings of all interfaces in the order of the bytes.
    pub interfaces: Vec<Interface>,
    /// What cannot be read and was skipped.
    pub skipped: Vec<Finding>,
}

/// One descriptor in a row of them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Block<'a> {
    pub offset: usize,
    /// With its length and type.
    pub bytes: &'a [u8],
}

impl Block<'_> {
    pub fn kind(&self) -> u8 {
        self.bytes.get(1).copied().unwrap_or(0)
    }
}

pub(crate) fn broken(offset: usize, text: impl Into<String>) -> Finding {
    Finding { offset, text: text.into() }
}

impl From<Finding> for Error {
    fn from(Finding { offset, text }: Finding) -> Self {
        Self::new(ErrorKind::Descriptor, format!("descriptor at byte {offset}: {text}"))
    }
}

/// Cuts a row of descriptors apart.
pub(crate) fn blocks(bytes: &[u8]) -> impl Iterator<Item = Result<Block<'_>, Finding>> {
    let mut offset = 0;
    std::iter::from_fn(move || {
        let rest = bytes.get(offset..).filter(|rest| !rest.is_empty())?;
        let length = usize::from(rest[0]);
        let at = offset;
        match rest.get(..length) {
            Some(block) if length >= 2 => {
                offset += length;
                Some(Ok(Block { offset: at, bytes: block }))
            }
            _ => {
                offset = bytes.len();
                Some(Err(broken(
                    at,
                    format!("length {length}, {} bytes are left, at least 2 are needed", rest.len()),
                )))
            }
        }
    })
}

pub(crate) fn u8_at(block: &Block<'_>, at: usize) -> Result<u8, Finding> {
    block.bytes.get(at).copied().ok_or_else(|| {
        broken(block.offset, format!("{} bytes, at least {} are needed", block.bytes.len(), at + 1))
    })
}

pub(crate) fn u16_at(block: &Block<'_>, at: usize) -> Result<u16, Finding> {
    Ok(u16::from_le_bytes([u8_at(block, at)?, u8_at(block, at + 1)?]))
}

pub(crate) fn u32_at(block: &Block<'_>, at: usize) -> Result<u32, Finding> {
    Ok(u32::from(u16_at(block, at)?) | u32::from(u16_at(block, at + 2)?) << 16)
}

impl Device {
    /// Reads the 18 bytes of a device descriptor.
    pub fn parse(bytes: &[u8]) -> Result<Self, Error> {
        Ok(Self::read(bytes)?)
    }

    fn read(bytes: &[u8]) -> Result<Self, Finding> {
        let block = Block { offset: 0, bytes };
        if bytes.len() < 18 || block.kind() != DEVICE || bytes[0] != 18 {
            return Err(broken(0, format!("{} bytes, a device descriptor of 18 is needed", bytes.len())));
        }
        Ok(Self {
            usb_bcd: u16_at(&block, 2)?,
            vendor_id: u16_at(&block, 8)?,
            product_id: u16_at(&block, 10)?,
            serial_string: u8_at(&block, 16)?,
        })
    }
}

impl Configuration {
    /// Reads a configuration descriptor with everything after it. Bytes past its own total length are ignored, as hosts do, and a
    /// total beyond the bytes is taken for all of them. Only the head of the configuration must be whole.
    pub fn parse(bytes: &[u8]) -> Result<Self, Error> {
        Ok(Self::read(bytes)?)
    }

    fn read(bytes: &[u8]) -> Result<Self, Finding> {
        let mut row = blocks(bytes);
        let head = row.next().ok_or_else(|| broken(0, "no bytes"))??;
        if head.kind() != CONFIGURATION {
            return Err(broken(0, format!("type {}, a configuration (2) is needed", head.kind())));
        }
        let total = usize::from(u16_at(&head, 2)?);
        let (interface_count, value) = (u8_at(&head, 4)?, u8_at(&head, 5)?);
        let mut parsed = Self { value, interface_count, interfaces: Vec::new(), skipped: Vec::new() };
        // What follows an interface that cannot be read is not that of the one before.
        let mut is_known = false;
        for block in blocks(&bytes[..total.min(bytes.len())]).skip(1) {
            let read = block.and_then(|block| {
                if block.kind() == INTERFACE {
                    is_known = false;
                    parsed.interfaces.push(Interface::parse(&block)?);
                    is_known = true;
                    return Ok(());
                }
                let interface = parsed.interfaces.last_mut().filter(|_| is_known);
                match (block.kind(), interface) {
                    (ENDPOINT, Some(interface)) => interface.endpoints.push(Endpoint::parse(&block)?),
                    (ENDPOINT, None) => {
                        return Err(broken(block.offset, "an endpoint outside any interface"));
                    }
                    (CS_INTERFACE, Some(interface)) => {
                        interface.class_specific.push((block.offset, block.bytes.to_vec()))
                    }
                    _ => {} // associations, class-specific endpoints, vendors' own
                }
                Ok(())
            });
            parsed.skipped.extend(read.err());
        }
        Ok(parsed)
    }

    /// The alternate settings of one interface.
    pub fn alternates(&self, number: u8) -> impl Iterator<Item = &Interface> {
        self.interfaces.iter().filter(move |interface| interface.number == number)
    }
}

impl Interface {
    fn parse(block: &Block<'_>) -> Result<Self, Finding> {
        Ok(Self {
            number: u8_at(block, 2)?,
            alternate: u8_at(block, 3)?,
            endpoint_count: u8_at(block, 4)?,
            class: (u8_at(block, 5)?, u8_at(block, 6)?),
            endpoints: Vec::new(),
            class_specific: Vec::new(),
            offset: block.offset,
        })
    }
}

impl Endpoint {
    fn parse(block: &Block<'_>) -> Result<Self, Finding> {
        let kind = match u8_at(block, 3)? & 3 {
            0 => EndpointKind::Control,
            1 => EndpointKind::Isochronous,
            2 => EndpointKind::Bulk,
            _ => EndpointKind::Interrupt,
        };
        Ok(Self { address: u8_at(block, 2)?, kind, max_packet_field: u16_at(block, 4)? })
    }
}
