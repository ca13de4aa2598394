// Adds a product to the stored value and stores the ReLU of the sum.
fn finish(value: f32, at: u32) -> f32 {
    return max(value + product[at], 0.0);
}
