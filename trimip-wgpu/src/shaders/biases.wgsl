// Biases of a layer with rows of `width` outputs: `spread` writes the biases to every row, `sum_rows` adds up the rows
// of a gradient in chunks.

@group(0) @binding(0) var<storage, read> source: array<f32>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read_write> rows: array<f32>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;

@compute @workgroup_size(GROUP)
fn spread(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i < counts[params.counter] * params.width {
        rows[i] = source[i % params.width];
    }
}

// One invocation per column of a chunk; there are as many chunks as for weight gradients.
@compute @workgroup_size(GROUP)
fn sum_rows(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.chunks * params.width {
        return;
    }
    let count = counts[params.counter];
    let chunk = i / params.width;
    let column = i % params.width;
    let per_chunk = (count + params.chunks - 1u) / params.chunks;
    let end = min((chunk + 1u) * per_chunk, count);
    var sum = 0.0;
    for (var row = chunk * per_chunk; row < end; row++) {
        sum += source[row * params.width + column];
    }
    rows[chunk * params.stride + column] = sum;
}
