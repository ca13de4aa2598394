// Draws pixels evenly from their scale; mirrors `SamplerPolicy::pixel` without an error map.

fn drawn(index: u32) -> Drawn {
    let s = scale_of(index);
    let pixels = params.pixels[s / 4u][s % 4u];
    let pixel = params.first_pixels[s / 4u][s % 4u] + below(random_bits(params.draws, index).x, pixels);
    return Drawn(s, pixel, 1.0);
}
