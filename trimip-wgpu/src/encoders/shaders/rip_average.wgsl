// Computes the levels of ripmaps: copies the base, then averages pairs of texels.

@group(0) @binding(1) var<storage, read> base: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn rip_base(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    let texel = part_texel(i / TEXEL_FOURS, 1u);
    if texel.plane < pass_.planes {
        maps[TEXEL_FOURS * part_index(texel.plane, 1u, 0u, texel.row, texel.column) + i % TEXEL_FOURS] = base[i];
    }
}

fn average(i: u32, axis: u32) {
    let texel = part_texel(i / TEXEL_FOURS, axis);
    if texel.plane < pass_.planes {
        let first = TEXEL_FOURS * finer_index(texel, axis, 0u) + i % TEXEL_FOURS;
        let second = TEXEL_FOURS * finer_index(texel, axis, 1u) + i % TEXEL_FOURS;
        let pair = maps[first] + maps[second];
        maps[TEXEL_FOURS * part_index(texel.plane, axis, pass_.level, texel.row, texel.column) + i % TEXEL_FOURS] = 0.5 * pair;
    }
}

@compute @workgroup_size(GROUP)
fn rip_average_along(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    average(index_of(group, groups, local), 0u);
}

@compute @workgroup_size(GROUP)
fn rip_average_across(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    average(index_of(group, groups, local), 1u);
}
