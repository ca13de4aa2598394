// Mip levels: each texel of a level is the mean of four of the finer one. One invocation has four channels of one texel.

struct Params {
    // Side of the finer level in texels.
    side: u32,
}

@group(0) @binding(0) var<storage, read_write> fine: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read_write> coarse: array<vec4<f32>>;
@group(0) @binding(2) var<uniform> params: Params;

@compute @workgroup_size(GROUP)
fn average(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    let half = params.side / 2u;
    if i >= 12u * half * half {
        return;
    }
    let texel = i / 4u;
    let row = texel / half;
    let first = (2u * row * params.side + 2u * (texel % half)) * 4u + i % 4u;
    let below = fine[first] + fine[first + 4u];
    let above = fine[first + 4u * params.side]
        + fine[first + 4u * params.side + 4u];
    coarse[i] = 0.25 * (below + above);
}
