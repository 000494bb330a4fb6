//! Endless noise from a few tiles made once: sampling a tile costs a tenth of computing noise at each pixel.

use crate::rng::Rng;
use std::sync::OnceLock;

const SIDE: usize = 512;
const LEVELS: usize = 8;

/// Copies of less contrast than this share of the first are not kept: what is left of fibres from afar drowns in noise.
const LEAST_SPREAD: f32 = 0.3;

/// A periodic 512 x 512 picture of zero mean and about unit spread, with halved copies against aliasing.
#[derive(Debug)]
pub struct Tile {
    levels: Vec<Vec<i8>>,
}

/// The three tiles.
#[derive(Debug)]
pub struct Tiles {
    /// Soft blotches of all sizes.
    pub cloud: Tile,
    /// Short fibres and grain of one to a few texels.
    pub fibre: Tile,
    /// Long streaks along x, fine across.
    pub streak: Tile,
}

/// The tiles, made at first use.
pub fn tiles() -> &'static Tiles {
    static TILES: OnceLock<Tiles> = OnceLock::new();
    TILES.get_or_init(|| Tiles {
        cloud: Tile::new(octaves(&[
            (4, 4, 1.0),
            (8, 8, 0.8),
            (16, 16, 0.55),
            (32, 32, 0.4),
            (64, 64, 0.3),
            (128, 128, 0.2),
        ])),
        fibre: Tile::new(fibres()),
        streak: Tile::new(octaves(&[
            (2, 16, 1.0),
            (2, 64, 0.8),
            (4, 128, 0.7),
            (8, 256, 0.6),
            (16, 512, 0.35),
        ])),
    })
}

impl Tile {
    fn new(mut field: Vec<f32>) -> Self {
        let mean = field.iter().sum::<f32>() / field.len() as f32;
        let square = field.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / field.len() as f32;
        let scale = 1.0 / square.sqrt().max(1e-6);
        field.iter_mut().for_each(|x| *x = (*x - mean) * scale);
        let mut levels = Vec::with_capacity(LEVELS);
        let mut side = SIDE;
        for _ in 0..LEVELS {
            let square = field.iter().map(|x| x * x).sum::<f32>() / field.len() as f32;
            if square.sqrt() < LEAST_SPREAD {
                break;
            }
            levels.push(field.iter().map(|x| (x * 40.0).clamp(-127.0, 127.0) as i8).collect());
            let half = side / 2;
            field = (0..half * half)
                .map(|i| {
                    let (x, y) = (i % half * 2, i / half * 2);
                    let at = y * side + x;
                    (field[at] + field[at + 1] + field[at + side] + field[at + side + 1]) * 0.25
                })
                .collect();
            side = half;
        }
        Self { levels }
    }

    /// Like [`Tile::at`], but the nearest texel where texels are as fine as the pixels and smoothness is not seen.
    #[inline]
    #[must_use]
    pub fn grain(&self, x: f32, y: f32, footprint: f32) -> f32 {
        if footprint < 1.0 {
            return self.at(x, y, footprint);
        }
        let level = level_of(footprint);
        let Some(texels) = self.levels.get(level) else { return 0.0 };
        let side = SIDE >> level;
        let mask = side as i32 - 1;
        let shrink = 1.0 / (1 << level) as f32;
        let (i, j) = (floor(x * shrink) & mask, floor(y * shrink) & mask);
        f32::from(texels[j as usize * side + i as usize]) * (1.0 / 40.0)
    }

    /// Bilinear sample at a position in texels; `footprint` is the size of the pixel in texels.
    #[inline]
    #[must_use]
    pub fn at(&self, x: f32, y: f32, footprint: f32) -> f32 {
        let level = level_of(footprint);
        let Some(texels) = self.levels.get(level) else { return 0.0 };
        let side = SIDE >> level;
        let mask = side as i32 - 1;
        let shrink = 1.0 / (1 << level) as f32;
        let (x, y) = (x * shrink, y * shrink);
        let (x0, y0) = (floor(x), floor(y));
        let (tx, ty) = (x - x0 as f32, y - y0 as f32);
        let (left, right) = ((x0 & mask) as usize, (x0.wrapping_add(1) & mask) as usize);
        let (upper, lower) = ((y0 & mask) as usize * side, (y0.wrapping_add(1) & mask) as usize * side);
        let texel = |i: usize| f32::from(texels[i]);
        let top = texel(upper + left) * (1.0 - tx) + texel(upper + right) * tx;
        let bottom = texel(lower + left) * (1.0 - tx) + texel(lower + right) * tx;
        (top * (1.0 - ty) + bottom * ty) * (1.0 / 40.0)
    }
}

/// Rounds down; `f32::floor` is a call into the mathematics library on the oldest processors that we build for.
#[inline]
#[must_use]
pub fn floor(x: f32) -> i32 {
    let i = x as i32;
    i - i32::from(x < i as f32)
}

/// log2 of the footprint, rounded, from the float's exponent.
#[inline]
fn level_of(footprint: f32) -> usize {
    let exponent = ((footprint * 1.4).to_bits() >> 23) as i32 - 127;
    exponent.clamp(0, 1 << 20) as usize
}

/// A hash of two integers to [0, 1).
#[inline]
#[must_use]
pub fn hash01(x: i32, y: i32, salt: u32) -> f32 {
    let mut h = (x as u32).wrapping_mul(0x9E37_79B1) ^ (y as u32).wrapping_mul(0x85EB_CA77) ^ salt;
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
    ((h ^ (h >> 15)) >> 8) as f32 / 16_777_216.0
}

/// Sum of periodic value noises: (cells along x, cells along y, weight).
fn octaves(list: &[(usize, usize, f32)]) -> Vec<f32> {
    let mut field = vec![0.0; SIDE * SIDE];
    for (n, (nx, ny, weight)) in list.iter().enumerate() {
        let salt = 77 + n as u32;
        let value = |i: usize, j: usize| hash01((i % nx) as i32, (j % ny) as i32, salt) - 0.5;
        let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
        for y in 0..SIDE {
            let fy = y as f32 * *ny as f32 / SIDE as f32;
            let (j, ty) = (fy as usize, smooth(fy.fract()));
            for x in 0..SIDE {
                let fx = x as f32 * *nx as f32 / SIDE as f32;
                let (i, tx) = (fx as usize, smooth(fx.fract()));
                let top = value(i, j) * (1.0 - tx) + value(i + 1, j) * tx;
                let bottom = value(i, j + 1) * (1.0 - tx) + value(i + 1, j + 1) * tx;
                field[y * SIDE + x] += weight * (top * (1.0 - ty) + bottom * ty);
            }
        }
    }
    field
}

fn fibres() -> Vec<f32> {
    let mut rng = Rng::new(11, 0xF1B);
    let mut field: Vec<f32> = (0..SIDE * SIDE).map(|_| rng.normal() as f32 * 0.5).collect();
    for _ in 0..16_000 {
        let (mut x, mut y) = (rng.range_f32(0.0, 512.0), rng.range_f32(0.0, 512.0));
        let mut angle = rng.range_f32(0.0, std::f32::consts::TAU);
        let weight = (rng.normal() * 0.55) as f32;
        for _ in 0..4 + rng.below(14) {
            field[(y as usize % SIDE) * SIDE + x as usize % SIDE] += weight;
            angle += rng.range_f32(-0.3, 0.3);
            x = (x + angle.cos()).rem_euclid(512.0);
            y = (y + angle.sin()).rem_euclid(512.0);
        }
    }
    field
}
