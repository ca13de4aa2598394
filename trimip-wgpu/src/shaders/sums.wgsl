// Sums over a workgroup. `Sum` is the type of the summands.
var<workgroup> shared_sums: array<Sum, GROUP>;

// Returns the sum over the workgroup, computed in a fixed order; valid in the first invocation.
fn workgroup_sum(local: u32, own: Sum) -> Sum {
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
