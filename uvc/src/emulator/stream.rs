//! The stream of the software head: frames cut into payloads with header and tag, spoilt where a fault is asked for.

use super::{Fault, FrameRequest};
use crate::payload::{FrameTag, PayloadHeader};
use std::sync::Arc;

/// A frame that is being sent.
pub(super) struct Sending {
    jpeg: Arc<[u8]>,
    shot: FrameRequest,
    frame_id: bool,
    tagged: bool,
    fault: Option<Fault>,
    /// Bytes of the frame that were sent.
    sent: usize,
    /// Payloads that were sent.
    payloads: u32,
    clock: u32,
    /// The payload that came before, for the fault that sends it twice.
    again: Option<Vec<u8>>,
}

impl Sending {
    pub fn new(
        jpeg: Arc<[u8]>,
        shot: FrameRequest,
        frame_id: bool,
        tagged: bool,
        clock: u32,
        fault: Option<Fault>,
    ) -> Self {
        let jpeg = match fault {
            Some(Fault::TornJpeg) => jpeg[..jpeg.len() / 2].into(),
            Some(Fault::NotJpeg) => jpeg.iter().map(|byte| !byte).collect(),
            Some(Fault::Huge) => {
                let mut huge = jpeg.to_vec();
                huge.resize(crate::mode::MAX_FRAME_BYTES + 1, 0x55);
                huge.into()
            }
            _ => jpeg,
        };
        Self { jpeg, shot, frame_id, tagged, fault, sent: 0, payloads: 0, clock, again: None }
    }

    pub fn is_done(&self) -> bool {
        self.sent >= self.jpeg.len() && self.again.is_none()
    }

    /// The next payload, of at most `room` bytes with its header.
    pub fn payload(&mut self, room: usize) -> Vec<u8> {
        if let Some(again) = self.again.take().filter(|again| again.len() <= room) {
            return again;
        }
        let mut header = PayloadHeader {
            length: 0,
            frame_id: self.frame_id,
            end_of_frame: false,
            error: false,
            still: false,
            pts: Some(self.clock),
            scr: Some((self.clock, ((self.clock / 1000) & 0x7FF) as u16)),
            tag: self.tagged.then(|| FrameTag {
                lasers: self.shot.lasers.bits(),
                switched: self.shot.switched,
                sequence: self.shot.sequence,
                offset_bytes: u32::try_from(self.sent).unwrap_or(u32::MAX),
            }),
        };
        let head_bytes = header.encode().len();
        let take = (self.jpeg.len() - self.sent).min(room.saturating_sub(head_bytes));
        let first = self.payloads == 0;
        self.payloads += 1;
        let data = &self.jpeg[self.sent..self.sent + take];
        self.sent += take;
        let last = self.sent == self.jpeg.len();
        header.end_of_frame = last && self.fault != Some(Fault::LostEof);
        header.error = last && self.fault == Some(Fault::ErrorBit);
        let mut payload = header.encode();
        payload.extend(data);
        // Faults hit the first payload, which every frame has, or the last.
        match self.fault {
            Some(Fault::LostPayload) if first && !last => return self.payload(room),
            Some(Fault::LostPayload) if first => payload.truncate(head_bytes),
            Some(Fault::TwicePayload) if first => self.again = Some(payload.clone()),
            Some(Fault::HeaderLength(length)) if first => payload[0] = length,
            Some(Fault::TooLongHeader) if first => payload = vec![payload.len().min(254) as u8 + 1; 2],
            _ => {}
        }
        payload
    }
}
