// Mirrors `trimip_core::math::compositing`.

// Returns 1 - exp(-x), with a small relative error for thin samples too.
fn alpha_of(x: f32) -> f32 {
    if abs(x) < 0.25 {
        return x * (1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0 * (1.0 - x / 7.0))))));
    }
    return 1.0 - exp(-x);
}
