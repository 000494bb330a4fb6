//! Where payloads begin and end in the transfers of a bulk pipe: a payload ends with a short packet or at the negotiated maximum,
//! and may span transfers (UVC 1.5, 2.4.3.2.1).

use crate::assembly::Assembler;

/// Cuts transfers into payloads.
pub struct BulkSplitter {
    max_payload_bytes: usize,
    /// Bytes of the payload under way; 0: the next byte starts one.
    have: usize,
    /// A transfer failed, and where the next payload starts is not known yet.
    lost: bool,
}

impl BulkSplitter {
    /// A maximum of 0 means that only short packets end payloads.
    pub fn new(max_payload_bytes: usize) -> Self {
        Self {
            max_payload_bytes: if max_payload_bytes == 0 { usize::MAX } else { max_payload_bytes },
            have: 0,
            lost: false,
        }
    }

    /// The bytes of one transfer; `short` says that it was not filled, so its last packet was short.
    pub fn transfer(&mut self, mut bytes: &[u8], short: bool, frames: &mut Assembler) {
        if self.lost && !frames.is_tagged_start(bytes) {
            self.lost = !short; // after a short packet comes a payload
            return;
        }
        self.lost = false;
        while !bytes.is_empty() {
            let (piece, rest) = bytes.split_at(bytes.len().min(self.max_payload_bytes - self.have));
            if self.have == 0 {
                frames.start(piece)
            } else {
                frames.more(piece)
            }
            self.have += piece.len();
            bytes = rest;
            if self.have == self.max_payload_bytes {
                self.end(frames);
            }
        }
        if short {
            self.end(frames);
        }
    }

    /// A transfer failed: nothing counts until a payload surely starts.
    pub fn failed(&mut self, frames: &mut Assembler) {
        self.have = 0;
        self.lost = true;
        frames.failed_transfer();
    }

    fn end(&mut self, frames: &mut Assembler) {
        if self.have > 0 {
            frames.end();
        }
        self.have = 0;
    }
}
