// Packed weights in f32.
alias Weight = f32;

fn weight_of(x: f32) -> Weight {
    return x;
}
