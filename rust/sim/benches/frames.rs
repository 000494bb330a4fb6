//! Time of a labelled small frame, of its steps, and of a full frame: `cargo bench -p boxline-sim`.
//! Frames differ, so one turn of the small ones renders twenty.

#![allow(missing_docs)] // of the function that criterion_group! makes

use boxline_sim::head::SENSOR_PX;
use boxline_sim::recording::full_frame;
use boxline_sim::render::sensor::Sensor;
use boxline_sim::render::{Options, Stage, expose_film};
use boxline_sim::stream::{FRAME_PX, sample};
use boxline_sim::world::{Plan, Scene, compose};
use boxline_sim::{Head, Raster, Rng, Split, Stock};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

const FRAMES: u64 = 20;

fn frames(criterion: &mut Criterion) {
    let stock = Stock::new(Split::Training);
    let scenes: Vec<(Head, Scene)> = (0..FRAMES)
        .map(|seed| {
            let head = Head::random(&mut Rng::new(seed, 1)).expect("fifty draws");
            let scene = compose(&mut Rng::new(seed, 2), &head, Plan::Face, &stock);
            (head, scene)
        })
        .collect();
    let stage = |head: &Head, scene: &Scene| {
        let raster = Raster::covering(SENSOR_PX, FRAME_PX[0], FRAME_PX[1]);
        expose_film(&Stage::new(scene, &scene.views[0], head, raster, &stock.photos, Options::default()))
    };
    let mut group = criterion.benchmark_group("frames");
    group.sample_size(10).throughput(Throughput::Elements(FRAMES));
    group.bench_function("labelled", |bench| {
        bench.iter(|| (0..FRAMES).for_each(|seed| drop(black_box(sample(seed, &stock)))));
    });
    group.bench_function("compose", |bench| {
        bench.iter(|| {
            for (seed, (head, _)) in (0..).zip(&scenes) {
                black_box(compose(&mut Rng::new(seed, 2), head, Plan::Face, &stock));
            }
        });
    });
    group.bench_function("film", |bench| {
        bench.iter(|| scenes.iter().for_each(|(head, scene)| drop(black_box(stage(head, scene)))));
    });
    let films: Vec<_> = scenes.iter().map(|(head, scene)| stage(head, scene)).collect();
    group.bench_function("sensor", |bench| {
        bench.iter(|| {
            for film in &films {
                let mut rng = Rng::new(1, 3);
                let sensor = Sensor::random(&mut rng, 0.02);
                black_box(sensor.develop(film, 5.0, &mut rng));
            }
        });
    });
    group.throughput(Throughput::Elements(1));
    group.bench_function("full", |bench| {
        let (head, scene) = &scenes[0];
        bench.iter(|| full_frame(head, scene, &scene.views[0], true, black_box(1), &stock));
    });
    group.finish();
}

criterion_group!(benches, frames);
criterion_main!(benches);
