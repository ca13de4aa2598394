// Tri-mip encoding: one invocation gathers four channels of one plane for one sample.

@group(0) @binding(0) var<storage, read> planes: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read> derived: array<vec4<f32>>;
@group(0) @binding(2) var<uniform> pyramid: Pyramid;
@group(0) @binding(3) var<storage, read> spheres: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> features: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;

fn texel(level: u32, index: u32) -> vec4<f32> {
    if level == 0u {
        return planes[index];
    }
    return derived[index];
}

@compute @workgroup_size(GROUP)
fn encode(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    let sample = i / FOURS;
    if sample >= counts[pyramid.counter] {
        return;
    }
    let plane = i % FOURS / TEXEL_FOURS;
    let part = i % TEXEL_FOURS;
    let sphere = spheres[sample];
    let at = plane_axes(sphere.xyz, plane);
    let blend = blend_levels(pyramid, plane, log2(sphere.w));
    var sum = vec4<f32>(0.0);
    for (var upper = 0u; upper < 2u; upper++) {
        let level_weight = select(1.0 - blend.fraction, blend.fraction, upper == 1u);
        if level_weight == 0.0 {
            continue;
        }
        let level = blend.lower + upper;
        let shape = plane_shape(pyramid.sides >> vec3<u32>(level), plane);
        let start = level_start(pyramid, level, plane);
        let taps = texel_taps(shape, at);
        for (var r = 0u; r < 2u; r++) {
            for (var c = 0u; c < 2u; c++) {
                let index = start + taps.rows[r] * shape.x + taps.columns[c];
                sum += level_weight * tap_weight(taps, r, c) * texel(level, TEXEL_FOURS * index + part);
            }
        }
    }
    let row = sample * (pyramid.stride / 4u);
    features[row + i % FOURS] = sum;
    // The mip level is an additional feature; columns beyond it become zero.
    if i % FOURS == FOURS - 1u && pyramid.level_input == 1u {
        features[row + FOURS] = vec4<f32>(level_feature(log2(sphere.w), pyramid.reference), 0.0, 0.0, 0.0);
        for (var at = FOURS + 1u; at < pyramid.stride / 4u; at++) {
            features[row + at] = vec4<f32>(0.0);
        }
    }
}
