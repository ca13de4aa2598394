// Adds up the sums of the workgroups of `evaluate` in order.

@group(0) @binding(2) var<uniform> params: Params;
// Loss, weight, squared error, number of non-finite pixels.
@group(0) @binding(4) var<storage, read_write> partial: array<vec4<f32>>;
// The same four sums over the step, as bits of floats. Then the numbers of marched samples, of kept samples, of samples dropped from each
// of the two for lack of room, and of samples with a backward pass: all kept samples, unless samples are drawn. The array does not hold
// floats, because the bits of small counts are denormal floats, which a device may flush to zero.
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
