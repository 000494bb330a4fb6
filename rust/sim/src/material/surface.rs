//! Bare surfaces: board, wood, stone, brick, tiles, sheet metal, paint, photographs; all from a few noise samples.

use super::noise::{floor, hash01, tiles};
use crate::photos::Photos;
use crate::vec3::{V3, v3};

/// What kind of surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pattern {
    /// Corrugated board: fibres, blotches, faint flutes of this pitch in mm along v (0: none).
    Board {
        /// Pitch of the flutes, mm.
        flute_mm: f32,
    },
    /// Planed or rough wood; grain along u.
    Wood,
    /// Boards of wood with joints, this wide in mm.
    Planks {
        /// Width of a plank, mm.
        width_mm: f32,
    },
    /// Concrete, asphalt, plaster.
    Stone,
    /// Bricks with mortar.
    Brick,
    /// Square tiles of this side in mm.
    Tiles {
        /// Side of a tile, mm.
        side_mm: f32,
    },
    /// Corrugated sheet, waves along u of this pitch in mm.
    Sheet {
        /// Pitch of the waves, mm.
        pitch_mm: f32,
    },
    /// Smooth paint.
    Paint,
    /// A photograph, tiled at this width in mm.
    Photo {
        /// Index in the folder.
        index: usize,
        /// Width of one copy, mm.
        width_mm: f32,
    },
}

/// A surface: pattern, two colours, strength and where its noise starts.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// The word of its kind.
    pub kind: &'static str,
    /// Kind.
    pub pattern: Pattern,
    /// Main colour, linear.
    pub base: V3,
    /// Second colour (joints, grain), linear.
    pub second: V3,
    /// Strength of the noise, about 1.
    pub strength: f32,
    /// Offset of the noise, texels, so that no two solids are alike.
    pub offset: [f32; 2],
}

impl Surface {
    /// Colour at (u, v) mm on a face seen with pixels of `foot` mm.
    #[must_use]
    pub fn colour(&self, face: usize, u: f32, v: f32, foot: f32, photos: &Photos) -> V3 {
        let t = tiles();
        let s = self.strength;
        let (x, y) = (u + self.offset[0] + 131.0 * face as f32, v + self.offset[1]);
        match self.pattern {
            Pattern::Board { flute_mm } => {
                let blotch = t.cloud.grain(x * 0.8, y * 0.8, foot * 0.8);
                let fibre = t.fibre.grain(x * 2.6, y * 2.6, foot * 2.6);
                // From afar the fine streaks of the paper machine are not seen.
                let cloud = if foot < 0.9 { t.streak.grain(x * 0.6, y * 1.7, foot * 1.7) } else { 0.0 };
                let mut tone = 1.0 + s * (0.035 * blotch + 0.055 * fibre + 0.018 * cloud);
                if flute_mm > 0.0 && foot < flute_mm {
                    let wave = (y * (std::f32::consts::TAU / flute_mm)).sin();
                    tone += 0.02 * s * wave * (1.0 - foot / flute_mm);
                }
                // Rough places show more of the second colour: board is never of one hue.
                let shift = 0.10 * s * (0.5 * blotch + 0.5 * fibre);
                (self.base + (self.second - self.base) * shift) * tone
            }
            Pattern::Wood => self.wood(x, y, foot),
            Pattern::Planks { width_mm } => {
                let line = floor(y / width_mm);
                let row = line as f32;
                let shift = hash01(line, 3, 5) * 900.0;
                let wood = self.wood(x + shift * 7.0, y + row * 57.0, foot);
                let tone = 0.85 + 0.3 * hash01(line, 0, 9);
                let to_joint = (y - row * width_mm).min((row + 1.0) * width_mm - y);
                let length = (x + shift) / 1900.0;
                let end = (length - floor(length) as f32) * 1900.0;
                let joint = cover(2.5, to_joint.min(end), foot);
                wood * (tone * (1.0 - 0.7 * joint))
            }
            Pattern::Stone => {
                let large = t.cloud.grain(x * 0.06, y * 0.06, foot * 0.06);
                let small = t.cloud.grain(x * 0.55 + 91.0, y * 0.55, foot * 0.55);
                let grain = t.fibre.grain(x * 0.45, y * 0.45, foot * 0.45);
                let sand = t.fibre.grain(x * 1.9, y * 1.9 + 37.0, foot * 1.9);
                let tone = 1.0 + s * (0.045 * large + 0.045 * small + 0.05 * grain + 0.05 * sand);
                let stain = (t.cloud.grain(x * 0.033 + 300.0, y * 0.033, foot * 0.033) - 1.0).clamp(0.0, 1.0);
                (self.base + (self.second - self.base) * (0.45 * stain)) * tone
            }
            Pattern::Brick => {
                let (w, h) = (250.0, 75.0);
                let row = floor(y / h);
                let along = x / w + 0.5 * (row & 1) as f32;
                let column = floor(along);
                let (px, py) = ((along - column as f32) * w, y - row as f32 * h);
                let to_joint = px.min(w - px).min(py).min(h - py);
                let joint = cover(5.0, to_joint, foot);
                let grain = t.fibre.grain(x * 0.6, y * 0.6, foot * 0.6);
                let tone = 0.75 + 0.5 * hash01(column, row, 21) + 0.08 * s * grain;
                self.base * tone * (1.0 - joint) + self.second * ((1.0 + 0.08 * grain) * joint)
            }
            Pattern::Tiles { side_mm } => {
                let (i, j) = (floor(x / side_mm), floor(y / side_mm));
                let (px, py) = (x - i as f32 * side_mm, y - j as f32 * side_mm);
                let to_joint = px.min(side_mm - px).min(py).min(side_mm - py);
                let joint = cover(2.5, to_joint, foot);
                let speck = t.fibre.grain(x * 0.5, y * 0.5, foot * 0.5);
                let cloud = t.cloud.grain(x * 0.15, y * 0.15, foot * 0.15);
                let tone = 0.95 + 0.1 * hash01(i, j, 2) + s * (0.04 * speck + 0.05 * cloud);
                (self.base * (1.0 - joint) + self.second * joint) * tone
            }
            Pattern::Sheet { pitch_mm } => {
                let phase = x * (std::f32::consts::TAU / pitch_mm);
                let wave = phase.sin() * (1.0 - foot / pitch_mm).clamp(0.0, 1.0);
                let dirt = t.streak.grain(y * 0.1, x * 0.4, foot * 0.4);
                self.base * (1.0 + 0.22 * wave + 0.05 * s * dirt)
            }
            Pattern::Paint => {
                let dirt = t.cloud.grain(x * 0.3, y * 0.3, foot * 0.3);
                let scratch = t.streak.grain(x * 0.9, y * 0.9, foot * 0.9);
                self.base * (1.0 + s * (0.04 * dirt + 0.02 * scratch))
            }
            Pattern::Photo { index, width_mm } => match photos.all.get(index) {
                Some(photo) => photo.tiled(x / width_mm, y / width_mm),
                None => self.base,
            },
        }
    }

    fn wood(&self, x: f32, y: f32, foot: f32) -> V3 {
        let t = tiles();
        let bend = 7.0 * t.cloud.grain(x * 0.12, y * 0.2, foot * 0.2);
        let grain = t.streak.grain(x * 0.8, (y + bend) * 3.1, foot * 3.1);
        let broad = t.streak.grain(x * 0.3, (y + bend) * 0.7, foot * 0.7);
        let pore = t.fibre.grain(x * 0.5, y * 3.0, foot * 2.0);
        let mixed = (0.3 + self.strength * (0.13 * grain + 0.13 * broad + 0.05 * pore)).clamp(0.0, 1.0);
        self.base + (self.second - self.base) * mixed
    }
}

/// Share of a pixel of `foot` mm that a joint of half width `half` covers, `distance` mm from its middle.
#[inline]
fn cover(half: f32, distance: f32, foot: f32) -> f32 {
    let foot = foot.max(0.2);
    ((half - distance) / foot + 0.5).clamp(0.0, (2.0 * half / foot).min(1.0))
}

impl crate::photos::Photo {
    /// Linear colour, repeated endlessly (mirrored, so that no seam shows); (1, 1) is one width.
    #[must_use]
    pub fn tiled(&self, x: f32, y: f32) -> V3 {
        let mirror = |t: f32| 1.0 - (t - 2.0 * floor(0.5 * t) as f32 - 1.0).abs();
        let ratio = self.width as f32 / self.height as f32;
        self.at(mirror(x), mirror(y * ratio))
    }

    /// Linear colour at a share of the width and height, bilinear.
    #[must_use]
    pub fn at(&self, x: f32, y: f32) -> V3 {
        let fx = (x * self.width as f32 - 0.5).clamp(0.0, (self.width - 1) as f32);
        let fy = (y * self.height as f32 - 0.5).clamp(0.0, (self.height - 1) as f32);
        let (x0, y0) = (fx as usize, fy as usize);
        let (x1, y1) = ((x0 + 1).min(self.width - 1), (y0 + 1).min(self.height - 1));
        let (tx, ty) = (fx - x0 as f32, fy - y0 as f32);
        let texel = |x: usize, y: usize| {
            let [r, g, b] = self.rgb[y * self.width + x].map(|c| f32::from(c) * (1.0 / 255.0));
            v3(r * r, g * g, b * b) // a square is near enough to the sRGB curve for a picture on a box
        };
        (texel(x0, y0) * (1.0 - tx) + texel(x1, y0) * tx) * (1.0 - ty)
            + (texel(x0, y1) * (1.0 - tx) + texel(x1, y1) * tx) * ty
    }
}
