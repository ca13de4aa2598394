//! Tests of every registered term of the loss: given pixels and samples match the terms' equations, a whole training step matches
//! finite differences, and an interrupted run equals an uninterrupted one. The configurations are the terms' own examples.

use super::{Bench, gradients::of_a_step, training};
use crate::{
    fixtures::{TestRandom, lively},
    reference::{Sample, loss},
};
use trimip_core::{
    Backend, Config, Encoder, Field, Layout, Pixel, Result,
    config::{Contraction, LossRays},
    engine::{
        backend::{Loss, RenderedTile},
        batch::{Interval, PartialGradients, Radiance, Ray, Samples, Segment, Sphere, StepResult, Target},
    },
    field::losses::{self, RaySample},
};

/// Tolerance for values and gradients of order 0.1 to 1, over forty samples in f32.
pub const TOLERANCE: f64 = 2e-6;

/// Tolerance for gradients of pixels of order 1 in f32, and for losses relative to their size.
const PIXEL_TOLERANCE: f64 = 2e-5;

/// Half width of a central difference.
const STEP: f64 = 1e-5;

/// Number of pixels: more than one workgroup of a device.
const PIXELS: usize = 150;

/// Number of pixels whose samples are differentiated; few, because a sum over all pairs of samples is slow.
const DIFFERENTIATED: usize = 14;

/// Exposure gains of three photographs.
const GAINS: [[f32; 3]; 3] = [[1.3, 0.7, 1.0], [0.4, 2.5, 1.1], [0.9, 1.6, 0.6]];

/// Returns the examples of all registered terms, applied to the configuration `base`.
pub fn examples(base: &Config) -> Vec<(&'static str, Config)> {
    let example = |term: &&dyn losses::Definition| {
        let mut config = base.clone();
        term.example(&mut config);
        (term.name(), config)
    };
    losses::all().iter().map(example).collect()
}

/// Given pixels with their photographs, cones and samples.
#[derive(Clone)]
pub struct Given {
    /// Ray of each cone.
    pub rays: Vec<Ray>,
    /// Range of the cones of each pixel.
    pub groups: Vec<Segment>,
    /// Target of each pixel.
    pub targets: Vec<Target>,
    /// Rendered channels of each pixel.
    pub pixels: Vec<Pixel>,
    /// Index of each pixel's photograph.
    pub photographs: Vec<u32>,
    /// Range of the samples of each cone.
    pub segments: Vec<Segment>,
    /// Interval of each sample.
    pub intervals: Vec<Interval>,
    /// Density of each sample.
    pub densities: Vec<f32>,
}

/// Results of a backend for given pixels and samples.
pub struct Found {
    /// Sums over the pixels, and derivatives with respect to log-gains.
    pub result: StepResult,
    /// Gradient with respect to the channels of each pixel.
    pub by_pixel: Vec<[f32; 4]>,
    /// Gradient with respect to each density.
    pub by_density: Vec<f64>,
}

impl Given {
    /// Creates pixels of random colours, whose cones have no samples, one, or up to forty. Samples are near and far away, and
    /// their densities range from almost 0 to opaque.
    pub fn new(seed: u64) -> Self {
        let mut random = TestRandom::new(seed);
        let mut all = Self {
            rays: vec![],
            groups: vec![],
            targets: vec![],
            pixels: vec![],
            photographs: vec![],
            segments: vec![],
            intervals: vec![],
            densities: vec![],
        };
        let kinds: [&[u32]; 7] = [&[0], &[1], &[40], &[17, 0, 5, 30], &[2, 1], &[33], &[0, 0]];
        for cones in kinds.into_iter().cycle().take(PIXELS) {
            let group = Segment { start: all.rays.len() as u32, count: cones.len() as u32 };
            all.groups.push(group);
            all.draw_pixel(&mut random);
            for &count in cones {
                all.draw_cone(count, &mut random);
            }
        }
        all
    }

    fn draw_pixel(&mut self, random: &mut TestRandom) {
        let mut some = || random.between(0.05, 0.95) as f32;
        let [pixel, rgb, background] = [0; 3].map(|_| [some(), some(), some()]);
        let (opacity, own) = (some(), some());
        self.pixels.push(Pixel { rgb: pixel, opacity, depth: 0.0 });
        let weight = [0.0, 1.0, 4.0, random.between(0.5, 16.0) as f32][random.below(4)];
        let exponent = [0.0, 0.4][random.below(2)];
        // A third of the pixels have no known depth.
        let deviation = [0.0, 0.05, random.between(1e-3, 0.5) as f32][random.below(3)];
        let distance = random.between(0.0, 3.0) as f32;
        let importance = [1.0, random.between(0.2, 3.0) as f32][random.below(2)];
        self.targets.push(Target {
            rgb,
            weight,
            background,
            opacity: own,
            exponent,
            distance,
            deviation,
            importance,
        });
        self.photographs.push(random.below(GAINS.len()) as u32);
    }

    fn draw_cone(&mut self, count: u32, random: &mut TestRandom) {
        let origin = [0; 3].map(|_| random.between(-1.0, 1.0) as f32);
        let direction = random.direction().to_array().map(|x| x as f32);
        self.rays.push(Ray { origin, direction, slope: 0.01, cosine: 1.0, ..Ray::default() });
        self.segments.push(Segment { start: self.intervals.len() as u32, count });
        let mut t = random.between(0.0, 1.0);
        for i in 0..count {
            let density = if i == 30 { 1e6 } else { random.between(-20.0, 1.5).exp() as f32 };
            self.densities.push(density);
            let length = random.between(0.01, 0.1);
            t += length * random.between(0.5, 2.0);
            self.intervals.push(Interval { t: t as f32, length: length as f32 });
        }
    }

    /// Replaces pixels and targets with black ones, so that the loss of colours is 0.
    pub fn without_colours(mut self) -> Self {
        self.pixels.fill(Pixel::default());
        self.targets.iter_mut().for_each(|target| {
            *target = Target { weight: target.weight, importance: 1.0, ..Target::default() }
        });
        self
    }

    /// Evaluates all terms of a configuration, with the photographs' `gains` unless they are empty.
    ///
    /// # Errors
    /// When the backend refuses the configuration.
    pub fn evaluate<B: Backend>(&self, backend: B, config: &Config, gains: &[[f32; 3]]) -> Result<Found> {
        let mut bench = Bench::new(backend, config, None, &lively(&Layout::new(config), 3))?;
        self.place(&mut bench);
        let Bench { backend, stages, workspace, .. } = &mut bench;
        let total = self.intervals.len();
        let (field, encoder) = (stages.field.gradient(), stages.encoder.gradient());
        let mut partial = PartialGradients::<B> { field, encoder, sums: B::Sums::default() };
        if !gains.is_empty() {
            stages.loss.set_gains(gains);
        }
        // The second pass checks that earlier results are not added again.
        for _ in 0..2 {
            partial.sums = B::Sums::default();
            let one = Radiance { rgb: [0.5; 3], density: 1.0 };
            backend.write(&mut workspace.radiance_gradients, &vec![one; total]);
            let (rays, samples) = (&workspace.rays, &workspace.samples);
            let tile =
                RenderedTile { rays, samples, radiance: &workspace.radiance, pixels: &workspace.pixels };
            let (stream, sums) = (&mut workspace.stream, &mut partial.sums);
            stages.loss.evaluate_pixels(stream, &tile, &mut workspace.pixel_gradients, sums);
            stages.loss.evaluate_rays(stream, &tile, &mut workspace.radiance_gradients, sums);
        }
        let result = backend.redeem(backend.post(&[partial]))?;
        assert_eq!(result.sums.non_finite, 0);
        let gradients = backend.read(&workspace.radiance_gradients);
        assert!(gradients.iter().all(|own| own.rgb == [0.5; 3]), "terms of rays leave colours alone");
        let by_density = gradients.iter().take(total).map(|own| f64::from(own.density) - 1.0).collect();
        Ok(Found { result, by_pixel: backend.read(&workspace.pixel_gradients), by_density })
    }

    fn place<B: Backend>(&self, bench: &mut Bench<B>) {
        let Bench { backend, workspace, .. } = bench;
        let total = self.intervals.len();
        backend.write(&mut workspace.rays.rays, &self.rays);
        backend.write(&mut workspace.rays.groups, &self.groups);
        backend.write(&mut workspace.rays.targets, &self.targets);
        backend.write(&mut workspace.rays.photographs, &self.photographs);
        let Samples { segments, rays, intervals, spheres, counts } = &mut workspace.samples;
        backend.write(segments, &self.segments);
        backend.write(rays, &vec![0; total]);
        backend.write(intervals, &self.intervals);
        backend.write(spheres, &vec![Sphere::default(); total]);
        backend.write(counts, &[[total as u32; 2], [0; 2]]);
        let radiance = |&density: &f32| Radiance { rgb: [0.3; 3], density };
        backend.write(&mut workspace.radiance, &self.densities.iter().map(radiance).collect::<Vec<_>>());
        backend.write(&mut workspace.pixels, &self.pixels);
    }

    /// Returns true if a pixel contributes to the loss.
    fn counts(&self, config: &Config, pixel: usize) -> bool {
        let any = |segment: &Segment| segment.count > 0;
        config.loss.rays == LossRays::All || self.segments[self.groups[pixel].range()].iter().any(any)
    }

    /// Returns the samples of a pixel's cones, in the form that the ray terms of the loss read.
    fn cones(&self, config: &Config, pixel: usize) -> Vec<Vec<RaySample<f64>>> {
        let cone = |index: usize| {
            let (ray, own) = (&self.rays[index], self.segments[index].range());
            let sample = |i: usize| {
                let interval = &self.intervals[i];
                let depth = f64::from(self.densities[i]) * f64::from(interval.length);
                loss::ray_sample(config, ray, &Sample::new(ray, interval, &Sphere::default()), depth)
            };
            own.map(sample).collect()
        };
        self.groups[pixel].range().map(cone).collect()
    }

    /// Returns the weighted loss of a pixel, computed from the equations.
    fn of_pixel(&self, config: &Config, pixel: usize, channels: [f64; 4], log_gains: &[[f64; 3]]) -> f64 {
        let target = &self.targets[pixel];
        let gains = log_gains.get(self.photographs[pixel] as usize).map_or([1.0; 3], |e| e.map(f64::exp));
        match self.counts(config, pixel) {
            true => f64::from(target.weight) * loss::of_pixel(config, channels, target, gains),
            false => 0.0,
        }
    }
}

/// Loss, gradients, and derivatives with respect to log-gains match the terms' equations for given pixels and samples, in every
/// example.
///
/// # Errors
/// When the backend refuses a configuration.
pub fn as_written<B: Backend>(make: impl Fn() -> B, examples: &[(&'static str, Config)]) -> Result<()> {
    for (name, config) in examples {
        for (seed, contraction) in [(31, Contraction::None), (32, Contraction::Ball)] {
            let mut config = config.clone();
            config.scene.contraction = contraction;
            let place = format!("{name}, {contraction:?}");
            let adjusted = losses::ADJUSTMENTS.iter().any(|term| term.weight(&config.loss) > 0.0);
            let gains: &[_] = if adjusted { &GAINS } else { &[] };
            let given = Given::new(seed);
            let found = given.evaluate(make(), &config, gains)?;
            let log_gains: Vec<_> = gains.iter().map(|gain| gain.map(|gain| f64::from(gain).ln())).collect();
            let expected = assert_gradients(&given, &config, &found, &log_gains, &place);
            let loss = found.result.sums.loss;
            assert!((loss - expected).abs() < PIXEL_TOLERANCE * expected, "{place}: {loss}, not {expected}");
        }
    }
    Ok(())
}

/// Compares gradients with central differences of the equations; returns the loss.
fn assert_gradients(
    given: &Given,
    config: &Config,
    found: &Found,
    log_gains: &[[f64; 3]],
    place: &str,
) -> f64 {
    let channels = |pixel: usize| given.pixels[pixel].channels().map(f64::from);
    let mut total = 0.0;
    for pixel in 0..given.pixels.len() {
        total += given.of_pixel(config, pixel, channels(pixel), log_gains);
        total += assert_densities(given, config, found, pixel, place);
        let size = f64::from(given.targets[pixel].weight).max(1.0);
        for c in 0..4 {
            let at = |by: f64| {
                let mut channels = channels(pixel);
                channels[c] += by;
                given.of_pixel(config, pixel, channels, log_gains)
            };
            let (found, slope) = (f64::from(found.by_pixel[pixel][c]), (at(STEP) - at(-STEP)) / (2.0 * STEP));
            let error = (found - slope).abs();
            assert!(error < PIXEL_TOLERANCE * size, "{place}: pixel {pixel}, {c}: {found}, not {slope}");
        }
    }
    assert_eq!(found.result.exposures.len(), log_gains.len(), "{place}");
    for (photograph, c) in (0..log_gains.len()).flat_map(|photograph| [0, 1, 2].map(|c| (photograph, c))) {
        let at = |by: f64| {
            let mut moved = log_gains.to_vec();
            moved[photograph][c] += by;
            (0..given.pixels.len()).map(|i| given.of_pixel(config, i, channels(i), &moved)).sum::<f64>()
        };
        let (found, slope) = (found.result.exposures[photograph][c], (at(STEP) - at(-STEP)) / (2.0 * STEP));
        let error = (found - slope).abs();
        assert!(error < PIXEL_TOLERANCE * total, "{place}: {photograph}, {c}: {found}, not {slope}");
    }
    total
}

/// Compares the gradients with respect to the densities of a pixel's samples; returns the pixel's ray terms.
fn assert_densities(given: &Given, config: &Config, found: &Found, pixel: usize, place: &str) -> f64 {
    let (target, group) = (&given.targets[pixel], &given.groups[pixel]);
    let cones = given.cones(config, pixel);
    let of = |cones: &[Vec<_>]| f64::from(target.weight) * loss::of_cones(config, target, cones);
    let fraction = f64::from(target.weight / group.count as f32).max(1.0);
    let samples =
        cones.iter().enumerate().flat_map(|(cone, samples)| (0..samples.len()).map(move |k| (cone, k)));
    for (cone, k) in samples.take_while(|_| pixel < DIFFERENTIATED) {
        let at = |by: f64| {
            let mut cones = cones.clone();
            cones[cone][k].depth += by;
            of(&cones)
        };
        let i = given.segments[group.start as usize + cone].start as usize + k;
        let length = f64::from(given.intervals[i].length);
        let slope = (at(STEP) - at(-STEP)) / (2.0 * STEP) * length;
        let found = found.by_density[i];
        let error = (found - slope).abs();
        assert!(error < TOLERANCE * fraction, "{place}: pixel {pixel}, sample {i}: {found}, not {slope}");
    }
    of(&cones)
}

/// The loss and the gradients of a training step match central differences of the reference, in every example.
///
/// # Errors
/// When the backend refuses a configuration.
pub fn finite_differences<B: Backend>(
    make: impl Fn() -> B,
    examples: &[(&'static str, Config)],
) -> Result<()> {
    examples.iter().try_for_each(|(name, config)| of_a_step(&make, name, config))
}

/// With every term, a run that is interrupted and resumed equals an uninterrupted run. `file` is the path of the checkpoint.
///
/// # Errors
/// When a step or the file fails.
pub fn resume<B: Backend>(make: impl Fn() -> B, file: &std::path::Path) -> Result<()> {
    examples(&training::configuration())
        .iter()
        .try_for_each(|(_, config)| training::resume_with(&make, config, file))
}
