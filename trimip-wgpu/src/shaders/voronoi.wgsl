// Returns the softmax of sharpness * dot(site, d) over the 16 sites; mirrors `trimip_core::math::voronoi`, whose sites are `SITES`.
fn soft_voronoi(d: vec3<f32>, sharpness: f32) -> array<f32, 16> {
    var sites = SITES;
    var weights: array<f32, 16>;
    var sum = 0.0;
    for (var i = 0u; i < 16u; i++) {
        let cosine = sites[3u * i] * d.x + sites[3u * i + 1u] * d.y + sites[3u * i + 2u] * d.z;
        weights[i] = exp(sharpness * (cosine - 1.0));
        sum += weights[i];
    }
    for (var i = 0u; i < 16u; i++) {
        weights[i] = weights[i] / sum;
    }
    return weights;
}
