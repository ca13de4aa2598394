// Converts gradients of texels or entries from fixed point to f32, four per invocation.

@group(0) @binding(0) var<storage, read_write> fine: array<vec4<u32>>;
@group(0) @binding(2) var<uniform> settling: Conversion;

@compute @workgroup_size(GROUP)
fn fixed_to_float(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i < settling.count {
        fine[i] = bitcast<vec4<u32>>(own_gradient(i));
    }
}
