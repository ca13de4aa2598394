//! The distortion loss: given samples against the sum over all pairs, the whole training step against finite differences, and
//! what a change of units changes.

use super::{Bench, gradients::of_a_step};
use crate::{
    fixtures::{Draw, lively, small},
    reference::{Sample, distortion},
};
use trimip_core::{
    Backend, Config, Encoder, Field, Layout, Pixel, Result,
    backend::Loss,
    batch::{Deposit, Interval, Radiance, Ray, Samples, Segment, Sphere, Target},
    config::{Contraction, LossRays},
};

/// Values and gradients of order 0.1 to 1 of forty samples in f32.
const TOLERANCE: f64 = 2e-6;

/// Bounded and contracted spaces in which the distortion weighs more than the colour.
pub fn configurations() -> Vec<(&'static str, Config)> {
    let change = |name, change: &dyn Fn(&mut Config)| {
        let mut config = small();
        config.loss.distortion = 0.8;
        change(&mut config);
        (name, config)
    };
    vec![
        // One, one and nine cones at the three scales.
        change("distortion of cones by scale", &|c| {
            (c.renderer.cones, c.renderer.cone_width) = (3, 0.3);
        }),
        change("mostly distortion, all rays, a box with three sides", &|c| {
            (c.loss.distortion, c.loss.rays) = (20.0, LossRays::All);
            (c.scene.aabb_min, c.scene.aabb_max) = ([-1.0, -1.5, -0.5], [2.0, 1.5, 0.75]);
        }),
        change("distortion in contracted space", &|c| {
            (c.scene.contraction, c.renderer.min_transmittance) = (Contraction::Ball, 0.0);
        }),
    ]
}

/// Loss and gradients of a training step against central differences of the reference.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn finite_differences<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    configurations().iter().try_for_each(|(name, config)| of_a_step(&make, name, config))
}

/// Pixels with their cones and given samples.
struct Given {
    rays: Vec<Ray>,
    groups: Vec<Segment>,
    targets: Vec<Target>,
    segments: Vec<Segment>,
    intervals: Vec<Interval>,
    densities: Vec<f32>,
}

/// Cones without samples, with one, and with up to forty of all densities, near and far away.
fn given(seed: u64) -> Given {
    let mut draw = Draw::new(seed);
    let mut all = Given {
        rays: vec![],
        groups: vec![],
        targets: vec![],
        segments: vec![],
        intervals: vec![],
        densities: vec![],
    };
    for cones in [[0].as_slice(), &[1], &[40], &[17, 0, 5, 30], &[2, 1], &[33], &[0, 0]] {
        let group = Segment { start: all.rays.len() as u32, count: cones.len() as u32 };
        all.groups.push(group);
        all.targets.push(Target { weight: draw.between(0.5, 16.0) as f32, ..Target::default() });
        for &count in cones {
            let origin = [0; 3].map(|_| draw.between(-1.0, 1.0) as f32);
            let direction = draw.direction().to_array().map(|x| x as f32);
            all.rays.push(Ray { origin, direction, slope: 0.01, cosine: 1.0, ..Ray::default() });
            all.segments.push(Segment { start: all.intervals.len() as u32, count });
            let mut t = draw.between(0.0, 1.0);
            for i in 0..count {
                let density = if i == 30 { 1e6 } else { draw.between(-20.0, 1.5).exp() as f32 };
                all.densities.push(density);
                let length = draw.between(0.01, 0.1);
                t += length * draw.between(0.5, 2.0);
                all.intervals.push(Interval { t: t as f32, length: length as f32 });
            }
        }
    }
    all
}

/// What `distort` adds to the loss, and to gradients of the densities that are 1 before.
fn distorted<B: Backend>(bench: &mut Bench<B>, given: &Given) -> Result<(f64, Vec<f64>)> {
    let Bench { backend, stages, space, .. } = bench;
    let total = given.intervals.len();
    backend.write(&mut space.rays.rays, &given.rays);
    backend.write(&mut space.rays.groups, &given.groups);
    backend.write(&mut space.rays.targets, &given.targets);
    let Samples { segments, rays, intervals, spheres, counts } = &mut space.samples;
    backend.write(segments, &given.segments);
    backend.write(rays, &vec![0; total]);
    backend.write(intervals, &given.intervals);
    backend.write(spheres, &vec![Sphere::default(); total]);
    backend.write(counts, &[[total as u32; 2], [0; 2]]);
    let radiance: Vec<_> = given.densities.iter().map(|&d| Radiance { rgb: [0.3; 3], density: d }).collect();
    backend.write(&mut space.radiance, &radiance);
    // Pixels of the colour that they should have: the other losses are 0.
    backend.write(&mut space.pixels, &vec![Pixel::default(); given.groups.len()]);
    let one = Radiance { rgb: [0.5; 3], density: 1.0 };
    backend.write(&mut space.radiance_gradients, &vec![one; total]);
    let mut deposit = Deposit::<B> {
        field: stages.field.gradient(),
        encoder: stages.encoder.gradient(),
        sums: B::Sums::default(),
    };
    let (lane, sums) = (&mut space.lane, &mut deposit.sums);
    let (rays, samples) = (&space.rays, &space.samples);
    stages.loss.evaluate(lane, rays, samples, &space.pixels, &mut space.pixel_gradients, sums);
    let gradients = &mut space.radiance_gradients;
    stages.loss.distort(lane, rays, samples, &space.radiance, gradients, sums);
    let sums = backend.redeem(backend.post(&[deposit]))?;
    assert_eq!(
        (sums.sums.squared_error, sums.sums.non_finite),
        (0.0, 0),
        "the error of colours is untouched"
    );
    let gradients = backend.read(gradients);
    assert!(gradients.iter().all(|own| own.rgb == [0.5; 3]), "colours have no part in it");
    Ok((sums.sums.loss, gradients.iter().take(total).map(|own| f64::from(own.density) - 1.0).collect()))
}

fn bench<B: Backend>(make: impl Fn() -> B, config: &Config) -> Result<Bench<B>> {
    Bench::new(make(), config, None, &lively(&Layout::new(config), 3))
}

/// Bounded and contracted space, in a box or a ball around the origin whose size is `scale` times the usual one.
fn spaces(scale: f32, weight: f32) -> [Config; 2] {
    [Contraction::None, Contraction::Ball].map(|contraction| {
        let mut config = small();
        (config.scene.contraction, config.loss.distortion) = (contraction, weight);
        (config.scene.aabb_min, config.scene.aabb_max) = ([-1.5 * scale; 3], [1.5 * scale; 3]);
        config
    })
}

/// The loss of given samples is the mean over a pixel's cones of the sum over all pairs, times the pixel's weight; gradients are
/// its central differences.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn as_written<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for (seed, config) in (31..).zip(spaces(1.0, 0.7)) {
        let given = given(seed);
        let (loss, gradients) = distorted(&mut bench(&make, &config)?, &given)?;
        let mut expected = 0.0;
        for (group, target) in given.groups.iter().zip(&given.targets) {
            let share = 0.7_f32 as f64 * f64::from(target.weight) / f64::from(group.count);
            for (ray, segment) in given.rays[group.range()].iter().zip(&given.segments[group.range()]) {
                let own = segment.range();
                let sample = |i: &Interval| Sample::new(ray, i, &Sphere::default());
                let place = |i: &Interval| distortion::along(&config, ray, &sample(i));
                let places: Vec<_> = given.intervals[own.clone()].iter().map(place).collect();
                let optical = |i: usize| f64::from(given.densities[i]) * f64::from(given.intervals[i].length);
                let depths: Vec<_> = own.clone().map(optical).collect();
                let cone = distortion::distortion(&depths, &places);
                expected += share * cone;
                if let ([depth], [[_, width]]) = (depths.as_slice(), places.as_slice()) {
                    let w = 1.0 - (-depth).exp();
                    assert!(
                        (cone - w * w * width / 3.0).abs() < 1e-15,
                        "a single sample has its width alone"
                    );
                }
                for (k, i) in own.enumerate() {
                    let h = 1e-5;
                    let at = |by: f64| {
                        let mut depths = depths.clone();
                        depths[k] += by;
                        distortion::distortion(&depths, &places)
                    };
                    let by_density =
                        share * (at(h) - at(-h)) / (2.0 * h) * f64::from(given.intervals[i].length);
                    assert!(
                        (gradients[i] - by_density).abs() < TOLERANCE * share.max(1.0),
                        "{ray:?}: sample {k}: {}, not {by_density}",
                        gradients[i]
                    );
                }
            }
        }
        assert!((loss - expected).abs() < TOLERANCE * expected, "{loss}, not {expected}");
    }
    Ok(())
}

/// Eight times the world with an eighth of the density is the same loss. Without a weight there is none.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn in_other_units<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let scale = 8.0;
    let near = given(5);
    let mut far = given(5);
    far.rays.iter_mut().for_each(|ray| ray.origin = ray.origin.map(|x| scale * x));
    far.densities.iter_mut().for_each(|density| *density /= scale);
    for interval in &mut far.intervals {
        *interval = Interval { t: scale * interval.t, length: scale * interval.length };
    }
    for (small, large) in spaces(1.0, 0.7).iter().zip(&spaces(scale, 0.7)) {
        let (loss, gradients) = distorted(&mut bench(&make, small)?, &near)?;
        let (same, others) = distorted(&mut bench(&make, large)?, &far)?;
        assert!(loss > 0.1 && (loss - same).abs() < TOLERANCE * loss, "{same}, not {loss}");
        for (a, b) in gradients.iter().zip(&others) {
            assert!((f64::from(scale) * a - b).abs() < 1e-5 * a.abs().max(1.0), "{b}, not eight times {a}");
        }
    }
    for config in spaces(1.0, 0.0) {
        let (loss, gradients) = distorted(&mut bench(&make, &config)?, &near)?;
        assert!(loss == 0.0 && gradients.iter().all(|&g| g == 0.0), "no weight, no loss");
    }
    Ok(())
}
