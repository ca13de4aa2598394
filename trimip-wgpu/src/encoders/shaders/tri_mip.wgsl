// Mirrors `trimip_core::field::encoders::tri_mip`: the level of a sphere (Eq. 5) and the texels that a query reads.

// Returns a position's coordinates along a row of texels and across the rows.
fn plane_axes(position: vec3<f32>, plane: u32) -> vec2<f32> {
    switch plane {
        case 0u: { return position.yz; }
        case 1u: { return position.xz; }
        default: { return position.xy; }
    }
}

// Returns the index of the first texel of `plane` on `level`. Level 0 lies at the start of the parameters, level 1 at
// the start of the derived levels.
fn level_start(pyramid: Pyramid, level: u32, plane: u32) -> u32 {
    var start = plane_start(pyramid.sides >> vec3<u32>(level), plane);
    for (var l = 1u; l < level; l++) {
        start += plane_start(pyramid.sides >> vec3<u32>(l), 3u);
    }
    return start;
}

// Returns a sphere's level as an input of the networks: log2(r / r̈) in units of LEVELS_PER_UNIT, clamped.
fn level_feature(log2_radius: f32, reference: f32) -> f32 {
    return clamp((log2_radius - reference) / LEVELS_PER_UNIT, -MOST_LEVEL_INPUT, MOST_LEVEL_INPUT);
}

fn blend_levels(pyramid: Pyramid, plane: u32, log2_radius: f32) -> Blend {
    return blend_at(log2_radius - pyramid.log2_base_radius[plane], pyramid.levels);
}
