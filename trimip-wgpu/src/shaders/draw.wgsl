// The pixels of a training step; the same as `SamplerPolicy::pixel`.

@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(4) var<storage, read> scales: array<Scale>;

// Scale of pixel `index` of the step, and its index among all pixels of the views.
fn drawn(index: u32) -> vec2<u32> {
    var s = 0u;
    for (var j = 1u; j < params.scales; j++) {
        if index >= params.begins[j / 4u][j % 4u] {
            s = j;
        }
    }
    let scale = scales[s];
    return vec2<u32>(s, scale.first_pixel + below(random_bits(params.draws, index).x, scale.pixels));
}
