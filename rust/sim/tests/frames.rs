//! Whole frames: the same seed gives the same bytes, and stripes are where their planes say.

#![allow(clippy::unwrap_used)] // the helpers of these tests are outside of test functions

use boxline::view::{BINS, VIEW};
use boxline::{Frame, Px};
use boxline_sim::head::SENSOR_PX;
use boxline_sim::labels::{CHANNELS, labels};
use boxline_sim::material::kinds::words;
use boxline_sim::pose::Refuse;
use boxline_sim::recording::jpeg;
use boxline_sim::render::{Film, Options, Stage, expose_film, expose_film_around};
use boxline_sim::stream::{FRAME_PX, header, sample, write_stream};
use boxline_sim::truth::face_of;
use boxline_sim::views::view_sample;
use boxline_sim::world::{Plan, Role, Scene, compose};
use boxline_sim::{Hazard, Hazards, Head, Raster, Rng, Shape, Split, Stock};

#[test]
fn a_seed_gives_the_same_frame_and_another_seed_another() {
    let stock = Stock::default();
    let first = sample(77, &stock).unwrap();
    assert_eq!(first, sample(77, &stock).unwrap());
    assert_ne!(first.rgb, sample(78, &stock).unwrap().rgb);
}

/// What a network is tested on must be new to it: no frame for training has a material of the other split, and the other
/// way round. Words are those of the whole scene, also of what the frame does not show.
#[test]
fn splits_share_no_material() {
    let common = ["paint", "photograph", "red line", "seam", "hand hole"];
    for (split, other) in [(Split::Training, Split::HeldOut), (Split::HeldOut, Split::Training)] {
        let stock = Stock::new(split);
        let mut met = std::collections::BTreeSet::new();
        for seed in 0..400 {
            let mut rng = Rng::new(seed, 40);
            let head = Head::random(&mut rng).unwrap();
            let plan = if seed % 8 == 0 { Plan::Refused(Refuse::NoBox) } else { Plan::Face };
            let scene = compose(&mut rng, &head, plan, &stock);
            met.extend(scene.materials(&stock).into_iter().map(str::to_owned));
        }
        let own = words(split);
        for word in &met {
            assert!(own.contains(&word.as_str()) || common.contains(&word.as_str()), "{split:?}: {word}");
            assert!(!words(other).contains(&word.as_str()));
        }
        // And every kind is met, so that the lists are not longer than what is drawn.
        assert!(own.iter().all(|w| met.contains(*w)), "{split:?}: only {met:?}");
    }
}

/// Photographs go to one split by their names.
#[test]
fn a_folder_of_photographs_is_divided_by_name() {
    let folder = std::env::temp_dir().join(format!("boxline-photos-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let [w, h] = SENSOR_PX.map(|n| n as usize);
    let picture = jpeg(&vec![90u8; w * h * 3], 1).unwrap();
    let names: Vec<String> = (0..12).map(|i| format!("p{i}.jpg")).collect();
    for name in &names {
        std::fs::write(folder.join(name), &picture).unwrap();
    }
    let read = |split| Stock::with_photos(split, &folder).map(|s| s.photos.all);
    let mut all = Vec::new();
    for split in [Split::Training, Split::HeldOut] {
        let photos = read(split).unwrap();
        assert!(photos.iter().all(|p| Split::of_photo(&p.name) == split && p.width <= 1024));
        all.extend(photos.into_iter().map(|p| p.name));
    }
    all.sort_unstable();
    let mut expected = names;
    expected.sort_unstable();
    assert_eq!(all, expected);
    std::fs::remove_dir_all(&folder).unwrap();
    assert!(read(Split::Training).is_err());
}

#[test]
fn a_stream_is_what_its_header_says() {
    let mut bytes = Vec::new();
    write_stream(&mut bytes, 5, Some(2), &Stock::default()).unwrap();
    assert_eq!(header().len(), 128);
    assert!(bytes.starts_with(header().as_bytes()));
    let mut at = 128;
    for seed in [5u64, 6] {
        assert_eq!(bytes[at..at + 8], seed.to_le_bytes());
        let meta = u32::from_le_bytes(bytes[at + 8..at + 12].try_into().unwrap()) as usize;
        let text = std::str::from_utf8(&bytes[at + 12..at + 12 + meta]).unwrap();
        let value: serde_json::Value = serde_json::from_str(text).unwrap();
        assert_eq!(value["contrast"].as_array().unwrap().len(), 4);
        at += 12 + meta + FRAME_PX[0] * FRAME_PX[1] * 3 + FRAME_PX[0] * FRAME_PX[1] / 4 * CHANNELS.len();
    }
    assert_eq!(at, bytes.len());
}

/// Along each side the picture of a plain bright box on a dark floor changes where its bin says.
#[test]
fn views_show_a_face_with_its_sides_where_their_bins_say() {
    let stock = Stock { hazards: Hazards::none(), ..Stock::default() };
    let (mut sides, mut steps) = (0, 0);
    for seed in 0..24 {
        let first = view_sample(seed, &stock).unwrap();
        assert_eq!(first, view_sample(seed, &stock).unwrap());
        let meta: serde_json::Value = serde_json::from_str(&first.meta).unwrap();
        let [_, rows, columns] = VIEW;
        let at = |side: usize, out: f64, along: usize| {
            let inner = columns - 2 * BINS;
            let cell = if side.is_multiple_of(2) { BINS as f64 - out } else { (BINS + inner) as f64 + out };
            let (row, column) = if side < 2 { (along, cell as usize) } else { (cell as usize, along) };
            (0..3).map(|c| i32::from(first.values[(c * rows + row) * columns + column])).collect::<Vec<_>>()
        };
        for side in 0..4 {
            let Some(bin) = meta["bins"][side].as_f64().filter(|bin| (4.0..BINS as f64 - 8.0).contains(bin))
            else {
                continue;
            };
            assert!(!meta["hidden"][side].as_bool().unwrap() || meta["refuse"] == "face_hidden");
            let far = |p: &[i32], q: &[i32]| p.iter().zip(q).map(|(p, q)| (p - q).abs()).max().unwrap();
            // Between the crossings there is always a piece of the side.
            let step = |from: f64, to: f64| {
                (BINS..columns - BINS).map(|k| far(&at(side, from, k), &at(side, to, k))).sum::<i32>()
            };
            sides += 1;
            steps += i32::from(
                step(bin - 3.0, bin + 3.0) > step(bin - 3.5, bin - 1.5).max(step(bin + 1.5, bin + 3.5)),
            );
        }
    }
    assert!(sides > 60 && steps * 10 > sides * 8, "{steps} of {sides} sides are steps");
}

/// The edges of an open flap are edges, but not of the face that is looked at.
#[test]
fn an_open_flap_is_labelled_beside_the_face() {
    let stock = Stock { hazards: Hazards::only(&[Hazard::OpenFlap]), ..Stock::default() };
    let head = Head::random(&mut Rng::new(1, 1)).unwrap();
    let drawn = (0..400).map(|seed| compose(&mut Rng::new(seed, 60), &head, Plan::Face, &stock));
    let mut scene = drawn.into_iter().find(|s| s.hazards.contains(&Hazard::OpenFlap)).unwrap();
    let sums = |scene: &Scene| {
        let raster = Raster::covering(SENSOR_PX, FRAME_PX[0], FRAME_PX[1]);
        let view = &scene.views[0];
        let stage = Stage::new(scene, view, &head, raster, &stock.photos, Options::default());
        let film = expose_film(&stage);
        let pose = face_of(scene, view).unwrap();
        let labels = labels(&stage, &film, &head, Some((&pose, view.face)));
        let n = labels.width * labels.height;
        ["face_edge", "other_edge"].map(|name| {
            let channel = CHANNELS.iter().position(|c| *c == name).unwrap();
            labels.bytes[channel * n..(channel + 1) * n].iter().map(|b| u64::from(*b)).sum::<u64>()
        })
    };
    let with = sums(&scene);
    let flap = scene.bodies.iter_mut().find(|b| b.role == Role::Flap).unwrap();
    flap.role = Role::Stand; // whose edges are not labelled
    let without = sums(&scene);
    assert_eq!(with[0], without[0]);
    assert!(with[1] > without[1] + 2000, "{with:?} {without:?}");
}

/// A measurable face, bare and flat, of a head of its own.
fn flat_scene() -> (Head, Scene) {
    let head = Head::random(&mut Rng::new(30, 1)).unwrap();
    let mut scene = compose(&mut Rng::new(30, 2), &head, Plan::Face, &Stock::default());
    let target = &mut scene.bodies[scene.target.unwrap()];
    target.shape = Shape::rounded(target.shape.radius_mm);
    target.look.decals.clear();
    target.look.wrap = None;
    target.look.gloss = 0.0;
    (head, scene)
}

fn film(head: &Head, scene: &Scene, lasers: bool) -> Film {
    let options = Options { lasers, speckle: false, seed: 0 };
    let stock = Stock::default();
    expose_film(&Stage::new(scene, &scene.views[0], head, Raster::full(SENSOR_PX), &stock.photos, options))
}

/// The stripe of laser k on a face q . X = 1 is the line (q - p_k) . x = 0 of the ideal image: the light's centroid along
/// a row must lie on it within 0.05 px.
#[test]
fn stripe_centroids_lie_on_the_line_of_the_two_planes() {
    let (head, scene) = flat_scene();
    let (on, off) = (film(&head, &scene, true), film(&head, &scene, false));
    let view = &scene.views[0];
    let face = face_of(&scene, view).unwrap();
    let inward = face.cam_from_face.column(2);
    let q = inward / inward.dot(&face.centre);
    let camera = head.calibration.camera();
    let mut worst = 0.0f64;
    for laser in 0..4 {
        let line = q - head.plane(laser);
        let at = |u: f64, v: f64| line.dot(&camera.ray_from_px(Px::new(u, v)).xy1);
        let ends = face
            .crossing(&head, laser, 0.0)
            .unwrap()
            .at
            .map(|[right, down]| boxline_sim::pose::px_of(&head, &face.point(right, down)).unwrap());
        let mut rows = 0;
        for step in 1..60 {
            let t = f64::from(step) / 60.0;
            let v = (ends[0].v + (ends[1].v - ends[0].v) * t).round();
            let guess = ends[0].u + (ends[1].u - ends[0].u) * t;
            let (mut low, mut high) = (guess - 60.0, guess + 60.0);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                let same = (at(middle, v) > 0.0) == (at(low, v) > 0.0);
                if same { low = middle } else { high = middle }
            }
            let expected = 0.5 * (low + high);
            // Print and fibres modulate both films alike: their ratio shows the laser alone.
            let (mut sum, mut weight) = (0.0, 0.0);
            let middle = expected.round();
            let reach = 24i32;
            let mut clean = true;
            for d in -reach..=reach {
                let i = v as usize * on.width + (middle as i64 + i64::from(d)) as usize;
                let share = f64::from((on.light[i].x - off.light[i].x) / off.light[i].x.max(1e-6));
                let others = on.traces.iter().any(|t| t.pixel as usize == i && usize::from(t.laser) != laser);
                clean &= !others && on.ids[i] == on.ids[v as usize * on.width + middle as usize];
                sum += share * (middle + f64::from(d));
                weight += share;
            }
            if clean && weight > 0.0 {
                rows += 1;
                worst = worst.max((sum / weight - expected).abs());
            }
        }
        assert!(rows > 10, "laser {}: only {rows} clean rows", laser + 1);
    }
    assert!(worst < 0.05, "{worst} px");
}

/// A small frame shows what the full one shows, averaged over each cell: whole scenes with lasers, without speckle and noise.
/// What differs: fine texture (small frames use halved tiles and leave out what is below a few levels), the light on
/// roundings, and four samples instead of four hundred where faces meet.
#[test]
fn a_small_frame_is_the_full_one_averaged() {
    let stock = Stock::default();
    let options = Options { lasers: true, speckle: false, seed: 0 };
    let (mut sum, mut count, mut red) = (0.0, 0.0, [0.0f64; 2]);
    for seed in 50..53 {
        let head = Head::random(&mut Rng::new(seed, 1)).unwrap();
        let scene = compose(&mut Rng::new(seed, 2), &head, Plan::Face, &stock);
        let view = &scene.views[0];
        let expose = |raster| expose_film(&Stage::new(&scene, view, &head, raster, &stock.photos, options));
        let full = expose(Raster::full(SENSOR_PX));
        let small = expose(Raster::covering(SENSOR_PX, FRAME_PX[0], FRAME_PX[1]));
        let [sx, sy] = [full.width as f64 / small.width as f64, full.height as f64 / small.height as f64];
        let level = |x: f64| 255.0 * x.clamp(0.0, 1.0).powf(1.0 / 2.2);
        for row in 2..small.height - 2 {
            for column in 2..small.width - 2 {
                let cover = |at: usize, scale: f64| {
                    let (low, high) = (at as f64 * scale, (at as f64 + 1.0) * scale);
                    (low as usize..high.ceil() as usize)
                        .map(move |i| (i, (i as f64 + 1.0).min(high) - (i as f64).max(low)))
                };
                let mut mean = [0.0; 3];
                for (y, wy) in cover(row, sy) {
                    for (x, wx) in cover(column, sx) {
                        let light = full.light[y * full.width + x];
                        for (m, c) in mean.iter_mut().zip([light.x, light.y, light.z]) {
                            *m += f64::from(c).min(1.0) * wx * wy / (sx * sy);
                        }
                    }
                }
                let light = small.light[row * small.width + column];
                let own = [light.x, light.y, light.z].map(|c| f64::from(c).min(1.0));
                for (m, c) in mean.iter().zip(own) {
                    sum += (level(*m) - level(c)).abs();
                    count += 1.0;
                }
                for (total, rgb) in red.iter_mut().zip([mean, own]) {
                    *total += (rgb[0] - 0.5 * (rgb[1] + rgb[2])).max(0.0);
                }
            }
        }
    }
    // One per cent of full scale, a fifth of one sensor pixel's noise; 1.9 levels when this was written. Stripes must carry
    // the same light.
    assert!(sum / count < 2.55, "{} levels", sum / count);
    assert!((red[0] / red[1] - 1.0).abs() < 0.03, "{red:?}");
}

/// Halved colour must not shift a red stripe by the half pixel that taking each block's first pixel does. Both samplings are
/// met by some seed; coarse quantisation of colour leaves up to 0.07 px of its own.
#[test]
fn encoding_does_not_shift_a_red_stripe() {
    let [w, h] = SENSOR_PX.map(|n| n as usize);
    // Not at exactly 45 degrees, or every block of the encoder would round alike.
    let middle = |row: usize| 400.3 + 1.0371 * row as f64;
    let mut rgb = vec![90u8; w * h * 3];
    for row in 0..h {
        for column in 0..w {
            let d = (column as f64 - middle(row)) / 3.5;
            rgb[(row * w + column) * 3] = (90.0 + 120.0 * (-0.5 * d * d).exp()) as u8;
        }
    }
    for seed in 0..6 {
        let frame = Frame::from_jpeg(&jpeg(&rgb, seed).unwrap()).unwrap();
        let (mut off, mut rows) = (0.0, 0.0);
        for row in (100..1500).step_by(10) {
            let centre = middle(row).round() as usize;
            let (mut sum, mut weight) = (0.0, 0.0);
            for column in centre - 14..=centre + 14 {
                let p = &frame.rgb()[(row * w + column) * 3..][..3];
                let red = (f64::from(p[0]) - (f64::from(p[1]) + f64::from(p[2])) / 2.0).max(0.0);
                sum += red * column as f64;
                weight += red;
            }
            off += sum / weight - middle(row);
            rows += 1.0;
        }
        assert!((off / rows).abs() < 0.1, "seed {seed}: {} px", off / rows);
    }
}

/// What learns from faces sees them as drawn everywhere, and less of what is far off.
#[test]
fn a_frame_drawn_finely_around_its_face_is_the_same_there() {
    let (head, scene) = flat_scene();
    let stock = Stock::default();
    let options = Options { lasers: true, speckle: true, seed: 4 };
    let raster = Raster::full(SENSOR_PX);
    let stage = Stage::new(&scene, &scene.views[0], &head, raster, &stock.photos, options);
    let window = [[800, 1200], [600, 1003]];
    let (all, part) = (expose_film(&stage), expose_film_around(&stage, window));
    let mut coarse = 0;
    for row in 0..all.height {
        for column in 0..all.width {
            let at = row * all.width + column;
            let inside = [column, row].iter().zip(window).all(|(i, [from, to])| (from..to).contains(i));
            // A pixel at the border may have a coarse neighbour.
            let well_inside =
                [column, row].iter().zip(window).all(|(i, [from, to])| (from + 1..to - 1).contains(i));
            assert!(!well_inside || all.light[at] == part.light[at], "column {column}, row {row}");
            coarse += usize::from(!inside && all.light[at] != part.light[at]);
        }
    }
    assert!(coarse > 1_000_000, "{coarse}");
}
