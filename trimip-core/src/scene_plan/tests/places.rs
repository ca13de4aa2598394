//! What the plan decides for places: thin surfaces, and colours that see directions late.

use super::{planned, views, views_of};
use crate::Config;

#[test]
fn places_have_thin_surfaces_and_objects_keep_their_settings() {
    let of = |alpha: bool, set: &[&str]| {
        let config = planned(&views(alpha), set).unwrap().0;
        (config.loss.distortion, config.renderer.min_transmittance, config.renderer.min_weight)
    };
    let Config { loss, renderer, .. } = Config::default();
    let defaults = (loss.distortion, renderer.min_transmittance, renderer.min_weight);
    assert_eq!(of(false, &[]), (0.005, 0.02, 0.002));
    // Where colours see directions from the start, as much distortion would move density in front of the cameras.
    assert_eq!(of(false, &["plan.direction_delay=off"]), (0.001, 0.02, 0.002));
    assert_eq!(of(false, &["renderer.min_weight=0.01"]), (0.005, 0.02, 0.01), "what is given stays");
    for (alpha, set) in
        [(true, &[][..]), (false, &["scene.contraction=none"]), (false, &["plan.surfaces=off"])]
    {
        assert_eq!(of(alpha, set), defaults, "{set:?}");
    }
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
