// Adds gradients of coarse mip levels to finer levels: each texel gets a quarter of its parent's gradient. One
// invocation computes four channels of one texel. `own_gradient` reads the sum that `scatter` wrote.

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
    if i / TEXEL_FOURS >= plane_start(params.sides, 3u) {
        return;
    }
    var own = own_gradient(i);
    if params.has_coarse != 0u {
        let place = place_of(params.sides, i / TEXEL_FOURS);
        let parent = Place(place.plane, place.row / 2u, place.column / 2u);
        let coarser = texel_at(params.sides / 2u, parent);
        own += 0.25 * bitcast<vec4<f32>>(coarse[TEXEL_FOURS * coarser + i % TEXEL_FOURS]);
    }
    fine[i] = bitcast<vec4<u32>>(own);
}
