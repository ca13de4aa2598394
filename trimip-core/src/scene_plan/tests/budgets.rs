//! Tests of decisions that follow the number of rays per pixel within a budget.

use super::{planned, views};

#[test]
fn pixels_that_a_budget_sees_rarely_are_drawn_by_their_errors() {
    let views = views(true);
    let pixels = views.pixels.len() as u64;
    let of = |samples: u64, set: &[&str]| {
        let steps = format!("train.steps={}", samples / 256);
        let set = [&[steps.as_str(), "train.samples_per_step=256"], set].concat();
        planned(&views, &set).unwrap().0.train.error_map.at(0.5)
    };
    assert_eq!((of(5 * pixels, &[]), of(7 * pixels, &[])), (0.8, 0.0));
    // Rays in contracted space keep more samples.
    let place = ["scene.contraction=ball", "plan.encoder=off"];
    assert_eq!((of(14 * pixels, &place), of(16 * pixels, &place)), (0.8, 0.0));
    assert_eq!(of(3 * pixels, &["train.error_map=0.3"]), 0.3, "what is given stays");
    assert_eq!(of(3 * pixels, &["plan.error_map=off"]), 0.0);
    let mut others = views.clone();
    others.views[0].name = "another".into();
    let set = ["train.steps=1", "train.samples_per_step=256"];
    assert_eq!(planned(&others, &set).unwrap().0.train.error_map.at(0.5), 0.0);
}

#[test]
fn coarse_scales_come_first_where_a_budget_sees_few_pixels() {
    let views = views(true);
    let of = |per_pixel: f64, set: &[&str]| {
        let steps = format!("train.steps={}", (2.0 * per_pixel * views.pixels.len() as f64 / 256.0) as u64);
        let train = planned(&views, &[&[steps.as_str(), "train.samples_per_step=256"], set].concat())
            .unwrap()
            .0
            .train;
        (train.finest_scale.at(0.2), train.finest_scale.at(0.8), train.scale_weighting.at(0.2))
    };
    assert_eq!((of(0.09, &[]), of(0.11, &[])), ((1.0, 0.0, 1.0), (0.0, 0.0, 0.5)));
    assert_eq!(of(0.09, &["train.finest_scale=2"]).2, 0.5, "what is given stays");
    assert_eq!(of(0.09, &["plan.coarse_to_fine=off"]).0, 0.0);
}
