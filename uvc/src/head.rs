//! The head's extension unit, as uvc/PROTOCOL.md lays it out: lasers, serial number, temperature. The calibration store is in
//! [`store`](crate::store). Pure: requests go through [`Controls`], which a device, or a head made of software, carries out.

use crate::{Error, ErrorKind};

/// The unit's GUID, 6f0a3c52-9d1e-4b7f-8a35-c2e41b7d9084, in the byte order of the descriptor.
pub const GUID: [u8; 16] =
    [0x52, 0x3c, 0x0a, 0x6f, 0x1e, 0x9d, 0x7f, 0x4b, 0x8a, 0x35, 0xc2, 0xe4, 0x1b, 0x7d, 0x90, 0x84];

/// A control of the unit; the number is its selector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Control {
    /// Which lasers are on.
    Lasers = 1,
    /// How bright each is.
    Power = 2,
    /// The head's serial number.
    Serial = 3,
    /// Temperature inside the head.
    Temperature = 4,
    /// What is stored.
    StoreInfo = 5,
    /// Begin, commit, abort, select a page.
    StoreCommand = 6,
    /// One page.
    StorePage = 7,
    /// How the last command went.
    StoreStatus = 8,
}

impl Control {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Lasers,
        Self::Power,
        Self::Serial,
        Self::Temperature,
        Self::StoreInfo,
        Self::StoreCommand,
        Self::StorePage,
        Self::StoreStatus,
    ];

    /// The control of a selector.
    pub fn from_selector(selector: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|control| *control as u8 == selector)
    }

    /// Bytes of its value.
    pub fn bytes(self) -> usize {
        match self {
            Self::Lasers => 1,
            Self::Power => 8,
            Self::Serial => 32,
            Self::Temperature => 2,
            Self::StoreInfo => 16,
            Self::StoreCommand => 12,
            Self::StorePage => 8 + crate::store::PAGE_BYTES,
            Self::StoreStatus => 4,
        }
    }

    /// Whether it can be written.
    pub fn writable(self) -> bool {
        matches!(self, Self::Lasers | Self::Power | Self::StoreCommand | Self::StorePage)
    }
}

/// Reads and writes controls of the unit.
pub trait Controls {
    /// GET_CUR.
    fn get(&self, control: Control) -> Result<Vec<u8>, Error>;
    /// SET_CUR. Never repeated after a time-out: the head may have done it.
    fn set(&self, control: Control, value: &[u8]) -> Result<(), Error>;
}

impl<C: Controls + ?Sized> Controls for &C {
    fn get(&self, control: Control) -> Result<Vec<u8>, Error> {
        (**self).get(control)
    }

    fn set(&self, control: Control, value: &[u8]) -> Result<(), Error> {
        (**self).set(control, value)
    }
}

/// A set of lasers; bit n is laser n + 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lasers(u8);

impl Lasers {
    /// All off.
    pub const OFF: Self = Self(0);
    /// All four on.
    pub const ALL: Self = Self(0xF);

    /// From four bits.
    pub fn from_bits(bits: u8) -> Result<Self, Error> {
        if bits > 0xF {
            let text = format!("lasers {bits:#04x}: there are four, 0x0f is the most");
            return Err(Error::new(ErrorKind::InvalidArgument, text));
        }
        Ok(Self(bits))
    }

    /// Bit n: laser n + 1.
    pub fn bits(self) -> u8 {
        self.0
    }
}

/// A value of exactly the length that the control has.
pub(crate) fn value<const N: usize>(controls: &impl Controls, control: Control) -> Result<[u8; N], Error> {
    let bytes = controls.get(control)?;
    let found = bytes.len();
    bytes.try_into().ok().ok_or_else(|| {
        let text = format!("{control:?}: the head answered {found} bytes, {N} are needed");
        Error::new(ErrorKind::Protocol, text)
    })
}

/// Which lasers are on.
pub fn lasers(controls: &impl Controls) -> Result<Lasers, Error> {
    let [bits] = value(controls, Control::Lasers)?;
    Lasers::from_bits(bits).map_err(|e| Error::new(ErrorKind::Protocol, format!("the head answered {e}")))
}

/// Switches lasers and reads back. They go out by themselves (uvc/PROTOCOL.md, "Lasers"): while no frames are read, repeat this.
pub fn set_lasers(controls: &impl Controls, on: Lasers) -> Result<(), Error> {
    controls.set(Control::Lasers, &[on.bits()])?;
    let now = lasers(controls)?;
    if now != on {
        let text = format!("lasers {:#06b} were asked for, {:#06b} are on", on.bits(), now.bits());
        return Err(Error::new(ErrorKind::Refused, text));
    }
    Ok(())
}

/// Power of each laser, thousandths of its most.
pub fn power_permille(controls: &impl Controls) -> Result<[u16; 4], Error> {
    let b: [u8; 8] = value(controls, Control::Power)?;
    Ok([0, 2, 4, 6].map(|i| u16::from_le_bytes([b[i], b[i + 1]])))
}

/// Sets the power of each laser, thousandths of its most.
pub fn set_power_permille(controls: &impl Controls, power: [u16; 4]) -> Result<(), Error> {
    if let Some(wrong) = power.iter().find(|power| **power > 1000) {
        return Err(Error::new(ErrorKind::InvalidArgument, format!("power {wrong}, 1000 is the most")));
    }
    controls.set(Control::Power, power.map(u16::to_le_bytes).as_flattened())
}

/// The head's serial number.
pub fn serial(controls: &impl Controls) -> Result<String, Error> {
    let bytes: [u8; 32] = value(controls, Control::Serial)?;
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    let text = &bytes[..end];
    if text.is_empty() || !text.iter().all(u8::is_ascii_graphic) {
        let text = text.escape_ascii();
        return Err(Error::new(
            ErrorKind::Protocol,
            format!("serial number {text:?}: printable ASCII is needed"),
        ));
    }
    Ok(text.iter().map(|byte| char::from(*byte)).collect())
}

/// Temperature inside the head, degrees Celsius.
pub fn temperature_celsius(controls: &impl Controls) -> Result<f64, Error> {
    Ok(f64::from(i16::from_le_bytes(value(controls, Control::Temperature)?)) / 100.0)
}
