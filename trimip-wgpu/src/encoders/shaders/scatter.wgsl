// Adds feature gradients to texel gradients of all levels: one invocation adds four channels of one plane of one
// sample. The variant of `add_base` and `add_derived` determines how values are added, and declares the buffers `base`
// and `derived`.

@group(0) @binding(0) var<storage, read> gradients: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read> spheres: array<vec4<f32>>;
@group(0) @binding(2) var<uniform> pyramid: Pyramid;
@group(0) @binding(5) var<storage, read> counts: array<u32>;

@compute @workgroup_size(GROUP)
fn scatter(
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
    let gradient = gradients[sample * (pyramid.stride / 4u) + i % FOURS];
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
                let texel = start + taps.rows[r] * shape.x + taps.columns[c];
                let value = level_weight * tap_weight(taps, r, c) * gradient;
                for (var channel = 0u; channel < 4u; channel++) {
                    let place = CHANNELS * texel + 4u * part + channel;
                    if level == 0u {
                        add_base(place, value[channel]);
                    } else {
                        add_derived(place, value[channel]);
                    }
                }
            }
        }
    }
}
