// Pruning for hybrid rendering. Marks the first sample of each group of samples that share a colour, and drops the
// others. The first sample gets the optical depth, the length and the weighted mean distance of its group, and the
// weighted mean of the group's geometry features. A ray that is too wide for the proxy keeps all its visible samples.
// Mirrors `trimip_core::engine::proxy::share_colors`.

@group(0) @binding(0) var<storage, read_write> segments: array<vec2<u32>>;
@group(0) @binding(1) var<storage, read> sure: array<u32>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read_write> radiance: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> intervals: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read_write> old_segments: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> marks: array<u32>;
@group(0) @binding(7) var<storage, read_write> outputs: array<f32>;

// A group of samples; its first sample is row `row`.
struct Group {
    row: u32,
    members: u32,
    first_t: f32,
    weight: f32,
    moment: f32,
    depth: f32,
    length: f32,
}

// Writes the shared values of a group to its first row.
fn finish(group: Group) {
    // A group without weight is invisible, and its first sample represents it unchanged.
    if group.members > 1u && group.weight > 0.0 {
        intervals[group.row] = vec2<f32>(group.moment / group.weight, group.length);
        radiance[group.row].w = group.depth / group.length;
    }
}

@compute @workgroup_size(GROUP)
fn share(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(workgroup, workgroups, local);
    if i >= params.count {
        return;
    }
    let segment = segments[i];
    old_segments[i] = segment;
    let shares = sure[i] == 1u;
    var passed = Passed(0.0, 0.0);
    var count = 0u;
    var group = Group(0u, 0u, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (var j = segment.x; j < segment.x + segment.y; j++) {
        let before = passed.depth;
        let factor = stands_for(&passed, radiance[j].w * intervals[j].y, params.max_depth, params.min_weight);
        if factor == 0.0 {
            marks[j] = 0u;
            continue;
        }
        intervals[j].y *= factor;
        let interval = intervals[j];
        let depth = radiance[j].w * interval.y;
        let weight = exp(-before) * alpha_of(depth);
        let sum = group.weight + weight;
        // The condition is false for NaN, so such a sample forms its own group.
        if shares && group.members > 0u && sum <= params.shared_weight && interval.x - group.first_t <= params.reach {
            if sum > 0.0 {
                // The mean so far moves towards this sample's features.
                let part = weight / sum;
                let mean = params.outputs * group.row + 1u;
                let own = params.outputs * j + 1u;
                for (var k = 0u; k < params.geometry; k++) {
                    outputs[mean + k] += part * (outputs[own + k] - outputs[mean + k]);
                }
            }
            group.members += 1u;
            group.weight = sum;
            group.moment += weight * interval.x;
            group.depth += depth;
            group.length += interval.y;
            marks[j] = 0u;
        } else {
            finish(group);
            group = Group(j, 1u, interval.x, weight, weight * interval.x, depth, interval.y);
            marks[j] = 1u;
            count += 1u;
        }
    }
    finish(group);
    segments[i] = vec2<u32>(0u, count);
}
