//! All unsafe code of this crate: `rusb` has contexts, devices and handles, and here are the asynchronous transfers that it lacks.
//!
//! A transfer that is in flight belongs to libusb; its callback gives it back. So none can be freed before its callback ran, however a
//! stream ends. One thread for each handle runs libusb's events; everything else waits on queues, always with a limit. What Linux makes
//! its caller wait for (5 s for a head that does not answer) is called on a thread of its own. The device is closed by whoever uses
//! it last: if libusb or Linux does not come back in time, that is the event thread, and nobody waits for it.
#![allow(unsafe_code)]

use crate::{Error, ErrorKind};
use rusb::{UsbContext, ffi};
use std::collections::VecDeque;
use std::ffi::{c_int, c_uint};
use std::os::fd::{AsRawFd, BorrowedFd, OwnedFd};
use std::ptr::{self, NonNull};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak, mpsc};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How long the event thread sleeps at most, so that it notices the end even if nothing wakes it.
const EVENT_NAP: Duration = Duration::from_millis(100);
/// How long a call may take in which Linux waits for the device. A request without data has to be answered in 50 ms (USB 2.0, 9.2.6.4).
const KERNEL_LIMIT: Duration = Duration::from_secs(1);
/// The same for taking an interface, which Linux's own driver may have to let go first, or may just be taking back.
const CLAIM_LIMIT: Duration = Duration::from_secs(3);
/// How long closing waits for transfers that were cancelled. Linux gives them back within milliseconds.
const CLOSE_LIMIT: Duration = Duration::from_secs(1);

/// What libusb says to a call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct LibusbError(rusb::Error);

impl LibusbError {
    /// Of a call that `rusb` does not make.
    fn of(code: c_int) -> Self {
        use ffi::constants::*;
        Self(match code {
            LIBUSB_ERROR_NO_DEVICE => rusb::Error::NoDevice,
            LIBUSB_ERROR_ACCESS => rusb::Error::Access,
            LIBUSB_ERROR_BUSY => rusb::Error::Busy,
            LIBUSB_ERROR_NO_MEM => rusb::Error::NoMem,
            _ => rusb::Error::Io,
        })
    }

    /// In words of this crate; `what` was tried.
    pub fn error(self, what: impl std::fmt::Display) -> Error {
        let (kind, text) = match self.0 {
            rusb::Error::NoDevice => (ErrorKind::DeviceLost, "the device is gone"),
            rusb::Error::NotFound => (ErrorKind::NotFound, "not found"),
            rusb::Error::Access => (ErrorKind::PermissionDenied, "the system does not allow it"),
            rusb::Error::Busy => (ErrorKind::DeviceBusy, "another program or driver holds it"),
            rusb::Error::Timeout => (ErrorKind::Timeout, "no answer in time"),
            rusb::Error::Pipe => (ErrorKind::Refused, "the device refused"),
            rusb::Error::Overflow => (ErrorKind::Protocol, "the device sent more than was asked for"),
            rusb::Error::NoMem => (ErrorKind::Io, "the system has no memory for it"),
            _ => (ErrorKind::Io, "the system's USB layer failed"),
        };
        Error::new(kind, format!("{what}: {text} (libusb: {})", self.0))
    }

    const LATE: Self = Self(rusb::Error::Timeout);

    /// The device is not there any more.
    pub fn is_gone(&self) -> bool {
        self.0 == rusb::Error::NoDevice
    }

    /// The limit was over before there was an answer.
    pub fn is_late(&self) -> bool {
        *self == Self::LATE
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[repr(C)]
struct InitOption {
    option: c_int,
    value: usize, // a union of an int and a function pointer
}

unsafe extern "C" {
    // Since libusb 1.0.27, which is the one compiled in; libusb1-sys does not declare it.
    fn libusb_init_context(
        context: *mut *mut ffi::libusb_context,
        options: *const InitOption,
        count: c_int,
    ) -> c_int;
}

/// A context that never looks at /dev/bus/usb, which an Android app may not do. `rusb::disable_device_discovery` would say so for all
/// contexts of the process.
fn without_discovery() -> Result<rusb::Context, LibusbError> {
    let option = InitOption { option: ffi::constants::LIBUSB_OPTION_NO_DEVICE_DISCOVERY as c_int, value: 0 };
    let mut raw = ptr::null_mut();
    // SAFETY: `raw` and `option` live during the call; the count is that of options behind the pointer. A context that was made is
    // not null, and nobody else has it.
    unsafe {
        match libusb_init_context(&mut raw, &option, 1) {
            0 => Ok(rusb::Context::from_raw(raw)),
            code => Err(LibusbError::of(code)),
        }
    }
}

fn starting(code: LibusbError) -> Error {
    code.error("starting libusb, which needs /dev/bus/usb and the uevents of the kernel")
}

/// A device that the system shows.
pub(crate) struct Listed {
    device: rusb::Device<rusb::Context>,
    pub vendor_id: u16,
    pub product_id: u16,
    /// Bus and address.
    pub place: (u8, u8),
}

/// All devices that the system shows.
pub(crate) fn list() -> Result<Vec<Listed>, Error> {
    let context = rusb::Context::new().map_err(|e| starting(LibusbError(e)))?;
    let devices = context.devices().map_err(|e| LibusbError(e).error("listing devices"))?;
    let listed = |device: rusb::Device<rusb::Context>| {
        let descriptor = device.device_descriptor().ok()?; // libusb has it: this cannot fail
        let place = (device.bus_number(), device.address());
        Some(Listed { vendor_id: descriptor.vendor_id(), product_id: descriptor.product_id(), place, device })
    };
    Ok(devices.iter().filter_map(listed).collect())
}

impl Listed {
    pub fn open(&self) -> Result<Handle, Error> {
        let opened = self.device.open().map_err(|e| {
            LibusbError(e).error(format!("opening the device {:03}/{:03}", self.place.0, self.place.1))
        })?;
        Handle::new(opened, None)
    }
}

/// An open device, closed when the last user drops it.
struct OpenDevice {
    /// Every transfer in flight, every call and the event thread hold an Arc to this: when it is closed none is left.
    handle: rusb::DeviceHandle<rusb::Context>,
    /// How many [`UseGuard`] there are.
    in_use: AtomicUsize,
    ending: AtomicBool,
    /// Whether somebody has the [`ExclusiveCall`].
    turn: Mutex<bool>,
    turn_ended: Condvar,
    /// A duplicate of the descriptor it was opened by. As the last field it outlives the handle.
    _fd: Option<OwnedFd>,
}

/// A transfer that libusb holds, or a call that has not returned: until there is none, events are handled and the device stays open.
struct UseGuard(Arc<OpenDevice>);

impl UseGuard {
    fn new(open: &Arc<OpenDevice>) -> Self {
        open.in_use.fetch_add(1, Ordering::AcqRel);
        Self(open.clone())
    }
}

impl Drop for UseGuard {
    fn drop(&mut self) {
        self.0.in_use.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Leave to call what takes the lock that Linux has for each device. While Linux waits for a silent device with that lock, others must
/// not even submit a request: they would wait as long.
struct ExclusiveCall(UseGuard);

impl ExclusiveCall {
    fn take(open: &Arc<OpenDevice>, limit: Duration) -> Result<Self, LibusbError> {
        let wait = open.turn_ended.wait_timeout_while(lock(&open.turn), limit, |taken| *taken);
        let mut taken = wait.unwrap_or_else(PoisonError::into_inner).0;
        if std::mem::replace(&mut *taken, true) {
            Err(LibusbError::LATE)
        } else {
            Ok(Self(UseGuard::new(open)))
        }
    }
}

impl Drop for ExclusiveCall {
    fn drop(&mut self) {
        let open = &self.0.0;
        *lock(&open.turn) = false;
        open.turn_ended.notify_one();
    }
}

/// An open device with the thread that runs its events. Dropping it closes the device.
pub(crate) struct Handle {
    open: Arc<OpenDevice>,
    events: Option<JoinHandle<()>>,
}

impl Handle {
    /// Opens by a descriptor of usbfs, such as Android hands out. The descriptor is duplicated: the caller's stays his.
    pub fn from_fd(fd: BorrowedFd<'_>) -> Result<Self, Error> {
        let fd = fd
            .try_clone_to_owned()
            .map_err(|e| Error::new(ErrorKind::Io, format!("duplicating the device's descriptor: {e}")))?;
        let context = without_discovery().map_err(starting)?;
        // SAFETY: the descriptor is ours and outlives the handle.
        let opened = unsafe { context.open_device_with_fd(fd.as_raw_fd()) };
        Self::new(opened.map_err(|e| LibusbError(e).error("opening the device by its descriptor"))?, Some(fd))
    }

    fn new(handle: rusb::DeviceHandle<rusb::Context>, fd: Option<OwnedFd>) -> Result<Self, Error> {
        // Where the kernel's own driver holds an interface it is put aside while we have it. Not supported everywhere.
        handle.set_auto_detach_kernel_driver(true).ok();
        let open = Arc::new(OpenDevice {
            handle,
            in_use: AtomicUsize::new(0),
            ending: AtomicBool::new(false),
            turn: Mutex::new(false),
            turn_ended: Condvar::new(),
            _fd: fd,
        });
        let mut handle = Self { open: open.clone(), events: None };
        let run = move || {
            while !open.ending.load(Ordering::Acquire) || open.in_use.load(Ordering::Acquire) > 0 {
                let handled = open.handle.context().handle_events(Some(EVENT_NAP));
                if handled.is_err_and(|e| e != rusb::Error::Interrupted) {
                    std::thread::sleep(Duration::from_millis(1)); // a lasting failure must not burn the processor
                }
            }
        };
        let thread = std::thread::Builder::new().name("usb events".into()).spawn(run);
        handle.events =
            Some(thread.map_err(|e| Error::new(ErrorKind::Io, format!("starting the event thread: {e}")))?);
        Ok(handle)
    }

    pub fn claim(&self, interface: u8) -> Result<(), LibusbError> {
        self.call(CLAIM_LIMIT, move |handle| handle.claim_interface(interface))
    }

    pub fn release(&self, interface: u8) -> Result<(), LibusbError> {
        self.call(KERNEL_LIMIT, move |handle| handle.release_interface(interface))
    }

    pub fn set_alternate(&self, interface: u8, setting: u8) -> Result<(), LibusbError> {
        self.call(KERNEL_LIMIT, move |handle| handle.set_alternate_setting(interface, setting))
    }

    pub fn clear_halt(&self, endpoint: u8) -> Result<(), LibusbError> {
        self.call(KERNEL_LIMIT, move |handle| handle.clear_halt(endpoint))
    }

    /// Makes a call in which Linux waits for the device. If it does not return in time it goes on without anybody waiting.
    fn call(
        &self,
        limit: Duration,
        call: impl FnOnce(&rusb::DeviceHandle<rusb::Context>) -> rusb::Result<()> + Send + 'static,
    ) -> Result<(), LibusbError> {
        let end = Instant::now() + limit;
        let turn = ExclusiveCall::take(&self.open, limit)?;
        let (tell, done) = mpsc::channel();
        let run = move || {
            let result = call(&turn.0.0.handle);
            drop(turn); // before the caller goes on, who may close the device
            tell.send(result).ok(); // the caller may have given up
        };
        let Ok(_detached) = std::thread::Builder::new().name("usb call".into()).spawn(run) else {
            return Err(LibusbError(rusb::Error::NoMem));
        };
        match done.recv_timeout(end.saturating_duration_since(Instant::now())) {
            Ok(result) => result.map_err(LibusbError),
            Err(_) => Err(LibusbError::LATE),
        }
    }

    /// A request on the control pipe. Returns the bytes that the device sent, or nothing for a request to the device.
    /// Takes no longer than `limit`, or [`CLOSE_LIMIT`] more if Linux does not even take it back.
    pub fn control(
        &self,
        request_type: u8,
        request: u8,
        value: u16,
        index: u16,
        data: ControlData<'_>,
        limit: Duration,
    ) -> Result<Vec<u8>, LibusbError> {
        let (length, out): (usize, &[u8]) = match data {
            ControlData::In(length) => (usize::from(length), &[]),
            ControlData::Out(bytes) => (bytes.len(), bytes),
        };
        let mut buffer = vec![request_type, request];
        for field in [value, index, u16::try_from(length).unwrap_or(u16::MAX)] {
            buffer.extend(field.to_le_bytes());
        }
        buffer.extend(out);
        buffer.resize(SETUP_BYTES + length, 0);
        let mut transfer = Transfer::new(buffer, 0)?;
        transfer.kind = ffi::constants::LIBUSB_TRANSFER_TYPE_CONTROL;
        // Its own queue: an answer that comes too late finds nobody and is freed.
        let queue = Queue::new();
        let end = Instant::now() + limit;
        let turn = ExclusiveCall::take(&self.open, limit)?;
        let left = end.saturating_duration_since(Instant::now());
        transfer.limit_ms = c_uint::try_from(left.as_millis()).unwrap_or(c_uint::MAX).max(1);
        transfer.submit(&self.open, &queue).map_err(|(_, code)| code)?;
        drop(turn);
        let Some(done) = queue.pop(left + CLOSE_LIMIT) else { return Err(LibusbError::LATE) };
        match done.status() {
            Status::Completed => {
                let got = done.actual_length().min(length);
                Ok(done.buffer[SETUP_BYTES..SETUP_BYTES + got].to_vec())
            }
            Status::TimedOut => Err(LibusbError::LATE),
            Status::Stall => Err(LibusbError(rusb::Error::Pipe)),
            Status::Gone | Status::Cancelled => Err(LibusbError(rusb::Error::NoDevice)),
            Status::Overflow => Err(LibusbError(rusb::Error::Overflow)),
            Status::Failed => Err(LibusbError(rusb::Error::Io)),
        }
    }

    /// Hands a transfer to libusb. On failure it comes back.
    pub fn submit(
        &self,
        transfer: Box<Transfer>,
        queue: &Arc<Queue>,
    ) -> Result<(), (Box<Transfer>, LibusbError)> {
        transfer.submit(&self.open, queue)
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        self.open.ending.store(true, Ordering::Release);
        self.open.handle.context().interrupt_handle_events();
        let end = Instant::now() + CLOSE_LIMIT;
        let Some(events) = self.events.take() else { return };
        while !events.is_finished() && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(1));
        }
        if events.is_finished() {
            drop(events.join()); // it has nothing that could panic
        }
    }
}

const SETUP_BYTES: usize = 8;

/// What a control request carries.
pub(crate) enum ControlData<'a> {
    /// So many bytes are asked for.
    In(u16),
    /// These are sent.
    Out(&'a [u8]),
}

/// How a transfer or packet ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Status {
    Completed,
    Failed,
    TimedOut,
    Cancelled,
    Stall,
    Gone,
    Overflow,
}

impl Status {
    fn from_raw(status: c_int) -> Self {
        use ffi::constants::*;
        match status {
            LIBUSB_TRANSFER_COMPLETED => Self::Completed,
            LIBUSB_TRANSFER_TIMED_OUT => Self::TimedOut,
            LIBUSB_TRANSFER_CANCELLED => Self::Cancelled,
            LIBUSB_TRANSFER_STALL => Self::Stall,
            LIBUSB_TRANSFER_NO_DEVICE => Self::Gone,
            LIBUSB_TRANSFER_OVERFLOW => Self::Overflow,
            _ => Self::Failed,
        }
    }
}

/// A transfer with its buffer, not in flight.
pub(crate) struct Transfer {
    raw: NonNull<ffi::libusb_transfer>,
    buffer: Vec<u8>,
    kind: u8,
    endpoint: u8,
    limit_ms: c_uint,
    packets: usize,
    packet_bytes: usize,
    /// Where it goes when it is done, and what keeps the device open until then.
    flight: Option<(Weak<Queue>, UseGuard)>,
}

// SAFETY: the raw transfer is owned by this value alone; libusb does not tie transfers to threads.
unsafe impl Send for Transfer {}

impl Transfer {
    fn new(buffer: Vec<u8>, packets: usize) -> Result<Box<Self>, LibusbError> {
        // SAFETY: no conditions; null is handled.
        let raw = unsafe { ffi::libusb_alloc_transfer(c_int::try_from(packets).unwrap_or(c_int::MAX)) };
        let raw = NonNull::new(raw).ok_or(LibusbError(rusb::Error::NoMem))?;
        let packet_bytes = buffer.len().checked_div(packets).unwrap_or(0);
        Ok(Box::new(Self {
            raw,
            buffer,
            kind: 0,
            endpoint: 0,
            limit_ms: 0,
            packets,
            packet_bytes,
            flight: None,
        }))
    }

    /// Reads `bytes` from a bulk endpoint, without a time limit.
    pub fn bulk(endpoint: u8, bytes: usize) -> Result<Box<Self>, LibusbError> {
        let mut transfer = Self::new(vec![0; bytes], 0)?;
        (transfer.kind, transfer.endpoint) = (ffi::constants::LIBUSB_TRANSFER_TYPE_BULK, endpoint);
        Ok(transfer)
    }

    /// Reads some packets from an isochronous endpoint.
    pub fn isochronous(endpoint: u8, packets: usize, packet_bytes: usize) -> Result<Box<Self>, LibusbError> {
        let mut transfer = Self::new(vec![0; packets * packet_bytes], packets)?;
        (transfer.kind, transfer.endpoint) = (ffi::constants::LIBUSB_TRANSFER_TYPE_ISOCHRONOUS, endpoint);
        Ok(transfer)
    }

    fn submit(
        mut self: Box<Self>,
        open: &Arc<OpenDevice>,
        queue: &Arc<Queue>,
    ) -> Result<(), (Box<Self>, LibusbError)> {
        self.flight = Some((Arc::downgrade(queue), UseGuard::new(open)));
        let raw = self.raw;
        let length = c_int::try_from(self.buffer.len()).unwrap_or(c_int::MAX); // buffers are far below 2 GB
        lock(&queue.state).alive.push(TransferId(raw));
        let whole = Box::into_raw(self);
        // SAFETY: `raw` is a live transfer that is not in flight, with room for `packets` packet descriptors; the buffer has
        // `length` bytes and moves with the box to the callback; `whole` is given back there, or below if libusb refuses.
        let code = unsafe {
            let t = raw.as_ptr();
            (*t).dev_handle = open.handle.as_raw();
            (*t).flags = 0;
            (*t).endpoint = (*whole).endpoint;
            (*t).transfer_type = (*whole).kind;
            (*t).timeout = (*whole).limit_ms;
            (*t).length = length;
            (*t).callback = finished;
            (*t).user_data = whole.cast();
            (*t).buffer = (*whole).buffer.as_mut_ptr();
            (*t).num_iso_packets = (*whole).packets as c_int;
            ffi::libusb_set_iso_packet_lengths(t, (*whole).packet_bytes as c_uint);
            ffi::libusb_submit_transfer(t)
        };
        match code {
            0 => Ok(()),
            code => {
                lock(&queue.state).alive.retain(|name| name.0 != raw);
                // SAFETY: libusb refused the transfer, so its callback will never run and the box is ours again.
                let mut back = unsafe { Box::from_raw(whole) };
                back.flight = None;
                Err((back, LibusbError::of(code)))
            }
        }
    }

    pub fn status(&self) -> Status {
        // SAFETY: the transfer is alive and not in flight.
        Status::from_raw(unsafe { (*self.raw.as_ptr()).status })
    }

    fn actual_length(&self) -> usize {
        // SAFETY: the transfer is alive and not in flight.
        usize::try_from(unsafe { (*self.raw.as_ptr()).actual_length }).unwrap_or(0)
    }

    /// The bytes that arrived, and whether they filled the transfer.
    pub fn bulk_bytes(&self) -> (&[u8], bool) {
        let got = self.actual_length().min(self.buffer.len());
        (&self.buffer[..got], got == self.buffer.len())
    }

    /// The packets of an isochronous transfer.
    pub fn packets(&self) -> impl Iterator<Item = (Status, &[u8])> {
        (0..self.packets).map(|i| {
            // SAFETY: the transfer is alive, not in flight, and was allocated with `packets` descriptors.
            let packet = unsafe { &*(*self.raw.as_ptr()).iso_packet_desc.as_ptr().add(i) };
            let got = (packet.actual_length as usize).min(self.packet_bytes);
            let start = i * self.packet_bytes;
            (Status::from_raw(packet.status), &self.buffer[start..start + got])
        })
    }
}

impl Drop for Transfer {
    fn drop(&mut self) {
        // SAFETY: a value of this type is never in flight: while libusb has it, there is only the raw box.
        unsafe { ffi::libusb_free_transfer(self.raw.as_ptr()) }
    }
}

/// Names a transfer that is alive: in flight, or done and not popped.
#[derive(Clone, Copy, PartialEq, Eq)]
struct TransferId(NonNull<ffi::libusb_transfer>);

// SAFETY: only a name; `Queue` alone uses it, and forgets it when the transfer is popped.
unsafe impl Send for TransferId {}

/// Runs on the event thread when a transfer is done, however it ended.
extern "system" fn finished(raw: *mut ffi::libusb_transfer) {
    // SAFETY: `user_data` is the box that `submit` turned into a pointer; libusb calls this once for each submission.
    let mut transfer = unsafe { Box::from_raw((*raw).user_data.cast::<Transfer>()) };
    if let Some((queue, _in_use)) = transfer.flight.take() {
        match queue.upgrade() {
            Some(queue) => queue.push(transfer),
            None => drop(transfer),
        }
    }
}

/// Transfers of one user: those that libusb holds, and those that are done.
pub(crate) struct Queue {
    state: Mutex<QueueState>,
    changed: Condvar,
}

struct QueueState {
    alive: Vec<TransferId>,
    done: VecDeque<Box<Transfer>>,
}

impl Queue {
    pub fn new() -> Arc<Self> {
        let state = QueueState { alive: Vec::new(), done: VecDeque::new() };
        Arc::new(Self { state: Mutex::new(state), changed: Condvar::new() })
    }

    fn push(&self, transfer: Box<Transfer>) {
        lock(&self.state).done.push_back(transfer);
        self.changed.notify_one();
    }

    /// The next one that is done; `None` after `limit`.
    pub fn pop(&self, limit: Duration) -> Option<Box<Transfer>> {
        let wait = self.changed.wait_timeout_while(lock(&self.state), limit, |state| state.done.is_empty());
        let mut state = wait.unwrap_or_else(PoisonError::into_inner).0;
        let transfer = state.done.pop_front()?;
        state.alive.retain(|name| name.0 != transfer.raw);
        Some(transfer)
    }

    /// How many were submitted and not popped.
    pub fn outstanding(&self) -> usize {
        lock(&self.state).alive.len()
    }

    /// Asks libusb to end all that it holds. They still arrive here.
    pub fn cancel(&self) {
        // Holding the lock keeps a transfer that is just done from being popped, and freed, meanwhile.
        let state = lock(&self.state);
        for name in &state.alive {
            // SAFETY: what is named here is alive; cancelling what is not in flight does nothing.
            unsafe { ffi::libusb_cancel_transfer(name.0.as_ptr()) };
        }
    }
}
