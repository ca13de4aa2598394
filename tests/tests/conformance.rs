//! Runs the suite for every backend on the CPU, with each instruction set and several numbers of threads.

use std::sync::Arc;
use trimip_core::{
    Config, Result,
    config::{Precision, TrainConfig},
    engine::exchange::{Exchange, Ranks},
    field::losses::verify,
};
use trimip_cpu::{CpuBackend, DataParallel, simd::Simd};
use trimip_tests::{fixtures, outside, ranks::Threads, suite};

/// Runs a test of the suite on every CPU backend that this processor supports.
fn on_every_cpu(part: impl Fn(&dyn Fn() -> CpuBackend) -> Result<()>) {
    with_threads(&[1, 2, 3], part);
}

/// Runs a test of the suite with every instruction set and the given numbers of threads.
fn with_threads(threads: &[u32], part: impl Fn(&dyn Fn() -> CpuBackend) -> Result<()>) {
    for simd in Simd::available() {
        for &threads in threads {
            println!("{simd:?}, {threads} threads");
            let make = || CpuBackend::new(threads, simd).expect("threads start");
            part(&make).expect("a small configuration is accepted");
        }
    }
}

#[test]
fn colours_see_directions_after_their_delay() {
    on_every_cpu(|make| suite::training::delayed_directions(make));
}

#[test]
fn a_run_begins_near_known_points() {
    on_every_cpu(|make| suite::training::confined(make));
}

#[test]
fn features_densities_and_colours_are_the_literal_ones() {
    on_every_cpu(|make| suite::stages::field(make));
}

#[test]
fn compositing_is_the_literal_sum() {
    on_every_cpu(|make| suite::stages::compositing(make));
}

#[test]
fn whole_pixels_are_the_literal_ones() {
    on_every_cpu(|make| suite::stages::pixels(make));
}

#[test]
fn rays_of_every_camera_model_are_those_of_f64() {
    on_every_cpu(|make| suite::projections::rays(make));
    on_every_cpu(|make| suite::projections::training(make));
}

#[test]
fn pixels_of_every_camera_model_are_the_literal_ones() {
    with_threads(&[2], |make| suite::projections::pixels(make));
}

#[test]
fn a_homogeneous_medium_is_exact_for_every_camera_model() {
    with_threads(&[2], |make| suite::projections::homogeneous(make));
}

#[test]
fn gradients_are_finite_differences() {
    // One number of threads is enough: the reference loss is slow, and `determinism.rs` proves that threads change no
    // bit.
    with_threads(&[2], |make| suite::gradients::finite_differences(make));
}

#[test]
fn bf16_gradients_are_near_those_of_f32() {
    with_threads(&[2], |make| suite::gradients::rounded(make, Precision::Bf16, 8));
}

#[test]
fn a_pixel_is_the_mean_of_its_cones() {
    on_every_cpu(|make| suite::cones::parts(make));
}

#[test]
fn a_quincunx_is_the_mean_of_five_pixels() {
    on_every_cpu(|make| suite::cones::quincunx(make));
}

#[test]
fn scales_have_the_cones_of_the_rule() {
    on_every_cpu(|make| suite::cones::by_scale(make));
}

#[test]
fn equal_cones_are_one() {
    on_every_cpu(|make| suite::cones::equal(make));
}

#[test]
fn a_step_may_be_smaller_than_a_pixel() {
    on_every_cpu(|make| suite::training::tiny_batches(make));
}

#[test]
fn a_pixel_has_the_samples_of_its_cones() {
    on_every_cpu(|make| suite::looking::samples(make));
}

#[test]
fn a_clipped_view_shows_its_box_alone() {
    on_every_cpu(|make| suite::looking::clips(make));
}

#[test]
fn queries_are_the_field_of_the_world() {
    on_every_cpu(|make| suite::probes::queries(make));
}

#[test]
fn nothing_is_placed_outside_of_the_hull() {
    with_threads(&[1], |make| suite::probes::within_the_hull(make));
}

#[test]
fn probes_lie_on_their_rays() {
    with_threads(&[1], |make| suite::probes::on_their_rays(make));
}

#[test]
fn bf16_gradients_are_those_of_the_rounded_factors() {
    with_threads(&[2], |make| suite::gradients::rounded_as_written(make));
}

#[test]
fn terms_of_the_loss_are_their_equations() {
    on_every_cpu(|make| suite::losses::as_written(make, &suite::losses::examples(&fixtures::small())));
}

#[test]
fn gradients_of_every_term_of_the_loss_are_finite_differences() {
    with_threads(&[2], |make| {
        suite::losses::finite_differences(make, &suite::losses::examples(&fixtures::small()))
    });
}

#[test]
fn terms_of_another_crate_are_part_of_the_loss() {
    let config = Config::default().loss;
    verify::pixel_term(&outside::SquaredOpacity(1.0), &config).unwrap();
    verify::ray_term(&outside::SampleOpacities(1.0), &config).unwrap();
    let examples = outside::examples(&fixtures::small());
    on_every_cpu(|make| suite::losses::as_written(make, &examples));
    with_threads(&[2], |make| suite::losses::finite_differences(make, &examples));
}

#[test]
fn a_resumed_run_is_the_run_that_never_stopped_with_every_term_of_the_loss() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    with_threads(&[2], |make| suite::losses::resume(make, &folder.path().join("checkpoint")));
}

#[test]
fn distortion_has_no_unit() {
    on_every_cpu(|make| suite::distortion::in_other_units(make));
}

#[test]
fn gradients_of_distortion_are_finite_differences() {
    with_threads(&[2], |make| suite::distortion::finite_differences(make));
}

#[test]
fn marching_is_asking_every_step() {
    on_every_cpu(|make| suite::marching::brute_force(make));
}

#[test]
fn samples_in_contracted_space_are_those_of_the_equations() {
    on_every_cpu(|make| suite::contraction::as_written(make));
}

#[test]
fn contracted_fog_hides_what_lies_far_away_as_computed() {
    on_every_cpu(|make| suite::contraction::fog(make));
}

#[test]
fn pictures_of_contracted_space_are_those_of_the_model_in_f64() {
    on_every_cpu(|make| suite::contraction::exact(make));
    on_every_cpu(|make| suite::contraction::shifted(make));
}

#[test]
fn the_step_follows_its_schedule() {
    on_every_cpu(|make| suite::marching::scale(make));
}

#[test]
fn a_step_moves_parameters_by_the_written_rule() {
    on_every_cpu(|make| suite::training::update(make, 0.0));
}

#[test]
fn no_checkpoint_has_an_update_by_a_loss_that_is_not_finite() {
    with_threads(&[2], |make| suite::training::spoilt(make));
}

/// Creates the exchange of the CPU backend.
fn together(ranks: Arc<dyn Ranks>, config: &Config) -> Box<dyn Exchange<CpuBackend>> {
    Box::new(DataParallel::new(ranks, &config.train).expect("few ranks"))
}

#[test]
fn any_number_of_ranks_has_the_bits_of_one() {
    let simd = Simd::detect();
    suite::exchange::same_bits(|| CpuBackend::new(2, simd).expect("threads start"), &together)
        .expect("all train");
}

#[test]
fn a_message_of_another_length_ends_the_run() {
    suite::exchange::broken(|| CpuBackend::new(1, Simd::detect()).expect("threads start"), &together)
        .expect("whole messages are read");
}

#[test]
fn ranks_that_add_gradients_learn_the_same() {
    suite::exchange::summed(|| CpuBackend::new(2, Simd::detect()).expect("threads start"))
        .expect("all train");
}

#[test]
fn more_ranks_than_parts_are_refused() {
    // The error names the limit that binds: the leaves in the settings, the samples of a step, or the largest number of
    // leaves.
    for (ranks, leaves, samples, advice) in [
        (5, 4, 262_144, "train.leaves = 8"),
        (17, 64, 16_384, "train.samples_per_step"),
        (65, 64, 262_144, "at most 64"),
    ] {
        let train = TrainConfig { leaves, samples_per_step: samples, ..Config::default().train };
        let refused = DataParallel::new(Threads::new(ranks).remove(0), &train).err().expect("too many");
        let told = format!("{ranks} ranks");
        assert!(refused.kind() == trimip_core::ErrorKind::Input, "{refused}");
        assert!(refused.message().contains(&told) && refused.message().contains(advice), "{refused}");
    }
}

#[test]
fn jitter_moves_rays_by_parts_of_a_step() {
    on_every_cpu(|make| suite::marching::jitter(make));
}

#[test]
fn what_is_seen_is_what_the_literal_rule_keeps() {
    with_threads(&[1], |make| suite::seeing::kept(make));
}

#[test]
fn seeing_in_pieces_keeps_what_asking_everything_keeps() {
    with_threads(&[1], |make| suite::seeing::pieces(make));
}

#[test]
fn every_level_has_the_mean_of_its_base() {
    on_every_cpu(|make| suite::pyramid::means(make));
}

#[test]
fn gradients_lose_nothing_on_the_way_to_the_base() {
    on_every_cpu(|make| suite::pyramid::gradients(make));
}

#[test]
fn a_homogeneous_medium_follows_beer_and_lambert() {
    on_every_cpu(|make| suite::scenes::homogeneous(make));
}

#[test]
fn an_opaque_box_has_its_silhouette() {
    on_every_cpu(|make| suite::scenes::silhouette(make));
}

#[test]
fn assets_travel_with_checkpoints_and_models() {
    on_every_cpu(|make| suite::training::assets(make));
}

#[test]
fn a_run_that_ends_early_is_its_model() {
    on_every_cpu(|make| suite::training::finish_early(make));
}

#[test]
fn a_resumed_run_is_the_run_that_never_stopped() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    on_every_cpu(|make| suite::training::resume(make, &folder.path().join("checkpoint")));
}

#[test]
fn every_scale_has_its_share_of_the_rays() {
    with_threads(&[1], |make| suite::sampling::balance(make));
}

#[test]
fn as_many_rays_have_their_own_background_as_the_schedule_says() {
    with_threads(&[1], |make| suite::sampling::backgrounds(make));
}

#[test]
fn targets_have_the_known_depths_of_their_pixels() {
    with_threads(&[1], |make| suite::sampling::known_depths(make));
}

#[test]
fn pixels_are_drawn_by_the_error_map_as_core_draws_them() {
    with_threads(&[1], |make| suite::sampling::error_map(make));
}

#[test]
fn the_unit_of_length_changes_nothing() {
    with_threads(&[2], |make| suite::units::change_nothing(make));
}

#[test]
fn the_batch_follows_the_step() {
    with_threads(&[2], |make| suite::training::steady_batch(make));
}

#[test]
fn nothing_is_learned_from_ignored_pixels() {
    on_every_cpu(|make| suite::masks::garbage(make));
}

#[test]
fn a_pixel_weighs_as_much_as_is_kept_of_it() {
    on_every_cpu(|make| suite::masks::fractions(make));
}

#[test]
fn masked_pixels_are_not_measured() {
    with_threads(&[2], |make| suite::masks::measures(make));
}

#[test]
fn poor_photographs_are_no_failure() {
    on_every_cpu(|make| suite::training::poor_photographs(make));
}

#[test]
fn an_empty_grid_recovers() {
    on_every_cpu(|make| suite::training::empty_occupancy(make));
}

#[test]
fn slopes_by_log_gains_are_those_of_the_loss() {
    on_every_cpu(|make| suite::exposure::whole_step(make));
}

#[test]
fn gains_of_photographs_are_beside_the_model() {
    on_every_cpu(|make| suite::exposure::beside_the_model(make));
}

#[test]
fn drawn_samples_are_those_of_the_rule() {
    on_every_cpu(|make| suite::drawing::as_written(make));
}

#[test]
fn drawn_samples_have_the_gradient_of_all() {
    with_threads(&[2], |make| suite::drawing::unbiased(make, 100));
}

#[test]
fn a_run_draws_the_fraction_of_its_schedule() {
    with_threads(&[2], |make| suite::drawing::fraction(make));
}

#[test]
fn refined_poses_are_beside_the_model() {
    on_every_cpu(|make| suite::poses::beside_the_model(make));
}

#[test]
fn refined_poses_have_no_common_motion() {
    on_every_cpu(|make| suite::poses::without_a_common_motion(make));
}

#[test]
fn derivatives_by_poses_are_slopes_of_the_loss() {
    on_every_cpu(|make| suite::poses::whole_step(make));
}

#[test]
fn derivatives_by_intrinsics_are_slopes_of_the_loss() {
    with_threads(&[2], |make| suite::poses::by_intrinsics(make));
}
