// Adds feature gradients to the gradients of factors: one invocation per four features of a sample. The variant of
// `add_base` determines how values are added.

@group(0) @binding(0) var<storage, read> gradients: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read> spheres: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;

fn add_four(at: u32, value: vec4<f32>) {
    for (var c = 0u; c < 4u; c++) {
        add_base(4u * at + c, value[c]);
    }
}

fn add_line(f: Feature, line: u32, position: vec3<f32>, value: vec4<f32>) {
    let place = along(axes(line).z, position);
    let at = line_index(f, line, place.lower);
    add_four(at, (1.0 - place.upper) * value);
    add_four(at + f.width, place.upper * value);
}

@compute @workgroup_size(GROUP)
fn tensor_add(
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
    let by_feature = gradients[i];
    if params.planes == 0u {
        let a = line_value(f, 0u, position);
        let b = line_value(f, 1u, position);
        let c = line_value(f, 2u, position);
        add_line(f, 0u, position, by_feature * b * c);
        add_line(f, 1u, position, by_feature * a * c);
        add_line(f, 2u, position, by_feature * a * b);
        return;
    }
    let own = cell(f, position);
    add_line(f, f.plane, position, by_feature * plane_value(f, own));
    let by_plane = by_feature * line_value(f, f.plane, position);
    add_four(own.at, (1.0 - own.up) * (1.0 - own.right) * by_plane);
    add_four(own.at + f.width, (1.0 - own.up) * own.right * by_plane);
    add_four(own.at + own.columns, own.up * (1.0 - own.right) * by_plane);
    add_four(own.at + own.columns + f.width, own.up * own.right * by_plane);
}
