// Cameras and the cones of their pixels; mirrors `trimip_core::geometry::camera`. Needs `cone_of_model` from the registry of
// camera models (`projections.rs`).

const PI: f32 = 3.14159265358979;

// A cone in its camera's axes.
struct LocalCone {
    // Start of the cone's ray: the origin, unless the camera's rays are parallel.
    origin: vec3<f32>,
    // Radius of the sphere at `origin`.
    radius: f32,
    // Direction of the axis, of any length.
    axis: vec3<f32>,
    inverse_length: f32,
    slope: f32,
    cosine: f32,
}

// Returns the cone of a camera whose rays meet at the origin.
fn central_cone(axis: vec3<f32>, inverse_length: f32, slope: f32, cosine: f32) -> LocalCone {
    return LocalCone(vec3<f32>(0.0), 0.0, axis, inverse_length, slope, cosine);
}

// Returns the cone of a pixel without a ray: it has no direction and meets nothing.
fn no_cone() -> LocalCone {
    return central_cone(vec3<f32>(0.0), 1.0, 0.0, 0.0);
}

// Returns the cone of a square part of a pixel, computed from the derivatives of its ray with respect to the position
// in the image; mirrors `LocalRay::cone`.
fn cone_of_ray(
    origin: vec3<f32>,
    direction: vec3<f32>,
    origin_by: array<vec3<f32>, 2>,
    direction_by: array<vec3<f32>, 2>,
    side: f32,
    cosine: f32,
) -> LocalCone {
    let areas = vec2<f32>(
        abs(dot(cross(origin_by[0], origin_by[1]), direction)),
        abs(dot(cross(direction_by[0], direction_by[1]), direction)),
    );
    let sizes = side * sqrt(areas / PI);
    return LocalCone(origin, sizes.x, direction, 1.0, sizes.y, cosine);
}

// Returns the cone of a square part of a pixel, given the part's centre and its side in pixels. The cone of a pixel
// without a ray has no direction.
fn project(view: View, at: vec2<f32>, side: f32) -> LocalCone {
    if view.lens == 0u {
        return cone_through((at - view.intrinsics.zw) / view.intrinsics.xy, side * view.disc);
    }
    return cone_of_model(view, at, side);
}

// Returns the number of cones of a pixel.
fn cones_in(side: u32) -> u32 {
    return select(side * side, 5u, side == QUINCUNX);
}

// Returns cone number `index` of a pixel that is divided into side * side parts, or into a quincunx.
fn cone_in(view: View, x: u32, y: u32, index: u32, side: u32) -> Ray {
    var part = 1.0 / f32(side);
    var within = part * (vec2<f32>(f32(index % side), f32(index / side)) + 0.5);
    if side == QUINCUNX {
        part = 1.0;
        within = vec2<f32>(0.5);
        if index > 0u {
            within = vec2<f32>(select(0.25, 0.75, index % 2u == 0u), select(0.25, 0.75, index > 2u));
        }
    }
    let cone = project(view, vec2<f32>(f32(x), f32(y)) + within, part);
    var ray: Ray;
    for (var i = 0u; i < 3u; i++) {
        let row = view.pose[i];
        ray.direction[i] = (row.x * cone.axis.x + row.y * cone.axis.y + row.z * cone.axis.z) * cone.inverse_length;
        ray.origin[i] = row.w;
        if cone.radius > 0.0 {
            ray.origin[i] += row.x * cone.origin.x + row.y * cone.origin.y + row.z * cone.origin.z;
        }
    }
    ray.radius = cone.radius;
    ray.slope = cone.slope;
    ray.cosine = cone.cosine;
    return ray;
}
