// Adds the errors of a training step's pixels to the pixels' cells in the error map; mirrors `error_map::error_of`.
// Needs `cell_of`.

@group(0) @binding(5) var<storage, read> targets: array<f32>;
@group(0) @binding(11) var<storage, read> gradients: array<vec4<f32>>;
// For each cell: low and high word of the sum of errors, number of pixels, and a word that stays 0.
@group(0) @binding(12) var<storage, read_write> errors: array<atomic<u32>>;

@compute @workgroup_size(GROUP)
fn observe(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    let weight = targets[TARGET_FLOATS * i + TARGET_WEIGHT];
    if !(weight > 0.0) {
        return;
    }
    let slopes = 3.0 * gradients[i].rgb / weight;
    let error = dot(slopes, slopes) / 3.0;
    let own = u32(select(MOST_ERROR, error, error < MOST_ERROR) * UNIT);
    let at = 4u * cell_of(random_bits(params.draws, params.first + i).x);
    let before = atomicAdd(&errors[at], own);
    if before + own < before {
        atomicAdd(&errors[at + 1u], 1u);
    }
    atomicAdd(&errors[at + 2u], 1u);
}
