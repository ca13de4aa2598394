// One invocation computes four features of one sample.

@group(0) @binding(1) var<storage, read> spheres: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> features: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;

@compute @workgroup_size(GROUP)
fn tensor_read(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    let sample = i / params.stride;
    if sample >= counts[params.counter] {
        return;
    }
    let position = spheres[sample].xyz;
    let f = feature(i % params.stride);
    if params.planes == 0u {
        features[i] = line_value(f, 0u, position) * line_value(f, 1u, position) * line_value(f, 2u, position);
    } else {
        features[i] = plane_value(f, cell(f, position)) * line_value(f, f.plane, position);
    }
}
