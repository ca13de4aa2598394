//! Criterion: each stage on one thread over one large span, and a whole training step on all cores. Throughput is in
//! samples, so `elem/s` compares stages with each other and with the step.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use trimip_core::backend::{Loss, Occupancy, Sampler};
use trimip_core::batch::{Radiance, StepSums, Workspace};
use trimip_core::trainer::Trainer;
use trimip_core::{Backend, Config, Encoder, Field, Layout, Renderer, Session, ViewSet};
use trimip_cpu::CpuBackend;
use trimip_cpu::simd::Simd;

/// The paper's model on small views of the built-in scene.
fn scene(samples: u32) -> (Config, ViewSet) {
    let mut config = Config::default();
    config.data.format = trimip_core::config::Format::Builtin;
    config.data.builtin_size = 64;
    config.data.builtin_train = 8;
    config.data.builtin_supersampling = 2;
    config.train.samples_per_step = samples;
    let views = trimip_data::open(&config.data).expect("the built-in scene needs no files").train;
    (config, views)
}

/// Occupied where the built-in scene is, roughly: a ball.
fn ball(resolution: u32) -> Vec<u8> {
    let cells = resolution.pow(3);
    let mut bits = vec![0; cells as usize / 8];
    for cell in 0..cells {
        let centre = resolution as f32 / 2.0;
        let distance = trimip_core::occupancy::coordinates(cell, resolution)
            .map(|c| (c as f32 + 0.5 - centre).powi(2))
            .iter()
            .sum::<f32>()
            .sqrt();
        bits[cell as usize / 8] |= u8::from(distance < 0.2 * resolution as f32) << (cell % 8);
    }
    bits
}

fn stages(criterion: &mut Criterion) {
    let (config, views) = scene(16_384);
    let backend = CpuBackend::new(1, Simd::detect()).expect("one thread");
    let mut stages = backend.stages(&config, Some(views)).expect("views that fit");
    let layout = Layout::new(&config);
    let mut parameters = backend.zeros(layout.len());
    backend.write(&mut parameters, &layout.initial(&config));
    stages.encoder.refresh(&parameters);
    stages.field.refresh(&parameters);
    stages.occupancy.restore(&ball(config.occupancy.resolution), None);

    let mut space = Workspace::<CpuBackend>::new(&backend, &stages.field);
    let Workspace { lane, rays, samples, features, tape, radiance, kept, pixels, .. } = &mut space;
    stages.sampler.training_rays(lane, 1, 64, 0..64, rays);
    stages.renderer.march(lane, rays, &stages.occupancy, Some(1), samples);
    let count = samples.spheres.len() as u64;

    let mut group = criterion.benchmark_group("stage, one thread");
    group.throughput(Throughput::Elements(count));
    group.bench_function("march", |b| {
        b.iter(|| stages.renderer.march(lane, black_box(rays), &stages.occupancy, Some(1), samples));
    });
    group.bench_function("encode", |b| {
        b.iter(|| stages.encoder.forward(lane, &parameters, black_box(samples), features));
    });
    group.bench_function("density", |b| {
        b.iter(|| stages.field.density(lane, samples, black_box(features), tape, radiance));
    });
    stages.renderer.prune(lane, radiance, samples, kept);
    stages.encoder.keep(lane, kept, features);
    stages.field.keep(lane, kept, tape, radiance);
    group.throughput(Throughput::Elements(samples.spheres.len() as u64));
    group.bench_function("color", |b| {
        b.iter(|| stages.field.color(lane, black_box(rays), samples, tape, radiance));
    });
    group.bench_function("composite", |b| {
        b.iter(|| stages.renderer.composite(lane, black_box(rays), samples, radiance, pixels));
    });
    let (mut pixel_gradients, mut radiance_gradients) = (backend.zeros(0), backend.zeros::<Radiance>(0));
    let mut sums = StepSums::default();
    group.bench_function("loss", |b| {
        b.iter(|| {
            stages.loss.evaluate(lane, rays, samples, black_box(pixels), &mut pixel_gradients, &mut sums)
        });
    });
    group.bench_function("composite backward", |b| {
        b.iter(|| {
            stages.renderer.backward(
                lane,
                samples,
                radiance,
                pixels,
                black_box(&pixel_gradients),
                &mut radiance_gradients,
            );
        });
    });
    let (mut gradient, mut feature_gradients) = (stages.field.gradient(), backend.zeros(0));
    group.bench_function("field backward", |b| {
        b.iter(|| {
            stages.field.backward(
                lane,
                samples,
                features,
                tape,
                radiance,
                black_box(&radiance_gradients),
                &mut feature_gradients,
                &mut gradient,
            );
        });
    });
    group.finish();
}

fn step(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("training step, all cores");
    group.sample_size(10);
    for samples in [32_768, 262_144] {
        let (config, views) = scene(samples);
        let backend = CpuBackend::new(0, Simd::detect()).expect("threads");
        let mut trainer = Trainer::new(backend, &config, views).expect("views that fit");
        // Past the first steps, whose rays meet a grid that is occupied everywhere.
        for _ in 0..24 {
            trainer.step(0.0).expect("a finite step");
        }
        group.throughput(Throughput::Elements(samples.into()));
        group.bench_function(format!("{samples} samples"), |b| {
            b.iter(|| trainer.step(0.0).expect("a finite step"));
        });
    }
    group.finish();
}

criterion_group!(benches, stages, step);
criterion_main!(benches);
