// Mip levels: each texel is the mean of four texels of the finer level. One invocation computes four channels of one
// texel.

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
    let sides = params.sides / 2u;
    if i / TEXEL_FOURS >= plane_start(sides, 3u) {
        return;
    }
    let place = place_of(sides, i / TEXEL_FOURS);
    let child = Place(place.plane, 2u * place.row, 2u * place.column);
    let first = TEXEL_FOURS * texel_at(params.sides, child) + i % TEXEL_FOURS;
    let row = TEXEL_FOURS * plane_shape(params.sides, place.plane).x;
    let below = fine[first] + fine[first + TEXEL_FOURS];
    let above = fine[first + row] + fine[first + row + TEXEL_FOURS];
    coarse[i] = 0.25 * (below + above);
}
