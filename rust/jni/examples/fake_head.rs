//! A head for tests of the Java side: loaded before the JVM (LD_PRELOAD), this library takes `ioctl` and `poll` over and puts the software
//! head behind the unmodified libusb, as the tests of `uvc` do. Java drives it through `dev.boxline.testing.FakeHead`.
//! `BOXLINE_FAKE_HEAD` names the folder of a recording.
#![allow(unsafe_code)] // functions that Java finds by name
#![allow(clippy::unwrap_used)] // a tool of tests

#[allow(dead_code)] // uses a part of what the tests of `uvc` use
#[path = "../../../uvc/tests/usbfs/mod.rs"]
mod usbfs;

use boxline_proto::json::{Laser, read_calibration, read_recording};
use boxline_proto::message::encode_calibration;
use boxline_uvc::emulator::{FrameRequest, Settings, SoftwareHead, WithoutBus};
use boxline_uvc::head::Lasers;
use boxline_uvc::store;
use std::ffi::{c_int, c_void};
use std::os::fd::AsRawFd;
use std::path::PathBuf;
use std::sync::atomic::{AtomicI32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use usbfs::{Plan, Plugged, UrbFault, plug};

static PLUGGED: Mutex<Option<Plugged>> = Mutex::new(None);
/// Which lit frame of the recording the head sees, from as many as there are on each once more in another exposure; below 0 nothing that
/// lasers light, `TORN` frames of which half is missing.
static VIEW: AtomicI32 = AtomicI32::new(0);

const TORN: c_int = -2;
const EMPTY_STORE: c_int = 1;
const OTHER_SERIAL: c_int = 2;

/// `static native int plug(int how)`: plugs a head in; gives its descriptor. Bit 0: nothing is stored in it, bit 1: its serial
/// number is not that of the calibration.
#[unsafe(no_mangle)]
pub extern "C" fn Java_dev_boxline_testing_FakeHead_plug(
    _: *mut c_void,
    _: *mut c_void,
    how: c_int,
) -> c_int {
    let folder = PathBuf::from(std::env::var_os("BOXLINE_FAKE_HEAD").unwrap());
    let recording = read_recording(&folder).unwrap();
    let calibration = read_calibration(&recording.calibration_file).unwrap();
    let read = |laser| {
        let chosen = recording.frames.iter().filter(move |frame| frame.laser == laser);
        chosen.map(|frame| Arc::from(std::fs::read(&frame.file).unwrap())).collect::<Vec<Arc<[u8]>>>()
    };
    let (mut lit, dark) = (read(Laser::On), read(Laser::Off));
    lit.extend(lit.clone().iter().map(|jpeg| exposed_again(jpeg)));
    // With the end of a JPEG, without which it would not leave the driver.
    let torn: Arc<[u8]> = [&lit[0][..lit[0].len() / 2], &[0xFF, 0xD9]].concat().into();
    let source = move |shot: FrameRequest| {
        // A sensor's pace; the bus inside this process has none.
        std::thread::sleep(Duration::from_millis(30));
        let view = VIEW.load(Ordering::SeqCst);
        if view == TORN {
            return Some(torn.clone());
        }
        let frames = if shot.lasers == Lasers::ALL { &lit } else { &dark };
        Some(usize::try_from(view).map_or(&dark[0], |view| &frames[view % frames.len()]).clone())
    };
    let serial =
        if how & OTHER_SERIAL != 0 { "OTHER-0001".to_owned() } else { calibration.serial().to_owned() };
    let head =
        WithoutBus::new(SoftwareHead::new(Settings { serial, ..Settings::default() }, Box::new(source)));
    if how & EMPTY_STORE == 0 {
        store::write(&head, &encode_calibration(&calibration), |_, _| ()).unwrap();
    }
    let plugged = plug(head.0.into_inner().unwrap(), Plan::default());
    let fd = plugged.fd().as_raw_fd();
    *PLUGGED.lock().unwrap() = Some(plugged);
    fd
}

/// The same picture with other pixels, as another exposure has them: one frequency of its blocks has another step.
fn exposed_again(jpeg: &[u8]) -> Arc<[u8]> {
    let mut jpeg = jpeg.to_vec();
    let steps = jpeg.windows(2).position(|marker| marker == [0xFF, 0xDB]).unwrap() + 5;
    jpeg[steps + 20] += 1;
    jpeg.into()
}

/// `static native void show(int view)`: which view it sees from now on.
#[unsafe(no_mangle)]
pub extern "C" fn Java_dev_boxline_testing_FakeHead_show(_: *mut c_void, _: *mut c_void, view: c_int) {
    VIEW.store(view, Ordering::SeqCst);
}

/// `static native void pull(int blocks)`: the cable comes out after so many more blocks of the stream; 0: now.
#[unsafe(no_mangle)]
pub extern "C" fn Java_dev_boxline_testing_FakeHead_pull(_: *mut c_void, _: *mut c_void, blocks: c_int) {
    if let Some(plugged) = &*PLUGGED.lock().unwrap() {
        if blocks == 0 {
            plugged.unplug();
        } else {
            let mut left = blocks;
            plugged.lock().plan.finish = Box::new(move |_| {
                left -= 1;
                (left <= 0).then_some(UrbFault::Unplug)
            });
        }
    }
}

/// `static native int lasers()`: which are lit.
#[unsafe(no_mangle)]
pub extern "C" fn Java_dev_boxline_testing_FakeHead_lasers(_: *mut c_void, _: *mut c_void) -> c_int {
    let plugged = PLUGGED.lock().unwrap();
    plugged.as_ref().map_or(0, |plugged| plugged.lock().head.lasers(Duration::ZERO).bits().into())
}

/// `static native int claims()`: interfaces that are held.
#[unsafe(no_mangle)]
pub extern "C" fn Java_dev_boxline_testing_FakeHead_claims(_: *mut c_void, _: *mut c_void) -> c_int {
    PLUGGED.lock().unwrap().as_ref().map_or(0, |plugged| plugged.lock().claims)
}
