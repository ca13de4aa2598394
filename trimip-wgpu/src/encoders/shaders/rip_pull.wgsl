// Adds gradients of coarse levels of ripmaps to finer levels: each texel adds half of its gradient to each of the two
// texels that it averages.

@group(0) @binding(1) var<storage, read_write> base: array<vec4<f32>>;

fn pull(i: u32, axis: u32) {
    let texel = part_texel(i / TEXEL_FOURS, axis);
    if texel.plane < pass_.planes {
        let coarse = maps[TEXEL_FOURS * part_index(texel.plane, axis, pass_.level, texel.row, texel.column) + i % TEXEL_FOURS];
        maps[TEXEL_FOURS * finer_index(texel, axis, 0u) + i % TEXEL_FOURS] += 0.5 * coarse;
        maps[TEXEL_FOURS * finer_index(texel, axis, 1u) + i % TEXEL_FOURS] += 0.5 * coarse;
    }
}

@compute @workgroup_size(GROUP)
fn rip_pull_along(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    pull(index_of(group, groups, local), 0u);
}

@compute @workgroup_size(GROUP)
fn rip_pull_across(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    pull(index_of(group, groups, local), 1u);
}

// Copies the gradient of level (0, 0) to the parameters' gradient.
@compute @workgroup_size(GROUP)
fn rip_take(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    let texel = part_texel(i / TEXEL_FOURS, 1u);
    if texel.plane < pass_.planes {
        base[i] = maps[TEXEL_FOURS * part_index(texel.plane, 1u, 0u, texel.row, texel.column) + i % TEXEL_FOURS];
    }
}
