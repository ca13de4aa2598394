// Adds feature gradients to the gradients of entries: one invocation per level of a sample. The variant of `add_base`
// determines how values are added.

@group(0) @binding(0) var<storage, read> gradients: array<f32>;
@group(0) @binding(1) var<storage, read> points: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;

@compute @workgroup_size(GROUP)
fn hash_add(
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
    let row = sample * params.stride + level * FEATURES;
    for (var p = 0u; p < POINTS; p++) {
        let point = points[POINTS * sample + p];
        let level_weight = downweight(levels[level].scale, point.w);
        let cell = cell_around(levels[level].scale, point.xyz);
        for (var corner = 0u; corner < 8u; corner++) {
            let weight = level_weight * corner_weight(cell, corner);
            let entry = corner_entry(levels[level], cell, corner);
            for (var f = 0u; f < FEATURES; f++) {
                add_base(entry * FEATURES + f, weight * gradients[row + f]);
            }
        }
    }
}
