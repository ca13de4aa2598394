//! Each stage matches the reference: features, density and colour, compositing, whole pixels.

use super::{Bench, wide};
use crate::{
    fixtures::{TestRandom, every_variant, lively, noise, small},
    reference::{Composited, Reference, Sample, composite, kept, march},
};
use glam::DVec3;
use trimip_core::{
    Backend, Camera, Config, Field, Intrinsics, Layout, Pixel, Renderer, Result, Viewer,
    config::{LevelFormula, PlaneShape},
    engine::{
        batch::{Interval, Radiance, Ray, Samples, Segment, Sphere, Tile},
        trainer::Trainer,
    },
    field::encoders,
};

/// Tolerance of features, for texels in ±1 on planes up to 64 texels wide. A coordinate in texels is rounded to
/// 64·2⁻²⁴ = 4e-6, and a texel differs from its neighbour by up to 2, on both axes; blending the levels doubles the
/// error.
const FEATURE_TOLERANCE: f64 = 4e-5;

/// Tolerance of colours and densities, absolute and relative: a logit of order 5 is the sum of 16 to 48 products in
/// f32.
const FIELD_TOLERANCE: f64 = 2e-5;

/// Tolerance of compositing without the other stages, relative to values of order 1: forty additions in f32.
const COMPOSITE_TOLERANCE: f64 = 1e-5;

/// Tolerance of a whole pixel: feature errors, amplified by the networks' slope of about 10, over some twenty samples.
const PIXEL_TOLERANCE: f64 = 5e-4;

/// If ln T of a sample is this close to the limit, either pruning decision is correct. The margin covers the error of
/// the densities.
const PRUNING_MARGIN: f64 = 1e-3;

fn configurations() -> Vec<Config> {
    let mut code = small();
    code.encoder.level = LevelFormula::Code;
    (code.encoder.plane_size, code.encoder.levels) = (64, 7);
    (code.field.hidden, code.field.density_layers, code.field.color_layers) = (48, 2, 4);
    // The box has three different sides, so each plane has its own base radius.
    (code.scene.aabb_min, code.scene.aabb_max) = ([-1.0, -1.5, -0.5], [2.0, 1.5, 0.75]);
    let mut flat = small();
    flat.encoder.mipmap = false;
    flat.field.directions = false;
    // The same box with square texels: 64, 64 and 32 along its axes.
    let mut fitted = small();
    (fitted.encoder.plane_size, fitted.encoder.levels) = (64, 4);
    fitted.encoder.shape = PlaneShape::Box;
    fitted.scene = code.scene.clone();
    let mut deferred = small();
    deferred.field.deferred = true;
    [vec![code, flat, fitted, deferred], every_variant()].concat()
}

/// Returns spheres all over the box and on its border, with radii from zero to far beyond the coarsest level.
pub fn spheres(seed: u64, count: usize) -> Vec<Sphere> {
    let mut random = TestRandom::new(seed);
    let radii = [0.0, 1e-30, 1e-3, 0.05, 0.2, 0.8, 3.0, 1e4, f32::INFINITY];
    (0..count)
        .map(|i| {
            let mut coordinate = || match random.below(8) {
                0 => 0.0,
                1 => 1.0,
                2 => 1.0 - f32::EPSILON,
                _ => random.between(0.0, 1.0) as f32,
            };
            let position = [coordinate(), coordinate(), coordinate()];
            let radius = radii.get(i % 16).map_or_else(|| random.between(-7.0, 1.0).exp2() as f32, |&r| r);
            Sphere { position, radius }
        })
        .collect()
}

fn close(found: f64, expected: f64, tolerance: f64) -> bool {
    (found - expected).abs() <= tolerance * expected.abs().max(1.0)
}

/// Returns rays in random directions, and `count` intervals from length 0 to far longer than a texel.
fn lines(seed: u64, rays: usize, count: usize) -> (Vec<Ray>, Vec<Interval>) {
    let mut random = TestRandom::new(seed);
    let ray = |direction: DVec3| Ray { direction: direction.to_array().map(|x| x as f32), ..Ray::default() };
    let rays = (0..rays).map(|_| ray(random.direction())).collect();
    let interval = |random: &mut TestRandom| {
        let t = random.between(0.1, 5.0);
        // No interval begins behind its camera.
        let length = [0.0, random.between(-10.0, 0.0).exp2().min(t), 2.0 * t][random.below(3)];
        Interval { t: t as f32, length: length as f32 }
    };
    (rays, (0..count).map(|_| interval(&mut random)).collect())
}

/// Features, densities and colours of random samples match the reference.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn field<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for config in configurations() {
        let layout = Layout::new(&config);
        let parameters = lively(&layout, 3);
        let reference = Reference::new(&config, &layout, &wide(&parameters));
        let mut bench = Bench::new(make(), &config, None, &parameters)?;
        // 37 is not a multiple of any tile size.
        let spheres = spheres(5, 37 * 5);
        let (rays, intervals) = lines(6, 5, spheres.len());
        bench.place_on(&rays, &intervals, &spheres);
        let features = bench.features();
        // Rows are padded to whole registers or tiles.
        let width = encoders::of(&config).width(&config);
        let stride = width.next_multiple_of(16);
        for (i, sphere) in spheres.iter().enumerate() {
            let expected = reference.features(&Sample::new(&rays[i / 37], &intervals[i], sphere));
            for (k, expected) in expected.into_iter().enumerate() {
                let found = f64::from(features[stride * i + k]);
                assert!(
                    close(found, expected, FEATURE_TOLERANCE),
                    "{:?}, {sphere:?}, {:?}, {:?}, feature {k}: {found}, not {expected}",
                    config.encoder.kind,
                    intervals[i],
                    rays[i / 37]
                );
            }
        }

        let Bench { backend, stages, workspace, parameters } = &mut bench;
        let (stream, samples, field_context) =
            (&mut workspace.stream, &workspace.samples, &mut workspace.field_context);
        let tile = &mut Tile { stream, parameters, rays: &workspace.rays, samples };
        stages.field.density(tile, &workspace.features, field_context, &mut workspace.radiance);
        stages.field.color(tile, 0.0, field_context, &mut workspace.radiance);
        let radiance = backend.read(&workspace.radiance);
        let geometry: Vec<_> = features
            .chunks_exact(stride)
            .take(spheres.len())
            .map(|row| reference.geometry(&wide(&row[..width])))
            .collect();
        let of_rays: Vec<_> = rays
            .iter()
            .enumerate()
            .map(|(ray, on)| {
                let own = 37 * ray..37 * (ray + 1);
                let samples = own.clone().map(|i| Sample::new(on, &intervals[i], &spheres[i]));
                let samples: Vec<_> = samples.collect();
                reference.deferred(&samples, &geometry[own], on.direction.map(f64::from))[0].1
            })
            .collect();
        for (i, found) in radiance.iter().enumerate().take(spheres.len()) {
            let density = reference.density(&geometry[i]);
            assert!(
                f64::from(found.density) == density
                    || close(f64::from(found.density) / density, 1.0, FIELD_TOLERANCE),
                "sample {i}: density {}, not {density}",
                found.density
            );
            let rgb = match config.field.deferred {
                true => of_rays[i / 37],
                false => reference.color(&geometry[i], rays[i / 37].direction.map(f64::from)),
            };
            for (found, expected) in found.rgb.into_iter().zip(rgb) {
                assert!(
                    close(found.into(), expected, FIELD_TOLERANCE),
                    "sample {i}: {found}, not {expected}"
                );
            }
        }
    }
    Ok(())
}

/// Compositing matches the reference for given samples: none, thin ones, an opaque one in the middle, forty of all
/// kinds.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn compositing<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let config = small();
    let layout = Layout::new(&config);
    let mut bench = Bench::new(make(), &config, None, &lively(&layout, 3))?;
    let Bench { backend, stages, workspace, parameters } = &mut bench;
    let mut random = TestRandom::new(11);
    let counts = [0_u32, 1, 40, 3, 0, 17];
    let (mut segments, mut intervals, mut radiance, mut owners) = (vec![], vec![], vec![], vec![]);
    for (ray, &count) in counts.iter().enumerate() {
        segments.push(Segment { start: intervals.len() as u32, count });
        for i in 0..count {
            let density = if (ray, i) == (3, 1) { 1e6 } else { random.between(-20.0, 3.0).exp() as f32 };
            let rgb = [0; 3].map(|_| random.between(0.0, 1.0) as f32);
            radiance.push(Radiance { rgb, density });
            intervals.push(Interval { t: 2.0 + 0.1 * i as f32, length: random.between(0.05, 0.15) as f32 });
            owners.push(ray as u32);
        }
    }
    let rays = [Ray { cosine: 0.8, ..Ray::default() }; 6];
    let total = intervals.len() as u32;
    workspace.rays.place(backend, &rays);
    let Samples { segments: s, rays: r, intervals: v, spheres, counts: c } = &mut workspace.samples;
    backend.write(s, &segments);
    backend.write(r, &owners);
    backend.write(v, &intervals);
    backend.write(spheres, &vec![Sphere::default(); total as usize]);
    backend.write(c, &[[total, total]]);
    backend.write(&mut workspace.radiance, &radiance);
    let (stream, samples, pixels) = (&mut workspace.stream, &workspace.samples, &mut workspace.pixels);
    let tile = &mut Tile { stream, parameters, rays: &workspace.rays, samples };
    stages.renderer.composite(tile, &workspace.radiance, &mut workspace.cones, pixels);
    for (pixel, segment) in backend.read(pixels).iter().zip(&segments) {
        let range = segment.start as usize..(segment.start + segment.count) as usize;
        let sample = |interval: &Interval| Sample {
            t: interval.t.into(),
            length: interval.length.into(),
            ..Sample::default()
        };
        let samples: Vec<_> = intervals[range.clone()].iter().map(sample).collect();
        let radiance: Vec<_> =
            radiance[range].iter().map(|r| (r.density.into(), r.rgb.map(f64::from))).collect();
        let background = config.data.background.map(f64::from);
        let expected = composite(&samples, &radiance, background, f64::from(rays[0].cosine));
        assert_pixel(pixel, &expected, COMPOSITE_TOLERANCE, "given samples");
    }
    Ok(())
}

fn assert_pixel(found: &Pixel, expected: &Composited, tolerance: f64, place: &str) {
    let values = [found.rgb[0], found.rgb[1], found.rgb[2], found.opacity, found.depth];
    let [r, g, b] = expected.rgb;
    for (found, expected) in values.into_iter().zip([r, g, b, expected.opacity, expected.depth]) {
        assert!(close(found.into(), expected, tolerance), "{place}: {found}, not {expected}");
    }
}

/// Whole pixels of a camera match the reference, with and without pruning.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn pixels<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let mut pruned = 0;
    for mut config in configurations() {
        for min_transmittance in [0.0, 1e-4, 0.3] {
            config.renderer.min_transmittance = min_transmittance;
            let mut trainer = Trainer::new(make(), &config, noise(1, 8, 1, 1))?;
            let layout = Layout::new(&config);
            let parameters = lively(&layout, 9);
            trainer.set_parameters(&parameters);
            trainer.occupy_all();
            let reference = Reference::new(&config, &layout, &wide(&parameters));
            let intrinsics = Intrinsics {
                width: 7,
                height: 6,
                fx: 6.0,
                fy: 5.5,
                cx: 3.3,
                cy: 3.1,
                ..Intrinsics::default()
            };
            let camera = Camera::look_at(intrinsics, DVec3::new(2.0, -3.0, 1.5), DVec3::ZERO, DVec3::Z);
            let frame = trainer.render(&camera)?;
            assert_eq!((frame.width, frame.height), (7, 6));
            for (i, pixel) in frame.pixels.iter().enumerate() {
                let ray = Ray::from(camera.cone::<f32>(i as u32 % 7, i as u32 / 7));
                let samples = march(&config, &ray, 0.0, |_| true);
                let (count, margin) = kept(&config, &samples, &reference.densities(&samples));
                pruned += samples.len() - count;
                let expected = reference.pixel(&ray, &samples[..count]);
                // Keeping or dropping a sample at the limit changes the pixel by the transmittance behind the sample
                // times the sample's distance.
                let edge = if margin < PRUNING_MARGIN { 8.0 * f64::from(min_transmittance) } else { 0.0 };
                assert_pixel(pixel, &expected, PIXEL_TOLERANCE + edge, &format!("pixel {i}"));
            }
        }
    }
    assert!(pruned > 0, "some samples are pruned");
    Ok(())
}
