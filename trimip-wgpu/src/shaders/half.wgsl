// Converts a factor to f16, clamped to the range of f16.
fn half(x: f32) -> f16 {
    return f16(clamp(x, -MOST_HALF, MOST_HALF));
}

// Returns 1 if f16 cannot hold the number, or if it is NaN. Compares the bits, because a device may compare floats as
// if there were no NaN.
fn too_large(x: f32) -> u32 {
    return select(1u, 0u, (bitcast<u32>(x) & 0x7fffffffu) <= bitcast<u32>(MOST_HALF));
}
