//! A head that does not answer where Linux makes its caller wait for 5 s: nobody here waits so long.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

mod support;
#[allow(dead_code)] // each test program uses its part
mod usbfs;

use boxline_uvc::emulator::{Pipe, Settings, SoftwareHead};
use boxline_uvc::head::Lasers;
use boxline_uvc::{Device, ErrorKind, StreamSettings};
use std::time::{Duration, Instant};
use support::pictures;
use usbfs::{Plan, Plugged, plug};

/// USB_CTRL_SET_TIMEOUT of Linux.
const LINUX_WAITS: Duration = Duration::from_secs(5);

fn plugged(pipe: Pipe) -> Plugged {
    plug(
        SoftwareHead::new(Settings { pipe, ..Settings::default() }, pictures(u64::MAX, 5000)),
        Plan::default(),
    )
}

/// What a call gives, and that it did not wait for Linux.
fn at_once<T>(what: &str, call: impl FnOnce() -> T) -> T {
    let begun = Instant::now();
    let result = call();
    assert!(begun.elapsed() < LINUX_WAITS, "{what} took {:?}", begun.elapsed());
    result
}

fn open_descriptors() -> usize {
    std::fs::read_dir("/proc/self/fd").unwrap().count()
}

#[test]
fn no_call_waits_for_a_silent_head() {
    let (bulk, isochronous) = (plugged(Pipe::Bulk), plugged(Pipe::Isochronous));
    let before = open_descriptors();

    let device = Device::from_fd(isochronous.fd()).unwrap();
    isochronous.lock().plan.waits = LINUX_WAITS;
    // Three calls, of which each gives up after a second: the setting, back to setting 0, letting the interface go.
    let refused = at_once("start", || device.start(&StreamSettings::default()).err().unwrap());
    assert_eq!(refused.kind(), ErrorKind::Timeout, "{refused}");
    // Linux still holds its lock.
    let refused = at_once("lasers", || device.set_lasers(Lasers::ALL).unwrap_err());
    assert_eq!(refused.kind(), ErrorKind::Timeout, "{refused}");
    at_once("dropping the device", || drop(device)); // lasers off, letting go, closing

    let device = Device::from_fd(bulk.fd()).unwrap();
    let stream = device.start(&StreamSettings::default()).unwrap();
    bulk.lock().plan.waits = LINUX_WAITS;
    at_once("stop", || drop(stream.stop()));
    at_once("dropping the device", || drop(device));

    // What nobody waited for is cleaned up when Linux comes back.
    let calm = (0..300).any(|_| {
        std::thread::sleep(Duration::from_millis(50));
        open_descriptors() <= before
    });
    assert!(calm, "{before} descriptors before, {} after", open_descriptors());
    for bus in [bulk, isochronous] {
        bus.lock().plan = Plan::default();
        let stream = Device::from_fd(bus.fd()).unwrap().start(&StreamSettings::default()).unwrap();
        stream.next_frame(Duration::from_secs(1)).unwrap();
        stream.stop().unwrap();
    }
}
