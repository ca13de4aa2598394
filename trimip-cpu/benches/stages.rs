//! Criterion benchmarks: each stage on one thread over one large tile, both with the widest instruction set and in
//! plain Rust, and a whole training step on all cores. Throughput is in samples (in rays for ray generation, in
//! parameters for the end of a step), so the `elem/s` of a stage can be compared with those of other stages and of the
//! whole step.

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use std::time::{Duration, Instant};
use trimip_core::config::Precision;
use trimip_core::engine::backend::{Loss, Occupancy, Optimizer, RenderedTile, Sampler, Stages};
use trimip_core::engine::batch::{
    FieldBackward, PartialGradients, Radiance, StepResult, Tile, Update, Workspace,
};
use trimip_core::engine::trainer::Trainer;
use trimip_core::{Backend, Config, Encoder, Field, Layout, Renderer, Session, ViewSet};
use trimip_cpu::CpuBackend;
use trimip_cpu::simd::Simd;
use trimip_data::settings::DataConfig;

/// Returns the configuration of the paper's model, and small views of the built-in scene.
fn scene(samples: u32) -> (Config, ViewSet) {
    let mut config = Config::default();
    config.train.samples_per_step = samples;
    let data = DataConfig {
        format: "builtin".into(),
        builtin_size: 64,
        builtin_train: 8,
        builtin_supersampling: 2,
        ..DataConfig::default()
    };
    let views = trimip_data::open(&data).expect("the built-in scene needs no files").train;
    (config, views)
}

/// Returns the bits of an occupancy grid whose occupied cells form a ball, roughly those of the built-in scene.
fn ball(resolution: u32) -> Vec<u8> {
    let cells = resolution.pow(3);
    let mut bits = vec![0; cells as usize / 8];
    for cell in 0..cells {
        let centre = resolution as f32 / 2.0;
        let distance = trimip_core::geometry::occupancy::coordinates(cell, resolution)
            .map(|c| (c as f32 + 0.5 - centre).powi(2))
            .iter()
            .sum::<f32>()
            .sqrt();
        bits[cell as usize / 8] |= u8::from(distance < 0.2 * resolution as f32) << (cell % 8);
    }
    bits
}

fn stages(criterion: &mut Criterion) {
    let widest = Simd::detect();
    for (simd, precision) in
        [(widest, Precision::F32), (widest, Precision::Bf16), (Simd::Portable, Precision::F32)]
    {
        let (mut config, views) = scene(16_384);
        config.field.precision = precision;
        let mut group = criterion.benchmark_group(format!("stage, one thread, {simd:?}, {precision:?}"));
        one_by_one(&mut group, &config, views, simd);
        group.finish();
    }
}

/// Benchmarks every stage of a step on one thread. Only the field's stages and the end of the step depend on the
/// precision.
fn one_by_one(group: &mut BenchmarkGroup<'_, WallTime>, config: &Config, views: ViewSet, simd: Simd) {
    let backend = CpuBackend::new(1, simd).expect("one thread");
    let mut stages = backend.stages(config, Some(views)).expect("views that fit");
    let layout = Layout::new(config);
    let mut parameters = backend.zeros(layout.len());
    backend.write(&mut parameters, &layout.initial(config));
    stages.encoder.refresh(&parameters);
    stages.field.refresh(&parameters);
    stages.occupancy.restore(&ball(config.occupancy.resolution), None);

    let mut workspace = Workspace::<CpuBackend>::new(&backend, &stages.field);
    let Workspace {
        stream,
        rays,
        samples,
        encoder_context,
        features,
        field_context,
        radiance,
        kept,
        cones,
        pixels,
        ..
    } = &mut workspace;
    let mut partial = PartialGradients {
        field: stages.field.gradient(),
        encoder: stages.encoder.gradient(),
        sums: StepResult::default(),
    };
    let allocation = stages.sampler.scale_weights().allocate(64);
    group.throughput(Throughput::Elements(64));
    group.bench_function("sample rays", |b| {
        let mut step = 0;
        b.iter(|| {
            step += 1;
            stages.sampler.training_rays(stream, step, &allocation, 0..64, rays);
        });
    });
    stages.sampler.training_rays(stream, 1, &allocation, 0..64, rays);
    stages.renderer.march(stream, rays, &stages.occupancy, Some(1), samples);
    group.throughput(Throughput::Elements(samples.spheres.len() as u64));
    stage(group, "march", || {
        stages.renderer.march(stream, black_box(&*rays), &stages.occupancy, Some(1), samples);
    });
    stage(group, "encode", || {
        let tile = &mut Tile { stream: &mut *stream, parameters: &parameters, rays, samples };
        stages.encoder.forward(black_box(tile), encoder_context, features);
    });
    stage(group, "density", || {
        let tile = &mut Tile { stream: &mut *stream, parameters: &parameters, rays, samples };
        stages.field.density(tile, black_box(&*features), field_context, radiance);
    });
    stages.renderer.prune(stream, radiance, samples, kept);
    stages.encoder.keep(stream, kept, encoder_context, features);
    stages.field.keep(stream, kept, field_context, radiance);
    group.throughput(Throughput::Elements(samples.spheres.len() as u64));
    stage(group, "color", || {
        let tile = &mut Tile { stream: &mut *stream, parameters: &parameters, rays, samples };
        stages.field.color(black_box(tile), 0.0, field_context, radiance);
    });
    stage(group, "composite", || {
        let tile = &mut Tile { stream: &mut *stream, parameters: &parameters, rays, samples };
        stages.renderer.composite(black_box(tile), radiance, cones, pixels);
    });
    let (mut pixel_gradients, mut radiance_gradients) = (backend.zeros(0), backend.zeros::<Radiance>(0));
    stage(group, "loss", || {
        let tile = RenderedTile { rays, samples, radiance, pixels: black_box(&*pixels) };
        stages.loss.evaluate_pixels(stream, &tile, &mut pixel_gradients, &mut partial.sums);
    });
    stage(group, "composite backward", || {
        let pixel_gradients = black_box(&pixel_gradients);
        let tile = &mut Tile { stream: &mut *stream, parameters: &parameters, rays, samples };
        stages.renderer.backward(tile, radiance, cones, pixel_gradients, &mut radiance_gradients);
    });
    let mut feature_gradients = backend.zeros(0);
    stage(group, "field backward", || {
        let tile = &mut Tile { stream: &mut *stream, parameters: &parameters, rays, samples };
        let radiance_gradients = black_box(&radiance_gradients);
        let feature_gradients = &mut feature_gradients;
        let arrays = FieldBackward { features, radiance, radiance_gradients, feature_gradients };
        stages.field.backward(tile, arrays, field_context, &mut partial.field);
    });
    // Accumulating a tile's gradients is timed separately from reducing all partial gradients at the end of the step.
    let mut gradient = backend.zeros(layout.len());
    let mut partials = [partial];
    let mut timed = |stages: &mut Stages<CpuBackend>, count: u64, end_of_step: bool| {
        let mut time = Duration::ZERO;
        for step in 0..count {
            let start = Instant::now();
            let partial = &mut partials[0].encoder;
            let tile = &mut Tile { stream: &mut *stream, parameters: &parameters, rays, samples };
            stages.encoder.backward(tile, encoder_context, &feature_gradients, partial);
            let deposited = start.elapsed();
            stages.reduce(&mut partials, &parameters, &mut gradient);
            if end_of_step {
                stages.optimizer.step(&mut Update {
                    parameters: &mut parameters,
                    gradient: &mut gradient,
                    partials: &mut partials,
                    learning_rate: 1e-3,
                    step: step + 1,
                });
                stages.encoder.refresh(&parameters);
                stages.field.refresh(&parameters);
            }
            time += if end_of_step { start.elapsed() - deposited } else { deposited };
        }
        time
    };
    group.bench_function("encode backward", |b| b.iter_custom(|count| timed(&mut stages, count, false)));
    group.throughput(Throughput::Elements(layout.len() as u64));
    group.bench_function("end of step", |b| b.iter_custom(|count| timed(&mut stages, count, true)));
}

/// Benchmarks a stage. The stage runs at least once, even if a filter skips the benchmark, because later stages read
/// its result.
fn stage(group: &mut BenchmarkGroup<'_, WallTime>, name: &str, mut work: impl FnMut()) {
    work();
    group.bench_function(name, |b| b.iter(&mut work));
}

fn step(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("training step, all cores");
    group.sample_size(10);
    for (samples, precision) in
        [(32_768, Precision::F32), (262_144, Precision::F32), (262_144, Precision::Bf16)]
    {
        let (mut config, views) = scene(samples);
        config.field.precision = precision;
        // Called only if no filter skips the benchmark.
        let start = || {
            let backend = CpuBackend::new(0, Simd::detect()).expect("threads");
            let mut trainer = Trainer::new(backend, &config, views.clone()).expect("views that fit");
            // Skips the first steps, in which the occupancy grid is still occupied everywhere.
            for _ in 0..24 {
                trainer.step(0.0).expect("a finite step");
            }
            trainer
        };
        let mut trainer = None;
        group.throughput(Throughput::Elements(samples.into()));
        group.bench_function(format!("{samples} samples, {precision:?}"), |b| {
            let trainer = trainer.get_or_insert_with(start);
            b.iter(|| trainer.step(0.0).expect("a finite step"));
        });
    }
    group.finish();
}

criterion_group!(benches, stages, step);
criterion_main!(benches);
