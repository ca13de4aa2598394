// Orthographic images; mirrors `trimip_core::geometry::projections::orthographic`.

// Returns the cone of a pixel. The rays are parallel, so it is a cylinder.
fn cone_orthographic(view: View, at: vec2<f32>, side: f32) -> LocalCone {
    let place = (at - view.intrinsics.zw) / view.intrinsics.xy;
    let by = 1.0 / view.intrinsics.xy;
    return cone_of_ray(
        vec3<f32>(place.x, -place.y, 0.0),
        vec3<f32>(0.0, 0.0, -1.0),
        array<vec3<f32>, 2>(vec3<f32>(by.x, 0.0, 0.0), vec3<f32>(0.0, -by.y, 0.0)),
        array<vec3<f32>, 2>(vec3<f32>(0.0), vec3<f32>(0.0)),
        side,
        1.0,
    );
}
