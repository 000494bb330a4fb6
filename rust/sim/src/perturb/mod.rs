//! Changes a finished frame in ways that leave the true sizes as they are: another JPEG quality, other light, noise, blur, black
//! bars, a date stamp, paint on the face. What is measured must not change by more than its sigma says.
//!
//! [`Shot`] is a frame with what its scene was, [`Perturbation`] one change of it. [`Perturbation::all`] is the list that
//! `boxline evaluate --perturb` goes through. The same seed gives the same bytes.

mod face;
mod margin;
mod paint;
mod picture;

pub use margin::{Corner, Sides};
pub use paint::{Ink, Paint, Part};

use crate::Error;
use boxline::frames::Point;
use boxline::{Calibration, Frame};
use face::FacePixels;
use std::fmt;
use std::sync::OnceLock;

/// A frame and where the face stands in it.
pub struct Shot<'a> {
    frame: &'a Frame,
    face: Option<TrueFace<'a>>,
    /// Light on the face, apart by where it comes from; made when paint is first asked for.
    pixels: OnceLock<FacePixels>,
}

/// Where the face is.
struct TrueFace<'a> {
    calibration: &'a Calibration,
    corners_cam_mm: [[f64; 3]; 4],
    corners_px: [[f64; 2]; 4],
}

impl<'a> Shot<'a> {
    /// A frame, and the corners of its face in the camera frame, going round; 0-1 and 3-2 are `length` edges. Without a face there
    /// is nothing to paint on, and nothing that bars could cover.
    #[must_use]
    pub fn new(
        frame: &'a Frame,
        calibration: &'a Calibration,
        corners_cam_mm: Option<[[f64; 3]; 4]>,
    ) -> Self {
        let face = corners_cam_mm.and_then(|corners_cam_mm| {
            let mut corners_px = [[0.0; 2]; 4];
            for (px, [x, y, z]) in corners_px.iter_mut().zip(corners_cam_mm) {
                let at = calibration.camera().px_from_point(&Point::new(x, y, z))?;
                *px = [at.u, at.v];
            }
            Some(TrueFace { calibration, corners_cam_mm, corners_px })
        });
        Self { frame, face, pixels: OnceLock::new() }
    }

    fn corners_px(&self) -> Option<&[[f64; 2]; 4]> {
        self.face.as_ref().map(|face| &face.corners_px)
    }

    fn pixels(&self) -> Option<&FacePixels> {
        let face = self.face.as_ref()?;
        Some(self.pixels.get_or_init(|| {
            FacePixels::new(self.frame, face.calibration, &face.corners_cam_mm, &face.corners_px)
        }))
    }
}

/// One change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Perturbation {
    /// Encoded again as JPEG.
    Jpeg {
        /// 1 to 100.
        quality: u8,
        /// Chroma at half the resolution (4:2:0), the mean of four pixels; else 4:4:4.
        halved_chroma: bool,
    },
    /// Linear light times this, clipped at white.
    Brightness(f32),
    /// Light of so many kelvin on a camera that is balanced for 6500.
    Temperature(f32),
    /// Normal noise of so many of 255 levels.
    Noise(f32),
    /// Gaussian blur of so many px.
    Blur(f32),
    /// Black bars along two borders, as far as the face leaves room.
    Bars(Sides),
    /// A date written into a corner of the picture, if the face leaves room.
    Date(Corner),
    /// Paint on the face; the lasers stay.
    Paint(Paint),
}

/// JPEG qualities: from what looks broken to what cameras write.
const QUALITIES: [u8; 10] = [50, 60, 68, 75, 80, 85, 89, 93, 95, 97];

impl Perturbation {
    /// The whole list.
    #[must_use]
    pub fn all() -> Vec<Self> {
        let mut all = Vec::new();
        for halved_chroma in [false, true] {
            all.extend(QUALITIES.map(|quality| Self::Jpeg { quality, halved_chroma }));
        }
        all.extend([0.6, 0.8, 1.2, 1.4].map(Self::Brightness));
        all.extend([4500.0, 5500.0, 7500.0, 9500.0].map(Self::Temperature));
        all.extend([2.0, 5.0, 10.0].map(Self::Noise));
        all.push(Self::Blur(0.7));
        all.extend(Sides::ALL.map(Self::Bars));
        all.extend(Corner::ALL.map(Self::Date));
        all.extend(Paint::ALL.map(Self::Paint));
        all
    }

    /// What kind of change it is, for sums over a kind.
    #[must_use]
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::Jpeg { halved_chroma: false, .. } => "JPEG 4:4:4",
            Self::Jpeg { halved_chroma: true, .. } => "JPEG 4:2:0",
            Self::Brightness(_) => "brightness",
            Self::Temperature(_) => "colour temperature",
            Self::Noise(_) => "noise",
            Self::Blur(_) => "blur",
            Self::Bars(_) => "bars",
            Self::Date(_) => "date",
            Self::Paint(_) => "paint",
        }
    }

    /// The changed frame; `None` where the picture has no room for it, or no face to paint on.
    ///
    /// # Errors
    /// The JPEG encoder or decoder refuses (a bug: its input is a frame).
    pub fn apply(&self, shot: &Shot<'_>, seed: u64) -> Result<Option<Frame>, Error> {
        let frame = shot.frame;
        Ok(match *self {
            Self::Jpeg { quality, halved_chroma } => {
                Some(picture::encoded_again(frame, quality, halved_chroma)?)
            }
            Self::Brightness(gain) => Some(picture::amplified(frame, [gain; 3])?),
            Self::Temperature(kelvin) => Some(picture::amplified(frame, picture::gains(kelvin))?),
            Self::Noise(levels) => Some(picture::noisy(frame, levels, seed)?),
            Self::Blur(sigma_px) => Some(picture::blurred(frame, sigma_px)?),
            Self::Bars(sides) => margin::with_bars(frame, shot.corners_px(), sides)?,
            Self::Date(corner) => margin::with_date(frame, shot.corners_px(), corner)?,
            Self::Paint(paint) => shot.pixels().map(|pixels| pixels.painted(frame, &paint)).transpose()?,
        })
    }
}

impl fmt::Display for Perturbation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Jpeg { quality, .. } => write!(f, "{} quality {quality}", self.kind()),
            Self::Brightness(gain) => write!(f, "brightness {gain}"),
            Self::Temperature(kelvin) => write!(f, "colour temperature {kelvin} K"),
            Self::Noise(levels) => write!(f, "noise {levels} levels"),
            Self::Blur(sigma_px) => write!(f, "blur {sigma_px} px"),
            Self::Bars(sides) => write!(f, "bars {sides}"),
            Self::Date(corner) => write!(f, "date {corner}"),
            Self::Paint(paint) => write!(f, "paint {paint}"),
        }
    }
}

/// A frame of the same size from other pixels.
fn like(frame: &Frame, rgb: Vec<u8>) -> Result<Frame, Error> {
    Frame::from_rgb(frame.width_px(), frame.height_px(), rgb).map_err(|e| Error::new("changed frame", e))
}

#[cfg(test)]
mod tests;
