// Cylindrical panoramas, as in `trimip_core::geometry::projections::dummy`.

// Returns the cone of a pixel, whose column is an angle and whose row is a height.
fn cone_dummy(view: View, at: vec2<f32>, side: f32) -> LocalCone {
    let place = (at - view.intrinsics.zw) / view.intrinsics.xy;
    let height = -place.y;
    if !(abs(place.x) <= PI) {
        return no_cone();
    }
    let s = sin(place.x);
    let c = cos(place.x);
    let across = 1.0 / sqrt(1.0 + height * height);
    let by_angle = across / view.intrinsics.x;
    let by_height = -across * across * across / view.intrinsics.y;
    return cone_of_ray(
        vec3<f32>(0.0),
        across * vec3<f32>(s, height, -c),
        array<vec3<f32>, 2>(vec3<f32>(0.0), vec3<f32>(0.0)),
        array<vec3<f32>, 2>(by_angle * vec3<f32>(c, 0.0, s), by_height * vec3<f32>(-height * s, 1.0, height * c)),
        side,
        1.0,
    );
}
