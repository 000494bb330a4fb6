//! The header of a payload (UVC 1.5, 2.4.3.3), with what the head appends to it (uvc/PROTOCOL.md, "Frame tag").

/// A payload that cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PayloadFault {
    /// A header length below 2, beyond the payload, or too short for the fields it announces.
    HeaderLength,
}

/// What the head says about the frame that a payload belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameTag {
    /// Bit n: laser n + 1 was on during the whole exposure.
    pub lasers: u8,
    /// A laser was switched during the exposure.
    pub switched: bool,
    /// Counts the frames that the sensor took, also those that were never sent; wraps.
    pub sequence: u16,
    /// How many bytes of the frame were sent before this payload.
    pub offset_bytes: u32,
}

/// A payload's header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PayloadHeader {
    /// Bytes of the header.
    pub length: usize,
    /// Toggles with each frame.
    pub frame_id: bool,
    /// The frame's last payload.
    pub end_of_frame: bool,
    /// The device says that the frame is broken.
    pub error: bool,
    /// Of a still picture, not of the stream.
    pub still: bool,
    /// When the frame was taken, ticks of the device's clock.
    pub pts: Option<u32>,
    /// Device clock and bus frame number at the moment of sending.
    pub scr: Option<(u32, u16)>,
    /// What the head appends; other cameras have none.
    pub tag: Option<FrameTag>,
}

pub(crate) const FID: u8 = 1;
pub(crate) const EOF: u8 = 1 << 1;
pub(crate) const PTS: u8 = 1 << 2;
pub(crate) const SCR: u8 = 1 << 3;
pub(crate) const STILL: u8 = 1 << 5;
pub(crate) const ERR: u8 = 1 << 6;
const TAG_BYTES: usize = 8;
/// A header with PTS, SCR and tag.
pub(crate) const TAGGED_HEADER_BYTES: usize = 12 + TAG_BYTES;
/// First byte of a tag, which says that it is one, version 1.
const TAG_MARK: u8 = 0xB1;
const TAG_SWITCHED: u8 = 1 << 7;
/// Bits of the second byte that are 0.
const TAG_RESERVED: u8 = 0x70;

impl PayloadHeader {
    /// Reads the header at the start of a payload.
    pub fn parse(payload: &[u8]) -> Result<Self, PayloadFault> {
        let &[length, flags, ..] = payload else { return Err(PayloadFault::HeaderLength) };
        let header = payload.get(..usize::from(length)).ok_or(PayloadFault::HeaderLength)?;
        let mut rest = header.get(2..).ok_or(PayloadFault::HeaderLength)?;
        let mut take = |n: usize| -> Result<&[u8], PayloadFault> {
            let (taken, left) = rest.split_at_checked(n).ok_or(PayloadFault::HeaderLength)?;
            rest = left;
            Ok(taken)
        };
        let pts = if flags & PTS != 0 {
            let b = take(4)?;
            Some(u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        } else {
            None
        };
        let scr = if flags & SCR != 0 {
            let b = take(6)?;
            Some((u32::from_le_bytes([b[0], b[1], b[2], b[3]]), u16::from_le_bytes([b[4], b[5]]) & 0x7FF))
        } else {
            None
        };
        Ok(Self {
            length: usize::from(length),
            frame_id: flags & FID != 0,
            end_of_frame: flags & EOF != 0,
            error: flags & ERR != 0,
            still: flags & STILL != 0,
            pts,
            scr,
            tag: FrameTag::parse(rest),
        })
    }

    /// The bytes of this header; `length` is not looked at.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = vec![0, 0];
        let mut flags =
            [(self.frame_id, FID), (self.end_of_frame, EOF), (self.error, ERR), (self.still, STILL)]
                .iter()
                .filter(|(set, _)| *set)
                .fold(0, |flags, (_, bit)| flags | bit);
        if let Some(pts) = self.pts {
            flags |= PTS;
            bytes.extend(pts.to_le_bytes());
        }
        if let Some((clock, bus_frame)) = self.scr {
            flags |= SCR;
            bytes.extend(clock.to_le_bytes());
            bytes.extend(bus_frame.to_le_bytes());
        }
        if let Some(tag) = self.tag {
            bytes.extend([TAG_MARK, tag.lasers & 0xF | if tag.switched { TAG_SWITCHED } else { 0 }]);
            bytes.extend(tag.sequence.to_le_bytes());
            bytes.extend(tag.offset_bytes.to_le_bytes());
        }
        bytes[0] = u8::try_from(bytes.len()).unwrap_or(u8::MAX); // at most 20
        bytes[1] = flags;
        bytes
    }
}

impl FrameTag {
    fn parse(bytes: &[u8]) -> Option<Self> {
        let &[TAG_MARK, state, s0, s1, o0, o1, o2, o3] = bytes.get(..TAG_BYTES)? else { return None };
        (state & TAG_RESERVED == 0).then(|| Self {
            lasers: state & 0xF,
            switched: state & TAG_SWITCHED != 0,
            sequence: u16::from_le_bytes([s0, s1]),
            offset_bytes: u32::from_le_bytes([o0, o1, o2, o3]),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn tag() -> impl Strategy<Value = FrameTag> {
        (0u8..16, any::<bool>(), any::<u16>(), any::<u32>()).prop_map(
            |(lasers, switched, sequence, offset_bytes)| FrameTag {
                lasers,
                switched,
                sequence,
                offset_bytes,
            },
        )
    }

    proptest! {
        #[test]
        fn a_header_survives_the_wire(
            flags: [bool; 4], pts: Option<u32>, scr in proptest::option::of((any::<u32>(), 0u16..2048)),
            tag in proptest::option::of(tag()), data in proptest::collection::vec(any::<u8>(), 0..40),
        ) {
            let mut header = PayloadHeader {
                length: 0, frame_id: flags[0], end_of_frame: flags[1], error: flags[2], still: flags[3], pts, scr, tag,
            };
            let mut bytes = header.encode();
            header.length = bytes.len();
            bytes.extend(data);
            prop_assert_eq!(PayloadHeader::parse(&bytes), Ok(header));
        }

        #[test]
        fn any_bytes_are_a_header_inside_the_payload_or_a_fault(bytes in proptest::collection::vec(any::<u8>(), 0..40)) {
            if let Ok(header) = PayloadHeader::parse(&bytes) {
                prop_assert!(header.length >= 2 && header.length <= bytes.len());
            }
        }
    }

    #[test]
    fn announced_fields_need_their_room() {
        assert_eq!(PayloadHeader::parse(&[2, PTS]), Err(PayloadFault::HeaderLength));
        assert_eq!(PayloadHeader::parse(&[1, 0]), Err(PayloadFault::HeaderLength));
        assert_eq!(PayloadHeader::parse(&[12, 0, 0]), Err(PayloadFault::HeaderLength));
        assert_eq!(PayloadHeader::parse(&[]), Err(PayloadFault::HeaderLength));
    }
}
