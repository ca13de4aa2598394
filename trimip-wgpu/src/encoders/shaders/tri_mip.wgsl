// Twin of `trimip_core::tri_mip`: the level of a sphere (Eq. 5) and the texels that a query reads. Needs
// `planes.wgsl` and `texels.wgsl`.

struct Pyramid {
    // log2 of each plane's base radius.
    log2_base_radius: vec3<f32>,
    levels: u32,
    // Texels along x, y and z at level 0.
    sides: vec3<u32>,
    // Index of the counter of rows: counts[counter].
    counter: u32,
}

// Coordinates along a row of texels and across the rows.
fn plane_axes(position: vec3<f32>, plane: u32) -> vec2<f32> {
    switch plane {
        case 0u: { return position.yz; }
        case 1u: { return position.xz; }
        default: { return position.xy; }
    }
}

// Index of the first texel of `level` of `plane`. Level 0 starts the parameters, level 1 the derived levels.
fn level_start(pyramid: Pyramid, level: u32, plane: u32) -> u32 {
    var start = plane_start(pyramid.sides >> vec3<u32>(level), plane);
    for (var l = 1u; l < level; l++) {
        start += plane_start(pyramid.sides >> vec3<u32>(l), 3u);
    }
    return start;
}

fn blend_levels(pyramid: Pyramid, plane: u32, log2_radius: f32) -> Blend {
    return blend_at(log2_radius - pyramid.log2_base_radius[plane], pyramid.levels);
}
