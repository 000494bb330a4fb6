//! The negotiation of a stream: the probe and commit controls (UVC 1.5, table 4-75), of 26, 34 or 48 bytes by version.

use crate::descriptor::UvcVersion;
use crate::{Error, ErrorKind};

/// What host and device agree on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Probe {
    /// Bit 0: the interval is fixed, quality may give.
    pub hint: u16,
    /// bFormatIndex.
    pub format_index: u8,
    /// bFrameIndex.
    pub frame_index: u8,
    /// Units of 100 ns.
    pub frame_interval: u32,
    /// dwMaxVideoFrameSize, bytes.
    pub max_frame_bytes: u32,
    /// dwMaxPayloadTransferSize, bytes with the payload header.
    pub max_payload_bytes: u32,
    /// dwClockFrequency, from 1.1 on; 0: as in the descriptors.
    pub clock_hz: u32,
}

impl UvcVersion {
    /// Bytes of probe and commit.
    pub fn probe_bytes(self) -> usize {
        match self {
            Self::V1_0 => 26,
            Self::V1_1 => 34,
            Self::V1_5 => 48,
        }
    }
}

impl Probe {
    /// Bytes for a device; `length` is 26, 34 or 48, or what its GET_LEN says. Fields that do not fit are left out.
    pub fn encode(&self, length: usize) -> Vec<u8> {
        let mut bytes = vec![0; 48];
        bytes[0..2].copy_from_slice(&self.hint.to_le_bytes());
        bytes[2] = self.format_index;
        bytes[3] = self.frame_index;
        bytes[4..8].copy_from_slice(&self.frame_interval.to_le_bytes());
        bytes[18..22].copy_from_slice(&self.max_frame_bytes.to_le_bytes());
        bytes[22..26].copy_from_slice(&self.max_payload_bytes.to_le_bytes());
        bytes[26..30].copy_from_slice(&self.clock_hz.to_le_bytes());
        bytes.resize(length, 0);
        bytes
    }

    /// A device's answer. Devices answer with more or fewer bytes than their version says; 26 are needed.
    pub fn decode(bytes: &[u8]) -> Result<Self, Error> {
        if bytes.len() < 26 {
            let text = format!("probe: {} bytes, at least 26 are needed", bytes.len());
            return Err(Error::new(ErrorKind::Protocol, text));
        }
        let u32_at =
            |at: usize| bytes.get(at..at + 4).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        Ok(Self {
            hint: u16::from_le_bytes([bytes[0], bytes[1]]),
            format_index: bytes[2],
            frame_index: bytes[3],
            frame_interval: u32_at(4),
            max_frame_bytes: u32_at(18),
            max_payload_bytes: u32_at(22),
            clock_hz: u32_at(26),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn fields_survive_the_wire_at_every_length(
            hint: u16, format_index: u8, frame_index: u8, frame_interval: u32, max_frame_bytes: u32,
            max_payload_bytes: u32, clock_hz: u32,
        ) {
            let sent = Probe {
                hint, format_index, frame_index, frame_interval, max_frame_bytes, max_payload_bytes, clock_hz,
            };
            for version in [UvcVersion::V1_0, UvcVersion::V1_1, UvcVersion::V1_5] {
                let bytes = sent.encode(version.probe_bytes());
                prop_assert_eq!(bytes.len(), version.probe_bytes());
                let clock_hz = if version == UvcVersion::V1_0 { 0 } else { clock_hz };
                prop_assert_eq!(Probe::decode(&bytes).unwrap(), Probe { clock_hz, ..sent });
            }
        }

        #[test]
        fn any_bytes_are_an_answer_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..60)) {
            prop_assert_eq!(Probe::decode(&bytes).is_ok(), bytes.len() >= 26);
        }
    }
}
