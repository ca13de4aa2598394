// Computes the arguments of a dispatch whose size depends on a counter on the device: at most MOST_GROUPS workgroups
// along x.

@group(0) @binding(0) var<storage, read> counts: array<u32>;
@group(0) @binding(1) var<storage, read_write> arguments: array<u32>;
@group(0) @binding(2) var<uniform> params: Params;

@compute @workgroup_size(1)
fn size() {
    let items = counts[params.counter] * params.per;
    let groups = (items + params.group - 1u) / params.group * params.times;
    arguments[SIZE_WORDS * params.slot] = min(groups, MOST_GROUPS);
    arguments[SIZE_WORDS * params.slot + 1u] = (groups + MOST_GROUPS - 1u) / MOST_GROUPS;
    arguments[SIZE_WORDS * params.slot + 2u] = 1u;
}
