//! Tests of the selection of training rays: fractions and weights of the scales, backgrounds, known depths, and the error map.

use super::Bench;
use crate::fixtures::{lively, noise, small};
use std::ops::Range;
use trimip_core::{
    Backend, Layout, Result,
    config::{Exposure, TrainBackground, schedule::Schedule},
    engine::{
        backend::Sampler,
        error_map::{UNIT, error_of},
    },
};

/// The schedules distribute the rays of a step over the scales, and the weights of the rays compensate. The width of a ray's cone
/// identifies its scale.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn balance<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let mut config = small();
    config.train.scale_weighting = Schedule::new(vec![[0.0, 0.0], [0.5, 0.5], [0.9, 1.0]]);
    config.train.finest_scale = Schedule::new(vec![[0.0, 0.0], [0.2, 1.0], [0.4, 0.0]]);
    let views = noise(3, 32, 3, 4);
    let finest = views.views[0].camera.intrinsics.fx.recip() / std::f64::consts::PI.sqrt();
    let parameters = lively(&Layout::new(&config), 1);
    let mut bench = Bench::new(make(), &config, Some(views), &parameters)?;
    // A scale has 4^(b-1) times as many rays as the next finer one, rounded down except at the finest; weights grow by 4^(1-b).
    let expected = [
        (0.0, [3_201, 800, 200], [1.0, 4.0, 16.0]),
        (0.3, [0, 3_361, 840], [1.0, 4.0, 16.0]),
        (0.49, [3_201, 800, 200], [1.0, 4.0, 16.0]),
        (0.5, [2_401, 1_200, 600], [1.0, 2.0, 4.0]),
        (1.0, [1_401, 1_400, 1_400], [1.0, 1.0, 1.0]),
    ];
    for (progress, fractions, weights) in expected {
        let Bench { backend, stages, workspace, .. } = &mut bench;
        stages.sampler.set_progress(progress);
        let allocation = stages.sampler.scale_weights().allocate(4_201);
        stages.sampler.training_rays(&mut workspace.stream, 7, &allocation, 0..4_201, &mut workspace.rays);
        let (rays, targets) = (backend.read(&workspace.rays.rays), backend.read(&workspace.rays.targets));
        let mut found = [0; 3];
        for (ray, target) in rays.iter().zip(&targets) {
            let width = f64::from(ray.slope) / f64::from(ray.cosine).powi(2) / finest;
            let scale = width.log2().round() as usize;
            found[scale] += 1;
            assert!((target.weight - weights[scale]).abs() < 1e-6, "weight {} at {progress}", target.weight);
        }
        assert_eq!(found, fractions, "{progress}");
    }
    Ok(())
}

/// The fraction of training rays with a random background follows the schedule; all other rays have the configured background. Every
/// target is composited on the background of its ray.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn backgrounds<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    const RAYS: u32 = 4_000;
    let mut config = small();
    config.data.background = [0.25, 0.5, 0.75];
    config.train.background_fraction = Schedule::new(vec![[0.0, 1.0], [0.5, 0.25], [0.9, 0.0]]);
    let parameters = lively(&Layout::new(&config), 1);
    for (background, fractions) in
        [(TrainBackground::Fixed, [0.0; 3]), (TrainBackground::Random, [1.0, 0.25, 0.0])]
    {
        config.train.background = background;
        let mut views = noise(3, 32, 3, 4);
        // The photographs are transparent, so only the background is visible.
        views.pixels.iter_mut().for_each(|pixel| pixel[3] = 0);
        let mut bench = Bench::new(make(), &config, Some(views), &parameters)?;
        for (progress, fraction) in [0.2, 0.7, 0.95].into_iter().zip(fractions) {
            let Bench { backend, stages, workspace, .. } = &mut bench;
            stages.sampler.set_progress(progress);
            let allocation = stages.sampler.scale_weights().allocate(RAYS);
            stages.sampler.training_rays(&mut workspace.stream, 3, &allocation, 0..RAYS, &mut workspace.rays);
            let targets = backend.read(&workspace.rays.targets);
            assert!(targets.iter().all(|target| target.rgb == target.background));
            let own = targets.iter().filter(|target| target.background != config.data.background);
            // The bound is five standard deviations.
            let bound = 5.0 * (f64::from(RAYS) * fraction * (1.0 - fraction)).sqrt();
            assert!(
                (own.count() as f64 - f64::from(RAYS) * fraction).abs() <= bound,
                "{fraction} at {progress}"
            );
        }
    }
    Ok(())
}

/// While the depth term has a weight, targets have exactly the known depths of their pixels; otherwise they have none.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn known_depths<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    const RAYS: Range<u32> = 5..1_405;
    let mut config = small();
    config.loss.depth = Schedule::new(vec![[0.0, 0.5], [0.5, 0.0]]);
    let mut views = noise(3, 32, 3, 4);
    // The colour of a pixel encodes its number.
    for (pixel, number) in views.pixels.iter_mut().zip(0_u32..) {
        *pixel = [number as u8, (number >> 8) as u8, 0, 255];
    }
    let known = views.depths.clone();
    let mut bench = Bench::new(make(), &config, Some(views), &lively(&Layout::new(&config), 1))?;
    for progress in [0.0, 0.5] {
        let Bench { backend, stages, workspace, .. } = &mut bench;
        stages.sampler.set_progress(progress);
        let allocation = stages.sampler.scale_weights().allocate(RAYS.end);
        stages.sampler.training_rays(&mut workspace.stream, 7, &allocation, RAYS, &mut workspace.rays);
        let targets = backend.read(&workspace.rays.targets);
        let mut supervised = 0;
        for target in &targets {
            let [low, high, _] = target.rgb.map(|channel| (255.0 * channel).round() as usize);
            let pixel = low + (high << 8);
            let own = known.iter().find(|known| known.pixel as usize == pixel).filter(|_| progress < 0.5);
            let expected = own.map_or([0.0; 2], |own| [own.distance, own.deviation]);
            assert_eq!([target.distance, target.deviation], expected, "{target:?} at {progress}");
            supervised += usize::from(own.is_some());
        }
        // Every third pixel has a known depth.
        let (low, high) = if progress < 0.5 { (RAYS.len() / 4, RAYS.len() / 2) } else { (0, 0) };
        assert!((low..=high).contains(&supervised), "{supervised} at {progress}");
    }
    Ok(())
}

/// With an error map, the backend draws the same pixels as core, at every scale and with their known depths, with and without exposure
/// gains. Errors are added to the cells of the pixels, and the next map draws other pixels.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn error_map<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    const RAYS: Range<u32> = 5..3_005;
    for exposure in [Exposure::None, Exposure::Gain] {
        let mut config = small();
        config.train.error_map = Schedule::new(vec![[0.0, 0.75]]);
        config.loss.depth = Schedule::new(vec![[0.0, 0.5]]);
        config.loss.exposure = exposure;
        let mut views = noise(3, 80, 3, 4);
        // The colour of a pixel encodes its number.
        for (pixel, number) in views.pixels.iter_mut().zip(0_u32..) {
            *pixel = [number as u8, (number >> 8) as u8, (number >> 16) as u8, 255];
        }
        let known = views.depths.clone();
        let all = views.views.clone();
        let mut bench = Bench::new(make(), &config, Some(views), &lively(&Layout::new(&config), 1))?;
        let Bench { backend, stages, workspace, .. } = &mut bench;
        let allocation = stages.sampler.scale_weights().allocate(RAYS.end);
        let mut before = Vec::new();
        for round in 0..3 {
            stages.sampler.training_rays(&mut workspace.stream, 7, &allocation, RAYS, &mut workspace.rays);
            let targets = backend.read(&workspace.rays.targets);
            let policy = stages.sampler.policy();
            let map = policy.error_map().expect("the configuration has a map").clone();
            let mut expected = vec![[0; 2]; map.len()];
            let gradients: Vec<[f32; 4]> =
                (0..RAYS.len()).map(|i| [0.0, 1e-4 * i as f32, 1e-3, 0.5]).collect();
            let mut pixels = Vec::new();
            for ((index, target), gradient) in RAYS.zip(&targets).zip(&gradients) {
                let own = policy.pixel(&all, 7, &allocation, index);
                let [low, middle, high] = target.rgb.map(|channel| (255.0 * channel).round() as usize);
                assert_eq!(low + (middle << 8) + (high << 16), own.pixel, "pixel {index}, round {round}");
                let weight = policy.scale_weights().weight(own.scale) * own.importance;
                assert!((target.importance / own.importance - 1.0).abs() < 1e-5, "{target:?}, not {own:?}");
                assert!((target.weight / weight - 1.0).abs() < 1e-5, "{target:?}, not {weight}");
                let depth = known.iter().find(|known| known.pixel as usize == own.pixel);
                assert_eq!(target.deviation, depth.map_or(0.0, |own| own.deviation));
                let [error, count] = &mut expected[policy.cell(&map, 7, index)];
                *error += (error_of(*gradient, target.weight) * UNIT) as u64;
                *count += 1;
                pixels.push(own.pixel);
            }
            assert_ne!(pixels, before, "round {round}");
            before = pixels;
            backend.write(&mut workspace.pixel_gradients, &gradients);
            stages.sampler.observe(
                &mut workspace.stream,
                7,
                RAYS,
                &workspace.rays,
                &workspace.pixel_gradients,
            );
            let found = stages.sampler.take_errors();
            for (cell, (found, expected)) in found.iter().zip(&expected).enumerate() {
                assert_eq!(found[1], expected[1], "cell {cell}");
                let off = found[0].abs_diff(expected[0]) as f64;
                assert!(off <= 1e-5 * expected[0] as f64 + expected[1] as f64, "{found:?}, not {expected:?}");
            }
            assert_eq!(found.len(), map.len());
            assert!(
                stages.sampler.take_errors().iter().all(|errors| *errors == [0; 2]),
                "they are empty now"
            );
            let mut next = map;
            next.update(&found, 0.75);
            stages.sampler.set_error_map(next);
        }
    }
    Ok(())
}
