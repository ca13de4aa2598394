// Adds feature gradients to the gradients of the grid: one invocation per feature of a sample. The variant of `add_base`
// determines how values are added.

@group(0) @binding(0) var<storage, read> gradients: array<f32>;
@group(0) @binding(1) var<storage, read> spheres: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;
@group(0) @binding(9) var<storage, read> rays: array<Ray>;
@group(0) @binding(10) var<storage, read> owners: array<u32>;

@compute @workgroup_size(GROUP)
fn voxels_add(
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
    let gradient = gradients[sample * params.stride + feature];
    let cell = cell_around(spheres[sample].xyz);
    var basis = spherical_harmonics(rays[owners[sample]].direction);
    for (var corner = 0u; corner < 8u; corner++) {
        let point = corner_point(cell, corner);
        let product = corner_weight(cell, corner) * gradient;
        if feature == 0u {
            add_base(params.density + point, product);
        } else {
            let first = color_at(point, feature - 1u);
            for (var k = 0u; k < params.harmonics; k++) {
                add_base(first + k, basis[k] * product);
            }
        }
    }
}
