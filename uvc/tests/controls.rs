//! Lasers and the calibration store, against the software head without a bus in between.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

mod support;

use boxline_uvc::ErrorKind;
use boxline_uvc::emulator::{LASER_HOLD, Pipe, Settings, SoftwareHead, WithoutBus};
use boxline_uvc::head::{self, Control, Controls, Lasers};
use boxline_uvc::store;
use proptest::prelude::*;
use std::time::Duration;

fn software_head() -> WithoutBus {
    WithoutBus::new(SoftwareHead::new(Settings::default(), support::pictures(0, 4000)))
}

#[test]
fn lasers_power_serial_and_temperature_are_read_and_written() {
    let device = software_head();
    head::set_lasers(&device, Lasers::from_bits(0b0101).unwrap()).unwrap();
    assert_eq!(head::lasers(&device).unwrap().bits(), 0b0101);
    head::set_power_permille(&device, [0, 250, 999, 1000]).unwrap();
    assert_eq!(head::power_permille(&device).unwrap(), [0, 250, 999, 1000]);
    assert_eq!(head::serial(&device).unwrap(), "SOFT-0001");
    assert_eq!(head::temperature_celsius(&device).unwrap(), 25.0);
    assert_eq!(head::set_power_permille(&device, [1001; 4]).unwrap_err().kind(), ErrorKind::InvalidArgument);
    assert_eq!(Lasers::from_bits(0x10).unwrap_err().kind(), ErrorKind::InvalidArgument);
    assert_eq!(device.set(Control::Lasers, &[0x1F]).unwrap_err().kind(), ErrorKind::Refused);
    assert_eq!(head::lasers(&device).unwrap().bits(), 0b0101, "a refused write changes nothing");
}

#[test]
fn lasers_go_out_by_themselves_and_with_the_stream() {
    let device = software_head();
    head::set_lasers(&device, Lasers::ALL).unwrap();
    let mut device = device.0.into_inner().unwrap();
    assert_eq!(device.lasers(LASER_HOLD - Duration::from_millis(1)), Lasers::ALL);
    assert_eq!(device.lasers(LASER_HOLD), Lasers::OFF, "nobody has read the stream or set them again");
    device.clear_halt(true);
    assert_eq!(device.lasers(Duration::ZERO), Lasers::ALL, "a halt that is cleared does not stop the stream");
    device.clear_halt(false);
    assert_eq!(device.lasers(Duration::ZERO), Lasers::OFF);
    let settings = Settings { pipe: Pipe::Isochronous, ..Settings::default() };
    let device = WithoutBus::new(SoftwareHead::new(settings, support::pictures(0, 4000)));
    device.head().set_alternate(3, Duration::ZERO).unwrap();
    head::set_lasers(&device, Lasers::ALL).unwrap();
    device.head().set_alternate(0, Duration::ZERO).unwrap();
    assert_eq!(head::lasers(&device).unwrap(), Lasers::OFF);
}

fn bytes(count: usize, seed: u8) -> Vec<u8> {
    (0..count).map(|i| (i as u8).wrapping_mul(31).wrapping_add(seed)).collect()
}

#[test]
fn the_store_gives_back_what_was_written() {
    let device = software_head();
    assert_eq!(store::read(&device, |_, _| ()).unwrap_err().kind(), ErrorKind::Store);
    for (count, seed) in [(1, 1), (255, 2), (256, 3), (257, 4), (5000, 5), (16384, 6)] {
        let written = bytes(count, seed);
        let mut progress = Vec::new();
        let info = store::write(&device, &written, |done, all| progress.push((done, all))).unwrap();
        assert_eq!(info.generation, u32::from(seed));
        let pages = count.div_ceil(256);
        assert_eq!(progress, (1..=pages).map(|done| (done, pages)).collect::<Vec<_>>());
        assert_eq!(store::read(&device, |_, _| ()).unwrap(), written);
    }
    for wrong in [0, 16385] {
        let error = store::write(&device, &bytes(wrong, 9), |_, _| ()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidArgument);
    }
}

/// Power fails before each single write to the memory in turn: the head has the old contents or the new ones, whole.
#[test]
fn a_cable_pulled_in_mid_write_leaves_the_old_calibration() {
    let (old, new) = (bytes(700, 1), bytes(1500, 2));
    let writes = 1 + 6 + 1; // begin, pages, commit
    for cut in 0..=writes {
        let device = software_head();
        store::write(&device, &old, |_, _| ()).unwrap();
        device.head().flash.fail_power_after(cut);
        let result = store::write(&device, &new, |_, _| ());
        device.head().power_up();
        let found = store::read(&device, |_, _| ()).unwrap();
        assert_eq!(result.is_ok(), cut == writes, "cut before write {cut}: {result:?}");
        assert!(found == if cut == writes { &new[..] } else { &old[..] }, "cut before write {cut}");
        // And the next attempt succeeds.
        store::write(&device, &new, |_, _| ()).unwrap();
    }
}

type Lie = fn(&mut Vec<u8>);

/// Changes one answer of a head.
struct Lying<'a>(&'a WithoutBus, Control, Lie);

impl Controls for Lying<'_> {
    fn get(&self, control: Control) -> Result<Vec<u8>, boxline_uvc::Error> {
        let mut answer = self.0.get(control)?;
        if control == self.1 {
            (self.2)(&mut answer);
        }
        Ok(answer)
    }

    fn set(&self, control: Control, value: &[u8]) -> Result<(), boxline_uvc::Error> {
        self.0.set(control, value)
    }
}

#[test]
fn a_store_that_lies_is_not_believed() {
    let device = software_head();
    store::write(&device, &bytes(700, 1), |_, _| ()).unwrap();
    let lies: [(Control, Lie); 9] = [
        (Control::StoreInfo, |a| a[2] = 0xFF), // 16 MB
        (Control::StoreInfo, |a| a[4] ^= 1),   // another CRC
        (Control::StoreInfo, |a| a[13] = 0),   // pages of 0 bytes
        (Control::StoreInfo, |a| a.truncate(15)),
        (Control::StorePage, |a| a[0] ^= 1),
        (Control::StorePage, |a| a[2] ^= 1),
        (Control::StorePage, |a| a[3] = 0xFF),
        (Control::StorePage, |a| a[8] ^= 1),
        (Control::StorePage, |a| a.truncate(7)),
    ];
    for (number, (control, lie)) in lies.into_iter().enumerate() {
        let error = store::read(&Lying(&device, control, lie), |_, _| ()).unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::Protocol | ErrorKind::Store), "lie {number}: {error}");
    }
    let deaf = Lying(&device, Control::Lasers, |a| a[0] = 0);
    assert_eq!(head::set_lasers(&deaf, Lasers::ALL).unwrap_err().kind(), ErrorKind::Refused);
    let nameless = Lying(&device, Control::Serial, |a| a.fill(0));
    assert_eq!(head::serial(&nameless).unwrap_err().kind(), ErrorKind::Protocol);
}

proptest! {
    #[test]
    fn any_request_is_answered_or_refused(
        requests in proptest::collection::vec((1u8..10, proptest::collection::vec(any::<u8>(), 0..300)), 0..30),
    ) {
        let device = software_head();
        let stored = bytes(300, 7);
        store::write(&device, &stored, |_, _| ()).unwrap();
        for (selector, value) in requests {
            let Some(control) = Control::from_selector(selector) else { continue };
            let mut value = value;
            value.resize(control.bytes(), 0);
            drop(device.set(control, &value));
            drop(device.get(control));
        }
        // Random bytes cannot have the right CRC twice: the old contents are there.
        prop_assert_eq!(store::read(&device, |_, _| ()).unwrap(), stored);
    }
}
