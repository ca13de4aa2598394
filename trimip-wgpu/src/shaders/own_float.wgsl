// Reads a texel's own gradient, as written by f32 additions.
fn own_gradient(at: u32) -> vec4<f32> {
    return bitcast<vec4<f32>>(fine[at]);
}
