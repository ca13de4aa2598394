//! The gradients of a whole step match central differences of the reference loss, in every slot and through every mip level.

use super::{Bench, wide};
use crate::{
    fixtures::{TestRandom, every_encoder, lively, nerf_networks, noise, small, small_zip},
    reference::{KeptCone, Reference, Sample, bf16, kept},
};
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Mutex;
use trimip_core::config::schedule::Schedule;
use trimip_core::{
    Backend, Config, Layout, Renderer, Result,
    config::{
        Contraction, DensityFunction, EncoderKind, LevelFormula, LossRays, Precision, TrainBackground,
        ViewEncoding,
    },
    engine::{
        backend::Sampler,
        batch::{Segment, Target},
        trainer::Trainer,
    },
    field::encoders,
};

/// Largest error of an entry, relative to the root mean square of its slot's checked entries (or to the entry itself if that is larger).
/// Each of about 600 samples' terms is rounded to about 1e-6, and the roundings partly cancel; the rest is margin for the exp and log of
/// other devices. A wrong factor anywhere causes a far larger error.
const GRADIENT_TOLERANCE: f64 = 5e-5;

/// Largest distance between a slot's gradient and the bf16 reference's, relative to its size. Sums in f32 and f64 agree to 2e-7 (measured
/// with and without AVX2), so a sum that close to the midpoint between two bf16 values may round to the other value. That happens to about
/// one value in ten thousand, and changes one of several hundred terms by 2⁻⁸: by 4e-5 of the slot. The tolerance allows five such values.
const ROUNDED_TOLERANCE: f64 = 2e-4;

/// Half width h of a central difference: the error is h² times the third derivative, plus 1e-16/h of rounding.
const STEP: f64 = 1e-5;

/// Number of rays of the step.
const RAYS: u32 = 48;

/// Number of the training step whose rays and jitter are used.
const TRAINING_STEP: u64 = 7;

fn configurations() -> Vec<(&'static str, Config)> {
    let change = |name, change: &dyn Fn(&mut Config)| {
        let mut config = small();
        change(&mut config);
        (name, config)
    };
    let mut all = vec![
        change("paper", &|_| {}),
        change("code", &|c| {
            c.encoder.level = LevelFormula::Code;
            (c.field.density_layers, c.field.color_layers) = (2, 4);
        }),
        change("no mipmap", &|c| c.encoder.mipmap = false),
        change("level as an input", &|c| c.encoder.level_input = true),
        change("linear loss over all rays", &|c| {
            (c.loss.beta, c.loss.rays) = (0.05, LossRays::All);
        }),
        change("random backgrounds, long steps, steps of 40 radii", &|c| {
            c.train.background = TrainBackground::Random;
            c.renderer.step_scale = Schedule::new(vec![[0.0, 1.5]]);
            c.renderer.step_per_radius = 40.0;
        }),
        change("opacity beside colour", &|c| c.loss.opacity = 0.7),
        change("pruned", &|c| c.renderer.min_transmittance = 0.3),
        change("four cones a pixel", &|c| c.renderer.cones = 2),
        // Pixels have one, one and nine cones at the three scales.
        change("cones by scale, photographs of dark silhouettes", &|c| {
            (c.renderer.cones, c.renderer.cone_width) = (3, 0.3);
            c.data.edge_exponents = vec![0.0, 0.25, 0.5];
        }),
        change("soft Voronoi cells of directions", &|c| {
            (c.field.view, c.field.view_sharpness) = (ViewEncoding::Voronoi, 5.0);
        }),
        change("one colour per ray", &|c| c.field.deferred = true),
        change("one colour per ray, four cones a pixel, pruned, sines of geometry", &|c| {
            (c.field.deferred, c.renderer.cones, c.field.geometry_frequencies) = (true, 2, 2);
            (c.renderer.min_transmittance, c.loss.opacity) = (0.3, 0.7);
        }),
        change("narrow networks", &|c| (c.field.geometry, c.field.harmonics) = (6, 2)),
        change("wide networks", &|c| c.field.geometry = 37),
        ("networks like NeRF's", {
            let mut config = nerf_networks();
            config.field.density = DensityFunction::Softplus;
            config
        }),
    ];
    let others = every_encoder().into_iter().filter(|config| config.encoder.kind != EncoderKind::TriMip);
    all.extend(others.map(|config| ("another encoder", config)));
    all.push(("six points", small_zip(6)));
    all
}

/// The pixels of the step and their cones, with the samples that are kept according to the reference's densities.
struct Batch {
    pixels: Vec<(Target, Vec<KeptCone>)>,
    marched: usize,
    kept: usize,
    /// Number of rays where rounding may change the decision to keep a sample.
    doubtful: usize,
}

fn batch<B: Backend>(bench: &mut Bench<B>, config: &Config, reference: &Reference) -> Batch {
    let Bench { backend, stages, workspace, .. } = bench;
    let allocation = stages.sampler.scale_weights().allocate(RAYS);
    stages.sampler.training_rays(
        &mut workspace.stream,
        TRAINING_STEP,
        &allocation,
        0..RAYS,
        &mut workspace.rays,
    );
    let (stream, jitter) = (&mut workspace.stream, Some(TRAINING_STEP));
    stages.renderer.march(stream, &workspace.rays, &stages.occupancy, jitter, &mut workspace.samples);
    let (rays, targets) = (backend.read(&workspace.rays.rays), backend.read(&workspace.rays.targets));
    let segments = backend.read(&workspace.samples.segments);
    let (intervals, spheres) =
        (backend.read(&workspace.samples.intervals), backend.read(&workspace.samples.spheres));
    let groups = backend.read(&workspace.rays.groups);
    let group = |(target, group): (&Target, &Segment)| (*target, Vec::with_capacity(group.count as usize));
    let pixels: Vec<_> = targets.iter().zip(&groups).map(group).collect();
    let owner = |ray: usize| groups.iter().position(|group| group.range().contains(&ray)).expect("a pixel's");
    let mut result = Batch { pixels, marched: 0, kept: 0, doubtful: 0 };
    for (i, segment) in segments.iter().enumerate() {
        let mut samples: Vec<Sample> = (segment.start as usize..(segment.start + segment.count) as usize)
            .map(|at| Sample::new(&rays[i], &intervals[at], &spheres[at]))
            .collect();
        result.marched += samples.len();
        let (count, margin) = kept(config, &samples, &reference.densities(&samples));
        samples.truncate(count);
        result.kept += count;
        result.doubtful += usize::from(margin < 1e-4);
        result.pixels[owner(i)].1.push((rays[i], samples));
    }
    result
}

/// Chooses entries of a slot to differentiate: 24 (texels) or 8 (layers) with a nonzero gradient, and four arbitrary ones.
fn entries(gradient: &[f32], sparse: bool, random: &mut TestRandom) -> Vec<usize> {
    let mut chosen: Vec<usize> = (0..4).map(|_| random.below(gradient.len())).collect();
    let live: Vec<usize> = (0..gradient.len()).filter(|&i| gradient[i] != 0.0).collect();
    assert!(!live.is_empty(), "a slot without any gradient");
    let more = if sparse { 24 } else { 8 };
    chosen.extend((0..more).map(|_| live[random.below(live.len())]));
    chosen
}

/// Returns the central difference for a step and a parameter, and computes it only once: it depends only on the reference, so backends
/// with the same samples share it.
fn taken_once(key: (u64, usize), take: impl FnOnce() -> f64) -> f64 {
    static TAKEN: Mutex<BTreeMap<(u64, usize), f64>> = Mutex::new(BTreeMap::new());
    let known = TAKEN.lock().expect("no test failed here").get(&key).copied();
    known.unwrap_or_else(|| {
        let taken = take();
        TAKEN.lock().expect("no test failed here").insert(key, taken);
        taken
    })
}

/// Returns the central difference of a loss around 0. If the slopes to the left and right differ, a ReLU switches within the step; a
/// smaller step then excludes the switch.
fn difference(at: &mut dyn FnMut(f64) -> f64) -> f64 {
    let here = at(0.0);
    let mut central = 0.0;
    for step in [STEP, STEP / 16.0, STEP / 256.0] {
        let (left, right) = ((here - at(-step)) / step, (at(step) - here) / step);
        central = 0.5 * (left + right);
        if (right - left).abs() <= GRADIENT_TOLERANCE * central.abs() {
            break;
        }
    }
    central
}

/// The loss and the gradient of every slot match central differences.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn finite_differences<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    configurations().iter().try_for_each(|(name, config)| of_a_step(&make, name, config))
}

/// Checks [`finite_differences`] for one configuration.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn of_a_step<B: Backend>(make: impl Fn() -> B, name: &str, config: &Config) -> Result<()> {
    let views = noise(3, 24, 3, 21);
    let layout = Layout::new(config);
    let parameters = lively(&layout, 13);
    let mut bench = Bench::new(make(), config, Some(views.clone()), &parameters)?;
    let mut values = wide(&parameters);
    let reference = Reference::new(config, &layout, &values);
    let batch = batch(&mut bench, config, &reference);
    let misses = |(_, cones): &(_, Vec<KeptCone>)| cones.iter().all(|cone| cone.1.is_empty());
    let bounded = config.scene.contraction == Contraction::None;
    assert_eq!(batch.pixels.iter().any(misses), bounded, "{name}: some pixels miss the box");
    assert_eq!(batch.kept < batch.marched, name.contains("pruned"), "{name}");

    let mut trainer = Trainer::new(make(), config, views)?;
    trainer.set_parameters(&parameters);
    trainer.occupy_all();
    let (sums, gradient) = trainer.loss_and_gradient(TRAINING_STEP, RAYS)?;
    assert_eq!(sums.rays, u64::from(RAYS), "{name}");
    // A backend that evaluates rays from front to back queries fewer samples, but never fewer than it keeps.
    assert!((sums.kept..=batch.marched as u64).contains(&sums.marched), "{name}: samples marched");
    assert!(sums.kept.abs_diff(batch.kept as u64) <= batch.doubtful as u64, "{name}: samples kept");
    let loss = reference.loss(&batch.pixels);
    assert!((sums.loss / sums.weight - loss).abs() < 1e-4 * loss, "{name}: loss, not {loss}");

    let step = {
        let mut hasher = DefaultHasher::new();
        format!("{config:?} {:?}", batch.pixels).hash(&mut hasher);
        hasher.finish()
    };
    let mut random = TestRandom::new(17);
    for slot in &layout.slots {
        let part = &gradient[slot.range.clone()];
        let chosen = entries(part, slot.group.is_some(), &mut random);
        let differences: Vec<f64> = chosen
            .iter()
            .map(|&i| {
                let i = slot.range.start + i;
                let mut at = |shift: f64| {
                    let before = values[i];
                    values[i] = before + shift;
                    let loss = Reference::new(config, &layout, &values).loss(&batch.pixels);
                    values[i] = before;
                    loss
                };
                taken_once((step, i), || difference(&mut at))
            })
            .collect();
        let size = (differences.iter().map(|d| d * d).sum::<f64>() / differences.len() as f64).sqrt();
        for (&i, &expected) in chosen.iter().zip(&differences) {
            let found = f64::from(part[i]);
            assert!(
                (found - expected).abs() <= GRADIENT_TOLERANCE * size.max(expected.abs()),
                "{name}: {}[{i}] is {found}, not {expected} (the slot's size is {size})",
                slot.name
            );
        }
    }
    Ok(())
}

/// At a precision whose rounding is known exactly, loss and gradients match a reference that rounds the same factors. The remaining
/// difference comes from the order of f32 sums, and from factors so close to the midpoint of two bf16 values that this order decides how
/// they round.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn rounded_as_written<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let views = noise(3, 24, 3, 21);
    let mut config = small();
    (config.field.precision, config.renderer.min_transmittance) = (Precision::Bf16, 0.0);
    (config.field.density_layers, config.field.color_layers) = (2, 3);
    let layout = Layout::new(&config);
    let parameters = lively(&layout, 13);
    let reference = Reference::new(&config, &layout, &wide(&parameters));
    let mut bench = Bench::new(make(), &config, Some(views.clone()), &parameters)?;
    let batch = batch(&mut bench, &config, &reference);
    let (width, stride) = (encoders::of(&config).width(&config), encoders::stride(&config));
    let features: Vec<_> =
        wide(&bench.features()).chunks_exact(stride).map(|row| row[..width].to_vec()).collect();
    // Each pixel has one cone.
    let rays: Vec<_> =
        batch.pixels.iter().map(|(target, cones)| (cones[0].0, *target, cones[0].1.clone())).collect();
    let expected = reference.gradient(&rays, &features, &bf16);

    let mut trainer = Trainer::new(make(), &config, views)?;
    trainer.set_parameters(&parameters);
    trainer.occupy_all();
    let (sums, gradient) = trainer.loss_and_gradient(TRAINING_STEP, RAYS)?;
    assert_eq!(sums.kept, batch.kept as u64, "samples kept");
    let loss = sums.loss / sums.weight;
    assert!((loss / expected.loss - 1.0).abs() < 1e-6, "loss {loss}, not {}", expected.loss);
    for (slot, expected) in layout.networks().iter().zip(&expected.layers) {
        let found = wide(&gradient[slot.range.clone()]);
        let square = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>();
        let distance = square(&mut found.iter().zip(expected).map(|(a, b)| a - b));
        let error = (distance / square(&mut expected.iter().copied())).sqrt();
        assert!(error < ROUNDED_TOLERANCE, "{}: off by {error}", slot.name);
    }
    // Features are linear in the encoder's parameters. The dot product of any parameter vector with the parameters' gradient therefore
    // equals that of the vector's features with the features' gradient. Vectors of random signs detect any error.
    let own = layout.encoder()[0].range.clone();
    let size = wide(&gradient[own.clone()]).iter().map(|g| g * g).sum::<f64>().sqrt();
    let mut random = TestRandom::new(23);
    for _ in 0..8 {
        let mut values = vec![0.0; layout.len()];
        values[own.clone()].fill_with(|| if random.below(2) == 0 { 1.0 } else { -1.0 });
        let direction = Reference::new(&config, &layout, &values);
        let expected: f64 = expected
            .features
            .iter()
            .map(|(sample, by_feature)| {
                let features = direction.features(sample);
                features.iter().zip(by_feature).map(|(f, g)| f * g).sum::<f64>()
            })
            .sum();
        let found: f64 = own.clone().map(|i| values[i] * f64::from(gradient[i])).sum();
        assert!((found - expected).abs() < 4.0 * ROUNDED_TOLERANCE * size, "planes: {found}, not {expected}");
    }
    Ok(())
}

/// Rounding the factors of the layers' products to `bits` bits changes the loss by less than one rounding (2^−`bits`), and gradients by
/// 0.1 to 4 roundings. All hidden units of the networks are on, because a unit that switches would change a gradient by far more than a
/// rounding.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn rounded<B: Backend>(make: impl Fn() -> B, precision: Precision, bits: i32) -> Result<()> {
    let rounding = 2_f64.powi(-bits);
    let views = noise(3, 24, 3, 21);
    let mut config = small();
    let layout = Layout::new(&config);
    let parameters = always_on(&layout);
    let mut at = |precision| {
        config.field.precision = precision;
        let mut trainer = Trainer::new(make(), &config, views.clone())?;
        trainer.set_parameters(&parameters);
        trainer.occupy_all();
        trainer.loss_and_gradient(TRAINING_STEP, RAYS)
    };
    let ((expected, exact), (found, rounded)) = (at(Precision::F32)?, at(precision)?);
    let (expected, found) = (expected.loss / expected.weight, found.loss / found.weight);
    assert!((found - expected).abs() < rounding * expected, "loss {found}, not {expected}");
    for slot in &layout.slots {
        let pairs = || exact[slot.range.clone()].iter().zip(&rounded[slot.range.clone()]);
        let square = |x: f64| x * x;
        let distance: f64 = pairs().map(|(a, b)| square(f64::from(a - b))).sum();
        let size: f64 = pairs().map(|(a, _)| square(f64::from(*a))).sum();
        let error = (distance / size).sqrt();
        // A gradient depends on at most four products forward and four backward. Each has two factors with an error of half a rounding, or
        // of a whole one if a device rounds to either neighbour. With bf16, 0.4 to 1.0 roundings were measured.
        assert!((0.1 * rounding..4.0 * rounding).contains(&error), "{}: off by {error}", slot.name);
    }
    Ok(())
}

/// Returns parameters for which the input of every ReLU is far above zero: texels and weights are positive, and the weights of all
/// harmonics except the constant one are small. Weights of the last colour layer may have either sign.
fn always_on(layout: &Layout) -> Vec<f32> {
    let mut random = TestRandom::new(29);
    let mut values = vec![0.0; layout.len()];
    for slot in &layout.slots {
        let part = &mut values[slot.range.clone()];
        let inputs = slot.shape[0] as f64;
        match slot.name.as_str() {
            "color.0.weight" => {
                let outputs = slot.shape[1];
                part.fill_with(|| random.between(0.5, 1.5) as f32 / inputs as f32);
                part[..outputs].fill_with(|| random.between(2.0, 3.0) as f32);
                part[outputs..16 * outputs].fill_with(|| random.between(-0.02, 0.02) as f32);
            }
            "color.2.weight" => part.fill_with(|| random.between(-4.0, 4.0) as f32 / inputs as f32),
            "planes" => part.fill_with(|| random.between(0.2, 1.0) as f32),
            _ => part.fill_with(|| (random.between(0.5, 1.5) / inputs) as f32),
        }
    }
    values
}
