// Gradients with respect to camera poses; mirrors `trimip_core::engine::policy::poses` and the CPU's stage. Each ray
// and its samples are moved by the ray's radius along a random direction perpendicular to the ray, to both sides.

@group(0) @binding(0) var<storage, read> rays: array<Ray>;
@group(0) @binding(1) var<storage, read_write> displaced_rays: array<Ray>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> owners: array<u32>;
@group(0) @binding(4) var<storage, read> intervals: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read> spheres: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> displaced_spheres: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> counts: array<u32>;
@group(0) @binding(8) var<storage, read> features: array<f32>;
@group(0) @binding(9) var<storage, read> feature_gradients: array<f32>;
// Slope of the loss along the displacement of each sample.
@group(0) @binding(10) var<storage, read_write> slopes: array<f32>;
@group(0) @binding(11) var<storage, read> segments: array<vec2<u32>>;
// First cone and number of cones of each pixel.
@group(0) @binding(12) var<storage, read> pixel_groups: array<vec2<u32>>;
@group(0) @binding(13) var<storage, read> photographs: array<u32>;
// Twelve sums of each photograph in fixed point: the low and the high word of each.
@group(0) @binding(14) var<storage, read_write> sums: array<atomic<u32>>;

// Returns a random unit vector perpendicular to ray `i` of the tile.
fn direction_across(i: u32, direction: vec3<f32>) -> vec3<f32> {
    let bits = random_bits(params.draws, params.first + i);
    var place = vec2<f32>(0.0);
    for (var k = 0u; k < 4u; k++) {
        place = (vec2<f32>(f32(bits[k] >> 16u), f32(bits[k] & 0xffffu)) + 0.5) / 32768.0 - 1.0;
        if dot(place, place) <= 1.0 {
            break;
        }
    }
    let basis = across(direction);
    return (place.x * basis[0] + place.y * basis[1]) / length(place);
}

@compute @workgroup_size(GROUP)
fn displace_rays(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    var ray = rays[i];
    let by = params.side * direction_across(i, ray.direction);
    ray.origin += ray.radius * by;
    ray.direction += ray.slope * by;
    displaced_rays[i] = ray;
}

@compute @workgroup_size(GROUP)
fn displace_spheres(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= counts[params.counter] {
        return;
    }
    let ray = displaced_rays[owners[i]];
    let place = to_cube(params.space, ray.origin + intervals[i].x * ray.direction);
    displaced_spheres[i] = vec4<f32>(clamp(place, vec3<f32>(0.0), vec3<f32>(1.0)), spheres[i].w);
}

@compute @workgroup_size(GROUP)
fn compare(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= counts[params.counter] {
        return;
    }
    var product = 0.0;
    for (var k = params.stride * i; k < params.stride * i + params.width; k++) {
        product += features[k] * feature_gradients[k];
    }
    if params.side > 0.0 {
        slopes[i] = product;
    } else {
        slopes[i] -= product;
    }
}

fn add_to(at: u32, value: f32) {
    if value == 0.0 || !fits(value) {
        return;
    }
    let words = to_fixed(value);
    let before = atomicAdd(&sums[at], words.x);
    let high = words.y + select(0u, 1u, before + words.x < before);
    if high != 0u {
        atomicAdd(&sums[at + 1u], high);
    }
}

@compute @workgroup_size(GROUP)
fn add_poses(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    let cones = pixel_groups[i];
    var force = vec3<f32>(0.0);
    var torque = vec3<f32>(0.0);
    var turned = vec3<f32>(0.0);
    var bent = vec3<f32>(0.0);
    for (var cone = cones.x; cone < cones.x + cones.y; cone++) {
        let ray = rays[cone];
        let segment = segments[cone];
        var own = 0.0;
        var lever = 0.0;
        for (var j = segment.x; j < segment.x + segment.y; j++) {
            let t = intervals[j].x;
            let slope = slopes[j] / (ray.radius + ray.slope * t);
            own += slope;
            lever += t * slope;
        }
        let by = direction_across(cone, ray.direction);
        force += own * by;
        torque += cross(own * ray.origin + lever * ray.direction, by);
        turned += ray.cosine * lever * by;
        bent += (1.0 / (ray.cosine * ray.cosine) - 1.0) * ray.cosine * lever * by;
    }
    let at = SUM_WORDS * photographs[i];
    for (var axis = 0u; axis < 3u; axis++) {
        add_to(at + 2u * axis, force[axis]);
        add_to(at + 2u * (3u + axis), torque[axis]);
        add_to(at + 2u * (6u + axis), turned[axis]);
        add_to(at + 2u * (9u + axis), bent[axis]);
    }
}
