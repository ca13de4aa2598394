// Mip levels and texels of a bilinear read; mirrors `LevelBlend` and `taps` in `trimip_core::field::encoders::tri_mip`.

struct Blend {
    lower: u32,
    fraction: f32,
}

// Returns the two levels around `level`, which is clamped to [0, levels - 1], as the lower level and the weight of the
// upper level.
fn blend_at(level: f32, levels: u32) -> Blend {
    if !(level > 0.0) || levels == 1u {
        return Blend(0u, 0.0);
    }
    if level >= f32(levels - 1u) {
        return Blend(levels - 1u, 0.0);
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
