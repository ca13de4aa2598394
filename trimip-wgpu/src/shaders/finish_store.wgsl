// Stores a product unchanged.
fn finish(value: f32, at: u32) -> f32 {
    return value;
}
