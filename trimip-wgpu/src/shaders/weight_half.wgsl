// Packed weights in f16.
alias Weight = f16;

fn weight_of(x: f32) -> Weight {
    return half(x);
}
