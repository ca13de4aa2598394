// Reads ripmaps: one invocation gathers four channels of one plane for one sample.

@group(0) @binding(0) var<storage, read> maps: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> features: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;

@compute @workgroup_size(GROUP)
fn rip_read(
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
    var sum = vec4<f32>(0.0);
    for (var which = 0u; which < 4u; which++) {
        let read = read_of(projection, which);
        if read.level_weight == 0.0 {
            continue;
        }
        let taps = read_taps(projection, plane, read.levels);
        for (var r = 0u; r < 2u; r++) {
            for (var c = 0u; c < 2u; c++) {
                let texel = read_texel(plane, read.levels, taps.rows[r], taps.columns[c]);
                sum += read.level_weight * tap_weight(taps, r, c) * maps[TEXEL_FOURS * texel + i % TEXEL_FOURS];
            }
        }
    }
    features[i] = sum;
}
