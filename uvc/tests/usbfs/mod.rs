//! A usbfs inside the test program: the software head behind the unmodified libusb, without a kernel, a bus or time. Requests are
//! answered at once; what has no answer yet stays pending. Faults of the bus are injected here, faults of the head in the head.

mod sys;

use boxline_uvc::emulator::{InReply, Setup, SoftwareHead};
use std::collections::{BTreeSet, VecDeque};
use std::ffi::c_int;
use std::io::{Read, Write};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};
pub use sys::Urb;
use sys::{BULK, CONTROL, ISOCHRONOUS, Request};

/// What happens to a block of the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UrbFault {
    /// It ends with an error; its data is lost.
    Status(c_int),
    /// Half of its data is lost, and nobody says so.
    Short,
    /// One packet of it fails; its data is lost.
    Packet(c_int),
    /// It never ends by itself.
    Hang,
    /// The cable is pulled.
    Unplug,
}

/// What the bus does wrong; numbers count blocks of the stream from 0.
pub struct Plan {
    /// Submitting fails with this error number.
    pub submit: Box<dyn FnMut(u64) -> Option<c_int> + Send>,
    /// What happens to a block.
    pub finish: Box<dyn FnMut(u64) -> Option<UrbFault> + Send>,
    /// Control requests that fail with an error number, or never end (0).
    pub control: Box<dyn FnMut(Setup) -> Option<c_int> + Send>,
    /// Alternate settings above this one find no room on the bus.
    pub room_for: u8,
    /// For so long Linux waits for the head to set an interface or clear a halt; if it is not zero, in vain.
    pub waits: Duration,
}

impl Default for Plan {
    fn default() -> Self {
        Self {
            submit: Box::new(|_| None),
            finish: Box::new(|_| None),
            control: Box::new(|_| None),
            room_for: u8::MAX,
            waits: Duration::ZERO,
        }
    }
}

pub struct State {
    pub head: SoftwareHead,
    pub plan: Plan,
    pending: VecDeque<Urb>,
    done: VecDeque<Urb>,
    pub unplugged: bool,
    halted: bool,
    submitted: u64,
    finished: u64,
    /// Where the blocks of the stream that were taken put their data: which transfers there are.
    buffers: BTreeSet<usize>,
    pub claims: i32,
    /// Interfaces taken so far, let go or not.
    pub claimed: u32,
}

/// A fake device.
pub struct Bus {
    pub state: Mutex<State>,
    /// Linux has a lock for each device, which it keeps while it waits for the device.
    lock_of_linux: Mutex<()>,
    fd: OwnedFd,
    event: OwnedFd,
    identity: (u64, u64),
    since: Instant,
}

/// A device that is plugged in until this is dropped.
pub struct Plugged(pub Arc<Bus>);

impl std::ops::Deref for Plugged {
    type Target = Bus;
    fn deref(&self) -> &Bus {
        &self.0
    }
}

impl Drop for Plugged {
    fn drop(&mut self) {
        sys::forget(&self.0);
    }
}

/// Plugs a head in.
pub fn plug(head: SoftwareHead, plan: Plan) -> Plugged {
    // libusb does not start where no usbfs is; an empty folder is enough for it.
    std::fs::create_dir_all("/dev/bus/usb/001")
        .expect("libusb needs /dev/bus/usb/001; make it, or run as root");
    let fd = sys::memfd();
    let mut file = std::fs::File::from(fd.try_clone().unwrap());
    let (device, configuration) = head.descriptors();
    file.write_all(&device).unwrap();
    file.write_all(&configuration).unwrap();
    let state = State {
        head,
        plan,
        pending: VecDeque::new(),
        done: VecDeque::new(),
        unplugged: false,
        halted: false,
        submitted: 0,
        finished: 0,
        buffers: BTreeSet::new(),
        claims: 0,
        claimed: 0,
    };
    let identity = sys::identity(fd.as_raw_fd());
    let bus = Arc::new(Bus {
        state: Mutex::new(state),
        lock_of_linux: Mutex::new(()),
        fd,
        event: sys::eventfd(),
        identity,
        since: Instant::now(),
    });
    sys::register(bus.clone());
    Plugged(bus)
}

impl Bus {
    /// What Android would hand out.
    pub fn fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }

    pub fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap()
    }

    pub fn unplug(&self) {
        let mut state = self.lock();
        state.unplug();
        self.signal(&state);
    }

    /// Tells poll whether something can be reaped.
    fn signal(&self, state: &State) {
        let event = std::fs::File::from(self.event.try_clone().unwrap());
        if state.unplugged || !state.done.is_empty() {
            (&event).write_all(&1u64.to_ne_bytes()).unwrap();
        } else {
            drop((&event).read(&mut [0; 8])); // nothing in it is fine
        }
    }

    fn poll_events(&self) -> i16 {
        let state = self.lock();
        let reapable = if state.done.is_empty() { 0 } else { libc::POLLOUT };
        if state.unplugged { reapable | libc::POLLERR | libc::POLLHUP } else { reapable }
    }

    /// What ioctl returns, or an error number.
    fn request(&self, request: Request<'_>) -> Result<c_int, c_int> {
        let _held = self.lock_of_linux.lock().unwrap();
        let waits = self.lock().plan.waits;
        if !waits.is_zero() && matches!(request, Request::SetInterface(_) | Request::ClearHalt) {
            std::thread::sleep(waits);
            return Err(libc::ETIMEDOUT);
        }
        let now = self.since.elapsed();
        let mut state = self.lock();
        let result = match request {
            Request::Reap(urb) => match state.done.pop_front() {
                Some(done) => {
                    *urb = done;
                    Ok(0)
                }
                None if state.unplugged => Err(libc::ENODEV),
                None => Err(libc::EAGAIN),
            },
            Request::Discard(urb) => match state.pending.iter().position(|pending| *pending == urb) {
                Some(at) => {
                    state.pending.remove(at);
                    urb.finish(-libc::ENOENT, 0);
                    state.done.push_back(urb);
                    Ok(0)
                }
                None => Err(libc::EINVAL),
            },
            _ if state.unplugged => Err(libc::ENODEV),
            // Zero packets, no limit of packet size, reaping after disconnection.
            Request::Capabilities(capabilities) => {
                *capabilities = 0x15;
                Ok(0)
            }
            Request::Speed => Ok(3),
            Request::ConnectInfo(info) => {
                *info = [1, 0];
                Ok(0)
            }
            Request::Claim => {
                state.claims += 1;
                state.claimed += 1;
                Ok(0)
            }
            Request::Release(interface) => {
                state.claims -= 1;
                if interface == 1 {
                    state.head.set_alternate(0, now).unwrap(); // as Linux does
                }
                Ok(0)
            }
            Request::SetInterface([1, setting]) if setting > u32::from(state.plan.room_for) => {
                Err(libc::ENOSPC)
            }
            Request::SetInterface([1, setting]) => {
                state.head.set_alternate(setting as u8, now).map(|()| 0).or(Err(libc::EPIPE))
            }
            Request::SetInterface(_) => Ok(0),
            Request::ClearHalt => {
                let halted = std::mem::take(&mut state.halted);
                state.head.clear_halt(halted);
                Ok(0)
            }
            Request::Reset => {
                state.head.power_up();
                Ok(0)
            }
            Request::Control { setup, data } => {
                let out = if setup[0] & 0x80 == 0 { &data[..] } else { &[] };
                match state.head.control(Setup::parse(&setup), out, now) {
                    Ok(answer) => {
                        data[..answer.len()].copy_from_slice(&answer);
                        Ok(answer.len() as c_int)
                    }
                    Err(_) => Err(libc::EPIPE),
                }
            }
            Request::Submit(urb) => state.submit(urb),
            Request::Other => Err(libc::ENODATA),
        };
        if !state.unplugged {
            state.serve(now);
        }
        self.signal(&state);
        result
    }
}

impl State {
    fn unplug(&mut self) {
        self.unplugged = true;
        self.head.power_up();
        for urb in std::mem::take(&mut self.pending) {
            urb.finish(-libc::ESHUTDOWN, 0);
            self.done.push_back(urb);
        }
    }

    /// Nothing more comes, and whatever came was taken: all transfers of the stream are queued again, and none can end.
    pub fn is_still(&self) -> bool {
        let queued = self.pending.iter().filter(|urb| urb.kind() != CONTROL).count();
        queued > 0 && queued == self.buffers.len() && self.done.is_empty()
    }

    fn submit(&mut self, urb: Urb) -> Result<c_int, c_int> {
        if urb.kind() != CONTROL {
            let number = self.submitted;
            self.submitted += 1;
            if let Some(error) = (self.plan.submit)(number) {
                return Err(error);
            }
            self.buffers.insert(urb.buffer().as_ptr() as usize);
        }
        self.pending.push_back(urb);
        Ok(0)
    }

    /// Ends what can be ended.
    fn serve(&mut self, now: Duration) {
        let mut waiting = VecDeque::new();
        while let Some(urb) = self.pending.pop_front() {
            let served = match urb.kind() {
                CONTROL => self.control(urb, now),
                // The blocks of the stream end in their order.
                _ if waiting.iter().any(|other: &Urb| other.kind() == urb.kind()) => false,
                BULK => self.bulk(urb, now),
                ISOCHRONOUS => self.isochronous(urb, now),
                kind => panic!("a block of kind {kind}"),
            };
            if self.unplugged {
                waiting.push_back(urb);
                break;
            }
            if served { self.done.push_back(urb) } else { waiting.push_back(urb) }
        }
        waiting.append(&mut self.pending);
        self.pending = waiting;
        if self.unplugged {
            self.unplug();
        }
    }

    fn control(&mut self, urb: Urb, now: Duration) -> bool {
        let buffer = urb.buffer();
        let (setup, data) = buffer.split_first_chunk_mut::<8>().unwrap();
        let setup = Setup::parse(setup);
        match (self.plan.control)(setup) {
            Some(0) => return false,
            Some(error) => {
                urb.finish(-error, 0);
                return true;
            }
            None => {}
        }
        let out = if setup.request_type & 0x80 == 0 { &data[..] } else { &[] };
        match self.head.control(setup, out, now) {
            Ok(answer) => {
                data[..answer.len()].copy_from_slice(&answer);
                let sent = if setup.request_type & 0x80 == 0 { data.len() } else { answer.len() };
                urb.finish(0, sent);
            }
            Err(_) => urb.finish(-libc::EPIPE, 0),
        }
        true
    }

    fn bulk(&mut self, urb: Urb, now: Duration) -> bool {
        if self.halted {
            urb.finish(-libc::EPIPE, 0);
            return true;
        }
        let buffer = urb.buffer();
        let InReply::Data(bytes) = self.head.bulk_in(buffer.len(), now) else { return false };
        let fault = self.next_fault();
        match fault {
            Some(UrbFault::Hang) => return false,
            Some(UrbFault::Unplug) => self.unplugged = true,
            Some(UrbFault::Status(error)) => {
                self.halted = error == libc::EPIPE;
                urb.finish(-error, 0);
            }
            Some(UrbFault::Short) => {
                let half = bytes.len() / 2;
                buffer[..half].copy_from_slice(&bytes[..half]);
                urb.finish(0, half);
            }
            _ => {
                buffer[..bytes.len()].copy_from_slice(&bytes);
                urb.finish(0, bytes.len());
            }
        }
        true
    }

    fn isochronous(&mut self, urb: Urb, now: Duration) -> bool {
        let buffer = urb.buffer();
        let mut start = 0;
        let mut anything = false;
        let fault = self.next_fault_later();
        for i in 0..urb.packet_count() {
            let length = urb.packet_length(i);
            let bytes = self.head.iso_in(length, now);
            if i == 0 && bytes.is_empty() {
                return false; // a real bus would bring nothing 8000 times a second
            }
            anything |= !bytes.is_empty();
            match fault {
                Some(UrbFault::Packet(error)) if i == 1 => urb.finish_packet(i, -error, 0),
                Some(UrbFault::Short) if i == 1 => urb.finish_packet(i, 0, 0),
                _ => {
                    buffer[start..start + bytes.len()].copy_from_slice(&bytes);
                    urb.finish_packet(i, 0, bytes.len());
                }
            }
            start += length;
        }
        assert!(anything);
        self.finished += 1;
        match fault {
            Some(UrbFault::Hang) => return false,
            Some(UrbFault::Unplug) => self.unplugged = true,
            Some(UrbFault::Status(error)) => urb.finish(-error, 0),
            _ => urb.finish(0, 0),
        }
        true
    }

    fn next_fault(&mut self) -> Option<UrbFault> {
        self.finished += 1;
        (self.plan.finish)(self.finished - 1)
    }

    /// The fault of the block that is counted when it ends.
    fn next_fault_later(&mut self) -> Option<UrbFault> {
        (self.plan.finish)(self.finished)
    }
}
