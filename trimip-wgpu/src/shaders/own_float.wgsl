// Reads a texel's own gradient, which f32 additions have summed.
fn own_gradient(at: u32) -> vec4<f32> {
    return bitcast<vec4<f32>>(fine[at]);
}
