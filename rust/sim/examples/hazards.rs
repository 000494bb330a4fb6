//! A sheet of all hazards, one tile each with its name: the first scenes that have it. `rust/sim/docs/hazards.jpg` is made so:
//!
//! `cargo run --release -p boxline-sim --example hazards -- rust/sim/docs/hazards.jpg`
//!
//! Further arguments are photographs (JPEG), whose tiles follow the rendered ones, to compare them.

use boxline::Frame;
use boxline_sim::head::SENSOR_PX;
use boxline_sim::material::font;
use boxline_sim::pose::{Refuse, px_of};
use boxline_sim::render::sensor::Sensor;
use boxline_sim::render::{Options, Stage, expose_film};
use boxline_sim::truth::face_of;
use boxline_sim::world::{Plan, Scene, compose};
use boxline_sim::{Hazard, Hazards, Head, Raster, Rng, Stock};
use clap::Parser;
use jpeg_encoder::{ColorType, Encoder};
use std::path::PathBuf;

/// Draws a sheet of all hazards
#[derive(Parser)]
struct Args {
    /// The sheet, a JPEG
    out: PathBuf,
    /// Photographs, put behind the rendered tiles
    photos: Vec<PathBuf>,
    /// Scenes of each hazard
    #[arg(long, default_value_t = 2)]
    each: usize,
    /// Seed of the first hazard's first scene; the next ones count on
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

const TILE: [usize; 2] = [320, 240];
const ACROSS: usize = 6;
/// Scenes are drawn at half the sensor's size.
const FILM: [usize; 2] = [SENSOR_PX[0] as usize / 2, SENSOR_PX[1] as usize / 2];
const MOST_SCENES: u64 = 2000;
const QUALITY: u8 = 78;

/// A picture, three bytes a pixel.
struct Picture {
    size: [usize; 2],
    rgb: Vec<u8>,
}

impl Picture {
    fn black(size: [usize; 2]) -> Self {
        Self { size, rgb: vec![0; size[0] * size[1] * 3] }
    }

    /// The part from (left, top) that is so wide, as a tile: means over areas.
    fn tile(&self, [left, top, width]: [f64; 3]) -> Self {
        const SAMPLES: usize = 3;
        let mut tile = Self::black(TILE);
        let scale = width / TILE[0] as f64;
        for (i, px) in tile.rgb.chunks_exact_mut(3).enumerate() {
            let mut sum = [0u32; 3];
            for k in 0..SAMPLES * SAMPLES {
                let at = |cell: usize, k: usize| cell as f64 + (k as f64 + 0.5) / SAMPLES as f64;
                let x = left + scale * at(i % TILE[0], k % SAMPLES);
                let y = top + scale * at(i / TILE[0], k / SAMPLES);
                let (x, y) = ((x as usize).min(self.size[0] - 1), (y as usize).min(self.size[1] - 1));
                let value = &self.rgb[(y * self.size[0] + x) * 3..][..3];
                sum.iter_mut().zip(value).for_each(|(s, v)| *s += u32::from(*v));
            }
            px.iter_mut().zip(sum).for_each(|(p, s)| *p = (s / (SAMPLES * SAMPLES) as u32) as u8);
        }
        tile
    }

    /// Writes a name into the upper left corner, light on dark.
    fn name(&mut self, name: &str) {
        const UNIT: f32 = 2.0;
        let text = name.to_uppercase().replace('_', "-");
        let width = (text.len() as f32 * font::ADVANCE * UNIT) as usize + 8;
        for row in self.rgb.chunks_exact_mut(TILE[0] * 3).take(20) {
            row[..3 * width.min(TILE[0])].iter_mut().for_each(|v| *v /= 4);
        }
        for [x0, y0, x1, y1] in font::segments(&text) {
            for k in 0..=24 {
                let t = k as f32 / 24.0;
                let (x, y) = (4.0 + UNIT * (x0 + (x1 - x0) * t), 4.0 + UNIT * (y0 + (y1 - y0) * t));
                let at = (y.round() as usize * TILE[0] + x.round() as usize) * 3;
                if (x as usize) < TILE[0] - 1 {
                    self.rgb[at..at + 3].fill(255);
                }
            }
        }
    }
}

/// A scene through the head, the face's surroundings in a tile.
fn rendered(seed: u64, scene: &Scene, head: &Head, stock: &Stock) -> Picture {
    let view = &scene.views[0];
    let raster = Raster::covering(SENSOR_PX, FILM[0], FILM[1]);
    let options = Options { lasers: true, speckle: true, seed };
    let film = expose_film(&Stage::new(scene, view, head, raster, &stock.photos, options));
    let mut rng = Rng::new(seed, 3);
    let rgb = Sensor::random(&mut rng, scene.light.noise).develop(&film, raster.scale() as f32, &mut rng);
    let corners: Vec<[f64; 2]> = face_of(scene, view)
        .into_iter()
        .flat_map(|pose| pose.corners())
        .filter_map(|corner| Some(raster.from_px(px_of(head, &corner)?)))
        .collect();
    let span = |axis: usize| {
        let places = corners.iter().map(|c| c[axis]);
        (places.clone().fold(f64::MAX, f64::min), places.fold(f64::MIN, f64::max))
    };
    let ((left, right), (top, bottom)) = (span(0), span(1));
    let aspect = TILE[0] as f64 / TILE[1] as f64;
    let width = (1.5 * (right - left).max((bottom - top) * aspect)).clamp(200.0, FILM[0] as f64);
    let from = |middle: f64, size: f64, all: usize| (middle - 0.5 * size).clamp(0.0, all as f64 - size);
    let (left, top) =
        (from(0.5 * (left + right), width, FILM[0]), from(0.5 * (top + bottom), width / aspect, FILM[1]));
    Picture { size: FILM, rgb }.tile([left, top, width])
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args = Args::parse();
    let mut tiles = Vec::new();
    for hazard in Hazard::ALL {
        let stock = Stock { hazards: Hazards::only(&[hazard]), ..Stock::default() };
        let mut found = 0;
        // Other scenes for each, which would else be the same ones.
        for seed in (args.seed + MOST_SCENES * hazard as u64..).take(MOST_SCENES as usize) {
            let head = Head::random(&mut Rng::new(seed, 1))?;
            let scene = compose(&mut Rng::new(seed, 2), &head, Plan::Face, &stock);
            if found < args.each && scene.hazards.contains(&hazard) {
                let mut tile = rendered(seed, &scene, &head, &stock);
                tile.name(hazard.word());
                tiles.push(tile);
                found += 1;
            }
        }
    }
    let stock = Stock::default();
    for seed in (args.seed..).take(2 * args.each) {
        let head = Head::random(&mut Rng::new(seed, 1))?;
        let scene = compose(&mut Rng::new(seed, 2), &head, Plan::Refused(Refuse::Hidden), &stock);
        let mut tile = rendered(seed, &scene, &head, &stock);
        tile.name("hidden");
        tiles.push(tile);
    }
    for photo in &args.photos {
        let frame = Frame::from_jpeg(&std::fs::read(photo)?)?;
        let size = [frame.width_px(), frame.height_px()];
        let width = size[0].min(size[1] * TILE[0] / TILE[1]) as f64;
        let mut tile = Picture { size, rgb: frame.rgb().to_vec() }.tile([0.0, 0.0, width]);
        tile.name("photograph");
        tiles.push(tile);
    }
    let mut sheet = Picture::black([TILE[0] * ACROSS, TILE[1] * tiles.len().div_ceil(ACROSS)]);
    for (n, tile) in tiles.iter().enumerate() {
        for (row, line) in tile.rgb.chunks_exact(TILE[0] * 3).enumerate() {
            let at = (n / ACROSS * TILE[1] + row) * sheet.size[0] + n % ACROSS * TILE[0];
            sheet.rgb[at * 3..][..line.len()].copy_from_slice(line);
        }
    }
    let [width, height] = sheet.size.map(u16::try_from);
    Encoder::new_file(&args.out, QUALITY)?.encode(&sheet.rgb, width?, height?, ColorType::Rgb)?;
    Ok(())
}
