var<workgroup> shared_sums: array<vec4<f32>, GROUP>;

// Sum over the workgroup in a fixed order; valid in the first invocation.
fn total(local: u32, own: vec4<f32>) -> vec4<f32> {
    shared_sums[local] = own;
    workgroupBarrier();
    for (var stride = GROUP / 2u; stride > 0u; stride /= 2u) {
        if local < stride {
            shared_sums[local] += shared_sums[local + stride];
        }
        workgroupBarrier();
    }
    return shared_sums[0];
}
