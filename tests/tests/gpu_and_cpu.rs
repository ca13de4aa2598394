//! Compares the GPU with the CPU: transfers, models and runs that change the backend, and the state after a device
//! loss.

use std::sync::atomic::AtomicBool;
use trimip_core::{
    Camera, Config, Error, ErrorKind, Intrinsics, Layout, Lens, Result, Session, Viewer,
    config::schedule::Schedule,
    engine::{
        checkpoint::Checkpoint,
        events::{Event, Totals},
        loaded::LoadedModel,
        trainer::Trainer,
    },
    field::{model::Model, tensors::Values},
    run::{
        Run, Store,
        evaluate::{ViewResult, evaluate},
    },
};
use trimip_cpu::{CpuBackend, simd::Simd};
use trimip_data::settings::DataConfig;
use trimip_tests::{
    fixtures,
    gpu::{ADDITIONS, reproducibly, with},
    suite,
};
use trimip_wgpu::{Photographs, WgpuConfig};

fn cpu() -> CpuBackend {
    CpuBackend::new(2, Simd::detect()).expect("threads start")
}

#[test]
fn a_step_is_one_submission_and_moves_no_parameters() {
    with(&ADDITIONS, |make| {
        let config = suite::training::configuration();
        let mut trainer = Trainer::new(make(), &config, fixtures::noise(3, 16, 2, 2))?;
        suite::training::steps(&mut trainer, &config, 5)?;
        let before = trainer.device().counts();
        // These steps include refreshes of the occupancy grid.
        for step in 5..17 {
            trainer.step(f64::from(step) / config.train.steps as f64)?;
        }
        let after = trainer.device().counts();
        assert_eq!(after.submissions - before.submissions, 12, "one submission a step");
        assert_eq!(after.written, before.written, "nothing is written");
        assert_eq!(after.read - before.read, 12 * 44, "nine sums and two counts are read a step");
        assert_eq!(after.stalls, before.stalls, "nobody waits for the step that runs");
        Ok(())
    });
}

#[test]
fn gains_of_photographs_cost_no_wait_and_are_the_same_on_both_backends() {
    reproducibly(|make| {
        let config = suite::exposure::exposed();
        let views = || fixtures::noise(3, 16, 2, 2);
        let (mut on_gpu, mut on_cpu) =
            (Trainer::new(make(), &config, views())?, Trainer::new(cpu(), &config, views())?);
        let gradient = on_cpu.loss_and_exposure_gradient(0, 150)?.1;
        let found = on_gpu.loss_and_exposure_gradient(0, 150)?.1;
        for (found, expected) in found.as_flattened().iter().zip(gradient.as_flattened()) {
            assert!((found - expected).abs() < 1e-5, "{found}, not {expected}");
        }
        // Later batches differ, because their sizes follow sums that a GPU reports later.
        for step in 0..3 {
            on_gpu.step(f64::from(step) / config.train.steps as f64)?;
            on_cpu.step(f64::from(step) / config.train.steps as f64)?;
            let (found, expected) = (on_gpu.log_gains(), on_cpu.log_gains());
            // On both backends, the first gradient moves the gains in the third step.
            assert_eq!(expected.as_flattened().iter().any(|&e| e != 0.0), step == 2, "step {step}");
            for (found, expected) in found.as_flattened().iter().zip(expected.as_flattened()) {
                assert!((found - expected).abs() < 1e-3, "step {step}: {found}, not {expected}");
            }
        }
        suite::training::steps(&mut on_gpu, &config, 3)?;
        let before = on_gpu.device().counts();
        for step in 8..16 {
            on_gpu.step(f64::from(step) / config.train.steps as f64)?;
        }
        let after = on_gpu.device().counts();
        assert_eq!(after.submissions - before.submissions, 8, "one submission a step");
        assert_eq!(after.written - before.written, 8 * 36, "nine gains are written a step");
        assert_eq!(after.stalls, before.stalls, "nobody waits for the step that runs");
        Ok(())
    });
}

/// Both backends compute the same derivatives with respect to the poses and the intrinsics of cameras, for a batch that
/// they draw alike.
#[test]
fn derivatives_by_cameras_are_the_same_on_both_backends() {
    reproducibly(|make| {
        let config = suite::poses::refined();
        let mut on_gpu = Trainer::new(make(), &config, fixtures::noise(3, 16, 2, 2))?;
        let mut on_cpu = Trainer::new(cpu(), &config, fixtures::noise(3, 16, 2, 2))?;
        let parameters = fixtures::lively(&Layout::new(&config), 13);
        for change in [[0.0; 4], [0.05, 0.02, -0.01, 0.0]] {
            on_gpu.set_parameters(&parameters);
            on_cpu.set_parameters(&parameters);
            on_gpu.set_intrinsics(change);
            on_cpu.set_intrinsics(change);
            let [found, expected] =
                [on_gpu.loss_and_pose_gradient(0, 150)?.1, on_cpu.loss_and_pose_gradient(0, 150)?.1];
            alike(found.as_flattened(), expected.as_flattened());
            let [found, expected] = [
                on_gpu.loss_and_intrinsics_gradient(0, 150)?.1,
                on_cpu.loss_and_intrinsics_gradient(0, 150)?.1,
            ];
            alike(found.as_flattened(), expected.as_flattened());
        }
        Ok(())
    });
}

/// Asserts that numbers differ by less than a hundredth of the largest one.
fn alike(found: &[f64], expected: &[f64]) {
    let largest = expected.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    assert!(largest > 0.0 && found.len() == expected.len(), "{expected:?}");
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() < 0.01 * largest, "{found}, not {expected} of {largest}");
    }
}

/// Returns the root-mean-square difference of two pictures.
fn difference(a: &trimip_core::Frame, b: &trimip_core::Frame) -> f64 {
    let squares = a.pixels.iter().zip(&b.pixels).flat_map(|(a, b)| [0, 1, 2].map(|c| a.rgb[c] - b.rgb[c]));
    let sum: f64 = squares.map(|d| f64::from(d) * f64::from(d)).sum();
    (sum / (3 * a.pixels.len()) as f64).sqrt()
}

#[test]
fn models_are_the_same_pictures_on_both_backends() {
    reproducibly(|make| {
        let config = suite::training::configuration();
        let views = || fixtures::noise(3, 16, 2, 2);
        let camera = views().views[0].camera;
        let mut on_cpu = Trainer::new(cpu(), &config, views())?;
        suite::training::steps(&mut on_cpu, &config, 20)?;
        let mut on_gpu = Trainer::new(make(), &config, views())?;
        suite::training::steps(&mut on_gpu, &config, 20)?;
        let models: [(&str, Model, _); 2] = [
            ("trained on the CPU", on_cpu.model()?, on_cpu.render(&camera)?),
            ("trained on the GPU", on_gpu.model()?, on_gpu.render(&camera)?),
        ];
        for (name, model, own) in &models {
            let [on_cpu, on_gpu] = [
                LoadedModel::new(cpu(), model)?.render(&camera)?,
                LoadedModel::new(make(), model)?.render(&camera)?,
            ];
            // The bound is 90 dB, because a sample at the border of an occupied cell may fall on either side.
            for picture in [&on_cpu, &on_gpu] {
                let error = difference(picture, own);
                assert!(error < 3e-5, "{name}: pictures differ by {error}");
            }
        }
        Ok(())
    });
}

#[test]
fn every_term_of_the_loss_is_the_same_on_both_backends() {
    reproducibly(|make| {
        let examples = suite::losses::examples(&fixtures::small());
        for (name, config) in suite::distortion::configurations().into_iter().chain(examples) {
            let parameters = fixtures::lively(&Layout::new(&config), 13);
            let views = || fixtures::noise(3, 24, 3, 21);
            let (mut on_cpu, mut on_gpu) =
                (Trainer::new(cpu(), &config, views())?, Trainer::new(make(), &config, views())?);
            on_cpu.set_parameters(&parameters);
            on_gpu.set_parameters(&parameters);
            let ((expected, gradient), (found, other)) =
                (on_cpu.loss_and_gradient(7, 48)?, on_gpu.loss_and_gradient(7, 48)?);
            assert!((found.loss - expected.loss).abs() < 1e-5 * expected.loss, "{name}: {found:?}");
            assert!((found.squared_error - expected.squared_error).abs() < 1e-4 * expected.squared_error);
            let square = |x: f32| f64::from(x) * f64::from(x);
            let apart: f64 = gradient.iter().zip(&other).map(|(a, b)| square(a - b)).sum();
            let size: f64 = gradient.iter().map(|a| square(*a)).sum();
            assert!((apart / size).sqrt() < 1e-4, "{name}: gradients differ by {}", (apart / size).sqrt());
        }
        Ok(())
    });
}

/// Both backends train and render alike through lenses. The last lens has no rays for the corners of its images: the
/// corners show the background, and nothing is learned from them.
#[test]
fn lenses_are_the_same_on_both_backends() {
    reproducibly(|make| {
        let config = suite::training::configuration();
        let lenses = [
            Lens::perspective([0.3, -0.1, 0.02, 0.0], [0.02, -0.01], [0.0; 3]),
            Lens::perspective([0.2, 0.1, 0.0, 0.0], [0.0; 2], [0.5, 0.1, 0.02]),
            Lens::fisheye([0.05, -0.02, 0.004, -0.0005], [0.01, -0.02], [0.01, 0.02]),
            Lens::perspective([-4.0, 0.0, 0.0, 0.0], [0.0; 2], [0.0; 3]),
        ];
        for (i, lens) in lenses.into_iter().enumerate() {
            let views = || {
                let mut views = fixtures::noise(3, 16, 2, 2);
                views.views.iter_mut().for_each(|view| view.camera.intrinsics.lens = lens);
                views
            };
            let camera = views().views[0].camera;
            assert_eq!(camera.intrinsics.blind_pixels() > 0, i == 3);
            let mut on_cpu = Trainer::new(cpu(), &config, views())?;
            let mut on_gpu = Trainer::new(make(), &config, views())?;
            // The first step moves all parameters that have a gradient by the same length, in the gradient's direction.
            let mut straight = Trainer::new(cpu(), &config, fixtures::noise(3, 16, 2, 2))?;
            on_cpu.step(0.0)?;
            on_gpu.step(0.0)?;
            straight.step(0.0)?;
            let own = on_cpu.parameters();
            let apart = |others: Vec<f32>| {
                let differing = own.iter().zip(&others).filter(|(a, b)| (*a - *b).abs() > 1e-4);
                differing.count() as f64 / own.len() as f64
            };
            let (by_backend, by_lens) = (apart(on_gpu.parameters()), apart(straight.parameters()));
            assert!(
                by_backend < 0.01 && by_lens > 5.0 * by_backend + 0.01,
                "lens {i}: {by_backend} {by_lens}"
            );
            suite::training::steps(&mut on_cpu, &config, 20)?;
            let model = on_cpu.model()?;
            let own = LoadedModel::new(cpu(), &model)?.render(&camera)?;
            let found = LoadedModel::new(make(), &model)?.render(&camera)?;
            let error = difference(&own, &found);
            assert!(error < 1e-4, "lens {i}: pictures of one model differ by {error}");
            // A pinhole camera gives another picture.
            let pinhole =
                Camera { intrinsics: Intrinsics { lens: Lens::default(), ..camera.intrinsics }, ..camera };
            assert!(difference(&own, &LoadedModel::new(cpu(), &model)?.render(&pinhole)?) > 1e-3);
            let blind = (0..own.width * own.height)
                .filter(|p| camera.cone::<f32>(p % own.width, p / own.width).slope == 0.0);
            for p in blind {
                assert_eq!(found.pixels[p as usize].rgb, config.data.background);
                assert_eq!(own.pixels[p as usize].rgb, config.data.background);
            }
        }
        Ok(())
    });
}

#[test]
fn masked_pixels_have_the_same_targets_on_both_backends() {
    reproducibly(|make| {
        let mut config = suite::masks::everything();
        for photographs in [Photographs::Device, Photographs::Host] {
            config.change(|wgpu: &mut WgpuConfig| wgpu.photographs = photographs)?;
            let mut on_cpu = Trainer::new(cpu(), &config, suite::masks::half(1))?;
            let mut on_gpu = Trainer::new(make(), &config, suite::masks::half(1))?;
            let ((own_sums, own), (sums, other)) =
                (on_cpu.loss_and_gradient(0, 150)?, on_gpu.loss_and_gradient(0, 150)?);
            assert_eq!((own_sums.rays, own_sums.kept), (sums.rays, sums.kept));
            let near = |a: f64, b: f64| (a / b - 1.0).abs() < 1e-5;
            assert!(near(own_sums.weight, sums.weight) && near(own_sums.loss, sums.loss));
            assert!(near(own_sums.squared_error, sums.squared_error));
            let square =
                |values: &mut dyn Iterator<Item = f32>| values.map(|x| f64::from(x * x)).sum::<f64>();
            let apart = square(&mut own.iter().zip(&other).map(|(a, b)| a - b));
            let size = square(&mut own.iter().copied());
            assert!(apart < 1e-8 * size, "{apart} of {size}");
        }
        Ok(())
    });
}

#[test]
fn a_run_goes_on_on_the_other_backend_as_on_its_own() {
    reproducibly(|make| {
        let config = suite::training::configuration();
        let views = || fixtures::noise(3, 16, 2, 2);
        let camera = views().views[0].camera;
        let mut began = Trainer::new(cpu(), &config, views())?;
        suite::training::steps(&mut began, &config, 20)?;
        let (checkpoint, before) = (began.checkpoint()?, began.render(&camera)?);
        let mut changed = Trainer::new(make(), &config, views())?;
        changed.restore(&checkpoint)?;
        let layout = changed.layout().clone();
        let values = |checkpoint: &Checkpoint, suffix| layout.from_tensors(&checkpoint.file, "it", suffix);
        let taken = changed.checkpoint()?;
        for suffix in ["", ".m", ".v"] {
            assert!(values(&taken, suffix)? == values(&checkpoint, suffix)?, "`{suffix}` is taken over");
        }
        assert_eq!(taken.state, checkpoint.state);
        // The next step uses the same rays and samples on both backends.
        let rays = checkpoint.state.rays_per_step;
        let ((own_sums, own), (sums, other)) =
            (began.loss_and_gradient(20, rays)?, changed.loss_and_gradient(20, rays)?);
        assert_eq!((own_sums.rays, own_sums.kept), (sums.rays, sums.kept));
        for slot in &layout.slots {
            let square =
                |values: &mut dyn Iterator<Item = f32>| values.map(|x| f64::from(x * x)).sum::<f64>();
            let pairs = || own[slot.range.clone()].iter().zip(&other[slot.range.clone()]);
            let size = square(&mut own[slot.range.clone()].iter().copied());
            let apart = (square(&mut pairs().map(|(a, b)| a - b)) / size).sqrt();
            println!("{}: gradients differ by {apart}", slot.name);
            assert!(apart < 1e-4, "{}: gradients differ by {apart}", slot.name);
        }
        for trainer in [&mut began as &mut dyn Session, &mut changed] {
            trainer.restore(&checkpoint)?;
            for step in 20..24 {
                trainer.step(f64::from(step) / config.train.steps as f64)?;
            }
        }
        let [own, other] = [began.checkpoint()?.state.totals, changed.checkpoint()?.state.totals];
        assert_eq!((own.step, other.step), (24, 24));
        let (own, other) = (began.render(&camera)?, changed.render(&camera)?);
        // AdamW moves a parameter by its learning rate, however small the gradient is. Parameters whose gradient is
        // only rounding error therefore diverge between the backends.
        let (moved, apart) = (difference(&own, &before), difference(&own, &other));
        assert!(apart < 0.4 * moved, "the picture moves by {moved}, backends differ by {apart}");
        Ok(())
    });
}

/// Takes `steps` steps; returns the checkpoint.
fn tensors(
    trainer: &mut Trainer<impl trimip_core::Backend>,
    config: &Config,
    steps: u64,
) -> Result<Checkpoint> {
    suite::training::steps(trainer, config, steps)?;
    trainer.checkpoint()
}

#[test]
fn photographs_on_the_host_train_the_same_bits() {
    reproducibly(|make| {
        let mut config = suite::training::scheduled()?;
        let views = || fixtures::noise(3, 16, 3, 2);
        let there = tensors(&mut Trainer::new(make(), &config, views())?, &config, 12)?;
        config.change(|wgpu: &mut WgpuConfig| wgpu.photographs = Photographs::Host)?;
        let mut trainer = Trainer::new(make(), &config, views())?;
        let written = trainer.device().counts().written;
        let sent = tensors(&mut trainer, &config, 12)?;
        assert!(trainer.device().counts().written > written, "pixels are sent");
        assert_eq!(sent.state, there.state);
        assert!(sent.file.tensors == there.file.tensors, "the same tensors");
        Ok(())
    });
}

#[test]
fn memory_is_predicted_within_a_tenth() {
    for (hidden, plane_size, samples, drawn) in
        [(64, 64, 2048, 1.0), (32, 256, 1024, 1.0), (64, 64, 2048, 0.5)]
    {
        // Each case has a new device, because a device reports the most memory that it has ever held.
        with(&ADDITIONS[..2], |make| {
            let mut config = suite::training::configuration();
            config.train.backward_fraction = Schedule::new(vec![[0.0, drawn]]);
            config.field.hidden = hidden;
            (config.encoder.plane_size, config.train.samples_per_step) = (plane_size, samples);
            config.occupancy.resolution = 32;
            let views = fixtures::noise(4, 64, 2, 2);
            let camera = views.views[0].camera;
            let mut trainer = Trainer::new(make(), &config, views.clone())?;
            let deterministic = trainer.device().addition() == ADDITIONS[0];
            config.change(|wgpu: &mut WgpuConfig| wgpu.deterministic = deterministic)?;
            let predicted: u64 = trimip_wgpu::memory(&config, &views).iter().map(|(_, bytes)| bytes).sum();
            suite::training::steps(&mut trainer, &config, 10)?;
            trainer.render(&camera)?;
            let found = trainer.device().counts().most_held;
            let ratio = predicted as f64 / found as f64;
            println!(
                "hidden {hidden}, planes {plane_size}, {samples} samples, {drawn} drawn: {predicted} bytes predicted, {found} held"
            );
            assert!((ratio - 1.0).abs() < 0.1, "predicted {predicted}, held {found}");
            Ok(())
        });
    }
}

/// A store that records the steps of the checkpoints, and destroys the device at the second one.
struct Shelf<'a> {
    kept: Vec<u64>,
    lose: &'a dyn Fn(),
}

impl Store for Shelf<'_> {
    fn checkpoint(&mut self, checkpoint: &Checkpoint) -> Result<u64> {
        let planes = &checkpoint.file.tensors["planes"];
        assert!(
            matches!(&planes.values, Values::F32(values) if values.iter().any(|x| *x != 0.0)),
            "{planes:?}"
        );
        self.kept.push(checkpoint.state.totals.step);
        if self.kept.len() == 2 {
            (self.lose)();
        }
        Ok(0)
    }

    fn model(&mut self, _: &Model) -> Result<u64> {
        Err(Error::run("a lost device has no model"))
    }

    fn view(&mut self, _: &ViewResult<'_>) -> Result<()> {
        Ok(())
    }

    fn evaluated(&mut self) -> Result<()> {
        Ok(())
    }
}

#[test]
fn a_lost_device_is_named_and_the_last_checkpoint_stays() {
    reproducibly(|make| {
        let mut config = suite::training::configuration();
        config.train.checkpoint_seconds = 1e-9;
        let backend = make();
        let lose = backend.destroyer();
        let mut trainer = Trainer::new(backend, &config, fixtures::noise(3, 16, 2, 2))?;
        let scene = trimip_data::open(&builtin().section()?)?;
        let mut shelf = Shelf { kept: Vec::new(), lose: &lose };
        let mut events: Vec<Event> = Vec::new();
        let outcome = Run {
            config: &config,
            session: &mut trainer,
            frames: scene.test.as_ref(),
            perception: &mut (),
            observer: &mut (),
            store: &mut shelf,
            events: &mut |event: &Event| events.push(event.clone()),
            stop: &AtomicBool::new(false),
            evaluated: Totals::default(),
        }
        .train(Totals::default());
        let error = outcome.expect_err("the device is gone");
        assert_eq!(error.kind(), ErrorKind::Device, "{error}");
        for part in ["failed in", "lost", "MiB were in use", "largest buffer", "may have"] {
            assert!(error.message().contains(part), "`{part}` in {error}");
        }
        assert_eq!(shelf.kept, [1, 2], "no checkpoint is written after the loss");
        let said = |event: &Event| matches!(event, Event::Warning { message } if message.contains("the checkpoint of step 2 is kept"));
        assert!(events.iter().any(said), "{events:?}");
        Ok(())
    });
}

/// Returns the configuration of the built-in scene at a small size.
fn builtin() -> Config {
    let mut config = fixtures::as_code();
    let read = config.change(|data: &mut DataConfig| {
        data.format = "builtin".into();
        (data.builtin_size, data.builtin_train, data.builtin_test) = (32, 8, 2);
        (data.builtin_supersampling, data.scales) = (2, 2);
    });
    read.unwrap();
    (config.encoder.plane_size, config.encoder.levels) = (32, 5);
    config.field.hidden = 32;
    config.renderer.steps_per_diagonal = 128;
    config.occupancy.resolution = 32;
    config.occupancy.warmup = 64;
    config.train.samples_per_step = 2048;
    config.train.steps = 150;
    config
}

/// Returns the mean PSNR on the held-out views of the built-in scene.
fn held_out(session: &mut dyn Viewer, config: &Config) -> Result<f64> {
    let scene = trimip_data::open(&config.section()?)?;
    let views = evaluate(session, scene.test.as_ref(), 1, &config.data, |_| Ok(true))?;
    Ok(views.iter().map(|view| view.measures.psnr).sum::<f64>() / views.len() as f64)
}

#[test]
fn both_backends_learn_the_built_in_scene_alike() {
    reproducibly(|make| {
        let config = builtin();
        let train = || Ok::<_, Error>(trimip_data::open(&config.section()?)?.train);
        // Runs of two seeds from scratch differ by more than a tenth of a decibel, so the comparison starts from a
        // common checkpoint.
        let mut on_cpu = Trainer::new(cpu(), &config, train()?)?;
        suite::training::steps(&mut on_cpu, &config, 90)?;
        let (start, before) = (on_cpu.checkpoint()?, held_out(&mut on_cpu, &config)?);
        let mut on_gpu = Trainer::new(make(), &config, train()?)?;
        on_gpu.restore(&start)?;
        suite::training::steps(&mut on_cpu, &config, 40)?;
        suite::training::steps(&mut on_gpu, &config, 40)?;
        let (by_cpu, by_gpu) = (held_out(&mut on_cpu, &config)?, held_out(&mut on_gpu, &config)?);
        println!("{before:.3} dB, then trained on the CPU {by_cpu:.3} dB, on the GPU {by_gpu:.3} dB");
        assert!(by_cpu > before + 0.5, "there is something to learn");
        assert!((by_cpu - by_gpu).abs() < 0.1, "CPU {by_cpu:.3} dB, GPU {by_gpu:.3} dB");
        // A model has the same quality on the other backend.
        let crossed = [
            (by_cpu, held_out(&mut LoadedModel::new(make(), &on_cpu.model()?)?, &config)?),
            (by_gpu, held_out(&mut LoadedModel::new(cpu(), &on_gpu.model()?)?, &config)?),
        ];
        for (own, other) in crossed {
            println!("{own:.4} dB where it was trained, {other:.4} dB on the other backend");
            assert!((own - other).abs() < 0.02, "{own:.4} dB and {other:.4} dB");
        }
        Ok(())
    });
}
