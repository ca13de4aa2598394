// Compares the opacity of a pixel with the alpha of its photograph; mirrors `trimip_core::field::losses::opacity`. `at` is the first
// word of the pixel's target.

fn opacity(
    pixel: vec4<f32>,
    at: u32,
    numbers: vec3<f32>,
    factor: f32,
    gradient: ptr<function, vec4<f32>>,
) -> f32 {
    let value = smooth_l1(pixel.a - targets[at + TARGET_OPACITY], numbers);
    (*gradient).a += factor * value.y;
    return value.x;
}
