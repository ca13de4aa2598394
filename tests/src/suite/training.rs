//! Truths of training: a run that stops and goes on is the run that never stopped, and poor data is no failure.

use crate::fixtures::{self, photographs};
use glam::DVec3;
use trimip_core::{
    Backend, Camera, Config, Intrinsics, Result, Session, ViewSet, checkpoint::Checkpoint, trainer::Trainer,
};

/// A configuration whose steps are short: warm-up of the occupancy ends at step 8, refreshes every 4.
pub fn configuration() -> Config {
    let mut config = fixtures::small();
    config.renderer.steps_per_diagonal = 64;
    (config.occupancy.warmup, config.occupancy.every) = (8, 4);
    config.train.steps = 40;
    config
}

/// Steps at the progress of the configured run.
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

/// `stop` steps, a checkpoint written and read, and the rest in a new trainer equal all steps in one: every tensor and
/// counter, bit for bit. `file` is where the checkpoint goes.
///
/// # Errors
/// When a step or the file fails.
pub fn resume<B: Backend>(make: impl Fn() -> B, file: &std::path::Path) -> Result<()> {
    let config = configuration();
    let views = || fixtures::noise(3, 16, 2, 2);
    let mut whole = Trainer::new(make(), &config, views())?;
    steps(&mut whole, &config, 18)?;
    let expected = whole.checkpoint()?;
    // Before, at and after a refresh and the end of the warm-up; right after the start.
    for stop in [1, 4, 7, 8, 9, 16] {
        let mut first = Trainer::new(make(), &config, views())?;
        steps(&mut first, &config, stop)?;
        first.checkpoint()?.write(file)?;
        drop(first);
        let read = Checkpoint::read(file)?;
        assert_eq!(read.state.totals.step, stop);
        let mut second = Trainer::new(make(), &config, views())?;
        second.restore(&read)?;
        steps(&mut second, &config, 18 - stop)?;
        let found = second.checkpoint()?;
        assert_eq!(found.state, expected.state, "stopped at {stop}");
        for (name, tensor) in &expected.file.tensors {
            assert!(found.file.tensors.get(name) == Some(tensor), "stopped at {stop}: `{name}` differs");
        }
    }
    Ok(())
}

/// Photographs that teach little: all white, all clear, one view, one pixel, one pixel per scale.
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

/// Training on poor photographs goes on, with finite parameters and pictures.
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

/// A grid whose cells were all emptied is filled by the next refresh, and training goes on.
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
            trimip_core::tensors::Values::U8(bits) if name == "occupancy" => bits.fill(0),
            trimip_core::tensors::Values::F32(densities) if name == "occupancy.density" => {
                densities.fill(0.0)
            }
            _ => {}
        }
    }
    trainer.restore(&checkpoint)?;
    let report = trainer.step(0.3)?;
    assert_eq!(report.occupied, 0.0, "nothing is occupied until the next refresh, at step 12");
    assert_eq!(report.totals.empty_batches, 1, "and the empty batch is counted");
    steps(&mut trainer, &config, 4)?;
    let before = trainer.checkpoint()?.state.totals;
    let report = trainer.step(0.5)?;
    assert!(report.occupied > 0.0, "the refresh filled the grid");
    assert!(report.totals.samples > before.samples, "and samples are kept again");
    Ok(())
}
