// Reads the grid: one invocation computes one of the four features of a sample, and writes a quarter of the zeros after
// the features.

@group(0) @binding(0) var<storage, read> values: array<f32>;
@group(0) @binding(1) var<storage, read> spheres: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> features: array<f32>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;
@group(0) @binding(6) var<storage, read> rays: array<Ray>;
@group(0) @binding(9) var<storage, read> owners: array<u32>;

@compute @workgroup_size(GROUP)
fn voxels_read(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    let sample = i / WIDTH;
    if sample >= counts[params.counter] {
        return;
    }
    let feature = i % WIDTH;
    let cell = cell_around(spheres[sample].xyz);
    var basis = spherical_harmonics(rays[owners[sample]].direction);
    var sum = 0.0;
    for (var corner = 0u; corner < 8u; corner++) {
        let point = corner_point(cell, corner);
        var value = 0.0;
        if feature == 0u {
            value = values[params.density + point];
        } else {
            let first = color_at(point, feature - 1u);
            for (var k = 0u; k < params.harmonics; k++) {
                value += basis[k] * values[first + k];
            }
        }
        sum += corner_weight(cell, corner) * value;
    }
    let row = sample * params.stride;
    features[row + feature] = sum;
    for (var at = WIDTH + feature; at < params.stride; at += WIDTH) {
        features[row + at] = 0.0;
    }
}
