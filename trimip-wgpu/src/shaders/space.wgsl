// The map from the world to the unit cube; twin of `trimip_core::space`. Needs `ray.wgsl`.

const FAR: f32 = 3.0e38;

struct Space {
    aabb_min: vec3<f32>,
    // Cells along each side of the occupancy grid.
    resolution: u32,
    aabb_max: vec3<f32>,
    // Longest side of the box.
    longest: f32,
    // Quotients are computed on the host, exact to half an ulp; a device's own division may be less accurate.
    inverse_extent: vec3<f32>,
    padding: f32,
    cell_extent: vec3<f32>,
    more_padding: f32,
}

// The distances (enter, leave) between which a ray can have samples; enter >= leave if there are none.
fn intersect(space: Space, ray: Ray) -> vec2<f32> {
    var enter = 0.0;
    var leave = FAR;
    for (var i = 0u; i < 3u; i++) {
        let below = space.aabb_min[i] - ray.origin[i];
        let above = space.aabb_max[i] - ray.origin[i];
        if ray.direction[i] == 0.0 {
            if below > 0.0 || above < 0.0 {
                return vec2<f32>(0.0);
            }
        } else {
            let inverse = 1.0 / ray.direction[i];
            enter = max(enter, min(below * inverse, above * inverse));
            leave = min(leave, max(below * inverse, above * inverse));
        }
    }
    return vec2<f32>(enter, leave);
}

fn to_cube(space: Space, point: vec3<f32>) -> vec3<f32> {
    return (point - space.aabb_min) * space.inverse_extent;
}

fn to_world(space: Space, position: vec3<f32>) -> vec3<f32> {
    return space.aabb_min + position * (space.aabb_max - space.aabb_min);
}

// Factor by which the map scales a sphere's radius at a point.
fn radius_scale(space: Space, point: vec3<f32>) -> f32 {
    return 1.0;
}

// The sphere of a ray at distance `t`: its centre in the cube, and its radius.
fn sphere_at(space: Space, ray: Ray, t: f32) -> vec4<f32> {
    let point = ray.origin + t * ray.direction;
    return vec4<f32>(to_cube(space, point), ray.slope * t * radius_scale(space, point));
}

// Cell of a position.
fn cell_of(space: Space, position: vec3<f32>) -> vec3<u32> {
    let scaled = position * f32(space.resolution);
    return min(vec3<u32>(max(scaled, vec3<f32>(0.0))), vec3<u32>(space.resolution - 1u));
}

// Distance beyond `t` at which a ray leaves the aligned cube of `size` cells that contains `cell`; FAR if it cannot
// be computed.
fn cells_exit(space: Space, ray: Ray, t: f32, cell: vec3<u32>, size: u32) -> f32 {
    var leave = FAR;
    for (var axis = 0u; axis < 3u; axis++) {
        if ray.direction[axis] == 0.0 {
            continue;
        }
        let lower = cell[axis] / size * size;
        let edge = f32(select(lower, lower + size, ray.direction[axis] > 0.0));
        let place = edge * space.cell_extent[axis] + space.aabb_min[axis];
        let distance = (place - ray.origin[axis]) / ray.direction[axis];
        if distance > t && distance < leave {
            leave = distance;
        }
    }
    return leave;
}
