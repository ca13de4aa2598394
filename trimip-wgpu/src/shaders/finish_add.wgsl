// Adds a product to the stored value.
fn finish(value: f32, at: u32) -> f32 {
    return value + product[at];
}
