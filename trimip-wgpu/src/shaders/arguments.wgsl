// Arguments of dispatches whose size depends on a count on the device; at most 65,535 workgroups along x.

struct Params {
    // The number of items is counts[counter] · per; `times` workgroups cover every `group` items.
    counter: u32,
    per: u32,
    group: u32,
    times: u32,
    // Index of the dispatch.
    slot: u32,
}

@group(0) @binding(0) var<storage, read> counts: array<u32>;
@group(0) @binding(1) var<storage, read_write> arguments: array<u32>;
@group(0) @binding(2) var<uniform> params: Params;

@compute @workgroup_size(1)
fn size() {
    let items = counts[params.counter] * params.per;
    let groups = (items + params.group - 1u) / params.group * params.times;
    arguments[4u * params.slot] = min(groups, 65535u);
    arguments[4u * params.slot + 1u] = (groups + 65534u) / 65535u;
    arguments[4u * params.slot + 2u] = 1u;
}
