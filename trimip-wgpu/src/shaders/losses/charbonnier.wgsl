// Returns the value and the derivative of the Charbonnier loss at `difference`; mirrors `trimip_core::field::losses::charbonnier`.
// `numbers.x` is the padding.

fn charbonnier(difference: f32, numbers: vec3<f32>) -> vec2<f32> {
    let value = sqrt(difference * difference + numbers.x * numbers.x);
    return vec2<f32>(value, difference / value);
}
