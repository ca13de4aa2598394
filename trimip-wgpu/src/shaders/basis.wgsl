// Returns two unit vectors that are orthogonal to the unit vector `d` and to each other; mirrors
// `trimip_core::math::basis`.
fn across(d: vec3<f32>) -> array<vec3<f32>, 2> {
    let side = select(1.0, -1.0, d.z < 0.0);
    let a = -1.0 / (side + d.z);
    let b = d.x * d.y * a;
    return array<vec3<f32>, 2>(
        vec3<f32>(1.0 + side * d.x * d.x * a, side * b, -side * d.x),
        vec3<f32>(b, side + d.y * d.y * a, -d.y),
    );
}
