//! Which format, size, rate and alternate setting to ask a head for, and why it is not the preferred one.

use crate::descriptor::{Alternate, EndpointKind, FormatKind, StreamingInterface, VideoFunction};
use crate::{Error, ErrorKind};

/// Columns and rows of the head's sensor.
pub const PREFERRED_SIZE: (u16, u16) = (2592, 1944);
/// 15 frames a second, in units of 100 ns.
pub const PREFERRED_INTERVAL: u32 = 666_666;
/// The largest frame that is taken, whatever a device claims: six times what the sensor gives at its best quality.
pub const MAX_FRAME_BYTES: usize = 10_000_000;

/// What to ask for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mode {
    /// Number of the streaming interface.
    pub interface: u8,
    /// bFormatIndex.
    pub format_index: u8,
    /// bFrameIndex.
    pub frame_index: u8,
    /// Columns.
    pub width: u16,
    /// Rows.
    pub height: u16,
    /// Units of 100 ns.
    pub interval: u32,
    /// Why this is not what was preferred, for people.
    pub fallback: Option<String>,
}

/// Picks MJPEG in the preferred size at the preferred rate, or what comes nearest: the size with the most pixels that are not more
/// than preferred (the smallest if all are larger), the rate that is nearest.
pub fn choose_mode(video: &VideoFunction) -> Result<Mode, Error> {
    let (width, height) = PREFERRED_SIZE;
    let wanted = u32::from(width) * u32::from(height);
    let candidates = video.streaming.iter().flat_map(|stream| {
        let mjpeg = stream.formats.iter().filter(|format| format.kind == FormatKind::Mjpeg);
        mjpeg.flat_map(move |format| format.frames.iter().map(move |frame| (stream, format, frame)))
    });
    let rank = |(stream, _, frame): &(&StreamingInterface, _, &crate::descriptor::FrameSize)| {
        let pixels = u32::from(frame.width) * u32::from(frame.height);
        let size = if pixels <= wanted { i64::from(pixels) } else { -i64::from(pixels) };
        (!stream.alternates.is_empty(), (frame.width, frame.height) == PREFERRED_SIZE, size)
    };
    let (stream, format, frame) = candidates
        .filter(|(_, _, frame)| frame.width > 0 && frame.height > 0)
        .max_by_key(rank)
        .ok_or_else(|| Error::new(ErrorKind::Unsupported, "no MJPEG frame size in the descriptors"))?;
    if stream.alternates.is_empty() {
        let text = format!("no alternate setting of interface {} carries the stream", stream.number);
        return Err(Error::new(ErrorKind::Unsupported, text));
    }
    let interval = frame.intervals.nearest(PREFERRED_INTERVAL).unwrap_or(PREFERRED_INTERVAL);
    let mut reasons = Vec::new();
    if (frame.width, frame.height) != PREFERRED_SIZE {
        reasons.push(format!("no {width}x{height}, taking {}x{}", frame.width, frame.height));
    }
    // Devices round 1/15 s in different ways; a thousandth of it is no other rate.
    if interval.abs_diff(PREFERRED_INTERVAL) > PREFERRED_INTERVAL / 1000 {
        reasons.push(format!("no 15 frames/s, taking {:.1}", 1e7 / f64::from(interval)));
    }
    Ok(Mode {
        interface: stream.number,
        format_index: format.index,
        frame_index: frame.index,
        width: frame.width,
        height: frame.height,
        interval,
        fallback: (!reasons.is_empty()).then(|| reasons.join("; ")),
    })
}

/// Alternate settings to try, best first: bulk, then the smallest isochronous one that holds the negotiated payload, then ever
/// smaller ones, which are for a bus that has no room. A payload of 0 or beyond all settings (devices do claim so) means the largest.
pub fn alternates_to_try(stream: &StreamingInterface, max_payload_bytes: u32) -> Vec<Alternate> {
    let needed = usize::try_from(max_payload_bytes).unwrap_or(usize::MAX);
    let bulk = stream.alternates.iter().filter(|a| a.endpoint.kind == EndpointKind::Bulk);
    let iso: Vec<&Alternate> =
        stream.alternates.iter().filter(|a| a.endpoint.kind == EndpointKind::Isochronous).collect();
    let fits = iso.iter().position(|a| needed > 0 && a.endpoint.bytes_per_interval() >= needed);
    let first = fits.map_or(iso.len(), |position| position + 1);
    bulk.copied().chain(iso[..first].iter().rev().map(|alternate| **alternate)).collect()
}
