// Fisheye images; mirrors `trimip_core::geometry::projections::fisheye`. Needs `perspective.wgsl`.

// Returns the cone of a fisheye's pixel.
fn cone_fisheye(view: View, at: vec2<f32>, side: f32) -> LocalCone {
    let unbent = unbend(view, (at - view.intrinsics.zw) / view.intrinsics.xy);
    if !(unbent.area > 0.0) {
        return no_cone();
    }
    let own = side * view.disc / sqrt(unbent.area);
    let angle = length(unbent.at);
    let narrower = select(1.0, sin(angle) / angle, angle > 1e-3);
    let across = unbent.at * narrower;
    return central_cone(vec3<f32>(across.x, -across.y, -cos(angle)), 1.0, own * sqrt(narrower), cos(angle));
}
