//! Changes of the whole picture: encoding, brightness, colour temperature, noise, blur.

use super::like;
use crate::render::sensor::{Curve, gaussians, soften};
use crate::{Error, Rng};
use boxline::Frame;
use jpeg_encoder::{ChromaSubsamplingMethod, ColorType, Encoder, SamplingFactor};
use std::sync::OnceLock;

/// sRGB's curve both ways: what a camera wrote is close to it.
pub struct Light {
    linear: [f32; 256],
    curve: Curve,
}

impl Light {
    pub fn get() -> &'static Self {
        static LIGHT: OnceLock<Light> = OnceLock::new();
        LIGHT.get_or_init(|| {
            let mut linear = [0.0; 256];
            for (level, x) in linear.iter_mut().enumerate() {
                let y = level as f32 / 255.0;
                *x = if y <= 0.040_45 { y / 12.92 } else { ((y + 0.055) / 1.055).powf(2.4) };
            }
            Self { linear, curve: Curve::new(0.0) }
        })
    }

    /// Linear light of a level, 0 to 1.
    #[inline]
    pub fn linear(&self, level: u8) -> f32 {
        self.linear[usize::from(level)]
    }

    /// The level of linear light, clipped.
    #[inline]
    pub fn level(&self, linear: f32) -> u8 {
        self.curve.byte(linear)
    }
}

pub fn encoded_again(frame: &Frame, quality: u8, halved_chroma: bool) -> Result<Frame, Error> {
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, quality);
    encoder.set_sampling_factor(if halved_chroma { SamplingFactor::F_2_2 } else { SamplingFactor::F_1_1 });
    encoder.set_chroma_subsampling_method(ChromaSubsamplingMethod::Average);
    let side = |px: usize| u16::try_from(px).map_err(|e| Error::new("frame for the JPEG encoder", e));
    encoder
        .encode(frame.rgb(), side(frame.width_px())?, side(frame.height_px())?, ColorType::Rgb)
        .map_err(|e| Error::new("jpeg", e))?;
    Frame::from_jpeg(&bytes).map_err(|e| Error::new("frame encoded again", e))
}

/// Gains of R, G, B in linear light, clipped at white.
pub fn amplified(frame: &Frame, gains: [f32; 3]) -> Result<Frame, Error> {
    let light = Light::get();
    let mut tables = [[0u8; 256]; 3];
    for (table, gain) in tables.iter_mut().zip(gains) {
        for (out, level) in table.iter_mut().zip(0..=u8::MAX) {
            *out = light.level(light.linear(level) * gain);
        }
    }
    let mut rgb = frame.rgb().to_vec();
    for px in rgb.chunks_exact_mut(3) {
        for (level, table) in px.iter_mut().zip(&tables) {
            *level = table[usize::from(*level)];
        }
    }
    like(frame, rgb)
}

/// What a black body of another temperature gives at the middle wavelengths of a camera's channels, against one of 6500 K; green
/// stays as it is. Planck's law, its exponential alone: the rest is below 2 % here.
pub fn gains(kelvin: f32) -> [f32; 3] {
    const WAVELENGTHS_NM: [f32; 3] = [610.0, 540.0, 465.0];
    const SECOND_RADIATION_CONSTANT_NM_K: f32 = 1.438_777e7;
    let exponents =
        WAVELENGTHS_NM.map(|nm| SECOND_RADIATION_CONSTANT_NM_K / nm * (1.0 / 6500.0 - 1.0 / kelvin));
    exponents.map(|e| (e - exponents[1]).exp())
}

pub fn noisy(frame: &Frame, levels: f32, seed: u64) -> Result<Frame, Error> {
    let normal = gaussians();
    let mut rng = Rng::new(seed, 0x4015);
    let mut rgb = frame.rgb().to_vec();
    for pair in rgb.chunks_mut(2) {
        let bits = rng.bits();
        for (level, deviate) in pair.iter_mut().zip([bits & 0xFFF, bits >> 12 & 0xFFF]) {
            let value = f32::from(*level) + levels * normal[deviate as usize];
            *level = (value + 0.5).clamp(0.0, 255.0) as u8;
        }
    }
    like(frame, rgb)
}

/// Blur in linear light, as a lens out of focus does it.
pub fn blurred(frame: &Frame, sigma_px: f32) -> Result<Frame, Error> {
    let light = Light::get();
    let mut rgb = vec![0u8; frame.rgb().len()];
    for channel in 0..3 {
        let mut plane: Vec<f32> = frame.rgb().chunks_exact(3).map(|px| light.linear(px[channel])).collect();
        soften(&mut plane, frame.width_px(), frame.height_px(), sigma_px);
        for (px, linear) in rgb.chunks_exact_mut(3).zip(plane) {
            px[channel] = light.level(linear);
        }
    }
    like(frame, rgb)
}
