//! The suite that every backend passes, on the GPU, with texel gradients in fixed point and in f32. Where a machine has no
//! adapter the tests are skipped and say so, unless `TRIMIP_REQUIRE_GPU` is set: then they fail.

use trimip_core::{Result, Session, model::Model, trainer::Trainer};
use trimip_cpu::{CpuBackend, simd::Simd};
use trimip_tests::{fixtures, suite};
use trimip_wgpu::WgpuBackend;

/// Runs a part of the suite on the best adapter, with both ways to add.
fn on_the_gpu(part: impl Fn(&dyn Fn() -> WgpuBackend) -> Result<()>) {
    with(&[true, false], part);
}

/// Runs a part of the suite that needs the same bits every time.
fn reproducibly(part: impl Fn(&dyn Fn() -> WgpuBackend) -> Result<()>) {
    with(&[true], part);
}

fn with(ways: &[bool], part: impl Fn(&dyn Fn() -> WgpuBackend) -> Result<()>) {
    if trimip_wgpu::adapters().is_empty() {
        assert!(
            std::env::var_os("TRIMIP_REQUIRE_GPU").is_none(),
            "a GPU is required and there is no adapter"
        );
        println!("skipped: this machine has no adapter for wgpu");
        return;
    }
    for &deterministic in ways {
        let make = || WgpuBackend::new("", deterministic).expect("the adapter opens");
        println!("{}, deterministic = {deterministic}", make().adapter());
        part(&make).expect("a small configuration is accepted");
    }
}

#[test]
fn features_densities_and_colours_are_the_literal_ones() {
    on_the_gpu(|make| suite::stages::field(make));
}

#[test]
fn compositing_is_the_literal_sum() {
    on_the_gpu(|make| suite::stages::compositing(make));
}

#[test]
fn whole_pixels_are_the_literal_ones() {
    on_the_gpu(|make| suite::stages::pixels(make));
}

#[test]
fn gradients_are_finite_differences() {
    on_the_gpu(|make| suite::gradients::finite_differences(make));
}

#[test]
fn marching_is_asking_every_step() {
    on_the_gpu(|make| suite::marching::brute_force(make));
}

#[test]
fn the_step_follows_its_schedule() {
    on_the_gpu(|make| suite::marching::scale(make));
}

#[test]
fn a_step_moves_parameters_by_the_written_rule() {
    reproducibly(|make| suite::training::update(make, 0.0));
    with(&[false], |make| suite::training::update(make, 1e-6));
}

#[test]
fn jitter_moves_rays_by_parts_of_a_step() {
    on_the_gpu(|make| suite::marching::jitter(make));
}

#[test]
fn seeing_in_pieces_keeps_what_asking_everything_keeps() {
    on_the_gpu(|make| suite::seeing::pieces(make));
}

#[test]
fn every_level_has_the_mean_of_its_base() {
    on_the_gpu(|make| suite::pyramid::means(make));
}

#[test]
fn gradients_lose_nothing_on_the_way_to_the_base() {
    on_the_gpu(|make| suite::pyramid::gradients(make));
}

#[test]
fn a_homogeneous_medium_follows_beer_and_lambert() {
    on_the_gpu(|make| suite::scenes::homogeneous(make));
}

#[test]
fn an_opaque_box_has_its_silhouette() {
    on_the_gpu(|make| suite::scenes::silhouette(make));
}

#[test]
fn every_scale_has_its_share_of_the_rays() {
    reproducibly(|make| suite::sampling::balance(make));
}

#[test]
fn the_batch_follows_the_step() {
    on_the_gpu(|make| suite::training::steady_batch(make));
}

#[test]
fn a_resumed_run_is_the_run_that_never_stopped() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    // In f32 the order of additions is the device's own affair, and with it the last bits.
    reproducibly(|make| suite::training::resume(make, &folder.path().join("checkpoint")));
}

#[test]
fn poor_photographs_are_no_failure() {
    on_the_gpu(|make| suite::training::poor_photographs(make));
}

#[test]
fn an_empty_grid_recovers() {
    on_the_gpu(|make| suite::training::empty_occupancy(make));
}

#[test]
fn a_step_is_one_submission_and_moves_no_parameters() {
    on_the_gpu(|make| {
        let config = suite::training::configuration();
        let mut trainer = Trainer::new(make(), &config, fixtures::noise(3, 16, 2, 2))?;
        suite::training::steps(&mut trainer, &config, 5)?;
        let before = trainer.device().counts();
        // Refreshes of the occupancy grid among them.
        for step in 5..17 {
            trainer.step(f64::from(step) / config.train.steps as f64)?;
        }
        let after = trainer.device().counts();
        assert_eq!(after.submissions - before.submissions, 12, "one submission a step");
        assert_eq!(after.written, before.written, "nothing is written");
        assert_eq!(after.read - before.read, 12 * 36, "eight sums and a count are read a step");
        assert_eq!(after.stalls, before.stalls, "nobody waits for the step that runs");
        Ok(())
    });
}

/// Root of the mean squared difference of two pictures.
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
        let cpu = || CpuBackend::new(2, Simd::detect()).expect("threads start");
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
                Trainer::from_model(cpu(), model)?.render(&camera)?,
                Trainer::from_model(make(), model)?.render(&camera)?,
            ];
            // 90 dB: a sample at the border of an occupied cell may fall to either side.
            for picture in [&on_cpu, &on_gpu] {
                let error = difference(picture, own);
                assert!(error < 3e-5, "{name}: pictures differ by {error}");
            }
        }
        // A run that began on one goes on on the other.
        let mut resumed = Trainer::new(make(), &config, views())?;
        resumed.restore(&on_cpu.checkpoint()?)?;
        suite::training::steps(&mut resumed, &config, 4)?;
        Ok(())
    });
}
