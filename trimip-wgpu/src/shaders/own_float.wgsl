// A texel's own gradient as f32 additions left it.
fn own_gradient(at: u32) -> vec4<f32> {
    return bitcast<vec4<f32>>(fine[at]);
}
