//! From payloads to frames. A frame is delivered whole or not at all, and each one that is not is counted with its reason.
//!
//! A frame ends with EOF, with the toggle of FID, or with the next sequence number of the head's tag, whichever comes first: cameras
//! exist that never set EOF and others whose FID is stuck. Each byte is copied once, from the transfer into the frame.

use crate::mode::MAX_FRAME_BYTES;
use crate::payload::{FrameTag, PayloadHeader, TAGGED_HEADER_BYTES};
use std::time::Instant;

/// A frame as the head sent it.
#[derive(Clone, Debug)]
pub struct Frame {
    /// One JPEG.
    pub jpeg: Vec<u8>,
    /// What the head said about it; none from other cameras.
    pub tag: Option<FrameTag>,
    /// When it was taken, ticks of the device's clock.
    pub pts: Option<u32>,
    /// When its first payload arrived here.
    pub received_at: Instant,
}

/// Why a frame was dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loss {
    /// The stream was joined in its middle; untagged streams lose their first frame always.
    First,
    /// The device set the error bit.
    DeviceError,
    /// A transfer or packet of it failed.
    Transfer,
    /// Bytes in the middle are missing or came twice.
    Torn,
    /// It does not start as a JPEG starts, or does not end as one ends.
    NotJpeg,
    /// Larger than [`MAX_FRAME_BYTES`].
    TooLarge,
    /// The reader took frames too slowly.
    SlowReader,
}

/// What became of the frames. `delivered + dropped() + missing` is what the head sent since the first payload that arrived.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Whole frames.
    pub delivered: u64,
    /// Bytes in them.
    pub delivered_bytes: u64,
    /// [`Loss::First`].
    pub first: u64,
    /// [`Loss::DeviceError`].
    pub device_error: u64,
    /// [`Loss::Transfer`].
    pub transfer: u64,
    /// [`Loss::Torn`].
    pub torn: u64,
    /// [`Loss::NotJpeg`].
    pub not_jpeg: u64,
    /// [`Loss::TooLarge`].
    pub too_large: u64,
    /// [`Loss::SlowReader`].
    pub slow_reader: u64,
    /// Frames of which nothing arrived, by the gaps between sequence numbers.
    pub missing: u64,
    /// Payloads with a broken header, or of a frame that had ended.
    pub bad_payloads: u64,
    /// Transfers or packets that failed.
    pub failed_transfers: u64,
}

impl Counters {
    /// Frames of which something arrived, and which were not delivered.
    pub fn dropped(&self) -> u64 {
        self.first
            + self.device_error
            + self.transfer
            + self.torn
            + self.not_jpeg
            + self.too_large
            + self.slow_reader
    }

    fn count(&mut self, reason: Loss) {
        *match reason {
            Loss::First => &mut self.first,
            Loss::DeviceError => &mut self.device_error,
            Loss::Transfer => &mut self.transfer,
            Loss::Torn => &mut self.torn,
            Loss::NotJpeg => &mut self.not_jpeg,
            Loss::TooLarge => &mut self.too_large,
            Loss::SlowReader => &mut self.slow_reader,
        } += 1;
    }
}

/// Sequence numbers that a stream may skip while nothing arrives: a minute and more at 15 frames/s, and a 64th of all numbers.
const FARTHEST_AHEAD: u16 = 1024;

struct Open {
    frame: Frame,
    frame_id: bool,
    fault: Option<Loss>,
}

/// The payload that is under way.
#[derive(Clone, Copy)]
enum Payload {
    /// Its bytes belong to the open frame; the flag is EOF.
    Wanted(bool),
    Ignored,
}

/// Puts frames together. Feed it [`payload`](Self::payload) by payload, or piece by piece for bulk payloads that span transfers:
/// [`start`](Self::start), [`more`](Self::more), [`end`](Self::end).
pub struct Assembler {
    expected_bytes: usize,
    open: Option<Open>,
    payload: Payload,
    /// Of the last frame that was begun.
    sequence: Option<u16>,
    /// A frame boundary has been seen, so the next untagged frame is whole.
    in_step: bool,
    /// Something failed while no frame was open; an untagged frame cannot tell whether that was its first payload.
    tainted: bool,
    ready: Vec<Frame>,
    counters: Counters,
}

impl Assembler {
    /// `expected_bytes` is what the device says is its largest frame: room is set aside for it, so that no frame is moved while it
    /// grows.
    pub fn new(expected_bytes: usize) -> Self {
        Self {
            expected_bytes: expected_bytes.min(MAX_FRAME_BYTES),
            open: None,
            payload: Payload::Ignored,
            sequence: None,
            in_step: false,
            tainted: false,
            ready: Vec::with_capacity(2),
            counters: Counters::default(),
        }
    }

    /// What became of the frames so far.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// Frames that are whole, oldest first.
    pub fn take_ready(&mut self) -> impl Iterator<Item = Frame> + '_ {
        self.ready.drain(..)
    }

    /// A whole payload. Empty ones are normal on isochronous pipes.
    pub fn payload(&mut self, bytes: &[u8]) {
        if !bytes.is_empty() {
            self.start(bytes);
            self.end();
        }
    }

    /// The first piece of a payload, with its header.
    pub fn start(&mut self, bytes: &[u8]) {
        self.payload = Payload::Ignored;
        let header = PayloadHeader::parse(bytes).ok();
        // What has no tag in a stream of tagged payloads is the rest of a payload whose start was lost.
        let Some(header) = header.filter(|header| header.tag.is_some() || self.sequence.is_none()) else {
            self.counters.bad_payloads += 1;
            self.spoil(Loss::Torn);
            return;
        };
        if header.still {
            return;
        }
        let data = &bytes[header.length..];
        if self.open.as_ref().is_some_and(|open| !open.continues_with(&header)) {
            self.close();
        }
        if self.open.is_none() {
            if data.is_empty() {
                return; // keep-alive between frames
            }
            if header.tag.is_some_and(|tag| self.sequence == Some(tag.sequence)) {
                self.counters.bad_payloads += 1; // a straggler of the frame that has just ended
                return;
            }
            self.open(&header);
        }
        if let Some(open) = &mut self.open {
            if header.error {
                open.fault.get_or_insert(Loss::DeviceError);
            }
            let have = open.frame.jpeg.len();
            if header.tag.is_some_and(|tag| usize::try_from(tag.offset_bytes) != Ok(have)) {
                // A frame that starts in its middle is the one that was under way when the stream was joined.
                let joined = have == 0 && !self.in_step;
                open.fault.get_or_insert(if joined { Loss::First } else { Loss::Torn });
            }
            self.payload = Payload::Wanted(header.end_of_frame);
        }
        self.more(data);
    }

    /// Whether bytes are surely the start of a payload: nothing but the head's header, of a frame that may come now. The bytes of a
    /// picture look like that once in 10^10 times; by the mark alone it was once in some thousand times, and its random
    /// sequence number counted up to 65,535 frames as missing.
    pub(crate) fn is_tagged_start(&self, bytes: &[u8]) -> bool {
        PayloadHeader::parse(bytes).is_ok_and(|header| {
            header.length == TAGGED_HEADER_BYTES
                && !header.still
                && header.tag.is_some_and(|tag| {
                    let ahead = self.sequence.map_or(0, |last| tag.sequence.wrapping_sub(last));
                    ahead <= FARTHEST_AHEAD
                        && usize::try_from(tag.offset_bytes).is_ok_and(|n| n < MAX_FRAME_BYTES)
                })
        })
    }

    /// The next piece of the payload.
    pub fn more(&mut self, data: &[u8]) {
        let (Payload::Wanted(_), Some(open)) = (self.payload, &mut self.open) else { return };
        if open.frame.jpeg.len() + data.len() > MAX_FRAME_BYTES {
            open.fault.get_or_insert(Loss::TooLarge);
        }
        // A spoilt frame still grows, within the cap, so that offsets of payloads go on making sense.
        if open.fault != Some(Loss::TooLarge) {
            open.frame.jpeg.extend_from_slice(data);
        }
    }

    /// The payload is complete.
    pub fn end(&mut self) {
        if let Payload::Wanted(true) = self.payload {
            self.close();
        }
        self.payload = Payload::Ignored;
    }

    /// A transfer or a packet failed: what it held is lost.
    pub fn failed_transfer(&mut self) {
        self.counters.failed_transfers += 1;
        self.payload = Payload::Ignored;
        self.spoil(Loss::Transfer);
    }

    /// The stream has stopped: a frame under way is lost.
    pub fn finish(&mut self) {
        self.spoil(Loss::Torn);
        self.close();
    }

    fn spoil(&mut self, reason: Loss) {
        match &mut self.open {
            Some(open) => {
                open.fault.get_or_insert(reason);
            }
            None => self.tainted = true,
        }
    }

    fn open(&mut self, header: &PayloadHeader) {
        let mut fault = None;
        match header.tag {
            Some(tag) => {
                if let Some(last) = self.sequence {
                    self.counters.missing += u64::from(tag.sequence.wrapping_sub(last).wrapping_sub(1));
                }
                self.sequence = Some(tag.sequence);
            }
            None if !self.in_step => fault = Some(Loss::First),
            None if self.tainted => fault = Some(Loss::Transfer),
            None => {}
        }
        self.tainted = false;
        self.open = Some(Open {
            frame: Frame {
                jpeg: Vec::with_capacity(self.expected_bytes),
                tag: header.tag,
                pts: header.pts,
                received_at: Instant::now(),
            },
            frame_id: header.frame_id,
            fault,
        });
    }

    fn close(&mut self) {
        let Some(Open { frame, fault, .. }) = self.open.take() else { return };
        self.in_step = true;
        match fault.or_else(|| (!is_jpeg(&frame.jpeg)).then_some(Loss::NotJpeg)) {
            Some(reason) => self.counters.count(reason),
            None => {
                self.counters.delivered += 1;
                self.counters.delivered_bytes += frame.jpeg.len() as u64;
                self.ready.push(frame);
            }
        }
    }
}

impl Open {
    /// Whether a payload belongs to this frame. With a tag its sequence number decides, which a stuck FID does not disturb.
    fn continues_with(&self, header: &PayloadHeader) -> bool {
        match (self.frame.tag, header.tag) {
            (Some(mine), Some(its)) => mine.sequence == its.sequence,
            _ => self.frame_id == header.frame_id,
        }
    }
}

/// SOI in front, EOI at the end; zeros after it are padding.
fn is_jpeg(bytes: &[u8]) -> bool {
    let end = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    bytes.starts_with(&[0xFF, 0xD8]) && end >= 4 && bytes[..end].ends_with(&[0xFF, 0xD9])
}
