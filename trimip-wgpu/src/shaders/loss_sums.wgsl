// Adds the sums of the workgroups of `evaluate` in order.

@group(0) @binding(2) var<uniform> params: Params;
// Loss, weight, squared error, number of non-finite pixels.
@group(0) @binding(4) var<storage, read_write> partial: array<vec4<f32>>;
// These four sums over the step, as bits; then the numbers of samples marched and kept, of samples dropped from both for lack of room, and
// of samples with a backward pass: all kept ones, unless samples are drawn. Counts are not stored as floats: the bits of small counts are
// denormal, and a device may flush them to zero.
@group(0) @binding(5) var<storage, read_write> sums: array<u32>;
@group(0) @binding(6) var<storage, read> counts: array<u32>;

@compute @workgroup_size(GROUP)
fn add_up(@builtin(local_invocation_index) local: u32) {
    var own = vec4<f32>(0.0);
    for (var i = local; i < params.blocks; i += GROUP) {
        own += partial[i];
    }
    let sum = workgroup_sum(local, own);
    if local == 0u {
        for (var c = 0u; c < 4u; c++) {
            sums[c] = bitcast<u32>(sum[c]);
            sums[4u + c] = counts[c];
        }
        sums[8] = counts[1];
    }
}
