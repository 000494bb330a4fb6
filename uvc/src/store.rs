//! The calibration store, host's side (uvc/PROTOCOL.md, "Calibration store"). What is stored is opaque here; boxline stores the
//! protobuf message `Calibration`.
//!
//! Writing is atomic: pages go to the half of the memory that is not in use, and only the commit makes it the one in use. A cable
//! pulled before that leaves the old contents.

use crate::head::{Control, Controls, value};
use crate::{Error, ErrorKind};

/// Bytes of a page; every page but the last is full.
pub const PAGE_BYTES: usize = 256;
/// The most that is written or believed when reading, whatever a head offers.
pub const MAX_BYTES: usize = 64 * 1024;

pub(crate) const BEGIN: u8 = 1;
pub(crate) const COMMIT: u8 = 2;
pub(crate) const ABORT: u8 = 3;
pub(crate) const SELECT: u8 = 4;

/// What a head has stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StoreInfo {
    /// Bytes; 0: nothing is stored.
    pub length: u32,
    /// CRC-32 (IEEE) of them.
    pub crc: u32,
    /// Grows with each commit.
    pub generation: u32,
    /// Bytes of a page.
    pub page_bytes: u16,
    /// How many pages there is room for.
    pub pages: u16,
}

impl StoreInfo {
    /// The bytes of the control.
    pub fn encode(&self) -> [u8; 16] {
        let mut bytes = [0; 16];
        bytes[0..4].copy_from_slice(&self.length.to_le_bytes());
        bytes[4..8].copy_from_slice(&self.crc.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.generation.to_le_bytes());
        bytes[12..14].copy_from_slice(&self.page_bytes.to_le_bytes());
        bytes[14..16].copy_from_slice(&self.pages.to_le_bytes());
        bytes
    }

    /// What the bytes of the control say.
    pub fn decode(bytes: &[u8; 16]) -> Result<Self, Error> {
        let u32_at = |i: usize| u32::from_le_bytes([bytes[i], bytes[i + 1], bytes[i + 2], bytes[i + 3]]);
        let u16_at = |i: usize| u16::from_le_bytes([bytes[i], bytes[i + 1]]);
        let info = Self {
            length: u32_at(0),
            crc: u32_at(4),
            generation: u32_at(8),
            page_bytes: u16_at(12),
            pages: u16_at(14),
        };
        let room = usize::from(info.pages) * PAGE_BYTES;
        if usize::from(info.page_bytes) != PAGE_BYTES || usize_of(info.length) > room.min(MAX_BYTES) {
            let text = format!(
                "the store says {info:?}; pages of {PAGE_BYTES} bytes and a length within them are needed"
            );
            return Err(Error::new(ErrorKind::Protocol, text));
        }
        Ok(info)
    }
}

/// A command to the store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Command {
    pub op: u8,
    pub page: u16,
    pub length: u32,
    pub crc: u32,
}

impl Command {
    pub fn encode(&self) -> [u8; 12] {
        let mut bytes = [0; 12];
        bytes[0] = self.op;
        bytes[2..4].copy_from_slice(&self.page.to_le_bytes());
        bytes[4..8].copy_from_slice(&self.length.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.crc.to_le_bytes());
        bytes
    }

    pub fn decode(bytes: &[u8; 12]) -> Self {
        let u32_at = |i: usize| u32::from_le_bytes([bytes[i], bytes[i + 1], bytes[i + 2], bytes[i + 3]]);
        Self {
            op: bytes[0],
            page: u16::from_le_bytes([bytes[2], bytes[3]]),
            length: u32_at(4),
            crc: u32_at(8),
        }
    }
}

/// A page on the wire: number, bytes used, their CRC, the bytes, zeros.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Page {
    /// Counts from 0.
    pub number: u16,
    /// At most [`PAGE_BYTES`].
    pub data: Vec<u8>,
}

impl Page {
    /// The bytes of the control.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = self.number.to_le_bytes().to_vec();
        bytes.extend(u16::try_from(self.data.len()).unwrap_or(u16::MAX).to_le_bytes());
        bytes.extend(crc32fast::hash(&self.data).to_le_bytes());
        bytes.extend(&self.data);
        bytes.resize(Control::StorePage.bytes(), 0);
        bytes
    }

    /// What the bytes of the control say, if their CRC is right.
    pub fn decode(bytes: &[u8]) -> Result<Self, Error> {
        let broken = |text: String| Error::new(ErrorKind::Protocol, format!("store page: {text}"));
        let Some((&[n0, n1, u0, u1, c0, c1, c2, c3], data)) = bytes.split_first_chunk() else {
            return Err(broken(format!("{} bytes, a header of 8 is needed", bytes.len())));
        };
        let used = usize::from(u16::from_le_bytes([u0, u1]));
        let data = data
            .get(..used)
            .filter(|_| used <= PAGE_BYTES)
            .ok_or_else(|| broken(format!("{used} bytes used, {PAGE_BYTES} is the most")))?;
        let (crc, found) = (u32::from_le_bytes([c0, c1, c2, c3]), crc32fast::hash(data));
        if crc != found {
            return Err(broken(format!("CRC {found:#010x} of its bytes, {crc:#010x} in its header")));
        }
        Ok(Self { number: u16::from_le_bytes([n0, n1]), data: data.to_vec() })
    }
}

/// What is stored.
pub fn info(controls: &impl Controls) -> Result<StoreInfo, Error> {
    StoreInfo::decode(&value(controls, Control::StoreInfo)?)
}

/// Reads the stored bytes. After each page `progress` is called with the number of pages that are read and of all pages.
pub fn read(controls: &impl Controls, mut progress: impl FnMut(usize, usize)) -> Result<Vec<u8>, Error> {
    let info = info(controls)?;
    if info.length == 0 {
        return Err(Error::new(ErrorKind::Store, "the head has no calibration stored"));
    }
    let length = usize_of(info.length);
    let pages = length.div_ceil(PAGE_BYTES);
    let mut bytes = Vec::with_capacity(length);
    for number in 0..page_number(pages)? {
        command(controls, Command { op: SELECT, page: number, length: 0, crc: 0 })?;
        let page = Page::decode(&controls.get(Control::StorePage)?)?;
        let needed = PAGE_BYTES.min(length - bytes.len());
        if page.number != number || page.data.len() != needed {
            let (found, used) = (page.number, page.data.len());
            let text = format!("page {number} of {needed} bytes was asked for, page {found} of {used} came");
            return Err(Error::new(ErrorKind::Protocol, text));
        }
        bytes.extend(page.data);
        progress(usize::from(number) + 1, pages);
    }
    let found = crc32fast::hash(&bytes);
    if found != info.crc {
        let text = format!("CRC {found:#010x} of what is stored, {:#010x} is needed", info.crc);
        return Err(Error::new(ErrorKind::Store, text));
    }
    Ok(bytes)
}

/// Writes bytes, reads them back and compares. On an error before the commit the old contents stay.
pub fn write(
    controls: &impl Controls,
    bytes: &[u8],
    mut progress: impl FnMut(usize, usize),
) -> Result<StoreInfo, Error> {
    let before = info(controls)?;
    let room = (usize::from(before.pages) * PAGE_BYTES).min(MAX_BYTES);
    if bytes.is_empty() || bytes.len() > room {
        let text = format!("{} bytes to store, 1 to {room} fit", bytes.len());
        return Err(Error::new(ErrorKind::InvalidArgument, text));
    }
    let length = u32::try_from(bytes.len()).unwrap_or(u32::MAX); // at most 64 KiB
    let crc = crc32fast::hash(bytes);
    let pages = bytes.len().div_ceil(PAGE_BYTES);
    command(controls, Command { op: BEGIN, page: 0, length, crc })?;
    for (number, data) in (0..page_number(pages)?).zip(bytes.chunks(PAGE_BYTES)) {
        let page = Page { number, data: data.to_vec() };
        if let Err(e) = controls.set(Control::StorePage, &page.encode()) {
            let error = explained(controls, e).in_context(format!("page {number}"));
            // The head forgets the session at the next begin or power-up; a failure here changes nothing for the caller.
            drop(command(controls, Command { op: ABORT, page: 0, length: 0, crc: 0 }));
            return Err(error);
        }
        progress(usize::from(number) + 1, pages);
    }
    command(controls, Command { op: COMMIT, page: 0, length, crc })?;
    let after = info(controls)?;
    if read(controls, |_, _| ())? != bytes || after.generation == before.generation {
        return Err(Error::new(ErrorKind::Store, "the head stored something else than was written"));
    }
    Ok(after)
}

fn command(controls: &impl Controls, command: Command) -> Result<(), Error> {
    controls.set(Control::StoreCommand, &command.encode()).map_err(|e| {
        let name = ["begin", "commit", "abort", "select"];
        let name = name.get(usize::from(command.op).wrapping_sub(1)).unwrap_or(&"?");
        explained(controls, e).in_context(name)
    })
}

/// Adds what the head says about a refusal.
fn explained(controls: &impl Controls, error: Error) -> Error {
    if error.kind() != ErrorKind::Refused {
        return error;
    }
    match value::<4>(controls, Control::StoreStatus) {
        Ok([_, result, ..]) => {
            let why = Status::from_code(result).map_or("unknown", Status::text);
            Error::new(ErrorKind::Refused, format!("{error}; the store says: {why} ({result})"))
        }
        Err(_) => error,
    }
}

/// How the last command or page went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Status {
    /// Done.
    Ok = 0,
    /// A page or a commit without a begin.
    NoSession = 1,
    /// A page out of order or out of range.
    WrongPage = 2,
    /// A page whose CRC does not fit.
    PageCrc = 3,
    /// A commit before the last page.
    Incomplete = 4,
    /// The whole does not have the CRC that was announced.
    WholeCrc = 5,
    /// The memory failed.
    Memory = 6,
    /// A command that does not exist, or a length that does not fit.
    BadCommand = 7,
}

impl Status {
    fn from_code(code: u8) -> Option<Self> {
        use Status::*;
        [Ok, NoSession, WrongPage, PageCrc, Incomplete, WholeCrc, Memory, BadCommand]
            .into_iter()
            .find(|s| *s as u8 == code)
    }

    fn text(self) -> &'static str {
        match self {
            Self::Ok => "done",
            Self::NoSession => "no write was begun",
            Self::WrongPage => "page out of order or out of range",
            Self::PageCrc => "CRC of the page is wrong",
            Self::Incomplete => "pages are missing",
            Self::WholeCrc => "CRC of the whole is wrong",
            Self::Memory => "memory failed",
            Self::BadCommand => "no such command or length",
        }
    }
}

fn usize_of(n: u32) -> usize {
    usize::try_from(n).unwrap_or(usize::MAX)
}

fn page_number(n: usize) -> Result<u16, Error> {
    u16::try_from(n)
        .ok()
        .ok_or_else(|| Error::new(ErrorKind::InvalidArgument, format!("{n} pages, 65535 is the most")))
}
