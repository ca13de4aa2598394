// Adds feature gradients to the gradients of ripmaps: one invocation adds four channels of one plane of one sample. The
// variant of `add_base` determines how values are added.

@group(0) @binding(0) var<storage, read> gradients: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;

@compute @workgroup_size(GROUP)
fn rip_add(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    let sample = i / (TEXEL_FOURS * params.planes);
    if sample >= counts[params.counter] {
        return;
    }
    let plane = i / TEXEL_FOURS % params.planes;
    let projection = project(gaussians[sample], plane, params.levels);
    let gradient = gradients[i];
    for (var which = 0u; which < 4u; which++) {
        let read = read_of(projection, which);
        if read.level_weight == 0.0 {
            continue;
        }
        let taps = read_taps(projection, plane, read.levels);
        for (var r = 0u; r < 2u; r++) {
            for (var c = 0u; c < 2u; c++) {
                let texel = read_texel(plane, read.levels, taps.rows[r], taps.columns[c]);
                let value = read.level_weight * tap_weight(taps, r, c) * gradient;
                for (var channel = 0u; channel < 4u; channel++) {
                    add_base(CHANNELS * texel + 4u * (i % TEXEL_FOURS) + channel, value[channel]);
                }
            }
        }
    }
}
