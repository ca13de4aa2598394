//! Error of each stage relative to f64, on a model's own samples. The input of each stage is the f32 output of the previous one, so that
//! each row has only the stage's own rounding. Errors are in units in the last place (ulp) of the f64 result rounded to f32, and relative
//! to the largest value of the stage.

use serde::Serialize;
use std::time::Instant;
use trimip::backends::{self, Visitor};
use trimip_core::config::Precision;
use trimip_core::engine::batch::{Interval, Radiance, Ray, Samples, Segment, Sphere, Tile, Workspace};
use trimip_core::field::encoders::{self, SamplePosition};
use trimip_core::field::exact::Exact;
use trimip_core::field::model::Model;
use trimip_core::{
    Backend, Camera, Encoder, Field, Layout, Renderer, Result, Space, engine::backend::Occupancy,
};

/// Number of rays along each side of the picture, over which the rays are spread.
const SIDE: u32 = 16;

/// A stage and its errors.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageError {
    /// Name of the stage.
    pub stage: &'static str,
    /// `f32`, `bf16` or `f16`.
    pub precision: &'static str,
    /// Number of values compared.
    pub values: usize,
    /// Median error in units in the last place.
    pub median_ulp: f64,
    /// 99th percentile of the error in units in the last place.
    pub high_ulp: f64,
    /// Largest error divided by the largest value.
    pub relative: f64,
    /// Time of the stage for these samples in milliseconds, including the read-back from the device.
    pub milliseconds: f64,
}

/// Measures the errors of a model's stages, in every precision that its backend supports.
///
/// # Errors
/// When the model does not fit its backend.
pub fn measure(model: &Model, camera: &Camera) -> Result<Vec<StageError>> {
    let mut rows = Vec::new();
    for (precision, name) in [(Precision::F32, "f32"), (Precision::Bf16, "bf16"), (Precision::F16, "f16")] {
        let mut other = model.clone();
        other.config.field.precision = precision;
        if backends::load(&other)?.notes().is_empty() {
            let work = OnBackend { model: &other, camera, precision: name };
            let found = backends::visit_configured(&other.config, work)?;
            // Only stages with layers are measured again in other precisions.
            rows.extend(found.into_iter().filter(|row| precision == Precision::F32 || layered(row.stage)));
        }
    }
    Ok(rows)
}

fn layered(stage: &str) -> bool {
    ["density", "colour"].contains(&stage)
}

/// Measures the errors of a model's stages on one backend.
struct OnBackend<'a> {
    model: &'a Model,
    camera: &'a Camera,
    precision: &'static str,
}

impl Visitor for OnBackend<'_> {
    type Output = Vec<StageError>;

    fn visit<B: Backend>(self, open: &dyn Fn() -> Result<B>) -> Result<Vec<StageError>> {
        on(&open()?, self.model, self.camera, self.precision)
    }
}

/// Measures the errors of a model's stages on a backend.
fn on<B: Backend>(
    backend: &B,
    model: &Model,
    camera: &Camera,
    precision: &'static str,
) -> Result<Vec<StageError>> {
    let exact = Exact::new(model)?;
    let (config, centre) = model.config.centred();
    let layout = Layout::new(&config);
    let mut stages = backend.stages(&config, None)?;
    let mut parameters = backend.zeros(layout.len());
    backend.write(&mut parameters, &layout.from_tensors(&model.file, "model", "")?);
    let bits = (config.occupancy.resolution as usize).pow(3).div_ceil(8);
    stages.occupancy.restore(model.file.u8("model", "occupancy", &[bits])?, None);
    backend.install(|| {
        stages.encoder.refresh(&parameters);
        stages.field.refresh(&parameters);
    });
    stages.renderer.set_progress(1.0);
    let k = camera.intrinsics;
    let camera = Camera { origin: camera.origin - centre, ..*camera };
    let rays: Vec<Ray> = (0..SIDE * SIDE)
        .map(|i| Ray::from(camera.cone::<f32>(i % SIDE * k.width / SIDE, i / SIDE * k.height / SIDE)))
        .collect();

    let mut workspace = Workspace::new(backend, &stages.field);
    workspace.rays.place(backend, &rays);
    let wait = || drop(backend.read(&backend.zeros::<u32>(1)));
    let Workspace {
        stream,
        rays: own,
        samples,
        encoder_context,
        features,
        field_context,
        radiance,
        cones,
        pixels,
        ..
    } = &mut workspace;
    let marching = timed(backend, || {
        stages.renderer.march(stream, own, &stages.occupancy, None, samples);
        wait();
    });
    let segments: Vec<Segment> = backend.read(&samples.segments);
    let count = segments.iter().map(|segment| segment.count as usize).sum::<usize>();
    let intervals: Vec<Interval> = backend.read(&samples.intervals)[..count].to_vec();
    let spheres: Vec<Sphere> = backend.read(&samples.spheres)[..count].to_vec();
    let owners: Vec<u32> = backend.read(&samples.rays)[..count].to_vec();
    place(backend, samples, &segments, &intervals, &spheres, &owners);
    let tile = &mut Tile { stream, parameters: &parameters, rays: own, samples };
    let encoder_context = timed(backend, || {
        stages.encoder.forward(tile, encoder_context, features);
        wait();
    });
    let density = timed(backend, || {
        stages.field.density(tile, features, field_context, radiance);
        wait();
    });
    let color = timed(backend, || {
        stages.field.color(tile, stages.renderer.color_weight(), field_context, radiance);
        wait();
    });
    let composing = timed(backend, || {
        stages.renderer.composite(tile, radiance, cones, pixels);
        wait();
    });
    let features = backend.read(features);
    let radiance: Vec<Radiance> = backend.read(radiance)[..count].to_vec();
    let pixels = backend.read(pixels);
    backend.health()?;

    let space = Space::<f64>::new(&config.scene);
    let (stride, width) = (encoders::stride(&config), encoders::of(&config).width(&config));
    let mut errors: [Vec<(f64, f64)>; 5] = Default::default();
    for (i, sphere) in spheres.iter().enumerate() {
        let (ray, t) = (&rays[owners[i] as usize], f64::from(intervals[i].t));
        let on_ray = |axis: usize| f64::from(ray.origin[axis]) + t * f64::from(ray.direction[axis]);
        let expected = space.to_cube([0, 1, 2].map(on_ray));
        errors[0].extend(sphere.position.map(f64::from).into_iter().zip(expected));
        let own = &features[stride * i..][..width];
        let expected = exact.features(&SamplePosition::new(ray, &intervals[i], sphere));
        errors[1].extend(own.iter().map(|&x| f64::from(x)).zip(expected));
        let own: Vec<f64> = own.iter().map(|&x| x.into()).collect();
        let (density, rgb) = exact.radiance(&own, ray.direction.map(f64::from));
        errors[2].push((radiance[i].density.into(), density));
        errors[3].extend(radiance[i].rgb.map(f64::from).into_iter().zip(rgb));
    }
    for (pixel, segment) in pixels.iter().zip(&segments) {
        let range = segment.start as usize..(segment.start + segment.count) as usize;
        let expected = composite(&intervals[range.clone()], &radiance[range], config.data.background);
        errors[4].extend(pixel.rgb.map(f64::from).into_iter().zip(expected));
    }
    let names = ["march", "encode", "density", "colour", "composite"];
    let times = [marching, encoder_context, density, color, composing];
    let rows = names.into_iter().zip(times).zip(&errors);
    Ok(rows.map(|((stage, time), errors)| row(stage, precision, time, errors)).collect())
}

/// Returns the time of a stage after one warm-up run, milliseconds.
fn timed<B: Backend>(backend: &B, mut work: impl FnMut() + Send) -> f64 {
    backend.install(&mut work);
    let started = Instant::now();
    backend.install(&mut work);
    1e3 * started.elapsed().as_secs_f64()
}

/// Uploads samples and marks all of them as kept.
fn place<B: Backend>(
    backend: &B,
    samples: &mut Samples<B>,
    segments: &[Segment],
    intervals: &[Interval],
    spheres: &[Sphere],
    owners: &[u32],
) {
    let count = spheres.len() as u32;
    backend.write(&mut samples.segments, segments);
    backend.write(&mut samples.intervals, intervals);
    backend.write(&mut samples.spheres, spheres);
    backend.write(&mut samples.rays, owners);
    backend.write(&mut samples.counts, &[[count, count]]);
}

/// Composites C = Σ T·α·c + T·background in f64.
fn composite(intervals: &[Interval], radiance: &[Radiance], background: [f32; 3]) -> [f64; 3] {
    let (mut rgb, mut depth) = ([0.0; 3], 0.0_f64);
    for (interval, sample) in intervals.iter().zip(radiance) {
        let own = f64::from(sample.density) * f64::from(interval.length);
        let weight = (-depth).exp() * -(-own).exp_m1();
        (0..3).for_each(|c| rgb[c] += weight * f64::from(sample.rgb[c]));
        depth += own;
    }
    std::array::from_fn(|c| rgb[c] + (-depth).exp() * f64::from(background[c]))
}

/// Returns the distance from a value to the next larger f32.
fn ulp(value: f64) -> f64 {
    let near = (value.abs() as f32).max(f32::MIN_POSITIVE);
    f64::from(near.next_up()) - f64::from(near)
}

/// Summarises the errors of a stage; `pairs` are the found and the expected values.
fn row(stage: &'static str, precision: &'static str, milliseconds: f64, pairs: &[(f64, f64)]) -> StageError {
    let mut ulps: Vec<f64> = pairs.iter().map(|(found, x)| (found - x).abs() / ulp(*x)).collect();
    ulps.sort_by(f64::total_cmp);
    let at = |fraction: f64| {
        ulps.get((fraction * (ulps.len().max(1) - 1) as f64) as usize).copied().unwrap_or(0.0)
    };
    let largest = pairs.iter().map(|(_, x)| x.abs()).fold(f64::MIN_POSITIVE, f64::max);
    let worst = pairs.iter().map(|(found, x)| (found - x).abs()).fold(0.0, f64::max);
    StageError {
        stage,
        precision,
        values: pairs.len(),
        median_ulp: at(0.5),
        high_ulp: at(0.99),
        relative: worst / largest,
        milliseconds,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_in_the_last_place_are_those_of_f32() {
        assert_eq!(ulp(1.0), f64::from(f32::EPSILON));
        assert_eq!(ulp(-3.0), 2.0 * f64::from(f32::EPSILON));
        let found = row("x", "f32", 0.0, &[(1.0 + 3.0 * f64::from(f32::EPSILON), 1.0); 10]);
        assert_eq!((found.median_ulp, found.high_ulp), (3.0, 3.0));
        assert!((found.relative - 3.0 * f64::from(f32::EPSILON)).abs() < 1e-12);
    }

    #[test]
    fn the_stages_of_a_fresh_model_round_as_f32_does() {
        let mut config = trimip_core::Config::default();
        (config.encoder.plane_size, config.encoder.levels) = (32, 4);
        (config.field.hidden, config.occupancy.resolution) = (16, 16);
        config.encoder.init_range = 1.0;
        let layout = Layout::new(&config);
        let mut file = trimip_core::field::tensors::TensorFile::default();
        layout.to_tensors(&layout.initial(&config), "", &mut file);
        let bits = trimip_core::field::tensors::Tensor::u8(&[512], vec![0xff; 512]);
        file.tensors.insert("occupancy".into(), bits);
        let model = Model::new(config, file);
        let k = trimip_core::Intrinsics::from_angle(32, 32, 0.7);
        let camera = Camera::look_at(k, glam::DVec3::new(3.0, 2.0, 1.0), glam::DVec3::ZERO, glam::DVec3::Z);
        let rows = measure(&model, &camera).unwrap();
        let of = |stage: &str| rows.iter().find(|r| r.stage == stage && r.precision == "f32").unwrap();
        for stage in ["march", "encode", "density", "colour", "composite"] {
            let row = of(stage);
            assert!(row.values > 500 && row.relative < 1e-5 && row.relative > 0.0, "{row:?}");
        }
        assert!(of("march").median_ulp < 8.0 && of("composite").median_ulp < 8.0, "{rows:?}");
    }
}
