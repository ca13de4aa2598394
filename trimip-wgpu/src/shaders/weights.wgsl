// Converts between parameters [inputs, outputs] and padded matrices. `pack` writes a layer's matrix and its transpose;
// `reduce` adds up the chunks of a weight gradient and drops the padding.

@group(0) @binding(0) var<storage, read> source: array<f32>;
@group(0) @binding(1) var<storage, read_write> forward: array<Weight>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read_write> backward: array<Weight>;

@compute @workgroup_size(GROUP)
fn pack(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.k * params.n {
        return;
    }
    let row = i / params.n;
    let column = i % params.n;
    var value = 0.0;
    let offset = select(0u, 1u, params.ones > 0u);
    if row < params.ones {
        value = select(0.0, 1.0, column == 0u);
    } else if row < params.ones + params.inputs && column >= offset && column < offset + params.outputs {
        value = source[params.start + (row - params.ones) * params.outputs + column - offset];
    }
    forward[i] = weight_of(value);
    backward[column * params.k + row] = weight_of(value);
}

@compute @workgroup_size(GROUP)
fn reduce(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.inputs * params.outputs {
        return;
    }
    let offset = select(0u, 1u, params.ones > 0u);
    let at = (params.ones + i / params.outputs) * params.n + offset + i % params.outputs;
    var sum = 0.0;
    for (var chunk = 0u; chunk < params.chunks; chunk++) {
        sum += source[chunk * params.k * params.n + at];
    }
    forward[params.start + i] = Weight(params.scale * sum);
}
