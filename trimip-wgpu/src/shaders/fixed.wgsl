// Sums of gradients in 64-bit fixed point, stored as two words; `POINT` is the fixed-point value of 1. Sums of integers are
// bit-identical in any order. Before the division by the sum of the step's loss weights, gradients stay below 2^33 and are as
// exact as in f32.
const WORD: f32 = 4294967296.0;

// Returns true for values of magnitude below 2^24; 512 such values can be added without overflow.
fn fits(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7fffffffu) < 0x4b800000u;
}

// Returns the low and the high word of a value that fits.
fn to_fixed(value: f32) -> vec2<u32> {
    let size = abs(value) * POINT;
    let high = u32(size / WORD);
    let low = u32(size - f32(high) * WORD);
    return select(vec2<u32>(low, high), negated(vec2<u32>(low, high)), value < 0.0);
}

fn negated(words: vec2<u32>) -> vec2<u32> {
    let low = ~words.x + 1u;
    return vec2<u32>(low, ~words.y + select(0u, 1u, low == 0u));
}

fn from_fixed(words: vec2<u32>) -> f32 {
    let negative = (words.y >> 31u) == 1u;
    let size = select(words, negated(words), negative);
    let value = (f32(size.y) * WORD + f32(size.x)) / POINT;
    return select(value, -value, negative);
}
