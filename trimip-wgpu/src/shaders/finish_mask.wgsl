// Stores a product where the mask, which has the same shape, is above zero, and 0 elsewhere: the derivative of a ReLU.
@group(0) @binding(4) var<storage, read> mask: array<f32>;

fn finish(value: f32, at: u32) -> f32 {
    return select(0.0, value, mask[at] > 0.0);
}
