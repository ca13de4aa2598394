// Reads a texel's own gradient, which `add_fixed.wgsl` has summed.
@group(0) @binding(3) var<storage, read_write> high: array<vec4<u32>>;

fn own_gradient(at: u32) -> vec4<f32> {
    let low = fine[at];
    let upper = high[at];
    return vec4<f32>(
        from_fixed(vec2<u32>(low.x, upper.x)),
        from_fixed(vec2<u32>(low.y, upper.y)),
        from_fixed(vec2<u32>(low.z, upper.z)),
        from_fixed(vec2<u32>(low.w, upper.w)),
    );
}
