//! Bitmaps that stamps are made of, drawn at the very resolution at which the camera will see them.

use super::font;
use super::noise::hash01;
use crate::rng::Rng;

/// Colour and cover per texel; sampled bilinearly.
#[derive(Clone, Debug)]
pub struct Bitmap {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// sRGB and alpha.
    pub texels: Vec<[u8; 4]>,
}

impl Bitmap {
    /// One colour everywhere.
    #[must_use]
    pub fn new(width: usize, height: usize, texel: [u8; 4]) -> Self {
        Self { width, height, texels: vec![texel; width * height] }
    }

    /// Bilinear sample at shares of width and height.
    #[inline]
    #[must_use]
    pub fn at(&self, x: f32, y: f32) -> [f32; 4] {
        let fx = (x * self.width as f32 - 0.5).clamp(0.0, (self.width - 1) as f32);
        let fy = (y * self.height as f32 - 0.5).clamp(0.0, (self.height - 1) as f32);
        let (x0, y0) = (fx as usize, fy as usize);
        let (x1, y1) = ((x0 + 1).min(self.width - 1), (y0 + 1).min(self.height - 1));
        let (tx, ty) = (fx - x0 as f32, fy - y0 as f32);
        let (a, b) = (self.texels[y0 * self.width + x0], self.texels[y0 * self.width + x1]);
        let (c, d) = (self.texels[y1 * self.width + x0], self.texels[y1 * self.width + x1]);
        let mut out = [0.0; 4];
        for (i, o) in out.iter_mut().enumerate() {
            let top = f32::from(a[i]) * (1.0 - tx) + f32::from(b[i]) * tx;
            let bottom = f32::from(c[i]) * (1.0 - tx) + f32::from(d[i]) * tx;
            *o = (top * (1.0 - ty) + bottom * ty) * (1.0 / 255.0);
        }
        out
    }

    /// Draws a round pen of radius `pen` from one point to another (texels), over what is there.
    pub fn pen(&mut self, s: [f32; 4], pen: f32, rgb: [u8; 3]) {
        let reach = pen + 1.0;
        let range = |a: f32, b: f32, n: usize| {
            let low = (a.min(b) - reach).floor().clamp(0.0, n as f32) as usize;
            let high = (a.max(b) + reach).ceil().clamp(0.0, n as f32) as usize;
            low..high
        };
        let (dx, dy) = (s[2] - s[0], s[3] - s[1]);
        let scale = 1.0 / (dx * dx + dy * dy).max(1e-6);
        // A pen finer than a texel covers it only in part.
        let most = (2.0 * pen).min(1.0);
        for y in range(s[1], s[3], self.height) {
            // Only the part of the segment that comes near this row counts.
            let (low, high) = (y as f32 + 0.5 - reach, y as f32 + 0.5 + reach);
            let cut =
                |edge: f32| if dy.abs() < 1e-3 { None } else { Some(((edge - s[1]) / dy).clamp(0.0, 1.0)) };
            let (t0, t1) = cut(low).zip(cut(high)).unwrap_or((0.0, 1.0));
            for x in range(s[0] + t0 * dx, s[0] + t1 * dx, self.width) {
                let (px, py) = (x as f32 + 0.5 - s[0], y as f32 + 0.5 - s[1]);
                let t = ((px * dx + py * dy) * scale).clamp(0.0, 1.0);
                let (ex, ey) = (px - t * dx, py - t * dy);
                let square = ex * ex + ey * ey;
                if square < reach * reach {
                    let cover = (pen - square.sqrt() + 0.5).clamp(0.0, most);
                    self.blend(x, y, rgb, cover);
                }
            }
        }
    }

    /// Fills an upright rectangle given in texels, its borders smooth.
    pub fn rect(&mut self, x0: f32, y0: f32, x1: f32, y1: f32, rgb: [u8; 3]) {
        self.tint(x0, y0, x1, y1, rgb, 1.0);
    }

    /// Like [`Bitmap::rect`], covering only a share of what is under it.
    fn tint(&mut self, x0: f32, y0: f32, x1: f32, y1: f32, rgb: [u8; 3], strength: f32) {
        let span = |a: f32, b: f32, n: usize| {
            (a.floor().clamp(0.0, n as f32) as usize)..(b.ceil().clamp(0.0, n as f32) as usize)
        };
        let cover = |i: usize, a: f32, b: f32| ((i + 1) as f32).min(b) - (i as f32).max(a);
        for y in span(y0, y1, self.height) {
            for x in span(x0, x1, self.width) {
                let share = cover(x, x0, x1).clamp(0.0, 1.0) * cover(y, y0, y1).clamp(0.0, 1.0);
                self.blend(x, y, rgb, share * strength);
            }
        }
    }

    /// Writes a text into a rectangle (left, top, width, height in texels); `bold` is the pen's radius in grid units.
    pub fn text(&mut self, text: &str, place: [f32; 4], bold: f32, rgb: [u8; 3]) {
        let [x, y, width, height] = place;
        if height < 5.0 {
            // Too small to be read: a grey dash for each word looks the same.
            let letter = width / text.chars().count().max(1) as f32;
            let (mut from, mut n) = (x, 0);
            for part in text.split(' ') {
                n += part.chars().count() + 1;
                let to = x + n as f32 * letter;
                self.tint(from, y, to - letter, y + height, rgb, (0.25 + 0.35 * bold).min(0.6));
                from = to;
            }
            return;
        }
        let (sx, sy) = (width / (font::width(text) + 2.0 * bold), height / (6.0 + 2.0 * bold));
        for [x0, y0, x1, y1] in font::segments(text) {
            let at = |px: f32, py: f32| [x + (px + bold) * sx, y + (py + bold) * sy];
            let ([ax, ay], [bx, by]) = (at(x0, y0), at(x1, y1));
            self.pen([ax, ay, bx, by], bold * sx.min(sy), rgb);
        }
    }

    fn blend(&mut self, x: usize, y: usize, rgb: [u8; 3], cover: f32) {
        if cover <= 0.0 {
            return;
        }
        let texel = &mut self.texels[y * self.width + x];
        let old = f32::from(texel[3]) / 255.0;
        let alpha = cover + old * (1.0 - cover);
        for (old_byte, new_byte) in texel.iter_mut().zip(rgb) {
            let mixed = (f32::from(new_byte) * cover + f32::from(*old_byte) * old * (1.0 - cover)) / alpha;
            *old_byte = (mixed + 0.5) as u8;
        }
        texel[3] = (alpha * 255.0 + 0.5) as u8;
    }
}

/// A word that nobody has registered.
pub fn word(rng: &mut Rng) -> String {
    const HEADS: [&str; 16] = [
        "NOR", "VEL", "KA", "TRA", "SOL", "BRI", "MON", "AXI", "PLU", "GER", "ZEN", "OR", "HAL", "FJO",
        "QUA", "DEX",
    ];
    const TAILS: [&str; 16] = [
        "DIS", "TEK", "LUX", "MAR", "VIA", "PACK", "STEN", "RO", "LINE", "BOX", "NIK", "ALIA", "TON", "RA",
        "WERK", "FIX",
    ];
    format!("{}{}", HEADS[rng.below(16)], TAILS[rng.below(16)])
}

/// Random letters and digits.
pub fn code(rng: &mut Rng, length: usize) -> String {
    (0..length).map(|_| char::from(b"ABCDEFGHKLMNPRSTUVWXYZ0123456789012345678901"[rng.below(44)])).collect()
}

/// A label: border, rows of words, a bar code, a large code. `seed` fixes its contents at every resolution; layout 0 is an
/// address, 1 a parcel's, anything else an order's.
#[must_use]
pub fn label(seed: u64, layout: u8, paper: [u8; 3], width: usize, height: usize) -> Bitmap {
    let mut rng = Rng::new(seed, 0x1ABE);
    let mut map = Bitmap::new(width, height, [paper[0], paper[1], paper[2], 255]);
    let (w, h) = (width as f32, height as f32);
    let black = [28, 27, 30];
    if rng.chance(0.6) {
        let b = 0.012 * w.min(h);
        let m = 0.03 * w.min(h);
        for r in [
            [m, m, w - m, m + b],
            [m, h - m - b, w - m, h - m],
            [m, m, m + b, h - m],
            [w - m - b, m, w - m, h - m],
        ] {
            map.rect(r[0], r[1], r[2], r[3], black);
        }
    }
    let bars = |map: &mut Bitmap, rng: &mut Rng, x0: f32, y0: f32, x1: f32, y1: f32| {
        let modules = 60 + rng.below(50);
        let step = (x1 - x0) / modules as f32;
        let salt = rng.bits();
        let mut run = 0;
        for i in 0..modules {
            // Runs of one to four modules, as in any linear code.
            let dark = hash01(i as i32, 0, salt) < 0.5;
            run = if dark { run + 1 } else { 0 };
            if dark && run < 4 {
                let x = x0 + i as f32 * step;
                map.rect(x, y0, x + step, y1, black);
            }
        }
    };
    let rows = |map: &mut Bitmap, rng: &mut Rng, x0: f32, y0: f32, x1: f32, y1: f32, n: usize| {
        let pitch = (y1 - y0) / n as f32;
        for i in 0..n {
            let text = format!("{} {} {}", word(rng), code(rng, 4), word(rng));
            let long = (x1 - x0) * rng.range_f32(0.5, 1.0);
            map.text(&text, [x0, y0 + i as f32 * pitch, long, pitch * 0.6], 0.35, black);
        }
    };
    match layout {
        0 => {
            rows(&mut map, &mut rng, 0.08 * w, 0.08 * h, 0.9 * w, 0.42 * h, 4);
            bars(&mut map, &mut rng, 0.08 * w, 0.46 * h, 0.92 * w, 0.8 * h);
            let text = code(&mut rng, 12);
            map.text(&text, [0.15 * w, 0.84 * h, 0.7 * w, 0.08 * h], 0.4, black);
        }
        1 => {
            bars(&mut map, &mut rng, 0.07 * w, 0.08 * h, 0.6 * w, 0.5 * h);
            rows(&mut map, &mut rng, 0.07 * w, 0.58 * h, 0.62 * w, 0.95 * h, 4);
            map.rect(0.68 * w, 0.55 * h, 0.93 * w, 0.92 * h, black);
            let text = code(&mut rng, 2);
            map.text(&text, [0.71 * w, 0.62 * h, 0.19 * w, 0.22 * h], 0.6, paper);
        }
        _ => {
            let text = code(&mut rng, 5);
            map.text(&text, [0.08 * w, 0.08 * h, 0.84 * w, 0.26 * h], 0.75, black);
            map.rect(0.05 * w, 0.4 * h, 0.95 * w, 0.415 * h, black);
            bars(&mut map, &mut rng, 0.1 * w, 0.46 * h, 0.9 * w, 0.7 * h);
            rows(&mut map, &mut rng, 0.08 * w, 0.75 * h, 0.9 * w, 0.96 * h, 3);
        }
    }
    map
}
