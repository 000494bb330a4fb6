//! An open head: its stream is read by a thread of its own, which keeps the newest frame and draws the preview. Java's
//! threads wait here for frames, always with a limit.

use crate::guard::Failure;
use crate::handles::Handles;
use crate::steady::Steadiness;
use boxline::{Calibration, LiveFace, Settings, Tracker};
use boxline_proto::message::decode_calibration;
use boxline_uvc::head::{self, Lasers};
use boxline_uvc::{Device, Error, ErrorKind, Frame, Stream, StreamSettings, store};
use std::os::fd::{BorrowedFd, RawFd};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

pub(crate) static HEADS: Handles<Head> = Handles::new();
/// Frames that were captured, as the head sent them.
pub(crate) static FRAMES: Handles<Captured> = Handles::new();

/// How often a waiting call looks whether it should stop.
const NAP: Duration = Duration::from_millis(50);
/// Frames until a switch of the lasers must show; it takes 1 to 3.
const SWITCH_FRAMES: u64 = 30;
/// A head that gives no frame for so long is treated like one that was unplugged.
const FRAME_LIMIT: Duration = Duration::from_secs(3);

/// A frame with the head that took it.
pub(crate) struct Captured {
    pub jpeg: Vec<u8>,
    /// The same view with the lasers off.
    pub off: Option<Vec<u8>>,
    pub serial: String,
}

/// An open head.
pub(crate) struct Head {
    // Fields are dropped in this order: the stream's thread ends before the device is let go.
    running: Mutex<Option<Running>>,
    shared: Arc<Shared>,
    device: Device,
    pub serial: String,
}

struct Running {
    reader: JoinHandle<()>,
    stop: Arc<AtomicBool>,
}

#[derive(Default)]
struct Shared {
    latest: Mutex<Latest>,
    changed: Condvar,
    live: Mutex<Live>,
    #[cfg(target_os = "android")]
    window: Mutex<Option<crate::window::Window>>,
}

/// What the live view knows from earlier frames.
#[derive(Default)]
struct Live {
    tracker: Tracker,
    steadiness: Steadiness,
}

#[derive(Default)]
struct Latest {
    /// Frames since the stream was started.
    number: u64,
    frame: Option<Arc<Frame>>,
    ended: Option<Error>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Head {
    /// Opens the head behind a descriptor of usbfs. It is duplicated: the caller keeps and closes his own.
    pub fn open(fd: RawFd) -> Result<Self, Failure> {
        if fd < 0 {
            return Err(Failure::Argument(format!("file descriptor {fd} is none")));
        }
        // SAFETY: the caller keeps it open during this call; one that is closed makes the duplication fail, which is an
        // error and nothing worse.
        #[allow(unsafe_code)]
        let borrowed = unsafe { BorrowedFd::borrow_raw(fd) };
        let device = Device::from_fd(borrowed)?;
        if !device.is_head() {
            let text = "this camera has no lasers: it is no boxline head";
            return Err(Error::new(ErrorKind::Unsupported, text).into());
        }
        let serial = head::serial(&device)?;
        log::info!("head {serial} opened");
        Ok(Self { running: Mutex::new(None), shared: Arc::default(), device, serial })
    }

    /// The calibration that is stored in the head.
    pub fn calibration(&self) -> Result<Calibration, Failure> {
        let bytes = store::read(&self.device, |_, _| ())?;
        let calibration =
            decode_calibration(&bytes).map_err(|e| e.in_context("the calibration stored in the head"))?;
        self.check_calibration(&calibration)?;
        if calibration.covariance().is_none() {
            log::warn!(
                "head {}: the stored calibration has no covariance, sigmas lack its part; `boxline head calibration write` stores it",
                self.serial
            );
        }
        Ok(calibration)
    }

    /// A calibration belongs to one head: with another one's every size is wrong.
    pub fn check_calibration(&self, calibration: &Calibration) -> Result<(), Failure> {
        check_serial(&self.serial, calibration)
    }

    /// Lights the lasers and starts the stream. Does nothing if it runs already.
    pub fn start(&self) -> Result<(), Failure> {
        let mut running = lock(&self.running);
        if running.as_ref().is_some_and(|running| !running.reader.is_finished()) {
            return Ok(());
        }
        *lock(&self.shared.latest) = Latest::default();
        *lock(&self.shared.live) = Live::default();
        let stream = self.device.start(&StreamSettings { waiting_frames: 1 })?;
        for reason in stream.negotiated().mode.fallback.iter().chain(&stream.negotiated().fallback) {
            log::warn!("head {}: {reason}", self.serial);
        }
        self.device.set_lasers(Lasers::ALL)?;
        let stop = Arc::new(AtomicBool::new(false));
        let (shared, stopped) = (self.shared.clone(), stop.clone());
        let reader = std::thread::Builder::new()
            .name("boxline head".into())
            .spawn(move || read(stream, &shared, &stopped))
            .map_err(|e| Error::new(ErrorKind::Io, format!("starting the head's thread: {e}")))?;
        *running = Some(Running { reader, stop });
        Ok(())
    }

    /// Lasers off, stream off. Bounded in time, also when the head is gone or silent.
    pub fn stop(&self) {
        let running = lock(&self.running).take();
        if let Some(Running { reader, stop }) = running {
            stop.store(true, Ordering::SeqCst);
            reader.join().ok(); // a panic in it is in the log, and the stream is stopped either way
        }
    }

    /// Where the preview goes; `None` ends it.
    #[cfg(target_os = "android")]
    pub fn set_window(&self, window: Option<crate::window::Window>) {
        *lock(&self.shared.window) = window;
    }

    /// What the live view shows of a frame seen now, and whether the head is held still.
    pub fn see(
        &self,
        jpeg: &[u8],
        calibration: &Calibration,
        settings: &Settings,
    ) -> Result<(LiveFace, bool), Failure> {
        let mut live = lock(&self.shared.live);
        let frame = boxline::Frame::from_jpeg(jpeg).map_err(|e| e.in_context("frame"))?;
        let seen = live.tracker.next(&frame, calibration, settings)?;
        let steady = live.steadiness.next(seen.corners_px(), Instant::now());
        Ok((seen, steady))
    }

    /// The next frame that all lasers lit, and one without them right after it, if the head gives one.
    pub fn capture(&self, stop: Option<&AtomicBool>) -> Result<Captured, Failure> {
        let (number, lit) = self.lit_frame(self.newest(), stop)?;
        self.device.set_lasers(Lasers::OFF)?;
        let off = self.frame_with(Lasers::OFF, number, stop);
        self.device.set_lasers(Lasers::ALL)?;
        let off = match off {
            Ok((_, frame)) => Some(frame.jpeg.clone()),
            Err(Failure::Cancelled) => return Err(Failure::Cancelled),
            Err(failure) => {
                log::warn!("no picture with the lasers off: {failure:?}");
                None
            }
        };
        Ok(Captured { jpeg: lit.jpeg.clone(), off, serial: self.serial.clone() })
    }

    /// The newest frame that is later than number `after` and was lit by all lasers from beginning to end.
    pub fn lit_frame(&self, after: u64, stop: Option<&AtomicBool>) -> Result<(u64, Arc<Frame>), Failure> {
        self.frame_with(Lasers::ALL, after, stop)
    }

    /// The newest frame that is later than number `after` and saw these lasers from beginning to end, and no others.
    fn frame_with(
        &self,
        lasers: Lasers,
        after: u64,
        stop: Option<&AtomicBool>,
    ) -> Result<(u64, Arc<Frame>), Failure> {
        let mut last = after;
        let mut waited_until = Instant::now() + FRAME_LIMIT;
        let mut first = None;
        loop {
            if stop.is_some_and(|stop| stop.load(Ordering::Relaxed)) {
                return Err(Failure::Cancelled);
            }
            let mut latest = lock(&self.shared.latest);
            if latest.number <= last && latest.ended.is_none() {
                latest =
                    self.shared.changed.wait_timeout(latest, NAP).unwrap_or_else(PoisonError::into_inner).0;
            }
            let (number, frame, ended) = (latest.number, latest.frame.clone(), latest.ended.clone());
            drop(latest);
            if let Some(error) = ended {
                return Err(error.into());
            }
            let Some(frame) = frame.filter(|_| number > last) else {
                if lock(&self.running).is_none() {
                    return Err(Failure::Handle("the head's stream is not started".into()));
                }
                if Instant::now() > waited_until {
                    let text = format!("the head gave no frame within {} s", FRAME_LIMIT.as_secs());
                    return Err(Error::new(ErrorKind::Timeout, text).into());
                }
                continue;
            };
            let Some(tag) = frame.tag else {
                let text = "its frames do not say which lasers were on (uvc/PROTOCOL.md, \"Frame tag\")";
                return Err(Error::new(ErrorKind::Unsupported, text).into());
            };
            if tag.lasers == lasers.bits() && !tag.switched {
                return Ok((number, frame));
            }
            if number - *first.get_or_insert(number) > SWITCH_FRAMES {
                let text = format!(
                    "lasers {:04b} were asked for and do not show in {SWITCH_FRAMES} frames",
                    lasers.bits()
                );
                return Err(Error::new(ErrorKind::Protocol, text).into());
            }
            last = number;
            waited_until = Instant::now() + FRAME_LIMIT;
        }
    }

    /// The number of the newest frame.
    pub fn newest(&self) -> u64 {
        lock(&self.shared.latest).number
    }
}

impl Drop for Head {
    fn drop(&mut self) {
        self.stop();
        log::info!("head {} closed", self.serial);
    }
}

/// A frame and a calibration must be of the same head.
pub(crate) fn check_serial(serial: &str, calibration: &Calibration) -> Result<(), Failure> {
    if serial == calibration.serial() {
        return Ok(());
    }
    let text = format!("the calibration is of head {:?}, the head is {serial:?}", calibration.serial());
    Err(boxline::Error::new(boxline::ErrorKind::CalibrationMismatch, text).into())
}

fn read(stream: Stream, shared: &Shared, stop: &AtomicBool) {
    while !stop.load(Ordering::SeqCst) {
        match stream.next_frame(NAP) {
            Ok(frame) => {
                let frame = Arc::new(frame);
                let mut latest = lock(&shared.latest);
                latest.number += 1;
                latest.frame = Some(frame.clone());
                drop(latest);
                shared.changed.notify_all();
                #[cfg(target_os = "android")]
                if let Some(window) = &*lock(&shared.window) {
                    window.draw(&frame.jpeg);
                }
            }
            Err(e) if e.kind() == ErrorKind::Timeout => {}
            Err(e) => {
                log::warn!("the stream ended: {e}");
                lock(&shared.latest).ended = Some(e);
                shared.changed.notify_all();
                return;
            }
        }
    }
    match stream.stop() {
        Ok(counters) => log::info!("stream stopped: {counters:?}"),
        Err(e) => log::warn!("stopping the stream: {e}"),
    }
}
