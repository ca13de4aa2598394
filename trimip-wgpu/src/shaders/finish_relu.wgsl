// Stores a product after a ReLU.
fn finish(value: f32, at: u32) -> f32 {
    return max(value, 0.0);
}
