// Trilinear reads: one invocation reads one level for one sample.

@group(0) @binding(0) var<storage, read> entries: array<f32>;
// The points of samples: position in the unit cube, then standard deviation in units of the box's longest side.
@group(0) @binding(1) var<storage, read> points: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> features: array<f32>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;

@compute @workgroup_size(GROUP)
fn hash_read(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    let sample = i / params.levels;
    if sample >= counts[params.counter] {
        return;
    }
    let level = i % params.levels;
    var sum: array<f32, FEATURES>;
    for (var p = 0u; p < POINTS; p++) {
        let point = points[POINTS * sample + p];
        let level_weight = downweight(levels[level].scale, point.w);
        let cell = cell_around(levels[level].scale, point.xyz);
        for (var corner = 0u; corner < 8u; corner++) {
            let weight = level_weight * corner_weight(cell, corner);
            let entry = corner_entry(levels[level], cell, corner);
            for (var f = 0u; f < FEATURES; f++) {
                sum[f] += weight * entries[entry * FEATURES + f];
            }
        }
    }
    let row = sample * params.stride;
    for (var f = 0u; f < FEATURES; f++) {
        features[row + level * FEATURES + f] = sum[f];
    }
    // Columns beyond the encoder's width become zero.
    if level + 1u == params.levels {
        for (var at = params.levels * FEATURES; at < params.stride; at++) {
            features[row + at] = 0.0;
        }
    }
}
