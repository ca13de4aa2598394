// Peak rate of multiply-adds: eight chains of vectors without memory accesses.

@group(0) @binding(0) var<storage, read_write> results: array<vec4<f32>>;
@group(0) @binding(1) var<uniform> params: Params;

@compute @workgroup_size(GROUP)
fn peak(@builtin(global_invocation_id) id: vec3<u32>) {
    let seed = vec4<f32>(f32(id.x) * 1e-9);
    var a = seed;
    var b = seed + 0.1;
    var c = seed + 0.2;
    var d = seed + 0.3;
    var e = seed + 0.4;
    var f = seed + 0.5;
    var g = seed + 0.6;
    var h = seed + 0.7;
    let scale = vec4<f32>(0.999);
    let shift = vec4<f32>(0.001);
    for (var i = 0u; i < params.rounds; i++) {
        a = fma(a, scale, shift);
        b = fma(b, scale, shift);
        c = fma(c, scale, shift);
        d = fma(d, scale, shift);
        e = fma(e, scale, shift);
        f = fma(f, scale, shift);
        g = fma(g, scale, shift);
        h = fma(h, scale, shift);
    }
    results[id.x % arrayLength(&results)] = a + b + c + d + e + f + g + h;
}
