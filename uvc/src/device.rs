//! An open head: found or handed in as a descriptor, its descriptors read, its extension unit checked before anything is written.

use crate::descriptor::{Configuration, Device as DeviceDescriptor, Finding, VideoFunction, lint};
use crate::head::{self, Control, Controls, GUID, Lasers};
use crate::sys::{self, ControlData, Handle};
use crate::{Error, ErrorKind};
use std::os::fd::BorrowedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How long an answer on the control pipe may take. USB allows 0.5 to 5 s; a head that needs more than one is broken.
pub(crate) const CONTROL_LIMIT: Duration = Duration::from_secs(1);

pub(crate) const SET_CUR: u8 = 0x01;
pub(crate) const GET_CUR: u8 = 0x81;
pub(crate) const GET_LEN: u8 = 0x85;
const TO_INTERFACE: u8 = 0x21;
const FROM_INTERFACE: u8 = 0xA1;
const REQUEST_ERROR_CODE: u16 = 0x0200;

/// Which device is meant; what is `None` does not matter.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Selector {
    /// Vendor's and product's number.
    pub product: Option<(u16, u16)>,
    /// Serial number.
    pub serial: Option<String>,
}

/// A camera of USB video class that the system shows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ListedCamera {
    /// Vendor's and product's number.
    pub product: (u16, u16),
    /// Bus and address.
    pub place: (u8, u8),
    /// What it is, or why that is not known or it cannot be used.
    pub state: Result<Identity, String>,
    /// Contradictions in its descriptors, also of a camera that cannot be used for them.
    pub findings: Vec<Finding>,
}

/// What a device says it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Its serial number; empty if it has none.
    pub serial: String,
    /// It has the lasers' extension unit.
    pub is_head: bool,
}

pub(crate) struct Inner {
    pub handle: Handle,
    pub video: VideoFunction,
    descriptors: DeviceDescriptors,
    extension_unit: Option<u8>,
    /// A laser was switched on and not all off since.
    lasers_on: AtomicBool,
}

/// An open camera, and, if it has the extension unit, head. Lasers go off when the last clone of it and its stream are dropped.
#[derive(Clone)]
pub struct Device {
    pub(crate) inner: Arc<Inner>,
}

/// All cameras that the system shows. They are only asked for their descriptors: a program that has one keeps it.
pub fn devices() -> Result<Vec<ListedCamera>, Error> {
    let mut found = Vec::new();
    for listed in sys::list()? {
        let (state, findings) = match listed.open().and_then(|handle| DeviceDescriptors::ask(&handle)) {
            Ok(descriptors) => {
                if descriptors.video().is_err_and(|e| e.kind() == ErrorKind::Unsupported) {
                    continue; // no camera
                }
                (descriptors.identity().map_err(|e| e.to_string()), descriptors.lint())
            }
            Err(e) => (Err(e.to_string()), Vec::new()),
        };
        let product = (listed.vendor_id, listed.product_id);
        found.push(ListedCamera { product, place: listed.place, state, findings });
    }
    Ok(found)
}

/// What a device answers without being taken from whoever has it: its descriptors.
pub(crate) struct DeviceDescriptors {
    device: Vec<u8>,
    configuration: Vec<u8>,
    serial: String,
}

impl DeviceDescriptors {
    pub(crate) fn ask(handle: &Handle) -> Result<Self, Error> {
        let descriptor = |kind: u16, index: u16, length: u16| {
            let (value, language) = (kind << 8 | index, if kind == 3 { 0x0409 } else { 0 });
            handle
                .control(0x80, 6, value, language, ControlData::In(length), CONTROL_LIMIT)
                .map_err(|code| code.error(format!("reading descriptor {kind}")))
        };
        let device = descriptor(1, 0, 18)?;
        let head = descriptor(2, 0, 9)?;
        let total = head.get(2..4).map_or(9, |b| u16::from_le_bytes([b[0], b[1]]));
        let configuration = descriptor(2, 0, total)?;
        // A broken device descriptor is told by `identity`, after `lint` had it.
        let serial = match DeviceDescriptor::parse(&device).map_or(0, |parsed| parsed.serial_string) {
            0 => String::new(),
            index => text_of(&descriptor(3, index.into(), 255)?),
        };
        Ok(Self { device, configuration, serial })
    }

    fn video(&self) -> Result<VideoFunction, Error> {
        VideoFunction::parse(&Configuration::parse(&self.configuration)?)
    }

    fn identity(&self) -> Result<Identity, Error> {
        DeviceDescriptor::parse(&self.device)?;
        let is_head = self.video()?.extension(&GUID).is_some();
        Ok(Identity { serial: self.serial.clone(), is_head })
    }

    fn lint(&self) -> Vec<Finding> {
        lint(&self.device, &self.configuration)
    }
}

impl Device {
    /// Opens by a descriptor of usbfs, such as Android's `UsbDeviceConnection` has. It is duplicated; the caller keeps his.
    pub fn from_fd(fd: BorrowedFd<'_>) -> Result<Self, Error> {
        Self::new(Handle::from_fd(fd)?)
    }

    /// What the device behind a descriptor of usbfs is, as [`devices`] asks it: nothing is taken from a program that has it.
    pub fn identify(fd: BorrowedFd<'_>) -> Result<(Result<Identity, Error>, Vec<Finding>), Error> {
        let descriptors = DeviceDescriptors::ask(&Handle::from_fd(fd)?)?;
        Ok((descriptors.identity(), descriptors.lint()))
    }

    /// Finds and opens the one device that is meant; others are left to whoever has them. A device that cannot be asked is skipped if
    /// another one fits.
    pub fn open(selector: &Selector) -> Result<Self, Error> {
        let mut fitting = Vec::new();
        let mut failure = None;
        for listed in sys::list()? {
            if selector.product.is_some_and(|product| product != (listed.vendor_id, listed.product_id)) {
                continue;
            }
            let opened = listed.open().and_then(|handle| {
                let descriptors = DeviceDescriptors::ask(&handle)?;
                let identity = descriptors.identity()?;
                let named = selector.serial.as_ref().is_none_or(|serial| *serial == identity.serial);
                // Without a number or name any camera would do: only heads are meant.
                let meant = named && (identity.is_head || selector != &Selector::default());
                if meant { Self::take(handle, descriptors).map(Some) } else { Ok(None) }
            });
            match opened {
                Ok(device) => fitting.extend(device),
                Err(e) if e.kind() == ErrorKind::Unsupported => {}
                Err(e) => failure = Some(e),
            }
        }
        if fitting.len() > 1 {
            let serials: Vec<_> = fitting.iter().map(Self::serial).collect();
            let text =
                format!("{} devices fit, say which by serial number: {}", fitting.len(), serials.join(", "));
            return Err(Error::new(ErrorKind::InvalidArgument, text));
        }
        fitting.pop().ok_or_else(|| {
            failure.unwrap_or_else(|| Error::new(ErrorKind::NotFound, "no such head is attached"))
        })
    }

    fn new(handle: Handle) -> Result<Self, Error> {
        let descriptors = DeviceDescriptors::ask(&handle)?;
        descriptors.identity()?;
        Self::take(handle, descriptors)
    }

    /// Takes its control interface, from Linux's own driver too.
    fn take(handle: Handle, descriptors: DeviceDescriptors) -> Result<Self, Error> {
        let video = descriptors.video()?;
        let extension_unit = video.extension(&GUID).map(|(unit, _)| unit);
        handle
            .claim(video.control_interface)
            .map_err(|code| code.error(format!("taking interface {}", video.control_interface)))?;
        let inner = Inner { handle, video, descriptors, extension_unit, lasers_on: AtomicBool::new(false) };
        inner.check_extension()?;
        Ok(Self { inner: Arc::new(inner) })
    }

    /// Serial number of the device descriptor; empty if it has none.
    pub fn serial(&self) -> &str {
        &self.inner.descriptors.serial
    }

    /// Whether it has lasers and a calibration store.
    pub fn is_head(&self) -> bool {
        self.inner.extension_unit.is_some()
    }

    /// What its descriptors say.
    pub fn video(&self) -> &VideoFunction {
        &self.inner.video
    }

    /// Contradictions in its descriptors.
    pub fn lint(&self) -> Vec<Finding> {
        self.inner.descriptors.lint()
    }

    /// Switches lasers and reads back. While no stream is read, repeat it at least once a second, or they go out.
    pub fn set_lasers(&self, on: Lasers) -> Result<(), Error> {
        self.inner.set_lasers(on)
    }
}

impl Controls for Device {
    fn get(&self, control: Control) -> Result<Vec<u8>, Error> {
        self.inner.get(control)
    }

    fn set(&self, control: Control, value: &[u8]) -> Result<(), Error> {
        self.inner.set(control, value)
    }
}

impl Inner {
    /// A unit that does not have the controls, or has others under their numbers, is never written to.
    fn check_extension(&self) -> Result<(), Error> {
        let Some((unit, extension)) = self.video.extension(&GUID) else { return Ok(()) };
        for control in Control::ALL {
            if !extension.has(control as u8) {
                let text = format!("extension unit {unit} lacks control {} ({control:?})", control as u8);
                return Err(Error::new(ErrorKind::Unsupported, text));
            }
            let answer = self.request(unit, GET_LEN, control as u8, ControlData::In(2))?;
            let length = answer.get(..2).map(|b| usize::from(u16::from_le_bytes([b[0], b[1]])));
            if length != Some(control.bytes()) {
                let text = format!(
                    "{control:?}: the head says that it has {length:?} bytes, {} are needed",
                    control.bytes()
                );
                return Err(Error::new(ErrorKind::Unsupported, text));
            }
        }
        Ok(())
    }

    fn request(&self, unit: u8, request: u8, selector: u8, data: ControlData<'_>) -> Result<Vec<u8>, Error> {
        let index = u16::from(unit) << 8 | u16::from(self.video.control_interface);
        self.class_request(request, u16::from(selector) << 8, index, data)
            .map_err(|e| e.in_context(format!("control {selector} of unit {unit}")))
    }

    /// A request of the video class; on a refusal the device is asked why.
    pub fn class_request(
        &self,
        request: u8,
        value: u16,
        index: u16,
        data: ControlData<'_>,
    ) -> Result<Vec<u8>, Error> {
        let kind = if matches!(data, ControlData::In(_)) { FROM_INTERFACE } else { TO_INTERFACE };
        self.handle.control(kind, request, value, index, data, CONTROL_LIMIT).map_err(|code| {
            let error = code.error("request");
            if error.kind() != ErrorKind::Refused {
                return error;
            }
            let why = self.handle.control(
                FROM_INTERFACE,
                GET_CUR,
                REQUEST_ERROR_CODE,
                self.video.control_interface.into(),
                ControlData::In(1),
                CONTROL_LIMIT,
            );
            match why.ok().as_deref() {
                Some([code]) => Error::new(ErrorKind::Refused, format!("{error}: {}", refusal(*code))),
                _ => error,
            }
        })
    }

    pub fn set_lasers(&self, on: Lasers) -> Result<(), Error> {
        if on != Lasers::OFF {
            self.lasers_on.store(true, Ordering::SeqCst); // before the write: it may work and still fail
        }
        head::set_lasers(self, on)?;
        if on == Lasers::OFF {
            self.lasers_on.store(false, Ordering::SeqCst);
        }
        Ok(())
    }

    /// Off, if any may be on. A failure is returned only: the head switches off by itself when nobody reads it.
    pub fn lasers_off(&self) -> Result<(), Error> {
        if self.lasers_on.load(Ordering::SeqCst) { self.set_lasers(Lasers::OFF) } else { Ok(()) }
    }
}

impl Controls for Inner {
    fn get(&self, control: Control) -> Result<Vec<u8>, Error> {
        let length = u16::try_from(control.bytes()).unwrap_or(u16::MAX);
        self.request(self.unit()?, GET_CUR, control as u8, ControlData::In(length))
    }

    fn set(&self, control: Control, value: &[u8]) -> Result<(), Error> {
        if control == Control::Lasers && value != [0] {
            self.lasers_on.store(true, Ordering::SeqCst);
        }
        self.request(self.unit()?, SET_CUR, control as u8, ControlData::Out(value)).map(drop)
    }
}

impl Inner {
    fn unit(&self) -> Result<u8, Error> {
        self.extension_unit.ok_or_else(|| {
            Error::new(
                ErrorKind::Unsupported,
                "this camera has no lasers: the head's extension unit is missing",
            )
        })
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        // Nobody is left to tell of a failure; the head switches off by itself then.
        drop(self.lasers_off());
        self.handle.release(self.video.control_interface).ok();
    }
}

/// VC_REQUEST_ERROR_CODE (UVC 1.5, table 4-10).
fn refusal(code: u8) -> String {
    match code {
        1 => "the device is not ready".into(),
        2 => "wrong state".into(),
        3 => "not enough power".into(),
        4 => "value out of range".into(),
        5 => "no such unit".into(),
        6 => "no such control".into(),
        7 => "no such request".into(),
        8 => "invalid value within range".into(),
        _ => format!("code {code}"),
    }
}

/// The text of a string descriptor; what is no text is replaced.
fn text_of(descriptor: &[u8]) -> String {
    let length = descriptor.first().map_or(0, |length| usize::from(*length)).min(descriptor.len());
    let units: Vec<u16> =
        descriptor[..length].chunks_exact(2).skip(1).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
    String::from_utf16_lossy(&units)
}
