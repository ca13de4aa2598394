// Mirrors `trimip_core::field::encoders::frequencies`: one invocation writes the features of one sample.

@group(0) @binding(0) var<storage, read> rays: array<Ray>;
@group(0) @binding(1) var<storage, read> owners: array<u32>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> intervals: array<vec2<f32>>;
@group(0) @binding(4) var<storage, read_write> features: array<f32>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;
@group(0) @binding(6) var<storage, read> spheres: array<vec4<f32>>;

// Reduces an angle to about [-π, π], because drivers compute inaccurate sines of large angles. Multiples of 2π are
// subtracted in two parts, for precision.
fn reduced(angle: f32) -> f32 {
    let turns = round(angle * 0.15915494);
    return (angle - turns * 6.28125) - turns * 1.9353072e-3;
}

@compute @workgroup_size(GROUP)
fn frequencies(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= counts[params.counter] {
        return;
    }
    let sphere = spheres[i];
    var mean = (sphere.xyz - 0.5) * params.extent;
    var variance = vec3<f32>(0.0);
    if params.integrated != 0u {
        let ray = rays[owners[i]];
        let direction = ray.direction;
        let interval = vec2<f32>(apex_distance(ray, intervals[i].x), intervals[i].y);
        let wide = vec4<f32>(sphere.xyz, params.radius * sphere.w);
        let own = gaussian_of(wide, params.extent, direction, interval);
        mean = (own.mean - 0.5) * params.extent;
        variance = own.along * direction * direction + own.across * (1.0 - direction * direction);
    }
    var at = params.stride * i;
    if params.identity != 0u {
        for (var axis = 0u; axis < 3u; axis++) {
            features[at] = mean[axis];
            at++;
        }
    }
    var factor = 1.0;
    for (var k = 0u; k < params.count; k++) {
        for (var axis = 0u; axis < 3u; axis++) {
            let angle = reduced(factor * mean[axis]);
            let attenuation = exp(-0.5 * factor * factor * variance[axis]);
            features[at + axis] = attenuation * sin(angle);
            features[at + 3u + axis] = attenuation * cos(angle);
        }
        at += 6u;
        factor *= 2.0;
    }
    for (; at < params.stride * (i + 1u); at++) {
        features[at] = 0.0;
    }
}
