//! Tests of decisions for places (scenes in contracted space) and for objects: thin surfaces, samples that merge, and
//! delayed view dependence.

use super::{planned, views, views_of};

#[test]
fn places_have_thin_surfaces_and_faint_samples_merge() {
    let of = |alpha: bool, set: &[&str]| {
        let config = planned(&views(alpha), set).unwrap().0;
        (config.loss.distortion, config.renderer.min_weight)
    };
    assert_eq!(of(false, &[]), (0.005, 0.01));
    // If colours depend on the view from the start, the same distortion weight would move density in front of the cameras.
    assert_eq!(of(false, &["plan.direction_delay=off"]), (0.001, 0.01));
    assert_eq!(of(false, &["renderer.min_weight=0.002"]), (0.005, 0.002), "what is given stays");
    for (alpha, set) in [(true, &[][..]), (false, &["scene.contraction=none"])] {
        assert_eq!(of(alpha, set), (0.0, 0.01), "{set:?}");
    }
    assert_eq!(of(false, &["plan.surfaces=off"]), (0.0, 0.0));
    assert_eq!(of(true, &["renderer.min_weight=0.0"]), (0.0, 0.0), "what is given stays");
}

#[test]
fn colours_of_places_in_few_photographs_see_directions_late() {
    let of = |alpha: bool, set: &[&str]| planned(&views(alpha), set).unwrap().0.field.direction_delay;
    assert_eq!(of(false, &[]), 0.2);
    assert_eq!(of(false, &["field.direction_delay=0.1"]), 0.1, "what is given stays");
    for (alpha, set) in [
        (true, &[][..]),
        (false, &["scene.contraction=none"]),
        (false, &["field.directions=false"]),
        (false, &["plan.direction_delay=off"]),
    ] {
        assert_eq!(of(alpha, set), 0.0, "{set:?}");
    }
    let many = planned(&views_of(false, 60), &[]).unwrap().0;
    assert_eq!(many.field.direction_delay, 0.0, "places are seen from many sides");
}
