//! What is done with bytes that a device sends, for the fuzz targets (uvc/fuzz) and for the run over their corpus in `cargo test`.
//! Nothing here may panic, and what comes out must be what it claims to be.

use boxline_uvc::bulk::BulkSplitter;
use boxline_uvc::descriptor::{Configuration, VideoFunction, lint};
use boxline_uvc::emulator::{Settings, SoftwareHead, WithoutBus, descriptors};
use boxline_uvc::head::{Control, Controls};
use boxline_uvc::mode::{alternates_to_try, choose_mode};
use boxline_uvc::store::{self, Page, StoreInfo};
use boxline_uvc::{Assembler, Error};
use std::cell::RefCell;

/// A configuration with all its descriptors.
pub fn descriptors(bytes: &[u8]) {
    lint(&descriptors::device(), bytes);
    let Ok(video) = Configuration::parse(bytes).and_then(|parsed| VideoFunction::parse(&parsed)) else {
        return;
    };
    if let Ok(mode) = choose_mode(&video) {
        assert!(mode.width > 0 && mode.height > 0 && mode.interval > 0);
        for stream in &video.streaming {
            for alternate in alternates_to_try(stream, 3072) {
                assert!(alternate.endpoint.bytes_per_interval() > 0);
            }
        }
    }
}

/// Payloads: each begins with a byte that says how it travels and one for its length.
pub fn payloads(mut bytes: &[u8]) {
    let mut frames = Assembler::new(64);
    let mut splitter = BulkSplitter::new(50);
    while let [how, length, rest @ ..] = bytes {
        let (payload, later) = rest.split_at(rest.len().min(usize::from(*length)));
        bytes = later;
        match how % 4 {
            0 => frames.failed_transfer(),
            1 => splitter.transfer(payload, how & 4 == 0, &mut frames),
            2 => frames.payload(payload),
            _ => splitter.failed(&mut frames),
        }
        for frame in frames.take_ready() {
            assert!(frame.jpeg.starts_with(&[0xFF, 0xD8]));
        }
    }
    frames.finish();
    let counters = frames.counters();
    assert!(counters.delivered_bytes >= 4 * counters.delivered);
}

/// A head that answers from the bytes, each answer with its length in front.
struct Answers<'a>(RefCell<&'a [u8]>);

impl Controls for Answers<'_> {
    fn get(&self, _: Control) -> Result<Vec<u8>, Error> {
        let mut bytes = self.0.borrow_mut();
        let [low, high, rest @ ..] = *bytes else { return Ok(vec![]) };
        let (answer, later) = rest.split_at(rest.len().min(usize::from(u16::from_le_bytes([*low, *high]))));
        *bytes = later;
        Ok(answer.to_vec())
    }

    fn set(&self, _: Control, _: &[u8]) -> Result<(), Error> {
        Ok(())
    }
}

/// The calibration store, read from a head that lies and written on one that is told nonsense.
pub fn store(bytes: &[u8]) {
    if let Ok(stored) = store::read(&Answers(RefCell::new(bytes)), |_, _| ()) {
        assert!(!stored.is_empty() && stored.len() <= store::MAX_BYTES);
    }
    if let Ok(page) = Page::decode(bytes) {
        assert_eq!(Page::decode(&page.encode()).map_err(|e| e.to_string()), Ok(page));
    }
    if let Some(info) = bytes.first_chunk() {
        drop(StoreInfo::decode(info));
    }
    let device = WithoutBus::new(SoftwareHead::new(Settings::default(), Box::new(|_| None)));
    for chunk in bytes.chunks(13) {
        let mut command = chunk.to_vec();
        command.resize(Control::StoreCommand.bytes(), 0);
        drop(device.set(Control::StoreCommand, &command));
        drop(device.set(Control::StorePage, &[chunk, &[0; 264]].concat()[..264]));
    }
    assert!(device.head().flash.page().is_none(), "nonsense was committed");
}
