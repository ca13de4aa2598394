// Sizes of dispatches that depend on a count on the device: workgroups in rows of at most 65,535.

struct Params {
    // Items are counts[counter] · per; a workgroup takes `group` of them.
    counter: u32,
    per: u32,
    group: u32,
    // Which dispatch the sizes are for.
    slot: u32,
}

@group(0) @binding(0) var<storage, read> counts: array<u32>;
@group(0) @binding(1) var<storage, read_write> arguments: array<u32>;
@group(0) @binding(2) var<uniform> params: Params;

@compute @workgroup_size(1)
fn size() {
    let items = counts[params.counter] * params.per;
    let groups = (items + params.group - 1u) / params.group;
    arguments[4u * params.slot] = min(groups, 65535u);
    arguments[4u * params.slot + 1u] = (groups + 65534u) / 65535u;
    arguments[4u * params.slot + 2u] = 1u;
}
