// Blackens the samples whose compositing weight is below `params.least`. One invocation per ray.

@group(0) @binding(0) var<storage, read> segments: array<vec2<u32>>;
@group(0) @binding(1) var<storage, read_write> radiance: array<vec4<f32>>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> intervals: array<vec2<f32>>;

@compute @workgroup_size(GROUP)
fn dim(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    let segment = segments[i];
    var before = 0.0;
    for (var j = segment.x; j < segment.x + segment.y; j++) {
        let density = radiance[j].w;
        let depth = density * intervals[j].y;
        if exp(-before) * alpha_of(depth) < params.least {
            radiance[j] = vec4<f32>(0.0, 0.0, 0.0, density);
        }
        before += depth;
    }
}
