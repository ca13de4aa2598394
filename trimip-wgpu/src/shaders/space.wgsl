// The map from the world to the unit cube; mirrors `trimip_core::geometry::space`.

// Maps distances along a ray to the parameter of its steps. In a bounded space (`speed` is 0), the parameter is the
// distance.
struct RayParameter {
    // Parameters between which the ray can have samples; enter >= leave if it cannot have any.
    enter: f32,
    leave: f32,
    middle: f32,
    reach: f32,
    speed: f32,
}

// Returns the distances (enter, leave) between which a ray can have samples; enter >= leave if it cannot have any.
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

fn centre_of(space: Space) -> vec3<f32> {
    return 0.5 * (space.aabb_min + space.aabb_max);
}

// Returns the parameterisation of a ray.
fn parameterisation_of(space: Space, ray: Ray) -> RayParameter {
    if space.ball == 0.0 {
        let hit = intersect(space, ray);
        return RayParameter(hit.x, hit.y, 0.0, 0.0, 0.0);
    }
    let u = (ray.origin - centre_of(space)) / space.ball;
    let middle = -dot(u, ray.direction);
    let b = length(u + middle * ray.direction);
    let reach = max(b, 1.0);
    let half = sqrt(max(FARTHEST * FARTHEST - b * b, 0.0));
    var parameterisation = RayParameter(0.0, 0.0, space.ball * middle, space.ball * reach, (2.0 * reach - 1.0) / (reach * reach));
    parameterisation.enter = parameter_at(parameterisation, 0.0);
    parameterisation.leave = parameter_at(parameterisation, space.ball * (middle + half));
    return parameterisation;
}

// Returns the ray parameter at distance `t`, in a contracted space.
fn parameter_at(parameterisation: RayParameter, t: f32) -> f32 {
    let m = (t - parameterisation.middle) / parameterisation.reach;
    let contracted = select(m, sign(m) * (2.0 - 1.0 / abs(m)), abs(m) > 1.0);
    return parameterisation.speed * parameterisation.reach * contracted;
}

// Returns the distance at the ray parameter `s`.
fn distance_at(parameterisation: RayParameter, s: f32) -> f32 {
    if parameterisation.speed == 0.0 {
        return s;
    }
    let c = s / (parameterisation.speed * parameterisation.reach);
    let m = select(c, sign(c) / (2.0 - abs(c)), abs(c) > 1.0);
    return parameterisation.middle + parameterisation.reach * m;
}

// Returns the length of a step of the ray parameter at distance `t`, in the units of the field's density.
fn length_at(space: Space, parameterisation: RayParameter, ray: Ray, t: f32, step: f32) -> f32 {
    if parameterisation.speed == 0.0 {
        return step;
    }
    let m = max(abs((t - parameterisation.middle) / parameterisation.reach), 1.0);
    let n = distance_from_ball(space, ray.origin + t * ray.direction);
    return step * (m * m / parameterisation.speed) / (n * n);
}

// Returns the ray parameter of a sample at distance `t`, and the parameter's increase over the sample, both in units of the
// box's longest side. `length` is the sample's length in the units of the field's density.
fn along(space: Space, parameterisation: RayParameter, ray: Ray, t: f32, length: f32) -> vec2<f32> {
    if parameterisation.speed == 0.0 {
        return vec2<f32>(t, length) / space.longest;
    }
    let step = length / length_at(space, parameterisation, ray, t, 1.0);
    return vec2<f32>(parameter_at(parameterisation, t), step) / space.longest;
}

// Returns the distance from a point to the ball's centre, in radii of the ball, at least 1.
fn distance_from_ball(space: Space, point: vec3<f32>) -> f32 {
    return max(length((point - centre_of(space)) / space.ball), 1.0);
}

fn to_cube(space: Space, point: vec3<f32>) -> vec3<f32> {
    var place = point;
    if space.ball > 0.0 {
        let centre = centre_of(space);
        let n = distance_from_ball(space, point);
        place = centre + (2.0 - 1.0 / n) / n * (point - centre);
    }
    return (place - space.aabb_min) * space.inverse_extent;
}

fn to_world(space: Space, position: vec3<f32>) -> vec3<f32> {
    let place = space.aabb_min + position * (space.aabb_max - space.aabb_min);
    if space.ball == 0.0 {
        return place;
    }
    let centre = centre_of(space);
    let m = length((place - centre) / space.ball);
    let n = 1.0 / max(2.0 - m, 1.0 / FARTHEST);
    return select(place, centre + n / m * (place - centre), m > 1.0);
}

// Returns the factor by which the map scales a sphere's radius at a point.
fn radius_scale(space: Space, point: vec3<f32>) -> f32 {
    if space.ball == 0.0 {
        return 1.0;
    }
    let n = distance_from_ball(space, point);
    return (2.0 * n - 1.0) / (n * n);
}

// Returns the sphere of a ray at distance `t`: its centre in the cube, and its radius.
fn sphere_at(space: Space, ray: Ray, t: f32) -> vec4<f32> {
    let point = ray.origin + t * ray.direction;
    return vec4<f32>(to_cube(space, point), (ray.radius + ray.slope * t) * radius_scale(space, point));
}

// Returns the cell of a position.
fn cell_of(space: Space, position: vec3<f32>) -> vec3<u32> {
    let scaled = position * f32(space.resolution);
    return min(vec3<u32>(max(scaled, vec3<f32>(0.0))), vec3<u32>(space.resolution - 1u));
}

// Returns the distance up to which a ray stays within the aligned cube of `size` cells that contains `cell`, minus the
// possible rounding error. The ray must pass through `cell` before that distance. Returns FAR if the distance cannot be
// computed.
fn cells_exit(space: Space, ray: Ray, cell: vec3<u32>, size: u32) -> f32 {
    var leave = FAR;
    for (var axis = 0u; axis < 3u; axis++) {
        if ray.direction[axis] == 0.0 {
            continue;
        }
        let lower = cell[axis] / size * size;
        let edge = f32(select(lower, lower + size, ray.direction[axis] > 0.0));
        let place = edge * space.cell_extent[axis] + space.aabb_min[axis];
        let rounding = ROUNDING * (abs(place) + abs(ray.origin[axis])) / abs(ray.direction[axis]);
        let distance = (place - ray.origin[axis]) / ray.direction[axis] - rounding;
        if distance < leave {
            leave = distance;
        }
    }
    return leave;
}

// Returns a ray parameter beyond `s` up to which a ray in a contracted space stays within the aligned cube of `size`
// cells that contains `cell`, the cell of `position`.
fn cells_clear(space: Space, s: f32, position: vec3<f32>, cell: vec3<u32>, size: u32) -> f32 {
    let within = position * f32(space.resolution) - vec3<f32>(cell / size * size);
    let margin = min(within, f32(size) - within);
    return s + max(min(margin.x, min(margin.y, margin.z)), 0.0) * space.cell / STRETCH;
}
