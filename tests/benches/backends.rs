//! Criterion benchmarks of every stage and of a whole training step, on the CPU and on the GPU. A table of both
//! backends follows at the end. Each stage processes one tile, on the CPU with one thread; the training step uses all
//! cores. `TRIMIP_BENCH_SAMPLES` sets the number of samples of a step (small for a software driver, large for a
//! graphics card).

use criterion::{Criterion, Throughput};
use std::path::Path;
use std::time::{Duration, Instant};
use trimip_core::config::Precision;
use trimip_core::engine::backend::{Loss, Occupancy, RenderedTile, Sampler};
use trimip_core::engine::batch::{FieldBackward, PartialGradients, Tile, Update, Workspace};
use trimip_core::engine::trainer::Trainer;
use trimip_core::{Backend, Config, Encoder, Field, Layout, Renderer, Session, ViewSet};
use trimip_cpu::{CpuBackend, simd::Simd};
use trimip_data::settings::DataConfig;
use trimip_wgpu::{Addition, WgpuBackend};

/// Number of untimed steps before the timed ones; during the first steps the occupancy grid is full.
const WARM: usize = 24;

fn samples() -> u32 {
    std::env::var("TRIMIP_BENCH_SAMPLES").ok().and_then(|text| text.parse().ok()).unwrap_or(8192)
}

/// Returns the configuration of the authors' code and small training views of the built-in scene.
fn scene(precision: Precision) -> (Config, ViewSet) {
    let mut config = trimip_tests::fixtures::as_code();
    config.train.samples_per_step = samples();
    config.field.precision = precision;
    (config.occupancy.resolution, config.occupancy.warmup) = (64, 8);
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

/// Returns the bits of an occupancy grid that approximates the built-in scene: a ball.
fn ball(resolution: u32) -> Vec<u8> {
    let cells = resolution.pow(3);
    let mut bits = vec![0; cells as usize / 8];
    for cell in 0..cells {
        let centre = resolution as f32 / 2.0;
        let offsets =
            trimip_core::geometry::occupancy::coordinates(cell, resolution).map(|c| c as f32 + 0.5 - centre);
        let distance = offsets.iter().map(|offset| offset * offset).sum::<f32>().sqrt();
        bits[cell as usize / 8] |= u8::from(distance < 0.2 * resolution as f32) << (cell % 8);
    }
    bits
}

/// A backend to measure.
struct Way<'a, B> {
    name: &'a str,
    make: &'a dyn Fn() -> B,
    precision: Precision,
}

/// Times every stage: submits the stage many times and waits once for all submissions.
fn stages<B: Backend>(criterion: &mut Criterion, way: &Way<'_, B>) {
    let (config, views) = scene(way.precision);
    let backend = (way.make)();
    let layout = Layout::new(&config);
    let mut stages = backend.stages(&config, Some(views)).expect("views that fit");
    let (mut parameters, mut gradient) = (backend.zeros(layout.len()), backend.zeros(layout.len()));
    backend.write(&mut parameters, &layout.initial(&config));
    stages.encoder.refresh(&parameters);
    stages.field.refresh(&parameters);
    stages.occupancy.restore(&ball(config.occupancy.resolution), None);
    let mark = backend.zeros::<u32>(1);
    let timed = |work: &mut dyn FnMut(), count: u64| -> Duration {
        backend.read(&mark);
        let start = Instant::now();
        for _ in 0..count {
            work();
        }
        backend.read(&mark);
        start.elapsed()
    };
    let rays = config.train.samples_per_step / 32;
    let mut workspace = Workspace::<B>::new(&backend, &stages.field);
    let mut partials = [PartialGradients {
        field: stages.field.gradient(),
        encoder: stages.encoder.gradient(),
        sums: B::Sums::default(),
    }];
    let mut bench = |stage: &str, elements: u64, work: &mut dyn FnMut()| {
        let mut group = criterion.benchmark_group(stage);
        group
            .sample_size(10)
            .measurement_time(Duration::from_secs(2))
            .warm_up_time(Duration::from_millis(500));
        group.throughput(Throughput::Elements(elements));
        group.bench_function(way.name, |b| b.iter_custom(|count| timed(work, count)));
        group.finish();
    };

    let allocation = stages.sampler.scale_weights().allocate(rays);
    bench("sample rays", rays.into(), &mut || {
        stages.sampler.training_rays(&mut workspace.stream, 1, &allocation, 0..rays, &mut workspace.rays);
    });
    stages.sampler.training_rays(&mut workspace.stream, 1, &allocation, 0..rays, &mut workspace.rays);
    let Workspace { stream, rays, samples, encoder_context, features, field_context, radiance, .. } =
        &mut workspace;
    stages.renderer.march(stream, rays, &stages.occupancy, Some(1), samples);
    let marched = backend.read(&samples.spheres).len() as u64;
    bench("march", marched, &mut || {
        stages.renderer.march(stream, rays, &stages.occupancy, Some(1), samples);
    });
    let tile = &mut Tile { stream, parameters: &parameters, rays, samples };
    bench("encode", marched, &mut || stages.encoder.forward(tile, encoder_context, features));
    bench("density", marched, &mut || stages.field.density(tile, features, field_context, radiance));
    bench("march to density, pruned", marched, &mut || {
        stages.renderer.visibility_pass(&stages, &parameters, &mut workspace, Some(1));
    });
    let Workspace {
        stream,
        rays,
        samples,
        encoder_context,
        features,
        feature_gradients,
        field_context,
        radiance,
        radiance_gradients,
        cones,
        pixels,
        pixel_gradients,
        ..
    } = &mut workspace;
    let kept = backend.read(&samples.spheres).len() as u64;
    let tile = &mut Tile { stream, parameters: &parameters, rays, samples };
    bench("color", kept, &mut || stages.field.color(tile, 0.0, field_context, radiance));
    bench("composite", kept, &mut || stages.renderer.composite(tile, radiance, cones, pixels));
    bench("loss", kept, &mut || {
        let rendered = RenderedTile { rays, samples, radiance, pixels };
        stages.loss.evaluate_pixels(tile.stream, &rendered, pixel_gradients, &mut partials[0].sums);
    });
    bench("composite backward", kept, &mut || {
        stages.renderer.backward(tile, radiance, cones, pixel_gradients, radiance_gradients);
    });
    bench("field backward", kept, &mut || {
        let feature_gradients = &mut *feature_gradients;
        let arrays = FieldBackward { features, radiance, radiance_gradients, feature_gradients };
        stages.field.backward(tile, arrays, field_context, &mut partials[0].field);
    });
    bench("scatter and end of step", kept, &mut || {
        let tile = &mut Tile { stream: &mut *stream, parameters: &parameters, rays, samples };
        stages.encoder.backward(tile, encoder_context, feature_gradients, &mut partials[0].encoder);
        stages.reduce(&mut partials, &parameters, &mut gradient);
        let (parameters, gradient, partials) = (&mut parameters, &mut gradient, &mut partials);
        backend.update(
            &mut stages,
            &mut Update { parameters, gradient, partials, learning_rate: 1e-3, step: 1 },
        );
    });
    backend.health().expect("the device works");
}

/// Times whole training steps, after the untimed ones.
fn step<B: Backend>(criterion: &mut Criterion, way: &Way<'_, B>) {
    let (config, views) = scene(way.precision);
    let mut trainer = Trainer::new((way.make)(), &config, views).expect("views that fit");
    for _ in 0..WARM {
        trainer.step(0.0).expect("a finite step");
    }
    let mut group = criterion.benchmark_group("training step");
    group.sample_size(10).measurement_time(Duration::from_secs(4));
    group.throughput(Throughput::Elements(config.train.samples_per_step.into()));
    group.bench_function(way.name, |b| {
        b.iter_custom(|count| {
            let start = Instant::now();
            for _ in 0..count {
                trainer.step(0.0).expect("a finite step");
            }
            trainer.health().expect("the device works");
            start.elapsed()
        });
    });
    group.finish();
}

fn both<B: Backend>(criterion: &mut Criterion, way: &Way<'_, B>) {
    stages(criterion, way);
    step(criterion, way);
}

/// Reads the median nanoseconds per element of the benchmark `group`/`name` from criterion's files.
fn estimate(folder: &Path, group: &str, name: &str) -> Option<f64> {
    let base = folder.join(group.replace(' ', "_")).join(name).join("new");
    let base = if base.exists() { base } else { folder.join(group).join(name).join("new") };
    let json = |file: &str| -> Option<serde_json::Value> {
        serde_json::from_slice(&std::fs::read(base.join(file)).ok()?).ok()
    };
    let time = json("estimates.json")?["median"]["point_estimate"].as_f64()?;
    let elements = json("benchmark.json")?["throughput"]["Elements"].as_f64()?;
    Some(time / elements)
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    let cpu = |threads| move || CpuBackend::new(threads, Simd::detect()).expect("threads start");
    let (one, all) = (cpu(1), cpu(0));
    stages(&mut criterion, &Way { name: "cpu", make: &one, precision: Precision::F32 });
    step(&mut criterion, &Way { name: "cpu", make: &all, precision: Precision::F32 });
    let gpu =
        || WgpuBackend::adding("", Addition::Fixed).expect("the adapter opens").expect("every device can");
    let mut names = vec!["cpu"];
    let mut adapter = "no adapter for wgpu".to_string();
    if !trimip_wgpu::adapters().is_empty() {
        adapter = gpu().adapter();
        both(&mut criterion, &Way { name: "wgpu f32", make: &gpu, precision: Precision::F32 });
        names.push("wgpu f32");
        if gpu().cooperates() {
            both(&mut criterion, &Way { name: "wgpu f16", make: &gpu, precision: Precision::F16 });
            names.push("wgpu f16");
        }
    }
    criterion.final_summary();

    let target = std::env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../target"), std::path::PathBuf::from);
    let folder = target.join("criterion");
    println!(
        "\n{} samples a step; wgpu on {adapter}; stages on the CPU by one thread, the step by all",
        samples()
    );
    println!("| nanoseconds a sample | {} |", names.join(" | "));
    println!("|---|{}", "---|".repeat(names.len()));
    for (stage, _) in work() {
        let cells: Vec<String> = names
            .iter()
            .map(|name| estimate(&folder, stage, name).map_or("not run".into(), |ns| format!("{ns:.2}")))
            .collect();
        println!("| {stage} | {} |", cells.join(" | "));
    }
    if names.len() > 1 {
        roofline(&folder, &names[1..], &gpu().ceilings());
    }
}

/// Returns the floating-point operations and the bytes of memory traffic per sample of each stage, for the paper's
/// networks; `None` for stages of mixed work. Every texel counts as read from memory, without a cache; arrays of
/// samples count as read and written once.
fn work() -> [(&'static str, Option<[f64; 2]>); 12] {
    let products = |layers: &[[f64; 2]]| layers.iter().map(|[k, n]| 2.0 * k * n).sum::<f64>();
    // Bytes that the layers read and write.
    let rows = |layers: &[[f64; 2]]| layers.iter().map(|[k, n]| 4.0 * (k + n)).sum::<f64>();
    let (density, color) = ([[48.0, 128.0], [128.0, 16.0]], [[32.0, 128.0], [128.0, 128.0], [128.0, 16.0]]);
    let taps = 3.0 * 8.0 * 16.0;
    let forward = [products(&density) + products(&color), rows(&density) + rows(&color)];
    [
        ("sample rays", None),
        ("march", None),
        ("encode", Some([2.0 * taps, 4.0 * taps + 4.0 * 48.0])),
        ("density", Some([products(&density), rows(&density)])),
        ("march to density, pruned", None),
        ("color", Some([products(&color), rows(&color)])),
        ("composite", Some([30.0, 16.0 + 8.0])),
        ("loss", None),
        ("composite backward", Some([40.0, 16.0 + 8.0 + 16.0])),
        // The backward pass of a layer computes two products: the gradient of its input and that of its weights.
        ("field backward", Some([2.0 * forward[0], 2.0 * forward[1]])),
        ("scatter and end of step", None),
        ("training step", Some([3.0 * forward[0] + 4.0 * taps, 3.0 * forward[1] + 8.0 * taps])),
    ]
}

/// Prints the performance of each stage as a fraction of the device's measured ceilings.
fn roofline(folder: &Path, names: &[&str], ceilings: &trimip_wgpu::Ceilings) {
    let (operations, bytes) = (ceilings.operations / 1e9, ceilings.bytes / 1e9);
    println!("\nmeasured ceilings: {operations:.1} GFLOP/s of f32 multiply-adds, {bytes:.1} GB/s of copies");
    println!("| stage | way | FLOP a sample | bytes a sample | GFLOP/s | share | GB/s | share |");
    println!("|---|---|---|---|---|---|---|---|");
    for (stage, work) in work() {
        let Some([flop, memory]) = work else { continue };
        for name in names {
            let Some(ns) = estimate(folder, stage, name) else { continue };
            println!(
                "| {stage} | {name} | {flop:.0} | {memory:.0} | {:.2} | {:.1} % | {:.2} | {:.1} % |",
                flop / ns,
                100.0 * flop / ns / operations,
                memory / ns,
                100.0 * memory / ns / bytes
            );
        }
    }
}
