// Gradients on their way down the mip levels: each texel takes a quarter of its parent's. One invocation has four channels
// of one texel. `own_gradient` reads what `scatter` left.

struct Params {
    // Side of the finer level in texels.
    side: u32,
    // There is a coarser level to pull from.
    has_coarse: u32,
}

@group(0) @binding(0) var<storage, read_write> fine: array<vec4<u32>>;
@group(0) @binding(1) var<storage, read_write> coarse: array<vec4<u32>>;
@group(0) @binding(2) var<uniform> params: Params;

@compute @workgroup_size(GROUP)
fn pull(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= 12u * params.side * params.side {
        return;
    }
    let at = i;
    var own = own_gradient(at);
    if params.has_coarse != 0u {
        let texel = i / 4u;
        let half = params.side / 2u;
        let parent = texel / params.side / 2u * half + texel % params.side / 2u;
        own += 0.25 * bitcast<vec4<f32>>(coarse[4u * parent + i % 4u]);
    }
    fine[at] = bitcast<vec4<u32>>(own);
}
