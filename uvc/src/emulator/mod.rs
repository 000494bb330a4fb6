//! A head made of software: descriptors, controls, stream and faults in one model without threads or clock, which is told the time.
//! Behind two faces: USB/IP attaches it to a Linux kernel; the tests put it behind a usbfs of their own. It is also the
//! reference for firmware: `uvc/PROTOCOL.md` says in words what this does.

pub mod descriptors;
pub mod flash;
mod stream;
pub mod usbip;

use crate::Error;
use crate::descriptor::UvcVersion;
use crate::head::{Control, Controls, Lasers};
use crate::mode::PREFERRED_INTERVAL;
use crate::probe::Probe;
use flash::Flash;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use stream::Sending;

/// How the stream travels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pipe {
    /// What is left of the bus.
    Bulk,
    /// Reserved bandwidth.
    Isochronous,
}

/// What kind of head it is.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Version of the video class.
    pub version: UvcVersion,
    /// How the stream travels.
    pub pipe: Pipe,
    /// Serial number, printable ASCII, at most 32.
    pub serial: String,
    /// Bytes of a bulk payload with its header.
    pub max_payload_bytes: u32,
    /// What dwMaxPayloadTransferSize claims, if it is not the truth.
    pub claimed_payload_bytes: Option<u32>,
    /// Whether payloads carry the head's tag; other cameras' do not.
    pub tagged: bool,
    /// Frames come at the negotiated rate; otherwise as fast as they are read.
    pub paced: bool,
    /// The alternate setting that has the bulk endpoint: 0 as the protocol wants it, another as cameras exist.
    pub bulk_alternate: u8,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            version: UvcVersion::V1_1,
            pipe: Pipe::Bulk,
            serial: "SOFT-0001".into(),
            max_payload_bytes: 16 * 1024,
            claimed_payload_bytes: None,
            tagged: true,
            paced: false,
            bulk_alternate: 0,
        }
    }
}

/// What the sensor is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameRequest {
    /// Counts frames; wraps.
    pub sequence: u16,
    /// Frames since power-up.
    pub number: u64,
    /// Lasers that are on during the whole exposure.
    pub lasers: Lasers,
    /// A laser was switched since the frame before.
    pub switched: bool,
}

/// One way to spoil a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// EOF is never set.
    LostEof,
    /// FID does not toggle.
    StuckFid,
    /// The error bit is set.
    ErrorBit,
    /// A payload is not sent.
    LostPayload,
    /// A payload is sent twice.
    TwicePayload,
    /// The picture ends in its middle.
    TornJpeg,
    /// The bytes are no picture.
    NotJpeg,
    /// Larger than any frame may be.
    Huge,
    /// A header length that makes no sense.
    HeaderLength(u8),
    /// A payload shorter than its header.
    TooLongHeader,
    /// The whole frame is not sent.
    Vanished,
}

/// Where pictures come from; `None`: no more.
pub type Source = Box<dyn FnMut(FrameRequest) -> Option<Arc<[u8]>> + Send>;
/// Which frames are spoilt, by their number.
pub type Faults = Box<dyn FnMut(u64) -> Option<Fault> + Send>;

/// A request on the control pipe (USB 2.0, table 9-2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setup {
    /// bmRequestType.
    pub request_type: u8,
    /// bRequest.
    pub request: u8,
    /// wValue.
    pub value: u16,
    /// wIndex.
    pub index: u16,
    /// wLength.
    pub length: u16,
}

impl Setup {
    /// From the eight bytes on the wire.
    pub fn parse(b: &[u8; 8]) -> Self {
        let u16_at = |i: usize| u16::from_le_bytes([b[i], b[i + 1]]);
        Self { request_type: b[0], request: b[1], value: u16_at(2), index: u16_at(4), length: u16_at(6) }
    }
}

/// The endpoint refuses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stall;

/// What an IN transfer on the stream's pipe gets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum InReply {
    /// Bytes; fewer than asked for end the transfer.
    Data(Vec<u8>),
    /// Nothing yet.
    Wait,
}

/// Lasers go out when for so long nobody has read the stream or set them.
pub const LASER_HOLD: Duration = Duration::from_secs(2);
/// VC_REQUEST_ERROR_CODE: value out of range, invalid unit, invalid control, invalid request (UVC 1.5, table 4-10).
const OUT_OF_RANGE: u8 = 4;
const INVALID_UNIT: u8 = 5;
const INVALID_CONTROL: u8 = 6;
const INVALID_REQUEST: u8 = 7;

/// The head.
pub struct SoftwareHead {
    settings: Settings,
    source: Source,
    faults: Faults,
    /// The calibration store.
    pub flash: Flash,
    configuration: Vec<u8>,
    alternate: u8,
    probe: Probe,
    streaming: bool,
    error_code: u8,
    lasers: Lasers,
    lasers_until: Duration,
    /// A laser was switched since the last frame.
    switched: bool,
    power: [u8; 8],
    frame_id: bool,
    frames: u64,
    next_frame_at: Duration,
    sending: Option<Sending>,
    /// The bulk payload under way, and whether it must end with a short packet.
    payload: Vec<u8>,
    payload_sent: usize,
    owes_short_packet: bool,
}

impl SoftwareHead {
    /// A head that has just got power.
    pub fn new(settings: Settings, source: Source) -> Self {
        Self {
            configuration: descriptors::configuration(&settings),
            source,
            faults: Box::new(|_| None),
            flash: Flash::default(),
            alternate: 0,
            probe: Probe {
                format_index: 1,
                frame_index: 1,
                frame_interval: PREFERRED_INTERVAL,
                max_frame_bytes: descriptors::MAX_VIDEO_FRAME_BYTES,
                max_payload_bytes: payload_bytes(&settings),
                clock_hz: descriptors::CLOCK_HZ,
                hint: 0,
            },
            settings,
            streaming: false,
            error_code: 0,
            lasers: Lasers::OFF,
            lasers_until: Duration::ZERO,
            switched: false,
            power: [500u16.to_le_bytes(); 4].as_flattened().try_into().unwrap_or_default(),
            frame_id: false,
            frames: 0,
            next_frame_at: Duration::ZERO,
            sending: None,
            payload: Vec::new(),
            payload_sent: 0,
            owes_short_packet: false,
        }
    }

    /// Spoils frames.
    #[must_use]
    pub fn with_faults(mut self, faults: Faults) -> Self {
        self.faults = faults;
        self
    }

    /// Puts other bytes in place of the configuration.
    #[must_use]
    pub fn with_configuration(mut self, configuration: Vec<u8>) -> Self {
        self.configuration = configuration;
        self
    }

    /// Device and configuration descriptors.
    pub fn descriptors(&self) -> (Vec<u8>, Vec<u8>) {
        (descriptors::device(), self.configuration.clone())
    }

    /// Frames that the sensor took since power-up.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Lasers that are on.
    pub fn lasers(&self, now: Duration) -> Lasers {
        if now < self.lasers_until { self.lasers } else { Lasers::OFF }
    }

    /// The cable is out and in again, or the bus was reset: nothing but the store is left.
    pub fn power_up(&mut self) {
        self.stop();
        self.alternate = 0;
        self.flash.power_up();
    }

    /// The interface is let go, the bus sleeps, or the stream is stopped: lasers off.
    pub fn stop(&mut self) {
        self.streaming = false;
        self.lasers = Lasers::OFF;
        self.sending = None;
        self.payload.clear();
        self.payload_sent = 0;
        self.owes_short_packet = false;
    }

    /// CLEAR_FEATURE(ENDPOINT_HALT) on the stream's endpoint. Of a bulk pipe that was not halted it is the host's way to stop.
    pub fn clear_halt(&mut self, was_halted: bool) {
        if !was_halted && self.settings.pipe == Pipe::Bulk {
            self.stop();
        }
    }

    /// SET_INTERFACE of the streaming interface.
    pub fn set_alternate(&mut self, alternate: u8, now: Duration) -> Result<(), Stall> {
        let is_there = match self.settings.pipe {
            Pipe::Bulk => alternate == 0 || alternate == self.settings.bulk_alternate,
            Pipe::Isochronous => usize::from(alternate) <= descriptors::ISO_PACKETS.len(),
        };
        if !is_there {
            return Err(Stall);
        }
        self.stop();
        self.alternate = alternate;
        if alternate > 0 {
            self.start(now);
        }
        Ok(())
    }

    fn start(&mut self, now: Duration) {
        self.streaming = true;
        self.next_frame_at = now;
    }

    /// A request on the control pipe: bytes for the host, or a stall. `data` is what the host sends.
    pub fn control(&mut self, setup: Setup, data: &[u8], now: Duration) -> Result<Vec<u8>, Stall> {
        if !matches!(setup.request_type, 0x21 | 0xA1) {
            return self.standard_request(setup, now);
        }
        match self.class_request(setup, data, now) {
            Ok(mut answer) => {
                answer.truncate(usize::from(setup.length));
                Ok(answer)
            }
            Err(code) => {
                self.error_code = code;
                Err(Stall)
            }
        }
    }

    fn standard_request(&mut self, setup: Setup, now: Duration) -> Result<Vec<u8>, Stall> {
        let [index, kind] = setup.value.to_le_bytes();
        let mut answer = match (setup.request_type, setup.request, kind) {
            (0x80, 6, 1) => descriptors::device(),
            (0x80, 6, 2) => self.configuration.clone(),
            (0x80, 6, 3) => descriptors::string(index, &self.settings.serial).ok_or(Stall)?,
            (0x80, 8, _) => vec![1],
            (0x80..=0x82, 0, _) => vec![0, 0],
            (0x81, 10, _) => vec![if setup.index == 1 { self.alternate } else { 0 }],
            (0x00, 9, _) => {
                self.stop();
                vec![]
            }
            (0x01, 11, _) if setup.index == 1 => self.set_alternate(index, now).map(|()| vec![])?,
            (0x01, 11, _) if setup.index == 0 && index == 0 => vec![],
            (0x02, 1, _) => {
                self.clear_halt(false);
                vec![]
            }
            _ => return Err(Stall),
        };
        answer.truncate(usize::from(setup.length));
        Ok(answer)
    }

    /// On failure the code for VC_REQUEST_ERROR_CODE.
    fn class_request(&mut self, setup: Setup, data: &[u8], now: Duration) -> Result<Vec<u8>, u8> {
        let [interface, unit] = setup.index.to_le_bytes();
        let [_, selector] = setup.value.to_le_bytes();
        match (interface, unit, selector) {
            (0, 0, 2) if setup.request == 0x81 => Ok(vec![self.error_code]),
            (0, descriptors::EXTENSION_UNIT, _) => self.extension_request(setup.request, selector, data, now),
            (0, 0, _) => Err(INVALID_CONTROL),
            (1, 0, 1 | 2) => self.stream_request(setup.request, selector == 2, data, now),
            _ => Err(INVALID_UNIT),
        }
    }

    fn stream_request(
        &mut self,
        request: u8,
        commit: bool,
        data: &[u8],
        now: Duration,
    ) -> Result<Vec<u8>, u8> {
        let length = self.settings.version.probe_bytes();
        match request {
            0x01 => {
                let asked = Probe::decode(data).ok().ok_or(OUT_OF_RANGE)?;
                if asked.format_index > 1 || asked.frame_index > 1 {
                    return Err(OUT_OF_RANGE);
                }
                self.probe.hint = asked.hint;
                if asked.frame_interval != 0 {
                    self.probe.frame_interval = asked.frame_interval.max(PREFERRED_INTERVAL);
                }
                if commit && self.settings.pipe == Pipe::Bulk && self.settings.bulk_alternate == 0 {
                    self.stop();
                    self.start(now);
                }
                Ok(vec![])
            }
            0x81 | 0x82 | 0x83 | 0x87 => Ok(self.probe.encode(length)),
            0x85 => Ok(u16::try_from(length).unwrap_or(0).to_le_bytes().to_vec()),
            0x86 => Ok(vec![3]),
            _ => Err(INVALID_REQUEST),
        }
    }

    fn extension_request(
        &mut self,
        request: u8,
        selector: u8,
        data: &[u8],
        now: Duration,
    ) -> Result<Vec<u8>, u8> {
        let control = Control::from_selector(selector).ok_or(INVALID_CONTROL)?;
        match request {
            0x01 if control.writable() => self.set(control, data, now).map(|()| vec![]),
            0x81 => self.get(control, now),
            // Linux asks for all of these when the control is first used.
            0x82..=0x84 | 0x87 => Ok(match (control, request) {
                (Control::Lasers, 0x83) => vec![0xF],
                (Control::Power, 0x83) => [1000u16.to_le_bytes(); 4].concat(),
                (_, 0x84) => vec![1; control.bytes()],
                _ => vec![0; control.bytes()],
            }),
            0x85 => Ok(u16::try_from(control.bytes()).unwrap_or(0).to_le_bytes().to_vec()),
            0x86 => Ok(vec![if control.writable() { 3 } else { 1 }]),
            _ => Err(INVALID_REQUEST),
        }
    }

    fn get(&self, control: Control, now: Duration) -> Result<Vec<u8>, u8> {
        Ok(match control {
            Control::Lasers => vec![self.lasers(now).bits()],
            Control::Power => self.power.to_vec(),
            Control::Serial => {
                let mut serial = self.settings.serial.as_bytes().to_vec();
                serial.resize(control.bytes(), 0);
                serial
            }
            Control::Temperature => {
                // It warms up by 10 degrees in an hour or so.
                let minutes = u16::try_from(now.as_secs() / 60).unwrap_or(u16::MAX).min(60);
                (2500 + 1000 / 60 * i16::try_from(minutes).unwrap_or(0)).to_le_bytes().to_vec()
            }
            Control::StoreInfo => self.flash.info().encode().to_vec(),
            Control::StoreStatus => self.flash.status().to_vec(),
            Control::StorePage => self.flash.page().ok_or(OUT_OF_RANGE)?.encode(),
            Control::StoreCommand => vec![0; control.bytes()],
        })
    }

    fn set(&mut self, control: Control, data: &[u8], now: Duration) -> Result<(), u8> {
        if data.len() != control.bytes() {
            return Err(OUT_OF_RANGE);
        }
        let fine = match control {
            Control::Lasers => match Lasers::from_bits(data[0]) {
                Ok(on) => {
                    self.switched |= on != self.lasers(now);
                    self.lasers = on;
                    self.lasers_until = now + LASER_HOLD;
                    true
                }
                Err(_) => false,
            },
            Control::Power => match data.try_into() {
                Ok(power) if data.chunks(2).all(|p| u16::from_le_bytes([p[0], p[1]]) <= 1000) => {
                    self.power = power;
                    true
                }
                _ => false,
            },
            Control::StoreCommand => data.try_into().is_ok_and(|command| self.flash.command(command)),
            Control::StorePage => self.flash.write_page(data),
            _ => false,
        };
        if fine { Ok(()) } else { Err(OUT_OF_RANGE) }
    }

    /// Bytes for a bulk transfer of `length`.
    pub fn bulk_in(&mut self, length: usize, now: Duration) -> InReply {
        if !self.streaming || self.settings.pipe != Pipe::Bulk {
            return InReply::Wait;
        }
        let room = self.settings.max_payload_bytes as usize;
        let mut bytes = Vec::with_capacity(length);
        while bytes.len() < length {
            if self.payload_sent == self.payload.len() {
                if std::mem::take(&mut self.owes_short_packet) {
                    return InReply::Data(bytes); // a packet of no bytes, or a transfer that is short anyway
                }
                match self.next_payload(room, now) {
                    Some(payload) => self.payload = payload,
                    None if bytes.is_empty() => return InReply::Wait,
                    None => return InReply::Data(bytes),
                }
                self.payload_sent = 0;
                self.owes_short_packet = self.payload.len() < room;
            }
            let take = (length - bytes.len()).min(self.payload.len() - self.payload_sent);
            bytes.extend(&self.payload[self.payload_sent..self.payload_sent + take]);
            self.payload_sent += take;
            if self.payload_sent == self.payload.len() && !self.payload.len().is_multiple_of(512) {
                self.owes_short_packet = false; // its last packet was short
                break;
            }
        }
        self.lasers_until = now + LASER_HOLD;
        InReply::Data(bytes)
    }

    /// The packet of one microframe, at most `length` bytes; empty if there is nothing to send.
    pub fn iso_in(&mut self, length: usize, now: Duration) -> Vec<u8> {
        if !self.streaming || self.settings.pipe != Pipe::Isochronous {
            return Vec::new();
        }
        self.lasers_until = now + LASER_HOLD;
        let setting = usize::from(self.alternate).saturating_sub(1);
        let room = descriptors::ISO_PACKETS.get(setting).map_or(0, |_| 1024 * (setting + 1));
        self.next_payload(length.min(room), now).unwrap_or_default()
    }

    fn next_payload(&mut self, room: usize, now: Duration) -> Option<Vec<u8>> {
        if self.sending.as_ref().is_none_or(Sending::is_done) {
            self.sending = self.next_frame(now);
        }
        Some(self.sending.as_mut()?.payload(room))
    }

    fn next_frame(&mut self, now: Duration) -> Option<Sending> {
        if self.settings.paced && now < self.next_frame_at {
            return None;
        }
        self.next_frame_at += Duration::from_nanos(u64::from(self.probe.frame_interval) * 100);
        if self.next_frame_at < now {
            self.next_frame_at = now; // the host was too slow: frames are left out, not saved up
        }
        loop {
            let shot = FrameRequest {
                sequence: (self.frames & 0xFFFF) as u16,
                number: self.frames,
                lasers: self.lasers(now),
                switched: std::mem::take(&mut self.switched),
            };
            let jpeg = (self.source)(shot)?;
            let fault = (self.faults)(self.frames);
            self.frames += 1;
            if fault == Some(Fault::Vanished) {
                continue;
            }
            if fault != Some(Fault::StuckFid) {
                self.frame_id = !self.frame_id;
            }
            let clock = (now.as_micros() & u128::from(u32::MAX)) as u32;
            return Some(Sending::new(jpeg, shot, self.frame_id, self.settings.tagged, clock, fault));
        }
    }
}

fn payload_bytes(settings: &Settings) -> u32 {
    let truth = match settings.pipe {
        Pipe::Bulk => settings.max_payload_bytes,
        Pipe::Isochronous => 3072,
    };
    settings.claimed_payload_bytes.unwrap_or(truth)
}

/// The head's controls without a bus in between, at time 0.
pub struct WithoutBus(pub Mutex<SoftwareHead>);

impl WithoutBus {
    /// A head that answers at once.
    pub fn new(head: SoftwareHead) -> Self {
        Self(Mutex::new(head))
    }

    /// The head itself.
    pub fn head(&self) -> std::sync::MutexGuard<'_, SoftwareHead> {
        self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    fn request(&self, request: u8, control: Control, data: &[u8]) -> Result<Vec<u8>, Error> {
        self.head().extension_request(request, control as u8, data, Duration::ZERO).map_err(|code| {
            Error::new(crate::ErrorKind::Refused, format!("{control:?}: refused with code {code}"))
        })
    }
}

impl Controls for WithoutBus {
    fn get(&self, control: Control) -> Result<Vec<u8>, Error> {
        self.request(0x81, control, &[])
    }

    fn set(&self, control: Control, value: &[u8]) -> Result<(), Error> {
        self.request(0x01, control, value).map(drop)
    }
}
