// Largest f16.
const MOST: f32 = 65504.0;

// A factor in f16; what is too large becomes the largest.
fn half(x: f32) -> f16 {
    return f16(clamp(x, -MOST, MOST));
}

// 1 for a number that f16 cannot hold, or that is none; by its bits, since a device may compare as if there were no NaN.
fn too_large(x: f32) -> u32 {
    return select(1u, 0u, (bitcast<u32>(x) & 0x7fffffffu) <= bitcast<u32>(MOST));
}
