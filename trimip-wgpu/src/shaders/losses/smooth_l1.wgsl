// Returns the value and the derivative of the smooth L1 loss at `difference`; mirrors `trimip_core::field::losses::smooth_l1`.
// The loss is quadratic for differences up to `numbers.x`.

fn smooth_l1(difference: f32, numbers: vec3<f32>) -> vec2<f32> {
    let beta = numbers.x;
    let size = abs(difference);
    if size < beta {
        return vec2<f32>(0.5 * difference * difference / beta, difference / beta);
    }
    return vec2<f32>(size - 0.5 * beta, sign(difference));
}
