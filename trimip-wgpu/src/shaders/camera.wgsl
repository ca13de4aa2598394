// Cameras and the cones of their pixels; twin of `trimip_core::camera`. Needs `ray.wgsl`.

struct View {
    // Rows of the camera-to-world rotation, each followed by a component of the origin.
    pose: array<vec4<f32>, 3>,
    // fx, fy, cx, cy.
    intrinsics: vec4<f32>,
    // Radius of the pixel's disc on the plane at distance 1.
    disc: f32,
    width: u32,
    // Index of the view's first pixel.
    offset: u32,
    padding: u32,
}

// A cone in its camera's axes.
struct LocalCone {
    // Direction of the axis, of any length.
    axis: vec3<f32>,
    inverse_length: f32,
    slope: f32,
    cosine: f32,
}

// Radius of the sphere inscribed in a cone per unit of distance along its axis (Eq. 3 with f = 1).
fn sphere_slope(disc: f32, tangent: f32, cosine: f32) -> f32 {
    let inner = tangent - disc;
    return disc * cosine / sqrt(inner * inner + 1.0);
}

// The pinhole's cone of a square part of a pixel, given its centre and its side in pixels.
fn project(view: View, at: vec2<f32>, side: f32) -> LocalCone {
    let u = (at.x - view.intrinsics.z) / view.intrinsics.x;
    let v = -(at.y - view.intrinsics.w) / view.intrinsics.y;
    let tangent = sqrt(u * u + v * v);
    let cosine = 1.0 / sqrt(1.0 + tangent * tangent);
    let slope = sphere_slope(side * view.disc, tangent, cosine);
    return LocalCone(vec3<f32>(u, v, -1.0), cosine, slope, cosine);
}

// Cone number `index` of the side * side parts of a pixel.
fn cone_in(view: View, x: u32, y: u32, index: u32, side: u32) -> Ray {
    let part = 1.0 / f32(side);
    let within = vec2<f32>(f32(index % side), f32(index / side)) + 0.5;
    let cone = project(view, vec2<f32>(f32(x), f32(y)) + within * part, part);
    var ray: Ray;
    for (var i = 0u; i < 3u; i++) {
        let row = view.pose[i];
        ray.direction[i] = (row.x * cone.axis.x + row.y * cone.axis.y + row.z * cone.axis.z) * cone.inverse_length;
        ray.origin[i] = row.w;
    }
    ray.slope = cone.slope;
    ray.cosine = cone.cosine;
    return ray;
}
