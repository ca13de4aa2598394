// Panoramas; mirrors `trimip_core::geometry::projections::equirectangular`.

// Returns the cone of a pixel, whose position gives a longitude and a latitude.
fn cone_equirectangular(view: View, at: vec2<f32>, side: f32) -> LocalCone {
    let angles = vec2<f32>(PI, -PI) * (at - view.intrinsics.zw) / view.intrinsics.xy;
    if !(abs(angles.y) <= 0.5 * PI) {
        return no_cone();
    }
    let s = sin(angles);
    let c = cos(angles);
    let by = PI / view.intrinsics.xy;
    return cone_of_ray(
        vec3<f32>(0.0),
        vec3<f32>(s.x * c.y, s.y, -c.x * c.y),
        array<vec3<f32>, 2>(vec3<f32>(0.0), vec3<f32>(0.0)),
        array<vec3<f32>, 2>(
            by.x * vec3<f32>(c.x * c.y, 0.0, s.x * c.y),
            by.y * vec3<f32>(s.x * s.y, -c.y, -c.x * s.y),
        ),
        side,
        1.0,
    );
}
