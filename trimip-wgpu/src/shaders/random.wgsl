// Mirrors `trimip_core::math::rng`: a hash of (seed, stream, step, index). `draws` is the part that all indices share.

fn pcg4d_mix(v: vec4<u32>) -> vec4<u32> {
    var r = v;
    r.x += r.y * r.w;
    r.y += r.z * r.x;
    r.z += r.x * r.y;
    r.w += r.y * r.z;
    return r;
}

fn pcg4d(v: vec4<u32>) -> vec4<u32> {
    let mixed = pcg4d_mix(v * 1664525u + 1013904223u);
    return pcg4d_mix(mixed ^ (mixed >> vec4<u32>(16u)));
}

// Returns four independent 32-bit numbers for `index`.
fn random_bits(draws: vec4<u32>, index: u32) -> vec4<u32> {
    return pcg4d(vec4<u32>(draws.x ^ index, draws.y, draws.z, draws.w + index));
}

// Returns the upper 24 bits as a number in [0, 1).
fn unit(bits: u32) -> f32 {
    return f32(bits >> 8u) * (1.0 / 16777216.0);
}

// Returns a number in 0..count from 32 random bits: the upper word of `bits` times `count`.
fn below(bits: u32, count: u32) -> u32 {
    let al = bits & 0xffffu;
    let ah = bits >> 16u;
    let bl = count & 0xffffu;
    let bh = count >> 16u;
    let middle = ah * bl + ((al * bl) >> 16u);
    let carry = al * bh + (middle & 0xffffu);
    return ah * bh + (middle >> 16u) + (carry >> 16u);
}
