// Exclusive prefix sums of the segments' counts. `sum_blocks` sums blocks of BLOCK segments, `sum_all` scans the
// blocks, and `start_segments` writes the start of every segment. The order of all additions is fixed.

// Number of segments per workgroup.
const BLOCK: u32 = EACH * GROUP;

@group(0) @binding(0) var<storage, read_write> segments: array<vec2<u32>>;
@group(0) @binding(1) var<storage, read_write> blocks: array<u32>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;

var<workgroup> sums: array<u32, GROUP>;

// Returns the exclusive prefix sum over the workgroup; afterwards `sums[GROUP - 1]` holds the total.
fn exclusive(local: u32, own: u32) -> u32 {
    sums[local] = own;
    workgroupBarrier();
    for (var stride = 1u; stride < GROUP; stride *= 2u) {
        var before = 0u;
        if local >= stride {
            before = sums[local - stride];
        }
        workgroupBarrier();
        sums[local] += before;
        workgroupBarrier();
    }
    return sums[local] - own;
}

@compute @workgroup_size(GROUP)
fn sum_blocks(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let block = group.y * groups.x + group.x;
    var own = 0u;
    for (var j = 0u; j < EACH; j++) {
        let i = block * BLOCK + local * EACH + j;
        if i < params.count {
            own += segments[i].y;
        }
    }
    let before = exclusive(local, own);
    if local == GROUP - 1u && block < params.blocks {
        blocks[block] = before + own;
    }
}

@compute @workgroup_size(GROUP)
fn sum_all(@builtin(local_invocation_index) local: u32) {
    var done = 0u;
    for (var first = 0u; first < params.blocks; first += GROUP) {
        var own = 0u;
        if first + local < params.blocks {
            own = blocks[first + local];
        }
        let before = exclusive(local, own);
        if first + local < params.blocks {
            blocks[first + local] = done + before;
        }
        done += sums[GROUP - 1u];
        workgroupBarrier();
    }
    if local == 0u {
        counts[params.counter] = min(done, params.capacity);
        counts[params.counter + DROPPED] = done - min(done, params.capacity);
    }
}

@compute @workgroup_size(GROUP)
fn start_segments(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let block = group.y * groups.x + group.x;
    var own = 0u;
    for (var j = 0u; j < EACH; j++) {
        let i = block * BLOCK + local * EACH + j;
        if i < params.count {
            own += segments[i].y;
        }
    }
    var at = exclusive(local, own);
    if block < params.blocks {
        at += blocks[block];
    }
    for (var j = 0u; j < EACH; j++) {
        let i = block * BLOCK + local * EACH + j;
        if i < params.count {
            segments[i].x = at;
            at += segments[i].y;
        }
    }
}
