//! Tests of training: a resumed run equals an uninterrupted one, and poor data causes no failure.

use crate::{
    fixtures::{self, photographs},
    reference::{changes, moments},
};
use glam::DVec3;
use trimip_core::{
    Backend, Camera, Config, ErrorKind, Intrinsics, Layout, Result, Session, ViewSet, Viewer,
    config::{EncoderKind, FilePrecision, Untouched, schedule::Schedule},
    engine::{
        checkpoint::{Checkpoint, OCCUPANCY_DENSITY},
        loaded::LoadedModel,
        trainer::Trainer,
    },
    field::{encoders::tri_mip::CHANNELS, model::OCCUPANCY, tensors::Tensor},
    geometry::occupancy::OUTSIDE,
    math::bits,
    scene::known_space::{Confinement, KnownSpace},
};

/// Returns a configuration with cheap steps. The occupancy warm-up ends at step 8, and the grid is refreshed every 4 steps.
pub fn configuration() -> Config {
    let mut config = fixtures::small();
    config.renderer.steps_per_diagonal = 64;
    (config.occupancy.warmup, config.occupancy.every) = (8, 4);
    config.train.steps = 40;
    config
}

/// Returns a configuration whose steps draw their pixels by the error map, and later only half of their samples.
pub fn drawn() -> Config {
    let mut config = configuration();
    config.train.backward_fraction = Schedule::new(vec![[0.0, 1.0], [0.1, 0.5]]);
    config.train.error_map = Schedule::new(vec![[0.0, 0.8], [0.3, 0.5]]);
    config.renderer.color_weight = Schedule::new(vec![[0.0, 0.0], [0.2, 0.01]]);
    config
}

/// Runs `count` steps at the progress of the configured run.
///
/// # Errors
/// When a step fails.
pub fn steps<B: Backend>(trainer: &mut Trainer<B>, config: &Config, count: u64) -> Result<()> {
    let first = trainer.checkpoint()?.state.totals.step;
    for step in first..first + count {
        trainer.step(step as f64 / config.train.steps as f64)?;
    }
    Ok(())
}

/// A run that a new trainer resumes from a checkpoint file equals the uninterrupted run bit for bit, in every tensor and counter. `file`
/// is the path of the checkpoint.
///
/// # Errors
/// When a step or the file fails.
pub fn resume<B: Backend>(make: impl Fn() -> B, file: &std::path::Path) -> Result<()> {
    for encoder in fixtures::every_encoder().into_iter().chain(fixtures::growing()) {
        resume_with(&make, &fixtures::encoded(configuration(), &encoder), file)?;
    }
    resume_with(&make, &scheduled()?, file)?;
    resume_with(&make, &super::poses::refined(), file)?;
    resume_with(&make, &drawn(), file)
}

/// Returns a configuration whose schedules change everything during the run: planes grow at steps 5 and 9, steps shorten, the batch grows,
/// colours depend on directions from step 6 on, and more cells of the occupancy grid can be occupied from steps 8 and 12 on.
///
/// # Errors
/// When the settings are refused.
pub fn scheduled() -> Result<Config> {
    let mut config = configuration();
    let text = r#"
        [encoder]
        halvings = [[0.0, 2], [0.11, 1], [0.21, 0]]
        [field]
        direction_delay = 0.15
        [renderer]
        step_scale = [[0.0, 2.0], [0.2, 1.0]]
        [occupancy]
        seeded = 0.2
        cleared = 0.3
        [loss]
        distortion = 0.05
        [optimizer]
        schedule = "cosine"
        untouched = "skip"
        [train]
        batch_scale = [[0.0, 0.5], [0.15, 1.0]]
        scale_weighting = [[0.0, 0.0], [0.18, 0.5]]
        background = "random"
    "#;
    let mut settings = trimip::settings::defaults();
    settings.apply_file("config", &config.to_toml())?;
    settings.apply_file("schedules", text)?;
    config = Config::from_settings(&settings)?;
    Ok(config)
}

/// At first only cells near points of known depth can be occupied, then cells farther from them, then all cells that photographs do
/// not look through, then all. Without known depths, all cells can be occupied from the start.
///
/// # Errors
/// When a step fails.
pub fn confined<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    use Confinement::{Near, None, NotFree};
    const CELLS: usize = 16 * 16 * 16;
    let mut config = configuration();
    config.occupancy.resolution = 16;
    (config.occupancy.seeded, config.occupancy.cleared) = (0.3, 0.6);
    // The cameras lie within the box, 4 units from its middle, and the space around them is free.
    (config.scene.aabb_min, config.scene.aabb_max) = ([-4.5; 3], [4.5; 3]);
    let mut views = fixtures::noise(9, 16, 2, 2);
    for known in &mut views.depths {
        (known.distance, known.deviation) = (4.0, 0.05);
    }
    let known = KnownSpace::of(&config, &views).expect("depths are known");
    let allowed = |confinement| (0..CELLS).filter(|&cell| known.allows(confinement, cell)).count();
    assert!(allowed(Near(2)) + 100 < allowed(NotFree) && allowed(NotFree) + 10 < CELLS);
    let mut trainer = Trainer::new(make(), &config, views.clone())?;
    let stages =
        [(1, Near(2)), (5, Near(4)), (8, Near(8)), (12, Near(16)), (13, NotFree), (24, NotFree), (32, None)];
    for (until, confinement) in stages {
        let done = trainer.checkpoint()?.state.totals.step;
        steps(&mut trainer, &config, until - done)?;
        let Checkpoint { state, file, .. } = trainer.checkpoint()?;
        assert_eq!(state.confinement, confinement, "after step {until}");
        let densities = file.f32("", OCCUPANCY_DENSITY, &[CELLS])?;
        let bits = file.u8("", OCCUPANCY, &[CELLS / 8])?;
        for (cell, density) in densities.iter().enumerate() {
            let allowed = known.allows(confinement, cell);
            assert_eq!(*density == OUTSIDE, !allowed, "after step {until}");
            assert!(allowed || !bits::is_set(bits, cell), "after step {until}");
        }
    }
    let Checkpoint { file, .. } = trainer.checkpoint()?;
    let bits = file.u8("", OCCUPANCY, &[CELLS / 8])?;
    assert!(
        (0..CELLS).any(|cell| bits::is_set(bits, cell) && !known.allows(Near(2), cell)),
        "cells come back"
    );
    let mut trainer = Trainer::new(make(), &config, ViewSet { depths: Vec::new(), ..views })?;
    steps(&mut trainer, &config, 1)?;
    let Checkpoint { state, file, .. } = trainer.checkpoint()?;
    assert_eq!(state.confinement, None);
    assert!(!file.f32("", OCCUPANCY_DENSITY, &[CELLS])?.contains(&OUTSIDE));
    Ok(())
}

/// Until the end of `field.direction_delay` the direction weights and their moments are 0, so colours do not depend on the direction.
/// After it the direction weights are trained; all other weights are trained from the start.
///
/// # Errors
/// When a step fails.
pub fn delayed_directions<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let mut config = configuration();
    config.field.direction_delay = 0.25;
    let mut trainer = Trainer::new(make(), &config, fixtures::noise(3, 16, 2, 2))?;
    let layout = trainer.layout().clone();
    let weights = layout.direction_weights(&config).expect("colours see directions");
    let slot = layout.network("color").next().expect("a layer").range.clone();
    assert_eq!((weights.start, weights.len()), (slot.start, 16 * config.field.hidden as usize));
    let initial = trainer.parameters();
    steps(&mut trainer, &config, 10)?;
    let file = trainer.checkpoint()?.file;
    let [parameters, m, v] = ["", ".m", ".v"].map(|suffix| layout.from_tensors(&file, "checkpoint", suffix));
    let (parameters, m, v) = (parameters?, m?, v?);
    for values in [&initial, &parameters, &m, &v] {
        assert!(values[weights.clone()].iter().all(|&value| value == 0.0));
    }
    let changed = |range: std::ops::Range<usize>| range.filter(|&i| parameters[i] != initial[i]).count();
    let others = weights.end..slot.end;
    assert!(changed(others.clone()) > others.len() / 2);
    steps(&mut trainer, &config, 1)?;
    let parameters = trainer.parameters();
    let moved = parameters[weights.clone()].iter().filter(|&&value| value != 0.0).count();
    assert!(moved > weights.len() / 4, "{moved} of {}", weights.len());
    Ok(())
}

/// A non-finite loss causes an error, [`Backend::LAG`] steps later. Without lag, the parameters and moments then are those before the
/// step. With lag, the trainer refuses to return its state. In both cases the trainer can be restored from an earlier checkpoint and
/// continues with the bits of an undisturbed run.
///
/// # Errors
/// When a healthy step fails.
pub fn spoilt<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let config = configuration();
    let views = || fixtures::noise(3, 16, 2, 2);
    let progress = |step: u64| step as f64 / config.train.steps as f64;
    let mut trainer = Trainer::new(make(), &config, views())?;
    steps(&mut trainer, &config, 6)?;
    let good = trainer.checkpoint()?;
    let mut values = trainer.parameters();
    let slot = trainer.layout().slots.iter().find(|slot| slot.name == "color.2.weight").expect("a layer");
    values[slot.range.start + 5] = f32::NAN;
    trainer.set_parameters(&values);
    let bits = |checkpoint: &Checkpoint| {
        let tensors = checkpoint.file.tensors.iter().filter(|(name, _)| !name.starts_with("occupancy"));
        tensors.map(|(name, tensor)| format!("{name} {tensor:?}")).collect::<Vec<_>>()
    };
    let broken =
        (B::LAG == 0).then(|| trainer.checkpoint().map(|checkpoint| bits(&checkpoint))).transpose()?;
    let late = (6..).find(|step| trainer.step(progress(*step)).is_err()).map(|step| step - 6);
    assert_eq!(late, Some(B::LAG as u64), "steps until the error");
    match broken {
        Some(broken) => assert!(bits(&trainer.checkpoint()?) == broken, "the state before the step"),
        None => {
            let refused = [
                trainer.step(progress(9)).map(drop),
                trainer.checkpoint().map(drop),
                trainer.join_checkpoint(),
                trainer.finish().map(drop),
            ];
            for refused in refused {
                let error = refused.expect_err("it holds an update by a loss that is not finite");
                assert_eq!(error.kind(), ErrorKind::Run);
                assert!(
                    error.message().starts_with("step 6: ") && error.message().contains("not finite"),
                    "{error}"
                );
            }
        }
    }
    trainer.restore(&good)?;
    steps(&mut trainer, &config, 6)?;
    let mut healthy = Trainer::new(make(), &config, views())?;
    healthy.restore(&good)?;
    steps(&mut healthy, &config, 6)?;
    assert!(trainer.checkpoint()? == healthy.checkpoint()?, "the bits of a run that was never broken");
    Ok(())
}

/// Checkpoints and models keep the assets of a scene, including those that the renderer does not use.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn assets<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let config = scheduled()?;
    let mut trainer = Trainer::new(make(), &config, fixtures::noise(3, 16, 2, 2))?;
    let asset = Tensor::f32(&[2, 3], vec![1.0, -2.0, 3.5, 0.0, 5.0, -6.25]);
    let mut checkpoint = trainer.checkpoint()?;
    checkpoint.file.tensors.insert("asset.mesh".into(), asset.clone());
    trainer.restore(&checkpoint)?;
    let model = trainer.finish()?;
    assert_eq!(model.file.tensors.get("asset.mesh"), Some(&asset));
    assert_eq!(trainer.checkpoint()?.file.tensors.get("asset.mesh"), Some(&asset));
    assert_eq!(checkpoint.into_model().file.tensors.get("asset.mesh"), Some(&asset));
    LoadedModel::new(make(), &model)?;
    Ok(())
}

/// A run that ends before its planes reach their full size renders the same pictures as its model file.
///
/// # Errors
/// When the settings are refused or a step fails.
pub fn finish_early<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let levels = fixtures::encoded(configuration(), &fixtures::growing_hash_grid());
    for mut config in [scheduled()?, levels] {
        config.file.planes = FilePrecision::F16;
        let views = fixtures::noise(3, 16, 2, 2);
        let camera = views.views[0].camera;
        let mut trainer = Trainer::new(make(), &config, views)?;
        steps(&mut trainer, &config, 3)?;
        let model = trainer.finish()?;
        let mut loaded = LoadedModel::new(make(), &model)?;
        assert!(
            trainer.render(&camera)?.pixels == loaded.render(&camera)?.pixels,
            "{:?}: other pictures than the file's",
            config.encoder.kind
        );
    }
    Ok(())
}

/// When the marching step shrinks to a quarter, the batch keeps its number of samples, not its number of rays.
///
/// # Errors
/// When a step fails.
pub fn steady_batch<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let mut config = configuration();
    config.train.samples_per_step = 2048;
    config.renderer.step_scale = Schedule::new(vec![[0.0, 4.0], [0.5, 1.0]]);
    let mut trainer = Trainer::new(make(), &config, fixtures::noise(3, 16, 2, 2))?;
    let (mut samples, mut rays) = (Vec::new(), Vec::new());
    for step in 0..config.train.steps {
        let before = trainer.checkpoint()?.state.totals;
        trainer.step(step as f64 / config.train.steps as f64)?;
        // A checkpoint includes the counts still pending on the device.
        let after = trainer.checkpoint()?.state.totals;
        samples.push((after.samples - before.samples) as f64);
        rays.push((after.rays - before.rays) as f64);
    }
    let switch = (config.train.steps / 2) as usize;
    let ratio = rays[switch] / rays[switch - 1];
    assert!((0.2..0.35).contains(&ratio), "rays change by {ratio}");
    for (step, kept) in samples.iter().enumerate().skip(switch - 4) {
        assert!((0.6..1.5).contains(&(kept / 2048.0)), "step {step} keeps {kept} samples");
    }
    Ok(())
}

fn same(found: &Checkpoint, expected: &Checkpoint, run: &str) {
    assert_eq!(found.state, expected.state, "{run}");
    for (name, tensor) in &expected.file.tensors {
        assert!(found.file.tensors.get(name) == Some(tensor), "{run}: `{name}` differs");
    }
}

/// Checks [`resume`] for one configuration.
///
/// # Errors
/// When a step or the file fails.
pub fn resume_with<B: Backend>(make: &impl Fn() -> B, config: &Config, file: &std::path::Path) -> Result<()> {
    let views = || fixtures::noise(3, 16, 2, 2);
    let mut whole = Trainer::new(make(), config, views())?;
    steps(&mut whole, config, 18)?;
    let expected = whole.checkpoint()?;
    // This run writes checkpoints right after the start, and before, at and after a refresh and the end of the warm-up.
    let mut kept = Trainer::new(make(), config, views())?;
    let mut done = 0;
    for stop in [1, 4, 7, 8, 9, 16] {
        steps(&mut kept, config, stop - done)?;
        done = stop;
        kept.checkpoint()?.write(file)?;
        let model = kept.model()?;
        let read = Checkpoint::read(file)?;
        assert_eq!(read.state.totals.step, stop);
        assert!(read.clone().into_model().file.tensors == model.file.tensors, "step {stop}: another model");
        let mut second = Trainer::new(make(), config, views())?;
        second.restore(&read)?;
        steps(&mut second, config, 18 - stop)?;
        same(&second.checkpoint()?, &expected, &format!("resumed at {stop}"));
    }
    steps(&mut kept, config, 18 - done)?;
    same(&kept.checkpoint()?, &expected, "not disturbed by its checkpoints");
    Ok(())
}

/// One step updates both moments of every parameter by the published rule with the gradient of the step's rays, and then the parameter by
/// the published rule with these moments, however the backend splits the work. With `untouched = "skip"`, texels without a gradient stay
/// bit-identical. Data derived from the parameters is updated too.
///
/// `spread` is the share of a tensor's largest gradient by which two sums of the same contributions may differ: 0 if the order of addition
/// is fixed. If the spread exceeds a gradient, the parameter may move in either direction; it is therefore compared using the moments that
/// the backend wrote.
///
/// # Errors
/// When a step fails.
pub fn update<B: Backend>(make: impl Fn() -> B, spread: f64) -> Result<()> {
    let both = [Untouched::Decay, Untouched::Skip];
    for (encoder, untouched) in fixtures::every_encoder().iter().flat_map(|e| both.map(|u| (e, u))) {
        let mut config = fixtures::encoded(configuration(), encoder);
        if config.encoder.kind == EncoderKind::TriMip {
            (config.encoder.plane_size, config.encoder.levels) = (64, 3);
        }
        (config.optimizer.untouched, config.optimizer.weight_decay) = (untouched, 0.1);
        let views = fixtures::noise(2, 16, 2, 4);
        let camera = views.views[0].camera;
        let layout = Layout::new(&config);
        let mut trainer = Trainer::new(make(), &config, views)?;
        steps(&mut trainer, &config, 5)?;
        let before = trainer.checkpoint()?;
        let step = before.state.totals.step;
        let (_, gradient) = trainer.loss_and_gradient(step, before.state.rays_per_step)?;
        trainer.restore(&before)?;
        trainer.step(step as f64 / config.train.steps as f64)?;
        let after = trainer.checkpoint()?;
        let values =
            |checkpoint: &Checkpoint, suffix| layout.from_tensors(&checkpoint.file, "checkpoint", suffix);
        let old = [values(&before, "")?, values(&before, ".m")?, values(&before, ".v")?];
        let new = [values(&after, "")?, values(&after, ".m")?, values(&after, ".v")?];
        let mut still = 0;
        for slot in &layout.slots {
            // Learning rate relative to the networks', weight decay, and number of values that are skipped together.
            let (factor, decays, group) = match slot.name.as_str() {
                "planes" if config.encoder.kind == EncoderKind::RipMap => {
                    (config.rip_map.rate, true, Some(CHANNELS))
                }
                "planes" => (config.optimizer.plane_scale, true, Some(CHANNELS)),
                name if name.ends_with("_planes") || name.ends_with("_lines") => {
                    (config.tensor.rate, false, None)
                }
                "density_voxels" => (config.voxels.density_rate, false, Some(1)),
                "color_voxels" => (config.voxels.color_rate, false, Some(1)),
                "table" => (config.hash_grid.rate, false, Some(config.hash_grid.features as usize)),
                _ => (1.0, true, None),
            };
            let rate = config.optimizer.learning_rate * factor;
            let decay = if decays { config.optimizer.weight_decay } else { 0.0 };
            let [share1, share2] = [config.optimizer.beta1, config.optimizer.beta2].map(|beta| 1.0 - beta);
            let largest = gradient[slot.range.clone()].iter().fold(0f32, |most, g| most.max(g.abs()));
            let spread = spread * f64::from(largest);
            for i in slot.range.clone() {
                let skipped = untouched == Untouched::Skip
                    && group.is_some_and(|group| {
                        let first = slot.range.start + (i - slot.range.start) / group * group;
                        gradient[first..first + group].iter().all(|g| *g == 0.0)
                    });
                if skipped {
                    still += 1;
                    assert_eq!(
                        new[0][i].to_bits(),
                        old[0][i].to_bits(),
                        "{}[{i}] has no gradient",
                        slot.name
                    );
                    continue;
                }
                let [x, m, v] = [&old[0], &old[1], &old[2]].map(|values| f64::from(values[i]));
                let [new_x, new_m, new_v] = [&new[0], &new[1], &new[2]].map(|values| f64::from(values[i]));
                // The loss includes `tensor.sparsity` times the mean absolute value of each of the three factors of density (L1).
                let sparsity =
                    match config.encoder.kind == EncoderKind::Tensor && slot.name.starts_with("density_") {
                        true => 3.0 * f64::from(config.tensor.sparsity[0]) / slot.range.len() as f64,
                        false => 0.0,
                    };
                let g = f64::from(gradient[i]) + if x < 0.0 { -sparsity } else { sparsity };
                let near = |what: &str, found: f64, expected: f64, tolerance: f64| {
                    let name = &slot.name;
                    assert!(
                        (found - expected).abs() <= tolerance,
                        "{what} of {name}[{i}]: {found}, not {expected}"
                    );
                };
                // About eight roundings of 6e-8 each, on the terms of each value; a device may flush denormals to zero.
                let (rounding, least) = (5e-7, f64::from(f32::MIN_POSITIVE));
                let [first, second] = moments(&config.optimizer, [m, v], g);
                let [terms, _] = moments(&config.optimizer, [m.abs(), v], g.abs());
                near("first moment", new_m, first, rounding * terms + share1 * spread + least);
                let apart = share2 * (2.0 * g.abs() + spread) * spread;
                near("second moment", new_v, second, rounding * second + apart + least);
                let [by_gradient, by_decay] =
                    changes(&config.optimizer, [rate, decay], step + 1, x, [new_m, new_v]);
                let bound = rounding * (by_gradient.abs() + x.abs());
                near("value", new_x, x + by_gradient + by_decay, bound);
            }
        }
        let skips = untouched == Untouched::Skip && layout.slots.iter().any(|slot| slot.group.is_some());
        assert_eq!(still > 100, skips, "{still} values without a gradient");
        let picture = trainer.render(&camera)?;
        trainer.set_parameters(&new[0]);
        assert!(trainer.render(&camera)? == picture, "levels and packed weights follow the parameters");
    }
    Ok(())
}

/// Returns photographs with little information: all white, all transparent, one view, one pixel, one pixel at the coarse scale, nothing of
/// the box in view.
fn poor() -> Vec<(&'static str, ViewSet)> {
    let camera = |size, i: u32| {
        let origin = DVec3::new(4.0 * f64::from(i).cos(), 4.0 * f64::from(i).sin(), 1.0);
        Camera::look_at(Intrinsics::from_angle(size, size, 0.7), origin, DVec3::ZERO, DVec3::Z)
    };
    let away = Camera::look_at(
        Intrinsics::from_angle(8, 8, 0.7),
        DVec3::new(5.0, 0.0, 0.0),
        DVec3::new(9.0, 0.0, 0.0),
        DVec3::Z,
    );
    let three: Vec<_> = (0..3).map(|i| camera(8, i)).collect();
    vec![
        ("all white", photographs(&three, 2, |_, _| [255; 4])),
        ("all clear", photographs(&three, 2, |_, _| [0; 4])),
        ("one view", photographs(&three[..1], 2, |_, p| [p as u8, 40, 90, 255])),
        ("one pixel", photographs(&[camera(1, 0)], 1, |_, _| [10, 200, 30, 255])),
        ("one pixel at the coarse scale", photographs(&[camera(2, 0)], 2, |_, _| [10, 200, 30, 128])),
        ("nothing of the box in view", photographs(&[away], 1, |_, _| [10, 200, 30, 255])),
    ]
}

/// Training on poor photographs continues, with finite parameters and pictures.
///
/// # Errors
/// When a step fails.
pub fn poor_photographs<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for (name, views) in poor() {
        let config = configuration();
        let camera = views.views[0].camera;
        let mut trainer = Trainer::new(make(), &config, views)?;
        steps(&mut trainer, &config, 12)?;
        assert!(trainer.parameters().iter().all(|p| p.is_finite()), "{name}: parameters");
        let frame = trainer.render(&camera)?;
        assert!(frame.pixels.iter().all(|p| p.rgb.iter().all(|c| c.is_finite())), "{name}: picture");
    }
    Ok(())
}

/// If all cells of an occupancy grid are emptied, the next refresh fills it, and training continues.
///
/// # Errors
/// When a step fails.
pub fn empty_occupancy<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let config = configuration();
    let mut trainer = Trainer::new(make(), &config, fixtures::noise(2, 16, 1, 6))?;
    steps(&mut trainer, &config, 9)?;
    let mut checkpoint = trainer.checkpoint()?;
    for (name, tensor) in &mut checkpoint.file.tensors {
        match &mut tensor.values {
            trimip_core::field::tensors::Values::U8(bits) if name == "occupancy" => bits.fill(0),
            trimip_core::field::tensors::Values::F32(densities) if name == "occupancy.density" => {
                densities.fill(0.0);
            }
            _ => {}
        }
    }
    trainer.restore(&checkpoint)?;
    let report = trainer.step(0.3)?;
    assert_eq!(report.occupied, 0.0, "nothing is occupied until the next refresh, at step 12");
    let totals = trainer.checkpoint()?.state.totals;
    assert_eq!(totals.empty_batches, 1, "and the empty batch is counted");
    steps(&mut trainer, &config, 4)?;
    let before = trainer.checkpoint()?.state.totals;
    let report = trainer.step(0.5)?;
    assert!(report.occupied > 0.0, "the refresh filled the grid");
    let after = trainer.checkpoint()?.state.totals;
    assert!(after.samples > before.samples, "and samples are kept again");
    Ok(())
}

/// A step trains even if the requested number of samples is below that of the cones of one pixel.
///
/// # Errors
/// When a step fails.
pub fn tiny_batches<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let mut config = configuration();
    (config.train.samples_per_step, config.renderer.cones, config.renderer.cone_width) = (256, 8, 1e-3);
    config.train.cones = Schedule::new(vec![[0.0, 8.0]]);
    config.train.batch_scale = Schedule::new(vec![[0.0, 0.01]]);
    let mut trainer = Trainer::new(make(), &config, fixtures::noise(2, 16, 3, 4))?;
    let before = trainer.parameters();
    for step in 0..12 {
        let report = trainer.step(f64::from(step) / 40.0)?;
        assert!(report.loss.is_finite(), "{report:?}");
    }
    let state = trainer.checkpoint()?.state;
    assert!((1..=16).contains(&state.rays_per_step), "{state:?}");
    assert!(state.totals.samples > 0 && trainer.parameters() != before);
    Ok(())
}
