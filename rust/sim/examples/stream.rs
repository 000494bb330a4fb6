//! Labelled frames to standard output or, with `--time`, only their speed:
//! `cargo run --release -p boxline-sim --example stream -- --seed 1 --count 200 --time`.

use boxline_sim::stream::{sample, write_stream};
use boxline_sim::{Split, Stock};
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut seed, mut count, mut time) = (1u64, None, false);
    let mut photos = Stock::default();
    let mut args = std::env::args().skip(1);
    while let Some(key) = args.next() {
        match key.as_str() {
            "--time" => time = true,
            "--seed" => seed = args.next().ok_or("--seed needs a value")?.parse()?,
            "--count" => count = Some(args.next().ok_or("--count needs a value")?.parse()?),
            "--photos" => {
                let folder = PathBuf::from(args.next().ok_or("--photos needs a value")?);
                photos = Stock::with_photos(Split::Training, &folder)?;
            }
            _ => return Err(format!("{key} is not known").into()),
        }
    }
    if !time {
        write_stream(&mut std::io::BufWriter::new(std::io::stdout().lock()), seed, count, &photos)?;
        return Ok(());
    }
    let count = count.unwrap_or(200);
    sample(seed, &photos)?; // makes the noise tiles
    let (wall, cpu) = (std::time::Instant::now(), cpu_seconds());
    for n in 0..count {
        std::hint::black_box(sample(seed + n, &photos)?);
    }
    let (wall, cpu) = (wall.elapsed().as_secs_f64(), cpu_seconds() - cpu);
    let n = count as f64;
    println!("{count} frames: {:.1} a second of processor time, {:.1} of wall time", n / cpu, n / wall);
    Ok(())
}

/// Processor time of this process from the kernel's counter in hundredths of a second; wall time where there is none.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let ticks: Vec<f64> =
        stat.rsplit(')').next().unwrap_or("").split_whitespace().filter_map(|t| t.parse().ok()).collect();
    // After the name: state (not a number), then from the third field on; utime and stime are 14 and 15.
    ticks.get(10).zip(ticks.get(11)).map_or(0.0, |(u, s)| (u + s) / 100.0)
}
