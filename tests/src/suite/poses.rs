//! Tests of the poses of photographs: the effect of refined poses on a run, and the derivatives of a whole step with respect to camera
//! motions and intrinsics.

use super::training::{configuration, steps};
use crate::fixtures::{lively, noise, photographs};
use glam::{DQuat, DVec3};
use trimip_core::{
    Backend, Camera, Config, Intrinsics, Layout, Result, Session, ViewSet, Viewer,
    config::{CameraPoses, Contraction},
    engine::{preconditioner::Motion, trainer::Trainer},
};

/// Number of photographs.
const PHOTOGRAPHS: usize = 3;

/// Returns a configuration that refines poses, at a learning rate high enough to see them move.
pub fn refined() -> Config {
    let mut config = configuration();
    config.train.cameras = CameraPoses::Refine;
    (config.optimizer.camera_rate, config.optimizer.camera_delay) = (1e-3, 0.0);
    config
}

/// Refined poses that do not move change no bit of a run, but poses that move change some. No model file contains poses.
///
/// # Errors
/// When a step fails.
pub fn beside_the_model<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let run = |cameras: CameraPoses, rate: f64| {
        let mut config = refined();
        (config.train.cameras, config.optimizer.camera_rate) = (cameras, rate);
        let views = noise(PHOTOGRAPHS, 16, 2, 2);
        let mut trainer = Trainer::new(make(), &config, views)?;
        steps(&mut trainer, &config, 12)?;
        let parameters: Vec<u32> = trainer.parameters().into_iter().map(f32::to_bits).collect();
        Ok((parameters, trainer.checkpoint()?, trainer.refined().map(|refined| refined.moved)))
    };
    let (plain, without, none) = run(CameraPoses::Fixed, 1e-3)?;
    let (still, with, zero) = run(CameraPoses::Refine, 0.0)?;
    let (moved, _, far) = run(CameraPoses::Refine, 1e-3)?;
    assert!(plain == still, "poses that stay change bits");
    assert!(plain != moved, "poses that move change nothing");
    assert!(none.is_none() && zero.is_some_and(|moved| moved.picture == 0.0));
    assert!(far.is_some_and(|moved| moved.picture > 1e-4 && moved.degrees > 0.0 && moved.distance > 0.0));
    assert!(without.file.tensors.keys().all(|name| !name.starts_with("poses")));
    assert!(with.file.tensors.keys().any(|name| name.starts_with("poses")));
    let names = |file: trimip_core::field::tensors::TensorFile| file.tensors.into_keys().collect::<Vec<_>>();
    assert_eq!(names(with.into_model().file), names(without.into_model().file));
    Ok(())
}

/// The mean of all motions, in the axes of the world, stays zero. A photograph at two scales has a single pose.
///
/// # Errors
/// When a step fails.
pub fn without_a_common_motion<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let config = refined();
    let views = noise(PHOTOGRAPHS, 16, 2, 2);
    let given: Vec<Camera> = views.views.iter().take(PHOTOGRAPHS).map(|view| view.camera).collect();
    let mut trainer = Trainer::new(make(), &config, views)?;
    steps(&mut trainer, &config, 12)?;
    let found = trainer.refined().map(|refined| refined.cameras).unwrap_or_default();
    assert!(found.iter().map(|(name, _)| name.as_str()).eq(["view 0", "view 1", "view 2"]));
    let mut mean = [DVec3::ZERO; 2];
    for ((_, found), given) in found.iter().zip(&given) {
        let turn = DQuat::from_mat3(&(found.rotation * given.rotation.transpose())).to_scaled_axis();
        assert!(turn.length() > 1e-6, "{turn}");
        mean = [mean[0] + turn, mean[1] + (found.origin - given.origin)];
    }
    assert!(mean[0].length() < 1e-6 && mean[1].length() < 1e-6, "{mean:?}");
    Ok(())
}

/// Number of steps over which derivatives are averaged, and number of rays in each step.
const STEPS: u64 = 8;
const RAYS: u32 = 512;

/// Largest error of a derivative, relative to its size. Each ray is moved in only one of two directions, chosen at random, which leaves an
/// error of about 4 %.
const TOLERANCE: f64 = 0.1;

/// Returns photographs that a model of `config` renders for `PHOTOGRAPHS` cameras.
fn rendered<B: Backend>(backend: B, config: &Config, parameters: &[f32]) -> Result<ViewSet> {
    let mut trainer = Trainer::new(backend, config, noise(PHOTOGRAPHS, 48, 1, 3))?;
    trainer.set_parameters(parameters);
    trainer.occupy_all();
    let wide = noise(PHOTOGRAPHS, 48, 1, 3).views.into_iter().map(|view| view.camera);
    let intrinsics = Intrinsics::from_angle(48, 48, 0.5);
    let cameras: Vec<Camera> = wide.map(|camera| Camera { intrinsics, ..camera }).collect();
    let pictures: Vec<Vec<[f32; 3]>> =
        cameras.iter().map(|camera| Ok(trainer.render(camera)?.rgb())).collect::<Result<_>>()?;
    let byte = |channel: f32| (255.0 * channel).round() as u8;
    Ok(photographs(&cameras, 1, |view, pixel| {
        let [r, g, b] = pictures[view][pixel].map(byte);
        [r, g, b, 255]
    }))
}

/// Returns a trainer on renderings of its own model, for which the derivatives with respect to cameras are complete.
fn on_its_own_pictures<B: Backend>(make: impl Fn() -> B) -> Result<Trainer<B>> {
    let mut config = refined();
    // The derivatives omit the effect of the direction on colours, of the radius on features, and of a ray's end on transmittance. None of
    // these matters here: colours do not depend on directions, the encoder has no mip levels, and rays are opaque long before their ends.
    // Steps are short.
    config.scene.contraction = Contraction::Ball;
    config.field.density_shift = -2.0;
    (config.field.directions, config.encoder.mipmap) = (false, false);
    config.renderer.steps_per_diagonal = 256;
    let parameters: Vec<f32> = lively(&Layout::new(&config), 13).iter().map(|value| 0.7 * value).collect();
    let mut trainer = Trainer::new(make(), &config, rendered(make(), &config, &parameters)?)?;
    trainer.set_parameters(&parameters);
    trainer.occupy_all();
    Ok(trainer)
}

/// The derivatives of a step with respect to camera motions are the slopes of its loss. The cameras are rotated away from the poses of the
/// photographs, by about two pixels.
///
/// # Errors
/// When a step fails.
pub fn whole_step<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let mut trainer = on_its_own_pictures(make)?;
    let turns = [[0.02, -0.015, 0.01], [-0.02, 0.01, 0.02], [0.01, 0.02, -0.015]];
    let off: [Motion; PHOTOGRAPHS] = turns.map(|[a, b, c]| [a, b, c, 0.0, 0.0, 0.0]);
    let mut at = |factor: f64| -> Result<(f64, f64)> {
        trainer.set_poses(&off.map(|motion| motion.map(|part| factor * part)));
        let (mut loss, mut slope) = (0.0, 0.0);
        for step in 0..STEPS {
            let (sums, gradient) = trainer.loss_and_pose_gradient(step, RAYS)?;
            loss += sums.loss / sums.weight / STEPS as f64;
            let products = gradient.as_flattened().iter().zip(off.as_flattened());
            slope += products.map(|(by, part)| by * part).sum::<f64>() / STEPS as f64;
        }
        Ok((loss, slope))
    };
    let (expected, found) = ((at(1.2)?.0 - at(0.8)?.0) / 0.4, at(1.0)?.1);
    assert!(expected > 5e-6, "the loss grows by {expected}");
    assert!((found / expected - 1.0).abs() < TOLERANCE, "{found}, not {expected}");
    Ok(())
}

/// Derivatives with respect to the focal length and the principal point of the one camera that took all photographs are the slopes of
/// the loss.
///
/// # Errors
/// When a step fails.
pub fn by_intrinsics<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let mut trainer = on_its_own_pictures(make)?;
    // A focal length moves mainly the rims of pictures, so fewer rays contribute to its derivative. The error of the derivative
    // corresponds to a change of the focal length by 0.01; a change of 0.2 outweighs that.
    let steps = 3 * STEPS;
    for off in [[0.2, 0.0, 0.0, 0.0], [0.0, 0.02, -0.015, 0.0]] {
        let mut at = |factor: f64| -> Result<(f64, f64)> {
            trainer.set_intrinsics(off.map(|part: f64| factor * part));
            let (mut loss, mut slope) = (0.0, 0.0);
            for step in 0..steps {
                let (sums, gradient) = trainer.loss_and_intrinsics_gradient(step, RAYS)?;
                loss += sums.loss / sums.weight / steps as f64;
                slope += gradient[0].iter().zip(off).map(|(by, part)| by * part).sum::<f64>() / steps as f64;
            }
            Ok((loss, slope))
        };
        let (expected, found) = ((at(1.2)?.0 - at(0.8)?.0) / 0.4, at(1.0)?.1);
        assert!(expected > 2e-6, "the loss grows by {expected}");
        assert!((found / expected - 1.0).abs() < TOLERANCE, "{off:?}: {found}, not {expected}");
    }
    Ok(())
}
