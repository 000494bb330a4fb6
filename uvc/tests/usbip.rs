//! The software head over USB/IP, with a host of a few lines in the place of Linux.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

mod support;

use boxline_uvc::Assembler;
use boxline_uvc::bulk::BulkSplitter;
use boxline_uvc::emulator::{Pipe, Settings, SoftwareHead, usbip};
use boxline_uvc::probe::Probe;
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use support::{picture, pictures, size_of};

const MOST: usize = 30_000;
const ECONNRESET: i32 = -104;

struct Host(UnixStream);

struct Reply {
    command: u32,
    sequence: u32,
    status: i32,
    length: usize,
    packets: usize,
}

impl Host {
    fn send(&mut self, fields: [u32; 10], setup: [u8; 8], data: &[u8]) {
        let mut message: Vec<u8> = fields.iter().flat_map(|field| field.to_be_bytes()).collect();
        message.extend(setup);
        message.extend(data);
        self.0.write_all(&message).unwrap();
    }

    fn reply(&mut self) -> Reply {
        let mut header = [0; 48];
        self.0.read_exact(&mut header).unwrap();
        let field = |i: usize| u32::from_be_bytes(header[4 * i..4 * i + 4].try_into().unwrap());
        Reply {
            command: field(0),
            sequence: field(1),
            status: field(5) as i32,
            length: field(6) as usize,
            packets: field(8) as usize,
        }
    }

    fn bytes(&mut self, count: usize) -> Vec<u8> {
        let mut bytes = vec![0; count];
        self.0.read_exact(&mut bytes).unwrap();
        bytes
    }

    /// A control request; the bytes that came, or the status.
    fn control(&mut self, sequence: u32, setup: [u8; 8], out: &[u8]) -> Result<Vec<u8>, i32> {
        let to_host = setup[0] >> 7;
        let length = u32::from(u16::from_le_bytes([setup[6], setup[7]]));
        self.send([1, sequence, 0x10002, to_host.into(), 0, 0, length, 0, 0, 0], setup, out);
        let reply = self.reply();
        assert_eq!((reply.command, reply.sequence), (3, sequence));
        if reply.status < 0 {
            return Err(reply.status);
        }
        Ok(if to_host == 1 { self.bytes(reply.length) } else { vec![] })
    }

    fn submit_in(&mut self, sequence: u32, length: u32, packets: &[u32]) {
        let count = packets.len() as u32;
        let descriptors: Vec<u8> =
            packets.iter().flat_map(|n| [0, *n, 0, 0]).flat_map(u32::to_be_bytes).collect();
        self.send([1, sequence, 0x10002, 1, 1, 0, length, 0, count, 1], [0; 8], &descriptors);
    }

    fn unlink(&mut self, sequence: u32, victim: u32) -> i32 {
        self.send([2, sequence, 0x10002, 0, 0, victim, 0, 0, 0, 0], [0; 8], &[]);
        let reply = self.reply();
        assert_eq!((reply.command, reply.sequence), (4, sequence));
        reply.status
    }
}

fn host(pipe: Pipe, frames: u64) -> (Host, std::thread::JoinHandle<std::io::Result<()>>) {
    let (ours, theirs) = UnixStream::pair().unwrap();
    let head = SoftwareHead::new(Settings { pipe, ..Settings::default() }, pictures(frames, MOST));
    let writer = theirs.try_clone().unwrap();
    (Host(ours), std::thread::spawn(move || usbip::serve(theirs, writer, head).1))
}

const COMMIT: [u8; 8] = [0x21, 1, 0, 2, 1, 0, 34, 0];

#[test]
fn descriptors_stalls_and_unlinks() {
    let (mut host, server) = host(Pipe::Bulk, 0);
    let device = host.control(1, [0x80, 6, 0, 1, 0, 0, 18, 0], &[]).unwrap();
    assert_eq!((device.len(), device[0], device[1]), (18, 18, 1));
    assert_eq!(host.control(2, [0x80, 6, 0, 9, 0, 0, 18, 0], &[]), Err(-32));
    assert_eq!(host.control(3, COMMIT, &Probe::default().encode(34)), Ok(vec![]));
    // Nothing is there to be read, so a block waits until it is unlinked, and is not answered afterwards.
    host.submit_in(4, 512, &[]);
    assert_eq!(host.unlink(5, 4), ECONNRESET);
    assert_eq!(host.unlink(6, 4), 0);
    assert_eq!(host.control(7, [0x80, 8, 0, 0, 0, 0, 1, 0], &[]), Ok(vec![1]));
    drop(host);
    server.join().unwrap().unwrap();
}

#[test]
fn frames_over_both_pipes() {
    for pipe in [Pipe::Bulk, Pipe::Isochronous] {
        let (mut host, server) = host(pipe, 20);
        let mut frames = Assembler::new(MOST);
        let mut splitter = BulkSplitter::new(16 * 1024);
        let packets: &[u32] = if pipe == Pipe::Bulk { &[] } else { &[3072; 8] };
        let start = if pipe == Pipe::Bulk { COMMIT } else { [1, 11, 3, 0, 1, 0, 0, 0] };
        let out = if pipe == Pipe::Bulk { Probe::default().encode(34) } else { vec![] };
        host.control(1, start, &out).unwrap();
        for sequence in 2.. {
            host.submit_in(sequence, 24_576, packets);
            let reply = host.reply();
            assert_eq!((reply.command, reply.sequence, reply.status), (3, sequence, 0));
            assert_eq!(reply.packets, packets.len());
            let data = host.bytes(reply.length);
            if pipe == Pipe::Bulk {
                splitter.transfer(&data, data.len() < 24_576, &mut frames);
            } else {
                let mut rest = &data[..];
                for packet in host.bytes(16 * packets.len()).chunks(16) {
                    let actual = u32::from_be_bytes(packet[8..12].try_into().unwrap()) as usize;
                    let (now, later) = rest.split_at(actual);
                    frames.payload(now);
                    rest = later;
                }
                assert!(rest.is_empty());
            }
            if frames.counters().delivered == 20 {
                break;
            }
        }
        for (number, frame) in (0..).zip(frames.take_ready()) {
            assert!(frame.jpeg == picture(number, size_of(number, MOST)));
        }
        drop(host);
        server.join().unwrap().unwrap();
    }
}

#[test]
fn a_host_that_talks_nonsense_is_told_off() {
    for fields in [[9; 10], [1, 1, 0, 1, 1, 0, u32::MAX / 2, 0, 0, 0], [1, 1, 0, 1, 1, 0, 8, 0, 99_999, 0]] {
        let (mut host, server) = host(Pipe::Bulk, 0);
        host.send(fields, [0; 8], &[]);
        assert_eq!(server.join().unwrap().unwrap_err().kind(), std::io::ErrorKind::InvalidData);
    }
}
