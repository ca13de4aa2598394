// The reads of a Gaussian on a plane; mirrors `trimip_core::field::encoders::rip_map::Plane::reads`.

@group(0) @binding(1) var<storage, read> gaussians: array<Gaussian>;
@group(0) @binding(2) var<uniform> params: Params;

// The position of a Gaussian along the two axes of a plane, and the levels that it blends along each axis.
struct Projection {
    at: vec2<f32>,
    blends: array<Blend, 2>,
}

fn blend_along(gaussian: Gaussian, axis: vec4<f32>, levels: u32) -> Blend {
    let cosine = dot(axis.xyz, gaussian.direction);
    let square = cosine * cosine;
    let variance = gaussian.across * (1.0 - square) + gaussian.along * square;
    return blend_at(0.5 * log2(variance) - axis.w, levels);
}

fn project(gaussian: Gaussian, plane: u32, levels: u32) -> Projection {
    let mean = vec4<f32>(gaussian.mean, 1.0);
    let at = vec2<f32>(dot(planes[plane].places[0], mean), dot(planes[plane].places[1], mean));
    let along = blend_along(gaussian, planes[plane].axes[0], levels);
    let across = blend_along(gaussian, planes[plane].axes[1], levels);
    return Projection(at, array<Blend, 2>(along, across));
}

// One of the four combinations of levels: bit 0 of `which` selects the coarser level along the rows, bit 1 the coarser
// level across them.
struct Read {
    levels: vec2<u32>,
    level_weight: f32,
}

fn read_of(projection: Projection, which: u32) -> Read {
    let along = projection.blends[0];
    let across = projection.blends[1];
    let upper = vec2<bool>((which & 1u) != 0u, (which & 2u) != 0u);
    let level_weights = vec2<f32>(
        select(1.0 - along.fraction, along.fraction, upper.x),
        select(1.0 - across.fraction, across.fraction, upper.y),
    );
    let levels = vec2<u32>(along.lower, across.lower) + select(vec2<u32>(0u), vec2<u32>(1u), upper);
    return Read(levels, level_weights.x * level_weights.y);
}

fn read_taps(projection: Projection, plane: u32, levels: vec2<u32>) -> Taps {
    return texel_taps(planes[plane].sides >> levels, projection.at);
}

// Returns the index, in the array of all ripmaps, of the texel at `row` and `column` of a level.
fn read_texel(plane: u32, levels: vec2<u32>, row: u32, column: u32) -> u32 {
    let first = vec2<u32>(level_first(plane, 0u, levels.x), level_first(plane, 1u, levels.y));
    return map_texel(plane, params.levels, first.y + row, first.x + column);
}
