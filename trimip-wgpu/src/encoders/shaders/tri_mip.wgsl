// Twin of `trimip_core::tri_mip`: the level of a sphere (Eq. 5) and the texels that a query reads. Needs
// `planes.wgsl`.

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

struct Blend {
    lower: u32,
    fraction: f32,
}

fn blend_levels(pyramid: Pyramid, plane: u32, log2_radius: f32) -> Blend {
    let level = log2_radius - pyramid.log2_base_radius[plane];
    let top = f32(pyramid.levels - 1u);
    if !(level > 0.0) || pyramid.levels == 1u {
        return Blend(0u, 0.0);
    }
    if level >= top {
        return Blend(pyramid.levels - 1u, 0.0);
    }
    let lower = floor(level);
    return Blend(u32(lower), level - lower);
}

struct Taps {
    // Columns of the left and right texels, rows of the lower and upper ones.
    columns: vec2<u32>,
    rows: vec2<u32>,
    // Interpolation fractions towards the right column and the upper row.
    right: f32,
    up: f32,
}

fn texel_taps(shape: vec2<u32>, at: vec2<f32>) -> Taps {
    let place = at * vec2<f32>(shape) - 0.5;
    let lower = floor(place);
    let fraction = place - lower;
    let last = vec2<i32>(shape) - 1;
    let low = vec2<i32>(lower);
    let first = vec2<u32>(clamp(low, vec2<i32>(0), last));
    let second = vec2<u32>(clamp(low + 1, vec2<i32>(0), last));
    return Taps(vec2<u32>(first.x, second.x), vec2<u32>(first.y, second.y), fraction.x, fraction.y);
}

fn tap_weight(taps: Taps, row: u32, column: u32) -> f32 {
    return select(1.0 - taps.up, taps.up, row == 1u) * select(1.0 - taps.right, taps.right, column == 1u);
}
