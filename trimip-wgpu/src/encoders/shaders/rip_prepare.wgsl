// Computes the Gaussian of every sample, one per invocation.

@group(0) @binding(0) var<storage, read> rays: array<Ray>;
@group(0) @binding(1) var<storage, read> owners: array<u32>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> intervals: array<vec2<f32>>;
@group(0) @binding(4) var<storage, read_write> gaussians: array<Gaussian>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;
@group(0) @binding(6) var<storage, read> spheres: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn rip_prepare(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i < counts[params.counter] {
        gaussians[i] = gaussian_of(spheres[i], params.extent, rays[owners[i]].direction, intervals[i]);
    }
}
