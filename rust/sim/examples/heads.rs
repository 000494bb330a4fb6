//! Heads with real lenses and what is wrong with heads and boards, calibrated from rendered frames: how far camera, planes and the sides
//! of boxes are off, in their sigmas, and which misfits are named. Prints the tables of `rust/CALIBRATION.md`.
//!
//! `cargo run --release -p boxline-sim --example heads -- --heads 24 --seed 301 --out heads.jsonl`
//!
//! One line a head is kept in the file: called again, it goes on with what is not there yet.

use boxline::calibration::CAMERA;
use boxline::calibration::{CalibrationStep, moved};
use boxline::frames::{Cam, Plane, Ray};
use boxline::{CameraModel, Frame, Px};
use boxline_calib::uncertainty::{SideSeen, side_sigma_mm, usual_distance_mm};
use boxline_calib::{Board, CalibrationSettings, CalibrationSolution, find_board, solve_all, solve_camera};
use boxline_sim::board::Faults;
use boxline_sim::head::{HeadKind, SENSOR_PX};
use boxline_sim::raster::Raster;
use boxline_sim::recording::{Kind, Recipe, render_recording};
use boxline_sim::rng::Rng;
use boxline_sim::{Head, Split, Stock};
use clap::{Parser, ValueEnum};
use indicatif::ProgressBar;
use nalgebra::{DMatrix, DVector, Rotation3, Vector3};
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// Calibrates rendered heads and says how far they are off
#[derive(Parser)]
struct Args {
    /// How many heads
    #[arg(long, default_value_t = 40)]
    heads: u64,
    /// Seed of the first; the next ones count on
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Frames of the board a head
    #[arg(long, default_value_t = 14)]
    frames: usize,
    /// Which lens
    #[arg(long, value_enum, default_value_t = Lens::Real)]
    head: Lens,
    /// What is wrong with all of them (focus=0.003,bow=2,stretch=0.001,light=0.8,tilt=0.3); without it, it is drawn for each
    #[arg(long, value_parser = Faults::parse)]
    faults: Option<Faults>,
    /// Where one line a head is kept
    #[arg(long)]
    out: PathBuf,
    /// Folder where pictures are kept, so that the same heads with the same faults are rendered once
    #[arg(long)]
    pictures: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Lens {
    Nominal,
    Random,
    Real,
}

impl From<Lens> for HeadKind {
    fn from(lens: Lens) -> Self {
        match lens {
            Lens::Nominal => Self::Nominal,
            Lens::Random => Self::Random,
            Lens::Real => Self::Real,
        }
    }
}

const BOARD: Board = Board { columns: 12, rows: 11, pitch_mm: 100.0, diameter_mm: 50.0 };
/// Sides whose lengths are compared, mm.
const SIDES_MM: [f64; 4] = [150.0, 600.0, 1200.0, 1800.0];
/// As good as with an ideal lens: a side may be off by this much, mm.
const SIDE_LIMIT_MM: f64 = 0.2;

/// What may be wrong with a head and a board, as large as it is found to be.
fn drawn(seed: u64) -> Faults {
    let rng = &mut Rng::new(seed, 0xFA17);
    Faults {
        focus: rng.range(0.0, 0.003),
        bow_mm: rng.range(-2.0, 2.0),
        stretch: rng.range(-0.001, 0.001),
        light: rng.range(0.0, 0.8),
        tilt_deg: rng.range(-0.3, 0.3),
    }
}

fn main() -> Result<()> {
    let args = Args::parse();
    let kept = std::fs::read_to_string(&args.out).unwrap_or_default();
    let mut rows: Vec<Value> =
        kept.lines().map(serde_json::from_str).collect::<std::result::Result<_, _>>()?;
    let done: Vec<u64> = rows.iter().filter_map(|row| row["seed"].as_u64()).collect();
    let seeds: Vec<u64> = (args.seed..args.seed + args.heads).filter(|seed| !done.contains(seed)).collect();
    let file = Mutex::new(std::fs::OpenOptions::new().create(true).append(true).open(&args.out)?);
    let (next, progress) = (AtomicUsize::new(0), ProgressBar::new(seeds.len() as u64));
    let work = || -> Result<Vec<Value>> {
        let mut rows = Vec::new();
        while let Some(seed) = seeds.get(next.fetch_add(1, Ordering::Relaxed)) {
            let row = head(&args, *seed)?;
            writeln!(file.lock().map_err(|e| e.to_string())?, "{row}")?;
            rows.push(row);
            progress.inc(1);
        }
        Ok(rows)
    };
    let threads = std::thread::available_parallelism()?.get();
    let found: Vec<Result<Vec<Value>>> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        workers.into_iter().map(|w| w.join().unwrap_or_else(|_| Err("a worker panicked".into()))).collect()
    });
    progress.finish_and_clear();
    for found in found {
        rows.extend(found?);
    }
    rows.retain(|row| row["seed"].as_u64().is_some_and(|s| (args.seed..args.seed + args.heads).contains(&s)));
    rows.sort_by_key(|row| row["seed"].as_u64());
    print(&rows);
    Ok(())
}

/// One head: rendered, calibrated, compared.
fn head(args: &Args, seed: u64) -> Result<Value> {
    let faults = args.faults.unwrap_or_else(|| drawn(seed));
    let recipe = Recipe { head: args.head.into(), faults, ..Recipe::new(seed, Kind::Board(args.frames)) };
    let kept = args.pictures.as_ref().map(|folder| folder.join(seed.to_string()));
    let (pictures, truth) = match kept.filter(|folder| folder.exists()) {
        Some(folder) => read_pictures(&folder, args.frames)?,
        None => rendered(&recipe, args.pictures.as_deref())?,
    };
    let faults_json = truth["faults"].clone();
    let solution = match calibrate(&pictures)? {
        Ok(solution) => solution,
        Err(why) => return Ok(json!({"seed": seed, "faults": faults_json, "refused": why})),
    };
    let head = Head::of_kind(args.head.into(), &mut Rng::new(seed, 1))?;
    let (camera, lasers) = (*head.calibration.camera(), *head.calibration.lasers());
    let raster = Raster::full(SENSOR_PX).tilted(faults.keystone_per_px(&head));
    let seen_at =
        |ray: &Ray<Cam>| camera.px_from_ray(ray).map(|px| raster.from_px(px)).map(|[u, v]| Px::new(u, v));
    let (best, turn, rest_px) =
        nearest(&camera, &lasers, seen_at).ok_or("no camera is near the tilted one")?;
    let planes = lasers.map(|plane| turn.inverse() * plane.per_mm);

    let covariance = &solution.covariance;
    let (c, t) = (&solution.camera, &best);
    let in_sigmas = |i: usize, error: f64| error / covariance[(i, i)].max(0.0).sqrt();
    let off = [c.fx - t.fx, c.fy - t.fy, c.cx - t.cx, c.cy - t.cy];
    let camera_sigmas: Vec<f64> = (0..4).map(|i| in_sigmas(i, off[i])).collect();
    let mut plane_sigmas = Vec::new();
    for (k, (found, true_plane)) in solution.lasers.iter().zip(planes).enumerate() {
        let error = found.per_mm - true_plane;
        plane_sigmas.extend((0..3).map(|i| in_sigmas(6 + 3 * k + i, error[i])));
    }
    let sides = SIDES_MM.iter().filter_map(|side| {
        let distance_mm = usual_distance_mm(*side);
        let seen = SideSeen::new(seen_at, &lasers, *side, distance_mm)?;
        let length_mm = seen.length_mm(&solution.camera, &solution.lasers)?;
        let sigma_mm = side_sigma_mm(&solution.camera, &solution.lasers, covariance, *side, distance_mm)?;
        Some(json!({"side_mm": side, "error_mm": length_mm - side, "sigma_mm": sigma_mm}))
    });
    let misfits = solution.misfits.iter().map(|m| json!({"kind": m.kind.name(), "size": m.size}));
    Ok(json!({
        "seed": seed,
        "faults": faults_json,
        "focus": truth["board_poses"].as_array().map(|all| all.iter().map(|p| p["focus"].clone()).collect::<Vec<_>>()),
        "frames": solution.frames.len(),
        "lens": solution.lens.name(),
        "circles_rms_px": solution.centre_rms_px,
        "tilt_rest_px": rest_px,
        "misfits": misfits.collect::<Vec<_>>(),
        "camera_error_px": off,
        "camera_error_sigmas": camera_sigmas,
        "plane_error_sigmas": plane_sigmas,
        "sides": sides.collect::<Vec<_>>(),
    }))
}

/// The pictures of a head and their truth.
type Pictures = (Vec<Vec<u8>>, Value);

fn picture_name(i: usize) -> String {
    format!("{i:02}.jpg")
}

fn read_pictures(folder: &Path, count: usize) -> Result<Pictures> {
    let read = |name: &str| std::fs::read(folder.join(name));
    let pictures = (0..count).map(|i| read(&picture_name(i))).collect::<std::io::Result<_>>()?;
    Ok((pictures, serde_json::from_slice(&read("truth.json")?)?))
}

fn rendered(recipe: &Recipe, keep_in: Option<&Path>) -> Result<Pictures> {
    let (mut pictures, mut truth) = (Vec::new(), Value::Null);
    render_recording(recipe, &Stock::new(Split::HeldOut), |name, bytes| {
        if name.ends_with(".jpg") {
            pictures.push(bytes);
        } else if name == "truth.json" {
            truth = serde_json::from_slice(&bytes).unwrap_or_default();
        }
        Ok(())
    })?;
    if let Some(folder) = keep_in {
        // A head's folder is there whole or not at all.
        let (part, whole) =
            (folder.join(format!("{}.part", recipe.seed)), folder.join(recipe.seed.to_string()));
        std::fs::create_dir_all(&part)?;
        for (i, picture) in pictures.iter().enumerate() {
            std::fs::write(part.join(picture_name(i)), picture)?;
        }
        std::fs::write(part.join("truth.json"), truth.to_string())?;
        std::fs::rename(part, whole)?;
    }
    Ok((pictures, truth))
}

fn calibrate(pictures: &[Vec<u8>]) -> Result<std::result::Result<CalibrationSolution, String>> {
    let (mut views, mut used) = (Vec::new(), Vec::new());
    for picture in pictures {
        if let Ok(view) = find_board(&Frame::from_jpeg(picture)?, &BOARD) {
            views.push(view);
            used.push(picture);
        }
    }
    let camera = match solve_camera(views, &BOARD, CalibrationSettings::default()) {
        Ok(camera) => camera,
        Err(why) => return Ok(Err(why.to_string())),
    };
    let mut stripes = Vec::new();
    for (view, picture) in used.into_iter().enumerate() {
        let frame = Frame::from_jpeg(picture)?;
        stripes.push(if camera.reject(view).is_none() {
            camera.find_stripes(view, &frame)
        } else {
            Vec::new()
        });
    }
    Ok(solve_all(camera, &stripes).map_err(|why| why.to_string()))
}

/// Unknowns of [`nearest`]: the camera's nine, and a turn.
const UNKNOWNS: usize = 12;
/// Steps of Gauss and Newton: from a tilt of a degree three are enough.
const STEPS: usize = 8;

/// The camera that comes nearest to one as a function of rays, turned: a sensor that is tilted is, but for what this leaves, one that is not
/// behind a lens that looks elsewhere. Camera, old frame of reference from new, and what is left, px rms.
fn nearest(
    start: &CameraModel,
    lasers: &[Plane<Cam>; 4],
    seen_at: impl Fn(&Ray<Cam>) -> Option<Px>,
) -> Option<(CameraModel, Rotation3<f64>, f64)> {
    let moved = |x: &DVector<f64>| {
        let mut step = CalibrationStep::zeros();
        for (k, index) in CAMERA.into_iter().enumerate() {
            step[index] = x[k];
        }
        (moved(start, lasers, &step).0, Rotation3::new(Vector3::new(x[9], x[10], x[11])))
    };
    let places: Vec<(Ray<Cam>, Px)> = (0..20 * 15)
        .filter_map(|i| {
            let at = Px::new(65.0 + 129.0 * f64::from(i % 20), 65.0 + 129.0 * f64::from(i / 20));
            let ray = start.ray_from_px(at);
            Some((ray, seen_at(&ray)?))
        })
        .collect();
    let off = |x: &DVector<f64>| -> Option<DVector<f64>> {
        let (camera, turn) = moved(x);
        let mut all = Vec::with_capacity(2 * places.len());
        for (ray, at) in &places {
            let direction = turn.inverse() * ray.xy1;
            let px = camera.px_from_ray(&Ray::new(direction.x / direction.z, direction.y / direction.z))?;
            all.extend([px.u - at.u, px.v - at.v]);
        }
        Some(DVector::from_vec(all))
    };
    let mut x = DVector::zeros(UNKNOWNS);
    for _ in 0..STEPS {
        let here = off(&x)?;
        let mut by = DMatrix::zeros(here.len(), UNKNOWNS);
        for k in 0..UNKNOWNS {
            // A hundredth of a px, or what moves the picture about as much.
            let size = if k < 4 { 1e-2 } else { 1e-6 };
            let mut step = x.clone();
            step[k] += size;
            by.set_column(k, &((off(&step)? - &here) / size));
        }
        x -= by.svd(true, true).solve(&here, 1e-9).ok()?;
    }
    let (camera, turn) = moved(&x);
    let rest = off(&x)?;
    Some((camera, turn, (rest.norm_squared() / rest.len() as f64).sqrt()))
}

/// Numbers under a key of all rows.
fn numbers<'a>(rows: &'a [Value], key: &'a str) -> impl Iterator<Item = f64> + 'a {
    rows.iter().flat_map(move |row| row[key].as_array().into_iter().flatten().filter_map(Value::as_f64))
}

/// Interval of a share that holds it in 95 of 100 (Clopper and Pearson 1934).
fn interval(hits: usize, of: usize) -> [f64; 2] {
    use statrs::distribution::{Beta, ContinuousCDF};
    let (k, n) = (hits as f64, of as f64);
    let quantile = |a: f64, b: f64, p: f64| Beta::new(a, b).map_or(f64::NAN, |beta| beta.inverse_cdf(p));
    let low = if hits == 0 { 0.0 } else { quantile(k, n - k + 1.0, 0.025) };
    let high = if hits == of { 1.0 } else { quantile(k + 1.0, n - k, 0.975) };
    [low, high]
}

fn share(hits: usize, of: usize) -> String {
    let [low, high] = interval(hits, of).map(|x| 100.0 * x);
    format!("{hits} of {of} ({low:.0} to {high:.0} %)")
}

fn print(rows: &[Value]) {
    let (refused, solved): (Vec<_>, Vec<_>) =
        rows.iter().cloned().partition(|row| row["refused"].is_string());
    println!("{} heads, {} refused", rows.len(), refused.len());
    for row in &refused {
        println!("  seed {}: {}", row["seed"], row["refused"]);
    }
    println!("| | values | within 3 sigma | mean (error/sigma)^2 | median of it |");
    println!("|---|---|---|---|---|");
    let row = |name: &str, sigmas: Vec<f64>| {
        let inside = sigmas.iter().filter(|z| z.abs() <= 3.0).count();
        let mut squares: Vec<f64> = sigmas.iter().map(|z| z * z).collect();
        squares.sort_by(f64::total_cmp);
        let mean = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
        let middle = squares.get(squares.len() / 2).copied().unwrap_or(f64::NAN);
        println!("| {name} | {} | {} | {mean:.2} | {middle:.2} |", sigmas.len(), share(inside, sigmas.len()));
    };
    row("fx, fy, cx, cy", numbers(&solved, "camera_error_sigmas").collect());
    row("planes, 12 each", numbers(&solved, "plane_error_sigmas").collect());
    let sides = |mm: f64| {
        let all = solved.iter().flat_map(|row| row["sides"].as_array().into_iter().flatten());
        all.filter(move |side| side["side_mm"] == json!(mm))
            .filter_map(|side| Some((side["error_mm"].as_f64()?, side["sigma_mm"].as_f64()?)))
            .collect::<Vec<_>>()
    };
    for mm in SIDES_MM {
        row(&format!("side {mm:.0} mm"), sides(mm).iter().map(|(error, sigma)| error / sigma).collect());
    }
    println!("\n| side, mm | error rms, mm | worst | sigma rms | within {SIDE_LIMIT_MM} mm |");
    println!("|---|---|---|---|---|");
    for mm in SIDES_MM {
        let all = sides(mm);
        let rms = |of: fn(&(f64, f64)) -> f64| {
            (all.iter().map(|x| of(x).powi(2)).sum::<f64>() / all.len().max(1) as f64).sqrt()
        };
        let worst = all.iter().map(|(error, _)| error.abs()).fold(0.0, f64::max);
        let inside = all.iter().filter(|(error, _)| error.abs() <= SIDE_LIMIT_MM).count();
        let (error, sigma) = (rms(|x| x.0), rms(|x| x.1));
        println!("| {mm:.0} | {error:.3} | {worst:.3} | {sigma:.3} | {} |", share(inside, all.len()));
    }
    println!("\n| misfit | first | named |");
    println!("|---|---|---|");
    let kinds = |row: &Value| -> Vec<String> {
        let all = row["misfits"].as_array().into_iter().flatten();
        all.filter_map(|m| m["kind"].as_str().map(str::to_owned)).collect()
    };
    for kind in boxline_calib::MisfitKind::ALL {
        let first = solved.iter().filter(|row| kinds(row).first().is_some_and(|k| k == kind.name())).count();
        let named = solved.iter().filter(|row| kinds(row).iter().any(|k| k == kind.name())).count();
        println!("| {} | {} | {} |", kind.name(), share(first, solved.len()), share(named, solved.len()));
    }
    let none = solved.iter().filter(|row| kinds(row).is_empty()).count();
    println!("| none | {} | |", share(none, solved.len()));
    let rest = solved.iter().filter_map(|row| row["tilt_rest_px"].as_f64()).fold(0.0, f64::max);
    println!("\nwhat the lens's terms do not take of the sensor's tilt: {rest:.4} px rms at most");
}
