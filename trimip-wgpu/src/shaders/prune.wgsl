// Pruning. `see` walks each ray front to back, marks the samples to keep, and lengthens their intervals by the faint samples
// that merge with them. After a prefix sum of the counts, `list` writes the rows of the marked samples. Mirrors
// `compositing::Pruning`.

@group(0) @binding(0) var<storage, read_write> segments: array<vec2<u32>>;
@group(0) @binding(1) var<storage, read_write> kept: array<u32>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> radiance: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> intervals: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read_write> old_segments: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> marks: array<u32>;

@compute @workgroup_size(GROUP)
fn see(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    let segment = segments[i];
    old_segments[i] = segment;
    var passed = Passed(0.0, 0.0);
    var count = 0u;
    for (var j = segment.x; j < segment.x + segment.y; j++) {
        let own = radiance[j].w * intervals[j].y;
        let factor = stands_for(&passed, own, params.max_depth, params.min_weight);
        if factor == 0.0 {
            marks[j] = 0u;
            continue;
        }
        intervals[j].y *= factor;
        marks[j] = 1u;
        count += 1u;
    }
    segments[i] = vec2<u32>(0u, count);
}

// Counts the marked samples of each ray.
@compute @workgroup_size(GROUP)
fn recount(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    let segment = segments[i];
    old_segments[i] = segment;
    var count = 0u;
    for (var j = segment.x; j < segment.x + segment.y; j++) {
        count += marks[j];
    }
    segments[i] = vec2<u32>(0u, count);
}

@compute @workgroup_size(GROUP)
fn list(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    let segment = fitting(segments[i], params.capacity);
    segments[i] = segment;
    let old = old_segments[i];
    var at = segment.x;
    let end = segment.x + segment.y;
    for (var j = old.x; j < old.x + old.y && at < end; j++) {
        if marks[j] == 1u {
            kept[at] = j;
            at += 1u;
        }
    }
}
