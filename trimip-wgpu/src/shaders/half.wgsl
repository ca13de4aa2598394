// Converts a factor to f16; clamps it to the largest f16.
fn half(x: f32) -> f16 {
    return f16(clamp(x, -MOST_HALF, MOST_HALF));
}

// 1 if f16 cannot hold the number or it is NaN. Tests the bits, because a device may compare as if there were no NaN.
fn too_large(x: f32) -> u32 {
    return select(1u, 0u, (bitcast<u32>(x) & 0x7fffffffu) <= bitcast<u32>(MOST_HALF));
}
