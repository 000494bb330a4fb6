//! Writes recordings: `cargo run --release -p boxline-sim --example render -- --seed 1 --count 20 --out DIR`.
//! `--kind box|faces|refuse` (box), `--frames N` per folder for the latter two, `--off` adds frames with lasers off,
//! `--photos DIR` takes textures from there.

use boxline_sim::recording::{Kind, write_recording};
use boxline_sim::{Split, Stock};
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut seed, mut count, mut frames) = (1u64, 1u64, 4usize);
    let (mut out, mut kind, mut off) = (PathBuf::from("rendered"), "box".to_owned(), false);
    let mut photos = Stock::default();
    let mut args = std::env::args().skip(1);
    while let Some(key) = args.next() {
        if key == "--off" {
            off = true;
            continue;
        }
        let value = args.next().ok_or(format!("{key} needs a value"))?;
        match key.as_str() {
            "--seed" => seed = value.parse()?,
            "--count" => count = value.parse()?,
            "--frames" => frames = value.parse()?,
            "--out" => out = PathBuf::from(value),
            "--kind" => kind = value,
            "--photos" => photos = Stock::with_photos(Split::Training, &PathBuf::from(value))?,
            _ => return Err(format!("{key} is not known").into()),
        }
    }
    for n in 0..count {
        let what = match kind.as_str() {
            "box" => Kind::Box,
            "faces" => Kind::Faces(frames),
            "refuse" => Kind::Refuse(frames),
            _ => return Err(format!("--kind {kind}: box, faces or refuse").into()),
        };
        let start = std::time::Instant::now();
        let folder = out.join(format!("{:03}", n + 1));
        write_recording(&folder, seed + n, what, off, &photos)?;
        println!("{} {:.2} s", folder.display(), start.elapsed().as_secs_f64());
    }
    Ok(())
}
