//! A running stream: negotiates it, keeps transfers queued, hands whole frames to the reader. Stopping is bounded in time.

use crate::assembly::{Assembler, Counters, Frame};
use crate::bulk::BulkSplitter;
use crate::descriptor::{Alternate, EndpointKind, StreamingInterface};
use crate::device::{Device, GET_CUR, GET_LEN, Inner, SET_CUR};
use crate::mode::{Mode, alternates_to_try, choose_mode};
use crate::probe::Probe;
use crate::sys::{ControlData, Queue, Status, Transfer};
use crate::{Error, ErrorKind};
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

const VS_PROBE: u16 = 0x0100;
const VS_COMMIT: u16 = 0x0200;
/// Bytes of a bulk transfer, and how many are queued: half a megabyte, 15 ms at the most that high speed carries.
const BULK_BYTES: usize = 64 * 1024;
const BULK_TRANSFERS: usize = 8;
/// Packets of an isochronous transfer, and how many transfers are queued: 32 ms. Some phones refuse transfers of 32 packets.
const ISO_PACKETS: usize = 16;
const ISO_TRANSFERS: usize = 16;
/// How long stopping may take until cancelled transfers are back.
const STOP_LIMIT: Duration = Duration::from_secs(2);
/// How often the pump looks whether it should stop.
const NAP: Duration = Duration::from_millis(20);
/// A system that takes no transfer for so long will take none.
const STARVED_LIMIT: Duration = Duration::from_secs(1);
/// A pipe that halts so often without a frame in between is broken.
const MAX_STALLS: u32 = 5;

/// How a stream is run.
#[derive(Clone, Debug)]
pub struct StreamSettings {
    /// Frames that wait for a slow reader; then the oldest is dropped and counted.
    pub waiting_frames: usize,
}

impl Default for StreamSettings {
    fn default() -> Self {
        Self { waiting_frames: 4 }
    }
}

/// What was agreed on.
#[derive(Clone, Debug)]
pub struct NegotiatedMode {
    /// Format, size and rate, with the reason if they are not the preferred ones.
    pub mode: Mode,
    /// What the device answered to the probe.
    pub probe: Probe,
    /// The alternate setting in use.
    pub alternate: Alternate,
    /// Why the alternate setting, or the number of transfers, is not the first choice, for people.
    pub fallback: Vec<String>,
}

struct State {
    frames: VecDeque<Frame>,
    counters: Counters,
    slow_reader: (u64, u64),
    stop: bool,
    /// The pump has ended; the error if that was not asked for.
    ended: Option<Option<Error>>,
}

struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, state: MutexGuard<'a, State>, limit: Duration) -> MutexGuard<'a, State> {
        self.changed.wait_timeout(state, limit).unwrap_or_else(PoisonError::into_inner).0
    }
}

/// A running stream. Dropping it stops it.
pub struct Stream {
    inner: Arc<Inner>,
    shared: Arc<Shared>,
    pump: Option<JoinHandle<()>>,
    negotiated: NegotiatedMode,
}

impl Device {
    /// Starts the stream.
    pub fn start(&self, settings: &StreamSettings) -> Result<Stream, Error> {
        let mode = choose_mode(self.video())?;
        let interface = mode.interface;
        self.inner
            .handle
            .claim(interface)
            .map_err(|code| code.error(format!("taking streaming interface {interface}")))?;
        Stream::start(&self.inner, mode, settings).inspect_err(|_| {
            // The first failure is what counts.
            self.inner.handle.set_alternate(interface, 0).ok();
            self.inner.handle.release(interface).ok();
        })
    }
}

impl Stream {
    fn start(inner: &Arc<Inner>, mode: Mode, settings: &StreamSettings) -> Result<Self, Error> {
        let streaming = inner.video.streaming.iter().find(|stream| stream.number == mode.interface);
        let streaming = streaming
            .ok_or_else(|| Error::new(ErrorKind::Unsupported, "the streaming interface is not there"))?;
        if streaming.alternates.iter().any(|alternate| alternate.setting != 0) {
            inner
                .handle
                .set_alternate(mode.interface, 0)
                .map_err(|code| code.error("stopping an earlier stream"))?;
        }
        let probe = negotiate(inner, &mode)?;
        let mut fallback = Vec::new();
        let alternate = set_alternate(inner, streaming, &probe, &mut fallback)?;
        let queue = Queue::new();
        submit_first(inner, &queue, &alternate, &mut fallback)?;
        let shared = Arc::new(Shared {
            state: Mutex::new(State {
                frames: VecDeque::new(),
                counters: Counters::default(),
                slow_reader: (0, 0),
                stop: false,
                ended: None,
            }),
            changed: Condvar::new(),
        });
        let max_payload = usize::try_from(probe.max_payload_bytes).unwrap_or(usize::MAX);
        let pump = TransferThread {
            inner: inner.clone(),
            queue,
            idle: Vec::new(),
            interface: mode.interface,
            alternate,
            splitter: BulkSplitter::new(max_payload),
            frames: Assembler::new(usize::try_from(probe.max_frame_bytes).unwrap_or(usize::MAX)),
            shared: shared.clone(),
            waiting_frames: settings.waiting_frames.max(1),
            stalls: 0,
            starved_since: None,
        };
        let thread = std::thread::Builder::new().name("usb stream".into()).spawn(move || pump.run());
        let pump =
            thread.map_err(|e| Error::new(ErrorKind::Io, format!("starting the stream's thread: {e}")))?;
        let negotiated = NegotiatedMode { mode, probe, alternate, fallback };
        Ok(Self { inner: inner.clone(), shared, pump: Some(pump), negotiated })
    }

    /// What was agreed on.
    pub fn negotiated(&self) -> &NegotiatedMode {
        &self.negotiated
    }

    /// The oldest frame that waits. [`ErrorKind::Timeout`] if none comes within `limit`; other errors end the stream.
    pub fn next_frame(&self, limit: Duration) -> Result<Frame, Error> {
        let end = Instant::now() + limit;
        let mut state = self.shared.lock();
        loop {
            if let Some(frame) = state.frames.pop_front() {
                return Ok(frame);
            }
            if let Some(ended) = &state.ended {
                let stopped = || Error::new(ErrorKind::Io, "the stream was stopped");
                return Err(ended.clone().unwrap_or_else(stopped));
            }
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                let text = format!("no whole frame within {:.1} s", limit.as_secs_f64());
                return Err(Error::new(ErrorKind::Timeout, text));
            }
            state = self.shared.wait(state, left);
        }
    }

    /// What became of the frames so far.
    pub fn counters(&self) -> Counters {
        let state = self.shared.lock();
        let (frames, bytes) = state.slow_reader;
        let mut counters = state.counters;
        counters.delivered -= frames;
        counters.delivered_bytes -= bytes;
        counters.slow_reader += frames;
        counters
    }

    /// Lasers off, then the stream. Takes at most 6 s, also when the device is gone or silent: two requests for the lasers, of a second
    /// each and the second in which Linux may not take one back, then 3 s for the stream; less than 0.1 s when all is well.
    pub fn stop(mut self) -> Result<Counters, Error> {
        self.end()?;
        Ok(self.counters())
    }

    fn end(&mut self) -> Result<(), Error> {
        let Some(pump) = self.pump.take() else { return Ok(()) };
        let lasers = self.inner.lasers_off();
        let mut state = self.shared.lock();
        state.stop = true;
        let end = Instant::now() + STOP_LIMIT + Duration::from_secs(1);
        while state.ended.is_none() && Instant::now() < end {
            state = self.shared.wait(state, NAP);
        }
        let ended = state.ended.clone();
        drop(state);
        let Some(ended) = ended else {
            // The thread waits in the system; it cleans up when that returns.
            return Err(Error::new(ErrorKind::Timeout, "the stream did not stop in time"));
        };
        pump.join().ok().ok_or_else(|| Error::new(ErrorKind::Io, "the stream's thread panicked"))?;
        if ended.is_some_and(|error| error.kind() == ErrorKind::DeviceLost) {
            return Ok(()); // lasers went off with the power
        }
        lasers
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        drop(self.end()); // who wants to know calls `stop`
    }
}

/// Probe, look at the answer, commit.
fn negotiate(inner: &Inner, mode: &Mode) -> Result<Probe, Error> {
    let index = u16::from(mode.interface);
    let request = |request: u8, value: u16, data: ControlData<'_>| {
        let name = if value == VS_PROBE { "probe" } else { "commit" };
        inner.class_request(request, value, index, data).map_err(|e| e.in_context(name))
    };
    // A device knows its own length best; what it says is believed if it is one that can be.
    let said = request(GET_LEN, VS_PROBE, ControlData::In(2)).ok();
    let said = said.and_then(|b| Some(usize::from(u16::from_le_bytes([*b.first()?, *b.get(1)?]))));
    let length = said.filter(|n| (26..=64).contains(n)).unwrap_or(inner.video.version.probe_bytes());
    let wanted = Probe {
        hint: 1,
        format_index: mode.format_index,
        frame_index: mode.frame_index,
        frame_interval: mode.interval,
        ..Probe::default()
    };
    request(SET_CUR, VS_PROBE, ControlData::Out(&wanted.encode(length)))?;
    let length_u16 = u16::try_from(length).unwrap_or(u16::MAX);
    let answer = Probe::decode(&request(GET_CUR, VS_PROBE, ControlData::In(length_u16))?)?;
    if (answer.format_index, answer.frame_index) != (mode.format_index, mode.frame_index) {
        let text = format!(
            "probe: format {} size {} was asked for, the device answered format {} size {}",
            mode.format_index, mode.frame_index, answer.format_index, answer.frame_index
        );
        return Err(Error::new(ErrorKind::Protocol, text));
    }
    request(SET_CUR, VS_COMMIT, ControlData::Out(&answer.encode(length)))?;
    Ok(answer)
}

fn set_alternate(
    inner: &Inner,
    streaming: &StreamingInterface,
    probe: &Probe,
    fallback: &mut Vec<String>,
) -> Result<Alternate, Error> {
    for alternate in alternates_to_try(streaming, probe.max_payload_bytes) {
        // Setting 0 is in force already. A camera of one setting need not even know SET_INTERFACE.
        if alternate.setting == 0 {
            return Ok(alternate);
        }
        match inner.handle.set_alternate(streaming.number, alternate.setting) {
            Ok(()) => return Ok(alternate),
            Err(code) if code.is_gone() || code.is_late() => {
                return Err(code.error("setting the stream's bandwidth"));
            }
            Err(code) => {
                let what = match alternate.endpoint.kind {
                    EndpointKind::Bulk => format!("no alternate setting {}", alternate.setting),
                    _ => {
                        format!(
                            "no room for {} bytes in a microframe",
                            alternate.endpoint.bytes_per_interval()
                        )
                    }
                };
                fallback.push(code.error(what).to_string());
            }
        }
    }
    Err(Error::new(
        ErrorKind::Bandwidth,
        format!("the bus has no room for the stream: {}", fallback.join("; ")),
    ))
}

/// Queues as many transfers as the system takes; one is enough to run.
fn submit_first(
    inner: &Inner,
    queue: &Arc<Queue>,
    alternate: &Alternate,
    fallback: &mut Vec<String>,
) -> Result<(), Error> {
    let endpoint = &alternate.endpoint;
    let bulk = endpoint.kind == EndpointKind::Bulk;
    let wanted = if bulk { BULK_TRANSFERS } else { ISO_TRANSFERS };
    for number in 0..wanted {
        let transfer = if bulk {
            // Whole packets, or the last one could overflow the buffer.
            let bytes = BULK_BYTES.next_multiple_of(endpoint.packet_bytes());
            Transfer::bulk(endpoint.address, bytes)
        } else {
            Transfer::isochronous(endpoint.address, ISO_PACKETS, endpoint.bytes_per_interval())
        };
        let submitted = transfer.and_then(|t| inner.handle.submit(t, queue).map_err(|(_, code)| code));
        match submitted {
            Ok(()) => {}
            Err(code) if code.is_gone() || number == 0 => {
                return Err(code.error("queueing the stream's first transfer"));
            }
            Err(code) => {
                fallback.push(code.error(format!("{number} of {wanted} transfers queued")).to_string());
                break;
            }
        }
    }
    Ok(())
}

/// The thread that takes transfers, assembles frames and queues the transfers again.
struct TransferThread {
    inner: Arc<Inner>,
    queue: Arc<Queue>,
    /// To be queued; the box is what libusb gets and gives back.
    #[allow(clippy::vec_box)]
    idle: Vec<Box<Transfer>>,
    interface: u8,
    alternate: Alternate,
    splitter: BulkSplitter,
    frames: Assembler,
    shared: Arc<Shared>,
    waiting_frames: usize,
    stalls: u32,
    /// Since when no transfer could be queued.
    starved_since: Option<Instant>,
}

impl TransferThread {
    fn run(mut self) {
        let error = self.pump().err();
        let lost = error.as_ref().is_some_and(|error| error.kind() == ErrorKind::DeviceLost);
        self.cancel_all();
        self.idle.clear();
        self.frames.finish();
        self.publish();
        let (handle, interface) = (&self.inner.handle, self.interface);
        if !lost {
            // The head switches its lasers off at either of these.
            match self.alternate.setting {
                0 => handle.clear_halt(self.alternate.endpoint.address),
                _ => handle.set_alternate(interface, 0),
            }
            .ok();
        }
        handle.release(interface).ok();
        if error.is_some() {
            drop(self.inner.lasers_off()); // the error that ended the stream is the one to tell
        }
        self.shared.lock().ended = Some(error);
        self.shared.changed.notify_all();
    }

    fn pump(&mut self) -> Result<(), Error> {
        loop {
            if self.shared.lock().stop {
                return Ok(());
            }
            let Some(transfer) = self.queue.pop(NAP) else {
                self.resubmit()?;
                continue;
            };
            match transfer.status() {
                // Nobody asked for a cancel here: it is one of the ways in which an unplug shows.
                Status::Gone | Status::Cancelled => return Err(gone()),
                Status::Stall => self.recover(transfer)?,
                _ => {
                    self.take(&transfer);
                    self.publish();
                    self.idle.push(transfer);
                    self.resubmit()?;
                }
            }
        }
    }

    fn take(&mut self, transfer: &Transfer) {
        if self.alternate.endpoint.kind == EndpointKind::Bulk {
            match transfer.status() {
                Status::Completed => {
                    let (bytes, filled) = transfer.bulk_bytes();
                    self.splitter.transfer(bytes, !filled, &mut self.frames);
                }
                _ => self.splitter.failed(&mut self.frames),
            }
            return;
        }
        if transfer.status() != Status::Completed {
            self.frames.failed_transfer();
            return;
        }
        for (status, bytes) in transfer.packets() {
            match status {
                Status::Completed => self.frames.payload(bytes),
                _ => self.frames.failed_transfer(),
            }
        }
    }

    fn publish(&mut self) {
        let mut state = self.shared.lock();
        for frame in self.frames.take_ready() {
            self.stalls = 0;
            if state.frames.len() == self.waiting_frames
                && let Some(oldest) = state.frames.pop_front()
            {
                state.slow_reader.0 += 1;
                state.slow_reader.1 += oldest.jpeg.len() as u64;
            }
            state.frames.push_back(frame);
            self.shared.changed.notify_all();
        }
        state.counters = self.frames.counters();
    }

    /// Queues what is idle. A system that is short of memory is asked again after the next transfer.
    fn resubmit(&mut self) -> Result<(), Error> {
        while let Some(transfer) = self.idle.pop() {
            let Err((transfer, code)) = self.inner.handle.submit(transfer, &self.queue) else { continue };
            if code.is_gone() {
                return Err(gone());
            }
            self.idle.push(transfer);
            if self.queue.outstanding() > 0 {
                self.starved_since = None;
            } else if self.starved_since.get_or_insert_with(Instant::now).elapsed() > STARVED_LIMIT {
                return Err(code.error("queueing the stream's transfers again"));
            }
            return Ok(());
        }
        self.starved_since = None;
        Ok(())
    }

    /// The pipe has halted: takes all transfers back, clears it, queues them again.
    fn recover(&mut self, transfer: Box<Transfer>) -> Result<(), Error> {
        self.stalls += 1;
        if self.stalls > MAX_STALLS {
            let text = format!("the stream's pipe halted {MAX_STALLS} times without a frame in between");
            return Err(Error::new(ErrorKind::Io, text));
        }
        self.splitter.failed(&mut self.frames);
        self.idle.push(transfer);
        self.cancel_all();
        self.inner
            .handle
            .clear_halt(self.alternate.endpoint.address)
            .map_err(|code| code.error("clearing a halt of the stream's pipe"))?;
        self.resubmit()
    }

    /// Takes all transfers back, within [`STOP_LIMIT`]. What does not come stays with libusb until it does.
    fn cancel_all(&mut self) {
        self.queue.cancel();
        let end = Instant::now() + STOP_LIMIT;
        while self.queue.outstanding() > 0 {
            let left = end.saturating_duration_since(Instant::now());
            let Some(transfer) = self.queue.pop(left) else { break };
            self.idle.push(transfer);
        }
    }
}

fn gone() -> Error {
    Error::new(ErrorKind::DeviceLost, "the device is gone")
}
