//! What is on a face beside its surface: print, labels, tape, straps, frames, photographs, hand holes. A [`Decal`] says what and where in
//! mm; a [`Stamp`] is the decal drawn for one camera distance.

use super::ink::{Bitmap, label};
use super::{font, linear};
use crate::photos::Photos;
use crate::vec3::{V3, v3};
use std::sync::OnceLock;

/// What is seen through a hole, linear: so little that a stripe in it drowns in noise.
const INSIDE: V3 = v3(0.004, 0.0035, 0.003);
/// Thickness of the board that shows below in a hole, mm.
const LIP_MM: f32 = 4.0;

/// What a decal shows.
#[derive(Clone, Debug)]
pub enum Art {
    /// One opaque colour with sharp borders: straps, stripes, seams. sRGB.
    Fill([u8; 3]),
    /// A printed area in an ink, by its word and sRGB: the board shows through as much as the cover leaves.
    Print(&'static str, [u8; 3], f32),
    /// Sticky tape: tints what is under it, with faint streaks. sRGB of the tint, and its cover.
    Tape([u8; 3], f32),
    /// Text in an ink.
    Text(String, [u8; 3], f32),
    /// Two arrows up over a bar.
    Arrows([u8; 3]),
    /// A glass, for fragile.
    Glass([u8; 3]),
    /// The outline of a rectangle, this wide in mm.
    Outline([u8; 3], f32),
    /// A label with contents of a seed, in a layout of [`super::ink::label`], on paper of a colour.
    Label(u64, u8, [u8; 3]),
    /// A photograph by index.
    Photo(usize),
    /// A slot with round ends through the board: darkness behind it.
    Hole,
    /// A printed disc, or an ellipse's slot with round ends. sRGB.
    Disc([u8; 3]),
}

/// Something on a face.
#[derive(Clone, Debug)]
pub struct Decal {
    /// The word of its kind.
    pub kind: &'static str,
    /// Which face.
    pub face: usize,
    /// Its middle in the face's picture axes, mm.
    pub centre: [f32; 2],
    /// Its turn on the face, rad.
    pub turn_rad: f32,
    /// Half sizes, mm.
    pub half: [f32; 2],
    /// What it shows.
    pub art: Art,
    /// Gloss of its coat; ink takes the board's.
    pub gloss: Option<f32>,
}

/// A decal ready for a camera distance; its bitmap is drawn when the first pixel asks for it, since most are hidden.
#[derive(Debug)]
pub struct Stamp {
    decal: Decal,
    cos: f32,
    sin: f32,
    texels: [usize; 2],
    tint: V3,
    map: OnceLock<Bitmap>,
}

impl Decal {
    /// Readies the decal for pixels of `foot` mm.
    #[must_use]
    pub fn stamp(&self, foot: f32) -> Stamp {
        let side = |half: f32| ((2.0 * half / foot * 1.2) as usize).clamp(2, 1400);
        let tint = match &self.art {
            Art::Fill(rgb)
            | Art::Print(_, rgb, _)
            | Art::Tape(rgb, _)
            | Art::Outline(rgb, _)
            | Art::Disc(rgb) => linear(*rgb),
            _ => V3::default(),
        };
        Stamp {
            decal: self.clone(),
            cos: self.turn_rad.cos(),
            sin: self.turn_rad.sin(),
            texels: [side(self.half[0]), side(self.half[1])],
            tint,
            map: OnceLock::new(),
        }
    }

    /// Draws what has a bitmap.
    fn draw(&self, w: usize, h: usize) -> Bitmap {
        let (wf, hf) = (w as f32, h as f32);
        let clear = |rgb: &[u8; 3]| Bitmap::new(w, h, [rgb[0], rgb[1], rgb[2], 0]);
        match &self.art {
            Art::Label(seed, layout, paper) => label(*seed, *layout, *paper, w, h),
            Art::Text(text, rgb, bold) => {
                let mut map = clear(rgb);
                map.text(text, [0.0, 0.0, wf, hf], *bold, *rgb);
                map
            }
            Art::Arrows(rgb) => {
                let mut map = clear(rgb);
                let pen = 0.055 * wf;
                for x in [0.27, 0.73] {
                    map.pen([x * wf, 0.16 * hf, x * wf, 0.78 * hf], pen, *rgb);
                    map.pen([x * wf, 0.1 * hf, (x - 0.17) * wf, 0.36 * hf], pen, *rgb);
                    map.pen([x * wf, 0.1 * hf, (x + 0.17) * wf, 0.36 * hf], pen, *rgb);
                }
                map.pen([0.08 * wf, 0.93 * hf, 0.92 * wf, 0.93 * hf], 0.8 * pen, *rgb);
                map
            }
            Art::Glass(rgb) => {
                let mut map = clear(rgb);
                for i in 0..=20 {
                    let t = i as f32 / 20.0; // a bowl that narrows downwards
                    let reach = 0.32 * (1.0 - t * t);
                    let y = (0.08 + 0.42 * t) * hf;
                    map.pen([(0.5 - reach) * wf, y, (0.5 + reach) * wf, y], 0.022 * hf, *rgb);
                }
                map.pen([0.5 * wf, 0.45 * hf, 0.5 * wf, 0.88 * hf], 0.05 * wf, *rgb);
                map.pen([0.25 * wf, 0.92 * hf, 0.75 * wf, 0.92 * hf], 0.04 * hf, *rgb);
                map
            }
            Art::Fill(rgb)
            | Art::Print(_, rgb, _)
            | Art::Tape(rgb, _)
            | Art::Outline(rgb, _)
            | Art::Disc(rgb) => clear(rgb),
            Art::Photo(_) | Art::Hole => clear(&[0; 3]),
        }
    }

    /// Height over width of a text in letters of normal proportion.
    #[must_use]
    pub fn text_aspect(text: &str, bold: f32) -> f32 {
        (6.0 + 2.0 * bold) / (font::width(text) + 2.0 * bold)
    }
}

impl Stamp {
    /// Whether any point within these ranges (mm along the face's picture axes) may show the stamp.
    #[must_use]
    pub fn reaches(&self, us: [f32; 2], vs: [f32; 2], foot: f32) -> bool {
        let Decal { centre, half: [x, y], .. } = self.decal;
        let (cos, sin) = (self.cos.abs(), self.sin.abs());
        let within = |range: [f32; 2], centre: f32, reach: f32| {
            range[0] <= centre + reach + foot && range[1] >= centre - reach - foot
        };
        within(us, centre[0], x * cos + y * sin) && within(vs, centre[1], x * sin + y * cos)
    }

    /// Lays the stamp over a colour and a gloss at (u, v) mm, seen with pixels of `foot` mm.
    #[inline]
    pub fn lay(&self, u: f32, v: f32, foot: f32, colour: &mut V3, gloss: &mut f32, photos: &Photos) {
        let decal = &self.decal;
        let [half_x, half_y] = decal.half;
        let (du, dv) = (u - decal.centre[0], v - decal.centre[1]);
        let (x, y) = (du * self.cos + dv * self.sin, dv * self.cos - du * self.sin);
        let inside = (half_x - x.abs()).min(half_y - y.abs());
        if inside < -0.5 * foot {
            return;
        }
        let rim = (0.5 + inside / foot).clamp(0.0, 1.0);
        let (sx, sy) = (0.5 + 0.5 * x / half_x, 0.5 + 0.5 * y / half_y);
        let (ink, cover) = match &decal.art {
            // What is finer than a pixel covers it only in part.
            Art::Fill(_) => (self.tint, rim * (2.0 * half_x.min(half_y) / foot).min(1.0)),
            Art::Print(_, _, cover) => (self.tint, rim * cover * (2.0 * half_x.min(half_y) / foot).min(1.0)),
            Art::Tape(_, cover) => {
                let t = super::noise::tiles();
                let (a, b) = if half_x > half_y { (x, y) } else { (y, x) };
                let streak = t.streak.at(a * 0.35 + decal.centre[0], b * 3.0, foot * 3.0);
                (self.tint * (1.0 + 0.05 * streak), rim * cover * (2.0 * half_x.min(half_y) / foot).min(1.0))
            }
            Art::Outline(_, line) => {
                let middle = (inside - 0.5 * line).abs();
                (self.tint, ((0.5 * line - middle) / foot + 0.5).clamp(0.0, (line / foot).min(1.0)))
            }
            Art::Photo(index) => match photos.all.get(*index) {
                Some(photo) => (photo.at(sx, sy), rim),
                None => (*colour, 0.0),
            },
            Art::Hole => {
                let to_end = (x.abs() - (half_x - half_y)).max(0.0);
                let deep = half_y - to_end.hypot(y);
                // The board's cut edge catches some light below.
                let lip = if y > 0.0 { (1.0 - deep / LIP_MM).clamp(0.0, 1.0) } else { 0.0 };
                (*colour * (0.3 * lip) + INSIDE, (0.5 + deep / foot).clamp(0.0, 1.0))
            }
            Art::Disc(_) => {
                let to_end = (x.abs() - (half_x - half_y)).max(0.0);
                (self.tint, (0.5 + (half_y - to_end.hypot(y)) / foot).clamp(0.0, 1.0))
            }
            _ => {
                let map = self.map.get_or_init(|| decal.draw(self.texels[0], self.texels[1]));
                let [r, g, b, a] = map.at(sx, sy);
                (v3(r * r, g * g, b * b), a * rim)
            }
        };
        // Ink does not hide the paper's tone altogether.
        *colour = *colour * (1.0 - cover) + ink * cover;
        if let Some(own) = decal.gloss {
            *gloss += (own - *gloss) * cover;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hole_is_dark_and_round_at_its_ends() {
        let decal = Decal {
            kind: "hand hole",
            face: 0,
            centre: [10.0, 0.0],
            turn_rad: 0.0,
            half: [40.0, 14.0],
            art: Art::Hole,
            gloss: Some(0.0),
        };
        let stamp = decal.stamp(0.5);
        let look = |x: f32, y: f32| {
            let (mut colour, mut gloss) = (v3(0.4, 0.3, 0.2), 0.1);
            stamp.lay(10.0 + x, y, 0.5, &mut colour, &mut gloss, &Photos::default());
            (colour.x, gloss)
        };
        assert!(look(0.0, 0.0).0 < 0.01 && look(38.0, 0.0).0 < 0.01 && look(0.0, 0.0).1 == 0.0);
        assert_eq!(look(39.0, 13.0), (0.4, 0.1));
        // The cut edge of the board is lighter than what is behind, below only.
        assert!(look(0.0, 13.0).0 > 0.05 && look(0.0, -13.0).0 < 0.01);
    }
}
