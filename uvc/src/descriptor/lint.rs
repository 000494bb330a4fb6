//! Looks for contradictions in descriptors that hosts forgive: Linux, for one, accepts a wrong total length, a source that does
//! not exist and a wrong number of frame sizes. A head's firmware should have none of them.

use super::video::{NO_CAMERA, STREAMING, VC_HEADER, VIDEO};
use super::{Block, u16_at};
use super::{CS_INTERFACE, Configuration, Device, FormatKind, VideoFunction, blocks};
use std::collections::BTreeSet;

/// A contradiction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Where in the configuration's bytes.
    pub offset: usize,
    /// What is there and what should be.
    pub text: String,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "byte {}: {}", self.offset, self.text)
    }
}

/// All contradictions in a device's descriptors; empty if there are none.
pub fn lint(device: &[u8], configuration: &[u8]) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut say = |offset: usize, text: String| findings.push(Finding { offset, text });
    if let Err(Finding { offset, text }) = Device::read(device) {
        say(offset, format!("in the device descriptor: {text}"));
    }
    let parsed = match Configuration::read(configuration) {
        Ok(parsed) => parsed,
        Err(Finding { offset, text }) => {
            say(offset, text);
            return findings;
        }
    };
    parsed.skipped.iter().for_each(|finding| say(finding.offset, finding.text.clone()));
    let total = configuration.get(2..4).map_or(0, |b| usize::from(u16::from_le_bytes([b[0], b[1]])));
    if total != configuration.len() {
        say(2, format!("wTotalLength is {total}, {} bytes are there", configuration.len()));
    }
    let numbers: BTreeSet<u8> = parsed.interfaces.iter().map(|interface| interface.number).collect();
    if numbers.len() != usize::from(parsed.interface_count) {
        say(4, format!("bNumInterfaces is {}, {} are there", parsed.interface_count, numbers.len()));
    }
    for interface in &parsed.interfaces {
        if interface.endpoints.len() != usize::from(interface.endpoint_count) {
            let text = format!(
                "bNumEndpoints of interface {} is {}, {} are there",
                interface.number,
                interface.endpoint_count,
                interface.endpoints.len()
            );
            say(interface.offset, text);
        }
    }
    for (offset, claimed, found) in class_lengths(&parsed, configuration) {
        if claimed != found {
            say(
                offset,
                format!("wTotalLength of the class-specific block is {claimed}, {found} bytes are there"),
            );
        }
    }
    match VideoFunction::read(&parsed) {
        Ok(Some(video)) => lint_video(&video, &mut say),
        Ok(None) => say(0, NO_CAMERA.into()),
        Err(Finding { offset, text }) => say(offset, text),
    }
    findings
}

fn lint_video(video: &VideoFunction, say: &mut impl FnMut(usize, String)) {
    let ids: Vec<u8> = video.units.iter().map(|unit| unit.id).collect();
    for unit in &video.units {
        if unit.id == 0 {
            say(unit.offset, "a unit with the number 0".into());
        }
        if ids.iter().filter(|id| **id == unit.id).count() > 1 {
            say(unit.offset, format!("unit number {} is there more than once", unit.id));
        }
        for source in unit.sources.iter().filter(|source| !ids.contains(source)) {
            say(unit.offset, format!("unit {} is fed by unit {source}, which is not there", unit.id));
        }
        if let Some(extension) = &unit.extension {
            let bits: u32 = extension.controls.iter().map(|byte| byte.count_ones()).sum();
            if bits != u32::from(extension.control_count) {
                let count = extension.control_count;
                say(unit.offset, format!("bNumControls is {count}, bmControls has {bits} bits"));
            }
        }
    }
    for number in &video.streaming_numbers {
        if !video.streaming.iter().any(|stream| stream.number == *number) {
            say(0, format!("the header lists streaming interface {number}, which is not there"));
        }
    }
    for stream in &video.streaming {
        if !ids.contains(&stream.terminal_link) {
            let link = stream.terminal_link;
            say(
                0,
                format!(
                    "streaming interface {} is fed by terminal {link}, which is not there",
                    stream.number
                ),
            );
        }
        if stream.alternates.is_empty() {
            say(
                0,
                format!("no setting of interface {} has endpoint {:#04x}", stream.number, stream.endpoint),
            );
        }
        for format in stream.formats.iter().filter(|format| format.kind == FormatKind::Mjpeg) {
            if format.frames.len() != usize::from(format.frame_count) {
                let (count, found) = (format.frame_count, format.frames.len());
                say(format.offset, format!("bNumFrameDescriptors is {count}, {found} are there"));
            }
            for frame in &format.frames {
                if frame.width == 0 || frame.height == 0 {
                    say(format.offset, format!("frame size {} has a zero in it", frame.index));
                }
                if let Some(text) = frame.intervals.contradiction() {
                    say(format.offset, format!("frame size {} has {text}", frame.index));
                }
                if !frame.intervals.has(frame.default_interval) {
                    say(
                        format.offset,
                        format!("the default interval of frame size {} is not listed", frame.index),
                    );
                }
            }
        }
    }
}

/// For each class-specific header: its offset, the total it claims, and the bytes that stand there.
fn class_lengths(parsed: &Configuration, bytes: &[u8]) -> Vec<(usize, usize, usize)> {
    let mut lengths = Vec::new();
    for interface in parsed.interfaces.iter().filter(|i| i.class.0 == VIDEO && i.alternate == 0) {
        let run: Vec<Block<'_>> = blocks(bytes)
            .flatten()
            .skip_while(|block| block.offset <= interface.offset)
            .take_while(|block| block.kind() == CS_INTERFACE)
            .collect();
        let Some(head) = run.first() else { continue };
        // Both headers, VC and VS input, have subtype 1; the total stands at 5 in the one and at 4 in the other.
        let at = if interface.class.1 == STREAMING { 4 } else { 5 };
        if head.bytes.get(2) == Some(&VC_HEADER)
            && let Ok(claimed) = u16_at(head, at)
        {
            let found = run.iter().map(|block| block.bytes.len()).sum();
            lengths.push((head.offset, usize::from(claimed), found));
        }
    }
    lengths
}
