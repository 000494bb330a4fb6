//! The software head as a USB/IP device (Documentation/usb/usbip_protocol.rst of Linux): attached to this machine's own
//! `vhci_hcd`, or offered on a socket to `usbip attach`. Linux then sees a camera like any other.
//!
//! A block that was unlinked is never answered, and one that was answered is not unlinked: both happen under one lock, since Linux drops
//! the whole device otherwise.

use super::{InReply, Setup, SoftwareHead, descriptors};
use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::TcpListener;
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

const CMD_SUBMIT: u32 = 1;
const CMD_UNLINK: u32 = 2;
const RET_SUBMIT: u32 = 3;
const RET_UNLINK: u32 = 4;
const EPIPE: i32 = -32;
const ECONNRESET: i32 = -104;
/// Speed and number of the device: high speed, bus 1, device 2.
const SPEED_HIGH: u32 = 3;
const DEVICE_ID: u32 = 0x0001_0002;
/// More than any host asks for at once.
const MAX_TRANSFER: usize = 4 << 20;
const MAX_PACKETS: usize = 1024;
/// A microframe, in which an isochronous pipe carries one packet.
const MICROFRAME: Duration = Duration::from_micros(125);
/// How often data is looked for.
const NAP: Duration = Duration::from_millis(1);
const OP_VERSION: u16 = 0x0111;

struct Block {
    sequence: u32,
    length: usize,
    /// Lengths of the packets of an isochronous block.
    packets: Vec<usize>,
}

struct State {
    head: SoftwareHead,
    writer: Box<dyn Write + Send>,
    pending: VecDeque<Block>,
    next_packet_at: Instant,
    since: Instant,
    ended: bool,
}

struct Link {
    state: Mutex<State>,
    changed: Condvar,
}

impl Link {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Serves one host until it goes away, and gives the head back as it is after an unplug.
pub fn serve(
    mut reader: impl Read,
    writer: impl Write + Send + 'static,
    head: SoftwareHead,
) -> (SoftwareHead, io::Result<()>) {
    let now = Instant::now();
    let state = State {
        head,
        writer: Box::new(writer),
        pending: VecDeque::new(),
        next_packet_at: now,
        since: now,
        ended: false,
    };
    let link = Arc::new(Link { state: Mutex::new(state), changed: Condvar::new() });
    let server = {
        let link = link.clone();
        std::thread::Builder::new().name("usbip stream".into()).spawn(move || link.run())
    };
    let result = server.map(|thread| {
        let result = link.read(&mut reader);
        link.lock().ended = true;
        link.changed.notify_all();
        drop(thread.join()); // it holds no more than the link
        result
    });
    let link =
        Arc::into_inner(link).map(|link| link.state.into_inner().unwrap_or_else(PoisonError::into_inner));
    match link {
        Some(mut state) => {
            state.head.power_up();
            (state.head, result.and_then(|result| result))
        }
        None => unreachable!("the only other owner has ended"),
    }
}

impl Link {
    fn read(&self, reader: &mut impl Read) -> io::Result<()> {
        loop {
            let mut header = [0; 48];
            match reader.read_exact(&mut header) {
                Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => return Ok(()),
                other => other?,
            }
            let field = |i: usize| u32::from_be_bytes([0, 1, 2, 3].map(|k| header[4 * i + k]));
            let (command, sequence, to_host, endpoint) = (field(0), field(1), field(3) == 1, field(4));
            match command {
                CMD_SUBMIT => {
                    let length = bounded(field(6), MAX_TRANSFER, "transfer")?;
                    // No packets: 0 or, from newer hosts, -1.
                    let count =
                        if field(8) == u32::MAX { 0 } else { bounded(field(8), MAX_PACKETS, "packets")? };
                    let mut out = vec![0; if to_host { 0 } else { length }];
                    reader.read_exact(&mut out)?;
                    let mut raw = vec![0; 16 * count];
                    reader.read_exact(&mut raw)?;
                    let packets = raw
                        .chunks_exact(16)
                        .map(|p| be_u32(p, 4) as usize)
                        .map(|n| n.min(MAX_TRANSFER))
                        .collect();
                    let setup: [u8; 8] = header[40..48].try_into().unwrap_or_default();
                    let mut state = self.lock();
                    if endpoint == 0 {
                        state.control(sequence, Setup::parse(&setup), &out)?;
                    } else {
                        state.pending.push_back(Block { sequence, length, packets });
                    }
                }
                CMD_UNLINK => {
                    let mut state = self.lock();
                    let victim = field(5);
                    let at = state.pending.iter().position(|block| block.sequence == victim);
                    let status = at.and_then(|at| state.pending.remove(at)).map_or(0, |_| ECONNRESET);
                    state.reply(RET_UNLINK, sequence, status, &[], &[])?;
                }
                other => return Err(invalid(format!("command {other}, 1 or 2 is needed"))),
            }
            self.changed.notify_all();
        }
    }

    /// Answers the blocks of the stream as data comes.
    fn run(&self) {
        let mut state = self.lock();
        while !state.ended {
            match state.serve_first() {
                Ok(true) => {
                    // Let the reader in, which may have an unlink or a control request.
                    drop(state);
                    std::thread::yield_now();
                    state = self.lock();
                }
                Ok(false) => {
                    state = self.changed.wait_timeout(state, NAP).unwrap_or_else(PoisonError::into_inner).0;
                }
                Err(_) => return, // the reader sees the same end
            }
        }
    }
}

impl State {
    fn control(&mut self, sequence: u32, setup: Setup, out: &[u8]) -> io::Result<()> {
        let now = self.since.elapsed();
        match self.head.control(setup, out, now) {
            Ok(answer) => {
                let sent = if setup.request_type & 0x80 == 0 { out.len() } else { answer.len() };
                self.reply(RET_SUBMIT, sequence, 0, &[sent, 0], &answer)
            }
            Err(super::Stall) => self.reply(RET_SUBMIT, sequence, EPIPE, &[0, 0], &[]),
        }
    }

    /// True if a block was answered.
    fn serve_first(&mut self) -> io::Result<bool> {
        let Some(block) = self.pending.front() else { return Ok(false) };
        let now = self.since.elapsed();
        if block.packets.is_empty() {
            let InReply::Data(bytes) = self.head.bulk_in(block.length, now) else { return Ok(false) };
            let sequence = block.sequence;
            self.pending.pop_front();
            self.reply(RET_SUBMIT, sequence, 0, &[bytes.len(), 0], &bytes)?;
            return Ok(true);
        }
        if Instant::now() < self.next_packet_at {
            return Ok(false);
        }
        let Some(block) = self.pending.pop_front() else { return Ok(false) };
        let time = MICROFRAME * u32::try_from(block.packets.len()).unwrap_or(1);
        // Behind by more than a tenth of a second nothing is made up for.
        let earliest = Instant::now().checked_sub(Duration::from_millis(100)).unwrap_or(self.next_packet_at);
        self.next_packet_at = self.next_packet_at.max(earliest) + time;
        let mut data = Vec::new();
        let mut packets = Vec::new();
        let mut offset = 0;
        for length in &block.packets {
            let packet = self.head.iso_in(*length, now);
            for field in [offset, *length, packet.len(), 0] {
                packets.extend(u32::try_from(field).unwrap_or(0).to_be_bytes());
            }
            data.extend(packet);
            offset += length;
        }
        let sent = data.len();
        data.extend(packets);
        self.reply(RET_SUBMIT, block.sequence, 0, &[sent, block.packets.len()], &data)?;
        Ok(true)
    }

    /// `fields`: actual length and number of packets, or none for an unlink.
    fn reply(
        &mut self,
        command: u32,
        sequence: u32,
        status: i32,
        fields: &[usize],
        data: &[u8],
    ) -> io::Result<()> {
        let mut message = Vec::with_capacity(48 + data.len());
        for field in [command, sequence, 0, 0, 0] {
            message.extend(field.to_be_bytes());
        }
        message.extend(status.to_be_bytes());
        if let [actual, packets] = fields {
            for field in [*actual, 0, *packets, 0] {
                message.extend(u32::try_from(field).unwrap_or(0).to_be_bytes());
            }
        }
        message.resize(48, 0);
        message.extend(data);
        self.writer.write_all(&message)
    }
}

/// Attaches a head to this machine's `vhci_hcd` and serves it until it is detached. Needs root and the module `vhci-hcd`.
pub fn attach(head: SoftwareHead, controller: &Path) -> (SoftwareHead, io::Result<()>) {
    let connected = UnixStream::pair().and_then(|(ours, theirs)| {
        let port = free_port(controller)?;
        let line = format!("{port} {} {DEVICE_ID} {SPEED_HIGH}", theirs.as_raw_fd());
        std::fs::write(controller.join("attach"), line)?;
        let writer = ours.try_clone()?;
        Ok((ours, writer)) // the kernel has its own hold on `theirs`
    });
    match connected {
        Ok((reader, writer)) => serve(reader, writer, head),
        Err(e) => (head, Err(e)),
    }
}

/// The first free port for high speed; lines of `status` are `hs  0000 004 ...`, 004 is free.
fn free_port(controller: &Path) -> io::Result<u32> {
    let status = std::fs::read_to_string(controller.join("status"))?;
    let ports = status.lines().filter_map(|line| {
        let mut words = line.split_whitespace();
        (words.next()? == "hs").then_some(())?;
        let port: u32 = words.next()?.parse().ok()?;
        (words.next()? == "004").then_some(port)
    });
    ports.min().ok_or_else(|| io::Error::other("vhci_hcd has no free port for high speed"))
}

/// Offers a head to `usbip list` and `usbip attach`, one host after the other, for ever.
pub fn listen(
    listener: &TcpListener,
    mut head: SoftwareHead,
    mut report: impl FnMut(&str),
) -> io::Result<()> {
    loop {
        let (mut stream, peer) = listener.accept()?;
        stream.set_nodelay(true)?;
        match import(&mut stream, &head) {
            Ok(true) => {
                report(&format!("attached by {peer}"));
                let (back, result) = serve(stream.try_clone()?, stream, head);
                head = back;
                report(&result.map_or_else(|e| format!("detached: {e}"), |()| "detached".into()));
            }
            Ok(false) => {}
            Err(e) => report(&format!("{peer}: {e}")),
        }
    }
}

/// The conversation before the device is handed over; true: it was.
fn import(stream: &mut (impl Read + Write), head: &SoftwareHead) -> io::Result<bool> {
    let mut request = [0; 8];
    stream.read_exact(&mut request)?;
    let (_, configuration) = head.descriptors();
    let mut device = vec![0; 256 + 32];
    device[..5].copy_from_slice(b"/head");
    device[256..259].copy_from_slice(b"1-1");
    for field in [1, 2, SPEED_HIGH] {
        device.extend(field.to_be_bytes());
    }
    for field in [descriptors::VENDOR_ID, descriptors::PRODUCT_ID, 0x0100] {
        device.extend(field.to_be_bytes());
    }
    device.extend([0xEF, 2, 1, 1, 1, configuration.get(4).copied().unwrap_or(0)]);
    let code = u16::from_be_bytes([request[2], request[3]]);
    let mut answer = OP_VERSION.to_be_bytes().to_vec();
    answer.extend((code & 0x7FFF).to_be_bytes());
    match code {
        0x8005 => {
            answer.extend([0, 0, 0, 0, 0, 0, 0, 1]);
            answer.extend(device);
            answer.extend([0x0E, 1, 0, 0, 0x0E, 2, 0, 0]);
            stream.write_all(&answer).map(|()| false)
        }
        0x8003 => {
            let mut bus_id = [0; 32];
            stream.read_exact(&mut bus_id)?;
            let known = bus_id.starts_with(b"1-1\0");
            answer.extend(u32::from(!known).to_be_bytes());
            if known {
                answer.extend(device);
            }
            stream.write_all(&answer).map(|()| known)
        }
        other => Err(invalid(format!("request {other:#06x}, 0x8003 or 0x8005 is needed"))),
    }
}

fn be_u32(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn bounded(value: u32, most: usize, what: &str) -> io::Result<usize> {
    let n = usize::try_from(value).unwrap_or(usize::MAX);
    if n > most { Err(invalid(format!("{what}: {n}, {most} is the most"))) } else { Ok(n) }
}

fn invalid(text: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, text)
}
