//! Drawing with smooth edges and a dark halo, so that marks can be read on cardboard of any colour and in the sun.
//! Knows pixels of the picture only; what is drawn where is decided in the parent module.

use ab_glyph::{Font, FontRef, Glyph, PxScale, ScaleFont, point};
use image::{Rgb, RgbImage};

/// A colour, 8 bits a channel.
pub type Color = [u8; 3];

/// The colour of halos and of the picture's ground.
pub const DARK: Color = [16, 16, 20];

/// A picture that is drawn on. Positions are (x, y) with pixel centres at integers.
pub struct Canvas {
    image: RgbImage,
    font: FontRef<'static>,
}

/// Text that is laid out and rasterised but not yet placed.
struct Stamp {
    width: usize,
    height: usize,
    ink: Vec<f32>,
    halo: Vec<f32>,
}

impl Canvas {
    /// A dark picture.
    pub fn new(width: u32, height: u32) -> anyhow::Result<Self> {
        let font = FontRef::try_from_slice(dejavu::sans_condensed::bold())?;
        Ok(Self { image: RgbImage::from_pixel(width, height, Rgb(DARK)), font })
    }

    /// The finished picture.
    pub fn into_image(self) -> RgbImage {
        self.image
    }

    /// Copies a picture to (x, y), mixed with the ground: 1 as it is, 0 dark.
    pub fn paste(&mut self, picture: &RgbImage, x: u32, y: u32, brightness: f32) {
        for (px, py, pixel) in picture.enumerate_pixels() {
            if let Some(target) = self.image.get_pixel_mut_checked(x + px, y + py) {
                for (t, s) in target.0.iter_mut().zip(pixel.0) {
                    *t = byte(f32::from(*t) * (1.0 - brightness) + f32::from(s) * brightness);
                }
            }
        }
    }

    /// Adds light of a colour to the px right of and below (x, y), in rows of `width`, as much as `share` says of each (0 to 1).
    pub fn light(&mut self, [x, y]: [u32; 2], width: usize, color: Color, share: &[f32]) {
        for (row, shares) in (y..).zip(share.chunks(width.max(1))) {
            for (column, share) in (x..).zip(shares) {
                if let Some(target) = self.image.get_pixel_mut_checked(column, row) {
                    for (t, c) in target.0.iter_mut().zip(color) {
                        *t = byte(f32::from(*t) + f32::from(c) * share.clamp(0.0, 1.0));
                    }
                }
            }
        }
    }

    /// Mixes a rectangle with a colour.
    pub fn shade(&mut self, [x0, y0]: [f32; 2], [x1, y1]: [f32; 2], color: Color, alpha: f32) {
        self.cover([x0, y0], [x1, y1], color, |x, y| {
            if x >= x0 && x < x1 && y >= y0 && y < y1 { alpha } else { 0.0 }
        });
    }

    /// A line with round ends.
    pub fn line(&mut self, from: [f32; 2], to: [f32; 2], width: f32, color: Color) {
        let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
        let length_squared = (dx * dx + dy * dy).max(1e-9);
        let reach = width / 2.0 + 1.0;
        let low = [from[0].min(to[0]) - reach, from[1].min(to[1]) - reach];
        let high = [from[0].max(to[0]) + reach, from[1].max(to[1]) + reach];
        self.cover(low, high, color, |x, y| {
            let along = (((x - from[0]) * dx + (y - from[1]) * dy) / length_squared).clamp(0.0, 1.0);
            let distance = (x - from[0] - along * dx).hypot(y - from[1] - along * dy);
            (width / 2.0 + 0.5 - distance).clamp(0.0, 1.0)
        });
    }

    /// A filled disc.
    pub fn disc(&mut self, at: [f32; 2], radius: f32, color: Color) {
        self.line(at, at, 2.0 * radius, color);
    }

    /// Width of a text in px.
    pub fn text_width(&self, text: &str, size: f32) -> f32 {
        let font = self.font.as_scaled(PxScale::from(size));
        text.chars().map(|c| font.h_advance(font.glyph_id(c))).sum()
    }

    /// Text with a halo, centred at a place and turned by an angle (clockwise as seen, radians).
    pub fn text_centered(&mut self, text: &str, size: f32, at: [f32; 2], angle_rad: f32, color: Color) {
        let stamp = self.stamp(text, size);
        self.press(&stamp, at, angle_rad, color);
    }

    /// Text with a halo that starts at a place: left end, vertical middle.
    pub fn text_from(&mut self, text: &str, size: f32, [x, y]: [f32; 2], color: Color) {
        let middle = [x + self.text_width(text, size) / 2.0, y];
        self.text_centered(text, size, middle, 0.0, color);
    }

    /// Breaks a text into lines that are not wider than `width` px.
    pub fn wrap(&self, text: &str, size: f32, width: f32) -> Vec<String> {
        let mut lines: Vec<String> = Vec::new();
        for word in text.split_whitespace() {
            match lines.last_mut() {
                Some(line) if self.text_width(&format!("{line} {word}"), size) <= width => {
                    line.push(' ');
                    line.push_str(word);
                }
                _ => lines.push(word.to_owned()),
            }
        }
        lines
    }

    fn stamp(&self, text: &str, size: f32) -> Stamp {
        let font = self.font.as_scaled(PxScale::from(size));
        let reach = (size / 11.0).max(2.0);
        let margin = reach.ceil() + 1.0;
        let width = (self.text_width(text, size) + 2.0 * margin).ceil().max(1.0) as usize;
        let height = (font.height() + 2.0 * margin).ceil().max(1.0) as usize;
        let mut ink = vec![0.0_f32; width * height];
        let mut pen = margin;
        for c in text.chars() {
            let id = font.glyph_id(c);
            let glyph: Glyph = id.with_scale_and_position(font.scale(), point(pen, margin + font.ascent()));
            pen += font.h_advance(id);
            let Some(outline) = font.outline_glyph(glyph) else { continue };
            let bounds = outline.px_bounds();
            outline.draw(|x, y, coverage| {
                let (column, row) = (x as f32 + bounds.min.x, y as f32 + bounds.min.y);
                if column >= 0.0 && row >= 0.0 && (column as usize) < width && (row as usize) < height {
                    let value = &mut ink[row as usize * width + column as usize];
                    *value = value.max(coverage);
                }
            });
        }
        let halo = dilate(&ink, width, height, reach);
        Stamp { width, height, ink, halo }
    }

    fn press(&mut self, stamp: &Stamp, at: [f32; 2], angle_rad: f32, color: Color) {
        let (sin, cos) = angle_rad.sin_cos();
        let half = [(stamp.width as f32 - 1.0) / 2.0, (stamp.height as f32 - 1.0) / 2.0];
        let reach = half[0].hypot(half[1]) + 1.0;
        let (low, high) = ([at[0] - reach, at[1] - reach], [at[0] + reach, at[1] + reach]);
        for (mask, color) in [(&stamp.halo, DARK), (&stamp.ink, color)] {
            self.cover(low, high, color, |x, y| {
                let [dx, dy] = [x - at[0], y - at[1]];
                bilinear(mask, stamp, dx * cos + dy * sin + half[0], dy * cos - dx * sin + half[1])
            });
        }
    }

    /// Mixes a colour into every pixel between two corners, as much as `coverage(x, y)` says (0 to 1).
    fn cover(&mut self, low: [f32; 2], high: [f32; 2], color: Color, coverage: impl Fn(f32, f32) -> f32) {
        let (width, height) = self.image.dimensions();
        // Negative and overlarge values end at the picture's border: `as` saturates.
        let columns = (low[0].floor() as u32)..((high[0].ceil() + 1.0) as u32).min(width);
        for y in (low[1].floor() as u32)..((high[1].ceil() + 1.0) as u32).min(height) {
            for x in columns.clone() {
                let alpha = coverage(x as f32, y as f32);
                if alpha > 0.0 {
                    let pixel = self.image.get_pixel_mut(x, y);
                    for (t, s) in pixel.0.iter_mut().zip(color) {
                        *t = byte(f32::from(*t) * (1.0 - alpha) + f32::from(s) * alpha);
                    }
                }
            }
        }
    }
}

fn byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

/// The largest coverage within a disc around each place.
fn dilate(ink: &[f32], width: usize, height: usize, radius: f32) -> Vec<f32> {
    let reach = radius.ceil() as isize;
    let offsets: Vec<(isize, isize, f32)> = (-reach..=reach)
        .flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)))
        .map(|(dx, dy)| (dx, dy, (radius + 0.5 - (dx as f32).hypot(dy as f32)).clamp(0.0, 1.0)))
        .filter(|&(_, _, weight)| weight > 0.0)
        .collect();
    let mut halo = vec![0.0_f32; ink.len()];
    for (at, &value) in ink.iter().enumerate().filter(|&(_, &value)| value > 0.0) {
        let (x, y) = (at % width, at / width);
        for &(dx, dy, weight) in &offsets {
            if let (Some(x), Some(y)) = (x.checked_add_signed(dx), y.checked_add_signed(dy))
                && x < width
                && y < height
            {
                let target = &mut halo[y * width + x];
                *target = target.max(value * weight);
            }
        }
    }
    halo
}

fn bilinear(mask: &[f32], stamp: &Stamp, x: f32, y: f32) -> f32 {
    if x <= -1.0 || y <= -1.0 {
        return 0.0;
    }
    let (x0, y0) = (x.floor(), y.floor());
    let at = |x: f32, y: f32| {
        let inside = x >= 0.0 && y >= 0.0 && (x as usize) < stamp.width && (y as usize) < stamp.height;
        if inside { mask[y as usize * stamp.width + x as usize] } else { 0.0 }
    };
    let (fx, fy) = (x - x0, y - y0);
    (at(x0, y0) * (1.0 - fx) + at(x0 + 1.0, y0) * fx) * (1.0 - fy)
        + (at(x0, y0 + 1.0) * (1.0 - fx) + at(x0 + 1.0, y0 + 1.0) * fx) * fy
}
