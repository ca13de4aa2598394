//! Runs the suite for every backend on the GPU, gradients and updates with every method of adding texel gradients.
//! Tests that compare backends are in `gpu_and_cpu.rs`.

use trimip_core::{Backend, ErrorKind, Layout, Result, Viewer, config::Precision, engine::trainer::Trainer};
use trimip_tests::{
    fixtures,
    gpu::{ADDITIONS, reproducibly, with},
    outside, suite,
};
use trimip_wgpu::{Addition, WgpuBackend};

/// Runs a test of the suite on the best adapter, with the reproducible method of addition and the fastest one.
fn on_the_gpu(part: impl Fn(&(dyn Fn() -> WgpuBackend + Sync)) -> Result<()>) {
    with(&[Addition::Fixed, Addition::Atomic], part);
}

#[test]
fn features_densities_and_colours_are_the_literal_ones() {
    reproducibly(|make| suite::stages::field(make));
}

#[test]
fn compositing_is_the_literal_sum() {
    reproducibly(|make| suite::stages::compositing(make));
}

#[test]
fn whole_pixels_are_the_literal_ones() {
    reproducibly(|make| suite::stages::pixels(make));
}

#[test]
fn a_pixel_is_the_mean_of_its_cones() {
    reproducibly(|make| suite::cones::parts(make));
}

#[test]
fn a_quincunx_is_the_mean_of_five_pixels() {
    reproducibly(|make| suite::cones::quincunx(make));
}

#[test]
fn scales_have_the_cones_of_the_rule() {
    reproducibly(|make| suite::cones::by_scale(make));
}

#[test]
fn equal_cones_are_one() {
    reproducibly(|make| suite::cones::equal(make));
}

#[test]
fn a_step_may_be_smaller_than_a_pixel() {
    reproducibly(|make| suite::training::tiny_batches(make));
}

#[test]
fn a_pixel_has_the_samples_of_its_cones() {
    reproducibly(|make| suite::looking::samples(make));
}

#[test]
fn a_clipped_view_shows_its_box_alone() {
    reproducibly(|make| suite::looking::clips(make));
}

#[test]
fn queries_are_the_field_of_the_world() {
    reproducibly(|make| suite::probes::queries(make));
}

#[test]
fn nothing_is_placed_outside_of_the_hull() {
    reproducibly(|make| suite::probes::within_the_hull(make));
}

#[test]
fn probes_lie_on_their_rays() {
    reproducibly(|make| suite::probes::on_their_rays(make));
}

#[test]
fn gradients_are_finite_differences() {
    with(&ADDITIONS, |make| suite::gradients::finite_differences(make));
}

#[test]
fn f16_gradients_are_near_those_of_f32() {
    reproducibly(|make| {
        if make().cooperates() {
            return suite::gradients::rounded(make, Precision::F16, 11);
        }
        println!("skipped: this adapter has no cooperative matrices");
        let mut config = suite::training::configuration();
        config.field.precision = Precision::F16;
        let notes = make().notes(&config);
        assert!(notes.len() == 1 && notes[0].contains("computed in f32"), "{notes:?}");
        Ok(())
    });
}

#[test]
fn numbers_beyond_f16_are_counted_and_the_run_goes_on_in_f32() {
    reproducibly(|make| {
        if !make().cooperates() {
            println!("skipped: this adapter has no cooperative matrices");
            return Ok(());
        }
        let mut config = suite::training::configuration();
        config.field.precision = Precision::F16;
        let mut trainer = Trainer::new(make(), &config, fixtures::noise(2, 16, 1, 6))?;
        suite::training::steps(&mut trainer, &config, 6)?;
        assert!(trainer.notes().is_empty(), "{:?}", trainer.notes());
        // With these weights, the first layer of the colour network has hidden units of a million; the weights of the
        // next layers are small.
        let mut values = trainer.parameters();
        for slot in &Layout::new(&config).slots {
            match slot.name.as_str() {
                "color.0.weight" => values[slot.range.clone()].fill(1e6),
                "color.1.weight" | "color.2.weight" => values[slot.range.clone()].fill(1e-9),
                _ => {}
            }
        }
        trainer.set_parameters(&values);
        suite::training::steps(&mut trainer, &config, 6)?;
        assert!(
            trainer.notes().iter().any(|note| note.contains("continues in f32")),
            "{:?}",
            trainer.notes()
        );
        assert!(trainer.parameters().iter().all(|x| x.is_finite()));
        Ok(())
    });
}

#[test]
fn samples_in_contracted_space_are_those_of_the_equations() {
    reproducibly(|make| suite::contraction::as_written(make));
}

#[test]
fn contracted_fog_hides_what_lies_far_away_as_computed() {
    reproducibly(|make| suite::contraction::fog(make));
}

#[test]
fn pictures_of_contracted_space_are_those_of_the_model_in_f64() {
    reproducibly(|make| suite::contraction::exact(make));
    reproducibly(|make| suite::contraction::shifted(make));
}

#[test]
fn terms_of_the_loss_are_their_equations() {
    reproducibly(|make| suite::losses::as_written(make, &suite::losses::examples(&fixtures::small())));
}

#[test]
fn gradients_of_every_term_of_the_loss_are_finite_differences() {
    reproducibly(|make| {
        suite::losses::finite_differences(make, &suite::losses::examples(&fixtures::small()))
    });
}

#[test]
fn a_term_of_another_crate_is_refused() {
    reproducibly(|make| {
        for (name, config) in outside::examples(&fixtures::small()) {
            let error = make().stages(&config, None).err().expect("the term has no WGSL");
            assert!(error.kind() == ErrorKind::Input, "{error}");
            assert!(
                error.message().contains(&format!("the loss term `{name}` of another crate has no WGSL"))
            );
        }
        Ok(())
    });
}

#[test]
fn a_resumed_run_is_the_run_that_never_stopped_with_every_term_of_the_loss() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    reproducibly(|make| suite::losses::resume(make, &folder.path().join("checkpoint")));
}

#[test]
fn distortion_has_no_unit() {
    reproducibly(|make| suite::distortion::in_other_units(make));
}

#[test]
fn gradients_of_distortion_are_finite_differences() {
    reproducibly(|make| suite::distortion::finite_differences(make));
}

#[test]
fn marching_is_asking_every_step() {
    reproducibly(|make| suite::marching::brute_force(make));
}

#[test]
fn the_step_follows_its_schedule() {
    reproducibly(|make| suite::marching::scale(make));
}

#[test]
fn a_step_moves_parameters_by_the_written_rule() {
    reproducibly(|make| suite::training::update(make, 0.0));
    with(&ADDITIONS[1..], |make| suite::training::update(make, 1e-6));
}

#[test]
fn colours_see_directions_after_their_delay() {
    reproducibly(|make| suite::training::delayed_directions(make));
}

#[test]
fn a_run_begins_near_known_points() {
    reproducibly(|make| suite::training::confined(make));
}

#[test]
fn no_checkpoint_has_an_update_by_a_loss_that_is_not_finite() {
    reproducibly(|make| suite::training::spoilt(make));
}

#[test]
fn ranks_that_add_gradients_learn_the_same() {
    reproducibly(|make| suite::exchange::summed(make));
}

#[test]
fn jitter_moves_rays_by_parts_of_a_step() {
    reproducibly(|make| suite::marching::jitter(make));
}

#[test]
fn what_is_seen_is_what_the_literal_rule_keeps() {
    reproducibly(|make| suite::seeing::kept(make));
}

#[test]
fn every_level_has_the_mean_of_its_base() {
    reproducibly(|make| suite::pyramid::means(make));
}

#[test]
fn gradients_lose_nothing_on_the_way_to_the_base() {
    on_the_gpu(|make| suite::pyramid::gradients(make));
}

#[test]
fn rays_of_every_camera_model_are_those_of_f64() {
    reproducibly(|make| suite::projections::rays(make));
    reproducibly(|make| suite::projections::training(make));
}

#[test]
fn pixels_of_every_camera_model_are_the_literal_ones() {
    reproducibly(|make| suite::projections::pixels(make));
}

#[test]
fn a_homogeneous_medium_is_exact_for_every_camera_model() {
    reproducibly(|make| suite::projections::homogeneous(make));
}

#[test]
fn a_homogeneous_medium_follows_beer_and_lambert() {
    reproducibly(|make| suite::scenes::homogeneous(make));
}

#[test]
fn an_opaque_box_has_its_silhouette() {
    reproducibly(|make| suite::scenes::silhouette(make));
}

#[test]
fn every_scale_has_its_share_of_the_rays() {
    reproducibly(|make| suite::sampling::balance(make));
}

#[test]
fn as_many_rays_have_their_own_background_as_the_schedule_says() {
    reproducibly(|make| suite::sampling::backgrounds(make));
}

#[test]
fn targets_have_the_known_depths_of_their_pixels() {
    reproducibly(|make| suite::sampling::known_depths(make));
}

#[test]
fn pixels_are_drawn_by_the_error_map_as_core_draws_them() {
    reproducibly(|make| suite::sampling::error_map(make));
}

#[test]
fn the_unit_of_length_changes_nothing() {
    reproducibly(|make| suite::units::change_nothing(make));
}

#[test]
fn the_batch_follows_the_step() {
    on_the_gpu(|make| suite::training::steady_batch(make));
}

#[test]
fn assets_travel_with_checkpoints_and_models() {
    reproducibly(|make| suite::training::assets(make));
}

#[test]
fn a_run_that_ends_early_is_its_model() {
    reproducibly(|make| suite::training::finish_early(make));
}

#[test]
fn a_resumed_run_is_the_run_that_never_stopped() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    // With additions in f32 the device chooses their order, and thus the last bits.
    reproducibly(|make| suite::training::resume(make, &folder.path().join("checkpoint")));
}

#[test]
fn nothing_is_learned_from_ignored_pixels() {
    reproducibly(|make| suite::masks::garbage(make));
}

#[test]
fn a_pixel_weighs_as_much_as_is_kept_of_it() {
    reproducibly(|make| suite::masks::fractions(make));
}

#[test]
fn poor_photographs_are_no_failure() {
    on_the_gpu(|make| suite::training::poor_photographs(make));
}

#[test]
fn an_empty_grid_recovers() {
    reproducibly(|make| suite::training::empty_occupancy(make));
}

#[test]
fn slopes_by_log_gains_are_those_of_the_loss() {
    reproducibly(|make| suite::exposure::whole_step(make));
}

#[test]
fn gains_of_photographs_are_beside_the_model() {
    reproducibly(|make| suite::exposure::beside_the_model(make));
}

#[test]
fn drawn_samples_are_those_of_the_rule() {
    reproducibly(|make| suite::drawing::as_written(make));
}

#[test]
fn drawn_samples_have_the_gradient_of_all() {
    reproducibly(|make| suite::drawing::unbiased(make, 20));
}

#[test]
fn a_run_draws_the_fraction_of_its_schedule() {
    reproducibly(|make| suite::drawing::fraction(make));
}

#[test]
fn refined_poses_are_beside_the_model() {
    reproducibly(|make| suite::poses::beside_the_model(make));
}

#[test]
fn refined_poses_have_no_common_motion() {
    reproducibly(|make| suite::poses::without_a_common_motion(make));
}
