// Gaussians of samples; mirrors `trimip_core::field::encoders::rip_map::Gaussian`.

struct Gaussian {
    // Mean in the unit cube, and variance across the ray.
    mean: vec3<f32>,
    across: f32,
    // Direction of the ray, and variance along it.
    direction: vec3<f32>,
    along: f32,
}

// Returns the Gaussian of a conical frustum. `extent` is the size of the unit cube. `interval` holds the distance of
// the frustum's midpoint from the apex, and the frustum's length. Both are in world units.
fn gaussian_of(sphere: vec4<f32>, extent: vec3<f32>, direction: vec3<f32>, interval: vec2<f32>) -> Gaussian {
    let half = 0.5 * interval.y;
    let ratio = half / interval.x;
    let q = select(0.0, min(ratio * ratio, 1.0), interval.x > 0.0);
    let sum = 3.0 + q;
    let shift = 2.0 * interval.x * q / sum;
    let fourth = 4.0 / 15.0;
    let along = half * half * (1.0 / 3.0 - fourth * q * (12.0 - q) / (sum * sum));
    let across = sphere.w * sphere.w * (0.25 + 5.0 / 12.0 * q - fourth * q * q / sum);
    return Gaussian(sphere.xyz + shift * direction / extent, across, direction, along);
}
