//! The unsafe part of the fake usbfs: this test program defines the C functions `ioctl` and `poll`, to which the libusb that is
//! linked into it binds. Calls for a fake device go to [`Bus`](super::Bus), all others to the system.
#![allow(unsafe_code)]
#![allow(clippy::mut_from_ref)] // a block is a pointer; the lock of the bus makes its user the only one

use super::Bus;
use std::ffi::{c_int, c_ulong, c_void};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// struct usbdevfs_urb of linux/usbdevice_fs.h, without the packets that follow it.
#[repr(C)]
struct RawUrb {
    kind: u8,
    endpoint: u8,
    status: c_int,
    flags: u32,
    buffer: *mut u8,
    buffer_length: c_int,
    actual_length: c_int,
    start_frame: c_int,
    number_of_packets: c_int,
    error_count: c_int,
    signal: u32,
    context: *mut c_void,
}

#[repr(C)]
#[derive(Clone, Copy)]
struct RawPacket {
    length: u32,
    actual_length: u32,
    status: u32,
}

/// A request block that libusb has submitted and not got back.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Urb(*mut RawUrb);

// SAFETY: the block belongs to the fake device from submission to reaping, which the bus's lock guards.
unsafe impl Send for Urb {}

pub const ISOCHRONOUS: u8 = 0;
pub const CONTROL: u8 = 2;
pub const BULK: u8 = 3;

impl Urb {
    fn raw(&self) -> &mut RawUrb {
        // SAFETY: libusb keeps a submitted block and its buffer alive until it is reaped.
        unsafe { &mut *self.0 }
    }

    pub fn kind(&self) -> u8 {
        self.raw().kind
    }

    pub fn buffer(&self) -> &mut [u8] {
        let raw = self.raw();
        // SAFETY: as above; `buffer_length` bytes are the block's own.
        unsafe { std::slice::from_raw_parts_mut(raw.buffer, raw.buffer_length as usize) }
    }

    pub fn finish(&self, status: c_int, actual_length: usize) {
        let raw = self.raw();
        (raw.status, raw.actual_length) = (status, actual_length as c_int);
    }

    pub fn packet_count(&self) -> usize {
        self.raw().number_of_packets as usize
    }

    fn packet(&self, i: usize) -> &mut RawPacket {
        assert!(i < self.packet_count());
        // SAFETY: `number_of_packets` descriptors follow the block.
        unsafe { &mut *self.0.add(1).cast::<RawPacket>().add(i) }
    }

    pub fn packet_length(&self, i: usize) -> usize {
        self.packet(i).length as usize
    }

    pub fn finish_packet(&self, i: usize, status: c_int, actual_length: usize) {
        let packet = self.packet(i);
        (packet.status, packet.actual_length) = (status as u32, actual_length as u32);
    }
}

/// What libusb asks of a device's descriptor.
pub enum Request<'a> {
    Capabilities(&'a mut u32),
    Speed,
    ConnectInfo(&'a mut [u32; 2]),
    Claim,
    Release(u32),
    SetInterface([u32; 2]),
    ClearHalt,
    Reset,
    /// Setup bytes and data in one.
    Control {
        setup: [u8; 8],
        data: &'a mut [u8],
    },
    Submit(Urb),
    Discard(Urb),
    Reap(&'a mut Urb),
    Other,
}

#[repr(C)]
struct RawControl {
    setup: [u8; 8],
    limit_ms: u32,
    data: *mut u8,
}

static BUSES: Mutex<Vec<Arc<Bus>>> = Mutex::new(Vec::new());

fn buses() -> MutexGuard<'static, Vec<Arc<Bus>>> {
    BUSES.lock().unwrap_or_else(PoisonError::into_inner)
}

pub fn register(bus: Arc<Bus>) {
    buses().push(bus);
}

pub fn forget(bus: &Arc<Bus>) {
    buses().retain(|other| !Arc::ptr_eq(other, bus));
}

/// What a descriptor stands for, however often it was duplicated.
pub fn identity(fd: c_int) -> (u64, u64) {
    // SAFETY: all zeros is a valid value; `stat` lives during the call.
    unsafe {
        let mut stat: libc::stat = std::mem::zeroed();
        if libc::fstat(fd, &mut stat) == 0 { (stat.st_dev, stat.st_ino) } else { (0, 0) }
    }
}

fn bus_of(fd: c_int) -> Option<Arc<Bus>> {
    let buses = buses();
    if buses.is_empty() {
        return None;
    }
    let identity = identity(fd);
    buses.iter().find(|bus| bus.identity == identity).cloned()
}

pub fn memfd() -> OwnedFd {
    // SAFETY: the name is a C string; a new descriptor is ours.
    unsafe {
        let fd = libc::memfd_create(c"fake-usb".as_ptr(), libc::MFD_CLOEXEC);
        assert!(fd >= 0, "memfd_create failed");
        OwnedFd::from_raw_fd(fd)
    }
}

/// A counter that polls as readable while it is not 0.
pub fn eventfd() -> OwnedFd {
    // SAFETY: a new descriptor is ours.
    unsafe {
        let fd = libc::eventfd(0, libc::EFD_NONBLOCK | libc::EFD_CLOEXEC);
        assert!(fd >= 0, "eventfd failed");
        OwnedFd::from_raw_fd(fd)
    }
}

fn errno(code: c_int) -> c_int {
    // SAFETY: the address is this thread's own.
    unsafe { *libc::__errno_location() = code };
    -1
}

/// # Safety
/// As ioctl(2).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ioctl(fd: c_int, request: c_ulong, argument: *mut c_void) -> c_int {
    let number = request & 0xFF;
    let bus = if request >> 8 & 0xFF == c_ulong::from(b'U') { bus_of(fd) } else { None };
    let Some(bus) = bus else {
        // SAFETY: passed on as it came.
        return unsafe { libc::syscall(libc::SYS_ioctl, fd, request, argument) } as c_int;
    };
    // SAFETY: libusb passes the structures that linux/usbdevice_fs.h names for these numbers.
    let result = unsafe {
        match number {
            0 => {
                let control = &mut *argument.cast::<RawControl>();
                let length = u16::from_le_bytes([control.setup[6], control.setup[7]]).into();
                let data = std::slice::from_raw_parts_mut(control.data, length);
                bus.request(Request::Control { setup: control.setup, data })
            }
            4 => bus.request(Request::SetInterface(*argument.cast())),
            10 => bus.request(Request::Submit(Urb(argument.cast()))),
            11 => bus.request(Request::Discard(Urb(argument.cast()))),
            13 => bus.request(Request::Reap(&mut *argument.cast())),
            15 | 27 => bus.request(Request::Claim),
            16 => bus.request(Request::Release(*argument.cast())),
            17 => bus.request(Request::ConnectInfo(&mut *argument.cast())),
            20 => bus.request(Request::Reset),
            21 => bus.request(Request::ClearHalt),
            26 => bus.request(Request::Capabilities(&mut *argument.cast())),
            31 => bus.request(Request::Speed),
            _ => bus.request(Request::Other),
        }
    };
    result.unwrap_or_else(errno)
}

/// # Safety
/// As poll(2).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn poll(fds: *mut libc::pollfd, count: libc::nfds_t, limit_ms: c_int) -> c_int {
    let given: &mut [libc::pollfd] = match count {
        0 => &mut [],
        // SAFETY: the caller says that there are so many.
        _ => unsafe { std::slice::from_raw_parts_mut(fds, count as usize) },
    };
    let owners: Vec<_> = given.iter().map(|fd| bus_of(fd.fd)).collect();
    let mut real: Vec<_> = given.to_vec();
    for (fd, bus) in real.iter_mut().zip(&owners) {
        if let Some(bus) = bus {
            (fd.fd, fd.events) = (bus.event.as_raw_fd(), libc::POLLIN);
        }
    }
    let limit = libc::timespec {
        tv_sec: (limit_ms / 1000).into(),
        tv_nsec: (libc::c_long::from(limit_ms) % 1000) * 1_000_000,
    };
    let limit: *const libc::timespec = if limit_ms < 0 { std::ptr::null() } else { &limit };
    // SAFETY: `real` has `count` entries; the last two say that no signal mask is given.
    let result = unsafe {
        libc::syscall(libc::SYS_ppoll, real.as_mut_ptr(), count, limit, std::ptr::null::<c_void>(), 8usize)
    };
    for ((fd, real), bus) in given.iter_mut().zip(&real).zip(&owners) {
        fd.revents = match bus {
            Some(bus) if real.revents != 0 => bus.poll_events(),
            _ => real.revents,
        };
    }
    result as c_int
}
